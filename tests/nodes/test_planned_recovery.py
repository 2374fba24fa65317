"""On the rod, with the sequencer's own detection: what a damaged robot still does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers.interface import STATES, Offer, SequencerState
from controllers.pressure_loop import PressureLoopGains
from sim.scene import scene_from
from softbot.campaign.recovered_speed import weak_over_dead
from softbot.nodes.direct import TRACE, DirectRun

STRUCK_S, SETTLED_S, END_S = 4.0, 7.0, 19.0
_ROLL, _STATE = TRACE.index("roll_rad"), TRACE.index("state")
_PRESSURES = slice(TRACE.index("pressure_0_Pa"), TRACE.index("pressure_0_Pa") + 4)
_HEALTHY: dict[tuple[float, str], float] = {}


class Run:
    """A run of the shipped robot under its sequencer, one fault on each of some chambers."""

    def __init__(
        self,
        gains: PressureLoopGains,
        chambers: Sequence[int] = (),
        *,
        kind: str = "rupture",
        severity: float = 1.0,
        struck_s: float = STRUCK_S,
        command: str = "left",
        **sequencer: Any,
    ) -> None:
        scene = scene_from(
            {
                "robot": "default",
                "drive": {"kind": "sequencer"},
                "sequencer": {"command": command, **sequencer},
                "solver": {"twin": "rod", "accuracy": "fast", "duration_s": END_S},
                "fault": [
                    {"t_s": struck_s, "chamber": chamber, "kind": kind, "severity": severity} for chamber in chambers
                ],
            },
            "recovery.toml",
            Path(),
        )
        run = DirectRun(scene, gains=gains)
        self.limit_Pa = scene.robot.max_pressure_Pa
        self.trace = run.advance(round(END_S / 0.01)).trace
        self.answers = run.recoveries()
        self.strategies = [answer.strategy for answer in self.answers]
        self.state = STATES[int(self.trace[-1, _STATE])]
        turns = (-1.0 if command == "left" else 1.0) * self.trace[:, _ROLL] / (2.0 * math.pi)
        since = round(SETTLED_S / 0.01)
        self.rate_rev_s = float((turns[-1] - turns[since]) / (END_S - SETTLED_S))


def healthy(gains: PressureLoopGains, lead_rad: float, command: str = "left") -> float:
    """Speed of the sound robot at full effort [rev/s]."""
    if (lead_rad, command) not in _HEALTHY:
        _HEALTHY[lead_rad, command] = Run(gains, lead_rad=lead_rad, command=command).rate_rev_s
    return _HEALTHY[lead_rad, command]


@pytest.mark.parametrize(("command", "chamber"), [("left", 0), ("left", 3), ("right", 1), ("right", 2)])
@pytest.mark.parametrize(("lead_rad", "share"), [(0.5, 0.8), (0.8, 0.7), (1.57, 0.6)])
def test_one_dead_chamber_costs_little_of_the_speed(gains, command, chamber, lead_rad, share):
    run = Run(gains, [chamber], command=command, lead_rad=lead_rad)
    assert run.rate_rev_s > share * healthy(gains, lead_rad, command)
    assert run.strategies == ["curvature_reversal"]
    assert run.state in (SequencerState.DEGRADED, SequencerState.REVERSING)
    assert run.trace[:, _PRESSURES].max() <= run.limit_Pa


@pytest.mark.parametrize("chamber", [0, 1, 2, 3])
def test_with_one_dead_chamber_a_quarter_of_the_speed_is_held(gains, chamber):
    for lead_rad in (0.8, 1.57):
        wanted = 0.25 * healthy(gains, lead_rad)
        run = Run(gains, [chamber], lead_rad=lead_rad, speed_rev_s=wanted)
        assert run.rate_rev_s == pytest.approx(wanted, rel=0.1)


@pytest.mark.parametrize("severity", [0.4, 0.7, 1.0])
def test_a_weak_chamber_rolls_no_slower_than_a_dead_one(gains, severity):
    weak = np.mean([Run(gains, [c], kind="ballooning", severity=severity, lead_rad=0.8).rate_rev_s for c in (0, 1)])
    dead = np.mean([Run(gains, [c], lead_rad=0.8).rate_rev_s for c in (0, 1)])
    assert weak > 0.97 * dead


@pytest.mark.slow
@pytest.mark.parametrize(("valves", "lead_rad"), [(0.5, 0.5), (1.0, 0.8)])
def test_a_weak_chamber_rolls_no_slower_than_a_dead_one_at_other_lags(valves, lead_rad):
    for share, error in weak_over_dead(valves, lead_rad):
        assert share > 0.98 - 2.0 * error
        assert error < 0.03


@pytest.mark.parametrize("pair", [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)])
def test_momentum_carries_a_rolling_robot_over_what_two_dead_chambers_leave_out(gains, pair):
    run = Run(gains, pair, lead_rad=0.8)
    assert run.rate_rev_s > 0.5
    assert "momentum" in run.strategies
    assert run.trace[:, _PRESSURES].max() <= run.limit_Pa


@pytest.mark.parametrize("speed_rev_s", [0.3, 0.8])
@pytest.mark.parametrize("pair", [(0, 1), (1, 2), (0, 2)])
def test_an_ordered_speed_is_honoured_with_two_dead_chambers_as_well(gains, pair, speed_rev_s):
    run = Run(gains, pair, lead_rad=0.8, speed_rev_s=speed_rev_s)
    assert run.state is not SequencerState.SAFE
    assert run.rate_rev_s == pytest.approx(speed_rev_s, rel=0.15)


def test_without_any_chamber_it_stops_and_says_so(gains):
    run = Run(gains, (0, 1, 2, 3))
    assert run.state is SequencerState.SAFE
    assert run.strategies[-1] == "safe_stop"
    assert run.trace[-100:, _PRESSURES].max() < 2e3
    assert run.answers[-1].offer == Offer(0.0, 0.0)


def test_level_on_the_line_of_two_opposite_chambers_it_stops_safely_and_says_that_nothing_is_left(gains):
    run = Run(gains, (1, 3), struck_s=0.2, turn_back=True)
    assert run.state is SequencerState.SAFE
    assert run.strategies[-1] == "safe_stop"
    assert run.strategies.count("safe_stop") == 1
    assert "rock_free" in run.strategies
    assert max(run.answers[-1].offer.left_rad, run.answers[-1].offer.right_rad) < 0.1
