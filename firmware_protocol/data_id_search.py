"""Finds the list of 16 DataIDs for a message, so that the protection keeps its Hamming distance.

CRC-8H2F finds every flip of up to three bits over these lengths (Koopman and Chakravarty 2004: distance 4 up
to 119 bits), but profile 2 adds a byte to the CRC that depends on the counter: when a flip hits the counter,
the receiver also takes another DataID, and a careless list lets two flipped bits cancel it. The CRC is
linear, so a flip passes exactly if the sum of the syndromes of its bits and of the DataIDs' difference is 0.
All DataIDs of even parity keep the parity that x + 1 (a factor of the polynomial) checks, so that odd flips
are found; the search below then excludes the lists that would let a flip of two bits pass.

`softbot.dbc` holds the lists that came out, one message after the other; a new message takes its list from
`find_data_id_list(length, lists already there)`.
"""

from __future__ import annotations

from collections.abc import Sequence

from fastcrc import crc8

from firmware_protocol.spec import COUNTER_VALUES

COUNTER_BITS = range(8, 12)


def syndrome_of_bit(length_bytes: int, bit: int) -> int:
    """What flipping `bit` of a protected frame does to its CRC comparison (bits 0-7 are the CRC itself)."""
    if bit < 8:
        return 1 << bit
    flipped = (1 << (bit - 8)).to_bytes(length_bytes - 1, "little")
    return crc8.autosar(flipped + b"\0") ^ crc8.autosar(bytes(length_bytes))


def syndrome_of_data_id(length_bytes: int, difference: int) -> int:
    """What taking a DataID that differs by these bits does to the CRC."""
    return crc8.autosar(bytes(length_bytes - 1) + bytes([difference])) ^ crc8.autosar(bytes(length_bytes))


def find_data_id_list(length_bytes: int, taken: Sequence[Sequence[int]]) -> tuple[int, ...] | None:
    """The first list (in lexical order) that finds every flip of up to three bits in a frame of this length.

    At each counter value it avoids the DataIDs of the lists `taken`, so that a frame under a wrong identifier
    is found too. None if there is no such list.
    """
    counter = [syndrome_of_bit(length_bytes, bit) for bit in COUNTER_BITS]
    others = {syndrome_of_bit(length_bytes, bit) for bit in range(8 * length_bytes) if bit not in COUNTER_BITS}
    data_id = [syndrome_of_data_id(length_bytes, difference) for difference in range(256)]
    chosen: list[int] = []

    def fits(candidate: int) -> bool:
        for earlier_counter, earlier in enumerate(chosen):
            flipped = len(chosen) ^ earlier_counter
            syndrome = data_id[candidate ^ earlier]
            for bit in range(4):
                if flipped >> bit & 1:
                    syndrome ^= counter[bit]
            # the counter alone, or one of its bits with one other bit; three bits fail the parity check
            if syndrome == 0 or (flipped.bit_count() <= 2 and syndrome in others):
                return False
        return True

    def extend() -> bool:
        if len(chosen) == COUNTER_VALUES:
            return True
        avoided = {ids[len(chosen)] for ids in taken}
        for candidate in range(1, 256):
            if candidate.bit_count() % 2 or candidate in avoided or candidate in chosen or not fits(candidate):
                continue
            chosen.append(candidate)
            if extend():
                return True
            chosen.pop()
        return False

    return tuple(chosen) if extend() else None
