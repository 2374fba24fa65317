"""The safety machine by itself: what it keeps, what it says, and what a board cannot show."""

from __future__ import annotations

import pytest

from firmware_protocol.board_limits import BoardLimits
from firmware_protocol.enumerations import BoardMode, ControlMode, Health, Parameter, SafeReason
from firmware_protocol.parameters import Parameters
from firmware_protocol.safety import BoardFaultRecord, SafetyMachine, Transition

DBC_HASH = 0x12345678


def machine() -> SafetyMachine:
    return SafetyMachine(Parameters(BoardLimits(200e3, 250e3)), challenge_seed=1, dbc_hash=DBC_HASH)


def disarmed(now_us: int = 0) -> SafetyMachine:
    made = machine()
    made.advance(now_us)
    made.measured((0, 0, 0, 0))
    made.control(ControlMode.DISARM, 0, 0)
    assert made.state.mode is BoardMode.DISARMED
    return made


def test_it_wakes_up_latched_with_nothing_commanded_at_time_zero() -> None:
    state = machine().state
    assert (state.mode, state.reason) == (BoardMode.SAFE_LATCHED, SafeReason.POWER_UP)
    assert (state.control_mode, state.setpoints_hPa, state.challenge) == (ControlMode.DISARM, (0, 0, 0, 0), 0)
    assert (state.started_us, state.mode_since_us, state.now_us) == (0, 0, None)
    assert (state.setpoints_us, state.control_us, state.heartbeat_us) == (None, None, None)


def test_a_failure_before_the_first_cycle_is_kept_from_time_zero() -> None:
    made = machine()
    made.latch(SafeReason.INTERNAL_ERROR)
    assert list(made.transitions) == [Transition(0.0, BoardMode.SAFE_LATCHED, SafeReason.INTERNAL_ERROR)]
    assert made.state.mode_since_us == 0


def test_transitions_tell_their_time_in_seconds() -> None:
    made = disarmed(2_500_000)
    assert list(made.transitions) == [Transition(2.5, BoardMode.DISARMED, SafeReason.NONE)]


def test_the_last_eight_faults_and_sixty_four_transitions_are_kept() -> None:
    made = machine()
    for number in range(40):
        made.advance(number)
        made.measured((0, 0, 0, 0))
        made.control(ControlMode.DISARM, 0, 0)
        made.emergency_stop(number)
    assert [fault.detail for fault in made.faults_to_send] == list(range(32, 40))
    assert len(made.transitions) == 64
    assert made.transitions[-1] == Transition(39e-6, BoardMode.SAFE_LATCHED, SafeReason.EMERGENCY_STOP)
    assert made.parameters.values[Parameter.LATCHES] == 40


@pytest.mark.parametrize(("detail", "kept"), [(0xFFFE, 0xFFFE), (0xFFFF, 0xFFFF), (0x10000, 0xFFFF)])
def test_details_fit_sixteen_bits(detail: int, kept: int) -> None:
    made = disarmed()
    made.latch(SafeReason.OVER_PRESSURE, chamber=2, detail=detail)
    assert list(made.faults_to_send) == [BoardFaultRecord(SafeReason.OVER_PRESSURE, 2, kept)]


def test_a_fault_of_no_chamber_and_without_detail_says_so() -> None:
    made = disarmed()
    made.latch(SafeReason.BUS_OFF)
    assert list(made.faults_to_send) == [BoardFaultRecord(SafeReason.BUS_OFF, 15, 0)]


def test_the_time_may_stand_still() -> None:
    made = disarmed(7)
    assert made.advance(7)
    assert not made.advance(6)
    assert made.advance(6)
    assert made.state.now_us == 6


def test_a_machine_at_rest_is_well() -> None:
    assert machine().health(blemished=False) is Health.OK
    assert machine().health(blemished=True) is Health.WARNING
