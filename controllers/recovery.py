"""Recovery: rolling on in the same direction with one dead chamber, by reversing the curvature.

The paper: converting the curvature of the C and changing the active side change the signs of sin φ0 and of sin θ
together, and the rolling direction stays. Half a turn is rolled on each side; where the dead chamber would be needed
(at θ = ±π/2) the curvature is reversed *through straight*: the exactly opposite direction is commanded, without lead,
until the measured pressures bend the robot to the other side. Flipping the side and keeping the lead at once would
swing the curvature round the short way and roll the body back as far as it had come (design part 3).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controllers.commutation import room_rad, shortfall_rad, wrapped

FloatArray = NDArray[np.float64]

NEAR_STOP_RAD = 0.12
"""Room left before the dead chamber stops the roll at which the reversal begins …"""
STALLED_RAD_S = 0.25
STALLED_WITHIN_RAD = 0.5
"""… or a roll slower than this, within this of the stop."""
FLIPPED_SHARE = 0.6
"""Part of the wanted curvature that must have grown on the other side."""
LONGEST_S = 2.0
"""A reversal that takes longer is given up for the side that the robot then has."""

REVERSAL = np.dtype(
    [("under_way", np.bool_), ("began_s", np.float64), ("direction_rad", np.float64), ("side", np.int64)],
    align=True,
)
"""A reversal, as a record: the body direction commanded, held until the C has flipped, and the side it will open to."""


@njit(cache=True)
def reversal_due(estimate: Any, side: int, forward: int, strength: FloatArray) -> bool:
    """Whether the roll has come to where a dead chamber is needed."""
    room = room_rad(side, estimate.roll_rad, forward, strength)
    slow = forward * -estimate.roll_rate_rad_s < STALLED_RAD_S
    return room < NEAR_STOP_RAD or (slow and room < STALLED_WITHIN_RAD)


@njit(cache=True)
def begin_reversal(own: Any, t_s: float, estimate: Any, side: int, strength: FloatArray) -> None:
    """Start a reversal: command the opposite of the curvature as it is, or the nearest that can be had."""
    opposite = math.atan2(estimate.curvature_1_m[1], estimate.curvature_1_m[0]) + math.pi
    opposite -= shortfall_rad(opposite, strength)
    own.under_way, own.began_s, own.direction_rad, own.side = True, t_s, wrapped(opposite), -side


@njit(cache=True)
def reversal_over(own: Any, t_s: float, estimate: Any, wanted_1_m: float) -> bool:
    """Whether the C has flipped (or too long has passed); the reversal then ends."""
    if not own.under_way:
        return True
    k1, k2 = estimate.curvature_1_m[0], estimate.curvature_1_m[1]
    along = k1 * math.cos(own.direction_rad) + k2 * math.sin(own.direction_rad)
    if along > FLIPPED_SHARE * wanted_1_m or t_s - own.began_s > LONGEST_S:
        own.under_way = False
        return True
    return False
