"""The protection is AUTOSAR profile 2 and finds what it promises to find."""

from __future__ import annotations

import itertools
import random

import pytest
from fastcrc import crc8

from firmware_protocol.data_id_search import (
    COUNTER_BITS,
    find_data_id_list,
    syndrome_of_bit,
    syndrome_of_data_id,
)
from firmware_protocol.e2e import FrameStatus, Receiver, Sender, check, protect
from firmware_protocol.errors import FrameError
from firmware_protocol.spec import MessageSpec, spec

MESSAGES = spec().messages
NAMES = [message.name for message in MESSAGES]


def crc_8h2f(data: bytes) -> int:
    """Bit by bit from the definition: polynomial 0x2F, start 0xFF, not reflected, final XOR 0xFF."""
    crc = 0xFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x2F) & 0xFF if crc & 0x80 else crc << 1
    return crc ^ 0xFF


@pytest.mark.parametrize(
    ("data", "crc"),
    [  # AUTOSAR CRC library, examples of CRC8H2F; last, the check value of the CRC catalogue
        ("00000000", 0x12),
        ("F20183", 0xC2),
        ("0FAA0055", 0xC6),
        ("00FF5511", 0x77),
        ("332255AABBCCDDEEFF", 0x11),
        ("926B55", 0x33),
        ("FFFFFFFF", 0x6C),
        (b"123456789".hex(), 0xDF),
    ],
)
def test_the_crc_is_crc_8h2f(data: str, crc: int) -> None:
    assert crc8.autosar(bytes.fromhex(data)) == crc == crc_8h2f(bytes.fromhex(data))


@pytest.mark.parametrize("message", MESSAGES, ids=NAMES)
def test_protect_sets_counter_and_crc_and_nothing_else(message: MessageSpec) -> None:
    payload = bytes(range(0xA0, 0xA0 + message.length_bytes))
    for counter in range(16):
        data = protect(message.name, payload, counter)
        assert data[1] == (payload[1] & 0xF0) | counter
        assert data[2:] == payload[2:]
        assert data[0] == crc_8h2f(data[1:] + bytes([message.data_ids[counter]]))
        assert check(message.name, data)


def test_protect_refuses_wrong_lengths_and_counters() -> None:
    with pytest.raises(FrameError, match="3 bytes instead of 2"):
        protect("EmergencyStop", bytes(3), 0)
    for counter in (-1, 16):
        with pytest.raises(FrameError, match="counter"):
            protect("EmergencyStop", bytes(2), counter)
    assert not check("EmergencyStop", bytes(3))
    assert not check("EmergencyStop", b"")


@pytest.mark.parametrize("message", MESSAGES, ids=NAMES)
def test_every_flip_of_one_or_two_bits_is_found(message: MessageSpec) -> None:
    length = message.length_bytes
    data = protect(message.name, random.Random(message.frame_id).randbytes(length), message.frame_id % 16)
    word = int.from_bytes(data, "little")
    flips = [1 << bit for bit in range(8 * length)]
    patterns = flips + [first | second for first, second in itertools.combinations(flips, 2)]
    assert not any(check(message.name, (word ^ each).to_bytes(length, "little")) for each in patterns)


@pytest.mark.parametrize("message", MESSAGES, ids=NAMES)
def test_no_flip_of_up_to_three_bits_cancels_whatever_the_payload(message: MessageSpec) -> None:
    """The CRC is linear: a flip passes exactly if its syndrome is 0, which depends on the payload through the
    counter alone. So this covers all flips of all frames."""
    length = message.length_bytes
    others = [syndrome_of_bit(length, bit) for bit in range(8 * length) if bit not in COUNTER_BITS]
    sums = [{0}, set(others), {first ^ second for first, second in itertools.combinations(others, 2)}]
    assert 0 not in sums[1]  # one flip outside the counter
    assert 0 not in sums[2]  # two
    assert not sums[1] & sums[2]  # three
    for counter, other_counter in itertools.permutations(range(16), 2):
        flipped = counter ^ other_counter
        syndrome = syndrome_of_data_id(length, message.data_ids[counter] ^ message.data_ids[other_counter])
        for bit in range(4):
            if flipped >> bit & 1:
                syndrome ^= syndrome_of_bit(length, 8 + bit)
        for more in range(4 - flipped.bit_count()):
            assert syndrome not in sums[more]


