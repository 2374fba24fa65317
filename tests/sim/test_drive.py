"""Open-loop drives: straight, bent by start_s, then turning; pressures that bend where the curvature would."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.drive import (
    active_side_rad,
    amplitude,
    bend_1_m,
    curvature_1_m,
    lost_shares,
    phase_rad,
    pressures_Pa,
    without_chamber,
)
from sim.rod_drive import drive_array, rest_curvature
from sim.scene import Drive
from softbot.actuator import ActuatorLaw
from softbot.cross_section import default_cross_section
from softbot.faults import Fault, FaultKind
from softbot.robot import load_robot
from softbot.rolling import reachable_half_plane


def given_curvature(**changes: Any) -> Drive:
    return Drive.model_validate(
        {"kind": "curvature", "curvature_1_m": 12.0, "period_s": 2.0, "start_s": 1.0, "ramp_s": 0.5, **changes}
    )


def given_pressure(**changes: Any) -> Drive:
    return Drive.model_validate(
        {"kind": "pressure", "peak_pressure_Pa": 40e3, "period_s": 2.0, "start_s": 1.0, "ramp_s": 0.5, **changes}
    )


def test_bend_grows_over_the_ramp_and_stands_at_the_start() -> None:
    drive = given_curvature()
    assert [amplitude(drive, t) for t in (0.0, 0.5, 0.75, 1.0, 7.0)] == [0.0, 0.0, 0.5, 1.0, 1.0]
    np.testing.assert_allclose(curvature_1_m(drive, 0.75), [6.0, 0.0])
    np.testing.assert_allclose(curvature_1_m(drive, 0.0), 0.0)


@given(t_s=st.floats(1.0, 50.0), direction=st.sampled_from([1, -1]), period_s=st.floats(0.1, 10.0))
def test_curvature_turns_once_a_period_in_the_direction(t_s: float, direction: int, period_s: float) -> None:
    drive = given_curvature(direction=direction, period_s=period_s)
    vector = curvature_1_m(drive, t_s)
    assert np.hypot(*vector) == pytest.approx(12.0)
    np.testing.assert_allclose(curvature_1_m(drive, t_s + period_s), vector, atol=1e-9)
    quarter = curvature_1_m(drive, t_s + 0.25 * period_s)
    turned = direction * np.array([-vector[1], vector[0]])
    np.testing.assert_allclose(quarter, turned, atol=1e-9)
    assert phase_rad(drive, 0.3) == 0.0


@given(t_s=st.floats(0.0, 9.0), direction=st.sampled_from([1, -1]), co_contraction_Pa=st.floats(0.0, 2e4))
def test_pressures_stay_between_co_contraction_and_peak(t_s: float, direction: int, co_contraction_Pa: float) -> None:
    drive = given_pressure(direction=direction, co_contraction_Pa=co_contraction_Pa)
    pressure = pressures_Pa(drive, t_s)
    assert np.all(pressure >= co_contraction_Pa)
    assert np.all(pressure <= co_contraction_Pa + 40e3 + 1e-6)
    assert np.count_nonzero(pressure > co_contraction_Pa + 1e-6) <= 2  # next to each other: half a turn at most


@pytest.mark.parametrize("direction", [1, -1])
def test_pressures_bend_a_tube_towards_the_phase(direction: int) -> None:
    law = ActuatorLaw(default_cross_section(0.01), "linear", 1e5)
    drive = given_pressure(direction=direction, co_contraction_Pa=5e3)
    for t_s in np.linspace(1.0, 3.0, 17):
        bend = law.equilibrium(pressures_Pa(drive, t_s)).curvature_1_m
        phase = phase_rad(drive, t_s)
        assert math.atan2(bend[1], bend[0]) == pytest.approx(math.remainder(phase, 2.0 * math.pi), abs=1e-6) or (
            abs(abs(math.remainder(phase, 2.0 * math.pi)) - math.pi) < 1e-6
        )
        assert np.hypot(*bend) == pytest.approx(np.hypot(*law.equilibrium([40e3, 0, 0, 0]).curvature_1_m), rel=1e-6)


def test_many_times_give_what_each_gives() -> None:
    drive, times_s = given_curvature(direction=-1), np.linspace(0.0, 4.0, 41)
    np.testing.assert_array_equal(amplitude(drive, times_s), [amplitude(drive, t) for t in times_s])
    np.testing.assert_array_equal(phase_rad(drive, times_s), [phase_rad(drive, t) for t in times_s])


@given(t_s=st.floats(0.0, 9.0), direction=st.sampled_from([1, -1]), chamber=st.integers(0, 3), lost=st.floats(0.0, 1.0))
def test_numbers_for_the_rod_ask_for_the_same_curvature(t_s: float, direction: int, chamber: int, lost: float) -> None:
    drive = given_curvature(direction=direction)
    numbers = drive_array(drive, [lost if n == chamber else 0.0 for n in range(4)])
    asked = rest_curvature.py_func(numbers, t_s, 0.0, 1.0, 0.0, 0.0, np.zeros(2))
    np.testing.assert_allclose(asked, without_chamber(curvature_1_m(drive, t_s), chamber, lost), atol=1e-12)


def test_faults_of_one_chamber_take_shares_of_what_is_left() -> None:
    faults = [
        Fault(1.0, 0, FaultKind.RUPTURE, 0.5),
        Fault(2.0, 0, FaultKind.BLOCKED_INLET, 0.5),
        Fault(3.0, 2, FaultKind.RUPTURE),
        Fault(3.0, 3, FaultKind.LEAK),  # needs pneumatics, which a given curvature has not
        Fault(3.0, 3, FaultKind.SENSOR_STUCK),
    ]
    np.testing.assert_allclose(lost_shares(faults), [0.75, 0.0, 1.0, 0.0])
    np.testing.assert_array_equal(lost_shares([]), np.zeros(4))


def test_active_chambers_are_outside_and_active_muscles_inside() -> None:
    chambers, muscles = load_robot("default"), load_robot("larva")
    times_s, bent_rad = np.array([0.5, 1.5, 2.0]), np.array([0.1, 0.2, 0.3])
    turning = given_curvature()
    np.testing.assert_allclose(active_side_rad(turning, muscles, times_s, bent_rad), [0.0, 0.5 * math.pi, math.pi])
    outside = active_side_rad(turning, chambers, times_s, bent_rad)
    np.testing.assert_allclose(outside, [math.pi, 1.5 * math.pi, 2.0 * math.pi])
    leading = given_curvature(lead_rad=0.8, lag_s=0.1, direction=-1)
    np.testing.assert_allclose(active_side_rad(leading, muscles, times_s, bent_rad), [0.0, 0.2 - 0.8, 0.3 - 0.8])


def test_contraction_bends_as_the_wall_lets_it() -> None:
    larva = load_robot("larva")
    tube = larva.thin_tube()
    assert tube is not None
    drive = Drive.model_validate({"kind": "contraction", "contraction": 0.1})
    softness = 8.0 * (1.0 - tube.poisson_ratio**2) / (math.pi**2 * larva.radius_m)  # Eq. (2) without ovalisation
    assert bend_1_m(drive, larva) == pytest.approx(softness * 0.1)
    assert bend_1_m(given_curvature(), larva) == 12.0


@pytest.mark.parametrize("chamber", range(4))
def test_a_dead_chamber_takes_its_part_of_a_given_curvature(chamber: int) -> None:
    """What is left is the nearest that the others can give; a half-dead chamber gives half."""
    reachable = reachable_half_plane([chamber])
    towards = chamber * math.pi / 2 + math.pi
    for angle in np.linspace(0.0, 2.0 * math.pi, 17):
        whole = 12.0 * np.array([math.cos(angle), math.sin(angle)])
        left = without_chamber(whole, chamber, 1.0)
        if reachable.contains(angle):
            np.testing.assert_allclose(left, whole, atol=1e-12)
        else:
            assert abs(left @ [math.cos(towards), math.sin(towards)]) < 1e-12
            np.testing.assert_allclose(without_chamber(whole, chamber, 0.5), 0.5 * (left + whole), atol=1e-12)
