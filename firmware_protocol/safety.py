"""The board's safety state machine: whole numbers in, whole numbers out, no frame and no clock of its own.

Pressures are gauge in hPa (0.1 kPa), times in µs on the board's clock. Every input first calls `advance`; what it
decides depends on the inputs and their times alone, so that the C11 reference decides the same. The rules themselves
are told in `board`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from firmware_protocol.arming import arm_token, next_challenge
from firmware_protocol.enumerations import (
    NO_CHAMBER,
    BoardMode,
    BusState,
    ControlMode,
    Health,
    Parameter,
    SafeReason,
)
from firmware_protocol.messages import CHAMBERS
from firmware_protocol.parameters import Parameters

FourCounts = tuple[int, int, int, int]
VENTED_hPa: FourCounts = (0, 0, 0, 0)
SENSOR_INVALID_hPa = -(1 << 31)
"""Stands for a measured pressure that is not a finite number."""
HIGHEST_DETAIL = 0xFFFF
_KEPT_TRANSITIONS = 64
_KEPT_FAULTS = 8
_ACTIVE = (BoardMode.ARMING, BoardMode.ARMED)
_FAILED_REASONS = (
    SafeReason.SENSOR_INVALID,
    SafeReason.BUS_OFF,
    SafeReason.INTERNAL_ERROR,
    SafeReason.CLOCK_ERROR,
)


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
    """All that the machine remembers besides the parameters. Times in µs; None: not yet, or forgotten."""

    challenge_seed: int
    mode: BoardMode = BoardMode.SAFE_LATCHED
    reason: SafeReason = SafeReason.POWER_UP
    control_mode: ControlMode = ControlMode.DISARM
    setpoints_hPa: FourCounts = VENTED_hPa
    challenge: int = 0
    pressures_valid: bool = False
    bus_state: BusState = BusState.ERROR_ACTIVE
    now_us: int | None = None
    started_us: int = 0
    mode_since_us: int = 0
    setpoints_us: int | None = None
    control_us: int | None = None
    heartbeat_us: int | None = None
    last_error: str = ""
    """The board's own last exception, as text."""

    @property
    def safe(self) -> bool:
        """Whether the valves belong in their safe state: in every mode but armed-and-run."""
        return not (self.mode is BoardMode.ARMED and self.control_mode is ControlMode.RUN)

    @property
    def active(self) -> bool:
        """Whether the board is arming or armed: there is something to protect."""
        return self.mode in _ACTIVE


