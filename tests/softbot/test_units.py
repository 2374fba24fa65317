"""Units: kernels that others call where they are, compiled here, elsewhere or on an earlier day."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from numba.core import types

NAME = "_units_of_a_test"
MODULE = """
from softbot.kernel_compiler import kernel, part, unit

@unit()
def thrice(value):
    return {factor} * value

@part()
def one_more(value):
    return thrice(value) + 1.0

@kernel()
def outer(value):
    return one_more(value) - thrice(0.5 * value)
"""
CALL = f"""
import importlib.util, sys
spec = importlib.util.spec_from_file_location({NAME!r}, sys.argv[1])
module = importlib.util.module_from_spec(spec)
sys.modules[{NAME!r}] = module
spec.loader.exec_module(module)
print(module.outer(2.0), sum(module.outer.stats.cache_hits.values()), sum(module.thrice.stats.cache_hits.values()))
"""
SIGNATURE = types.float64(types.float64)


def _written(folder: Path, factor: str = "3.0") -> Path:
    file = folder / f"{NAME}.py"
    file.write_text(MODULE.format(factor=factor))
    return file


def _called_elsewhere(file: Path) -> list[float]:
    """What `outer` gives in another process, and how often it and the unit were found on disk."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(file.parent / "kept"), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", CALL, str(file)],
        capture_output=True,
        text=True,
        env=environment,
        check=True,
        timeout=120,
    )
    return [float(word) for word in done.stdout.split()]


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    spec = importlib.util.spec_from_file_location(NAME, _written(tmp_path))
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, NAME, made)
    spec.loader.exec_module(made)
    return made


def _waited(times: list[Any]) -> Any:
    return lambda: times.append(None)


def test_a_kernel_and_its_unit_are_found_again_and_not_once_the_unit_has_changed(tmp_path: Path) -> None:
    file = _written(tmp_path)
    assert _called_elsewhere(file) == [4.0, 0.0, 0.0]
    assert _called_elsewhere(file) == [4.0, 1.0, 1.0]
    for kept in (tmp_path / "kept").rglob("*thrice*.nbc"):
        kept.unlink()
    assert _called_elsewhere(file) == [4.0, 1.0, 0.0]  # the unit alone is compiled again
    was = file.stat()
    _written(tmp_path, "5.0")
    os.utime(file, ns=(was.st_atime_ns, was.st_mtime_ns))  # of the same size and date
    assert _called_elsewhere(file) == [6.0, 0.0, 0.0]


def test_a_promised_unit_is_waited_for_when_its_caller_is_needed(module: ModuleType) -> None:
    waits: list[Any] = []
    module.thrice.promise(SIGNATURE, _waited(waits))
    module.thrice.compile(SIGNATURE.args)
    assert waits == []
    assert module.outer(2.0) == 4.0  # and a promise that was not kept is made good
    assert len(waits) == 1
    assert module.outer(4.0) == 7.0
    assert len(waits) == 1


def test_what_is_promised_no_longer_is_compiled_here(module: ModuleType) -> None:
    waits: list[Any] = []
    module.thrice.promise(SIGNATURE, _waited(waits))
    module.thrice.compile(SIGNATURE.args)
    module.thrice.withdraw(SIGNATURE.args)
    assert module.outer(2.0) == 4.0
    assert waits == []


def test_a_unit_that_python_calls_runs_as_python(module: ModuleType) -> None:
    assert module.thrice(2) == 6.0
    with pytest.raises(TypeError):
        module.thrice("b")
