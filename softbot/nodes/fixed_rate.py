"""A loop at a fixed rate on the machine's clock: absolute deadlines, and how well they were kept.

Deadlines are start + n × period, so that a late cycle does not shift the ones after it. A cycle that is late by a
period or more has missed the deadlines in between; they are left out, not made up for in a burst. The time of a cycle
is that of its deadline: rates are then free of the jitter of waking up, and a time-out of so many periods is that many.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from softbot.nodes.durations import Durations


@dataclass(frozen=True)
class LoopTiming:
    """How a loop kept its rate. Lateness is that of the wake-up after its deadline; load, the share of time at work."""

    period_s: float
    cycles: int
    missed_deadlines: int
    mean_lateness_s: float
    p99_lateness_s: float
    """99th percentile, to 0.1 ms (at least this where it is 50 ms)."""
    max_lateness_s: float
    load: float

    def __str__(self) -> str:
        return (
            f"{self.cycles} cycles of {1e3 * self.period_s:g} ms: {self.missed_deadlines} deadlines missed, late by "
            f"{1e3 * self.mean_lateness_s:.2f} ms on average, {1e3 * self.p99_lateness_s:.1f} ms at 99 %, "
            f"{1e3 * self.max_lateness_s:.1f} ms at most; {100.0 * self.load:.0f} % of the time at work"
        )


class FixedRate:
    """Call `wait` at the head of each cycle. `clock` [s] must never go back; `sleep` may return late."""

    def __init__(
        self,
        period_s: float,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._period_s, self._clock, self._sleep = period_s, clock, sleep
        self._start_s = clock()
        self._deadline = 0  # number of the next one
        self._woke_s: float | None = None
        self.missed_now = 0
        """Deadlines that the last `wait` left out."""
        self._missed, self._busy_s = 0, 0.0
        self._lateness = Durations()

    def wait(self) -> float:
        """Sleep until the next deadline; the time of the newest one that has passed, since the start [s]."""
        now_s = self._clock()
        if self._woke_s is not None:
            self._busy_s += now_s - self._woke_s
        deadline_s = self._start_s + self._deadline * self._period_s
        while now_s < deadline_s:
            self._sleep(deadline_s - now_s)
            now_s = self._clock()
        late_s = now_s - deadline_s
        behind = int(late_s / self._period_s)
        self.missed_now = behind
        self._missed += behind
        self._deadline += behind + 1
        self._lateness.add(late_s)
        self._woke_s = now_s
        return (self._deadline - 1) * self._period_s

    def timing(self) -> LoopTiming:
        """What was measured so far."""
        elapsed_s = self._deadline * self._period_s
        return LoopTiming(
            period_s=self._period_s,
            cycles=self._lateness.count,
            missed_deadlines=self._missed,
            mean_lateness_s=self._lateness.mean_s,
            p99_lateness_s=self._lateness.percentile_s(0.99),
            max_lateness_s=self._lateness.max_s,
            load=min(self._busy_s / elapsed_s, 1.0) if elapsed_s > 0.0 else 0.0,
        )
