"""Chambers that rest get small steps of pressure, in turn, and faults that strike at rest are found by them."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.excitation import Excitation, excite
from controllers.interface import SequencerState
from softbot.faults import Fault

CYCLE_S = 0.01
STEPS = Excitation(8e3, 0.4)


def excited(setpoint_Pa: list[float], wanted: list[int], idle_Pa: float = 0.0, excitation: Excitation = STEPS):
    """Setpoints of two periods, a row a cycle."""
    rows = []
    for cycle in range(round(2.0 * STEPS.period_s / CYCLE_S)):
        setpoint = np.array(setpoint_Pa, dtype=float)
        excite(excitation, idle_Pa, cycle * CYCLE_S, np.array(wanted, dtype=np.int64), setpoint)
        rows.append(setpoint)
    return np.array(rows)


def test_each_resting_chamber_steps_for_half_of_the_period_and_they_take_turns():
    rows = excited([0.0, 0.0, 0.0, 0.0], [1, 1, 1, 1], idle_Pa=1e3)
    assert set(rows.ravel()) == {0.0, 9e3}
    up = rows > 0.0
    assert up.mean(axis=0) == pytest.approx(0.5, abs=0.03)
    assert up.sum(axis=1).min() >= 1  # never all at once
    assert up.sum(axis=1).max() <= 3
    assert len({tuple(column) for column in up.T.tolist()}) == 4


def test_a_chamber_in_use_is_left_as_it_is_and_one_that_is_not_wanted_too():
    rows = excited([60e3, 0.0, 8.5e3, 0.0], [1, 1, 1, 0])
    assert set(rows[:, 0]) == {60e3}
    assert set(rows[:, 1]) == {0.0, 8e3}
    assert set(rows[:, 2]) == {8.5e3}
    assert set(rows[:, 3]) == {0.0}


def test_none_is_none():
    assert not excited([0.0] * 4, [1] * 4, excitation=Excitation(0.0, 0.4)).any()


def test_ruptures_are_found_in_half_of_the_time_that_they_take_without_steps(closed_loop):
    delays = {}
    for excitation_Pa in (0.0, 10e3):
        delays[excitation_Pa] = 0.0
        for chamber in range(4):
            faults = (Fault(6.0, chamber, "rupture"),)
            run = closed_loop(9.0, speed_rev_s=0.3, faults=faults, seed=chamber, excitation_Pa=excitation_Pa)
            assert [(one.chamber, one.kind) for one in run.detections] == [(chamber, "rupture")]
            delays[excitation_Pa] += run.detections[0].t_s - 6.0
    assert delays[10e3] < 0.5 * delays[0.0]


def test_only_a_robot_that_rolls_is_excited(closed_loop):
    size_Pa = 7654.0  # that no bend happens to ask for
    run = closed_loop(6.0, distance_m=0.05, excitation_Pa=size_Pa)
    stepped = (np.array(run.setpoint_Pa) == size_Pa).any(axis=1)
    rolling = np.array([state is SequencerState.ROLLING for state in run.states])
    assert run.states[-1] is SequencerState.DISARMED
    assert stepped[rolling].mean() > 0.5
    assert not stepped[~rolling].any()
