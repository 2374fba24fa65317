"""The board's safety rules: a pure state machine over received frames, measured pressures and time.

The safe state is defined by the valves: main supply closed, every exhaust open. It is reached

- at power-up, and whenever the board is not armed and in mode run;
- latched, when an armed or arming board gets no valid setpoints or control for 100 ms, no valid heartbeat for
  200 ms, more refused frames of a message than the tolerance, a mode that is out of turn, a heartbeat that
  says failed, a DBC hash that is not its own, a wrong token, or no token in time;
- latched, in any mode, by an emergency stop, a chamber above the board's limit, a pressure that is not
  finite, a clock that goes backwards, bus-off, or an exception of the board itself.

A latch is left by `disarm` only, and only once every measured pressure is finite and below the limit; then
arm_request -> challenge (BoardHeartbeat) -> arm_confirm with the token -> armed -> run. Setpoints above the
board's limit are clamped to it and counted, not refused: a controller that brushes the limit must not lose
the robot, and one that means harm gets the limit and no more. No frame can change a limit.

Nothing is hidden: `state`, `reception`, `limits` and `transitions` are public. Time comes in as `t_s` and
must not go back.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from firmware_protocol.arming import arm_token, next_challenge
from firmware_protocol.e2e import FrameStatus, Sender
from firmware_protocol.enumerations import NO_CHAMBER, BoardMode, ControlMode, Health, SafeReason
from firmware_protocol.errors import LimitsError
from firmware_protocol.frame import Frame
from firmware_protocol.messages import (
    CHAMBERS,
    PASCAL_PER_KILOPASCAL,
    FourValues,
    axis_signals,
    four_signals,
    four_values,
)
from firmware_protocol.reception import Received, Reception, ReceptionLimits
from firmware_protocol.schedule import Schedule
from firmware_protocol.spec import BOARD, dbc_hash, message_spec, time_us

VENTED: FourValues = (0.0, 0.0, 0.0, 0.0)
_KEPT_TRANSITIONS = 64
_KEPT_FAULTS = 8


@dataclass(frozen=True, slots=True)
class BoardLimits:
    """What the board enforces whatever is commanded [gauge Pa, s].

    `max_setpoint_Pa`: setpoints are clamped to it. `over_pressure_Pa`: a measured pressure above it latches
    the safe state; the gap between the two is what overshoot and sensor noise may use up. Raises LimitsError
    when they contradict each other or cannot be measured over the bus.
    """

    max_setpoint_Pa: float
    over_pressure_Pa: float
    command_timeout_s: float = 0.1
    heartbeat_timeout_s: float = 0.2
    arming_timeout_s: float = 1.0
    reception: ReceptionLimits = field(default_factory=ReceptionLimits)

    def __post_init__(self) -> None:
        pressure = next(each for each in message_spec("BoardPressures").signals if each.name == "Pressure0")
        highest_Pa = pressure.maximum * PASCAL_PER_KILOPASCAL
        if not 0 < self.max_setpoint_Pa < self.over_pressure_Pa <= highest_Pa:
            raise LimitsError(
                f"max_setpoint_Pa = {self.max_setpoint_Pa} and over_pressure_Pa = {self.over_pressure_Pa} "
                f"must be 0 < max_setpoint_Pa < over_pressure_Pa <= {highest_Pa:.0f} "
                "(the range of BoardPressures)"
            )
        for name in ("command_timeout_s", "heartbeat_timeout_s", "arming_timeout_s"):
            if not 0 < getattr(self, name) <= 10:
                raise LimitsError(f"{name} = {getattr(self, name)} must be above 0 and at most 10 s")


@dataclass(frozen=True, slots=True)
class BoardDecision:
    """What the valves are to do in this cycle.

    `safe`: the valves belong in their safe state, main supply closed and exhausts open, whatever the rest
    says; true in every mode but armed-and-run. `setpoints_Pa`: gauge, clamped to the board's limit, 0 when
    safe.
    """

    mode: BoardMode
    safe: bool
    reason: SafeReason
    setpoints_Pa: FourValues
    main_supply_open: bool


@dataclass(frozen=True, slots=True)
class Transition:
    """A change of mode at `t_s`; `reason` is NONE unless the new mode is SAFE_LATCHED."""

    t_s: float
    mode: BoardMode
    reason: SafeReason


@dataclass(frozen=True, slots=True)
class BoardFaultRecord:
    """The content of a BoardFault frame."""

    reason: SafeReason
    chamber: int
    detail: int


@dataclass(slots=True)
class BoardState:
    """All that the rules remember besides the reception. Times in µs on the caller's clock."""

    mode: BoardMode = BoardMode.SAFE_LATCHED
    reason: SafeReason = SafeReason.POWER_UP
    control_mode: ControlMode = ControlMode.DISARM
    setpoints_Pa: FourValues = VENTED
    setpoints_clamped: int = 0
    challenge: int = 0
    challenge_seed: int = 1
    pressures_valid: bool = False
    now_us: int | None = None
    started_us: int = 0
    mode_since_us: int = 0
    last_error: str = ""
    """The board's own last exception, as text."""

    @property
    def safe(self) -> bool:
        return not (self.mode is BoardMode.ARMED and self.control_mode is ControlMode.RUN)


