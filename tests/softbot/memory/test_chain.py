"""The parts joined: each alone does what it says, a pressure held for ever stays, all but the line are undone."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softbot.errors import InputError
from softbot.memory import chain, hysteresis, line, prony, residual
from softbot.memory.chain import Memory, MemoryParts
from softbot.memory.hysteresis import Hysteresis
from softbot.memory.line import Line
from softbot.memory.prony import PronySeries
from softbot.memory.residual import Residual

VOLUME_m3 = (4e-5, 4e-5, 5e-5, 4e-5)
LINE = Line(2e-10, 1e-10, 3e-6)
PLAYS = Hysteresis((5e3, 10e3, 20e3), (0.1, 0.1, 0.1), 1.3, 0.2)
CREEP = PronySeries((0.1, 0.1), (0.5, 20.0))
RESIDUAL = Residual(0.1, 20.0, 60.0)
COMBINATIONS = [
    MemoryParts(*(part if on else None for part, on in zip((LINE, PLAYS, CREEP, RESIDUAL), chosen, strict=True)))
    for chosen in itertools.product((False, True), repeat=4)
]
undone = st.sampled_from([parts for parts in COMBINATIONS if parts.line is None])
four = st.tuples(*[st.floats(0.0, 1e5)] * 4)
steps = st.lists(st.tuples(four, st.floats(0.0, 100.0)), min_size=1, max_size=10)


def memory(parts: MemoryParts) -> Memory:
    return Memory(parts, VOLUME_m3)


def after(of: Memory, done: list[tuple[tuple[float, ...], float]]) -> np.ndarray:
    state = of.rest()
    for pressure, dt in done:
        state, _ = of.step(state, pressure, dt)
    return state


@given(parts=undone, done=steps, wanted=four, dt=st.floats(0.0, 1e3))
def test_inverse_then_step_has_the_wanted_effect(
    parts: MemoryParts, done: list[tuple[tuple[float, ...], float]], wanted: tuple[float, ...], dt: float
) -> None:
    of = memory(parts)
    state = after(of, done)
    kept = state.copy()
    pressure = of.inverse(state, wanted, dt)
    np.testing.assert_array_equal(state, kept)
    np.testing.assert_allclose(of.step(state, pressure, dt)[1], wanted, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("parts", COMBINATIONS)
def test_pressure_once_reached_and_held_for_ever_is_felt_up_to_the_hysteresis(parts: MemoryParts) -> None:
    of, held = memory(parts), np.array([0.0, 2e4, 5e4, 9e4])
    state, felt = of.step(of.rest(), held, 1e9)
    state, felt = of.step(state, held, 1e9)
    swallowed = 0.0
    if parts.hysteresis is not None:
        swallowed = sum(0.1 * np.minimum(held, r) for r in PLAYS.thresholds_Pa)
    np.testing.assert_allclose(felt, held - swallowed, rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(of.step(of.rest(held), held, 1.0)[1], felt, rtol=1e-6, atol=1e-3)


def test_memory_without_parts_feels_the_pressure_itself() -> None:
    of = Memory(MemoryParts())
    assert not of.parts.on
    felt = of.step(of.rest(), [1.0, -2.0, 3.0, 4.0], 0.1)[1]
    np.testing.assert_array_equal(felt, [1.0, -2.0, 3.0, 4.0])


@given(parts=st.sampled_from(COMBINATIONS), done=steps)
def test_run_is_step_after_step(parts: MemoryParts, done: list[tuple[tuple[float, ...], float]]) -> None:
    of = memory(parts)
    pressure = np.array([row for row, _ in done])
    t = np.cumsum([dt for _, dt in done])
    found = of.run(t, pressure)
    state = of.rest(pressure[0])
    for n, dt in enumerate(np.diff(t, prepend=t[0])):
        state, felt = of.step(state, pressure[n], dt)
        np.testing.assert_allclose(found[n], felt, rtol=1e-12, atol=1e-9)


@given(parts=st.sampled_from(COMBINATIONS), done=steps)
def test_chambers_do_not_know_of_each_other(parts: MemoryParts, done: list[tuple[tuple[float, ...], float]]) -> None:
    of = memory(parts)
    alone = after(of, [((row[0], 0.0, 0.0, 0.0), dt) for row, dt in done])
    np.testing.assert_array_equal(alone[0], after(of, done)[0])


@given(parts=st.sampled_from(COMBINATIONS), done=steps)
def test_felt_pressures_stay_within_what_there_was(
    parts: MemoryParts, done: list[tuple[tuple[float, ...], float]]
) -> None:
    """With loops that close at zero; the plays' own unloading share leaves up to Σ w r at zero pressure."""
    of = memory(parts)
    state, most = of.rest(), 0.0
    for row, dt in done:
        state, felt = of.step(state, row, dt)
        most = max(most, *row)
        assert np.all(felt >= -1e-6)
        assert np.all(felt <= most * (1.0 + 1e-9) + 0.1 * 0.2 * 35e3)


