"""The C codec, made from the DBC: messages as structs of raw integers, packed and unpacked, and their scaling.

Four files. `softbot_messages.h` and `.c`: value tables, the list of messages with their DataIDs, one struct and two
functions (pack, unpack) a message; integers only. `softbot_physical.h` and `.c`: each scaled signal from and to
its unit in double precision, rounded exactly as `codec` rounds (to the nearest, ties to even, a millionth of
a step of slack at the ends of a range); firmware that works in raw counts leaves these two out.

A check that cannot fail, because the C type or the bits of the signal already hold it, is not written, so that every
branch of the code can be tested.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import IntEnum

from firmware_protocol import enumerations
from firmware_protocol.c_names import GENERATED, c_type, function_prefix, payload, snake_case, type_bits
from firmware_protocol.c_physical import physical_header, physical_source
from firmware_protocol.errors import SpecError
from firmware_protocol.messages import CHAMBERS
from firmware_protocol.spec import COUNTER_VALUES, MessageSpec, ProtocolSpec, SignalKind, SignalSpec

Interval = tuple[int, int]

_LINE_LENGTH = 120


def c_codec(protocol: ProtocolSpec) -> dict[str, str]:
    """The text of each file, by its name.

    Raises SpecError for a message that carries nothing, or a scaled signal too long for a double.
    """
    for message in protocol.messages:
        if not payload(message):
            raise SpecError(f"{message.name}: carries nothing but Crc and Counter; a C struct needs a signal")
    return {
        "softbot_messages.h": _messages_header(protocol),
        "softbot_messages.c": _messages_source(protocol),
        "softbot_physical.h": physical_header(protocol),
        "softbot_physical.c": physical_source(protocol),
    }


# ---------------------------------------------------------------------- what a signal may carry


def _allowed(signal: SignalSpec) -> list[Interval]:
    """The raw values that may be sent, as intervals in ascending order."""
    lowest, highest = signal.raw_minimum, signal.raw_maximum
    if signal.kind is not SignalKind.ENUMERATION:
        return [(lowest, highest)]
    intervals: list[Interval] = []
    for raw in sorted(raw for raw in signal.choices if lowest <= raw <= highest):
        if intervals and intervals[-1][1] == raw - 1:
            intervals[-1] = (intervals[-1][0], raw)
        else:
            intervals.append((raw, raw))
    return intervals


def _representable(bits: int, signed: bool) -> Interval:
    return (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signed else (0, (1 << bits) - 1)


def _condition(signal: SignalSpec, bits: int) -> str | None:
    """A C condition on `raw` of that many bits; None if it always holds."""
    lowest, highest = _representable(bits, signal.signed)
    alternatives = []
    for low, high in _allowed(signal):
        if low == high:
            alternatives.append(f"(raw == {_literal(low, signal)})")
            continue
        parts = [f"(raw >= {_literal(low, signal)})"] if low > lowest else []
        parts += [f"(raw <= {_literal(high, signal)})"] if high < highest else []
        if not parts:
            return None
        alternatives.append(parts[0] if len(parts) == 1 else f"({' && '.join(parts)})")
    return " || ".join(alternatives) if len(alternatives) > 1 else alternatives[0][1:-1]


def _literal(value: int, signal: SignalSpec) -> str:
    if signal.signed:
        return f"({value})" if value < 0 else f"{value}"
    return f"{value}u" if value <= 0xFFFF_FFFF else f"UINT64_C({value})"


def _predicate_name(message: MessageSpec, signal: SignalSpec) -> str:
    return f"{snake_case(message.name)}_{snake_case(signal.name)}_is_valid"


def _pack_refuses(signal: SignalSpec) -> bool:
    saturated = signal.kind is SignalKind.SATURATED_NUMBER
    return not saturated and _condition(signal, type_bits(signal)) is not None


def _unpack_refuses(signal: SignalSpec) -> bool:
    return _condition(signal, signal.length) is not None


# ---------------------------------------------------------------------- softbot_messages.h


def _messages_header(protocol: ProtocolSpec) -> str:
    lines = [
        GENERATED,
        "#ifndef SOFTBOT_MESSAGES_H",
        "#define SOFTBOT_MESSAGES_H",
        "",
        "#include <stdbool.h>",
        "#include <stdint.h>",
        "",
        f"#define SOFTBOT_BITRATE_BIT_S {protocol.bitrate_bit_s}u",
        "/* First 32 bits of the SHA-256 of softbot.dbc: both ends compare it before arming. */",
        f"#define SOFTBOT_DBC_HASH 0x{protocol.dbc_hash:08X}u",
        f"#define SOFTBOT_COUNTER_VALUES {COUNTER_VALUES}u",
        f"#define SOFTBOT_CHAMBERS {CHAMBERS}u",
        "/* Chamber signals carry this where no single chamber is concerned. */",
        f"#define SOFTBOT_NO_CHAMBER {enumerations.NO_CHAMBER}u",
        "",
    ]
    for table in _tables():
        lines += _enumeration(table)
    lines += [
        "/* The messages in the order of their identifiers, that is by bus priority: index into softbot_messages[]. */",
        "typedef enum {",
        *(f"    {_index(message)} = {number}," for number, message in enumerate(protocol.messages)),
        f"    SOFTBOT_MESSAGE_COUNT = {len(protocol.messages)}",
        "} softbot_message_index_t;",
        "",
        "/* Who receives a message: bits of softbot_message_t.receivers. */",
        *(f"#define SOFTBOT_NODE_{node.upper()} {1 << bit}u" for bit, node in enumerate(_nodes(protocol))),
        "",
        "/* cycle_us: 0 for a message sent on an event, at most every gap_us. data_ids: one for each counter value. */",
        "typedef struct {",
        "    uint16_t id;",
        "    uint8_t length;",
        "    uint8_t sender;",
        "    uint8_t receivers;",
        "    uint32_t cycle_us;",
        "    uint32_t gap_us;",
        "    uint8_t data_ids[SOFTBOT_COUNTER_VALUES];",
        "} softbot_message_t;",
        "",
        "extern const softbot_message_t softbot_messages[SOFTBOT_MESSAGE_COUNT];",
        "",
        "/*",
        " * pack: false, and nothing written, if a value is not allowed; a measurement (SaturatedNumber) out of range",
        " * goes as the end of its range. CRC and counter are left 0 for softbot_e2e_protect.",
        " * unpack: false for a reserved bit that is set, a value out of range or not in its table; `signals` is then",
        " * not to be used. Judges no CRC.",
        " */",
        "",
    ]
    for message in protocol.messages:
        lines += _message_declarations(message)
    lines += [
        "/* Any message; `index` says which member holds. */",
        "typedef struct {",
        "    softbot_message_index_t index;",
        "    union {",
        *(f"        {_struct(message)} {snake_case(message.name)};" for message in protocol.messages),
        "    } of;",
        "} softbot_signals_t;",
        "",
        "/* The functions above by index; false for SOFTBOT_MESSAGE_COUNT too. `data` holds the message's length. */",
        "bool softbot_pack(const softbot_signals_t *signals, uint8_t data[]);",
        "bool softbot_unpack(softbot_message_index_t index, const uint8_t data[], softbot_signals_t *signals);",
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _tables() -> list[type[IntEnum]]:
    found = vars(enumerations).values()
    return [each for each in found if isinstance(each, type) and issubclass(each, IntEnum) and each is not IntEnum]


def _enumeration(table: type[IntEnum]) -> list[str]:
    prefix = f"SOFTBOT_{snake_case(table.__name__).upper()}"
    members = [f"    {prefix}_{each.name} = {each.value}" for each in table]
    return ["typedef enum {", *(f"{each}," for each in members[:-1]), members[-1], f"}} {prefix.lower()}_t;", ""]


def _nodes(protocol: ProtocolSpec) -> list[str]:
    return sorted({node for message in protocol.messages for node in (message.sender, *message.receivers)})


def _index(message: MessageSpec) -> str:
    return f"SOFTBOT_MESSAGE_{snake_case(message.name).upper()}"


def _macro(message: MessageSpec) -> str:
    return f"SOFTBOT_{snake_case(message.name).upper()}"


def _struct(message: MessageSpec) -> str:
    return f"{function_prefix(message)}_t"


def _pack_prototype(message: MessageSpec) -> str:
    name, length = function_prefix(message), f"{_macro(message)}_LENGTH"
    return _fitted(f"bool {name}_pack(", (f"const {name}_t *signals", f"uint8_t data[{length}]"), ", ", ")")


def _unpack_prototype(message: MessageSpec) -> str:
    name, length = function_prefix(message), f"{_macro(message)}_LENGTH"
    return _fitted(f"bool {name}_unpack(", (f"const uint8_t data[{length}]", f"{name}_t *signals"), ", ", ")")


def _fitted(before: str, parts: Sequence[str], between: str, after: str) -> str:
    """One line if it fits, else one part a line, each below the first."""
    line = before + between.join(parts) + after
    if len(line) < _LINE_LENGTH:
        return line
    return before + (between.rstrip() + "\n" + " " * len(before)).join(parts) + after


def _message_declarations(message: MessageSpec) -> list[str]:
    rhythm = f"every {message.cycle_s * 1000:g} ms" if message.cycle_s is not None else "on an event"
    receivers = ", ".join(sorted(message.receivers))
    return [
        f"/* {message.name}: {message.sender} to {receivers}, {rhythm}. */",
        f"#define {_macro(message)}_ID 0x{message.frame_id:03X}u",
        f"#define {_macro(message)}_LENGTH {message.length_bytes}u",
        "typedef struct {",
        *(f"    {c_type(each)} {snake_case(each.name)}; /* {_explained(each)} */" for each in payload(message)),
        f"}} {_struct(message)};",
        f"{_pack_prototype(message)};",
        f"{_unpack_prototype(message)};",
        "",
    ]


def _explained(signal: SignalSpec) -> str:
    unit = f" {signal.unit}" if signal.unit not in ("", "1") else ""
    if signal.kind is SignalKind.ENUMERATION:
        return "value table: " + ", ".join(
            f"{low}" if low == high else f"{low} to {high}" for low, high in _allowed(signal)
        )
    limits = f"{signal.raw_minimum} to {signal.raw_maximum}"
    if signal.whole:
        return f"{limits}{unit}"
    offset = f" {'-' if signal.offset < 0 else '+'} {abs(signal.offset):g}{unit}" if signal.offset else ""
    return f"{limits} times {signal.scale:g}{unit}{offset}"


# ---------------------------------------------------------------------- softbot_messages.c


def _messages_source(protocol: ProtocolSpec) -> str:
    lines = [GENERATED, '#include "softbot_messages.h"', ""]
    lines += ["const softbot_message_t softbot_messages[SOFTBOT_MESSAGE_COUNT] = {"]
    for message in protocol.messages:
        lines += _table_row(message)
    lines += ["};", ""]
    lines += _WORD_FUNCTIONS
    if any(signal.signed for message in protocol.messages for signal in payload(message)):
        lines += _SIGN_FUNCTION
    for message in protocol.messages:
        for signal in payload(message):
            if _pack_refuses(signal) or _unpack_refuses(signal):
                lines += _predicate(message, signal)
        lines += _pack(message) + _unpack(message)
    lines += _dispatch(protocol)
    return "\n".join(lines)


_WORD_FUNCTIONS = """\
/* The frame as one little-endian number: byte 0 holds bits 0 to 7. */
static uint64_t word_of(const uint8_t data[], uint32_t length)
{
    uint64_t word = 0u;
    for (uint32_t i = 0u; i < length; i++) {
        word |= (uint64_t)data[i] << (8u * i);
    }
    return word;
}

