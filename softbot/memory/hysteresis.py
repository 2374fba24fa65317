"""Rate-independent hysteresis: a Prandtl–Ishlinskii operator of generalised plays, with its exact inverse.

    y = q v + Σ w_j P_j,   P_j ← max(l_j(v), min(u_j(v), P_j)),   q = 1 − Σ w_j
    loading    l_j(v) = v − r_j
    unloading  u_j(v) = v + (σ − 1) max(v, 0) + β r_j

v is the pressure [Pa], y the pressure that would have the same effect without hysteresis, P_j = 0 before the first
loading. Thresholds r_j, weights w_j; σ ≥ 1 and 0 ≤ β ≤ 1 make unloading unlike loading: σ = β = 1 is the classical,
symmetric operator, whose loop stays open at zero pressure; with β = 0 and σ > 1 the loop closes at zero, as that of a
chamber that is vented to the atmosphere does, and is the wider the higher the pressure has been. The slope beyond the
thresholds is 1 in loading: the wall's law is that of loading, less Σ w_j r_j.

With its plays where they stand, y rises strictly with v and is piecewise linear: the inverse is found by going through
the places where a play begins to move, and is exact (no iteration, no tolerance). Any sampling of a run that keeps its
turning points gives the same result, and a closed minor loop leaves no trace (return-point memory).

Sources: P. Krejčí and K. Kuhnen (2001) for the classical operator and its inverse; M. Al Janaideh, S. Rakheja and C.-Y.
Su (2009) for plays whose sides differ. The inverse through the state of the plays is this program's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pydantic
from numpy.typing import NDArray

from softbot.errors import InputError
from softbot.kernel_compiler import kernel, part

FloatArray = NDArray[np.float64]

MOST_PLAYS = 16
WEIGHT_BOUND = 0.95
UNLOADING_SLOPE_BOUNDS = (1.0, 10.0)


@dataclass(frozen=True)
class Hysteresis:
    """Plays of thresholds r_j [Pa] and weights w_j; `unloading_slope` σ and `unloading_share` β.

    Raises InputError unless there are as many weights as thresholds (1 … 16), thresholds are above zero and rise,
    weights are not negative and add up to at most 0.95, σ is 1 … 10 and β 0 … 1.
    """

    __pydantic_config__: ClassVar[pydantic.ConfigDict] = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)

    thresholds_Pa: tuple[float, ...]
    weights: tuple[float, ...]
    unloading_slope: float = 1.0
    unloading_share: float = 1.0

    def __post_init__(self) -> None:
        if not 1 <= len(self.thresholds_Pa) == len(self.weights) <= MOST_PLAYS:
            raise InputError(
                f"memory.hysteresis: thresholds_Pa and weights have {len(self.thresholds_Pa)} and {len(self.weights)} "
                f"numbers: give 1 to {MOST_PLAYS} of each, one of each a play"
            )
        rising = all(a < b for a, b in zip((0.0, *self.thresholds_Pa), self.thresholds_Pa, strict=False))
        if not (rising and self.thresholds_Pa[-1] <= 1e9):
            raise InputError(
                f"memory.hysteresis.thresholds_Pa = {list(self.thresholds_Pa)}: give rising numbers above 0, up to "
                "1e9 Pa"
            )
        if not (all(0.0 <= weight <= WEIGHT_BOUND for weight in self.weights) and sum(self.weights) <= WEIGHT_BOUND):
            raise InputError(
                f"memory.hysteresis.weights = {list(self.weights)}: each from 0, together at most {WEIGHT_BOUND}"
            )
        low, high = UNLOADING_SLOPE_BOUNDS
        if not low <= self.unloading_slope <= high:
            raise InputError(f"memory.hysteresis.unloading_slope = {self.unloading_slope!r}: give {low:g} to {high:g}")
        if not 0.0 <= self.unloading_share <= 1.0:
            raise InputError(f"memory.hysteresis.unloading_share = {self.unloading_share!r}: give 0 to 1")


@part()
def _upper(v: float, offset: float, slope: float) -> float:
    return (slope * v if v > 0.0 else v) + offset


@part()
def _value(threshold: FloatArray, weight: FloatArray, slope: float, share: float, play: FloatArray, v: float) -> float:
    """y at v with the plays where they stand; they are not moved."""
    loose, felt = 1.0, 0.0
    for j in range(threshold.size):
        at = max(v - threshold[j], min(_upper(v, share * threshold[j], slope), play[j]))
        felt += weight[j] * at
        loose -= weight[j]
    return felt + loose * v


@kernel()
def hysteresis_step(
    threshold: FloatArray, weight: FloatArray, slope: float, share: float, play: FloatArray, pressure_Pa: float
) -> float:
    """y at `pressure_Pa`, to which the pressure ran without turning; moves the plays P_j, shape (plays,), in place."""
    loose, felt = 1.0, 0.0
    for j in range(threshold.size):
        upper = _upper(pressure_Pa, share * threshold[j], slope)
        play[j] = max(pressure_Pa - threshold[j], min(upper, play[j]))
        felt += weight[j] * play[j]
        loose -= weight[j]
    return felt + loose * pressure_Pa


@kernel()
def hysteresis_inverse(
    threshold: FloatArray, weight: FloatArray, slope: float, share: float, play: FloatArray, felt_Pa: float
) -> float:
    """The pressure at which `hysteresis_step` gives `felt_Pa`; `play` is left as it is."""
    low, high = -np.inf, np.inf  # the nearest breakpoints below and above the solution, and y there
    low_value, high_value = 0.0, 0.0
    for n in range(2 * threshold.size + 1):
        if n == 2 * threshold.size:
            at = 0.0
        elif n % 2 == 0:
            at = play[n // 2] + threshold[n // 2]
        else:
            at = play[n // 2] - share * threshold[n // 2]
            if at > 0.0:
                at /= slope
        if low < at < high:
            value = _value(threshold, weight, slope, share, play, at)
            if value <= felt_Pa:
                low, low_value = at, value
            else:
                high, high_value = at, value
    if low == -np.inf:  # all plays move, one of the breakpoints being zero: the slope is 1
        return high - (high_value - felt_Pa)
    if high == np.inf:
        return low + (felt_Pa - low_value)
    return low + (high - low) * ((felt_Pa - low_value) / (high_value - low_value))
