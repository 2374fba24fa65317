"""Residual strain: a share of the load that builds up while a chamber is pressurised and lingers after its release.

    y' = (1 − s) y + r,   dr/dt = (s y − r)/τ,   τ = τ_growth while s y > r, else τ_recovery

y is the pressure that the wall feels, r what has set. Under a lasting load y' = y; right after its release y' = r,
which recovers slowly: with a very long `recovery_time_s` it is a permanent set. A step is exact for a load that stands
as it is at the step's end; r becomes a weighted mean of what it was and of s y, so any step is stable. The inverse is
exact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import pydantic

from softbot.errors import InputError
from softbot.kernel_compiler import kernel
from softbot.memory.prony import TIME_BOUNDS_S

SHARE_BOUND = 0.9


@dataclass(frozen=True)
class Residual:
    """`share` s of a chamber's load that sets within `growth_time_s` and recovers within `recovery_time_s`.

    Raises InputError unless 0 ≤ s ≤ 0.9 and both times are 1e-4 … 1e7 s.
    """

    __pydantic_config__: ClassVar[pydantic.ConfigDict] = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)

    share: float
    growth_time_s: float
    recovery_time_s: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.share <= SHARE_BOUND:
            raise InputError(f"memory.residual.share = {self.share!r}: give 0 to {SHARE_BOUND:g}")
        low, high = TIME_BOUNDS_S
        for name in ("growth_time_s", "recovery_time_s"):
            if not low <= getattr(self, name) <= high:
                raise InputError(f"memory.residual.{name} = {getattr(self, name)!r}: give {low:g} to {high:g} s")


@kernel()
def residual_step(
    share: float, growth_s: float, recovery_s: float, residue_Pa: float, felt_Pa: float, dt_s: float
) -> float:
    """r at the end of a step of dt_s ≥ 0 from `residue_Pa`, the load standing at `felt_Pa`. y' is (1 − s) y + r."""
    target = share * felt_Pa
    decay = math.exp(-dt_s / (growth_s if target > residue_Pa else recovery_s))
    return target + decay * (residue_Pa - target)


@kernel()
def residual_inverse(
    share: float, growth_s: float, recovery_s: float, residue_Pa: float, wanted_Pa: float, dt_s: float
) -> float:
    """The y at the end of a step with which y' is `wanted_Pa`."""
    # y' rises with y and the two branches meet at s y = r, where y' = (1 − s) r/s + r.
    grows = share * (wanted_Pa - residue_Pa) > (1.0 - share) * residue_Pa
    decay = math.exp(-dt_s / (growth_s if grows else recovery_s))
    return (wanted_Pa - decay * residue_Pa) / (1.0 - share * decay)
