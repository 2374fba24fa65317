"""Roll and curvature from readings alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.estimation import Estimator
from controllers.robot_model import RobotModel, pressures_for, robot_model
from softbot.actuator import ActuatorLaw
from softbot.robot import Robot, load_robot
from softbot.sensing import Readings

STEP_S = 0.01


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("default")


@pytest.fixture(scope="module")
def model(robot: Robot) -> RobotModel:
    return robot_model(robot)


@pytest.fixture(scope="module")
def law(robot: Robot) -> ActuatorLaw:
    return robot.actuator_law()


def readings(t_s, roll_rad, rate_rad_s=0.0, pressure_Pa=(0.0, 0.0, 0.0, 0.0), extra_m_s2=0.0) -> Readings:
    up = np.array([math.sin(roll_rad), math.cos(roll_rad), 0.0])
    return Readings(
        t_s=t_s,
        pressure_Pa=np.array(pressure_Pa, dtype=float),
        supply_Pa=250e3,
        gyro_rad_s=np.array([0.0, 0.0, rate_rad_s]),
        accelerometer_m_s2=(9.81 + extra_m_s2) * up,
        opening=np.zeros(4),
    )


@pytest.mark.parametrize("roll_rad", [-3.0, -1.0, 0.0, 0.5, 3.1])
def test_a_resting_robot_shows_its_roll_at_once(model, roll_rad):
    assert Estimator(model).update(readings(0.0, roll_rad)).roll_rad == pytest.approx(roll_rad, abs=1e-9)


def test_the_roll_is_unwrapped_over_many_turns(model):
    estimator, rate = Estimator(model), -7.0
    for cycle in range(1000):
        t_s = cycle * STEP_S
        estimate = estimator.update(readings(t_s, rate * t_s, rate))
    assert estimate.roll_rad == pytest.approx(rate * 9.99, abs=0.02)
    assert estimate.roll_rate_rad_s == pytest.approx(rate, rel=0.02)


def test_the_bias_of_the_gyro_is_learnt(model):
    estimator, bias = Estimator(model), 0.05
    for cycle in range(4000):
        estimate = estimator.update(readings(cycle * STEP_S, 0.3, bias))
    assert estimate.roll_rad == pytest.approx(0.3, abs=0.005)
    assert estimate.roll_rate_rad_s == pytest.approx(0.0, abs=0.005)


def test_a_clock_that_jumps_makes_no_revolutions(model):
    estimator, rate = Estimator(model), 5.0
    for cycle in range(100):
        estimator.update(readings(cycle * STEP_S, rate * cycle * STEP_S, rate))
    for cycle in range(100):
        estimate = estimator.update(readings(3600.0 + cycle * STEP_S, 6.0 + rate * cycle * STEP_S, rate))
    assert estimate.roll_rad == pytest.approx(6.0 + 99 * STEP_S * rate, abs=0.1)
    assert estimate.roll_rate_rad_s == pytest.approx(rate, rel=0.02)


def test_a_knock_on_the_accelerometer_does_not_turn_the_estimate(model):
    estimator = Estimator(model)
    estimator.update(readings(0.0, 0.0))
    for cycle in range(1, 20):  # specific force far from g, pointing elsewhere
        estimate = estimator.update(readings(cycle * STEP_S, 1.5, 0.0, extra_m_s2=20.0))
    assert abs(estimate.roll_rad) < 0.01


def test_readings_that_are_no_numbers_are_skipped(model):
    estimator = Estimator(model)
    before = estimator.update(readings(0.0, 0.4, pressure_Pa=(5e4, 0.0, 0.0, 0.0)))
    broken = readings(0.01, math.nan, math.nan, pressure_Pa=(math.nan, 0.0, 0.0, 0.0))
    after = estimator.update(broken)
    assert after.roll_rad == pytest.approx(before.roll_rad)
    np.testing.assert_array_equal(after.curvature_1_m, before.curvature_1_m)


def test_the_curvature_is_the_laws(model, law):
    pressure = (6e4, 1e4, 0.0, 0.0)
    estimate = Estimator(model).update(readings(0.0, 0.0, pressure_Pa=pressure))
    bent = law.equilibrium(pressure)
    np.testing.assert_allclose(estimate.curvature_1_m, bent.curvature_1_m, rtol=1e-6)
    assert estimate.curvature_direction_rad == pytest.approx(math.atan2(*bent.curvature_1_m[::-1]))
    assert estimate.curvature_size_1_m == pytest.approx(float(np.hypot(*bent.curvature_1_m)))
    assert estimate.stretch == pytest.approx(bent.stretch)


def test_a_blind_chamber_is_taken_as_vented(model, law):
    shown = Estimator(model).update(readings(0.0, 0.0, pressure_Pa=(6e4, 5e4, 0.0, 0.0)), dead=(1,))
    np.testing.assert_allclose(
        shown.curvature_1_m, law.equilibrium((6e4, 0.0, 0.0, 0.0)).curvature_1_m, rtol=1e-6, atol=1e-9
    )


@pytest.mark.parametrize(("roll_rad", "side"), [(0.0, -1), (math.pi, 1), (0.4, -1), (math.pi - 0.4, 1)])
def test_the_side_of_the_c_follows_from_roll_and_curvature(model, roll_rad, side):
    # chamber 0 alone bends away from itself; at roll 0 it lies to the left, so the C opens to the right
    estimate = Estimator(model).update(readings(0.0, roll_rad, pressure_Pa=(8e4, 0.0, 0.0, 0.0)))
    assert estimate.c_bend_side == side


def test_the_curvature_follows_quick_pressures_from_cycle_to_cycle(model, law):
    estimator = Estimator(model)
    for cycle in range(200):
        turning = 0.2 * cycle - np.arange(4) * math.pi / 2
        pressure = 9e4 * np.maximum(np.cos(turning), 0.0)
        estimate = estimator.update(readings(cycle * STEP_S, 0.0, pressure_Pa=pressure))
        np.testing.assert_allclose(
            estimate.curvature_1_m, law.equilibrium(pressure).curvature_1_m, rtol=1e-5, atol=1e-5
        )


def test_a_pressure_that_no_section_carries_leaves_what_was_believed(model):
    estimator = Estimator(model)
    before = estimator.update(readings(0.0, 0.0, pressure_Pa=(6e4, 0.0, 0.0, 0.0)))
    after = estimator.update(readings(0.01, 0.0, pressure_Pa=(1e12, 0.0, 0.0, 0.0)))
    np.testing.assert_allclose(after.curvature_1_m, before.curvature_1_m)


@given(st.floats(-10.0, 10.0), st.floats(0.0, 1.0))
def test_the_table_of_pressures_is_the_inverse_of_the_law(model, law, direction_rad, share):
    size = share * model.curvature_1_m
    pressure = np.empty(4)
    pressures_for(model, direction_rad, size, pressure)
    assert pressure.min() >= 0.0
    assert pressure.max() <= model.pressure_limit_Pa
    wanted = size * np.array([math.cos(direction_rad), math.sin(direction_rad)])
    exact = law.pressures(wanted, limit_Pa=model.pressure_limit_Pa).pressure_Pa
    np.testing.assert_allclose(pressure, exact, atol=0.004 * model.pressure_limit_Pa)
