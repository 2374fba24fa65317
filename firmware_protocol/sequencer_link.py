"""The sequencer's end of the link: arming handshake, heartbeat, setpoints, and what the board reports.

A pure state machine like the board's: frames and time in, frames out. It follows the mode that the board
publishes:

    arm() -> CLEARING   sends disarm until the board says disarmed and BoardBoot showed the same DBC hash
          -> REQUESTING sends arm_request until the board publishes a challenge
          -> CONFIRMING sends arm_confirm with the token until the board says armed
          -> ARMED      sends run; setpoints act

Whatever ends that by itself (board latched or silent, measurements missing, another DBC, no answer in time,
refused frames beyond the tolerance) ends in FAILED with its reason: disarm is sent, setpoints are 0, and only
a new `arm()` tries again. A disarm after a run does not wait for its turn: the frame is sent at once. While an
emergency stop is held, the stop is repeated and SequencerControl falls silent, so that nothing can clear the latch.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

from firmware_protocol.arming import arm_token
from firmware_protocol.e2e import Sender
from firmware_protocol.enumerations import (
    NO_CHAMBER,
    BoardMode,
    BusState,
    ControlMode,
    EmergencyReason,
    FaultKind,
    Health,
    SafeReason,
    SequencerState,
)
from firmware_protocol.errors import LimitsError
from firmware_protocol.frame import Frame
from firmware_protocol.messages import (
    PASCAL_PER_KILOPASCAL,
    FourValues,
    ThreeValues,
    axis_values,
    four_signals,
    four_values,
)
from firmware_protocol.parameter_client import ParameterClient
from firmware_protocol.reception import Received, Reception, ReceptionLimits
from firmware_protocol.schedule import Schedule
from firmware_protocol.spec import SEQUENCER, dbc_hash, message_spec, time_us
from firmware_protocol.time_sync import ClockSync

_NOTHING: FourValues = (0.0, 0.0, 0.0, 0.0)
_KEPT_FAULTS = 16
_MEASUREMENTS = ("BoardPressures", "ImuGyro", "ImuAccelerometer")


class LinkState(StrEnum):
    """Where the sequencer's end of the link stands."""

    DISARMED = "disarmed"
    CLEARING = "clearing"
    REQUESTING = "requesting"
    CONFIRMING = "confirming"
    ARMED = "armed"
    FAILED = "failed"
    EMERGENCY_STOP = "emergency_stop"


class LinkFailure(StrEnum):
    """Why the link is in state FAILED."""

    NONE = "none"
    BOARD_LATCHED = "board_latched"
    """The board latched its safe state; `readings.safe_reason` says why."""
    BOARD_LOST_MODE = "board_lost_mode"
    """The board left arming or armed without latching: restarted, or disarmed by somebody else."""
    BOARD_SILENT = "board_silent"
    MEASUREMENTS_MISSING = "measurements_missing"
    PROTECTION_ERROR = "protection_error"
    VERSION_MISMATCH = "version_mismatch"
    ARMING_TIMEOUT = "arming_timeout"
    CLOCK_ERROR = "clock_error"


@dataclass(frozen=True, slots=True)
class LinkLimits:
    """Ages at which an armed link gives up [s], and the tolerance for refused frames.

    `board_version_major`: the firmware whose meaning of the messages this link was built for; another one is not armed.
    """

    measurement_timeout_s: float = 0.1
    heartbeat_timeout_s: float = 0.2
    arming_timeout_s: float = 2.0
    reception: ReceptionLimits = field(default_factory=ReceptionLimits)
    board_version_major: int = 0

    def __post_init__(self) -> None:
        for name in ("measurement_timeout_s", "heartbeat_timeout_s", "arming_timeout_s"):
            if not 0 < getattr(self, name) <= 60:
                raise LimitsError(f"{name} = {getattr(self, name)} must be above 0 and at most 60 s")


class ErrorCounters(NamedTuple):
    """The content of a BoardErrors frame, in its order."""

    bus_state: BusState
    transmit_errors: int
    receive_errors: int
    protection_errors: int
    refused_frames: int


@dataclass(slots=True)
class BoardReadings:
    """The newest accepted content of each message of the board (SI, gauge); None until the first came."""

    pressures_Pa: FourValues | None = None
    openings: FourValues | None = None
    main_supply_open: bool | None = None
    supply_pressure_Pa: float | None = None
    sample_time_s: float | None = None
    """Board clock at the sampling, modulo 65.536 s."""
    angular_velocity_rad_s: ThreeValues | None = None
    specific_force_m_s2: ThreeValues | None = None
    board_mode: BoardMode | None = None
    safe_reason: SafeReason = SafeReason.NONE
    board_health: Health | None = None
    challenge: int = 0
    board_uptime_s: float | None = None
    board_version: tuple[int, int, int] | None = None
    board_dbc_hash: int | None = None
    last_fault: tuple[SafeReason, int | None, int] | None = None
    """Reason, chamber (None: no single one) and detail of the last BoardFault."""
    board_errors: ErrorCounters | None = None