def test_chamber_loaded_again_and_again_lags_differently_up_and_down() -> None:
    of = memory(MemoryParts(LINE, PLAYS, CREEP, RESIDUAL))
    t = np.arange(0.0, 40.0, 0.01)
    pressure = np.zeros((t.size, 4))
    pressure[:, 1] = 1e5 * np.where(t < 20.0, np.minimum(t, 1.0), np.clip(21.0 - t, 0.0, 1.0))
    felt = of.run(t, pressure)[:, 1]
    up, down = np.searchsorted(t, [0.5, 20.5])
    assert felt[up] < 0.5 * pressure[up, 1] < 1.2 * pressure[down, 1] < felt[down]
    assert 0.05 * felt.max() < felt[-1] < 0.2 * felt.max()  # what remains after 19 s without pressure


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda of: of.step(of.rest(), [1.0, 2.0], 0.1), "give 4 finite numbers"),
        (lambda of: of.step(of.rest(), [0.0, 0.0, float("nan"), 0.0], 0.1), "give 4 finite numbers"),
        (lambda of: of.step(of.rest(), [0.0] * 4, -0.1), "dt_s = -0.1"),
        (lambda of: of.inverse(of.rest(), [0.0] * 4, float("nan")), "dt_s = nan"),
        (lambda of: of.run([0.0, 1.0], [[0.0] * 4]), "give shapes"),
        (lambda of: of.run([1.0, 0.0], [[0.0] * 4] * 2), "falls at row 1; sort"),
        (lambda of: of.run([0.0], [[float("nan")] * 4]), "finite numbers only"),
        (lambda of: of.run([], np.zeros((0, 4))), "give shapes"),
        (lambda of: Memory(MemoryParts(line=LINE)), "a line needs 4 chamber volumes"),
        (lambda of: Memory(MemoryParts(line=LINE), [1e-5, 0.0, 1e-5, 1e-5]), "above zero"),
    ],
)
def test_wrong_calls_are_refused(call: Callable[[Memory], object], says: str) -> None:
    with pytest.raises(InputError, match=says):
        call(memory(COMBINATIONS[-1]))


def test_interpreted_and_compiled_kernels_agree(interpreted: Callable[..., None]) -> None:
    t = np.linspace(0.0, 3.0, 7)
    pressure = np.random.default_rng(1).uniform(0.0, 1e5, (7, 4))

    def everything() -> list[np.ndarray]:
        of = memory(COMBINATIONS[-1])
        state = of.rest(pressure[0])
        return [of.run(t, pressure), of.inverse(state, pressure[3], 0.5), of.step(state, pressure[2], 0.1)[0]]

    compiled = everything()
    interpreted(prony, hysteresis, residual, line, chain)
    for one, other in zip(compiled, everything(), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)
