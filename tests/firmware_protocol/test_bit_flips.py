"""Every flip of one, two or three bits of every protected frame is rejected: all of them, tried and counted."""

from __future__ import annotations

from itertools import combinations
from math import comb

import numpy as np
import pytest
from numpy.typing import NDArray

from firmware_protocol.e2e import check, protect
from firmware_protocol.spec import COUNTER_VALUES, MessageSpec, spec

Bytes = NDArray[np.uint8]
MESSAGES = spec().messages


def crc_table() -> Bytes:
    table = np.arange(256, dtype=np.uint8)
    for _ in range(8):
        table = np.where(table & 0x80, (table << 1) ^ 0x2F, table << 1).astype(np.uint8)
    return table


TABLE = crc_table()


def accepted(frames: Bytes, data_ids: Bytes) -> NDArray[np.bool_]:
    """Which of the frames (one a row) have the CRC of their counter's DataID: `e2e.check` for many at once."""
    crc = np.full(len(frames), 0xFF, dtype=np.uint8)
    for column in range(1, frames.shape[1]):
        crc = TABLE[crc ^ frames[:, column]]
    crc = TABLE[crc ^ data_ids[frames[:, 1] & 0x0F]] ^ 0xFF
    return crc == frames[:, 0]


def flips_of(length_bytes: int) -> Bytes:
    """Every pattern of one, two or three set bits over a frame, one a row."""
    bits = range(8 * length_bytes)
    patterns = [chosen for count in (1, 2, 3) for chosen in combinations(bits, count)]
    rows = np.zeros((len(patterns), length_bytes), dtype=np.uint8)
    for row, chosen in enumerate(patterns):
        for bit in chosen:
            rows[row, bit // 8] |= 1 << bit % 8
    return rows


FLIPS = {length: flips_of(length) for length in {message.length_bytes for message in MESSAGES}}


def test_the_patterns_are_all_there_are() -> None:
    for length, flips in FLIPS.items():
        bits = 8 * length
        assert len(flips) == comb(bits, 1) + comb(bits, 2) + comb(bits, 3)
        assert len(np.unique(flips, axis=0)) == len(flips)
        counts = np.unpackbits(flips, axis=1).sum(axis=1)
        assert sorted(set(counts.tolist())) == [1, 2, 3]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.name)
def test_the_check_for_many_is_the_one_that_the_receiver_makes(message: MessageSpec) -> None:
    rng = np.random.default_rng(message.frame_id)
    data_ids = np.array(message.data_ids, dtype=np.uint8)
    frames = rng.integers(0, 256, (2000, message.length_bytes), dtype=np.uint8)
    for row in range(0, len(frames), 2):  # half of them right
        frames[row] = list(protect(message.name, frames[row].tobytes(), row // 2 % COUNTER_VALUES))
    expected = [check(message.name, frame.tobytes()) for frame in frames]
    assert accepted(frames, data_ids).tolist() == expected
    assert sum(expected) >= 1000


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.name)
def test_every_flip_of_up_to_three_bits_is_rejected_at_every_counter(message: MessageSpec) -> None:
    """Once for each value of the counter, with a payload of its own: the CRC is linear, so other payloads can do no
    different (`test_e2e`)."""
    rng = np.random.default_rng(message.frame_id)
    data_ids = np.array(message.data_ids, dtype=np.uint8)
    flips = FLIPS[message.length_bytes]
    tried = passed = 0
    for counter in range(COUNTER_VALUES):
        payload = rng.integers(0, 256, message.length_bytes, dtype=np.uint8).tobytes()
        good = np.frombuffer(protect(message.name, payload, counter), dtype=np.uint8)
        assert accepted(good[np.newaxis], data_ids).all()
        passed += int(accepted(flips ^ good, data_ids).sum())
        tried += len(flips)
    print(f"{message.name}: {tried} flips of 1, 2 or 3 bits tried, {passed} accepted")
    assert tried == 16 * sum(comb(8 * message.length_bytes, count) for count in (1, 2, 3))
    assert passed == 0


def test_a_flip_of_four_bits_can_pass() -> None:
    """The distance is 4 and no more, so the test above is sharp."""
    message = spec().by_name["SequencerSetpoints"]
    data_ids = np.array(message.data_ids, dtype=np.uint8)
    good = np.frombuffer(protect(message.name, bytes(8), 0), dtype=np.uint8)
    triples = FLIPS[8][comb(64, 1) + comb(64, 2) :]
    # a fourth bit of the CRC's own byte mends a triple whose remainder is a single bit
    found = sum(
        int(accepted(triples ^ good ^ np.eye(1, 8, dtype=np.uint8) * (1 << bit), data_ids).sum()) for bit in range(8)
    )
    assert found > 0
