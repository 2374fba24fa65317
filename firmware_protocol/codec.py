"""Signals to frames and back, made from the DBC.

Values are physical ones in the DBC's units (kPa where it says kPa; `messages` converts from and to SI).
`raw = round((physical - offset) / scale)` to the nearest, ties to even, in double precision: what cantools
and a C `rint` give too. Encoding tolerates a millionth of a step beyond a range, so that every decoded value
encodes again. Enumerations take the values of their table only, in both directions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, NoReturn

from firmware_protocol.errors import FrameError
from firmware_protocol.frame import Frame
from firmware_protocol.spec import MessageSpec, SignalKind, SignalSpec, spec, unknown_message
from firmware_protocol.spec import dbc_hash as dbc_hash

RANGE_SLACK_STEPS = 1e-6


class _Field(NamedTuple):
    """A signal with all that packing needs worked out beforehand."""

    name: str
    start: int
    mask: int
    sign_bit: int
    scale: float
    offset: float
    raw_minimum: int
    raw_maximum: int
    lowest: float
    highest: float
    saturated: bool
    whole: bool
    allowed: frozenset[int] | None


@dataclass(frozen=True, slots=True)
class _Layout:
    message: MessageSpec
    fields: tuple[_Field, ...]
    payload: tuple[_Field, ...]


@lru_cache(maxsize=1)
def _layouts() -> tuple[dict[str, _Layout], dict[int, _Layout]]:
    by_name = {message.name: _layout(message) for message in spec().messages}
    return by_name, {layout.message.frame_id: layout for layout in by_name.values()}


def encode(name: str, signals: Mapping[str, float]) -> Frame:
    """The frame of message `name` with these signals [physical, DBC units]; every signal must be given.

    Crc and Counter may be left out (0); `e2e.protect` sets them. Raises FrameError for an unknown message, a
    missing or unknown signal, a value that is not a finite number, not whole where it must be, not in the
    value table, or out of range; measurements (SignalKind SaturatedNumber) out of range go as the end of
    their range.
    """
    layout = _layouts()[0].get(name)
    if layout is None:
        raise unknown_message(name)
    fields = layout.payload
    if len(signals) != len(fields):
        fields = tuple(each for each in layout.fields if each.name in signals or each.name not in ("Crc", "Counter"))
        if len(signals) != len(fields):
            _refuse_names(layout, signals)
    word = 0
    for field in fields:
        try:
            steps = (signals[field.name] - field.offset) / field.scale
            raw = round(steps)
        except KeyError:
            _refuse_names(layout, signals)
        except (TypeError, ValueError, OverflowError):  # no number, NaN, infinite
            _refuse_value(layout, field, signals[field.name], "is not a finite number")
        if not field.lowest <= steps <= field.highest:
            if not field.saturated:
                _refuse_value(layout, field, signals[field.name], "is out of range")
            raw = field.raw_minimum if steps < field.lowest else field.raw_maximum
        elif field.whole and raw != steps:
            _refuse_value(layout, field, signals[field.name], "is not a whole number")
        if field.allowed is not None and raw not in field.allowed:
            _refuse_value(layout, field, signals[field.name], "is not in the value table")
        word |= (raw & field.mask) << field.start
    return Frame(layout.message.frame_id, word.to_bytes(layout.message.length_bytes, "little"))


def decode(frame_id: int, data: bytes) -> tuple[str, dict[str, float]]:
    """Name and signals [physical, DBC units] of a frame, Crc and Counter among them; judges no CRC.

    Raises FrameError for an unknown identifier, a wrong length, a reserved bit that is set, a value out of
    range or not in its value table.
    """
    name, raw = unpack(frame_id, data)
    return name, physical(name, raw)


def unpack(frame_id: int, data: bytes) -> tuple[str, dict[str, int]]:
    """Name and signals of a frame as the whole numbers that it carries; else as `decode`."""
    layout = _layouts()[1].get(frame_id)
    if layout is None:
        raise FrameError(f"identifier {frame_id:#05x} is not in softbot.dbc")
    message = layout.message
    if len(data) != message.length_bytes:
        raise FrameError(f"{message.name}: {len(data)} bytes instead of {message.length_bytes}")
    word = int.from_bytes(data, "little")
    if word & message.reserved_mask:
        raise FrameError(f"{message.name}: reserved bits are set ({word & message.reserved_mask:#x})")
    values: dict[str, int] = {}
    for field in layout.fields:
        raw = (word >> field.start) & field.mask
        if raw & field.sign_bit:
            raw -= field.mask + 1
        if not field.raw_minimum <= raw <= field.raw_maximum:
            _refuse_value(layout, field, raw * field.scale + field.offset, "is out of range")
        if field.allowed is not None and raw not in field.allowed:
            _refuse_value(layout, field, raw, "is not in the value table")
        values[field.name] = raw
    return message.name, values


def physical(name: str, raw: Mapping[str, int]) -> dict[str, float]:
    """The physical values [DBC units] of the raw ones that `unpack` gave for message `name`."""
    return {
        field.name: raw[field.name] if field.whole else raw[field.name] * field.scale + field.offset
        for field in _layouts()[0][name].fields
    }


def _layout(message: MessageSpec) -> _Layout:
    fields = tuple(_field(signal) for signal in message.signals)
    return _Layout(message, fields, tuple(each for each in fields if each.name not in ("Crc", "Counter")))


def _field(signal: SignalSpec) -> _Field:
    return _Field(
        name=signal.name,
        start=signal.start,
        mask=(1 << signal.length) - 1,
        sign_bit=1 << (signal.length - 1) if signal.signed else 0,
        scale=signal.scale,
        offset=signal.offset,
        raw_minimum=signal.raw_minimum,
        raw_maximum=signal.raw_maximum,
        lowest=signal.raw_minimum - RANGE_SLACK_STEPS,
        highest=signal.raw_maximum + RANGE_SLACK_STEPS,
        saturated=signal.kind is SignalKind.SATURATED_NUMBER,
        whole=signal.whole,
        allowed=frozenset(signal.choices) if signal.kind is SignalKind.ENUMERATION else None,
    )


def _refuse_names(layout: _Layout, signals: Mapping[str, float]) -> NoReturn:
    missing = [each.name for each in layout.payload if each.name not in signals]
    unknown = sorted(set(signals) - {each.name for each in layout.fields})
    raise FrameError(f"{layout.message.name}: signals missing {missing}, unknown {unknown}")


def _refuse_value(layout: _Layout, field: _Field, value: object, why: str) -> NoReturn:
    signal = next(each for each in layout.message.signals if each.name == field.name)
    unit = f" {signal.unit}" if signal.unit not in ("", "1") else ""
    expected = f"{signal.minimum} to {signal.maximum}{unit}"
    if field.allowed is not None:
        expected = ", ".join(f"{raw} {label}" for raw, label in sorted(signal.choices.items()))
    raise FrameError(f"{layout.message.name}.{field.name} = {value} {why} (allowed: {expected})")
