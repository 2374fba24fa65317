"""The message spec: `softbot.dbc`, read once with cantools and reduced to what codec and protection need.

Everything that both ends must agree on comes from that file: layout, scaling, ranges, value tables, cycle
times, who sends what, and the DataID lists of the end-to-end protection. Nothing is read at import.

Times of this package are whole microseconds inside (`t_us`), so that a timeout of 100 ms is exactly 100 ms
and a C reference decides identically; seconds at the boundary (`t_s`).
"""

from __future__ import annotations

import hashlib
import math
import re
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from importlib import resources
from typing import Any

from firmware_protocol.errors import FrameError, ProtocolError, SpecError

SEQUENCER = "Sequencer"
BOARD = "Board"
COUNTER_VALUES = 16


class SignalKind(StrEnum):
    """What encoding does with a value out of range (DBC attribute SignalKind)."""

    NUMBER = "Number"
    """Refused."""
    SATURATED_NUMBER = "SaturatedNumber"
    """A measurement: sent as the nearest end of its range. Not finite: refused all the same."""
    ENUMERATION = "Enumeration"
    """Only the values of its table."""


@dataclass(frozen=True, slots=True)
class SignalSpec:
    """One signal: `physical = raw * scale + offset` [unit], little-endian at bit `start`, `length` bits."""

    name: str
    start: int
    length: int
    signed: bool
    scale: float
    offset: float
    minimum: float
    maximum: float
    unit: str
    kind: SignalKind
    choices: dict[int, str]
    comment: str

    @property
    def whole(self) -> bool:
        """Whether physical values are whole numbers (scale 1, offset 0)."""
        return self.scale == 1 and self.offset == 0

    @property
    def raw_minimum(self) -> int:
        """Smallest raw count in range."""
        return round((self.minimum - self.offset) / self.scale)

    @property
    def raw_maximum(self) -> int:
        """Largest raw count in range."""
        return round((self.maximum - self.offset) / self.scale)


@dataclass(frozen=True, slots=True)
class MessageSpec:
    """One message. `cycle_s` is None for a message sent on an event, at most every `minimum_gap_s`."""

    frame_id: int
    name: str
    length_bytes: int
    sender: str
    receivers: frozenset[str]
    signals: tuple[SignalSpec, ...]
    cycle_s: float | None
    minimum_gap_s: float
    data_ids: tuple[int, ...]
    reserved_mask: int
    comment: str


@dataclass(frozen=True, slots=True)
class ProtocolSpec:
    """The whole DBC. `messages` by ascending identifier, that is by bus priority; `comment` on the whole of it."""

    version: str
    comment: str
    bitrate_bit_s: int
    dbc_hash: int
    messages: tuple[MessageSpec, ...]
    by_name: dict[str, MessageSpec]
    by_id: dict[int, MessageSpec]


def dbc_text() -> str:
    """The DBC as text with LF line ends, whatever the checkout made of them."""
    return (resources.files("firmware_protocol") / "softbot.dbc").read_text(encoding="utf-8")


def hash_of_dbc(text: str) -> int:
    """First 32 bits of the SHA-256 of a DBC's text (UTF-8, LF line ends)."""
    normalised = text.replace("\r\n", "\n").encode()
    return int.from_bytes(hashlib.sha256(normalised).digest()[:4], "big")


@lru_cache(maxsize=1)
def spec() -> ProtocolSpec:
    """The spec of `softbot.dbc`, read on the first call (about 0.3 s) and kept."""
    return read_spec(dbc_text())


def read_spec(text: str) -> ProtocolSpec:
    """Reads a DBC's text.

    Raises SpecError for overlapping or big-endian signals, an extended identifier, a message that does not
    begin with Crc (8 bits) and Counter (4 bits), a missing range, sender, table or DataID list.
    """
    import cantools

    try:
        database: Any = cantools.database.load_string(text, "dbc", strict=True)
    except cantools.database.Error as error:
        raise SpecError(f"softbot.dbc is not a valid DBC: {error}") from error
    attributes = database.dbc.attributes
    if "Baudrate" not in attributes:
        raise SpecError('softbot.dbc: the attribute Baudrate is missing; add BA_ "Baudrate" 500000;')
    messages = tuple(_read_message(message) for message in sorted(database.messages, key=lambda each: each.frame_id))
    return ProtocolSpec(
        version=database.version,
        comment=_comment(text),
        bitrate_bit_s=int(attributes["Baudrate"].value),
        dbc_hash=hash_of_dbc(text),
        messages=messages,
        by_name={message.name: message for message in messages},
        by_id={message.frame_id: message for message in messages},
    )


