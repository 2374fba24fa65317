"""The board's safety rules: every way into the safe state, and the only way out."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.arming import arm_token
from firmware_protocol.board import VENTED, BoardDecision, BoardLimits, BoardRules, Transition
from firmware_protocol.codec import dbc_hash, decode
from firmware_protocol.e2e import FrameStatus, Sender
from firmware_protocol.enumerations import BoardMode, ControlMode, Health, SafeReason
from firmware_protocol.errors import FrameError, LimitsError
from firmware_protocol.frame import Frame
from firmware_protocol.reception import ReceptionLimits

LIMITS = BoardLimits(max_setpoint_Pa=200e3, over_pressure_Pa=250e3)
REST = (0.0, 0.0, 0.0, 0.0)
CYCLE_S = 0.01


class Bench:
    """A board with a peer whose every frame the test decides."""

    def __init__(self, limits: BoardLimits = LIMITS) -> None:
        self.rules = BoardRules(limits)
        self.peer = Sender()
        self.t_s = 0.0
        self.measured_Pa: Sequence[float] = REST

    def put(self, frame: Frame) -> FrameStatus:
        return self.rules.receive(frame.frame_id, frame.data, self.t_s).status

    def control(self, mode: int, token: int = 0, peer_hash: int | None = None) -> FrameStatus:
        signals = {"Mode": mode, "ArmToken": token, "DbcHash": dbc_hash() if peer_hash is None else peer_hash}
        return self.put(self.peer.send("SequencerControl", signals))

    def setpoints(self, pressure_kPa: float = 100.0) -> FrameStatus:
        signals = {f"Setpoint{chamber}": pressure_kPa + chamber for chamber in range(4)}
        return self.put(self.peer.send("SequencerSetpoints", signals))

    def heartbeat(self, health: Health = Health.OK) -> FrameStatus:
        return self.put(self.peer.send("SequencerHeartbeat", {"State": 2, "Health": health, "UptimeS": 1}))

    def stop(self) -> FrameStatus:
        return self.put(self.peer.send("EmergencyStop", {"Reason": 3}))

    def tick(self) -> BoardDecision:
        return self.rules.tick(self.t_s, self.measured_Pa)

    def token(self) -> int:
        return arm_token(self.rules.state.challenge, dbc_hash())

    def disarmed(self) -> Bench:
        self.tick()
        self.control(ControlMode.DISARM)
        assert self.mode is BoardMode.DISARMED
        return self

    def arming(self) -> Bench:
        self.disarmed().heartbeat()
        self.control(ControlMode.ARM_REQUEST)
        assert self.mode is BoardMode.ARMING
        return self

    def armed(self) -> Bench:
        self.arming().control(ControlMode.ARM_CONFIRM, self.token())
        assert self.mode is BoardMode.ARMED
        return self

    def running(self) -> Bench:
        self.armed().control(ControlMode.RUN)
        self.setpoints()
        assert not self.tick().safe
        return self

    def wait(self, duration_s: float, *, without: str = "") -> BoardDecision:
        """Runs on with all commands but one for `duration_s` in cycles of 10 ms."""
        for _ in range(round(duration_s / CYCLE_S)):
            self.t_s = round(self.t_s + CYCLE_S, 6)
            if without != "SequencerControl":
                self.control(ControlMode.RUN)
            if without != "SequencerSetpoints":
                self.setpoints()
            if without != "SequencerHeartbeat":
                self.heartbeat()
            self.tick()
        return self.tick()

    @property
    def mode(self) -> BoardMode:
        return self.rules.state.mode

    @property
    def reason(self) -> SafeReason:
        return self.rules.state.reason

    def faults(self) -> list[dict[str, float]]:
        decoded = [decode(*frame) for frame in self.rules.outgoing(self.t_s)]
        return [signals for name, signals in decoded if name == "BoardFault"]


def assert_latched(bench: Bench, reason: SafeReason) -> None:
    decision = bench.tick()
    assert decision == BoardDecision(BoardMode.SAFE_LATCHED, True, reason, VENTED, False)
    # Nothing but disarm leads out.
    for mode in (ControlMode.ARM_REQUEST, ControlMode.ARM_CONFIRM, ControlMode.RUN):
        bench.control(mode, bench.token())
        bench.setpoints()
        bench.heartbeat()
        assert bench.tick() == decision


# ---------------------------------------------------------------------- start and handshake


def test_power_up_is_safe_and_stays_so_whatever_is_commanded() -> None:
    bench = Bench()
    assert_latched(bench, SafeReason.POWER_UP)


def test_disarm_needs_measured_pressures_first() -> None:
    bench = Bench()
    bench.control(ControlMode.DISARM)
    assert bench.mode is BoardMode.SAFE_LATCHED
    bench.disarmed()


def test_the_handshake_arms_and_run_lets_setpoints_act() -> None:
    bench = Bench().armed()
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


def test_setpoints_from_before_arming_are_forgotten() -> None:
    bench = Bench().arming()
    bench.setpoints()
    bench.control(ControlMode.ARM_CONFIRM, bench.token())
    bench.control(ControlMode.RUN)
    assert bench.tick().setpoints_Pa == VENTED


def test_a_disarmed_board_ignores_confirm_and_run() -> None:
    bench = Bench().disarmed()
    for mode in (ControlMode.ARM_CONFIRM, ControlMode.RUN):
        bench.control(mode, bench.token())
        assert bench.mode is BoardMode.DISARMED
        assert bench.tick().safe


def test_a_repeated_request_keeps_the_challenge_and_a_new_handshake_changes_it() -> None:
    bench = Bench().arming()
    challenge = bench.rules.state.challenge
    assert challenge != 0
    bench.control(ControlMode.ARM_REQUEST)
    assert bench.rules.state.challenge == challenge
    bench.control(ControlMode.DISARM)
    assert bench.rules.state.challenge == 0
    bench.control(ControlMode.ARM_REQUEST)
    assert bench.rules.state.challenge not in (0, challenge)


@pytest.mark.parametrize("error", [1, 0x8000])
def test_a_wrong_token_latches(error: int) -> None:
    bench = Bench().arming()
    bench.control(ControlMode.ARM_CONFIRM, bench.token() ^ error)
    assert_latched(bench, SafeReason.ARMING_REFUSED)


def test_the_token_of_an_earlier_challenge_is_refused() -> None:
    bench = Bench().arming()
    old = bench.token()
    bench.control(ControlMode.DISARM)
    bench.control(ControlMode.ARM_REQUEST)
    bench.control(ControlMode.ARM_CONFIRM, old)
    assert_latched(bench, SafeReason.ARMING_REFUSED)


def test_run_before_the_token_latches() -> None:
    bench = Bench().arming()
    bench.control(ControlMode.RUN, bench.token())
    assert_latched(bench, SafeReason.UNEXPECTED_MODE)


def test_arming_needs_a_recent_heartbeat() -> None:
    for age_s in (None, 0.2, 0.19):
        bench = Bench().disarmed()
        if age_s is not None:
            bench.heartbeat()
            bench.t_s = age_s
        bench.control(ControlMode.ARM_REQUEST)
        bench.control(ControlMode.ARM_CONFIRM, bench.token())
        if age_s == 0.19:
            assert bench.mode is BoardMode.ARMED
        else:
            assert_latched(bench, SafeReason.HEARTBEAT_TIMEOUT)


def test_a_handshake_that_is_not_finished_in_time_latches() -> None:
    bench = Bench().arming()
    bench.t_s = 0.999
    bench.tick()
    assert bench.mode is BoardMode.ARMING
    bench.t_s = 1.0
    bench.control(ControlMode.ARM_CONFIRM, bench.token())  # the right token, too late
    assert bench.faults()[0]["Detail"] == 1000
    assert_latched(bench, SafeReason.ARMING_TIMEOUT)


@pytest.mark.parametrize("stage", ["disarmed", "arming", "armed", "running"])
def test_another_dbc_is_refused_but_may_always_disarm(stage: str) -> None:
    other = dbc_hash() ^ 1
    bench: Bench = getattr(Bench(), stage)()
    bench.control(ControlMode.DISARM, peer_hash=other)
    assert bench.mode is BoardMode.DISARMED
    bench = getattr(Bench(), stage)()
    bench.control(ControlMode.ARM_REQUEST, peer_hash=other)
    assert bench.faults()[0] | {"Crc": 0} == {
        "Crc": 0,
        "Counter": 0,
        "Reason": SafeReason.VERSION_MISMATCH,
        "Chamber": 15,
        "Detail": other & 0xFFFF,
    }
    assert_latched(bench, SafeReason.VERSION_MISMATCH)


def test_an_armed_board_asked_to_arm_again_latches() -> None:
    bench = Bench().running()
    bench.control(ControlMode.ARM_REQUEST)
    assert_latched(bench, SafeReason.UNEXPECTED_MODE)


# ---------------------------------------------------------------------- timeouts


@pytest.mark.parametrize(
    ("missing", "timeout_s", "reason"),
    [
        ("SequencerSetpoints", 0.1, SafeReason.COMMAND_TIMEOUT),
        ("SequencerControl", 0.1, SafeReason.COMMAND_TIMEOUT),
        ("SequencerHeartbeat", 0.2, SafeReason.HEARTBEAT_TIMEOUT),
    ],
)
def test_a_missing_message_latches_exactly_at_its_timeout(missing: str, timeout_s: float, reason: SafeReason) -> None:
    bench = Bench().running()
    bench.wait(0.5)
    assert not bench.wait(timeout_s - CYCLE_S, without=missing).safe
    assert bench.wait(CYCLE_S, without=missing).safe
    assert bench.faults()[0]["Detail"] == timeout_s * 1000
    assert_latched(bench, reason)


@pytest.mark.parametrize("missing", ["SequencerSetpoints", "SequencerControl"])
def test_after_arming_the_commands_have_one_timeout_to_start(missing: str) -> None:
    bench = Bench().armed()
    bench.wait(0.09, without=missing)
    assert bench.mode is BoardMode.ARMED
    bench.wait(0.01, without=missing)
    assert_latched(bench, SafeReason.COMMAND_TIMEOUT)


def test_a_late_frame_does_not_hide_that_it_was_late() -> None:
    bench = Bench().running()
    bench.t_s = 0.1
    bench.control(ControlMode.RUN)  # comes before the tick that would have seen the timeout
    bench.setpoints()
    assert_latched(bench, SafeReason.COMMAND_TIMEOUT)


@pytest.mark.parametrize("stage", ["disarmed", "arming"])
def test_silence_matters_only_to_an_armed_board(stage: str) -> None:
    bench: Bench = getattr(Bench(), stage)()
    bench.t_s = 0.9
    assert bench.tick().reason is SafeReason.NONE


# ---------------------------------------------------------------------- other ways into the safe state


@pytest.mark.parametrize("stage", ["disarmed", "arming", "armed", "running"])
def test_an_emergency_stop_latches_in_every_mode(stage: str) -> None:
    bench: Bench = getattr(Bench(), stage)()
    assert bench.stop() is FrameStatus.OK
    assert bench.faults()[0]["Detail"] == 3
    assert_latched(bench, SafeReason.EMERGENCY_STOP)


def test_an_emergency_stop_counts_whatever_its_counter_but_not_with_a_wrong_crc() -> None:
    bench = Bench().running()
    frame = bench.peer.send("EmergencyStop", {"Reason": 0})
    corrupt = Frame(frame.frame_id, bytes([frame.data[0] ^ 4, frame.data[1]]))
    assert bench.put(corrupt) is FrameStatus.WRONG_CRC
    assert not bench.tick().safe
    bench.put(frame)
    bench.disarmed()
    bench.put(frame)
    assert_latched(bench, SafeReason.EMERGENCY_STOP)


@pytest.mark.parametrize("stage", ["disarmed", "arming", "armed", "running"])
@pytest.mark.parametrize("chamber", range(4))
def test_over_pressure_latches_and_holds_until_it_is_gone(stage: str, chamber: int) -> None:
    bench: Bench = getattr(Bench(), stage)()
    pressures = [0.0] * 4
    pressures[chamber] = 250e3
    bench.measured_Pa = pressures
    bench.tick()
    assert bench.mode is not BoardMode.SAFE_LATCHED  # at the limit, not above it
    pressures[chamber] = 250.6e3
    bench.tick()
    fault = bench.faults()[0]
    assert (fault["Chamber"], fault["Detail"]) == (chamber, 2506)
    assert_latched(bench, SafeReason.OVER_PRESSURE)
    bench.control(ControlMode.DISARM)
    assert_latched(bench, SafeReason.OVER_PRESSURE)
    pressures[chamber] = 0.0
    bench.disarmed()


def test_an_absurd_pressure_still_makes_a_fault_frame() -> None:
    bench = Bench().running()
    bench.measured_Pa = (0.0, 1e12, 0.0, 0.0)
    bench.tick()
    assert bench.faults()[0]["Detail"] == 0xFFFF


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_pressure_that_is_not_finite_latches(value: float) -> None:
    bench = Bench().running()
    bench.measured_Pa = (0.0, 0.0, value, 0.0)
    bench.tick()
    assert bench.faults()[0]["Chamber"] == 2
    assert_latched(bench, SafeReason.SENSOR_INVALID)


@pytest.mark.parametrize("name", ["SequencerControl", "SequencerSetpoints", "SequencerHeartbeat"])
@pytest.mark.parametrize("defect", ["crc", "length", "repeat"])
def test_refused_frames_beyond_the_tolerance_latch(name: str, defect: str) -> None:
    limits = BoardLimits(200e3, 250e3, reception=ReceptionLimits(tolerated_errors=3))
    bench = Bench(limits).running()
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
    assert_latched(bench, SafeReason.PROTECTION_ERROR)


def test_refused_frames_do_not_move_the_setpoints_nor_count_as_life() -> None:
    bench = Bench().running()
    before = bench.tick().setpoints_Pa
    bench.t_s = 0.05
    frame = bench.peer.send("SequencerSetpoints", {f"Setpoint{chamber}": 1.0 for chamber in range(4)})
    bench.put(Frame(frame.frame_id, frame.data[:-1] + bytes([frame.data[-1] ^ 1])))
    assert bench.tick().setpoints_Pa == before
    bench.control(ControlMode.RUN)
    bench.t_s = 0.1
    assert_latched(bench, SafeReason.COMMAND_TIMEOUT)


def test_refused_frames_of_before_do_not_count_against_a_new_handshake() -> None:
    bench = Bench().disarmed()
    for _ in range(10):
        bench.put(Frame(0x110, bytes(8)))
    assert bench.mode is BoardMode.DISARMED  # nothing to protect
    bench.heartbeat()
    bench.control(ControlMode.ARM_REQUEST)
    bench.put(Frame(0x110, bytes(8)))
    assert bench.mode is BoardMode.ARMING


def test_foreign_frames_and_the_boards_own_are_ignored() -> None:
    bench = Bench().running()
    for frame_id in (0x000, 0x200, 0x240, 0x250, 0x7FF):
        for _ in range(20):
            assert bench.put(Frame(frame_id, bytes(8))) is FrameStatus.NOT_LISTED
    assert not bench.tick().safe


def test_a_sequencer_that_says_it_failed_latches_an_active_board_only() -> None:
    bench = Bench().disarmed()
    bench.heartbeat(Health.FAILED)
    assert bench.mode is BoardMode.DISARMED
    for stage in ("arming", "running"):
        bench = getattr(Bench(), stage)()
        bench.heartbeat(Health.DEGRADED)
        assert bench.mode is not BoardMode.SAFE_LATCHED
        bench.heartbeat(Health.FAILED)
        assert_latched(bench, SafeReason.SEQUENCER_FAILED)


def test_a_fault_report_of_the_sequencer_changes_nothing() -> None:
    bench = Bench().running()
    before = bench.tick()
    fault = {"Chamber": 1, "Kind": 1, "DelayMs": 100, "Confidence": 0.9}
    assert bench.put(bench.peer.send("SequencerFault", fault)).accepted
    assert bench.tick() == before


@pytest.mark.parametrize("by_tick", [True, False])
def test_a_clock_that_goes_back_latches(by_tick: bool) -> None:
    bench = Bench().running()
    bench.wait(0.05)
    bench.t_s = 0.04
    if by_tick:
        bench.tick()
    else:
        bench.heartbeat()
    assert_latched(bench, SafeReason.CLOCK_ERROR)
    bench.running()  # and the board can be used again afterwards


def test_a_clock_that_jumps_forward_latches() -> None:
    bench = Bench().running()
    bench.t_s = 3600.0
    assert_latched(bench, SafeReason.COMMAND_TIMEOUT)


@pytest.mark.parametrize("measured", [(0.0,) * 3, (0.0, None, 0.0, 0.0), None])
def test_the_boards_own_exceptions_end_in_the_safe_state(measured: object) -> None:
    bench = Bench().running()
    decision = bench.rules.tick(bench.t_s, measured)  # type: ignore[arg-type]
    assert decision == BoardDecision(BoardMode.SAFE_LATCHED, True, SafeReason.INTERNAL_ERROR, VENTED, False)
    assert "Error: " in bench.rules.state.last_error
    bench.control(ControlMode.DISARM)
    assert bench.mode is BoardMode.SAFE_LATCHED  # pressures are unknown
    bench.disarmed()


def test_an_exception_while_receiving_ends_in_the_safe_state() -> None:
    bench = Bench().running()
    assert bench.rules.receive(0x110, bytes(8), math.nan).status is FrameStatus.MALFORMED
    assert_latched(bench, SafeReason.INTERNAL_ERROR)


def test_failures_found_elsewhere_latch() -> None:
    bench = Bench().running()
    bench.rules.report_failure(SafeReason.BUS_OFF, detail=7)
    assert bench.faults()[0]["Detail"] == 7
    assert_latched(bench, SafeReason.BUS_OFF)


def test_the_first_reason_stays_until_disarmed() -> None:
    bench = Bench().running()
    bench.stop()
    bench.measured_Pa = (300e3, 0.0, 0.0, 0.0)
    assert_latched(bench, SafeReason.EMERGENCY_STOP)
    assert len(bench.rules.faults_to_send) == 1


def test_a_latched_board_runs_again_after_a_whole_handshake() -> None:
    bench = Bench().running()
    bench.stop()
    assert_latched(bench, SafeReason.EMERGENCY_STOP)
    bench.running()


@pytest.mark.parametrize("stage", ["arming", "armed", "running"])
def test_disarm_vents_at_once(stage: str) -> None:
    bench: Bench = getattr(Bench(), stage)()
    bench.control(ControlMode.DISARM)
    assert bench.tick() == BoardDecision(BoardMode.DISARMED, True, SafeReason.NONE, VENTED, False)


# ---------------------------------------------------------------------- limits


@given(st.lists(st.floats(0, 819.1), min_size=4, max_size=4))
@settings(deadline=None, max_examples=60)
def test_no_setpoint_above_the_limit_ever_acts(wanted_kPa: list[float]) -> None:
    bench = Bench().running()
    bench.put(bench.peer.send("SequencerSetpoints", {f"Setpoint{each}": wanted_kPa[each] for each in range(4)}))
    acting_Pa = bench.tick().setpoints_Pa
    for wanted, acting in zip(wanted_kPa, acting_Pa, strict=True):
        assert acting == pytest.approx(min(wanted * 1e3, 200e3), abs=51)
        assert acting <= 200e3
    assert bench.rules.state.setpoints_clamped == sum(round(wanted, 1) > 200.0 for wanted in wanted_kPa)


@pytest.mark.parametrize(
    ("bad", "complaint"),
    [
        ({"max_setpoint_Pa": 0.0}, "0 < max_setpoint_Pa < over_pressure_Pa"),
        ({"max_setpoint_Pa": 250e3}, "0 < max_setpoint_Pa < over_pressure_Pa"),
        ({"over_pressure_Pa": 810e3}, "<= 809100"),
        ({"max_setpoint_Pa": math.nan}, "max_setpoint_Pa = nan"),
        ({"command_timeout_s": 0.0}, "command_timeout_s = 0.0"),
        ({"heartbeat_timeout_s": 11.0}, "heartbeat_timeout_s = 11.0"),
        ({"arming_timeout_s": math.nan}, "arming_timeout_s = nan"),
    ],
)
def test_limits_that_protect_nothing_are_refused(bad: dict[str, float], complaint: str) -> None:
    with pytest.raises(LimitsError, match=complaint):
        BoardLimits(**({"max_setpoint_Pa": 200e3, "over_pressure_Pa": 250e3} | bad))  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", [0, 65536])
def test_a_challenge_seed_that_does_not_fit_is_refused(seed: int) -> None:
    with pytest.raises(LimitsError, match="challenge_seed"):
        BoardRules(LIMITS, challenge_seed=seed)


# ---------------------------------------------------------------------- what goes out


def test_heartbeat_and_boot_tell_mode_reason_challenge_version_and_hash() -> None:
    bench = Bench()
    bench.rules.version = (1, 2, 3)
    frames = dict(decode(*frame) for frame in bench.rules.outgoing(0.0))
    assert frames["BoardHeartbeat"]["SafeReason"] == SafeReason.POWER_UP
    boot = frames["BoardBoot"]
    assert (boot["VersionMajor"], boot["VersionMinor"], boot["VersionPatch"]) == (1, 2, 3)
    assert boot["DbcHash"] == dbc_hash()
    bench.arming()
    frames = dict(decode(*frame) for frame in bench.rules.outgoing(2.05))
    heartbeat = frames["BoardHeartbeat"]
    assert heartbeat["BoardMode"] == BoardMode.ARMING
    assert heartbeat["ArmChallenge"] == bench.rules.state.challenge
    assert heartbeat["UptimeS"] == 2


def test_heartbeat_and_boot_keep_their_cycles() -> None:
    bench = Bench()
    names = [decode(*f)[0] for cycle in range(100) for f in bench.rules.outgoing(cycle / 100)]
    assert names.count("BoardHeartbeat") == 20
    assert names.count("BoardBoot") == 5
    assert len(names) == 25


def test_faults_keep_their_minimum_gap_and_none_is_lost() -> None:
    bench = Bench()
    for _ in range(3):
        bench.disarmed().stop()
    sent_s = []
    for cycle in range(30):
        bench.t_s = cycle / 100
        sent_s += [bench.t_s] * len(bench.faults())
    assert sent_s == [0.0, 0.05, 0.1]


def test_a_new_handshake_is_not_disturbed_by_reports_of_old_latches() -> None:
    bench = Bench().disarmed()
    bench.stop()
    bench.arming()
    assert bench.faults() == []


def test_measurements_carry_si_values() -> None:
    bench = Bench().running()
    frames = bench.rules.measurements(
        66.0,
        pressures_Pa=(0.0, 1e5, -500.0, 2e6),
        openings=(-1.0, 0.0, 0.5, 1.0),
        supply_pressure_Pa=6e5,
        main_supply_open=True,
        angular_velocity_rad_s=(1.0, -2.0, 0.0),
        specific_force_m_s2=(0.0, 0.0, 9.81),
    )
    content = dict(decode(*frame) for frame in frames)
    assert [frame.frame_id for frame in frames] == [0x200, 0x210, 0x220, 0x230, 0x231]
    assert [content["BoardPressures"][f"Pressure{each}"] for each in range(4)] == pytest.approx(
        [0.0, 100.0, -0.5, 809.1]
    )
    assert content["BoardValves"]["Opening2"] == pytest.approx(0.5)
    assert content["BoardValves"]["MainSupplyOpen"] == 1
    assert content["BoardValves"]["BoardMode"] == BoardMode.ARMED
    assert content["BoardSupply"]["SupplyPressure"] == pytest.approx(600.0)
    assert content["BoardSupply"]["SampleTimeMs"] == 66000 - 65536
    assert content["ImuGyro"]["Y"] == pytest.approx(-2.0)
    assert content["ImuAccelerometer"]["Z"] == pytest.approx(9.81)


def test_measurements_that_are_not_finite_are_refused() -> None:
    with pytest.raises(FrameError, match=r"ImuGyro\.X"):
        Bench().rules.measurements(
            0.0,
            pressures_Pa=REST,
            openings=REST,
            supply_pressure_Pa=0.0,
            main_supply_open=False,
            angular_velocity_rad_s=(math.nan, 0.0, 0.0),
            specific_force_m_s2=(0.0, 0.0, 0.0),
        )


# ---------------------------------------------------------------------- nothing gets through

LISTED = {0x010: 2, 0x100: 8, 0x110: 8, 0x120: 6, 0x130: 6}


@given(
    st.lists(
        st.one_of(
            st.tuples(st.integers(0, 2047), st.binary(max_size=8)),
            st.sampled_from(sorted(LISTED)).flatmap(
                lambda frame_id: st.tuples(
                    st.just(frame_id), st.binary(min_size=LISTED[frame_id], max_size=LISTED[frame_id])
                )
            ),
        ),
        max_size=40,
    )
)
@settings(deadline=None, max_examples=60)
def test_random_frames_never_open_a_valve_nor_raise(frames: list[tuple[int, bytes]]) -> None:
    bench = Bench().disarmed()
    for frame_id, data in frames:
        bench.put(Frame(frame_id, data))
        assert bench.tick().safe
        assert bench.rules.state.last_error == ""


ACTIONS = st.one_of(
    st.tuples(st.just("control"), st.sampled_from(list(ControlMode)), st.booleans()),
    st.tuples(st.just("setpoints"), st.floats(0, 815), st.just(False)),
    st.tuples(st.just("heartbeat"), st.sampled_from(list(Health)), st.just(False)),
    st.tuples(st.just("stop"), st.just(0), st.just(False)),
    st.tuples(st.just("wait"), st.sampled_from([0.01, 0.05, 0.1, 0.2]), st.just(False)),
    st.tuples(st.just("pressure"), st.sampled_from([0.0, 1e5, 2.6e5, math.nan]), st.just(False)),
)


@given(st.lists(ACTIONS, max_size=60))
@settings(deadline=None, max_examples=150)
def test_valves_open_only_when_armed_and_running_and_only_to_the_limit(
    actions: list[tuple[str, float, bool]],
) -> None:
    bench = Bench()
    seen_disarmed = False
    for action, value, right_token in actions:
        if action == "control":
            bench.control(int(value), bench.token() if right_token else 0)
        elif action == "setpoints":
            bench.setpoints(value)
        elif action == "heartbeat":
            bench.heartbeat(Health(int(value)))
        elif action == "stop":
            bench.stop()
            assert bench.mode is BoardMode.SAFE_LATCHED
        elif action == "wait":
            bench.t_s = round(bench.t_s + value, 6)
        else:
            bench.measured_Pa = (0.0, value, 0.0, 0.0)
        decision = bench.tick()
        seen_disarmed = seen_disarmed or decision.mode is BoardMode.DISARMED
        assert decision.safe == (not decision.main_supply_open)
        assert (decision.mode is BoardMode.SAFE_LATCHED) == (decision.reason is not SafeReason.NONE)
        if decision.safe:
            assert decision.setpoints_Pa == VENTED
        else:
            assert seen_disarmed
            assert decision.mode is BoardMode.ARMED
            assert bench.rules.state.control_mode is ControlMode.RUN
            assert max(decision.setpoints_Pa) <= LIMITS.max_setpoint_Pa
            assert max(bench.measured_Pa) <= LIMITS.over_pressure_Pa
