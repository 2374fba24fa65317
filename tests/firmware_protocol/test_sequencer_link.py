"""The sequencer's end arms a board, gives up when it should, and hands on what the board says."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from firmware_protocol.board import BoardDecision, BoardLimits, BoardRules
from firmware_protocol.bus import drain, opened, send
from firmware_protocol.codec import decode
from firmware_protocol.e2e import FrameStatus, Sender
from firmware_protocol.enumerations import (
    BoardMode,
    BusState,
    ControlMode,
    EmergencyReason,
    FaultKind,
    Health,
    Parameter,
    SafeReason,
    SequencerState,
)
from firmware_protocol.errors import FrameError, LimitsError
from firmware_protocol.frame import Frame
from firmware_protocol.sequencer_link import ErrorCounters, LinkFailure, LinkLimits, LinkState, SequencerLink

SETPOINTS = (10e3, 20e3, 30e3, 40e3)
Filter = Callable[[Frame], bool]


def everything(frame: Frame) -> bool:
    return True


class Loop:
    """Sequencer's link and board's rules in lock-step at 100 Hz; either direction may lose frames."""

    def __init__(self, limits: LinkLimits | None = None) -> None:
        self.link = SequencerLink(limits)
        self.board = BoardRules(BoardLimits(max_setpoint_Pa=200e3, over_pressure_Pa=250e3))
        self.cycle = 0
        self.pressures_Pa = (1e3, 2e3, 3e3, 4e3)
        self.decision: BoardDecision | None = None
        self.to_board: list[Frame] = []
        self.to_link: list[Frame] = []

    @property
    def t_s(self) -> float:
        return self.cycle / 100

    def run(self, duration_s: float, *, up: Filter = everything, down: Filter = everything) -> None:
        for _ in range(round(duration_s * 100)):
            self.to_board = self.link.outgoing(self.t_s, SETPOINTS, SequencerState.ROLLING)
            for frame in filter(down, self.to_board):
                self.board.receive(*frame, self.t_s)
            self.decision = self.board.tick(self.t_s, self.pressures_Pa)
            self.to_link = self.board.outgoing(self.t_s) + self.board.measurements(
                self.t_s,
                pressures_Pa=self.pressures_Pa,
                openings=(0.1, -0.2, 0.3, -0.4),
                supply_pressure_Pa=5e5,
                main_supply_open=self.decision.main_supply_open,
                angular_velocity_rad_s=(0.1, 0.2, 0.3),
                specific_force_m_s2=(0.0, 0.0, 9.81),
            )
            for frame in filter(up, self.to_link):
                self.link.receive(*frame, self.t_s)
            self.cycle += 1

    def armed(self) -> Loop:
        self.link.arm()
        self.run(0.4)
        assert self.link.armed
        return self

    def control_modes(self) -> list[int]:
        return [int(decode(*frame)[1]["Mode"]) for frame in self.to_board if frame.frame_id == 0x100]


def without(*frame_ids: int) -> Filter:
    return lambda frame: frame.frame_id not in frame_ids


def nothing(frame: Frame) -> bool:
    return False


def test_the_handshake_arms_the_board_in_a_fraction_of_a_second() -> None:
    loop = Loop()
    loop.run(0.52)  # between two heartbeats, so that each state lasts a cycle
    assert loop.link.state is LinkState.DISARMED
    assert loop.board.state.mode is BoardMode.DISARMED
    loop.link.arm()
    states = [loop.link.state]
    while not loop.link.armed:
        loop.run(0.01)
        if loop.link.state is not states[-1]:
            states.append(loop.link.state)
        assert loop.cycle < 80
    assert states == [LinkState.CLEARING, LinkState.REQUESTING, LinkState.CONFIRMING, LinkState.ARMED]
    loop.run(0.03)
    assert loop.decision is not None
    assert not loop.decision.safe
    assert loop.decision.setpoints_Pa == pytest.approx(SETPOINTS)
    loop.link.arm()  # no effect when armed
    assert loop.link.armed


def test_setpoints_are_zero_until_armed() -> None:
    loop = Loop()
    loop.run(0.01)
    setpoints = dict(decode(*frame) for frame in loop.to_board)["SequencerSetpoints"]
    assert [setpoints[f"Setpoint{chamber}"] for chamber in range(4)] == [0.0] * 4


def test_readings_are_what_the_board_measured_with_their_ages() -> None:
    loop = Loop()
    assert loop.link.readings.pressures_Pa is None
    assert loop.link.age_s("BoardPressures", 0.0) == math.inf
    loop.armed()
    readings = loop.link.readings
    assert readings.pressures_Pa == pytest.approx(loop.pressures_Pa)
    assert readings.openings == pytest.approx((0.1, -0.2, 0.3, -0.4))
    assert readings.main_supply_open is True
    assert readings.supply_pressure_Pa == pytest.approx(5e5)
    assert readings.sample_time_s == pytest.approx(loop.t_s - 0.01)
    assert readings.angular_velocity_rad_s == pytest.approx((0.1, 0.2, 0.3))
    assert readings.specific_force_m_s2 == pytest.approx((0.0, 0.0, 9.81), abs=0.0026)
    assert readings.board_mode is BoardMode.ARMED
    assert readings.board_version == (0, 1, 0)
    assert readings.board_uptime_s == 0
    assert loop.link.age_s("BoardPressures", loop.t_s + 0.05) == pytest.approx(0.06)


def test_a_second_of_rolling_loses_nothing_and_refuses_nothing() -> None:
    loop = Loop().armed()
    loop.run(1.0)
    for reception in (loop.board.reception, loop.link.reception):
        assert reception.not_listed == 0
        for entry in reception.messages.values():
            assert entry.receiver.lost_frames == 0
            assert sum(n for status, n in entry.counts.items() if not status.accepted) == 0


def test_disarming_vents_the_board() -> None:
    loop = Loop().armed()
    loop.link.disarm()
    loop.run(0.03)
    assert loop.link.state is LinkState.DISARMED
    assert loop.board.state.mode is BoardMode.DISARMED


def test_a_latched_board_fails_the_link_until_it_is_armed_anew() -> None:
    loop = Loop().armed()
    loop.pressures_Pa = (0.0, 0.0, 300e3, 0.0)
    loop.run(0.01)
    assert (loop.link.state, loop.link.failure) == (LinkState.FAILED, LinkFailure.BOARD_LATCHED)
    assert loop.link.readings.last_fault == (SafeReason.OVER_PRESSURE, 2, 3000)
    assert loop.link.readings.safe_reason is SafeReason.OVER_PRESSURE
    loop.pressures_Pa = (0.0,) * 4
    loop.run(0.5)
    assert loop.link.state is LinkState.FAILED
    assert loop.decision is not None
    assert loop.decision.safe
    assert loop.board.state.mode is BoardMode.DISARMED
    loop.armed()
    assert loop.link.failure is LinkFailure.NONE


def test_disarm_leaves_failed() -> None:
    loop = Loop().armed()
    loop.board.report_failure(SafeReason.BUS_OFF)
    loop.run(0.01)
    assert loop.link.readings.last_fault == (SafeReason.BUS_OFF, None, 0)
    loop.link.disarm()
    assert (loop.link.state, loop.link.failure) == (LinkState.DISARMED, LinkFailure.NONE)


def test_a_lost_fault_report_is_made_up_for_by_the_heartbeat() -> None:
    loop = Loop().armed()
    loop.board.report_failure(SafeReason.INTERNAL_ERROR)
    loop.run(0.06, up=without(0x240), down=without(0x100))
    assert loop.link.failure is LinkFailure.BOARD_LATCHED
    assert loop.link.readings.safe_reason is SafeReason.INTERNAL_ERROR


def test_a_board_of_another_dbc_is_not_armed() -> None:
    loop = Loop()
    loop.board.machine.dbc_hash ^= 1
    loop.link.arm()
    modes: list[int] = []
    for _ in range(50):
        loop.run(0.01)
        modes += loop.control_modes()
    assert loop.link.failure is LinkFailure.VERSION_MISMATCH
    assert set(modes) == {ControlMode.DISARM}


def test_without_boot_messages_nothing_is_requested_and_arming_times_out() -> None:
    loop = Loop()
    loop.link.arm()
    loop.run(1.9, up=without(0x260))
    assert loop.link.state is LinkState.CLEARING
    loop.run(0.2, up=without(0x260))
    assert loop.link.failure is LinkFailure.ARMING_TIMEOUT


def test_a_board_that_never_answers_times_out() -> None:
    loop = Loop(LinkLimits(arming_timeout_s=0.3))
    loop.link.arm()
    loop.run(0.35, up=nothing)
    assert loop.link.failure is LinkFailure.ARMING_TIMEOUT


@pytest.mark.parametrize(
    ("lost", "after_s", "failure"),
    [
        ((0x250,), 0.2, LinkFailure.BOARD_SILENT),
        ((0x200,), 0.1, LinkFailure.MEASUREMENTS_MISSING),
        ((0x230,), 0.1, LinkFailure.MEASUREMENTS_MISSING),
        ((0x231,), 0.1, LinkFailure.MEASUREMENTS_MISSING),
    ],
)
def test_an_armed_link_gives_up_when_the_board_falls_silent(
    lost: tuple[int, ...], after_s: float, failure: LinkFailure
) -> None:
    loop = Loop().armed()
    while not any(frame.frame_id == 0x250 for frame in loop.to_link):
        loop.run(0.01)
    loop.run(after_s - 0.01, up=without(*lost))
    assert loop.link.armed
    loop.run(0.02, up=without(*lost))
    assert loop.link.failure is failure
    assert loop.board.state.mode is BoardMode.DISARMED or loop.control_modes() == []


def test_a_sequencer_that_dies_lets_the_board_vent() -> None:
    loop = Loop().armed()
    loop.run(0.1, down=nothing)
    assert loop.decision is not None
    assert loop.decision.safe
    assert loop.decision.reason is SafeReason.COMMAND_TIMEOUT


def test_a_sequencer_that_restarts_takes_the_board_over_only_through_a_new_handshake() -> None:
    loop = Loop().armed()
    loop.link = SequencerLink()
    loop.run(0.05)
    assert loop.decision is not None
    assert loop.decision.safe
    loop.armed()


def test_a_board_that_restarts_fails_the_link() -> None:
    loop = Loop().armed()
    loop.board = BoardRules(loop.board.limits)
    loop.run(0.2)
    assert loop.link.failure in (LinkFailure.BOARD_LATCHED, LinkFailure.BOARD_LOST_MODE)
    assert loop.decision is not None
    assert loop.decision.safe
    loop.armed()


@pytest.mark.parametrize("state", [LinkState.CONFIRMING, LinkState.ARMED])
def test_a_board_disarmed_by_somebody_else_fails_the_link(state: LinkState) -> None:
    link = SequencerLink()
    link.state = state
    heartbeat = {"BoardMode": BoardMode.DISARMED, "SafeReason": 0, "Health": 0, "ArmChallenge": 0, "UptimeS": 0}
    for name in ("BoardPressures", "ImuGyro", "ImuAccelerometer", "BoardHeartbeat"):
        link.reception.messages[name].last_accepted_us = 0
    link.receive(*Sender().send("BoardHeartbeat", heartbeat), 0.0)
    assert link.failure is LinkFailure.BOARD_LOST_MODE


def test_refused_frames_beyond_the_tolerance_fail_the_link() -> None:
    loop = Loop().armed()
    for _ in range(3):
        received = loop.link.receive(0x200, bytes(8), loop.t_s)
        assert received.status is FrameStatus.WRONG_CRC
    assert loop.link.armed
    loop.link.receive(0x200, bytes(8), loop.t_s)
    assert loop.link.failure is LinkFailure.PROTECTION_ERROR


def test_refused_frames_never_reach_the_readings() -> None:
    loop = Loop().armed()
    before = loop.link.readings.pressures_Pa
    frame = next(each for each in loop.to_link if each.frame_id == 0x200)
    loop.link.receive(frame.frame_id, frame.data[:-1] + bytes([frame.data[-1] ^ 0x10]), loop.t_s)
    assert loop.link.readings.pressures_Pa == before


def test_a_clock_that_goes_back_fails_an_active_link_only() -> None:
    loop = Loop().armed()
    loop.link.outgoing(loop.t_s - 0.2, SETPOINTS)
    assert loop.link.failure is LinkFailure.CLOCK_ERROR
    loop.link.disarm()
    loop.link.outgoing(0.0, SETPOINTS)
    assert loop.link.failure is LinkFailure.NONE


def test_an_emergency_stop_is_repeated_and_nothing_clears_it_until_released() -> None:
    loop = Loop().armed()
    loop.link.emergency_stop(EmergencyReason.FAULT_DETECTED)
    loop.link.emergency_stop()  # held: the first reason stays
    loop.run(0.01)
    assert loop.to_board[0].frame_id == 0x010
    assert decode(*loop.to_board[0])[1]["Reason"] == EmergencyReason.FAULT_DETECTED
    assert loop.link.outgoing(loop.t_s - 0.009, SETPOINTS) == []  # not before the minimum gap is over
    for _ in range(50):
        loop.link.arm()
        loop.link.disarm()
        loop.run(0.01)
        assert loop.link.state is LinkState.EMERGENCY_STOP
        assert loop.board.state.mode is BoardMode.SAFE_LATCHED
        assert loop.board.state.reason is SafeReason.EMERGENCY_STOP
        assert 0x010 in [frame.frame_id for frame in loop.to_board]
    loop.link.release_emergency_stop()
    loop.run(0.05)
    assert loop.link.state is LinkState.DISARMED
    assert loop.board.state.mode is BoardMode.DISARMED
    loop.armed()
    loop.link.release_emergency_stop()  # nothing to release
    assert loop.link.armed


def test_a_failed_sequencer_says_so_and_the_board_vents() -> None:
    loop = Loop().armed()
    sent: list[Frame] = []
    for cycle in range(6):
        sent += loop.link.outgoing(loop.t_s + cycle / 100, SETPOINTS, SequencerState.SAFE, Health.FAILED)
    for frame in sent:
        loop.board.receive(*frame, loop.t_s)
    assert loop.board.state.reason is SafeReason.SEQUENCER_FAILED


@pytest.mark.parametrize(("cycles", "in_turn"), [(0, [0, 1, 0, 1]), (1, [1, 0, 1, 0])])
def test_a_disarm_after_a_run_is_sent_at_once_and_then_in_its_turn(cycles: int, in_turn: list[int]) -> None:
    loop = Loop().armed()
    loop.run(cycles / 100)
    assert loop.decision is not None
    assert loop.decision.main_supply_open
    loop.link.disarm()
    sent = []
    for _ in range(5):
        loop.run(0.01)
        assert not loop.decision.main_supply_open
        sent.append([decode(*frame)[1]["Mode"] for frame in loop.to_board if frame.frame_id == 0x100])
    assert sent[0] == [ControlMode.DISARM]
    assert [len(modes) for modes in sent[1:]] == in_turn


def test_fault_reports_go_out_one_after_the_other_at_their_gap() -> None:
    link = SequencerLink()
    link.report_fault(FaultKind.RUPTURE, chamber=2, delay_s=0.1234, confidence=0.97)
    link.report_fault(FaultKind.SUPPLY_LOSS, chamber=None)
    reports = []
    for cycle in range(10):
        for frame in link.outgoing(cycle / 100, SETPOINTS):
            name, signals = decode(*frame)
            if name == "SequencerFault":
                reports.append((cycle, signals["Kind"], signals["Chamber"], signals["DelayMs"]))
    assert reports == [(0, FaultKind.RUPTURE, 2, 123), (5, FaultKind.SUPPLY_LOSS, 15, 0)]


def test_messages_keep_their_cycles_and_priority() -> None:
    link = SequencerLink()
    names = []
    for cycle in range(100):
        frames = link.outgoing(cycle / 100, SETPOINTS)
        assert [frame.frame_id for frame in frames] == sorted(frame.frame_id for frame in frames)
        names += [decode(*frame)[0] for frame in frames]
    assert names.count("SequencerSetpoints") == 100
    assert names.count("SequencerControl") == 50
    assert names.count("SequencerHeartbeat") == 20


def test_a_setpoint_the_frame_cannot_carry_is_refused() -> None:
    loop = Loop().armed()
    with pytest.raises(FrameError, match=r"SequencerSetpoints\.Setpoint1 = -1\.0 is out of range"):
        loop.link.outgoing(loop.t_s, (0.0, -1e3, 0.0, 0.0))


@pytest.mark.parametrize("name", ["measurement_timeout_s", "heartbeat_timeout_s", "arming_timeout_s"])
@pytest.mark.parametrize("value", [0.0, 61.0, math.nan])
def test_limits_that_mean_nothing_are_refused(name: str, value: float) -> None:
    with pytest.raises(LimitsError, match=name):
        LinkLimits(**{name: value})


@pytest.mark.parametrize(("version", "armed"), [((0, 9, 9), True), ((1, 0, 0), False)])
def test_firmware_of_another_major_version_is_not_armed(version: tuple[int, int, int], armed: bool) -> None:
    loop = Loop()
    loop.board.version = version
    loop.link.arm()
    loop.run(0.5)
    assert loop.link.armed == armed
    assert loop.link.failure is (LinkFailure.NONE if armed else LinkFailure.VERSION_MISMATCH)
    assert LinkLimits(board_version_major=1).board_version_major == 1


def test_parameters_are_read_and_lowered_through_the_link() -> None:
    loop = Loop()
    loop.link.parameters.read(Parameter.OVER_PRESSURE)
    loop.link.parameters.write(Parameter.MAX_SETPOINT, 150)
    loop.run(0.1)
    assert loop.link.parameters.values == {Parameter.OVER_PRESSURE: 2500, Parameter.MAX_SETPOINT: 150}
    loop.armed()
    assert loop.decision is not None
    assert loop.decision.setpoints_Pa == (10e3, 15e3, 15e3, 15e3)


def test_the_boards_clock_is_measured_and_forgotten_when_a_clock_jumps() -> None:
    loop = Loop()
    assert loop.link.clock.best is None
    loop.run(0.05)
    assert loop.link.clock.best == (0, 0)
    loop.link.outgoing(0.0, SETPOINTS)
    assert loop.link.clock.best is None


def test_each_end_learns_the_other_ends_errors_and_the_boards_health() -> None:
    loop = Loop()
    loop.run(0.02)
    assert loop.link.readings.board_health is Health.OK
    assert loop.link.readings.board_errors == (BusState.ERROR_ACTIVE, 0, 0, 0, 0)
    loop.board.receive(0x110, bytes(8), loop.t_s)
    loop.board.receive(0x7FF, b"", loop.t_s)
    loop.board.report_bus(BusState.ERROR_PASSIVE, 130, 5)
    loop.link.receive(0x200, bytes(8), loop.t_s)
    loop.link.report_bus(BusState.ERROR_PASSIVE, 12, 140)
    said: list[dict[str, float]] = []
    for _ in range(110):
        loop.run(0.01)
        said += [decode(*frame)[1] for frame in loop.to_board if frame.frame_id == 0x160]
    assert loop.link.readings.board_errors == ErrorCounters(BusState.ERROR_PASSIVE, 130, 5, 1, 1)
    assert loop.link.readings.board_health is Health.DEGRADED
    assert len(said) == 1
    assert [said[0][name] for name in ("BusState", "TransmitErrors", "ReceiveErrors")] == [1, 12, 140]
    assert [said[0][name] for name in ("ProtectionErrors", "RefusedFrames")] == [1, 0]


def test_a_clock_that_went_back_delays_neither_stop_nor_reports() -> None:
    link = SequencerLink()
    link.report_fault(FaultKind.LEAK, chamber=0)
    link.emergency_stop()
    link.outgoing(100.0, SETPOINTS)
    link.report_fault(FaultKind.LEAK, chamber=1)
    frames = [frame.frame_id for frame in link.outgoing(1.0, SETPOINTS)]
    assert 0x010 in frames
    assert 0x130 not in frames
    assert 0x130 in [frame.frame_id for frame in link.outgoing(1.05, SETPOINTS)]


def test_two_nodes_arm_over_a_virtual_bus_and_the_plant_obeys() -> None:
    link = SequencerLink()
    board = BoardRules(BoardLimits(max_setpoint_Pa=200e3, over_pressure_Pa=250e3))
    link.arm()
    pressures_Pa = [0.0] * 4
    with opened("virtual", "arming") as sequencer_bus, opened("virtual", "arming") as board_bus:
        for cycle in range(100):
            t_s = cycle / 100
            send(sequencer_bus, link.outgoing(t_s, SETPOINTS), t_s)
            for frame, stamp_s in drain(board_bus):
                assert stamp_s == t_s
                board.receive(*frame, t_s)
            decision = board.tick(t_s, pressures_Pa)
            for chamber, setpoint_Pa in enumerate(decision.setpoints_Pa):
                pressures_Pa[chamber] += 0.3 * (setpoint_Pa - pressures_Pa[chamber])
            send(board_bus, board.outgoing(t_s), t_s)
            send(
                board_bus,
                board.measurements(
                    t_s,
                    pressures_Pa=pressures_Pa,
                    openings=(0.0,) * 4,
                    supply_pressure_Pa=5e5,
                    main_supply_open=decision.main_supply_open,
                    angular_velocity_rad_s=(0.0,) * 3,
                    specific_force_m_s2=(0.0,) * 3,
                ),
                t_s,
            )
            for frame, _ in drain(sequencer_bus):
                assert link.receive(*frame, t_s).status.accepted
    assert link.armed
    assert link.readings.pressures_Pa == pytest.approx(SETPOINTS, abs=100)
