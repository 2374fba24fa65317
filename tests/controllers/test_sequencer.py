"""The sequencer in a closed loop without a bus: orders, speed, stops, recovery, safety."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.interface import Command, Offer, Order, SequencerState
from controllers.sequencer import Sequencer
from controllers.sequencer_parts import SequencerConfig
from softbot.faults import Fault
from softbot.sensing import Readings

S = SequencerState


@pytest.mark.parametrize(("command", "sign"), [(Command.LEFT, -1), (Command.RIGHT, 1)])
@pytest.mark.parametrize("speed_rev_s", [0.2, 0.5])
def test_it_rolls_where_and_as_fast_as_ordered(closed_loop, command, sign, speed_rev_s):
    run = closed_loop(12.0, command=command, speed_rev_s=speed_rev_s)
    assert run.turned(4.0, 12.0) / 8.0 == pytest.approx(sign * speed_rev_s, rel=0.1)
    assert run.states[0] is S.PRIMING
    assert run.states[-1] is S.ROLLING


def test_more_lead_rolls_faster(closed_loop):
    slow = closed_loop(6.0, speed_rev_s=None, lead_rad=0.4)
    fast = closed_loop(6.0, speed_rev_s=None, lead_rad=1.0)
    assert abs(fast.turned(3.0, 6.0)) > 1.5 * abs(slow.turned(3.0, 6.0))


def test_it_stops_after_the_ordered_distance_and_vents(closed_loop, robot):
    run = closed_loop(10.0, distance_m=0.3)
    rolled_m = abs(run.revolutions[-1]) * 2.0 * math.pi * robot.radius_m
    assert rolled_m == pytest.approx(0.3, rel=0.15)
    assert run.states[-1] is S.DISARMED
    assert run.pressure_Pa[-1][:4].max() < 2e3


def test_an_order_to_stop_stops_and_one_to_go_goes_the_other_way(closed_loop):
    orders = ((4.0, Order(Command.STOP)), (6.0, Order(Command.RIGHT, 0.5)))
    run = closed_loop(11.0, orders=orders)
    assert run.turned(2.0, 4.0) < -0.5
    assert abs(run.turned(5.0, 6.0)) < 0.05
    assert run.turned(7.5, 11.0) > 1.0
    assert S.DISARMED in run.states[410:600]


@pytest.mark.parametrize("command", [Command.LEFT, Command.RIGHT])
@pytest.mark.parametrize("chamber", [0, 1, 2, 3])
def test_with_one_dead_chamber_it_reverses_its_curvature_and_rolls_on_the_same_way(closed_loop, command, chamber):
    run = closed_loop(13.0, command=command, faults=(Fault(5.0, chamber, "rupture"),))
    sign = -1 if command is Command.LEFT else 1
    assert sign * run.turned(7.5, 13.0) > 1.0
    assert S.REVERSING in run.states
    assert [r.strategy for r in run.recoveries] == ["curvature_reversal"]
    assert run.states[-1] in (S.DEGRADED, S.REVERSING)


@pytest.mark.parametrize("chamber", [0, 3])
def test_without_recovery_it_stalls_with_the_dead_chamber_across(closed_loop, chamber):
    run = closed_loop(12.0, faults=(Fault(5.0, chamber, "rupture"),), recovery=False)
    assert run.states[-1] is S.STALLED
    assert abs(run.turned(9.0, 12.0)) < 0.02
    theta = math.remainder(chamber * math.pi / 2 - run.bend_direction_rad[-1], 2.0 * math.pi)
    assert abs(theta) == pytest.approx(math.pi / 2, abs=math.radians(20.0))
    assert run.recoveries == []


def test_no_chamber_is_ever_asked_for_more_than_its_limit(closed_loop, robot):
    for faults in ((), (Fault(3.0, 1, "rupture"),)):
        run = closed_loop(8.0, speed_rev_s=None, co_contraction_Pa=10e3, faults=faults)
        asked = np.array(run.setpoint_Pa)
        assert asked.min() >= 0.0
        assert asked.max() <= robot.max_pressure_Pa
        assert np.array(run.pressure_Pa)[:, :4].max() < 1.05 * robot.max_pressure_Pa


def test_a_valve_stuck_open_ends_in_the_safe_state_until_a_stop_is_ordered(closed_loop):
    orders = ((8.0, Order(Command.STOP)),)
    run = closed_loop(9.0, faults=(Fault(4.0, 1, "stuck_open"),), orders=orders)
    assert run.states[790] is S.SAFE
    assert run.recoveries[0].strategy == "safe_stop"
    assert run.states[-1] is S.DISARMED
    assert all((np.array(run.setpoint_Pa)[700:790] == 0.0).all(axis=1))


def test_two_dead_chambers_stop_it_safely(closed_loop):
    run = closed_loop(15.0, faults=(Fault(4.0, 0, "rupture"), Fault(4.0, 1, "rupture")))
    assert run.states[-1] is S.SAFE
    assert run.recoveries[-1].strategy == "safe_stop"


def test_a_stop_for_want_of_chambers_offers_what_they_still_push_it(closed_loop):
    run = closed_loop(15.0, faults=(Fault(4.0, 0, "rupture"), Fault(4.0, 1, "rupture")))
    offer = run.recoveries[-1].offer
    assert 0.2 < offer.left_rad + offer.right_rad < 1.6 * math.pi
    assert all(answer.offer is None for answer in run.recoveries if answer.strategy != "safe_stop")


@pytest.mark.parametrize(("kind", "severity"), [("stuck_open", 1.0), ("imu_dropout", 1.0)])
def test_what_forbids_any_motion_leaves_nothing_and_is_not_turned_from(closed_loop, kind, severity):
    orders = ((0.0, Order(Command.LEFT, 0.5, turn_back=True)),)
    chamber = 1 if kind == "stuck_open" else None
    run = closed_loop(9.0, faults=(Fault(4.0, chamber, kind, severity),), orders=orders)
    assert [answer.strategy for answer in run.recoveries] == ["safe_stop"]
    assert run.recoveries[0].offer == Offer(0.0, 0.0)
    assert run.states[-1] is S.SAFE


def test_a_robot_told_to_turn_back_does_so_once_and_can_then_still_be_stopped(closed_loop):
    orders = ((0.0, Order(Command.LEFT, 0.5, turn_back=True)),)
    run = closed_loop(30.0, faults=(Fault(4.0, 1, "rupture"), Fault(4.0, 2, "rupture")), orders=orders)
    answers = [answer.strategy for answer in run.recoveries if answer.strategy in ("safe_stop", "other_way")]
    assert answers == ["safe_stop", "other_way", "safe_stop"]
    stopped_s, turned_s, _ = (a.t_s for a in run.recoveries if a.strategy in ("safe_stop", "other_way"))
    pressure_Pa = np.array(run.pressure_Pa)[:, :4]
    assert pressure_Pa[round(turned_s / 0.01)].max() < 2e3  # at rest in between
    assert turned_s > stopped_s + 0.5
    assert max(run.revolutions[round(turned_s / 0.01) :]) > run.revolutions[round(turned_s / 0.01)] + 0.1
    assert run.states[-1] is S.SAFE


def resting(t_s: float) -> Readings:
    return Readings(t_s, np.zeros(4), 250e3, np.zeros(3), np.array([0.0, 9.81, 0.0]), np.zeros(4))


def test_it_asks_for_no_pressure_before_the_board_is_armed(robot):
    sequencer = Sequencer(SequencerConfig(robot))
    assert sequencer.state is S.DISARMED
    assert not sequencer.update(0.0, resting(0.0)).wants_armed
    sequencer.order(Order(Command.LEFT), 0.01)
    for cycle in range(1, 50):
        output = sequencer.update(cycle * 0.01, resting(cycle * 0.01))
        assert output.wants_armed
        assert output.state is S.PRIMING
        assert not output.setpoint_Pa.any()
    sequencer.armed(True)
    assert sequencer.update(0.5, resting(0.5)).setpoint_Pa.max() > 10e3
    sequencer.armed(False)  # the board fell back to its safe state
    assert not sequencer.update(0.51, resting(0.51)).setpoint_Pa.any()


def test_a_bend_that_is_ordered_is_the_bend_that_is_commanded(robot):
    sequencer = Sequencer(SequencerConfig(robot, bend_rad=0.3))
    sequencer.order(Order(Command.LEFT), 0.0)
    sequencer.armed(True)
    for cycle in range(3):
        output = sequencer.update(cycle * 0.01, resting(cycle * 0.01))
    bent = robot.actuator_law().equilibrium(output.setpoint_Pa)
    assert float(np.hypot(*bent.curvature_1_m)) * robot.length_m == pytest.approx(0.3, rel=0.02)
