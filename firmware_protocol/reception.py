"""What one node lets in: the whitelist by identifier, direction and length, then protection, then ranges.

Each refusal of a listed message is remembered over the last frames of that message; more of them than the
tolerance means that the link is not trustworthy. A frame that is not listed is counted and otherwise ignored:
it may belong to somebody else on the bus, and must not be able to do more than cost time.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from firmware_protocol.codec import physical, unpack
from firmware_protocol.e2e import FrameStatus, Receiver
from firmware_protocol.errors import FrameError, LimitsError
from firmware_protocol.spec import MessageSpec, spec


@dataclass(frozen=True, slots=True)
class Received:
    """A judged frame. `name`: None when not listed. `raw`: its signals as carried when accepted, else empty.

    `beyond_tolerance`: this refusal is one more than the tolerance over the window of its message.
    """

    status: FrameStatus
    name: str | None = None
    raw: dict[str, int] = field(default_factory=dict)
    beyond_tolerance: bool = False

    @property
    def signals(self) -> dict[str, float]:
        """The signals [physical, DBC units]; empty unless accepted."""
        return physical(str(self.name), self.raw) if self.raw else {}


@dataclass(frozen=True, slots=True)
class ReceptionLimits:
    """What is tolerated of one message.

    `max_counter_delta`: the largest accepted counter step. Of its last `window_frames` frames at most
    `tolerated_errors` may be refused.
    """

    max_counter_delta: int = 3
    window_frames: int = 16
    tolerated_errors: int = 3

    def __post_init__(self) -> None:
        if not 1 <= self.max_counter_delta <= 14:
            raise LimitsError(f"max_counter_delta = {self.max_counter_delta} must be from 1 to 14")
        if not 0 <= self.tolerated_errors < self.window_frames:
            raise LimitsError(
                f"tolerated_errors = {self.tolerated_errors} must be from 0 to window_frames - 1 "
                f"= {self.window_frames - 1}"
            )


class MessageReception:
    """The state of one received message; public, for monitors."""

    def __init__(self, message: MessageSpec, limits: ReceptionLimits) -> None:
        self.message = message
        self.receiver = Receiver(message.name, limits.max_counter_delta)
        self.last_accepted_us: int | None = None
        self.window_bits = 0  # one bit a frame, newest lowest, 1 = refused

    @property
    def counts(self) -> dict[FrameStatus, int]:
        """Frames so far by their verdict."""
        return self.receiver.counts


class Reception:
    """Judges every frame that reaches `node` ("Sequencer" or "Board").

    Messages in `counter_exempt` are accepted whatever their counter, as long as the CRC is right.
    """

    def __init__(
        self,
        node: str,
        limits: ReceptionLimits | None = None,
        counter_exempt: frozenset[str] = frozenset(),
    ) -> None:
        self.limits = limits or ReceptionLimits()
        self.counter_exempt = counter_exempt
        self.not_listed = 0
        self.messages: dict[str, MessageReception] = {}
        self._by_id: dict[int, MessageReception] = {}
        self._window_mask = (1 << self.limits.window_frames) - 1
        for message in spec().messages:
            if node in message.receivers:
                self.messages[message.name] = MessageReception(message, self.limits)
                self._by_id[message.frame_id] = self.messages[message.name]

    def accept(self, frame_id: int, data: bytes, t_us: int) -> Received:
        """Judges one frame that came at `t_us`; never raises for what is in it."""
        entry = self._by_id.get(frame_id)
        if entry is None:
            self.not_listed += 1
            return Received(FrameStatus.NOT_LISTED)
        name = entry.message.name
        status, raw = self._judge(entry, data)
        entry.counts[status] += 1
        refused = not status.accepted
        entry.window_bits = (entry.window_bits << 1 | refused) & self._window_mask
        if refused:
            beyond = entry.window_bits.bit_count() > self.limits.tolerated_errors
            return Received(status, name, beyond_tolerance=beyond)
        entry.last_accepted_us = t_us
        return Received(status, name, raw)

    def _judge(self, entry: MessageReception, data: bytes) -> tuple[FrameStatus, dict[str, int]]:
        if len(data) != entry.message.length_bytes:
            return FrameStatus.MALFORMED, {}
        status = entry.receiver.judge(data)
        if entry.message.name in self.counter_exempt and status is not FrameStatus.WRONG_CRC:
            status = FrameStatus.OK
        if not status.accepted:
            return status, {}
        try:
            return status, unpack(entry.message.frame_id, data)[1]
        except FrameError:
            return FrameStatus.MALFORMED, {}

    def tighten(self, max_counter_delta: int, tolerated_errors: int) -> None:
        """Takes over these two limits from now on."""
        self.limits = ReceptionLimits(max_counter_delta, self.limits.window_frames, tolerated_errors)
        for entry in self.messages.values():
            entry.receiver.max_delta = max_counter_delta

    @property
    def protection_errors(self) -> int:
        """Frames of listed messages that were refused by CRC or counter so far."""
        return sum(entry.counts[status] for entry in self.messages.values() for status in _PROTECTION_ERRORS)

    @property
    def refused_frames(self) -> int:
        """Frames that were refused by identifier, direction, length, reserved bits or range so far."""
        return self.not_listed + sum(entry.counts[FrameStatus.MALFORMED] for entry in self.messages.values())

    @property
    def blemished(self) -> bool:
        """Whether any window holds a refusal."""
        return any(entry.window_bits for entry in self.messages.values())

    def age_us(self, name: str, t_us: int) -> int | None:
        """Time since the last accepted frame of this message; None if there was none."""
        last_us = self.messages[name].last_accepted_us
        return None if last_us is None else t_us - last_us

    def forgive(self) -> None:
        """Empties the windows of refusals (the counts stay)."""
        for entry in self.messages.values():
            entry.window_bits = 0

    def forget_times(self) -> None:
        """Forgets when frames came; for a clock that went backwards."""
        for entry in self.messages.values():
            entry.last_accepted_us = None


_PROTECTION_ERRORS = (FrameStatus.REPEATED, FrameStatus.WRONG_SEQUENCE, FrameStatus.WRONG_CRC)
