"""The board's safety rules: received frames, measured pressures and time in; a decision and frames out.

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
the robot, and one that means harm gets the limit and no more. No frame can raise a limit; while nothing is armed,
a parameter request can lower one until power-up (`parameters`).

The decisions are made by `safety.SafetyMachine` in whole numbers; this module is its boundary: SI values, frames, and
the rule that an exception of the board ends in the safe state and never in the caller. Nothing is hidden: `state`,
`reception`, `parameters` and `transitions` are public. Time comes in as `t_s` and must not go back.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from firmware_protocol.board_limits import BoardLimits
from firmware_protocol.e2e import FrameStatus, Sender
from firmware_protocol.enumerations import (
    BoardMode,
    BusState,
    ControlMode,
    Parameter,
    SafeReason,
)
from firmware_protocol.errors import FrameError, LimitsError
from firmware_protocol.frame import Frame
from firmware_protocol.messages import (
    PASCAL_PER_HECTOPASCAL,
    PASCAL_PER_KILOPASCAL,
    FourValues,
    axis_signals,
    four_signals,
)
from firmware_protocol.parameters import ParameterAnswer, Parameters
from firmware_protocol.reception import Received, Reception
from firmware_protocol.safety import BoardFaultRecord, BoardState, SafetyMachine, SENSOR_INVALID_hPa, Transition
from firmware_protocol.schedule import Schedule
from firmware_protocol.spec import BOARD, dbc_hash, message_spec, time_us

VENTED: FourValues = (0.0, 0.0, 0.0, 0.0)
_HIGHEST_hPa = (1 << 31) - 1
_EVENTS = ("BoardFault", "ParameterResponse", "TimeSyncResponse")


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


def measured_hPa(pressure_Pa: float) -> int:
    """A measured pressure in whole hPa, rounded up, so that it is above a limit exactly if the pressure is."""
    if not math.isfinite(pressure_Pa):
        return SENSOR_INVALID_hPa
    return max(-_HIGHEST_hPa, min(math.ceil(pressure_Pa / PASCAL_PER_HECTOPASCAL), _HIGHEST_hPa))


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
        self.machine = SafetyMachine(Parameters(limits), challenge_seed=challenge_seed, dbc_hash=dbc_hash())
        self.reception = Reception(BOARD, limits.reception, frozenset({"EmergencyStop"}))
        self.sender = Sender()
        self.schedule = Schedule(BOARD)
        self.transmit_errors = 0
        self.receive_errors = 0
        self._next_event_us = dict.fromkeys(_EVENTS, 0)
        self._answer: ParameterAnswer | None = None
        self._sync: tuple[int, int] | None = None

    @property
    def state(self) -> BoardState:
        """What the safety machine remembers."""
        return self.machine.state

    @property
    def parameters(self) -> Parameters:
        """The limits as they stand, after what was lowered over the bus."""
        return self.machine.parameters

    @property
    def transitions(self) -> deque[Transition]:
        """The last changes of mode, oldest first."""
        return self.machine.transitions

    @property
    def faults_to_send(self) -> deque[BoardFaultRecord]:
        """Faults that no BoardFault frame has told of yet."""
        return self.machine.faults_to_send

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
            self.state.pressures_valid = False
            self.machine.measured([measured_hPa(each) for each in measured_pressure_Pa])
        except Exception as error:  # as in receive
            self._internal_error(error)
        state = self.state
        if state.safe:
            return BoardDecision(state.mode, True, state.reason, VENTED, False)
        first, second, third, fourth = (each * PASCAL_PER_HECTOPASCAL for each in state.setpoints_hPa)
        return BoardDecision(state.mode, False, state.reason, (first, second, third, fourth), True)

    def report_failure(self, reason: SafeReason, detail: int = 0) -> None:
        """Latches the safe state for what the board's other parts found (BUS_OFF, INTERNAL_ERROR, …)."""
        self.machine.latch(reason, detail=detail)

    def report_bus(self, bus_state: BusState, transmit_errors: int = 0, receive_errors: int = 0) -> None:
        """Takes over what the CAN controller says of itself; bus-off latches the safe state."""
        self.transmit_errors, self.receive_errors = transmit_errors, receive_errors
        self.machine.bus(bus_state)

    # ------------------------------------------------------------------ what goes out

    def outgoing(self, t_s: float) -> list[Frame]:
        """The frames besides the measurements that are due at `t_s`, in order of priority."""
        try:
            return self._outgoing(time_us(t_s))
        except Exception as error:  # as in receive
            self._internal_error(error)
            return []

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
        (x, y, z). A message with a value that is not finite is left out: the sequencer sees it missing.
        """
        try:
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
        except Exception as error:  # as in receive
            self._internal_error(error)
            return []
        frames = []
        for name, signals in content.items():
            if self.schedule.due(name, t_us):
                try:
                    frames.append(self.sender.send(name, signals))
                except FrameError as error:
                    self.state.last_error = str(error)
        return frames

    # ------------------------------------------------------------------ the boundary of the machine

    def _receive(self, frame_id: int, data: bytes, t_s: float) -> Received:
        # Timeouts first: a frame that comes too late must not hide that it was late.
        now_us = self._advance(t_s)
        received = self.reception.accept(frame_id, bytes(data), now_us)
        if received.beyond_tolerance:
            self.machine.beyond_tolerance(frame_id)
        if received.status.accepted:
            self._act(str(received.name), received.raw, now_us)
        return received

    def _act(self, name: str, raw: Mapping[str, int], now_us: int) -> None:
        machine = self.machine
        if name == "EmergencyStop":
            machine.emergency_stop(raw["Reason"])
        elif name == "SequencerControl":
            before = machine.state.mode
            machine.control(ControlMode(raw["Mode"]), raw["ArmToken"], raw["DbcHash"])
            if before is BoardMode.DISARMED and machine.state.mode is BoardMode.ARMING:
                self.reception.forgive()  # what was refused before has nothing to say about this handshake
        elif name == "SequencerSetpoints":
            machine.setpoints((raw["Setpoint0"], raw["Setpoint1"], raw["Setpoint2"], raw["Setpoint3"]))
        elif name == "SequencerHeartbeat":
            machine.heartbeat(raw["Health"])
        elif name == "ParameterRequest":
            self._answer = self.parameters.execute(raw, may_write=not machine.state.active)
            self.reception.tighten(
                self.parameters.values[Parameter.MAX_COUNTER_DELTA], self.parameters.values[Parameter.TOLERATED_ERRORS]
            )
        elif name == "TimeSyncRequest":
            self._sync = raw["SyncId"], now_us

    def _advance(self, t_s: float) -> int:
        now_us = time_us(t_s)
        if not self.machine.advance(now_us):
            self.reception.forget_times()
            self._next_event_us = dict.fromkeys(_EVENTS, now_us)
        return now_us

    def _outgoing(self, t_us: int) -> list[Frame]:
        state = self.state
        frames: list[Frame] = []
        if self.faults_to_send and self._event_due("BoardFault", t_us):
            fault = self.faults_to_send.popleft()
            signals = {"Reason": fault.reason, "Chamber": fault.chamber, "Detail": fault.detail}
            frames.append(self.sender.send("BoardFault", signals))
        if self.schedule.due("BoardHeartbeat", t_us):
            heartbeat = {
                "BoardMode": state.mode,
                "SafeReason": state.reason,
                "Health": self.machine.health(blemished=self.reception.blemished),
                "ArmChallenge": state.challenge,
                "UptimeS": (t_us - state.started_us) // 1_000_000,
            }
            frames.append(self.sender.send("BoardHeartbeat", heartbeat))
        if self.schedule.due("BoardBoot", t_us):
            major, minor, patch = self.version
            boot = {
                "VersionMajor": major,
                "VersionMinor": minor,
                "VersionPatch": patch,
                "DbcHash": self.machine.dbc_hash,
            }
            frames.append(self.sender.send("BoardBoot", boot))
        if self._answer is not None and self._event_due("ParameterResponse", t_us):
            abort_code, parameter, transaction, value = self._answer
            self._answer = None
            answer = {"AbortCode": abort_code, "Parameter": parameter, "Transaction": transaction, "Value": value}
            frames.append(self.sender.send("ParameterResponse", answer))
        if self._sync is not None and self._event_due("TimeSyncResponse", t_us):
            sync_id, came_us = self._sync
            self._sync = None
            sync = {"SyncId": sync_id, "ReceiveUs": came_us & 0xFFFFFFFF, "HoldUs": t_us - came_us}
            frames.append(self.sender.send("TimeSyncResponse", sync))
        if self.schedule.due("BoardErrors", t_us):
            frames.append(self.sender.send("BoardErrors", self._error_counters()))
        return frames

    def _error_counters(self) -> dict[str, float]:
        return {
            "BusState": self.state.bus_state,
            "TransmitErrors": self.transmit_errors,
            "ReceiveErrors": self.receive_errors,
            "ProtectionErrors": self.reception.protection_errors,
            "RefusedFrames": self.reception.refused_frames,
        }

    def _event_due(self, name: str, t_us: int) -> bool:
        """Whether the minimum gap of an event message is over; if so, it begins anew."""
        if t_us < self._next_event_us[name]:
            return False
        self._next_event_us[name] = t_us + time_us(message_spec(name).minimum_gap_s)
        return True

    def _internal_error(self, error: Exception) -> None:
        self.state.last_error = f"{type(error).__name__}: {error}"
        self.machine.latch(SafeReason.INTERNAL_ERROR)
