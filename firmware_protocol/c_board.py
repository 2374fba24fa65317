"""The C reference as the deciding board: the interface of `board.BoardRules`, every decision made in C.

Python only carries values across: SI to whole counts, frames to bytes. What the C side cannot be given at all (a time
that is no number, five pressures) ends in the latched safe state, as it does in Python.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache

from firmware_protocol.board import VENTED, BoardDecision, measured_hPa
from firmware_protocol.board_limits import BoardLimits
from firmware_protocol.c_reference import load_c_reference
from firmware_protocol.codec import unpack
from firmware_protocol.e2e import FrameStatus
from firmware_protocol.enumerations import BoardMode, BusState, ControlMode, SafeReason
from firmware_protocol.errors import LimitsError, ProtocolError
from firmware_protocol.frame import Frame
from firmware_protocol.messages import CHAMBERS, PASCAL_PER_HECTOPASCAL, PASCAL_PER_KILOPASCAL
from firmware_protocol.parameters import PARAMETERS, Parameters
from firmware_protocol.reception import Received
from firmware_protocol.safety import BoardFaultRecord, BoardState, SENSOR_INVALID_hPa, Transition
from firmware_protocol.spec import spec, time_us

_HIGHEST_US = (1 << 63) - 1
_HIGHEST_WINDOW = 32
_FRAME_BYTES = 11
_MOST_FRAMES = 6
_STATUSES = tuple(FrameStatus)
_STATE_VALUES = 18
_KEPT_FAULTS = 8
_KEPT_TRANSITIONS = 16


@cache
def _library() -> ctypes.CDLL:
    return load_c_reference()


class CBoardRules:
    """The rules in C, one object a board; use and arguments as `BoardRules`.

    Compiles the reference on the first use (about 1 s), unless `library` is one of it already. Raises LimitsError as
    `BoardRules` does and for a window of more than 32 frames, CompilerError where there is no C compiler.
    """

    def __init__(
        self,
        limits: BoardLimits,
        *,
        challenge_seed: int = 1,
        version: tuple[int, int, int] = (0, 1, 0),
        library: ctypes.CDLL | None = None,
    ) -> None:
        if not 1 <= challenge_seed <= 0xFFFF:
            raise LimitsError(f"challenge_seed = {challenge_seed} must be from 1 to 65535")
        if limits.reception.window_frames > _HIGHEST_WINDOW:
            raise LimitsError(
                f"window_frames = {limits.reception.window_frames} must be at most {_HIGHEST_WINDOW} for the board in C"
            )
        self.limits = limits
        self.version = version
        self._last_error = ""
        self._library = library or _library()
        self._library.softbot_host_size.restype = ctypes.c_size_t
        self._library.softbot_host_init.restype = ctypes.c_bool
        self.board = (ctypes.c_uint64 * -(-self._library.softbot_host_size() // 8))()  # uint64: aligned for anything
        reception = limits.reception
        counts = (
            *(limits.max_setpoint_hPa, limits.over_pressure_hPa),
            *(limits.command_timeout_ms, limits.heartbeat_timeout_ms, limits.arming_timeout_ms),
            *(reception.max_counter_delta, reception.window_frames, reception.tolerated_errors),
        )
        if not self._library.softbot_host_init(
            self.board, (ctypes.c_uint16 * 8)(*counts), ctypes.c_uint16(challenge_seed), (ctypes.c_uint8 * 3)(*version)
        ):
            raise LimitsError(f"version {version}: the major number must be from 0 to 15")

    # ------------------------------------------------------------------ what can be seen

    @property
    def state(self) -> BoardState:
        """What the machine remembers now, read out of the C side."""
        values = self._values()
        times = [None if each < 0 else each for each in (values[11], *values[14:17])]
        return BoardState(
            mode=BoardMode(values[0]),
            reason=SafeReason(values[1]),
            control_mode=ControlMode(values[2]),
            setpoints_hPa=(values[3], values[4], values[5], values[6]),
            challenge=values[7],
            challenge_seed=values[8],
            pressures_valid=bool(values[9]),
            bus_state=BusState(values[10]),
            now_us=times[0],
            started_us=values[12],
            mode_since_us=values[13],
            setpoints_us=times[1],
            control_us=times[2],
            heartbeat_us=times[3],
            last_error=self._last_error,
        )

    @property
    def transitions(self) -> tuple[Transition, ...]:
        """The last changes of mode, at most 16, oldest first."""
        count = self._values()[17]
        kept, found = (ctypes.c_int64 * 3)(), []
        for number in range(max(0, count - _KEPT_TRANSITIONS), count):
            self._library.softbot_host_transition(self.board, ctypes.c_uint32(number), kept)
            found.append(Transition(kept[0] / 1e6, BoardMode(kept[1]), SafeReason(kept[2])))
        return tuple(found)

    @property
    def parameters(self) -> Parameters:
        """The values in force, read out of the C side; what is changed there changes nothing here."""
        parameters = Parameters(self.limits)
        for each, value in zip(PARAMETERS, self._values()[_STATE_VALUES:], strict=True):
            parameters.values[each.parameter] = value
        return parameters

    @property
    def faults_to_send(self) -> tuple[BoardFaultRecord, ...]:
        """The faults that are still to be sent, oldest first."""
        kept = (ctypes.c_int64 * (3 * _KEPT_FAULTS))()
        count = self._library.softbot_host_faults(self.board, kept)
        return tuple(BoardFaultRecord(SafeReason(kept[3 * i]), kept[3 * i + 1], kept[3 * i + 2]) for i in range(count))

    def counts(self, name: str) -> dict[FrameStatus, int]:
        """Frames of message `name` by what was made of them."""
        index = [message.name for message in spec().messages].index(name)
        state = (ctypes.c_int64 * (4 + len(_STATUSES)))()
        self._library.softbot_host_reception(self.board, ctypes.c_uint32(index), state)
        return dict(zip(_STATUSES, state[4:], strict=True))

    def _values(self) -> list[int]:
        state = (ctypes.c_int64 * (_STATE_VALUES + len(PARAMETERS)))()
        self._library.softbot_host_state(self.board, state)
        return list(state)

    # ------------------------------------------------------------------ what comes in

    def receive(self, frame_id: int, data: bytes, t_s: float) -> Received:
        """Judges one frame and acts on it if it is accepted."""
        try:
            now_us, content = _clock(t_s), bytes(data)
            carried_id = ctypes.c_uint32(frame_id if 0 <= frame_id < 1 << 32 else (1 << 32) - 1)
        except Exception as error:  # as in BoardRules: never in the caller
            self._internal_error(error)
            return Received(FrameStatus.MALFORMED)
        judged = (ctypes.c_int32 * 3)()
        self._library.softbot_host_receive(
            self.board,
            carried_id,
            content.ljust(8, b"\0"),
            ctypes.c_uint32(len(content)),
            now_us,
            judged,
        )
        status, index, beyond = _STATUSES[judged[0]], judged[1], bool(judged[2])
        if status is FrameStatus.NOT_LISTED:
            return Received(status)
        raw = unpack(frame_id, content)[1] if status.accepted else {}
        return Received(status, spec().messages[index].name, raw, beyond)

    def tick(self, t_s: float, measured_pressure_Pa: Sequence[float]) -> BoardDecision:
        """The cycle's decision, after checking timeouts and the measured pressures [4 values, gauge Pa]."""
        try:
            now_us = _clock(t_s)
            measured = [measured_hPa(each) for each in measured_pressure_Pa]
            if len(measured) != CHAMBERS:
                raise ValueError(f"{len(measured)} measured pressures for {CHAMBERS} chambers")
        except Exception as error:  # as in receive
            self._internal_error(error)
            now_us, measured = ctypes.c_uint64(self.state.now_us or 0), [SENSOR_INVALID_hPa] * CHAMBERS
        pressures = (ctypes.c_int32 * CHAMBERS)(*measured)
        decided = (ctypes.c_int32 * 8)()
        self._library.softbot_host_tick(self.board, now_us, pressures, decided)
        mode, reason = BoardMode(decided[0]), SafeReason(decided[1])
        if decided[2]:
            return BoardDecision(mode, True, reason, VENTED, bool(decided[3]))
        first, second, third, fourth = (each * PASCAL_PER_HECTOPASCAL for each in decided[4:])
        return BoardDecision(mode, False, reason, (first, second, third, fourth), bool(decided[3]))

    def report_failure(self, reason: SafeReason, detail: int = 0) -> None:
        """Latches the safe state for what the board's other parts found."""
        self._library.softbot_board_report_failure(
            self.board, ctypes.c_uint(reason), ctypes.c_uint16(max(0, min(detail, 0xFFFF)))
        )

    def report_bus(self, bus_state: BusState, transmit_errors: int = 0, receive_errors: int = 0) -> None:
        """Takes over what the CAN controller says of itself; bus-off latches the safe state."""
        errors = [ctypes.c_uint8(max(0, min(each, 0xFF))) for each in (transmit_errors, receive_errors)]
        self._library.softbot_board_report_bus(self.board, ctypes.c_uint(bus_state), *errors)

    def _internal_error(self, error: Exception) -> None:
        self._last_error = f"{type(error).__name__}: {error}"
        self.report_failure(SafeReason.INTERNAL_ERROR)

    # ------------------------------------------------------------------ what goes out

    def outgoing(self, t_s: float) -> list[Frame]:
        """The frames besides the measurements that are due at `t_s`, in order of priority."""
        try:
            now_us = _clock(t_s)
        except Exception as error:  # as in receive
            self._internal_error(error)
            return []
        frames = (ctypes.c_uint8 * (_FRAME_BYTES * _MOST_FRAMES))()
        return _frames(frames, self._library.softbot_host_outgoing(self.board, now_us, frames))

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
        """The cyclic measurement frames that are due at `t_s`, as `BoardRules.measurements`."""
        try:
            now_us = _clock(t_s)
            physical = [
                *(each / PASCAL_PER_KILOPASCAL for each in pressures_Pa),
                *openings,
                supply_pressure_Pa / PASCAL_PER_KILOPASCAL,
                *angular_velocity_rad_s,
                *specific_force_m_s2,
            ]
            lengths = [len(each) for each in (pressures_Pa, openings, angular_velocity_rad_s, specific_force_m_s2)]
            if lengths != [CHAMBERS, CHAMBERS, 3, 3]:
                raise ValueError(f"{lengths} values where 4 pressures, 4 openings and 2 times 3 axes belong")
            values = (ctypes.c_double * len(physical))(*physical)
        except Exception as error:  # as in receive
            self._internal_error(error)
            return []
        frames = (ctypes.c_uint8 * (_FRAME_BYTES * _MOST_FRAMES))()
        is_open = ctypes.c_uint8(bool(main_supply_open))
        return _frames(frames, self._library.softbot_host_measurements(self.board, now_us, values, is_open, frames))


def _clock(t_s: float) -> ctypes.c_uint64:
    now_us = time_us(t_s)
    if not 0 <= now_us <= _HIGHEST_US:
        raise ProtocolError(f"time {t_s} s: the board in C counts from 0")
    return ctypes.c_uint64(now_us)


def _frames(flat: ctypes.Array[ctypes.c_uint8], count: int) -> list[Frame]:
    frames = []
    for start in range(0, _FRAME_BYTES * count, _FRAME_BYTES):
        low, high, length, *data = flat[start : start + _FRAME_BYTES]
        frames.append(Frame(low | high << 8, bytes(data[:length])))
    return frames