class SequencerLink:
    """One object a sequencer.

    A cycle: `receive` every frame, read `readings`, control, then send `outgoing`. `state`, `failure`,
    `readings`, `reception`, `parameters` (reads, and lowers, the board's) and `clock` (the board's against this one)
    are public.
    """

    def __init__(self, limits: LinkLimits | None = None) -> None:
        self.limits = limits or LinkLimits()
        self.state = LinkState.DISARMED
        self.failure = LinkFailure.NONE
        self.readings = BoardReadings()
        self.reception = Reception(SEQUENCER, self.limits.reception)
        self.sender = Sender()
        self.schedule = Schedule(SEQUENCER)
        self.faults_to_send: deque[dict[str, float]] = deque(maxlen=_KEPT_FAULTS)
        self.parameters = ParameterClient()
        self.clock = ClockSync()
        self.bus_state = BusState.ERROR_ACTIVE
        self.transmit_errors = 0
        self.receive_errors = 0
        self._dbc_hash = dbc_hash()
        self._now_us: int | None = None
        self._started_us = 0
        self._arming_since_us: int | None = None
        self._next_fault_us = 0
        self._next_stop_us: int | None = None
        self._said = ControlMode.DISARM
        self._stop_reason = EmergencyReason.OPERATOR
        self._fault_gap_us = time_us(message_spec("SequencerFault").minimum_gap_s)
        self._stop_gap_us = time_us(message_spec("EmergencyStop").minimum_gap_s)

    # ------------------------------------------------------------------ what the sequencer asks for

    @property
    def armed(self) -> bool:
        """Whether setpoints act (as far as the board has said)."""
        return self.state is LinkState.ARMED

    def arm(self) -> None:
        """Starts the handshake; does nothing while it runs, when armed, or during an emergency stop."""
        if self.state in (LinkState.DISARMED, LinkState.FAILED):
            self.state, self.failure = LinkState.CLEARING, LinkFailure.NONE
            self._arming_since_us = None
            self.reception.forgive()

    def disarm(self) -> None:
        """Vents and disarms; also leaves FAILED. An emergency stop stays."""
        if self.state is not LinkState.EMERGENCY_STOP:
            self.state, self.failure = LinkState.DISARMED, LinkFailure.NONE

    def emergency_stop(self, reason: EmergencyReason = EmergencyReason.OPERATOR) -> None:
        """Latches the board from the next `outgoing` on, until `release_emergency_stop`."""
        if self.state is not LinkState.EMERGENCY_STOP:
            self.state, self._stop_reason, self._next_stop_us = LinkState.EMERGENCY_STOP, reason, None

    def release_emergency_stop(self) -> None:
        """Ends the stop; the link is disarmed and the board can be armed anew."""
        if self.state is LinkState.EMERGENCY_STOP:
            self.state, self.failure = LinkState.DISARMED, LinkFailure.NONE

    def report_fault(
        self, kind: FaultKind, *, chamber: int | None, delay_s: float = 0.0, confidence: float = 1.0
    ) -> None:
        """Queues a SequencerFault.

        `chamber`: 0 to 3, or None when it is not one chamber's. `delay_s`: from onset to detection.
        `confidence`: 0 to 1.
        """
        self.faults_to_send.append(
            {
                "Chamber": NO_CHAMBER if chamber is None else chamber,
                "Kind": kind,
                "DelayMs": round(delay_s * 1000),
                "Confidence": confidence,
            }
        )

    def report_bus(self, bus_state: BusState, transmit_errors: int = 0, receive_errors: int = 0) -> None:
        """Takes over what this end's CAN controller says of itself, for SequencerErrors."""
        self.bus_state, self.transmit_errors, self.receive_errors = bus_state, transmit_errors, receive_errors

    # ------------------------------------------------------------------ what comes in

    def receive(self, frame_id: int, data: bytes, t_s: float) -> Received:
        """Judges one frame and takes over its content if it is accepted."""
        now_us = self._advance(t_s)
        received = self.reception.accept(frame_id, bytes(data), now_us)
        if received.beyond_tolerance and self.state in _ACTIVE:
            self._fail(LinkFailure.PROTECTION_ERROR)
        if received.status.accepted:
            self._take(received, now_us)
        return received

    def age_s(self, name: str, t_s: float) -> float:
        """Time since the last accepted frame of message `name`; infinite if there was none."""
        age_us = self.reception.age_us(name, time_us(t_s))
        return math.inf if age_us is None else age_us / 1e6

    def _take(self, received: Received, now_us: int) -> None:
        readings, signals = self.readings, received.signals
        match received.name:
            case "BoardPressures":
                readings.pressures_Pa = four_values("Pressure", signals, PASCAL_PER_KILOPASCAL)
            case "BoardValves":
                readings.openings = four_values("Opening", signals)
                readings.main_supply_open = bool(signals["MainSupplyOpen"])
            case "BoardSupply":
                readings.supply_pressure_Pa = signals["SupplyPressure"] * PASCAL_PER_KILOPASCAL
                readings.sample_time_s = signals["SampleTimeMs"] / 1000
            case "ImuGyro":
                readings.angular_velocity_rad_s = axis_values(signals)
            case "ImuAccelerometer":
                readings.specific_force_m_s2 = axis_values(signals)
            case "BoardHeartbeat":
                readings.board_health = Health(int(signals["Health"]))
                readings.challenge = int(signals["ArmChallenge"])
                readings.board_uptime_s = signals["UptimeS"]
                self._follow(BoardMode(int(signals["BoardMode"])), SafeReason(int(signals["SafeReason"])))
            case "BoardFault":
                chamber = int(signals["Chamber"])
                reason = SafeReason(int(signals["Reason"]))
                readings.last_fault = (
                    reason,
                    None if chamber == NO_CHAMBER else chamber,
                    int(signals["Detail"]),
                )
                self._follow(BoardMode.SAFE_LATCHED, reason)
            case "BoardBoot":
                readings.board_version = (
                    int(signals["VersionMajor"]),
                    int(signals["VersionMinor"]),
                    int(signals["VersionPatch"]),
                )
                readings.board_dbc_hash = int(signals["DbcHash"])
            case "ParameterResponse":
                self.parameters.take(received.raw)
            case "TimeSyncResponse":
                self.clock.take(received.raw, now_us)
            case _:  # BoardErrors, the last message that a sequencer receives
                raw = received.raw
                readings.board_errors = ErrorCounters(
                    BusState(raw["BusState"]),
                    raw["TransmitErrors"],
                    raw["ReceiveErrors"],
                    raw["ProtectionErrors"],
                    raw["RefusedFrames"],
                )

    def _follow(self, mode: BoardMode, reason: SafeReason) -> None:
        """Moves with the mode that the board publishes."""
        readings = self.readings
        readings.board_mode, readings.safe_reason = mode, reason
        if self.state in _HANDSHAKE and mode is BoardMode.SAFE_LATCHED:
            self._fail(LinkFailure.BOARD_LATCHED)
        elif self.state is LinkState.REQUESTING and mode is BoardMode.ARMING:
            self.state = LinkState.CONFIRMING
        elif self.state is LinkState.CONFIRMING and mode is BoardMode.ARMED:
            self.state = LinkState.ARMED
        elif (self.state is LinkState.CONFIRMING and mode is BoardMode.DISARMED) or (
            self.state is LinkState.ARMED and mode is not BoardMode.ARMED
        ):
            self._fail(LinkFailure.BOARD_LOST_MODE)

    # ------------------------------------------------------------------ what goes out

    def outgoing(
        self,
        t_s: float,
        setpoints_Pa: Sequence[float],
        sequencer_state: SequencerState = SequencerState.DISARMED,
        health: Health = Health.OK,
    ) -> list[Frame]:
        """The frames that are due at `t_s`, in order of priority.

        `setpoints_Pa` [4 values, gauge Pa] go out when armed, 0 otherwise. Raises FrameError when one of them
        is outside 0 to 819.1 kPa.
        """
        now_us = self._advance(t_s)
        self._proceed(now_us)
        frames: list[Frame] = []
        stopping = self.state is LinkState.EMERGENCY_STOP
        if stopping and (self._next_stop_us is None or now_us >= self._next_stop_us):
            self._next_stop_us = now_us + self._stop_gap_us
            frames.append(self.sender.send("EmergencyStop", {"Reason": self._stop_reason}))
        runs_no_more = self._said is ControlMode.RUN and not self.armed
        if not stopping and (self.schedule.due("SequencerControl", now_us) or runs_no_more):
            frames.append(self.sender.send("SequencerControl", self._control_signals()))
        if self.schedule.due("SequencerSetpoints", now_us):
            wanted = four_signals("Setpoint", setpoints_Pa if self.armed else _NOTHING, PASCAL_PER_KILOPASCAL)
            frames.append(self.sender.send("SequencerSetpoints", wanted))
        if self.schedule.due("SequencerHeartbeat", now_us):
            uptime_s = (now_us - self._started_us) // 1_000_000
            heartbeat = {"State": sequencer_state, "Health": health, "UptimeS": uptime_s}
            frames.append(self.sender.send("SequencerHeartbeat", heartbeat))
        if self.faults_to_send and now_us >= self._next_fault_us:
            self._next_fault_us = now_us + self._fault_gap_us
            frames.append(self.sender.send("SequencerFault", self.faults_to_send.popleft()))
        request = self.parameters.due(now_us)
        if request is not None:
            frames.append(self.sender.send("ParameterRequest", request))
        if self.schedule.due("TimeSyncRequest", now_us):
            frames.append(self.sender.send("TimeSyncRequest", self.clock.request(now_us)))
        if self.schedule.due("SequencerErrors", now_us):
            frames.append(self.sender.send("SequencerErrors", self._error_counters()))
        return frames

    def _error_counters(self) -> dict[str, float]:
        return {
            "BusState": self.bus_state,
            "TransmitErrors": self.transmit_errors,
            "ReceiveErrors": self.receive_errors,
            "ProtectionErrors": self.reception.protection_errors,
            "RefusedFrames": self.reception.refused_frames,
        }

    def _control_signals(self) -> dict[str, float]:
        mode, token = ControlMode.DISARM, 0
        if self.state is LinkState.REQUESTING:
            mode = ControlMode.ARM_REQUEST
        elif self.state is LinkState.CONFIRMING:
            mode, token = ControlMode.ARM_CONFIRM, arm_token(self.readings.challenge, self._dbc_hash)
        elif self.state is LinkState.ARMED:
            mode = ControlMode.RUN
        self._said = mode
        return {"Mode": mode, "ArmToken": token, "DbcHash": self._dbc_hash}

    # ------------------------------------------------------------------ what time alone decides

    def _advance(self, t_s: float) -> int:
        now_us = time_us(t_s)
        if self._now_us is None:
            self._started_us = now_us
        elif now_us < self._now_us:
            self.reception.forget_times()
            self.parameters.restart(now_us)
            self.clock.forget()
            self._next_fault_us = min(self._next_fault_us, now_us + self._fault_gap_us)
            self._next_stop_us = None
            if self.state in _ACTIVE:
                self._fail(LinkFailure.CLOCK_ERROR)
        self._now_us = now_us
        if self.state is LinkState.ARMED:
            self._check_ages(now_us)
        return now_us

    def _check_ages(self, now_us: int) -> None:
        if self._older(now_us, "BoardHeartbeat", self.limits.heartbeat_timeout_s):
            self._fail(LinkFailure.BOARD_SILENT)
        elif any(self._older(now_us, name, self.limits.measurement_timeout_s) for name in _MEASUREMENTS):
            self._fail(LinkFailure.MEASUREMENTS_MISSING)

    def _older(self, now_us: int, name: str, timeout_s: float) -> bool:
        age_us = self.reception.age_us(name, now_us)
        return age_us is None or age_us >= time_us(timeout_s)

    def _proceed(self, now_us: int) -> None:
        """The handshake's own steps."""
        if self.state not in _ACTIVE or self.state is LinkState.ARMED:
            return
        if self._arming_since_us is None:
            self._arming_since_us = now_us
        readings = self.readings
        if readings.board_version is not None and (
            readings.board_dbc_hash != self._dbc_hash or readings.board_version[0] != self.limits.board_version_major
        ):
            self._fail(LinkFailure.VERSION_MISMATCH)
        elif now_us - self._arming_since_us >= time_us(self.limits.arming_timeout_s):
            self._fail(LinkFailure.ARMING_TIMEOUT)
        elif (
            self.state is LinkState.CLEARING
            and readings.board_mode is BoardMode.DISARMED
            and readings.board_dbc_hash is not None
        ):
            self.state = LinkState.REQUESTING

    def _fail(self, failure: LinkFailure) -> None:
        self.state, self.failure = LinkState.FAILED, failure


_HANDSHAKE = frozenset({LinkState.REQUESTING, LinkState.CONFIRMING, LinkState.ARMED})
_ACTIVE = _HANDSHAKE | {LinkState.CLEARING}
