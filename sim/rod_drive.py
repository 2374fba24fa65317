"""Open-loop drives of the rod as numbers, and the rest curvature they ask for (compiled).

The rest curvature grows to its size by `start_s` and then turns once in `period_s`, or keeps a lead ahead of the inner
side of the C as it lies now; what dead chambers or muscles would have given is taken away; a first-order lag follows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim.resolution import STEPS_A_RAMP
from sim.rod_compile import inner
from sim.scene import Drive

FloatArray = NDArray[np.float64]

HOLD, TURN, LEAD = range(3)
DRIVE_SIZE = 16
_KIND, _CURVATURE, _PERIOD, _DIRECTION, _START, _RAMP, _LEAD, _LAG, _LOST, _SIDE, _GROWING = (
    0,
    1,
    2,
    3,
    4,
    5,
    6,
    7,
    8,
    12,
    13,
)
_STRAIGHT_1_M = 1e-6


def drive_array(
    drive: Drive,
    lost: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    *,
    curvature_1_m: float | None = None,
    muscle: bool = False,
    growing_step_s: float | None = None,
) -> FloatArray:
    """A scene's given curvature as numbers, shape (16,).

    lost: share that each of the four chambers or muscles has lost, 0 … 1. curvature_1_m: stands in for the drive's
    own (of a contraction, which needs the robot to say what curvature it is). muscle: an active muscle bends towards
    itself, an active chamber away from itself. growing_step_s: longest step [s] while the bend grows; default: as
    `STEPS_A_RAMP` has it for the coarsest accuracy.
    """
    size = drive.curvature_1_m if curvature_1_m is None else curvature_1_m
    assert size is not None
    numbers = np.zeros(DRIVE_SIZE)
    numbers[_KIND] = TURN if drive.lead_rad is None else LEAD
    numbers[_CURVATURE], numbers[_PERIOD], numbers[_DIRECTION] = size, drive.period_s, drive.direction
    numbers[_START], numbers[_RAMP], numbers[_LAG] = drive.start_s, drive.ramp_s, drive.lag_s
    numbers[_LEAD] = drive.lead_rad or 0.0
    numbers[_LOST : _LOST + 4] = lost
    numbers[_SIDE] = 1.0 if muscle else -1.0
    numbers[_GROWING] = growing_step_s or drive.ramp_s / min(STEPS_A_RAMP.values())
    return numbers


def hold() -> FloatArray:
    """A drive that leaves the rest strains as they are, shape (16,)."""
    return np.zeros(DRIVE_SIZE)


@inner
def quiet_until_s(drive: FloatArray) -> float:
    """Until when a drive leaves a straight tube straight [s]."""
    if drive[_KIND] == HOLD:
        return math.inf
    return drive[_START] - drive[_RAMP]


@inner
def growing_step_s(drive: FloatArray, t_s: float) -> float:
    """Longest step from t_s on that a growing bend is followed with [s]; without bound once it has its size."""
    if drive[_KIND] == HOLD or t_s >= drive[_START]:
        return math.inf
    return max(drive[_START] - drive[_RAMP] - t_s, drive[_GROWING])


@inner
def rest_curvature(
    drive: FloatArray, t_s: float, step_s: float, theta: float, bend_1: float, bend_2: float, lagged_1_m: FloatArray
) -> tuple[float, float]:
    """Rest curvature (k1, k2) [1/m] in the body frame for the step of step_s from t_s, as it is θ of the step on.

    bend_1, bend_2: mean curvature of the rod at the middle of the step [1/m]. lagged_1_m: what a lag has reached, shape
    (2,); moved on by a step.
    """
    at = t_s + theta * step_s
    size = drive[_CURVATURE] * min(max((at - drive[_START]) / drive[_RAMP] + 1.0, 0.0), 1.0)
    angle = 0.0
    if drive[_KIND] == TURN:
        angle = drive[_DIRECTION] * 2.0 * math.pi * max(at - drive[_START], 0.0) / drive[_PERIOD]
    elif at >= drive[_START] and bend_1 * bend_1 + bend_2 * bend_2 > _STRAIGHT_1_M**2:
        angle = math.atan2(bend_2, bend_1) + drive[_DIRECTION] * drive[_LEAD]
    k1, k2 = size * math.cos(angle), size * math.sin(angle)
    for i in range(4):
        lost = drive[_LOST + i]
        if lost > 0.0:  # chamber i lies at i·90° and bends to the other side, a muscle to its own
            x = drive[_SIDE] * (1.0 if i == 0 else (-1.0 if i == 2 else 0.0))
            y = drive[_SIDE] * (1.0 if i == 1 else (-1.0 if i == 3 else 0.0))
            part = lost * max(k1 * x + k2 * y, 0.0)
            k1 -= part * x
            k2 -= part * y
    if drive[_LAG] > 0.0:
        share = 1.0 - math.exp(-step_s / drive[_LAG])
        old1, old2 = lagged_1_m[0], lagged_1_m[1]
        lagged_1_m[0] += share * (k1 - old1)
        lagged_1_m[1] += share * (k2 - old2)
        k1, k2 = old1 + theta * (lagged_1_m[0] - old1), old2 + theta * (lagged_1_m[1] - old2)
    return k1, k2