static void put_word(uint64_t word, uint8_t data[], uint32_t length)
{
    for (uint32_t i = 0u; i < length; i++) {
        data[i] = (uint8_t)((word >> (8u * i)) & 0xFFu);
    }
}

""".splitlines()

_SIGN_FUNCTION = """\
/* Two's complement of any width, without a conversion that the implementation defines. */
static int64_t sign_extended(uint64_t raw, uint64_t sign_bit)
{
    return (int64_t)(raw ^ sign_bit) - (int64_t)sign_bit;
}

""".splitlines()


def _table_row(message: MessageSpec) -> list[str]:
    receivers = " | ".join(f"SOFTBOT_NODE_{node.upper()}" for node in sorted(message.receivers))
    ids = [f"0x{each:02X}u" for each in message.data_ids]
    cycle_us = round((message.cycle_s or 0) * 1e6)
    return [
        f"    [{_index(message)}] = {{",
        f"        .id = {_macro(message)}_ID,",
        f"        .length = {_macro(message)}_LENGTH,",
        f"        .sender = SOFTBOT_NODE_{message.sender.upper()},",
        f"        .receivers = {receivers},",
        f"        .cycle_us = {cycle_us}u,",
        f"        .gap_us = {round(message.minimum_gap_s * 1e6)}u,",
        f"        .data_ids = {{{', '.join(ids[:8])},",
        f"                     {', '.join(ids[8:])}}},",
        "    },",
    ]


def _predicate(message: MessageSpec, signal: SignalSpec) -> list[str]:
    # A saturated signal's predicate serves unpack alone, all others pack as well.
    bits = type_bits(signal) if _pack_refuses(signal) else signal.length
    return [
        f"static bool {_predicate_name(message, signal)}({c_type(signal)} raw)",
        "{",
        f"    return {_condition(signal, bits)};",
        "}",
        "",
    ]


def _pack(message: MessageSpec) -> list[str]:
    checks = [
        f"{_predicate_name(message, each)}(signals->{snake_case(each.name)})"
        for each in payload(message)
        if _pack_refuses(each)
    ]
    body = ["uint64_t word = 0u;"]
    for signal in payload(message):
        field = f"signals->{snake_case(signal.name)}"
        if signal.kind is SignalKind.SATURATED_NUMBER and _condition(signal, type_bits(signal)) is not None:
            body += _saturating(signal)
            field = snake_case(signal.name)
        widened = f"(uint64_t)(int64_t){field}" if signal.signed else f"(uint64_t){field}"
        body.append(f"word |= ({widened} & {_mask(signal)}) << {signal.start}u;")
    body.append(f"put_word(word, data, {_macro(message)}_LENGTH);")
    if not checks:
        return [_pack_prototype(message), "{", *_indented(body), "    return true;", "}", ""]
    return [
        _pack_prototype(message),
        "{",
        _fitted("    const bool valid = ", checks, " && ", ";"),
        "    if (valid) {",
        *_indented(_indented(body)),
        "    }",
        "    return valid;",
        "}",
        "",
    ]


def _indented(lines: Iterable[str]) -> list[str]:
    return [f"    {each}" for each in lines]


def _saturating(signal: SignalSpec) -> list[str]:
    name = snake_case(signal.name)
    lowest, highest = _representable(type_bits(signal), signal.signed)
    lines = [f"{c_type(signal)} {name} = signals->{name};"]
    ends = [("<", signal.raw_minimum)] if signal.raw_minimum > lowest else []
    ends += [(">", signal.raw_maximum)] if signal.raw_maximum < highest else []
    for comparison, end in ends:
        lines += [
            f"if ({name} {comparison} {_literal(end, signal)}) {{",
            f"    {name} = {_literal(end, signal)};",
            "}",
        ]
    return lines


def _unpack(message: MessageSpec) -> list[str]:
    lines = [
        _unpack_prototype(message),
        "{",
        f"    const uint64_t word = word_of(data, {_macro(message)}_LENGTH);",
    ]
    checks = [f"((word & UINT64_C(0x{message.reserved_mask:X})) == 0u)"] if message.reserved_mask else []
    for signal in payload(message):
        name = snake_case(signal.name)
        raw = f"(word >> {signal.start}u) & {_mask(signal)}"
        if signal.signed:
            raw = f"sign_extended({raw}, UINT64_C(0x{1 << (signal.length - 1):X}))"
            lines.append(f"    signals->{name} = ({c_type(signal)}){raw};")
        else:
            lines.append(f"    signals->{name} = ({c_type(signal)})({raw});")
        if _unpack_refuses(signal):
            checks.append(f"{_predicate_name(message, signal)}(signals->{name})")
    return [*lines, _fitted("    return ", checks or ["true"], " && ", ";"), "}", ""]


def _mask(signal: SignalSpec) -> str:
    return f"UINT64_C(0x{(1 << signal.length) - 1:X})"


def _dispatch(protocol: ProtocolSpec) -> list[str]:
    """`softbot_pack` and `softbot_unpack`: the message's own, by its index."""
    return [
        *_switch(
            protocol,
            "bool softbot_pack(const softbot_signals_t *signals, uint8_t data[])",
            "packed",
            ["    switch (signals->index) {"],
            "_pack(&signals->of.{member}, data)",
        ),
        *_switch(
            protocol,
            "bool softbot_unpack(softbot_message_index_t index, const uint8_t data[], softbot_signals_t *signals)",
            "unpacked",
            ["    signals->index = index;", "    switch (index) {"],
            "_unpack(data, &signals->of.{member})",
        ),
    ]


def _switch(protocol: ProtocolSpec, head: str, result: str, before: list[str], call: str) -> list[str]:
    lines = [head, "{", f"    bool {result} = false;", *before]
    for message in protocol.messages:
        called = function_prefix(message) + call.format(member=snake_case(message.name))
        lines += [f"    case {_index(message)}:", f"        {result} = {called};", "        break;"]
    lines += ["    case SOFTBOT_MESSAGE_COUNT:", "    default:", "        break;", "    }"]
    return [*lines, f"    return {result};", "}", ""]
