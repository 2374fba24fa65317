"""The generalised Prandtl–Ishlinskii operator: what makes it one, its loops, and its inverse."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softbot.errors import InputError
from softbot.memory.hysteresis import Hysteresis, hysteresis_inverse, hysteresis_step

CLASSICAL = Hysteresis((1.0, 3.0, 6.0), (0.1, 0.2, 0.15))
CLOSING = Hysteresis((1.0, 3.0, 6.0), (0.1, 0.2, 0.15), unloading_slope=1.4, unloading_share=0.0)
inputs = st.lists(st.floats(-20.0, 20.0), min_size=1, max_size=20)


@st.composite
def operators(draw: st.DrawFn) -> Hysteresis:
    plays = draw(st.integers(1, 6))
    gaps = [draw(st.floats(0.1, 5.0)) for _ in range(plays)]
    weights = tuple(draw(st.floats(0.0, 0.9 / plays)) for _ in range(plays))
    slope, share = draw(st.floats(1.0, 4.0)), draw(st.floats(0.0, 1.0))
    return Hysteresis(tuple(itertools.accumulate(gaps)), weights, slope, share)


class Stream:
    """The operator with its state."""

    def __init__(self, operator: Hysteresis) -> None:
        self.numbers = (
            np.array(operator.thresholds_Pa),
            np.array(operator.weights),
            operator.unloading_slope,
            operator.unloading_share,
        )
        self.play = np.zeros(len(operator.weights))

    def to(self, *values: float) -> float:
        felt = math.nan
        for value in values:
            felt = hysteresis_step(*self.numbers, self.play, value)
        return felt

    def back(self, felt: float) -> float:
        return hysteresis_inverse(*self.numbers, self.play, felt)


@given(operator=operators(), values=inputs, cuts=st.lists(st.floats(0.0, 1.0), max_size=4))
def test_result_depends_on_the_turning_points_alone(
    operator: Hysteresis, values: list[float], cuts: list[float]
) -> None:
    coarse, fine = Stream(operator), Stream(operator)
    before = 0.0
    for value in values:
        between = sorted(before + cut * (value - before) for cut in cuts)
        fine.to(*(between if value >= before else between[::-1]))
        assert fine.to(value) == pytest.approx(coarse.to(value), abs=1e-9)
        before = value


@given(operator=operators(), values=inputs, ends=st.tuples(st.floats(-20.0, 20.0), st.floats(0.0, 1.0)))
def test_closed_minor_loop_leaves_no_trace(
    operator: Hysteresis, values: list[float], ends: tuple[float, float]
) -> None:
    stream = Stream(operator)
    stream.to(*values)
    turned, back = ends[0], values[-1] + ends[1] * (ends[0] - values[-1])
    before = stream.to(turned)
    stream.to(back)  # on the way back to what came before, but not past it
    assert stream.to(turned) == pytest.approx(before, abs=1e-9)


@given(operator=operators(), values=inputs, wanted=st.floats(-30.0, 30.0))
def test_inverse_is_exact_from_any_state(operator: Hysteresis, values: list[float], wanted: float) -> None:
    stream = Stream(operator)
    stream.to(*values)
    plays = stream.play.copy()
    found = stream.back(wanted)
    np.testing.assert_array_equal(stream.play, plays)
    assert stream.to(found) == pytest.approx(wanted, abs=1e-11)


@given(operator=operators(), values=inputs)
def test_inverse_of_the_operator_gives_its_input_back(operator: Hysteresis, values: list[float]) -> None:
    stream = Stream(operator)
    for value in values:
        ahead = Stream(operator)
        ahead.play = stream.play.copy()
        felt = ahead.to(value)
        assert stream.back(felt) == pytest.approx(value, abs=1e-9)
        stream.to(value)


def test_inverse_of_the_classical_operator_is_the_known_closed_form() -> None:
    """Krejčí and Kuhnen: an operator of plays again, of thresholds r' and weights w' that follow from r and w."""
    r = np.array([0.0, *CLASSICAL.thresholds_Pa])
    w = np.array([1.0 - sum(CLASSICAL.weights), *CLASSICAL.weights])
    total = np.cumsum(w)
    thresholds = np.array([np.sum(w[: i + 1] * (r[i] - r[: i + 1])) for i in range(r.size)])
    weights = np.array([1.0 / w[0], *(-w[1:] / (total[1:] * total[:-1]))])
    play = np.zeros(r.size)
    stream = Stream(CLASSICAL)
    for felt in (2.0, 9.0, 4.0, -3.0, 1.0, 0.0, 12.0, -15.0, 3.0):
        play = np.maximum(felt - thresholds, np.minimum(felt + thresholds, play))
        found = stream.back(felt)
        assert found == pytest.approx(float(weights @ play), rel=1e-12, abs=1e-12)
        stream.to(found)


@given(operator=operators(), values=inputs, pair=st.tuples(st.floats(-20.0, 20.0), st.floats(1e-3, 10.0)))
def test_felt_pressure_rises_strictly_with_the_pressure(
    operator: Hysteresis, values: list[float], pair: tuple[float, float]
) -> None:
    low, high = Stream(operator), Stream(operator)
    low.to(*values)
    high.to(*values)
    least = 1.0 - sum(operator.weights)
    assert high.to(pair[0] + pair[1]) - low.to(pair[0]) >= least * pair[1] * (1.0 - 1e-9) - 1e-12


def test_loading_is_the_pressure_less_what_each_play_swallows_first() -> None:
    for operator in (CLASSICAL, CLOSING):
        for pressure in (0.5, 2.0, 5.0, 40.0):
            swallowed = sum(w * min(pressure, r) for r, w in zip(operator.thresholds_Pa, operator.weights, strict=True))
            assert Stream(operator).to(pressure) == pytest.approx(pressure - swallowed)


def test_unloading_lags_and_closes_at_zero_only_where_it_is_said_to() -> None:
    for operator, left in ((CLASSICAL, sum(w * r for w, r in zip((0.1, 0.2, 0.15), (1, 3, 6), strict=True))),
                           (CLOSING, 0.0)):  # fmt: skip
        stream = Stream(operator)
        loading = {pressure: stream.to(pressure) for pressure in np.linspace(0.0, 20.0, 41)}
        gap = [stream.to(pressure) - loading[pressure] for pressure in sorted(loading, reverse=True)]
        assert max(gap) > 0.5
        assert min(gap) >= 0.0
        assert gap[-1] == pytest.approx(left, abs=1e-12)


def test_classical_loop_is_symmetric_and_the_other_is_not() -> None:
    def settled(operator: Hysteresis) -> float:
        stream = Stream(operator)
        stream.to(10.0, -10.0)
        up = np.array([stream.to(v) for v in np.linspace(-10.0, 10.0, 41)])
        down = np.array([stream.to(v) for v in np.linspace(10.0, -10.0, 41)])
        return float(np.abs(up + down).max())

    assert settled(CLASSICAL) == pytest.approx(0.0, abs=1e-12)
    assert settled(CLOSING) > 0.5


@pytest.mark.parametrize(
    ("values", "says"),
    [
        (((), ()), "0 and 0 numbers"),
        (((1.0,), (0.1, 0.1)), "1 and 2 numbers"),
        (((2.0, 1.0), (0.1, 0.1)), "rising numbers above 0"),
        (((0.0,), (0.1,)), "rising numbers above 0"),
        (((1.0, 2.0), (0.5, 0.5)), "together at most 0.95"),
        (((1.0,), (-0.1,)), "weights"),
        (((1.0,), (0.1,), 0.5), "unloading_slope = 0.5: give 1 to 10"),
        (((1.0,), (0.1,), 1.0, 2.0), "unloading_share = 2.0: give 0 to 1"),
        (((math.nan,), (0.1,)), "thresholds_Pa"),
    ],
)
def test_what_is_no_operator_is_refused(values: tuple, says: str) -> None:
    with pytest.raises(InputError, match=says):
        Hysteresis(*values)
