"""The protocol as a document: everything that the DBC says, in Markdown.

    python -m firmware_protocol.document > docs/protocol.md

A test holds docs/protocol.md equal to this.
"""

from __future__ import annotations

from collections.abc import Iterator

from firmware_protocol.bus_load import BusLoad, bus_load
from firmware_protocol.parameters import PARAMETERS
from firmware_protocol.spec import MessageSpec, ProtocolSpec, SignalKind, SignalSpec, spec

_PROTECTED_BITS = 12  # CRC and counter


def document(protocol: ProtocolSpec | None = None) -> str:
    """The whole document as Markdown; of `softbot.dbc` unless another spec is given."""
    protocol = protocol or spec()
    load = bus_load(protocol)
    lines = [*_introduction(protocol, load), *_overview(protocol, load), *_pressures(protocol), *_parameters()]
    lines += ["## Messages", ""]
    for message in protocol.messages:
        lines += _message(message)
    return "\n".join(lines).rstrip() + "\n"


def _introduction(protocol: ProtocolSpec, load: BusLoad) -> list[str]:
    return [
        f"# The protocol, version {protocol.version}",
        "",
        "Made from `firmware_protocol/softbot.dbc` by `python -m firmware_protocol.document`; change the DBC, not this",
        "page.",
        "The rules that the board follows, and where its two timeouts come from, are in [safety.md](safety.md).",
        "",
        protocol.comment,
        "",
        f"Hash of this DBC, as both ends exchange it: `0x{protocol.dbc_hash:08X}`.",
        "",
        f"**Bus load.** {100 * load.load:.1f} % of {protocol.bitrate_bit_s // 1000} kbit/s at worst: every frame with "
        "as many stuff bits as its length allows, every event message as often as its minimum gap allows, for ever.",
        "",
    ]


def _overview(protocol: ProtocolSpec, load: BusLoad) -> list[str]:
    lines = [
        "| id | message | from | bytes | sent | worst bits | load |",
        "|---|---|---|---|---|---|---|",
    ]
    for message, share in zip(protocol.messages, load.messages, strict=True):
        lines.append(
            f"| 0x{message.frame_id:03X} | [{message.name}](#{message.name.lower()}) | {message.sender} "
            f"| {message.length_bytes} | {_sent(message)} | {share.frame_bits} | {100 * share.load:.2f} % |"
        )
    return [*lines, ""]


def _pressures(protocol: ProtocolSpec) -> list[str]:
    lines = [
        "## Resolution and range of the pressures",
        "",
        f"Four pressures share a frame of 64 bits with the CRC (8) and the counter (4), which leaves "
        f"{64 - _PROTECTED_BITS} bits, 13 for each. The supply has a message of its own.",
        "",
        "| signals | step | rounding error at most | range |",
        "|---|---|---|---|",
    ]
    for message, name in (
        ("SequencerSetpoints", "Setpoint0"),
        ("BoardPressures", "Pressure0"),
        ("BoardSupply", "SupplyPressure"),
    ):
        signal = next(each for each in protocol.by_name[message].signals if each.name == name)
        lines.append(
            f"| {message}.{name.rstrip('0')} ({signal.length} bits) | {signal.scale:g} {signal.unit} "
            f"| {signal.scale / 2:g} {signal.unit} | {signal.minimum:g} … {signal.maximum:g} {signal.unit} |"
        )
    return [*lines, ""]


def _parameters() -> list[str]:
    lines = [
        "## Parameters",
        "",
        "Read and written with ParameterRequest; a limit can be lowered, never raised, and stays lowered until",
        "power-up.",
        "",
        "| number | parameter | unit | can be lowered to | meaning |",
        "|---|---|---|---|---|",
    ]
    for each in PARAMETERS:
        lowest = "read only" if each.minimum is None else str(each.minimum)
        lines.append(
            f"| {int(each.parameter)} | {each.parameter.name.lower()} | {each.unit} | {lowest} | {each.meaning} |"
        )
    return [*lines, ""]


def _message(message: MessageSpec) -> list[str]:
    lines = [
        f"### {message.name}",
        "",
        f"0x{message.frame_id:03X} ({message.frame_id}), {message.length_bytes} bytes, {message.sender} to "
        f"{', '.join(sorted(message.receivers))}, {_sent(message)}. {message.comment}",
        "",
        f"DataIDs: {bytes(message.data_ids).hex(' ').upper()}."
        + (f" Reserved bits: {_bits(message.reserved_mask)}." if message.reserved_mask else ""),
        "",
        "| bits | signal | type | step | offset | range | unit | values | meaning |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    return [*lines, *(_signal(each) for each in message.signals), ""]


def _signal(signal: SignalSpec) -> str:
    last = signal.start + signal.length - 1
    kind = f"{'i' if signal.signed else 'u'}{signal.length}" + _KINDS[signal.kind]
    values = ", ".join(f"{raw} {label}" for raw, label in sorted(signal.choices.items()))
    return (
        f"| {signal.start}–{last} | {signal.name} | {kind} | {signal.scale:g} | {signal.offset:g} "
        f"| {_number(signal.minimum)} … {_number(signal.maximum)} | {signal.unit} | {values} | {signal.comment} |"
    )


_KINDS = {SignalKind.NUMBER: "", SignalKind.SATURATED_NUMBER: ", saturates", SignalKind.ENUMERATION: ", enumeration"}


def _number(value: float) -> str:
    return str(int(value)) if value == int(value) else str(value)


def _sent(message: MessageSpec) -> str:
    if message.cycle_s is not None:
        return f"every {1000 * message.cycle_s:g} ms"
    return f"on an event, at most every {1000 * message.minimum_gap_s:g} ms"


def _bits(mask: int) -> str:
    return ", ".join(_runs([bit for bit in range(mask.bit_length()) if mask >> bit & 1]))


def _runs(bits: list[int]) -> Iterator[str]:
    first = bits[0]
    for bit, following in zip(bits, [*bits[1:], -1], strict=True):
        if following != bit + 1:
            yield str(bit) if bit == first else f"{first}–{bit}"
            first = following


if __name__ == "__main__":
    print(document(), end="")
