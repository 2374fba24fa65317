"""Names and types of the C codec: what a message, a signal and its unit are called, and the C type that holds it."""

from __future__ import annotations

import re

from firmware_protocol.spec import MessageSpec, SignalSpec

GENERATED = "/* Made from softbot.dbc by firmware_protocol/c_codec.py: change the DBC, not this file. */"


def snake_case(name: str) -> str:
    """`DbcHash` to `dbc_hash`, `UptimeS` to `uptime_s`."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


def payload(message: MessageSpec) -> tuple[SignalSpec, ...]:
    """The signals of a message's struct: all but Crc and Counter, which belong to the protection."""
    return tuple(signal for signal in message.signals if signal.name not in ("Crc", "Counter"))


def unit_suffix(signal: SignalSpec) -> str:
    """The unit as part of a C name: `kPa`, `rad_s`, `m_s2`; `number` where there is none."""
    return re.sub(r"\W+", "_", signal.unit) if signal.unit not in ("", "1") else "number"


def type_bits(signal: SignalSpec) -> int:
    """Width of the C integer that holds a signal: 8, 16, 32 or 64."""
    return next(bits for bits in (8, 16, 32, 64) if bits >= signal.length)


def c_type(signal: SignalSpec) -> str:
    """The C type of a signal's raw value: `uint16_t`."""
    return f"{'' if signal.signed else 'u'}int{type_bits(signal)}_t"


def function_prefix(message: MessageSpec) -> str:
    """What the names of a message's functions begin with: `softbot_board_pressures`."""
    return f"softbot_{snake_case(message.name)}"
