"""What can be told of a bus by listening alone: each message's rate, age, counter, content and protection errors.

Pure: frames with their time stamps in, numbers out. It judges every message of the DBC as its receiver would (CRC,
counter, range) and changes nothing; whoever shows it must not send.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise

from firmware_protocol.bus_load import worst_case_frame_bits
from firmware_protocol.codec import decode
from firmware_protocol.e2e import FrameStatus, Receiver
from firmware_protocol.errors import FrameError
from firmware_protocol.frame import Frame
from firmware_protocol.spec import MessageSpec, spec

RATE_OVER_S = 2.0
"""Rates and intervals are of so long a time."""
LATE_CYCLES = 3.0
"""A cyclic message is overdue after so many of its cycles."""


@dataclass
class MessageWatch:
    """One message of the DBC. `signals` are the last valid ones [DBC units]; errors are counted from the start."""

    message: MessageSpec
    receiver: Receiver
    frames: int = 0
    malformed: int = 0
    signals: dict[str, float] = field(default_factory=dict)
    last_s: float | None = None
    recent_s: deque[float] = field(default_factory=deque)

    @property
    def errors(self) -> int:
        """Frames that a receiver refuses."""
        counts = self.receiver.counts
        return self.malformed + sum(count for status, count in counts.items() if not status.accepted)

    @property
    def lost(self) -> int:
        """Frames missing between two that came, by the counter."""
        return self.receiver.lost_frames

    def age_s(self, now_s: float) -> float:
        """Since the last one; infinite before the first."""
        return math.inf if self.last_s is None else max(now_s - self.last_s, 0.0)

    def rate_Hz(self, now_s: float) -> float:
        """Over the last moments; 0 when none came in them."""
        recent = [stamp_s for stamp_s in self.recent_s if now_s - stamp_s <= RATE_OVER_S]
        if len(recent) < 2:
            return 0.0
        return (len(recent) - 1) / max(recent[-1] - recent[0], 1e-6)

    def jitter_s(self) -> float:
        """Largest departure of a recent interval from the cycle time; nan for an event message or none yet."""
        if self.message.cycle_s is None or len(self.recent_s) < 2:
            return math.nan
        return max(abs(after - before - self.message.cycle_s) for before, after in pairwise(self.recent_s))

    def overdue(self, now_s: float) -> bool:
        """Whether a cyclic message that has come before is missing now."""
        return (
            self.message.cycle_s is not None
            and self.last_s is not None
            and self.age_s(now_s) > LATE_CYCLES * self.message.cycle_s
        )


class BusWatch:
    """The whole bus: `messages` by name, `unknown` identifiers with how often each came, `frames` in all."""

    def __init__(self) -> None:
        self.messages = {
            message.name: MessageWatch(message, Receiver(message.name, max_delta=15)) for message in spec().messages
        }
        self.unknown: dict[int, int] = {}
        self.frames = 0
        self._bits: deque[tuple[float, int]] = deque()

    def see(self, frame: Frame, t_s: float) -> None:
        """A frame that was on the bus at `t_s`; times may not go back (one that does counts as the last)."""
        self.frames += 1
        self._bits.append((t_s, worst_case_frame_bits(len(frame.data))))
        while self._bits and t_s - self._bits[0][0] > RATE_OVER_S:
            self._bits.popleft()
        known = spec().by_id.get(frame.frame_id)
        if known is None:
            self.unknown[frame.frame_id] = self.unknown.get(frame.frame_id, 0) + 1
            return
        watch = self.messages[known.name]
        watch.frames += 1
        watch.last_s = t_s if watch.last_s is None else max(t_s, watch.last_s)
        watch.recent_s.append(watch.last_s)
        while watch.last_s - watch.recent_s[0] > RATE_OVER_S:
            watch.recent_s.popleft()
        if len(frame.data) != known.length_bytes:
            watch.malformed += 1
            return
        if watch.receiver.check(frame.data) is FrameStatus.WRONG_CRC:
            return
        try:
            watch.signals = decode(*frame)[1]
        except FrameError:
            watch.malformed += 1

    def load(self, now_s: float) -> float:
        """Share of the bus in use at worst-case stuffing, over the last moments."""
        bits = sum(count for stamp_s, count in self._bits if now_s - stamp_s <= RATE_OVER_S)
        return bits / (RATE_OVER_S * spec().bitrate_bit_s)

    def named(self, message: str, signal: str) -> str | None:
        """The last value of an enumeration by its name in the DBC; None before the first."""
        watch = self.messages[message]
        if signal not in watch.signals:
            return None
        choices = next(each.choices for each in watch.message.signals if each.name == signal)
        return choices.get(int(watch.signals[signal]), str(watch.signals[signal]))

    def report(self, now_s: float) -> dict[str, object]:
        """All of it as plain values, for `softbot monitor --json`."""
        return {
            "frames": self.frames,
            "bus_load": self.load(now_s),
            "board_mode": self.named("BoardHeartbeat", "BoardMode"),
            "safe_reason": self.named("BoardHeartbeat", "SafeReason"),
            "sequencer_state": self.named("SequencerHeartbeat", "State"),
            "health": self.named("SequencerHeartbeat", "Health"),
            "unknown": {f"0x{frame_id:03X}": count for frame_id, count in sorted(self.unknown.items())},
            "messages": {
                name: {
                    "id": f"0x{watch.message.frame_id:03X}",
                    "frames": watch.frames,
                    "rate_Hz": round(watch.rate_Hz(now_s), 2),
                    "age_s": None if watch.last_s is None else round(watch.age_s(now_s), 4),
                    "jitter_s": None if math.isnan(watch.jitter_s()) else round(watch.jitter_s(), 6),
                    "counter": watch.receiver.last_counter,
                    "lost": watch.lost,
                    "errors": watch.errors,
                    "overdue": watch.overdue(now_s),
                    "signals": {key: value for key, value in watch.signals.items() if key not in ("Crc", "Counter")},
                }
                for name, watch in self.messages.items()
            },
        }
