"""The safety machine by itself: what it keeps, what it says, and what a board cannot show."""

from __future__ import annotations

import pytest

from firmware_protocol.arming import arm_token
from firmware_protocol.board_limits import BoardLimits
from firmware_protocol.enumerations import NO_CHAMBER, BoardMode, ControlMode, Health, Parameter, SafeReason
from firmware_protocol.parameters import Parameters
from firmware_protocol.safety import BoardFaultRecord, BoardState, SafetyMachine, SENSOR_INVALID_hPa, Transition

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


def confirm(made: SafetyMachine) -> None:
    """Asks to arm and answers the challenge rightly."""
    made.control(ControlMode.ARM_REQUEST, 0, DBC_HASH)
    made.control(ControlMode.ARM_CONFIRM, arm_token(made.state.challenge, DBC_HASH), DBC_HASH)


def armed(now_us: int = 0) -> SafetyMachine:
    made = disarmed(now_us)
    made.heartbeat(Health.OK)
    confirm(made)
    assert made.state.mode is BoardMode.ARMED
    return made


@pytest.mark.parametrize("mode", BoardMode)
@pytest.mark.parametrize("control_mode", ControlMode)
def test_the_valves_leave_their_safe_state_only_armed_and_in_run(mode: BoardMode, control_mode: ControlMode) -> None:
    state = BoardState(challenge_seed=1, mode=mode, control_mode=control_mode)
    assert state.safe is ((mode, control_mode) != (BoardMode.ARMED, ControlMode.RUN))


def test_it_counts_its_time_from_its_first_cycle() -> None:
    made = machine()
    made.advance(5_000_000)
    made.advance(6_000_000)
    assert (made.state.started_us, made.state.mode_since_us) == (5_000_000, 5_000_000)


def test_messages_from_before_a_clock_that_went_back_do_not_count() -> None:
    made = armed(100_000_000)
    made.setpoints((0, 0, 0, 0))
    made.advance(1_000_000)
    assert made.transitions[-1] == Transition(1.0, BoardMode.SAFE_LATCHED, SafeReason.CLOCK_ERROR)
    state = made.state
    assert (state.setpoints_us, state.control_us, state.heartbeat_us) == (None, None, None)
    made.control(ControlMode.DISARM, 0, 0)
    confirm(made)
    assert made.state.reason is SafeReason.HEARTBEAT_TIMEOUT


def test_a_message_may_be_missing_for_its_timeout_after_arming() -> None:
    made = disarmed()
    made.setpoints((0, 0, 0, 0))
    made.advance(5_000_000)
    made.heartbeat(Health.OK)
    confirm(made)
    made.advance(5_099_999)
    assert made.state.mode is BoardMode.ARMED
    made.advance(5_100_000)
    assert made.state.reason is SafeReason.COMMAND_TIMEOUT


def test_what_is_not_safe_can_always_be_disarmed() -> None:
    made = armed()
    made.state.pressures_valid = False
    made.control(ControlMode.DISARM, 0, 0)
    assert made.state.mode is BoardMode.DISARMED


def test_setpoints_for_a_board_that_is_not_armed_are_not_kept() -> None:
    made = disarmed()
    made.setpoints((100, 200, 300, 5000))
    assert made.state.setpoints_hPa == (0, 0, 0, 0)
    assert made.parameters.values[Parameter.SETPOINTS_CLAMPED] == 0


def test_only_setpoints_above_the_limit_count_as_clamped() -> None:
    made = armed()
    limit_hPa = made.parameters.values[Parameter.MAX_SETPOINT]
    made.setpoints((limit_hPa, limit_hPa + 1, limit_hPa - 1, limit_hPa + 100))
    assert made.state.setpoints_hPa == (limit_hPa, limit_hPa, limit_hPa - 1, limit_hPa)
    assert made.parameters.values[Parameter.SETPOINTS_CLAMPED] == 2


@pytest.mark.parametrize("pressures_hPa", [(0, 9999, 0, 0), (0, 0, SENSOR_INVALID_hPa, 0)])
def test_it_stays_latched_while_its_pressures_are_wrong(pressures_hPa: tuple[int, int, int, int]) -> None:
    made = disarmed()
    made.measured(pressures_hPa)
    made.control(ControlMode.DISARM, 0, 0)
    assert made.state.mode is BoardMode.SAFE_LATCHED
    made.measured((0, 0, 0, 0))
    made.control(ControlMode.DISARM, 0, 0)
    assert made.state.mode is BoardMode.DISARMED


def test_a_wrong_number_of_pressures_is_no_valid_measurement() -> None:
    made = disarmed()
    with pytest.raises(ValueError, match="3 measured pressures for 4 chambers"):
        made.measured((0, 0, 0))
    assert not made.state.pressures_valid


def test_a_wrong_answer_to_the_challenge_is_reported_as_such() -> None:
    made = disarmed()
    made.heartbeat(Health.OK)
    made.control(ControlMode.ARM_REQUEST, 0, DBC_HASH)
    made.control(ControlMode.ARM_CONFIRM, arm_token(made.state.challenge, DBC_HASH) ^ 1, DBC_HASH)
    assert made.faults_to_send[-1] == BoardFaultRecord(
        SafeReason.ARMING_REFUSED, NO_CHAMBER, int(ControlMode.ARM_CONFIRM)
    )


@pytest.mark.parametrize("age_us", [199_999, 200_000, 900_123])
def test_arming_needs_a_heartbeat_younger_than_its_timeout(age_us: int) -> None:
    made = disarmed(1_000_000)
    made.heartbeat(Health.OK)
    made.advance(1_000_000 + age_us)
    confirm(made)
    if age_us < 200_000:
        assert made.state.mode is BoardMode.ARMED
    else:
        fault = BoardFaultRecord(SafeReason.HEARTBEAT_TIMEOUT, NO_CHAMBER, age_us // 1000)
        assert made.faults_to_send[-1] == fault


def test_leaving_the_armed_mode_forgets_what_was_commanded() -> None:
    made = armed()
    assert made.state.control_mode is ControlMode.ARM_CONFIRM
    made.control(ControlMode.RUN, 0, DBC_HASH)
    made.setpoints((1, 2, 3, 4))
    assert (made.state.control_mode, made.state.setpoints_hPa) == (ControlMode.RUN, (1, 2, 3, 4))
    made.emergency_stop(0)
    assert (made.state.control_mode, made.state.setpoints_hPa) == (ControlMode.DISARM, (0, 0, 0, 0))


def test_disarming_once_more_changes_nothing() -> None:
    made = disarmed()
    made.advance(1_000)
    made.control(ControlMode.DISARM, 0, 0)
    assert made.state.mode_since_us == 0
    assert len(made.transitions) == 1
