"""Commutation: which way the curvature is commanded, from the roll and the side on which the C lies.

Angles in the cross-section are counted right-handedly about the tangent: in the world from the left (π/2 is up), in the
body from chamber 0; world angle = body angle + roll. The C lies flat, opening to the left (angle 0, side +1) or to the
right (angle π, side −1). Commanding the curvature a lead δ ahead of that side makes the body roll by −δ to follow, so
a positive lead rolls with negative revolutions, to the left: design part 3, note 0003.

What each chamber can still do is its `strength`, shape (4,), 0 … 1; what that leaves: `controllers.recovery`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softbot.cross_section import CHAMBERS
from softbot.kernel_compiler import kernel

FloatArray = NDArray[np.float64]

TURN_RAD = 2.0 * math.pi


def without(dead: Sequence[int]) -> FloatArray:
    """Strength of the chambers when some are dead, shape (4,)."""
    strength = np.ones(CHAMBERS)
    strength[list(dead)] = 0.0
    return strength


@kernel()
def wrapped(angle_rad: float) -> float:
    """The same angle from −π to π [rad]."""
    return angle_rad - TURN_RAD * np.round(angle_rad / TURN_RAD)


@kernel()
def side_angle_rad(side: int) -> float:
    """World angle of the inner side of a C that opens to the left (+1) or to the right (−1) [rad]."""
    return 0.0 if side > 0 else math.pi


@kernel()
def commanded_direction_rad(side: int, lead_rad: float, roll_rad: float) -> float:
    """Body angle of the curvature to command, the lead ahead of where the C lies [rad]."""
    return wrapped(side_angle_rad(side) + lead_rad - roll_rad)