class SafetyMachine:
    """One board's machine. `state`, `parameters`, `transitions` and `faults_to_send` are public."""

    def __init__(self, parameters: Parameters, *, challenge_seed: int, dbc_hash: int) -> None:
        self.parameters = parameters
        self.state = BoardState(challenge_seed=challenge_seed)
        self.transitions: deque[Transition] = deque(maxlen=_KEPT_TRANSITIONS)
        self.faults_to_send: deque[BoardFaultRecord] = deque(maxlen=_KEPT_FAULTS)
        self.dbc_hash = dbc_hash

    # ------------------------------------------------------------------ time

    def advance(self, now_us: int) -> bool:
        """Takes over the time and checks what depends on it alone. False: the clock went backwards."""
        state = self.state
        forwards = True
        if state.now_us is None:
            state.started_us = state.mode_since_us = now_us
        elif now_us < state.now_us:
            forwards = False
            state.setpoints_us = state.control_us = state.heartbeat_us = None
            state.now_us = now_us
            self.latch(SafeReason.CLOCK_ERROR)
        state.now_us = now_us
        if state.mode is BoardMode.ARMING:
            self._latch_if_old(Parameter.ARMING_TIMEOUT, None, SafeReason.ARMING_TIMEOUT)
        elif state.mode is BoardMode.ARMED:
            self._latch_if_old(Parameter.COMMAND_TIMEOUT, state.setpoints_us, SafeReason.COMMAND_TIMEOUT)
            self._latch_if_old(Parameter.COMMAND_TIMEOUT, state.control_us, SafeReason.COMMAND_TIMEOUT)
            self._latch_if_old(Parameter.HEARTBEAT_TIMEOUT, state.heartbeat_us, SafeReason.HEARTBEAT_TIMEOUT)
        return forwards

    def _latch_if_old(self, timeout: Parameter, last_us: int | None, reason: SafeReason) -> None:
        since_us = self.state.mode_since_us  # a message may be missing for its timeout after arming, too
        if last_us is not None and last_us > since_us:
            since_us = last_us
        age_us = self._now_us - since_us
        if age_us >= 1000 * self.parameters.values[timeout]:
            self.latch(reason, detail=age_us // 1000)

    @property
    def _now_us(self) -> int:
        return 0 if self.state.now_us is None else self.state.now_us

    # ------------------------------------------------------------------ what came on the bus, already accepted

    def emergency_stop(self, reason: int) -> None:
        """An EmergencyStop message: latches the safe state in any mode."""
        self.latch(SafeReason.EMERGENCY_STOP, detail=reason)

    def control(self, wanted: ControlMode, token: int, peer_hash: int) -> None:
        """A SequencerControl message."""
        state = self.state
        state.control_us = state.now_us
        if wanted is ControlMode.DISARM:
            if state.mode is not BoardMode.SAFE_LATCHED or state.pressures_valid:
                self._enter(BoardMode.DISARMED, SafeReason.NONE)
            return
        if state.mode is BoardMode.SAFE_LATCHED:
            return
        if peer_hash != self.dbc_hash:
            self.latch(SafeReason.VERSION_MISMATCH, detail=peer_hash & 0xFFFF)
        elif state.mode is BoardMode.DISARMED:
            if wanted is ControlMode.ARM_REQUEST:
                self._begin_arming()
        elif state.mode is BoardMode.ARMING:
            if wanted is ControlMode.ARM_CONFIRM:
                self._finish_arming(token)
            elif wanted is ControlMode.RUN:
                self.latch(SafeReason.UNEXPECTED_MODE, detail=wanted)
        elif wanted is ControlMode.ARM_REQUEST:
            # An armed board is asked to arm by a sequencer that lost its memory of it.
            self.latch(SafeReason.UNEXPECTED_MODE, detail=wanted)
        else:
            state.control_mode = wanted

    def setpoints(self, wanted_hPa: Sequence[int]) -> None:
        """A SequencerSetpoints message [4 values]: clamped to the limit, and counted where that was needed."""
        state = self.state
        state.setpoints_us = state.now_us
        if state.mode is not BoardMode.ARMED:
            return
        limit_hPa = self.parameters.values[Parameter.MAX_SETPOINT]
        first, second, third, fourth = wanted_hPa
        self.parameters.count(Parameter.SETPOINTS_CLAMPED, sum(each > limit_hPa for each in wanted_hPa))
        state.setpoints_hPa = (
            min(first, limit_hPa),
            min(second, limit_hPa),
            min(third, limit_hPa),
            min(fourth, limit_hPa),
        )

    def heartbeat(self, health: int) -> None:
        """A SequencerHeartbeat message."""
        self.state.heartbeat_us = self.state.now_us
        if self.state.active and health == Health.FAILED:
            self.latch(SafeReason.SEQUENCER_FAILED)

    def beyond_tolerance(self, frame_id: int) -> None:
        """More frames of this identifier were refused than is tolerated."""
        if self.state.active:
            self.latch(SafeReason.PROTECTION_ERROR, detail=frame_id)

    # ------------------------------------------------------------------ what the board finds itself

    def measured(self, pressures_hPa: Sequence[int]) -> None:
        """The measured chamber pressures [4 values, rounded up]; SENSOR_INVALID_hPa for what is not finite."""
        self.state.pressures_valid = False
        if len(pressures_hPa) != CHAMBERS:
            raise ValueError(f"{len(pressures_hPa)} measured pressures for {CHAMBERS} chambers")
        limit_hPa = self.parameters.values[Parameter.OVER_PRESSURE]
        for chamber, pressure_hPa in enumerate(pressures_hPa):
            if pressure_hPa == SENSOR_INVALID_hPa:
                self.latch(SafeReason.SENSOR_INVALID, chamber=chamber)
                return
            if pressure_hPa > limit_hPa:
                self.latch(SafeReason.OVER_PRESSURE, chamber=chamber, detail=pressure_hPa)
                return
        self.state.pressures_valid = True

    def bus(self, bus_state: BusState) -> None:
        """What the CAN controller says of itself."""
        self.state.bus_state = bus_state
        if bus_state is BusState.BUS_OFF:
            self.latch(SafeReason.BUS_OFF)

    def latch(self, reason: SafeReason, *, chamber: int = NO_CHAMBER, detail: int = 0) -> None:
        """Enters the latched safe state. The first reason stays until disarmed: it caused the others."""
        if self.state.mode is BoardMode.SAFE_LATCHED and self.state.reason is not SafeReason.POWER_UP:
            return
        self._enter(BoardMode.SAFE_LATCHED, reason)
        self.parameters.count(Parameter.LATCHES)
        self.faults_to_send.append(BoardFaultRecord(reason, chamber, min(detail, HIGHEST_DETAIL)))

    def health(self, *, blemished: bool) -> Health:
        """The board's judgement of itself; `blemished`: a frame was refused lately."""
        if self.state.reason in _FAILED_REASONS:
            return Health.FAILED
        if self.state.bus_state is not BusState.ERROR_ACTIVE:
            return Health.DEGRADED
        return Health.WARNING if blemished else Health.OK

    # ------------------------------------------------------------------ steps

    def _begin_arming(self) -> None:
        state = self.state
        state.challenge_seed = next_challenge(state.challenge_seed)
        self.faults_to_send.clear()  # a late report of an old latch would look like a new one
        self._enter(BoardMode.ARMING, SafeReason.NONE)
        state.challenge = state.challenge_seed

    def _finish_arming(self, token: int) -> None:
        state = self.state
        if token != arm_token(state.challenge, self.dbc_hash):
            self.latch(SafeReason.ARMING_REFUSED, detail=ControlMode.ARM_CONFIRM)
            return
        timeout_us = 1000 * self.parameters.values[Parameter.HEARTBEAT_TIMEOUT]
        if state.heartbeat_us is None:
            self.latch(SafeReason.HEARTBEAT_TIMEOUT, detail=HIGHEST_DETAIL)
        elif self._now_us - state.heartbeat_us >= timeout_us:
            self.latch(SafeReason.HEARTBEAT_TIMEOUT, detail=(self._now_us - state.heartbeat_us) // 1000)
        else:
            self._enter(BoardMode.ARMED, SafeReason.NONE)
            state.control_mode = ControlMode.ARM_CONFIRM

    def _enter(self, mode: BoardMode, reason: SafeReason) -> None:
        state = self.state
        if (state.mode, state.reason) == (mode, reason):
            return
        state.mode, state.reason, state.mode_since_us = mode, reason, self._now_us
        state.control_mode = ControlMode.DISARM
        state.setpoints_hPa = VENTED_hPa
        state.challenge = 0
        self.transitions.append(Transition(self._now_us / 1e6, mode, reason))
