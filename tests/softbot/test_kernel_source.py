"""What a kernel is compiled from is followed wherever it stands."""

from __future__ import annotations

import sys
import types
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from softbot.kernel_source import source_digest

FIRST = "_aside_first"
SECOND = "_aside_second"
CALLED = """
from softbot.kernel_compiler import part
SHARE = 2.0
class Sizes:
    pass
@part({options})
def scaled(value):
    {comment}
    return {share} * value
"""
CALLER = """
import _aside_second
from _aside_second import scaled
def kernel(value):
    def inner(value):
        return scaled(value) + _aside_second.SHARE + {constant}
    return inner(value)
"""


@pytest.fixture
def digest() -> Iterator[Callable[..., str]]:
    def of(*, share: str = "3.0", options: str = "", comment: str = "", constant: str = "1.0", value: Any = 2.0) -> str:
        called, caller = types.ModuleType(SECOND), types.ModuleType(FIRST)
        sys.modules[SECOND], sys.modules[FIRST] = called, caller
        exec(CALLED.format(share=share, options=options, comment=comment), vars(called))
        vars(called)["SHARE"] = value
        exec(CALLER.format(constant=constant), vars(caller))
        return source_digest(vars(caller)["kernel"], frozenset({FIRST, SECOND}))

    yield of
    for name in (FIRST, SECOND):
        sys.modules.pop(name, None)


@pytest.mark.parametrize(
    "change", [{"share": "4.0"}, {"options": "fastmath=True"}, {"constant": "2.0"}, {"value": 3.0}, {"value": (2.0,)}]
)
def test_code_options_and_constants_of_what_is_called_are_part_of_it(
    digest: Callable[..., str], change: dict[str, Any]
) -> None:
    assert digest(**change) != digest()


def test_a_comment_and_another_time_are_not(digest: Callable[..., str]) -> None:
    assert digest(comment="# said otherwise") == digest() == digest()


def test_kernels_follow_their_code_into_other_packages() -> None:
    from sim import rod_kernel
    from softbot.kernel_source import reached

    found = reached(rod_kernel.play.py_func)
    for name in ("sim.rod_placement.place_rod", "sim.rod_algebra.dot", "sim.rod_groups._field", "sim.rod_views._view"):
        assert name in found
