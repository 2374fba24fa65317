"""What a first run waits for."""

from __future__ import annotations

import gc

import pytest
from numba import njit

from softbot.cli.compiling import told_of_compiling


def test_the_compiler_runs_without_garbage_collection_and_nothing_else_does(capsys: pytest.CaptureFixture[str]) -> None:
    twice = njit(lambda x: 2 * x)
    with told_of_compiling("preparing", "compiling, once"):
        assert gc.isenabled()
        assert twice(3) == 6
        assert not gc.isenabled()
    assert gc.isenabled()
    assert "compiling, once" in "".join(capsys.readouterr())


def test_garbage_is_collected_again_when_the_inside_fails() -> None:
    twice = njit(lambda x: 2 * x)
    with pytest.raises(ZeroDivisionError), told_of_compiling("preparing", "compiling, once"):
        _ = twice(3) / 0
    assert gc.isenabled()
