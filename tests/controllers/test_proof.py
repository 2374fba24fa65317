"""A chamber that was given up is used again when it has proved itself, and not before."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from controllers.interface import Command, Order, SequencerState
from controllers.proof import FAILED, FILLS, NOT_ANY, PROVED, UNDER_WAY, begin_proof, follow_proof, proof_memory
from controllers.sequencer import Sequencer
from controllers.sequencer_parts import SequencerConfig
from softbot.faults import KIND_CODES, Fault, FaultKind
from softbot.sensing import Readings

LAG_S, TEST_Pa = 0.1, 40e3


def prove(lag_s: float, *, reaches: float = 1.0, holds_Pa: float = 0.0) -> tuple[int, Any, int]:
    """Outcome for a chamber of this lag, that comes to a share of what it is asked for and never empties."""
    proof: Any = proof_memory()[0]
    begin_proof(proof, 2, 0.0)
    pressure_Pa, highest_fills = holds_Pa, 0
    for cycle in range(3000):
        outcome = int(follow_proof(proof, pressure_Pa, TEST_Pa, 0.01 * cycle, LAG_S))
        highest_fills = max(highest_fills, int(proof["fills"]))
        if outcome != UNDER_WAY:
            return outcome, proof, highest_fills
        wanted_Pa = reaches * TEST_Pa if proof["filling"] else 0.0
        pressure_Pa = max(wanted_Pa + (pressure_Pa - wanted_Pa) * math.exp(-0.01 / lag_s), holds_Pa)
    raise AssertionError("never decided")


def test_a_sound_chamber_is_filled_as_often_as_it_must_and_proved():
    outcome, proof, fills = prove(LAG_S)
    assert outcome == PROVED
    assert fills == FILLS
    assert proof["chamber"] == NOT_ANY
    assert not proof["owed"].any()


@pytest.mark.parametrize(
    "chamber",
    [
        {"lag_s": 5 * LAG_S},  # a kinked line
        {"lag_s": LAG_S, "reaches": 0.6},  # a hole
        {"lag_s": LAG_S, "reaches": 1.4},
        {"lag_s": LAG_S, "holds_Pa": 12e3},  # a valve that does not vent
        {"lag_s": LAG_S, "holds_Pa": math.nan},
    ],
)
def test_one_that_does_not_follow_is_not_proved(chamber):
    outcome, proof, _ = prove(**chamber)
    assert outcome == FAILED
    assert proof["chamber"] == NOT_ANY


STOPS = ((6.0, Order(Command.STOP)), (8.0, Order(Command.LEFT, 0.5)))


def test_after_a_stop_a_chamber_that_recovered_is_used_again(closed_loop, robot):
    once = Fault(3.0, 1, "blocked_inlet", period_s=100.0, duty=0.04)
    run = closed_loop(18.0, faults=(once,), orders=STOPS)
    assert any(found.chamber == 1 for found in run.detections)
    asked = np.array(run.setpoint_Pa)[:, 1]
    assert asked[450:800].max() == 0.0
    proving = asked[800:1200]
    assert np.count_nonzero(np.diff((proving > 0.0).astype(int)) > 0) >= FILLS
    assert run.states[1799] is SequencerState.ROLLING
    assert asked[1400:].max() > 0.6 * robot.max_pressure_Pa
    assert run.turned(13.0, 18.0) == pytest.approx(-2.5, rel=0.1)


def test_one_that_did_not_is_tried_once_and_left_out(closed_loop, robot):
    run = closed_loop(16.0, faults=(Fault(3.0, 1, "rupture"),), orders=STOPS)
    asked = np.array(run.setpoint_Pa)[:, 1]
    tried = np.flatnonzero(asked[800:] > 0.0)
    assert 0 < tried.size < 150
    assert asked[800:].max() < 0.5 * robot.max_pressure_Pa
    assert run.states[1599] in (SequencerState.DEGRADED, SequencerState.REVERSING)
    assert run.turned(12.0, 16.0) < -1.0


def test_a_milder_name_gives_nothing_back_before_the_robot_rests(robot):
    sequencer = Sequencer(SequencerConfig(robot))
    sequencer.order(Order(Command.LEFT), 0.0)
    sequencer.armed(True)
    named = sequencer.memory.detector.own[0]["named"]
    dead = []
    for cycle in range(60):
        named[1] = {20: KIND_CODES[FaultKind.RUPTURE], 30: KIND_CODES[FaultKind.LEAK], 40: 0}.get(cycle, named[1])
        if cycle == 50:
            sequencer.order(Order(Command.STOP), 0.01 * cycle)
        sequencer.update(0.01 * cycle, resting(0.01 * cycle))
        dead.append(sequencer.dead_chambers)
    assert dead[19] == ()
    assert all(chambers == (1,) for chambers in dead[20:50])
    assert dead[-1] == ()


def resting(t_s: float) -> Readings:
    return Readings(t_s, np.zeros(4), 250e3, np.zeros(3), np.array([0.0, 9.81, 0.0]), np.zeros(4))


def test_a_chamber_whose_sensor_lied_is_not_tried(closed_loop):
    run = closed_loop(12.0, faults=(Fault(3.0, 1, "sensor_dropout"),), orders=STOPS)
    assert any(found.kind == "sensor_dropout" for found in run.detections)
    assert np.array(run.setpoint_Pa)[600:, 1].max() == 0.0
