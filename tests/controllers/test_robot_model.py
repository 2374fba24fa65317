"""What the controller asks of a robot where nobody says how far it is to bend."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.robot_model import USE_OF_LIMIT, pressure_lag_s, robot_model
from softbot.robot import load_robot, robot_from

SOFT = {
    "length_m": 0.3,
    "radius_m": 0.012,
    "mass_kg": 0.15,
    "actuator": {
        "modulus_Pa": 25e3,
        "chamber_area_m2": 5.4e-5,
        "chamber_centroid_radius_m": 6.6e-3,
        "max_pressure_Pa": 60e3,
    },
}


def test_a_soft_robot_bends_to_half_a_circle_and_no_further() -> None:
    soft = robot_from(SOFT, "soft.toml")
    alone = soft.actuator_law().equilibrium(np.array([USE_OF_LIMIT * 60e3, 0.0, 0.0, 0.0]))
    assert np.hypot(*alone.curvature_1_m) * soft.length_m > 2.0 * math.pi  # by its pressure it would be a ring
    model = robot_model(soft)
    assert model.curvature_1_m * soft.length_m == pytest.approx(math.pi)
    assert 0.0 < model.advance_m_rad < soft.radius_m
    assert robot_model(soft, bend_rad=4.0).curvature_1_m == pytest.approx(4.0 / soft.length_m)


def test_any_other_bends_as_far_as_its_weakest_chamber_takes_it() -> None:
    own = load_robot("default")
    pressures = USE_OF_LIMIT * own.max_pressure_Pa * np.eye(4)
    weakest = min(float(np.hypot(*own.actuator_law().equilibrium(one).curvature_1_m)) for one in pressures)
    assert robot_model(own).curvature_1_m == pytest.approx(weakest, rel=1e-12)
    assert weakest * own.length_m < math.pi


def test_a_setpoint_that_moves_slower_than_open_valves_sets_the_lag() -> None:
    own = load_robot("default")
    working_Pa = USE_OF_LIMIT * own.max_pressure_Pa
    valves_s = pressure_lag_s(own, working_Pa)
    assert pressure_lag_s(own, working_Pa, 600e3) == valves_s
    slow_s = pressure_lag_s(own, working_Pa, 50e3)
    assert slow_s == pytest.approx((1.0 - math.exp(-1.0)) * working_Pa / 50e3 + own.pneumatics.valve_lag_s)
    assert robot_model(own, setpoint_rate_Pa_s=50e3).lag_s == slow_s > 3.0 * valves_s