def message_spec(name: str) -> MessageSpec:
    """The message of this name; FrameError if the DBC has none."""
    message = spec().by_name.get(name)
    if message is None:
        raise unknown_message(name)
    return message


def unknown_message(name: str) -> FrameError:
    """The error that says that softbot.dbc has no message of this name."""
    return FrameError(f"{name!r} is no message of softbot.dbc (it has {', '.join(spec().by_name)})")


def dbc_hash() -> int:
    """The 32-bit hash of `softbot.dbc` that both ends compare before arming."""
    return spec().dbc_hash


def time_us(t_s: float) -> int:
    """Seconds to whole microseconds; ProtocolError when `t_s` is not finite."""
    if not math.isfinite(t_s):
        raise ProtocolError(f"time {t_s} s is not finite")
    return round(t_s * 1e6)


def _comment(text: str) -> str:
    found = re.search(r'^CM_ "((?:[^"\\]|\\.)*)";', text, re.MULTILINE)
    if found is None:
        raise SpecError('softbot.dbc: the comment on the whole is missing; add CM_ "…";')
    return found[1]


def _read_message(message: Any) -> MessageSpec:
    attributes = {name: attribute.value for name, attribute in message.dbc.attributes.items()}
    name = message.name
    if message.is_extended_frame:
        raise SpecError(f"{name}: only 11-bit identifiers are used here")
    if len(message.senders) != 1:
        raise SpecError(f"{name}: one sender expected, not {message.senders}")
    signals = tuple(_read_signal(name, signal) for signal in message.signals)
    if [(each.name, each.start, each.length) for each in signals[:2]] != [("Crc", 0, 8), ("Counter", 8, 4)]:
        raise SpecError(f"{name}: must begin with Crc (bits 0-7) and Counter (bits 8-11)")
    try:
        data_ids = tuple(bytes.fromhex(attributes.get("E2EDataIdList", "")))
    except ValueError as error:
        raise SpecError(f"{name}: E2EDataIdList is not hexadecimal: {error}") from error
    if len(data_ids) != COUNTER_VALUES:
        raise SpecError(f"{name}: E2EDataIdList needs {COUNTER_VALUES} bytes, it has {len(data_ids)}")
    used = 0
    for signal in signals:
        used |= ((1 << signal.length) - 1) << signal.start
    cycle_ms = int(attributes.get("GenMsgCycleTime", 0))
    gap_ms = int(attributes.get("GenMsgDelayTime", 0))
    if cycle_ms == 0 and gap_ms == 0:
        raise SpecError(f"{name}: needs GenMsgCycleTime, or GenMsgDelayTime if it is sent on an event")
    return MessageSpec(
        frame_id=message.frame_id,
        name=name,
        length_bytes=message.length,
        sender=message.senders[0],
        receivers=frozenset(message.receivers),
        signals=signals,
        cycle_s=cycle_ms / 1000 if cycle_ms else None,
        minimum_gap_s=gap_ms / 1000,
        data_ids=data_ids,
        reserved_mask=((1 << 8 * message.length) - 1) & ~used,
        comment=message.comment or "",
    )


def _read_signal(message_name: str, signal: Any) -> SignalSpec:
    name = f"{message_name}.{signal.name}"
    if signal.byte_order != "little_endian" or signal.is_multiplexer or signal.is_float:
        raise SpecError(f"{name}: only plain little-endian integers are used here")
    if signal.minimum is None or signal.maximum is None:
        raise SpecError(f"{name}: needs a range")
    attribute = signal.dbc.attributes.get("SignalKind")
    kind = list(SignalKind)[int(attribute.value)] if attribute is not None else SignalKind.NUMBER
    choices = {int(raw): str(label) for raw, label in (signal.choices or {}).items()}
    if kind is SignalKind.ENUMERATION and not choices:
        raise SpecError(f"{name}: an Enumeration needs a value table")
    return SignalSpec(
        name=signal.name,
        start=signal.start,
        length=signal.length,
        signed=signal.is_signed,
        scale=signal.scale,
        offset=signal.offset,
        minimum=signal.minimum,
        maximum=signal.maximum,
        unit=signal.unit or "",
        kind=kind,
        choices=choices,
        comment=signal.comment or "",
    )
