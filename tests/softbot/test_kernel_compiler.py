"""The compiler of kernels: what it leaves out changes no result."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softbot.kernel_compiler import kernel, part


@part()
def _clipped(value: float, most: float) -> float:
    return min(max(value, -most), most)


@part()
def _counted(values: Any, step: int) -> int:
    total = 0
    for k in range(0, values.shape[0], step):
        total += 1 if values[k] > 0.0 else -1
    return total


def _sum(values: Any, most: float) -> tuple[float, float, int, bool]:
    total, product, whole = 0.0, 1.0, 3
    for k in range(values.shape[0]):
        total += _clipped(values[k], most)
        product *= math.cos(values[k]) + 0.5 * k  # floats, and a whole number times a float
        whole = whole * 3 % 1000
    first = values.shape[0]
    head = values[:2]
    head[:] = total
    return total, product, whole + first + _counted(values, 1) + _counted(values, 2), total > most


_compiled = kernel(cache=False)(_sum)


@settings(max_examples=30)
@given(st.lists(st.floats(-10.0, 10.0), min_size=2, max_size=12), st.floats(0.0, 5.0))
def test_a_kernel_computes_what_python_does(values: list[float], most: float) -> None:
    once, again = np.array(values), np.array(values)
    globals_now = {**_sum.__globals__, "_clipped": _clipped.py_func, "_counted": _counted.py_func}
    interpreted = type(_sum)(_sum.__code__, globals_now)
    found, expected = _compiled(once, most), interpreted(again, most)
    assert found[2:] == expected[2:]
    np.testing.assert_allclose(found[:2], expected[:2], rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(once, again)


def test_constants_make_no_further_versions_of_a_part() -> None:
    _compiled(np.ones(3), 1.0)
    assert len(_counted.overloads) == 1


def test_a_part_that_python_calls_runs_as_python() -> None:
    assert _clipped(3.0, 1.0) == 1.0
    with pytest.raises(TypeError):
        _clipped("b", 1.0)


def test_a_kernel_called_with_other_types_is_another_version() -> None:
    @kernel(cache=False)
    def twice(value: Any) -> Any:
        return value + value

    assert twice(2) == 4
    assert twice(0.25) == 0.5
    np.testing.assert_array_equal(twice(np.array([1.0, 2.0])), [2.0, 4.0])


def test_what_is_compiled_on_the_way_has_the_options_of_who_asks_for_it() -> None:
    def power(value: float, exponent: int) -> float:
        return float(value**exponent)

    exact, fast = kernel(cache=False)(power), kernel(cache=False, fastmath={"reassoc"})(power)
    assert exact(1.5, 3) == fast(1.5, 3) == 3.375
    ((_, of_exact),), ((_, of_fast),) = exact.inspect_llvm().items(), fast.inspect_llvm().items()
    assert "fmul double" in of_exact
    assert "fmul reassoc double" in of_fast
    assert "fmul double" not in of_fast