class BoardRules:
    """The rules, one object a board.

    A cycle of the board: `receive` every frame, `tick` with the measured pressures, act on the decision, then
    send `outgoing` and `measurements`. `challenge_seed` (1 to 65535) makes the challenges; hardware takes it
    from a source of entropy. `version`: of the firmware, for BoardBoot.
    """

    def __init__(
        self,
        limits: BoardLimits,
        *,
        challenge_seed: int = 1,
        version: tuple[int, int, int] = (0, 1, 0),
    ) -> None:
        if not 1 <= challenge_seed <= 0xFFFF:
            raise LimitsError(f"challenge_seed = {challenge_seed} must be from 1 to 65535")
        self.limits = limits
        self.version = version
        self.state = BoardState(challenge_seed=challenge_seed)
        self.reception = Reception(BOARD, limits.reception, frozenset({"EmergencyStop"}))
        self.transitions: deque[Transition] = deque(maxlen=_KEPT_TRANSITIONS)
        self.faults_to_send: deque[BoardFaultRecord] = deque(maxlen=_KEPT_FAULTS)
        self.sender = Sender()
        self.schedule = Schedule(BOARD)
        self._dbc_hash = dbc_hash()
        self._command_timeout_us = time_us(limits.command_timeout_s)
        self._heartbeat_timeout_us = time_us(limits.heartbeat_timeout_s)
        self._arming_timeout_us = time_us(limits.arming_timeout_s)
        self._fault_gap_us = time_us(message_spec("BoardFault").minimum_gap_s)
        self._next_fault_us = 0

    # ------------------------------------------------------------------ what comes in

    def receive(self, frame_id: int, data: bytes, t_s: float) -> Received:
        """Judges one frame and acts on it if it is accepted. An exception inside latches the safe state."""
        try:
            return self._receive(frame_id, data, t_s)
        except Exception as error:  # the board's own exceptions end in the safe state, never in the caller
            self._internal_error(error)
            return Received(FrameStatus.MALFORMED)

    def tick(self, t_s: float, measured_pressure_Pa: Sequence[float]) -> BoardDecision:
        """The cycle's decision, after checking timeouts and the measured pressures [4 values, gauge Pa]."""
        try:
            self._advance(t_s)
            self._check_pressures(measured_pressure_Pa)
        except Exception as error:  # as in receive
            self._internal_error(error)
        state = self.state
        if state.safe:
            return BoardDecision(state.mode, True, state.reason, VENTED, False)
        return BoardDecision(state.mode, False, state.reason, state.setpoints_Pa, True)

    def report_failure(self, reason: SafeReason, detail: int = 0) -> None:
        """Latches the safe state for what the board's other parts found (BUS_OFF, INTERNAL_ERROR, …)."""
        self._latch(reason, detail=detail)

    # ------------------------------------------------------------------ what goes out

    def outgoing(self, t_s: float) -> list[Frame]:
        """The BoardFault, BoardHeartbeat and BoardBoot frames that are due at `t_s`."""
        t_us = time_us(t_s)
        frames: list[Frame] = []
        if self.faults_to_send and t_us >= self._next_fault_us:
            fault = self.faults_to_send.popleft()
            self._next_fault_us = t_us + self._fault_gap_us
            signals = {"Reason": fault.reason, "Chamber": fault.chamber, "Detail": fault.detail}
            frames.append(self.sender.send("BoardFault", signals))
        if self.schedule.due("BoardHeartbeat", t_us):
            frames.append(
                self.sender.send(
                    "BoardHeartbeat",
                    {
                        "BoardMode": self.state.mode,
                        "SafeReason": self.state.reason,
                        "Health": 0,
                        "ArmChallenge": self.state.challenge,
                        "UptimeS": max(t_us - self.state.started_us, 0) // 1_000_000,
                    },
                )
            )
        if self.schedule.due("BoardBoot", t_us):
            major, minor, patch = self.version
            boot = {
                "VersionMajor": major,
                "VersionMinor": minor,
                "VersionPatch": patch,
                "DbcHash": self._dbc_hash,
            }
            frames.append(self.sender.send("BoardBoot", boot))
        return frames

    def measurements(
        self,
        t_s: float,
        *,
        pressures_Pa: Sequence[float],
        openings: Sequence[float],
        supply_pressure_Pa: float,
        main_supply_open: bool,
        angular_velocity_rad_s: Sequence[float],
        specific_force_m_s2: Sequence[float],
    ) -> list[Frame]:
        """The cyclic measurement frames that are due at `t_s`.

        Pressures and supply [gauge Pa], valve openings [-1 exhaust fully open, +1 supply fully open], IMU
        (x, y, z). Raises FrameError for what is not finite.
        """
        t_us = time_us(t_s)
        content: dict[str, dict[str, float]] = {
            "BoardPressures": four_signals("Pressure", pressures_Pa, PASCAL_PER_KILOPASCAL),
            "BoardValves": four_signals("Opening", openings)
            | {"MainSupplyOpen": main_supply_open, "BoardMode": self.state.mode},
            "BoardSupply": {
                "SupplyPressure": supply_pressure_Pa / PASCAL_PER_KILOPASCAL,
                "SampleTimeMs": t_us // 1000 % 65536,
            },
            "ImuGyro": axis_signals(angular_velocity_rad_s),
            "ImuAccelerometer": axis_signals(specific_force_m_s2),
        }
        return [self.sender.send(name, signals) for name, signals in content.items() if self.schedule.due(name, t_us)]

    # ------------------------------------------------------------------ the rules

    def _receive(self, frame_id: int, data: bytes, t_s: float) -> Received:
        # Timeouts first: a frame that comes too late must not hide that it was late.
        now_us = self._advance(t_s)
        received = self.reception.accept(frame_id, bytes(data), now_us)
        state = self.state
        if received.beyond_tolerance and state.mode in (BoardMode.ARMING, BoardMode.ARMED):
            self._latch(SafeReason.PROTECTION_ERROR, detail=frame_id)
        signals = received.signals
        if not received.status.accepted:
            return received
        if received.name == "EmergencyStop":
            self._latch(SafeReason.EMERGENCY_STOP, detail=int(signals["Reason"]))
        elif received.name == "SequencerControl":
            self._control(ControlMode(int(signals["Mode"])), int(signals["ArmToken"]), int(signals["DbcHash"]))
        elif received.name == "SequencerSetpoints":
            self._setpoints(four_values("Setpoint", signals, PASCAL_PER_KILOPASCAL))
        elif received.name == "SequencerHeartbeat":
            active = state.mode in (BoardMode.ARMING, BoardMode.ARMED)
            if active and signals["Health"] == Health.FAILED:
                self._latch(SafeReason.SEQUENCER_FAILED)
        return received

    def _control(self, wanted: ControlMode, token: int, peer_hash: int) -> None:
        state = self.state
        if wanted is ControlMode.DISARM:
            if state.mode is not BoardMode.SAFE_LATCHED or state.pressures_valid:
                self._enter(BoardMode.DISARMED, SafeReason.NONE)
            return
        if state.mode is BoardMode.SAFE_LATCHED:
            return
        if peer_hash != self._dbc_hash:
            self._latch(SafeReason.VERSION_MISMATCH, detail=peer_hash & 0xFFFF)
        elif state.mode is BoardMode.DISARMED:
            if wanted is ControlMode.ARM_REQUEST:
                self._begin_arming()
        elif state.mode is BoardMode.ARMING:
            if wanted is ControlMode.ARM_CONFIRM:
                self._finish_arming(token)
            elif wanted is ControlMode.RUN:
                self._latch(SafeReason.UNEXPECTED_MODE, detail=wanted)
        elif wanted is ControlMode.ARM_REQUEST:
            # An armed board is asked to arm by a sequencer that lost its memory of it.
            self._latch(SafeReason.UNEXPECTED_MODE, detail=wanted)
        else:
            state.control_mode = wanted

    def _begin_arming(self) -> None:
        state = self.state
        state.challenge_seed = next_challenge(state.challenge_seed)
        self.reception.forgive()
        self.faults_to_send.clear()  # a late report of an old latch would look like a new one
        self._enter(BoardMode.ARMING, SafeReason.NONE)
        state.challenge = state.challenge_seed

    def _finish_arming(self, token: int) -> None:
        now_us = self.state.now_us or 0
        age_us = self.reception.age_us("SequencerHeartbeat", now_us)
        if token != arm_token(self.state.challenge, self._dbc_hash):
            self._latch(SafeReason.ARMING_REFUSED, detail=ControlMode.ARM_CONFIRM)
        elif age_us is None or age_us >= self._heartbeat_timeout_us:
            self._latch(SafeReason.HEARTBEAT_TIMEOUT)
        else:
            self._enter(BoardMode.ARMED, SafeReason.NONE)
            self.state.control_mode = ControlMode.ARM_CONFIRM

    def _setpoints(self, wanted_Pa: FourValues) -> None:
        state = self.state
        if state.mode is not BoardMode.ARMED:
            return
        limit_Pa = self.limits.max_setpoint_Pa
        state.setpoints_clamped += sum(each > limit_Pa for each in wanted_Pa)
        first, second, third, fourth = wanted_Pa
        state.setpoints_Pa = (
            min(first, limit_Pa),
            min(second, limit_Pa),
            min(third, limit_Pa),
            min(fourth, limit_Pa),
        )

    def _advance(self, t_s: float) -> int:
        """Takes over the time and checks what depends on it alone."""
        state = self.state
        now_us = time_us(t_s)
        if state.now_us is None:
            state.started_us = state.mode_since_us = now_us
        elif now_us < state.now_us:
            self.reception.forget_times()
            state.now_us = now_us
            self._latch(SafeReason.CLOCK_ERROR)
        state.now_us = now_us
        if state.mode is BoardMode.ARMING:
            age_us = now_us - state.mode_since_us
            if age_us >= self._arming_timeout_us:
                self._latch(SafeReason.ARMING_TIMEOUT, detail=_milliseconds(age_us))
        elif state.mode is BoardMode.ARMED:
            for name, timeout_us, reason in (
                ("SequencerSetpoints", self._command_timeout_us, SafeReason.COMMAND_TIMEOUT),
                ("SequencerControl", self._command_timeout_us, SafeReason.COMMAND_TIMEOUT),
                ("SequencerHeartbeat", self._heartbeat_timeout_us, SafeReason.HEARTBEAT_TIMEOUT),
            ):
                since_us = state.mode_since_us  # a message may be missing for its timeout after arming, too
                last_us = self.reception.messages[name].last_accepted_us
                if last_us is not None and last_us > since_us:
                    since_us = last_us
                if now_us - since_us >= timeout_us:
                    self._latch(reason, detail=_milliseconds(now_us - since_us))
                    break
        return now_us

    def _check_pressures(self, measured_pressure_Pa: Sequence[float]) -> None:
        self.state.pressures_valid = False
        if len(measured_pressure_Pa) != CHAMBERS:
            raise ValueError(f"{len(measured_pressure_Pa)} measured pressures for {CHAMBERS} chambers")
        for chamber, pressure_Pa in enumerate(measured_pressure_Pa):
            if not math.isfinite(pressure_Pa):
                self._latch(SafeReason.SENSOR_INVALID, chamber=chamber)
                return
            if pressure_Pa > self.limits.over_pressure_Pa:
                detail = min(math.ceil(pressure_Pa / 100.0), 0xFFFF)
                self._latch(SafeReason.OVER_PRESSURE, chamber=chamber, detail=detail)
                return
        self.state.pressures_valid = True

    def _internal_error(self, error: Exception) -> None:
        self.state.last_error = f"{type(error).__name__}: {error}"
        self._latch(SafeReason.INTERNAL_ERROR)

    def _latch(self, reason: SafeReason, *, chamber: int = NO_CHAMBER, detail: int = 0) -> None:
        """Enters the latched safe state. The first reason stays until disarmed: it caused the others."""
        if self.state.mode is BoardMode.SAFE_LATCHED and self.state.reason is not SafeReason.POWER_UP:
            return
        self._enter(BoardMode.SAFE_LATCHED, reason)
        self.faults_to_send.append(BoardFaultRecord(reason, chamber, detail))

    def _enter(self, mode: BoardMode, reason: SafeReason) -> None:
        state = self.state
        if (state.mode, state.reason) == (mode, reason):
            return
        now_us = state.now_us or 0
        state.mode, state.reason, state.mode_since_us = mode, reason, now_us
        state.control_mode = ControlMode.DISARM
        state.setpoints_Pa = VENTED
        state.challenge = 0
        self.transitions.append(Transition(now_us / 1e6, mode, reason))


def _milliseconds(age_us: int) -> int:
    return min(age_us // 1000, 0xFFFF)
