"""The only way out of the safe state: disarm, challenge, token, run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from firmware_protocol.board import VENTED, BoardDecision, Transition
from firmware_protocol.codec import dbc_hash
from firmware_protocol.enumerations import BoardMode, ControlMode, SafeReason
from firmware_protocol.frame import Frame
from firmware_protocol.spec import message_spec

NewBench = Callable[..., Any]


def test_power_up_is_safe_and_stays_so_whatever_is_commanded(new_bench: NewBench) -> None:
    bench = new_bench()
    bench.assert_latched(SafeReason.POWER_UP)


def test_disarm_needs_measured_pressures_first(new_bench: NewBench) -> None:
    bench = new_bench()
    bench.control(ControlMode.DISARM)
    assert bench.mode is BoardMode.SAFE_LATCHED
    bench.disarmed()


def test_the_handshake_arms_and_run_lets_setpoints_act(new_bench: NewBench) -> None:
    bench = new_bench().armed()
    bench.setpoints()
    assert bench.tick() == BoardDecision(BoardMode.ARMED, True, SafeReason.NONE, VENTED, False)
    bench.control(ControlMode.RUN)
    decision = bench.tick()
    assert (decision.mode, decision.safe, decision.main_supply_open) == (BoardMode.ARMED, False, True)
    assert decision.setpoints_Pa == pytest.approx((100e3, 101e3, 102e3, 103e3))
    bench.control(ControlMode.ARM_CONFIRM)  # pause: vented, still armed
    assert bench.tick() == BoardDecision(BoardMode.ARMED, True, SafeReason.NONE, VENTED, False)
    assert list(bench.rules.transitions) == [
        Transition(0.0, mode, SafeReason.NONE) for mode in (BoardMode.DISARMED, BoardMode.ARMING, BoardMode.ARMED)
    ]


def test_setpoints_from_before_arming_are_forgotten(new_bench: NewBench) -> None:
    bench = new_bench().arming()
    bench.setpoints()
    bench.control(ControlMode.ARM_CONFIRM, bench.token())
    bench.control(ControlMode.RUN)
    assert bench.tick().setpoints_Pa == VENTED


def test_a_disarmed_board_ignores_confirm_and_run(new_bench: NewBench) -> None:
    bench = new_bench().disarmed()
    for mode in (ControlMode.ARM_CONFIRM, ControlMode.RUN):
        bench.control(mode, bench.token())
        assert bench.mode is BoardMode.DISARMED
        assert bench.tick().safe


def test_a_repeated_request_keeps_the_challenge_and_a_new_handshake_changes_it(new_bench: NewBench) -> None:
    bench = new_bench().arming()
    challenge = bench.rules.state.challenge
    assert challenge != 0
    bench.control(ControlMode.ARM_REQUEST)
    assert bench.rules.state.challenge == challenge
    bench.control(ControlMode.DISARM)
    assert bench.rules.state.challenge == 0
    bench.control(ControlMode.ARM_REQUEST)
    assert bench.rules.state.challenge not in (0, challenge)


@pytest.mark.parametrize("error", [1, 0x8000])
def test_a_wrong_token_latches(new_bench: NewBench, error: int) -> None:
    bench = new_bench().arming()
    bench.control(ControlMode.ARM_CONFIRM, bench.token() ^ error)
    bench.assert_latched(SafeReason.ARMING_REFUSED)


def test_the_token_of_an_earlier_challenge_is_refused(new_bench: NewBench) -> None:
    bench = new_bench().arming()
    old = bench.token()
    bench.control(ControlMode.DISARM)
    bench.control(ControlMode.ARM_REQUEST)
    bench.control(ControlMode.ARM_CONFIRM, old)
    bench.assert_latched(SafeReason.ARMING_REFUSED)


def test_run_before_the_token_latches(new_bench: NewBench) -> None:
    bench = new_bench().arming()
    bench.control(ControlMode.RUN, bench.token())
    bench.assert_latched(SafeReason.UNEXPECTED_MODE)


def test_arming_needs_a_recent_heartbeat(new_bench: NewBench) -> None:
    for age_s in (None, 0.2, 0.19):
        bench = new_bench().disarmed()
        if age_s is not None:
            bench.heartbeat()
            bench.t_s = age_s
        bench.control(ControlMode.ARM_REQUEST)
        bench.control(ControlMode.ARM_CONFIRM, bench.token())
        if age_s == 0.19:
            assert bench.mode is BoardMode.ARMED
        else:
            bench.assert_latched(SafeReason.HEARTBEAT_TIMEOUT)


def test_a_handshake_that_is_not_finished_in_time_latches(new_bench: NewBench) -> None:
    bench = new_bench().arming()
    bench.t_s = 0.999
    bench.tick()
    assert bench.mode is BoardMode.ARMING
    bench.t_s = 1.0
    bench.control(ControlMode.ARM_CONFIRM, bench.token())  # the right token, too late
    assert bench.faults()[0]["Detail"] == 1000
    bench.assert_latched(SafeReason.ARMING_TIMEOUT)


@pytest.mark.parametrize("stage", ["disarmed", "arming", "armed", "running"])
def test_another_dbc_is_refused_but_may_always_disarm(new_bench: NewBench, stage: str) -> None:
    other = dbc_hash() ^ 1
    bench = getattr(new_bench(), stage)()
    bench.control(ControlMode.DISARM, peer_hash=other)
    assert bench.mode is BoardMode.DISARMED
    bench = getattr(new_bench(), stage)()
    bench.control(ControlMode.ARM_REQUEST, peer_hash=other)
    assert bench.faults()[0] | {"Crc": 0} == {
        "Crc": 0,
        "Counter": 0,
        "Reason": SafeReason.VERSION_MISMATCH,
        "Chamber": 15,
        "Detail": other & 0xFFFF,
    }
    bench.assert_latched(SafeReason.VERSION_MISMATCH)


def test_an_armed_board_asked_to_arm_again_latches(new_bench: NewBench) -> None:
    bench = new_bench().running()
    bench.control(ControlMode.ARM_REQUEST)
    bench.assert_latched(SafeReason.UNEXPECTED_MODE)


@pytest.mark.parametrize(("mode", "wanted"), [("disarmed", ControlMode.DISARM), ("arming", ControlMode.ARM_REQUEST)])
def test_refused_frames_are_forgiven_only_when_a_handshake_begins(
    python_bench: Any, mode: str, wanted: ControlMode
) -> None:
    bench = getattr(python_bench, mode)()
    bench.put(Frame(message_spec("SequencerSetpoints").frame_id, bytes(8)))
    assert bench.rules.reception.blemished
    bench.control(wanted)
    assert bench.rules.reception.blemished
    if mode == "disarmed":
        bench.control(ControlMode.ARM_REQUEST)
        assert bench.mode is BoardMode.ARMING
        assert not bench.rules.reception.blemished


def test_a_clock_that_went_back_forgets_when_frames_came(python_bench: Any) -> None:
    bench = python_bench
    bench.t_s = 5.0
    bench.disarmed().heartbeat()
    assert bench.rules.reception.age_us("SequencerHeartbeat", 5_100_000) == 100_000
    bench.t_s = 1.0
    bench.tick()
    assert bench.rules.reception.age_us("SequencerHeartbeat", 1_000_000) is None
