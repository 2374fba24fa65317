"""The offset of the board's clock, measured from the sequencer's end as NTP does (RFC 5905, section 8).

With t1 the request's sending, t2 its coming to the board, t3 = t2 + hold the response's going and t4 its coming:

    offset     = ((t2 - t1) + (t3 - t4)) / 2        board's clock minus this one
    round trip = (t4 - t1) - (t3 - t2)

The offset is off by at most half the round trip, so the measurement with the shortest one of the last few counts. The
bus carries times modulo 2^32 µs (71.6 minutes), and so the offset is known modulo that. Nobody's clock is set: stamps
are translated.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

CLOCK_CYCLE_US = 1 << 32
_SYNC_IDS = 16
_KEPT = 8
_HOLD_SATURATED_US = 0xFFFF


class ClockMeasurement(NamedTuple):
    """One exchange. `offset_us` from -2^31 to 2^31 - 1, `round_trip_us` without the board's hold."""

    offset_us: int
    round_trip_us: int


class ClockSync:
    """Makes the requests, takes the responses. `measurements`: the last few, newest last."""

    def __init__(self) -> None:
        self.measurements: deque[ClockMeasurement] = deque(maxlen=_KEPT)
        self._sync_id = 0
        self._sent_us: int | None = None

    def request(self, now_us: int) -> dict[str, float]:
        """The signals of the next TimeSyncRequest; an unanswered one is given up."""
        self._sync_id = (self._sync_id + 1) % _SYNC_IDS
        self._sent_us = now_us
        return {"SyncId": self._sync_id, "SendUs": now_us % CLOCK_CYCLE_US}

    def take(self, raw: Mapping[str, int], now_us: int) -> None:
        """Takes an accepted TimeSyncResponse (its raw signals) that came at `now_us`."""
        sent_us = self._sent_us
        if sent_us is None or raw["SyncId"] != self._sync_id or raw["HoldUs"] == _HOLD_SATURATED_US:
            return
        self._sent_us = None
        round_trip_us = now_us - sent_us - raw["HoldUs"]
        if round_trip_us < 0:
            return  # a clock jumped in between
        there_us = _signed(raw["ReceiveUs"] - sent_us)
        self.measurements.append(ClockMeasurement(_signed(there_us - round_trip_us // 2), round_trip_us))

    @property
    def best(self) -> ClockMeasurement | None:
        """The measurement with the shortest round trip of the last few; None before the first."""
        return min(self.measurements, key=lambda each: each.round_trip_us, default=None)

    def forget(self) -> None:
        """For a clock, here or there, that jumped."""
        self.measurements.clear()
        self._sent_us = None


def _signed(difference_us: int) -> int:
    """A difference of clocks modulo their cycle, as the one nearest to 0."""
    half = CLOCK_CYCLE_US // 2
    return (difference_us + half) % CLOCK_CYCLE_US - half
