"""Durations counted as they come: mean, percentile and worst, in memory that does not grow."""

from __future__ import annotations

_BIN_S = 1e-4
_BINS = 500


class Durations:
    """Durations of zero or more [s]. Percentiles are to 0.1 ms, and at least 50 ms where they lie beyond that."""

    def __init__(self) -> None:
        self.count = 0
        self.total_s = 0.0
        self.max_s = 0.0
        self._histogram = [0] * (_BINS + 1)

    def add(self, duration_s: float) -> None:
        """Count one."""
        self.count += 1
        self.total_s += duration_s
        self.max_s = max(self.max_s, duration_s)
        self._histogram[min(int(duration_s / _BIN_S), _BINS)] += 1

    @property
    def mean_s(self) -> float:
        """The mean; 0 of none."""
        return self.total_s / max(self.count, 1)

    def percentile_s(self, share: float) -> float:
        """What a `share` (0 … 1) of them do not exceed."""
        wanted, seen = share * self.count, 0
        for number, count in enumerate(self._histogram[:_BINS]):
            seen += count
            if seen >= wanted:
                return min((number + 1) * _BIN_S, self.max_s)
        return min(_BINS * _BIN_S, self.max_s)
