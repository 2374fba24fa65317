"""The board's parameters: what can be read over the bus, and the limits that can be lowered, never raised.

After the pattern of CANopen's SDO: a request names a parameter by number, the answer carries an abort code and the
value that is in force. A lower value is the stricter one for every parameter that can be written, so that whoever is
on the bus can make the board more careful and nothing else. What was lowered holds until power-up; disarming does not
bring it back. Values are whole numbers in the parameter's own unit.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from firmware_protocol.board_limits import BoardLimits
from firmware_protocol.enumerations import AbortCode, Parameter, ParameterOperation

HIGHEST_COUNT = 0xFFFFFFFF


class ParameterSpec(NamedTuple):
    """One parameter. `minimum`: the least value that can be written; None for one that can only be read."""

    parameter: Parameter
    unit: str
    minimum: int | None
    meaning: str


PARAMETERS = (
    ParameterSpec(Parameter.MAX_SETPOINT, "0.1 kPa", 1, "setpoints are clamped to it"),
    ParameterSpec(Parameter.OVER_PRESSURE, "0.1 kPa", 2, "a measured pressure above it latches the safe state"),
    ParameterSpec(Parameter.COMMAND_TIMEOUT, "ms", 40, "age of setpoints or control that latches an armed board"),
    ParameterSpec(Parameter.HEARTBEAT_TIMEOUT, "ms", 100, "age of the heartbeat that latches an armed board"),
    ParameterSpec(Parameter.ARMING_TIMEOUT, "ms", 200, "time from the challenge in which the token has to come"),
    ParameterSpec(Parameter.MAX_COUNTER_DELTA, "frames", 1, "largest step of a message's counter that is accepted"),
    ParameterSpec(Parameter.TOLERATED_ERRORS, "frames", 0, "refused frames of a message tolerated in the window"),
    ParameterSpec(Parameter.WINDOW_FRAMES, "frames", None, "the last frames of a message that are judged together"),
    ParameterSpec(Parameter.SETPOINTS_CLAMPED, "1", None, "setpoints clamped to the limit since power-up"),
    ParameterSpec(Parameter.LATCHES, "1", None, "times the board latched its safe state since power-up"),
)
"""The least timeouts are two cycles of the message they watch over (heartbeat: two, arming: four), so that one lost
frame does not latch a board that was asked to be careful."""

_SPECS = {int(each.parameter): each for each in PARAMETERS}


class ParameterAnswer(NamedTuple):
    """The content of a ParameterResponse frame."""

    abort_code: AbortCode
    parameter: int
    transaction: int
    value: int


class Parameters:
    """The values in force, one for each parameter; `values` is public, for the rules and for monitors."""

    def __init__(self, limits: BoardLimits) -> None:
        self.values: dict[Parameter, int] = {
            Parameter.MAX_SETPOINT: limits.max_setpoint_hPa,
            Parameter.OVER_PRESSURE: limits.over_pressure_hPa,
            Parameter.COMMAND_TIMEOUT: limits.command_timeout_ms,
            Parameter.HEARTBEAT_TIMEOUT: limits.heartbeat_timeout_ms,
            Parameter.ARMING_TIMEOUT: limits.arming_timeout_ms,
            Parameter.MAX_COUNTER_DELTA: limits.reception.max_counter_delta,
            Parameter.TOLERATED_ERRORS: limits.reception.tolerated_errors,
            Parameter.WINDOW_FRAMES: limits.reception.window_frames,
            Parameter.SETPOINTS_CLAMPED: 0,
            Parameter.LATCHES: 0,
        }

    def count(self, parameter: Parameter, more: int = 1) -> None:
        """Counts up, and stays at 2^32 - 1 when it gets there."""
        self.values[parameter] = min(self.values[parameter] + more, HIGHEST_COUNT)

    def execute(self, raw: Mapping[str, int], *, may_write: bool) -> ParameterAnswer:
        """Does what a ParameterRequest (its raw signals) asks for, if it is allowed, and says what came out."""
        number, transaction = raw["Parameter"], raw["Transaction"]
        known = _SPECS.get(number)
        if known is None:
            return ParameterAnswer(AbortCode.UNKNOWN_PARAMETER, number, transaction, 0)
        abort_code = AbortCode.DONE
        if raw["Operation"] == ParameterOperation.WRITE:
            abort_code = self._write(known, raw["Value"], may_write)
        return ParameterAnswer(abort_code, number, transaction, self.values[known.parameter])

    def _write(self, known: ParameterSpec, value: int, may_write: bool) -> AbortCode:
        if known.minimum is None:
            return AbortCode.READ_ONLY
        if not may_write:
            return AbortCode.WRONG_MODE
        if value > self.values[known.parameter]:
            return AbortCode.WOULD_RAISE
        if value < known.minimum:
            return AbortCode.TOO_LOW
        if known.parameter is Parameter.OVER_PRESSURE and value <= self.values[Parameter.MAX_SETPOINT]:
            return AbortCode.CONTRADICTS
        self.values[known.parameter] = value
        return AbortCode.DONE
