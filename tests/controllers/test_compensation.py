"""Feed-forward compensation: what is commanded has the wanted effect, through every memory and with dead chambers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.compensation import Compensator, compensate
from controllers.estimation import Estimator
from controllers.robot_model import pressures_for, robot_model
from softbot.actuator import ActuatorLaw
from softbot.cross_section import CHAMBER_ANGLES_RAD, default_cross_section
from softbot.errors import InputError
from softbot.memory.chain import Memory, MemoryParts
from softbot.memory.hysteresis import Hysteresis
from softbot.memory.line import Line
from softbot.memory.prony import PronySeries
from softbot.memory.residual import Residual
from softbot.robot import robot_from
from softbot.sensing import Readings

LAW = ActuatorLaw(default_cross_section(0.01), "neo-hookean", 3e4)
LIMIT_Pa, STEP_S = 60e3, 0.02
PLAYS = Hysteresis((2e3, 8e3, 20e3), (0.15, 0.15, 0.1), 1.3, 0.3)
CREEP = PronySeries((0.1, 0.1), (0.5, 20.0))
RESIDUAL = Residual(0.08, 5.0, 30.0)
ALL = MemoryParts(None, PLAYS, CREEP, RESIDUAL)
PARTS = [MemoryParts(hysteresis=PLAYS), MemoryParts(creep=CREEP), MemoryParts(residual=RESIDUAL), ALL]
moves = st.lists(
    st.tuples(st.floats(-math.pi, math.pi), st.floats(0.0, 3.0), st.floats(0.0, 30.0)), min_size=1, max_size=12
)


def vector(direction: float, size: float) -> np.ndarray:
    return size * np.array([math.cos(direction), math.sin(direction)])


class Chambers:
    """The true chambers behind perfect valves: what is commanded is there at the end of the period."""

    def __init__(self, parts: MemoryParts) -> None:
        self.memory = Memory(parts, [4e-5] * 4)
        self.state = self.memory.rest()

    def bend(self, pressure_Pa: np.ndarray, dt_s: float) -> np.ndarray:
        self.state, felt = self.memory.step(self.state, pressure_Pa, dt_s)
        return LAW.equilibrium(felt).curvature_1_m


@settings(max_examples=60)
@given(parts=st.sampled_from(PARTS), done=moves)
def test_wanted_bend_is_there_at_the_end_of_the_period(
    parts: MemoryParts, done: list[tuple[float, float, float]]
) -> None:
    truth, controller = Chambers(parts), Compensator(LAW, Memory(parts))
    for direction, size, dt in done:
        found = controller.pressures(vector(direction, size), dt_s=dt, limit_Pa=LIMIT_Pa)
        assert np.all((found.pressure_Pa >= 0.0) & (found.pressure_Pa <= LIMIT_Pa))
        given_now = truth.bend(found.pressure_Pa, dt)
        np.testing.assert_allclose(given_now, found.curvature_1_m, atol=1e-6)
        if found.reached:
            assert np.hypot(*(given_now - vector(direction, size))) <= 0.01 * size + 1e-4
        controller.observe(found.pressure_Pa, dt)


@settings(max_examples=40)
@given(done=moves, dead=st.integers(0, 3))
def test_dead_chamber_is_left_alone_and_its_half_plane_is_kept(
    done: list[tuple[float, float, float]], dead: int
) -> None:
    truth, controller = Chambers(ALL), Compensator(LAW, Memory(ALL))
    available = [chamber != dead for chamber in range(4)]
    for off, size, dt in done:
        direction = CHAMBER_ANGLES_RAD[dead] + 0.45 * off  # well inside what is left: ± 81°
        found = controller.pressures(vector(direction, size), dt_s=dt, limit_Pa=LIMIT_Pa, available=available)
        assert found.pressure_Pa[dead] == 0.0
        given_now = truth.bend(found.pressure_Pa, dt)
        np.testing.assert_allclose(given_now, found.curvature_1_m, atol=1e-6)
        controller.observe(found.pressure_Pa, dt)


def test_what_a_vented_chamber_still_feels_is_made_up_for_by_the_others() -> None:
    truth, controller = Chambers(ALL), Compensator(LAW, Memory(ALL))
    bent = np.array([50e3, 0.0, 0.0, 0.0])
    for _ in range(100):
        truth.bend(bent, 0.1)
        controller.observe(bent, 0.1)
    straight = controller.pressures([0.0, 0.0], dt_s=STEP_S, limit_Pa=LIMIT_Pa)
    assert straight.pressure_Pa[0] == 0.0
    assert straight.pressure_Pa[2] > 1e3
    assert np.hypot(*truth.bend(straight.pressure_Pa, STEP_S)) < 1e-6


def test_stretch_is_had_through_the_memory_too() -> None:
    truth, controller = Chambers(ALL), Compensator(LAW, Memory(ALL))
    found = controller.pressures([2.0, 1.0], dt_s=STEP_S, limit_Pa=LIMIT_Pa, stretch=1.08)
    assert found.reached
    assert found.stretch_reached
    truth.state, felt = truth.memory.step(truth.state, found.pressure_Pa, STEP_S)
    assert LAW.equilibrium(felt).stretch == pytest.approx(1.08, abs=1e-6)


def test_compensation_leaves_a_third_of_the_error_even_with_parameters_that_are_off() -> None:
    """A slow tour of the workspace; the controller believes in weights and thresholds a tenth too small."""
    small = (tuple(0.9 * r for r in PLAYS.thresholds_Pa), tuple(0.9 * w for w in PLAYS.weights))
    believed = Hysteresis(*small, unloading_slope=1.27, unloading_share=0.27)
    random = np.random.default_rng(2)
    targets = [vector(*one) for one in random.uniform((-3.0, 0.5), (3.0, 4.0), (200, 2))]
    error = {}
    for name, memory in (("without", None), ("off", Memory(MemoryParts(hysteresis=believed))),
                         ("with", Memory(MemoryParts(hysteresis=PLAYS)))):  # fmt: skip
        truth, controller = Chambers(MemoryParts(hysteresis=PLAYS)), Compensator(LAW, memory)
        missed = []
        for target in targets:
            pressure = controller.pressures(target, dt_s=1.0, limit_Pa=LIMIT_Pa).pressure_Pa
            missed.append(truth.bend(pressure, 1.0) - target)
            controller.observe(pressure, 1.0)
        error[name] = float(np.sqrt(np.mean(np.square(missed))))
    assert error["off"] < error["without"] / 3.0
    assert error["with"] < 1e-2 * error["without"]


def test_without_memory_it_is_the_laws_inverse() -> None:
    plain = Compensator(LAW)
    np.testing.assert_array_equal(plain.observe([1.0, 2.0, 3.0, 4.0], 0.1), [1.0, 2.0, 3.0, 4.0])
    found = plain.pressures([3.0, 1.0], dt_s=0.1, limit_Pa=LIMIT_Pa, co_contraction_Pa=2e3)
    expected = LAW.pressures([3.0, 1.0], limit_Pa=LIMIT_Pa, co_contraction_Pa=2e3)
    np.testing.assert_array_equal(found.pressure_Pa, expected.pressure_Pa)


def test_line_is_followed_but_not_undone() -> None:
    parts = MemoryParts(line=Line(2e-10, 2e-10), hysteresis=PLAYS)
    controller = Compensator(LAW, Memory(parts, [4e-5] * 4))
    felt = controller.observe([30e3, 0.0, 0.0, 0.0], 0.05)
    assert 0.0 < felt[0] < 25e3  # the chamber is not there yet
    found = controller.pressures([-3.0, 0.0], dt_s=0.05, limit_Pa=LIMIT_Pa)
    assert found.reached
    assert found.pressure_Pa.max() < LIMIT_Pa


def test_wrong_questions_are_refused() -> None:
    controller = Compensator(LAW, Memory(ALL))
    with pytest.raises(InputError, match="co_contraction_Pa"):
        controller.pressures([1.0, 0.0], dt_s=0.1, limit_Pa=LIMIT_Pa, co_contraction_Pa=2 * LIMIT_Pa)
    with pytest.raises(InputError, match="4 finite numbers"):
        controller.observe([math.nan] * 4, 0.1)


# --- in the sequencer's own compiled cycle ------------------------------------------------------------


def test_sequencers_compensator_has_the_wanted_effect_through_every_memory() -> None:
    """A slow turn of the curvature: the pressures that it commands against the law's own, on chambers that remember."""
    table = {"length_m": 0.15, "radius_m": 0.01, "mass_kg": 0.05, "bending_stiffness_N_m2": 3.93e-3}
    parts = {
        "hysteresis": {"thresholds_Pa": [2e3, 8e3], "weights": [0.2, 0.2], "unloading_slope": 1.3},
        "creep": {"shares": [0.1], "times_s": [1.0]},
        "residual": {"share": 0.05, "growth_time_s": 5.0, "recovery_time_s": 30.0},
    }
    robot = robot_from({**table, "memory": parts}, "r.toml")
    model, law, memory = robot_model(robot), robot.actuator_law(), robot.actuator_memory()
    assert memory is not None
    state, estimator = memory.rest(), Estimator(model)
    wanted, setpoint = np.empty(4), np.empty(4)
    with_it, without = [], []
    plain = memory.rest()
    for n, direction in enumerate(np.linspace(0.0, 12.0, 240)):
        target = vector(direction, 0.8 * model.curvature_1_m)
        pressures_for(model, direction, 0.8 * model.curvature_1_m, wanted)
        setpoint[:] = wanted
        compensate(model, estimator.memory[0], np.ones(4), setpoint)
        assert np.all((setpoint >= 0.0) & (setpoint <= model.pressure_limit_Pa))
        state, felt = memory.step(state, setpoint, 0.05)
        plain, felt_plain = memory.step(plain, wanted, 0.05)
        with_it.append(np.hypot(*(law.equilibrium(felt).curvature_1_m - target)))
        without.append(np.hypot(*(law.equilibrium(felt_plain).curvature_1_m - target)))
        told = Readings(0.05 * (n + 1), setpoint.copy(), 2e5, np.zeros(3), np.array([0.0, 9.81, 0.0]), np.zeros(4))
        estimate = estimator.update(told)
        np.testing.assert_allclose(estimate.curvature_1_m, law.equilibrium(felt).curvature_1_m, atol=2e-2)
    assert np.mean(with_it[5:]) < np.mean(without[5:]) / 3.0


def test_sequencer_of_a_robot_without_memory_has_none_to_follow() -> None:
    table = {"length_m": 0.15, "radius_m": 0.01, "mass_kg": 0.05, "bending_stiffness_N_m2": 3.93e-3}
    assert robot_model(robot_from(table, "r.toml")).memory.size == 0
