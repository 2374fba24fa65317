"""Every way into the board's safe state."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from firmware_protocol.board import VENTED, BoardDecision, BoardLimits
from firmware_protocol.codec import dbc_hash
from firmware_protocol.e2e import FrameStatus
from firmware_protocol.enumerations import BoardMode, BusState, ControlMode, Health, SafeReason
from firmware_protocol.frame import Frame
from firmware_protocol.reception import ReceptionLimits

NewBench = Callable[..., Any]


@pytest.mark.parametrize(
    ("missing", "timeout_s", "reason"),
    [
        ("SequencerSetpoints", 0.1, SafeReason.COMMAND_TIMEOUT),
        ("SequencerControl", 0.1, SafeReason.COMMAND_TIMEOUT),
        ("SequencerHeartbeat", 0.2, SafeReason.HEARTBEAT_TIMEOUT),
    ],
)
def test_a_missing_message_latches_exactly_at_its_timeout(
    new_bench: NewBench, missing: str, timeout_s: float, reason: SafeReason
) -> None:
    bench = new_bench().running()
    bench.wait(0.5)
    assert not bench.wait(timeout_s - 0.01, without=missing).safe
    assert bench.wait(0.01, without=missing).safe
    assert bench.faults()[0]["Detail"] == timeout_s * 1000
    bench.assert_latched(reason)


@pytest.mark.parametrize("missing", ["SequencerSetpoints", "SequencerControl"])
def test_after_arming_the_commands_have_one_timeout_to_start(new_bench: NewBench, missing: str) -> None:
    bench = new_bench().armed()
    bench.wait(0.09, without=missing)
    assert bench.mode is BoardMode.ARMED
    bench.wait(0.01, without=missing)
    bench.assert_latched(SafeReason.COMMAND_TIMEOUT)


def test_a_late_frame_does_not_hide_that_it_was_late(new_bench: NewBench) -> None:
    bench = new_bench().running()
    bench.t_s = 0.1
    bench.control(ControlMode.RUN)  # comes before the tick that would have seen the timeout
    bench.setpoints()
    bench.assert_latched(SafeReason.COMMAND_TIMEOUT)


@pytest.mark.parametrize("stage", ["disarmed", "arming"])
def test_silence_matters_only_to_an_armed_board(new_bench: NewBench, stage: str) -> None:
    bench = getattr(new_bench(), stage)()
    bench.t_s = 0.9
    assert bench.tick().reason is SafeReason.NONE


@pytest.mark.parametrize("stage", ["disarmed", "arming", "armed", "running"])
def test_an_emergency_stop_latches_in_every_mode(new_bench: NewBench, stage: str) -> None:
    bench = getattr(new_bench(), stage)()
    assert bench.stop() is FrameStatus.OK
    assert bench.faults()[0]["Detail"] == 3
    bench.assert_latched(SafeReason.EMERGENCY_STOP)


def test_an_emergency_stop_counts_whatever_its_counter_but_not_with_a_wrong_crc(new_bench: NewBench) -> None:
    bench = new_bench().running()
    frame = bench.peer.send("EmergencyStop", {"Reason": 0})
    corrupt = Frame(frame.frame_id, bytes([frame.data[0] ^ 4, frame.data[1]]))
    assert bench.put(corrupt) is FrameStatus.WRONG_CRC
    assert not bench.tick().safe
    bench.put(frame)
    bench.disarmed()
    bench.put(frame)
    bench.assert_latched(SafeReason.EMERGENCY_STOP)


@pytest.mark.parametrize("stage", ["disarmed", "arming", "armed", "running"])
@pytest.mark.parametrize("chamber", range(4))
def test_over_pressure_latches_and_holds_until_it_is_gone(new_bench: NewBench, stage: str, chamber: int) -> None:
    bench = getattr(new_bench(), stage)()
    pressures = [0.0] * 4
    pressures[chamber] = 250e3
    bench.measured_Pa = pressures
    bench.tick()
    assert bench.mode is not BoardMode.SAFE_LATCHED  # at the limit, not above it
    pressures[chamber] = 250.6e3
    bench.tick()
    fault = bench.faults()[0]
    assert (fault["Chamber"], fault["Detail"]) == (chamber, 2506)
    bench.assert_latched(SafeReason.OVER_PRESSURE)
    bench.control(ControlMode.DISARM)
    bench.assert_latched(SafeReason.OVER_PRESSURE)
    pressures[chamber] = 0.0
    bench.disarmed()


def test_an_absurd_pressure_still_makes_a_fault_frame(new_bench: NewBench) -> None:
    bench = new_bench().running()
    bench.measured_Pa = (0.0, 1e12, 0.0, 0.0)
    bench.tick()
    assert bench.faults()[0]["Detail"] == 0xFFFF


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_pressure_that_is_not_finite_latches(new_bench: NewBench, value: float) -> None:
    bench = new_bench().running()
    bench.measured_Pa = (0.0, 0.0, value, 0.0)
    bench.tick()
    assert bench.faults()[0]["Chamber"] == 2
    bench.assert_latched(SafeReason.SENSOR_INVALID)


@pytest.mark.parametrize("name", ["SequencerControl", "SequencerSetpoints", "SequencerHeartbeat"])
@pytest.mark.parametrize("defect", ["crc", "length", "repeat"])
def test_refused_frames_beyond_the_tolerance_latch(new_bench: NewBench, name: str, defect: str) -> None:
    limits = BoardLimits(200e3, 250e3, reception=ReceptionLimits(tolerated_errors=3))
    bench = new_bench(limits).running()
    bench.heartbeat()
    signals: dict[str, float] = {
        "SequencerControl": {"Mode": 3, "ArmToken": 0, "DbcHash": dbc_hash()},
        "SequencerSetpoints": {f"Setpoint{chamber}": 1.0 for chamber in range(4)},
        "SequencerHeartbeat": {"State": 2, "Health": 0, "UptimeS": 1},
    }[name]
    good = bench.peer.send(name, signals)
    bench.put(good)
    bad = {
        "crc": Frame(good.frame_id, bytes([good.data[0] ^ 1]) + good.data[1:]),
        "length": Frame(good.frame_id, good.data[:-1]),
        "repeat": good,
    }[defect]
    for _ in range(3):
        assert not FrameStatus(bench.put(bad)).accepted
        assert not bench.tick().safe
    bench.put(bad)
    assert bench.faults()[0]["Detail"] == good.frame_id
    bench.assert_latched(SafeReason.PROTECTION_ERROR)


def test_refused_frames_do_not_move_the_setpoints_nor_count_as_life(new_bench: NewBench) -> None:
    bench = new_bench().running()
    before = bench.tick().setpoints_Pa
    bench.t_s = 0.05
    frame = bench.peer.send("SequencerSetpoints", {f"Setpoint{chamber}": 1.0 for chamber in range(4)})
    bench.put(Frame(frame.frame_id, frame.data[:-1] + bytes([frame.data[-1] ^ 1])))
    assert bench.tick().setpoints_Pa == before
    bench.control(ControlMode.RUN)
    bench.t_s = 0.1
    bench.assert_latched(SafeReason.COMMAND_TIMEOUT)


def test_refused_frames_of_before_do_not_count_against_a_new_handshake(new_bench: NewBench) -> None:
    bench = new_bench().disarmed()
    for _ in range(10):
        bench.put(Frame(0x110, bytes(8)))
    assert bench.mode is BoardMode.DISARMED  # nothing to protect
    bench.heartbeat()
    bench.control(ControlMode.ARM_REQUEST)
    bench.put(Frame(0x110, bytes(8)))
    assert bench.mode is BoardMode.ARMING


def test_foreign_frames_and_the_boards_own_are_ignored(new_bench: NewBench) -> None:
    bench = new_bench().running()
    for frame_id in (0x000, 0x200, 0x240, 0x250, 0x7FF):
        for _ in range(20):
            assert bench.put(Frame(frame_id, bytes(8))) is FrameStatus.NOT_LISTED
    assert not bench.tick().safe


def test_a_sequencer_that_says_it_failed_latches_an_active_board_only(new_bench: NewBench) -> None:
    bench = new_bench().disarmed()
    bench.heartbeat(Health.FAILED)
    assert bench.mode is BoardMode.DISARMED
    for stage in ("arming", "running"):
        bench = getattr(new_bench(), stage)()
        bench.heartbeat(Health.DEGRADED)
        assert bench.mode is not BoardMode.SAFE_LATCHED
        bench.heartbeat(Health.FAILED)
        bench.assert_latched(SafeReason.SEQUENCER_FAILED)


def test_a_fault_report_of_the_sequencer_changes_nothing(new_bench: NewBench) -> None:
    bench = new_bench().running()
    before = bench.tick()
    fault = {"Chamber": 1, "Kind": 1, "DelayMs": 100, "Confidence": 0.9}
    assert bench.put(bench.peer.send("SequencerFault", fault)).accepted
    assert bench.tick() == before


@pytest.mark.parametrize("by_tick", [True, False])
def test_a_clock_that_goes_back_latches(new_bench: NewBench, by_tick: bool) -> None:
    bench = new_bench().running()
    bench.wait(0.05)
    bench.t_s = 0.04
    if by_tick:
        bench.tick()
    else:
        bench.heartbeat()
    bench.assert_latched(SafeReason.CLOCK_ERROR)
    bench.running()  # and the board can be used again afterwards


def test_a_clock_that_jumps_forward_latches(new_bench: NewBench) -> None:
    bench = new_bench().running()
    bench.t_s = 3600.0
    bench.assert_latched(SafeReason.COMMAND_TIMEOUT)


@pytest.mark.parametrize("measured", [(0.0,) * 3, (0.0, None, 0.0, 0.0), None])
def test_the_boards_own_exceptions_end_in_the_safe_state(new_bench: NewBench, measured: object) -> None:
    bench = new_bench().running()
    decision = bench.rules.tick(bench.t_s, measured)  # type: ignore[arg-type]
    assert decision == BoardDecision(BoardMode.SAFE_LATCHED, True, SafeReason.INTERNAL_ERROR, VENTED, False)
    assert "Error: " in bench.rules.state.last_error
    bench.control(ControlMode.DISARM)
    assert bench.mode is BoardMode.SAFE_LATCHED  # pressures are unknown
    bench.disarmed()


def test_an_exception_while_receiving_ends_in_the_safe_state(new_bench: NewBench) -> None:
    bench = new_bench().running()
    assert bench.rules.receive(0x110, bytes(8), math.nan).status is FrameStatus.MALFORMED
    bench.assert_latched(SafeReason.INTERNAL_ERROR)


@pytest.mark.parametrize(("state", "latched"), [(BusState.ERROR_PASSIVE, False), (BusState.BUS_OFF, True)])
def test_bus_off_latches_and_error_passive_does_not(new_bench: NewBench, state: BusState, latched: bool) -> None:
    bench = new_bench().running()
    bench.rules.report_bus(state, transmit_errors=255, receive_errors=3)
    assert bench.tick().safe == latched
    if latched:
        bench.assert_latched(SafeReason.BUS_OFF)


def test_a_timeout_is_reported_as_the_message_that_was_late_first(new_bench: NewBench) -> None:
    bench = new_bench().running()
    bench.t_s = 0.15
    bench.tick()  # setpoints and control are both late, and the heartbeat is not
    assert bench.rules.state.reason is SafeReason.COMMAND_TIMEOUT
    assert len(bench.rules.faults_to_send) == 1


def test_failures_found_elsewhere_latch(new_bench: NewBench) -> None:
    bench = new_bench().running()
    bench.rules.report_failure(SafeReason.BUS_OFF, detail=7)
    assert bench.faults()[0]["Detail"] == 7
    bench.assert_latched(SafeReason.BUS_OFF)


def test_the_first_reason_stays_until_disarmed(new_bench: NewBench) -> None:
    bench = new_bench().running()
    bench.stop()
    bench.measured_Pa = (300e3, 0.0, 0.0, 0.0)
    bench.assert_latched(SafeReason.EMERGENCY_STOP)
    assert len(bench.rules.faults_to_send) == 1


def test_a_latched_board_runs_again_after_a_whole_handshake(new_bench: NewBench) -> None:
    bench = new_bench().running()
    bench.stop()
    bench.assert_latched(SafeReason.EMERGENCY_STOP)
    bench.running()


@pytest.mark.parametrize("stage", ["arming", "armed", "running"])
def test_disarm_vents_at_once(new_bench: NewBench, stage: str) -> None:
    bench = getattr(new_bench(), stage)()
    bench.control(ControlMode.DISARM)
    assert bench.tick() == BoardDecision(BoardMode.DISARMED, True, SafeReason.NONE, VENTED, False)
