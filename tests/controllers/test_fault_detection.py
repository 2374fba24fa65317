"""Fault detection in the closed loop: nothing on a healthy robot, the right name on a broken one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from controllers.fault_detection import FaultDetector
from controllers.interface import Command
from softbot.faults import NO_CHAMBER, Fault
from softbot.pneumatics import PneumaticsParameters
from softbot.sensing import Readings, SensorParameters


@pytest.mark.parametrize(("speed_rev_s", "seed"), [(0.1, 0), (0.5, 1), (0.9, 2), (None, 3)])
def test_a_healthy_robot_raises_no_alarm(closed_loop, speed_rev_s, seed):
    run = closed_loop(15.0, speed_rev_s=speed_rev_s, seed=seed)
    assert run.detections == []
    assert abs(run.turned(5.0, 15.0)) > 0.5  # and it did roll


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_robot_with_other_valves_than_its_file_says_is_healthy(closed_loop, with_other_valves, seed):
    run = closed_loop(15.0, speed_rev_s=0.4, seed=seed, real=with_other_valves(seed))
    assert run.detections == []
    assert abs(run.turned(5.0, 15.0)) > 0.5


@pytest.mark.parametrize(("share", "longest"), [(0.1, 1), (0.02, 20)])
def test_samplings_that_are_lost_or_late_are_no_fault(closed_loop, share, longest):
    random = np.random.default_rng(5)
    silent = np.zeros(1500, dtype=bool)
    for start in np.flatnonzero(random.random(1500) < share):
        silent[start : start + random.integers(1, longest + 1)] = True
    run = closed_loop(15.0, speed_rev_s=0.4, heard=lambda cycle: not silent[cycle])
    assert run.detections == []
    assert 0.05 < silent.mean() < 0.3


@pytest.mark.parametrize("chamber", [0, 1, 2, 3])
@pytest.mark.parametrize("t_s", [5.0, 5.37, 5.9])
def test_a_rupture_is_found_and_named(closed_loop, chamber, t_s):
    run = closed_loop(t_s + 2.5, faults=(Fault(t_s, chamber, "rupture"),), seed=chamber)
    assert [(d.chamber, d.kind) for d in run.detections] == [(chamber, "rupture")]
    # at the latest when the chamber is needed: once in a revolution of 2 s
    assert 0.0 < run.detections[0].t_s - t_s < 2.0
    assert run.detections[0].confidence > 0.9


@pytest.mark.parametrize(
    ("kind", "severity", "names"),
    [
        ("leak", 1.0, {"leak"}),
        ("blocked_inlet", 1.0, {"blocked_inlet", "stuck_closed"}),
        ("stuck_closed", 1.0, {"stuck_closed", "blocked_inlet"}),
        ("stuck_open", 1.0, {"stuck_open"}),
        ("sensor_offset", 1.0, {"sensor_offset"}),
        ("sensor_offset", 0.5, {"sensor_offset"}),
        ("sensor_stuck", 1.0, {"sensor_stuck"}),
        ("leak", 0.25, {"leak"}),
        ("kinked_line", 0.8, {"kinked_line"}),
        ("blocked_exhaust", 0.8, {"blocked_exhaust"}),
        ("sensor_noise", 0.5, {"sensor_noise"}),
        ("sensor_dropout", 1.0, {"sensor_dropout"}),
        ("lines_swapped", 1.0, {"lines_swapped"}),
        ("ballooning", 0.6, {"ballooning"}),
        ("sensor_drift", 0.8, {"sensor_drift"}),
        ("valve_slow", 0.7, {"valve_slow"}),
    ],
)
def test_the_other_kinds_are_found_on_the_right_chamber(closed_loop, kind, severity, names):
    """A blocked inlet and a valve stuck shut look the same while the chamber is empty; both names are right then."""
    run = closed_loop(9.0, faults=(Fault(5.3, 1, kind, severity),), seed=7, command=Command.RIGHT)
    assert run.detections
    last = [found for found in run.detections if found.chamber == 1][-1]
    assert last.kind in names


def test_steps_of_pressure_tell_a_wrong_scale_from_a_chamber_that_balloons(closed_loop):
    fault = Fault(5.3, 1, "sensor_scale", 0.6)
    run = closed_loop(9.0, faults=(fault,), seed=7, command=Command.RIGHT, excitation_Pa=10e3)
    last = [found for found in run.detections if found.chamber == 1][-1]
    assert last.kind == "sensor_scale"


@pytest.mark.parametrize(
    ("kind", "severity"), [("supply_sag", 0.5), ("imu_stuck", 1.0), ("imu_dropout", 1.0), ("imu_bias", 0.5)]
)
def test_what_the_chambers_share_names_no_chamber(closed_loop, kind, severity):
    run = closed_loop(8.0, faults=(Fault(5.3, None, kind, severity),), seed=7)
    assert [(found.chamber, found.kind) for found in run.detections] == [(NO_CHAMBER, kind)]


@pytest.mark.parametrize(
    ("kind", "severity"), [("supply_loss", 1.0), ("supply_loss", 0.96), ("supply_sag", 0.7), ("supply_sag", 0.4)]
)
def test_a_lost_supply_is_told_from_one_that_sags(closed_loop, kind, severity):
    run = closed_loop(14.0, faults=(Fault(5.3, None, kind, severity),), seed=4)
    assert (run.detections[-1].chamber, run.detections[-1].kind) == (NO_CHAMBER, kind)
    assert all(found.chamber == NO_CHAMBER for found in run.detections)


def readings(t_s, pressure_Pa, opening=0.0) -> Readings:
    return Readings(
        t_s, np.full(4, float(pressure_Pa)), 250e3, np.zeros(3), np.array([0.0, 9.81, 0.0]), np.full(4, float(opening))
    )


def test_a_supply_that_the_board_has_shut_is_not_lost_and_may_fill_again_but_one_that_stays_low_is_named():
    detector = FaultDetector(PneumaticsParameters(), SensorParameters())
    volume = np.full(4, 50e-6)

    def found(first: int, count: int, supply_Pa: float, is_shut: bool = False) -> list[str]:
        kinds = []
        for cycle in range(first, first + count):
            reading = replace(readings(0.01 * cycle, 0.0), supply_Pa=supply_Pa, main_supply_shut=is_shut)
            kinds += [one.kind for one in detector.update(reading, volume)]
        return kinds

    assert found(0, 100, 250e3) == []
    assert found(100, 100, 100e3, is_shut=True) == []
    assert found(200, 15, 160e3) == []
    assert found(215, 50, 250e3) == []
    assert found(265, 4, 200e3, is_shut=True) == []
    assert found(269, 50, 160e3) == ["supply_sag"]


def test_a_gap_in_the_readings_restarts_the_models_without_a_verdict():
    detector = FaultDetector(PneumaticsParameters(), SensorParameters())
    volume = np.full(4, 50e-6)
    for cycle in range(100):
        assert detector.update(readings(cycle * 0.01, 0.0), volume) == ()
    # after a second of silence all chambers stand at 80 kPa with their valves shut
    for cycle in range(100):
        assert detector.update(readings(2.0 + cycle * 0.01, 80e3), volume) == ()


def test_readings_that_are_no_numbers_decide_nothing():
    detector = FaultDetector(PneumaticsParameters(), SensorParameters())
    volume = np.full(4, 50e-6)
    for cycle in range(200):
        value = math.nan if cycle % 3 == 0 else 0.0
        assert detector.update(readings(cycle * 0.01, value), volume) == ()


def test_a_chamber_is_named_once_until_it_is_forgotten():
    detector = FaultDetector(PneumaticsParameters(), SensorParameters())
    volume = np.full(4, 50e-6)
    noise = np.random.default_rng(1)
    found = []

    def blow(seconds: float, start_s: float) -> None:
        for cycle in range(round(seconds / 0.01)):  # all valves wide open, and no pressure comes
            reading = readings(start_s + cycle * 0.01, 0.0, opening=1.0)
            reading = Readings(
                reading.t_s,
                reading.pressure_Pa + 300.0 * noise.standard_normal(4),
                reading.supply_Pa,
                reading.gyro_rad_s,
                reading.accelerometer_m_s2,
                reading.opening,
            )
            found.extend(detector.update(reading, volume))

    blow(1.5, 0.0)
    assert sorted(d.chamber for d in found) == [0, 1, 2, 3]
    assert {d.kind for d in found} <= {"blocked_inlet", "stuck_closed", "rupture"}
    blow(1.0, 1.5)
    assert len(found) == 4
    detector.forget(2)
    blow(1.0, 2.5)
    assert [d.chamber for d in found[4:]] == [2]


@pytest.fixture(scope="module")
def full_s(closed_loop):
    """A time at which chamber 1 is as full as it gets, to the hundredth of a second."""
    run = closed_loop(9.0, seed=7)
    pressure_Pa = np.array(run.pressure_Pa)[:, 1]
    late = np.array(run.t_s) > 5.0
    at = int(np.argmax(np.where(late, pressure_Pa, 0.0)))
    assert pressure_Pa[at] > 85e3
    return round(run.t_s[at], 2)


@pytest.mark.parametrize("later_s", [0.002, 0.005, 0.008])
def test_a_valve_that_sticks_open_at_a_full_chamber_is_named_before_it_is_usually_suspected(
    closed_loop, full_s, later_s
):
    t_s = full_s + later_s
    run = closed_loop(t_s + 0.5, faults=(Fault(t_s, 1, "stuck_open", 1.0),), seed=7)
    assert [(d.chamber, d.kind) for d in run.detections] == [(1, "stuck_open")]
    assert run.detections[0].t_s - t_s < 0.05  # four surprises make a suspicion, and two cycles confirm it


@pytest.mark.parametrize("later_s", [0.002, 0.052])
@pytest.mark.parametrize(
    ("kind", "severity"),
    [("sensor_offset", 0.5), ("sensor_offset", 1.0), ("sensor_noise", 0.3), ("sensor_noise", 1.0), ("valve_slow", 1.0)],
)
def test_what_else_shows_more_pressure_in_a_full_chamber_is_no_valve_stuck_open(
    closed_loop, full_s, kind, severity, later_s
):
    t_s = full_s + later_s
    run = closed_loop(t_s + 1.0, faults=(Fault(t_s, 1, kind, severity),), seed=7)
    assert [(d.chamber, d.kind) for d in run.detections] == [(1, kind)]
