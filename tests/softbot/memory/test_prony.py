"""Creep of a Prony series against closed forms, and its steps: exact for linear runs, stable for any length."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softbot.errors import InputError
from softbot.memory.prony import PronySeries, creep_inverse, creep_step

TWO = PronySeries((0.2, 0.15), (0.5, 20.0))
times = st.floats(1e-3, 1e3)


@st.composite
def prony_series(draw: st.DrawFn) -> PronySeries:
    terms = draw(st.integers(1, 5))
    shares = tuple(draw(st.floats(0.0, 0.9 / terms)) for _ in range(terms))
    return PronySeries(shares, tuple(draw(times) for _ in range(terms)))


def felt_after(series: PronySeries, steps: list[tuple[float, float]]) -> float:
    """y after steps of (pressure at the end, length), from rest at zero."""
    instant, share, time_s = series.creep()
    state, felt = np.zeros(1 + share.size), 0.0
    for pressure, dt in steps:
        felt = creep_step(instant, share, time_s, state, pressure, dt)
    return felt


def test_one_term_creeps_as_the_standard_linear_solid() -> None:
    """G∞ + G₁ e^{−t/τ} in relaxation creeps with θ = τ/(1 − g) from 1 − g to 1."""
    instant, share, time_s = PronySeries((0.3,), (2.0,)).creep()
    assert instant == pytest.approx(0.7)
    np.testing.assert_allclose(share, [0.3], rtol=1e-12)
    np.testing.assert_allclose(time_s, [2.0 / 0.7], rtol=1e-12)


@given(series=prony_series())
def test_creep_begins_at_the_instantaneous_compliance_and_ends_at_one(series: PronySeries) -> None:
    instant, share, time_s = series.creep()
    assert instant * series.instantaneous_ratio == pytest.approx(1.0, rel=1e-12)
    assert instant + share.sum() == pytest.approx(1.0, rel=1e-9)
    assert np.all(share >= 0.0)
    assert np.all(np.sort(time_s) >= np.sort(series.times_s) * (1.0 - 1e-9))


@given(series=prony_series(), rate=st.floats(0.01, 100.0))
def test_creep_and_relaxation_are_each_others_inverse(series: PronySeries, rate: float) -> None:
    """In Laplace's plane s J(s) · s G(s) = 1, at any s > 0."""
    instant, share, time_s = series.creep()
    compliance = instant + np.sum(share / (1.0 + rate * time_s))
    excess = np.array(series.shares) * series.instantaneous_ratio
    x = rate * np.array(series.times_s)
    assert compliance * (1.0 + np.sum(excess * x / (1.0 + x))) == pytest.approx(1.0, rel=1e-9)


def test_relaxation_of_a_held_strain_is_the_series() -> None:
    """The pressure that keeps y = 1 from t = 0 on, step by step, against Σ γ_k e^{−t/τ_k}."""
    instant, share, time_s = TWO.creep()
    state = np.zeros(3)
    pressure = [creep_inverse(instant, share, time_s, state, 1.0, 0.0)]
    creep_step(instant, share, time_s, state, pressure[0], 0.0)
    dt = 0.002
    for _ in range(5000):
        pressure.append(creep_inverse(instant, share, time_s, state, 1.0, dt))
        assert creep_step(instant, share, time_s, state, pressure[-1], dt) == pytest.approx(1.0, rel=1e-12)
    np.testing.assert_allclose(pressure, TWO.relaxation(dt * np.arange(5001)), rtol=2e-6)
    assert pressure[0] == pytest.approx(TWO.instantaneous_ratio)


@given(series=prony_series(), cuts=st.lists(st.floats(0.0, 1.0), max_size=6), dt=st.floats(1e-4, 1e4))
def test_a_linear_run_may_be_cut_into_any_steps(series: PronySeries, cuts: list[float], dt: float) -> None:
    ends = [*sorted(cuts), 1.0]
    steps = [(end, dt * (end - before)) for before, end in zip([0.0, *ends[:-1]], ends, strict=True)]
    assert felt_after(series, steps) == pytest.approx(felt_after(series, [(1.0, dt)]), rel=1e-8, abs=1e-10)


@given(
    series=prony_series(),
    steps=st.lists(st.tuples(st.floats(-1.0, 2.0), st.floats(0.0, 1e9)), min_size=1, max_size=30),
)
def test_no_step_however_long_leaves_the_span_of_the_pressures(
    series: PronySeries, steps: list[tuple[float, float]]
) -> None:
    reached = [0.0, *(pressure for pressure, _ in steps)]
    for count in range(1, len(steps) + 1):
        assert min(reached) - 1e-9 <= felt_after(series, steps[:count]) <= max(reached) + 1e-9


@given(series=prony_series())
def test_pressure_held_for_ever_is_felt_as_it_is(series: PronySeries) -> None:
    assert felt_after(series, [(3.0, 1.0), (3.0, 1e9)]) == pytest.approx(3.0, rel=1e-9)


def test_unit_step_creeps_as_the_retardation_spectrum_says() -> None:
    _, share, time_s = TWO.creep()
    for t in (0.1, 1.0, 30.0):
        expected = 1.0 - sum(c * math.exp(-t / theta) for c, theta in zip(share, time_s, strict=True))
        assert felt_after(TWO, [(1.0, 0.0), (1.0, t)]) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("shares", "times_s", "says"),
    [
        ((), (), "0 and 0 numbers: give 1 to 8"),
        ((0.1, 0.2), (1.0,), "2 and 1 numbers"),
        ((-0.1,), (1.0,), "shares = .*from 0, together at most 0.95"),
        ((0.5, 0.5), (1.0, 2.0), "together at most 0.95"),
        ((0.1,), (0.0,), "times_s = .*0.0001 to 1e.07 s"),
        ((math.nan,), (1.0,), "shares"),
        ((0.1,), (math.nan,), "times_s"),
    ],
)
def test_what_is_no_series_is_refused(shares: tuple[float, ...], times_s: tuple[float, ...], says: str) -> None:
    with pytest.raises(InputError, match=says):
        PronySeries(shares, times_s)