def test_a_frame_under_another_messages_identifier_is_found() -> None:
    for message, other in itertools.permutations(MESSAGES, 2):
        assert all(mine != theirs for mine, theirs in zip(message.data_ids, other.data_ids, strict=True))
        if message.length_bytes == other.length_bytes:
            for counter in range(16):
                data = protect(message.name, bytes(message.length_bytes), counter)
                assert not check(other.name, data)


def test_the_lists_of_the_dbc_are_those_the_search_finds() -> None:
    taken: list[tuple[int, ...]] = []
    for message in MESSAGES:
        assert find_data_id_list(message.length_bytes, taken) == message.data_ids
        taken.append(message.data_ids)


def test_the_search_says_when_there_is_no_list() -> None:
    everything = [[value] * 16 for value in range(256)]
    assert find_data_id_list(8, everything) is None
    all_at_counter_1 = [[0, value] + [0] * 14 for value in range(256)]
    assert find_data_id_list(8, all_at_counter_1) is None  # after trying every DataID at counter 0


def test_the_sender_counts_each_message_for_itself() -> None:
    sender = Sender()
    counters = [sender.send("EmergencyStop", {"Reason": 0}).data[1] & 0x0F for _ in range(18)]
    assert counters == [*range(16), 0, 1]
    with pytest.raises(FrameError):
        sender.send("EmergencyStop", {"Reason": 9})
    assert sender.send("EmergencyStop", {"Reason": 0}).data[1] & 0x0F == 2
    other = sender.send("BoardFault", {"Reason": 0, "Chamber": 15, "Detail": 0})
    assert other.data[1] & 0x0F == 0


def stop_frame(counter: int) -> bytes:
    return protect("EmergencyStop", bytes(2), counter)


def test_the_receiver_tells_ok_lost_repeated_jumped_and_corrupt_apart() -> None:
    receiver = Receiver("EmergencyStop", max_delta=3)
    assert receiver.check(stop_frame(14)) is FrameStatus.INITIAL
    assert receiver.check(stop_frame(15)) is FrameStatus.OK
    assert receiver.check(stop_frame(0)) is FrameStatus.OK
    assert receiver.check(stop_frame(0)) is FrameStatus.REPEATED
    assert receiver.check(stop_frame(3)) is FrameStatus.OK_SOME_LOST
    assert receiver.lost_frames == 2
    assert receiver.check(stop_frame(7)) is FrameStatus.WRONG_SEQUENCE
    assert receiver.check(stop_frame(8)) is FrameStatus.OK  # it takes up the count after a jump
    assert receiver.check(stop_frame(7)) is FrameStatus.WRONG_SEQUENCE  # backwards is a jump too
    corrupt = bytes([stop_frame(8)[0] ^ 1]) + stop_frame(8)[1:]
    assert receiver.check(corrupt) is FrameStatus.WRONG_CRC
    assert receiver.last_counter == 7  # a corrupt frame says nothing about the count
    assert receiver.counts[FrameStatus.OK] == 3
    assert receiver.counts[FrameStatus.WRONG_SEQUENCE] == 2


def test_max_delta_of_one_tolerates_no_loss() -> None:
    receiver = Receiver("EmergencyStop", max_delta=1)
    receiver.check(stop_frame(0))
    assert receiver.check(stop_frame(2)) is FrameStatus.WRONG_SEQUENCE


def test_a_status_is_called_what_it_is() -> None:
    assert all(status == name.lower() for name, status in FrameStatus.__members__.items())


def test_a_receiver_tolerates_two_lost_frames_unless_told() -> None:
    for last, status in ((3, FrameStatus.OK_SOME_LOST), (4, FrameStatus.WRONG_SEQUENCE)):
        receiver = Receiver("EmergencyStop")
        receiver.check(stop_frame(0))
        assert receiver.check(stop_frame(last)) is status


def test_only_three_statuses_are_accepted() -> None:
    assert {status for status in FrameStatus if status.accepted} == {"ok", "ok_some_lost", "initial"}


def test_a_receiver_needs_a_listed_message() -> None:
    with pytest.raises(FrameError, match="no message"):
        Receiver("Nothing")
