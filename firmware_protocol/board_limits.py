"""What a board enforces, as its maker sets it at power-up: SI values in, whole counts out.

Decisions are made on whole numbers (pressures in hPa, that is 0.1 kPa, the step of the bus; times in ms and µs), so
that a C reference decides identically. Limits are rounded down: never less strict than what was asked for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from firmware_protocol.errors import LimitsError
from firmware_protocol.messages import PASCAL_PER_HECTOPASCAL
from firmware_protocol.reception import ReceptionLimits
from firmware_protocol.spec import message_spec

_ROUNDING = 1e-6
"""Of a count: what a value that is meant to be whole may be off by in double precision."""


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
        highest_Pa = pressure.maximum * 1000.0
        if not 0 < self.max_setpoint_Pa < self.over_pressure_Pa <= highest_Pa:
            raise LimitsError(
                f"max_setpoint_Pa = {self.max_setpoint_Pa} and over_pressure_Pa = {self.over_pressure_Pa} "
                f"must be 0 < max_setpoint_Pa < over_pressure_Pa <= {highest_Pa:.0f} "
                "(the range of BoardPressures)"
            )
        if not 0 < self.max_setpoint_hPa < self.over_pressure_hPa:
            raise LimitsError(
                f"max_setpoint_Pa = {self.max_setpoint_Pa} and over_pressure_Pa = {self.over_pressure_Pa} "
                "must be at least 100 Pa (the step of the bus) and differ by as much"
            )
        for name in ("command_timeout_s", "heartbeat_timeout_s", "arming_timeout_s"):
            if not 0.001 <= getattr(self, name) <= 10:
                raise LimitsError(f"{name} = {getattr(self, name)} must be from 0.001 to 10 s")

    @property
    def max_setpoint_hPa(self) -> int:
        """As the safety machine takes it [gauge hPa]."""
        return _whole(self.max_setpoint_Pa / PASCAL_PER_HECTOPASCAL)

    @property
    def over_pressure_hPa(self) -> int:
        """As the safety machine takes it [gauge hPa]."""
        return _whole(self.over_pressure_Pa / PASCAL_PER_HECTOPASCAL)

    @property
    def command_timeout_ms(self) -> int:
        """As the safety machine takes it [ms]."""
        return _whole(self.command_timeout_s * 1000)

    @property
    def heartbeat_timeout_ms(self) -> int:
        """As the safety machine takes it [ms]."""
        return _whole(self.heartbeat_timeout_s * 1000)

    @property
    def arming_timeout_ms(self) -> int:
        """As the safety machine takes it [ms]."""
        return _whole(self.arming_timeout_s * 1000)


def _whole(value: float) -> int:
    return math.floor(value + _ROUNDING)
