"""How much of the bus the protocol takes at worst, from the DBC's cycle times.

A classic data frame with an 11-bit identifier and n data bytes has 44 + 8 n bits from start of frame to end
of frame, followed by 3 bits of interframe space; of its first 34 + 8 n bits (start of frame to CRC) a stuff
bit follows at worst the first five and then every four (ISO 11898-1; worst case after Davis et al., Real-Time
Systems 35, 2007): 55 + 10 n bits and at most 135 in all. Event messages count as if sent at their minimum gap
for ever.
"""

from __future__ import annotations

from dataclasses import dataclass

from firmware_protocol.errors import FrameError
from firmware_protocol.spec import ProtocolSpec, spec


@dataclass(frozen=True, slots=True)
class MessageLoad:
    """One message's share. `load` is the fraction of the bus it takes."""

    name: str
    frame_bits: int
    period_s: float
    load: float


@dataclass(frozen=True, slots=True)
class BusLoad:
    """The whole bus: `load` is the sum over `messages`."""

    bitrate_bit_s: int
    messages: tuple[MessageLoad, ...]

    @property
    def load(self) -> float:
        """Share of the bus's time that all messages take, 1: all of it."""
        return sum(message.load for message in self.messages)


def worst_case_frame_bits(length_bytes: int) -> int:
    """Bits on the wire of a classic 11-bit data frame with 0 to 8 bytes, stuffing and spacing included."""
    if not 0 <= length_bytes <= 8:
        raise FrameError(f"a classic CAN frame has 0 to 8 bytes, not {length_bytes}")
    stuffed = 34 + 8 * length_bytes
    return 44 + 8 * length_bytes + 3 + (stuffed - 1) // 4


def bus_load(protocol: ProtocolSpec | None = None) -> BusLoad:
    """The worst-case load of `protocol` (default: softbot.dbc) at its bit rate."""
    protocol = protocol or spec()
    messages = []
    for message in protocol.messages:
        period_s = message.minimum_gap_s if message.cycle_s is None else message.cycle_s
        bits = worst_case_frame_bits(message.length_bytes)
        messages.append(MessageLoad(message.name, bits, period_s, bits / period_s / protocol.bitrate_bit_s))
    return BusLoad(protocol.bitrate_bit_s, tuple(messages))
