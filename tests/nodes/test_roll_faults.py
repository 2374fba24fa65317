"""What befalls the roll of a whole robot is found and answered, and no chamber is blamed for it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers.interface import STATES, Offer, SequencerState
from sim.recorder import samples_of
from sim.scene import scene_from
from softbot.campaign.outcome import mean_rate
from softbot.nodes.direct import TRACE, DirectRun

TURN_RAD = 2.0 * np.pi
SPEED_REV_S = 0.4


def run_of(*faults: dict[str, Any], duration_s: float = 14.0, **sequencer: Any) -> tuple[DirectRun, Any]:
    """A run of the default robot, and its trace."""
    table: dict[str, Any] = {
        "robot": "default",
        "drive": {"kind": "sequencer"},
        "sequencer": {"command": "left", "speed_rev_s": SPEED_REV_S, **sequencer},
        "solver": {"twin": "rod", "accuracy": "fast", "duration_s": duration_s, "seed": 3},
        "fault": list(faults),
    }
    scene = scene_from(table, "roll.toml", Path())
    run = DirectRun(scene)
    return run, run.advance(samples_of(scene)).trace


def rate_rev_s(trace: Any, from_s: float) -> float:
    """To the left."""
    rate = mean_rate(trace[:, 0], -trace[:, TRACE.index("roll_rad")] / TURN_RAD, from_s, np.inf)
    assert rate is not None
    return rate


def named(run: DirectRun) -> list[tuple[int, str]]:
    return [(found.chamber, found.kind) for found in run.detections()]


@pytest.mark.parametrize("severity", [0.4, 1.0])
@pytest.mark.parametrize("command", ["left", "right"])
def test_a_biased_gyro_is_found_and_the_ordered_speed_held(severity, command):
    run, trace = run_of({"t_s": 6.0, "kind": "imu_bias", "severity": severity}, command=command)
    assert named(run) == [(-1, "imu_bias")]
    assert run.detections()[0].t_s < 7.5
    sign = 1.0 if command == "left" else -1.0
    assert sign * rate_rev_s(trace, 9.0) == pytest.approx(SPEED_REV_S, rel=0.05)
    off = trace[900:, TRACE.index("estimated_roll_rad")] - trace[900:, TRACE.index("roll_rad")]
    assert np.abs(np.angle(np.exp(1j * off))).max() < 0.15


def test_ice_is_found_and_the_robot_turns_on():
    run, trace = run_of({"t_s": 6.0, "kind": "friction_lost", "severity": 1.0})
    assert named(run) == [(-1, "friction_lost")]
    assert rate_rev_s(trace, 9.0) == pytest.approx(SPEED_REV_S, rel=0.05)


def test_a_robot_at_a_kerb_that_it_does_not_climb_stops_safely():
    run, trace = run_of({"t_s": 6.0, "kind": "obstacle", "severity": 0.25})
    assert named(run) == [(-1, "obstacle")]
    assert STATES[int(trace[-1, TRACE.index("state")])] is SequencerState.SAFE
    assert [answer.strategy for answer in run.recoveries()] == ["safe_stop"]


def test_a_robot_at_a_kerb_offers_the_other_way_and_takes_it_when_told_to():
    run, trace = run_of({"t_s": 6.0, "kind": "obstacle", "severity": 0.25}, turn_back=True, duration_s=18.0)
    stop, turn = run.recoveries()
    assert (stop.strategy, turn.strategy) == ("safe_stop", "other_way")
    assert stop.offer == Offer(0.0, 2.0 * math.pi)
    assert rate_rev_s(trace, turn.t_s + 3.0) == pytest.approx(-SPEED_REV_S, rel=0.05)


@pytest.mark.parametrize("chamber", [0, 3])
def test_a_wall_that_grows_soft_is_named_with_its_chamber_and_the_robot_rolls_on(chamber):
    fault = {"t_s": 7.0, "chamber": chamber, "kind": "wall_softening", "severity": 0.9, "ramp_s": 3.0}
    run, trace = run_of(fault, duration_s=20.0)
    assert named(run) == [(chamber, "wall_softening")]
    assert rate_rev_s(trace, 12.0) == pytest.approx(SPEED_REV_S, rel=0.05)


@pytest.mark.parametrize("kind", ["friction_high", "payload"])
def test_what_costs_no_speed_is_left_alone(kind):
    run, trace = run_of({"t_s": 6.0, "kind": kind, "severity": 1.0})
    assert named(run) == []
    assert rate_rev_s(trace, 9.0) == pytest.approx(SPEED_REV_S, rel=0.05)


def test_a_rupture_after_a_soft_wall_is_still_found():
    soft = {"t_s": 7.0, "chamber": 1, "kind": "wall_softening", "severity": 0.9, "ramp_s": 3.0}
    run, _ = run_of(soft, {"t_s": 17.0, "chamber": 1, "kind": "rupture"}, duration_s=20.0)
    assert named(run)[0] == (1, "wall_softening")
    assert named(run)[-1] == (1, "rupture")
