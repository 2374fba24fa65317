"""End-to-end protection after AUTOSAR E2E profile 2 (PRS E2E Protocol, chapter on profile 2).

Byte 0 of a frame carries CRC-8H2F (polynomial 0x2F, start 0xFF, final XOR 0xFF), the low nibble of byte 1 a
counter from 0 to 15. The CRC runs over the bytes after it and then over the DataID that the message's list
has for this counter value, which is why a frame under a wrong identifier, or one of another message, does not
pass. The lists stand in the DBC (attribute E2EDataIdList); how they were found, and why they matter, is in
`data_id_search`.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from functools import cache

from fastcrc import crc8

from firmware_protocol.codec import encode
from firmware_protocol.errors import FrameError
from firmware_protocol.frame import Frame
from firmware_protocol.spec import COUNTER_VALUES, MessageSpec, message_spec


class FrameStatus(StrEnum):
    """What a receiver made of a frame. The first three are accepted, the others refused."""

    OK = "ok"
    OK_SOME_LOST = "ok_some_lost"
    """The counter skipped, within the tolerance."""
    INITIAL = "initial"
    """The first of its message: nothing to compare the counter with."""
    REPEATED = "repeated"
    WRONG_SEQUENCE = "wrong_sequence"
    """The counter skipped more than is tolerated; the receiver takes up the count from here."""
    WRONG_CRC = "wrong_crc"
    MALFORMED = "malformed"
    """Wrong length, reserved bits set, or a value out of range under a right CRC."""
    NOT_LISTED = "not_listed"
    """No message that this node may receive: unknown identifier, or one that this node sends itself."""

    @property
    def accepted(self) -> bool:
        """Whether the frame may be acted on."""
        return self in _ACCEPTED


_ACCEPTED = frozenset({FrameStatus.OK, FrameStatus.OK_SOME_LOST, FrameStatus.INITIAL})


def protect(name: str, data: bytes, counter: int) -> bytes:
    """`data` of message `name` with counter (0 to 15) and CRC set; what stood in their places is overwritten.

    Raises FrameError for an unknown message, a wrong length or a counter out of range.
    """
    length_bytes, data_ids = _protection(name)
    if len(data) != length_bytes:
        raise FrameError(f"{name}: {len(data)} bytes instead of {length_bytes}")
    if not 0 <= counter < COUNTER_VALUES:
        raise FrameError(f"{name}: counter {counter} is out of range (allowed: 0 to 15)")
    body = bytes([(data[1] & 0xF0) | counter]) + data[2:]
    return bytes([crc8.autosar(body + data_ids[counter])]) + body


def check(name: str, data: bytes) -> bool:
    """Whether length and CRC of `data` are those of a frame of message `name`."""
    length_bytes, data_ids = _protection(name)
    return len(data) == length_bytes and crc8.autosar(data[1:] + data_ids[data[1] & 0x0F]) == data[0]


class Sender:
    """Encodes, counts and protects: one counter for each message, starting from 0."""

    def __init__(self) -> None:
        self.counters: dict[str, int] = {}

    def send(self, name: str, signals: Mapping[str, float]) -> Frame:
        """The next frame of `name`. Raises FrameError as `codec.encode` does; the counter then stays."""
        frame_id, data = encode(name, signals)
        counter = self.counters.get(name, 0)
        frame = Frame(frame_id, protect(name, data, counter))
        self.counters[name] = (counter + 1) % COUNTER_VALUES
        return frame


class Receiver:
    """Judges CRC and counter of one message.

    `max_delta`: the largest step of the counter that is accepted (1: no frame may be lost). Anything else
    leaves no trace but in the public counts.
    """

    def __init__(self, name: str, max_delta: int = 3) -> None:
        self.message: MessageSpec = message_spec(name)
        self.max_delta = max_delta
        self.last_counter: int | None = None
        self.lost_frames = 0
        self.counts: dict[FrameStatus, int] = dict.fromkeys(FrameStatus, 0)

    def check(self, data: bytes) -> FrameStatus:
        """Judges one frame, takes over its counter unless the CRC is wrong, and counts what came out."""
        status = self.judge(data)
        self.counts[status] += 1
        return status

    def judge(self, data: bytes) -> FrameStatus:
        """As `check`, for a caller that counts for itself."""
        if not check(self.message.name, data):
            return FrameStatus.WRONG_CRC
        counter = data[1] & 0x0F
        last, self.last_counter = self.last_counter, counter
        if last is None:
            return FrameStatus.INITIAL
        delta = (counter - last) % COUNTER_VALUES
        if delta == 0:
            return FrameStatus.REPEATED
        if delta > self.max_delta:
            return FrameStatus.WRONG_SEQUENCE
        self.lost_frames += delta - 1
        return FrameStatus.OK if delta == 1 else FrameStatus.OK_SOME_LOST


@cache
def _protection(name: str) -> tuple[int, tuple[bytes, ...]]:
    message = message_spec(name)
    return message.length_bytes, tuple(bytes([data_id]) for data_id in message.data_ids)
