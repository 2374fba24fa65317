"""How one message reaches a node: how many came, how many were lost, how long until the node had acted on it.

It judges by itself (end-to-end protection of the message alone), whatever the node's own rules make of the frames.
A bus's time stamps are taken for those of the machine's wall clock, which is what SocketCAN and the hub give; where
they are not, a frame counts as having come when it was read. Everything else is the monotonic clock.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from firmware_protocol.e2e import Receiver
from firmware_protocol.frame import Frame
from softbot.nodes.durations import Durations

_OLDEST_S = 1.0
"""A frame does not lie unread for longer in a loop of 10 ms; a stamp further back is another clock's."""


@dataclass(frozen=True)
class MessageTiming:
    """How a message came. Latency: from its arrival to the end of the cycle that acted on it."""

    message: str
    received: int
    lost: int
    refused: int
    longest_gap_s: float
    mean_latency_s: float
    p99_latency_s: float
    max_latency_s: float

    def __str__(self) -> str:
        return (
            f"{self.message}: {self.received} came, {self.lost} lost, {self.refused} refused, at most "
            f"{1e3 * self.longest_gap_s:.1f} ms apart; acted on after {1e3 * self.mean_latency_s:.1f} ms on average, "
            f"{1e3 * self.p99_latency_s:.1f} ms at 99 %, {1e3 * self.max_latency_s:.1f} ms at most"
        )


class MessageMeter:
    """In each cycle: `came` with all that was read, then `acted` once the node has done with it."""

    def __init__(
        self,
        message: str,
        *,
        monotonic: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
    ) -> None:
        self._receiver = Receiver(message, max_delta=15)
        self._frame_id = self._receiver.message.frame_id
        self._monotonic, self._wall_clock = monotonic, wall_clock
        self._arrived_s: float | None = None  # of the newest that the node has not acted on
        self._last_s: float | None = None
        self._received, self._refused = 0, 0
        self._longest_gap_s = 0.0
        self._latency = Durations()

    def came(self, frames: list[tuple[Frame, float]]) -> None:
        """Frames with the bus's time stamps [s]."""
        now_s, now_stamp_s = self._monotonic(), self._wall_clock()
        for frame, stamp_s in frames:
            if frame.frame_id != self._frame_id:
                continue
            if not self._receiver.check(frame.data).accepted:
                self._refused += 1
                continue
            age_s = now_stamp_s - stamp_s
            arrived_s = now_s - age_s if 0.0 <= age_s <= _OLDEST_S else now_s
            if self._last_s is not None:
                self._longest_gap_s = max(self._longest_gap_s, arrived_s - self._last_s)
            self._received += 1
            self._arrived_s = self._last_s = arrived_s

    def acted(self) -> None:
        """The node has acted on the newest of them."""
        if self._arrived_s is not None:
            self._latency.add(max(self._monotonic() - self._arrived_s, 0.0))
            self._arrived_s = None

    def timing(self) -> MessageTiming:
        """What was measured so far."""
        return MessageTiming(
            message=self._receiver.message.name,
            received=self._received,
            lost=self._receiver.lost_frames,
            refused=self._refused,
            longest_gap_s=self._longest_gap_s,
            mean_latency_s=self._latency.mean_s,
            p99_latency_s=self._latency.percentile_s(0.99),
            max_latency_s=self._latency.max_s,
        )
