"""Rows of the benchmark's answer."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Result:
    """One setting of one engine on one case, or why there is none (`reason`, with every number None)."""

    case: str
    engine: str
    setting: str
    value: float | None = None
    expected: float | None = None
    expected_from: str | None = None
    error_percent: float | None = None
    wall_s_per_sim_s: float | None = None
    """Of the solver loop alone; the median of `repeats`."""
    real_time_factor: float | None = None
    repeats: int = 0
    reason: str | None = None

    def row(self) -> dict[str, Any]:
        """As one row of the JSON answer."""
        return asdict(self)


@dataclass(frozen=True)
class Growth:
    """How the cost grows with one quantity: wall time per simulated second of one robot at one size."""

    of: str
    size: float
    wall_s_per_sim_s: float
    real_time_factor: float
    """Simulated over wall seconds, all robots together."""

    def row(self) -> dict[str, Any]:
        """As one row of the JSON answer."""
        return asdict(self)
