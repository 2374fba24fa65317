"""Commutation: which way the curvature is commanded, from the roll and the side on which the C lies.

Angles in the cross-section are counted right-handedly about the tangent: in the world from the left (π/2 is up), in the
body from chamber 0; world angle = body angle + roll. The C lies flat, opening to the left (angle 0, side +1) or to the
right (angle π, side −1). Commanding the curvature a lead δ ahead of that side makes the body roll by −δ to follow, so
a positive lead rolls with negative revolutions, to the left: design part 3, note 0003.

A dead chamber i cannot bend the robot towards its own opposite side: only body directions within π/2 of α_i are left.
`strength`, shape (4,), says what each chamber can still do, 0 … 1: here only whether that is nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from softbot.cross_section import CHAMBERS

FloatArray = NDArray[np.float64]

TURN_RAD = 2.0 * math.pi
_QUARTER_RAD = 0.5 * math.pi


def without(dead: Sequence[int]) -> FloatArray:
    """Strength of the chambers when some are dead, shape (4,)."""
    strength = np.ones(CHAMBERS)
    strength[list(dead)] = 0.0
    return strength


@njit(cache=True)
def wrapped(angle_rad: float) -> float:
    """The same angle from −π to π [rad]."""
    return angle_rad - TURN_RAD * np.round(angle_rad / TURN_RAD)


@njit(cache=True)
def side_angle_rad(side: int) -> float:
    """World angle of the inner side of a C that opens to the left (+1) or to the right (−1) [rad]."""
    return 0.0 if side > 0 else math.pi


@njit(cache=True)
def commanded_direction_rad(side: int, lead_rad: float, roll_rad: float) -> float:
    """Body angle of the curvature to command, the lead ahead of where the C lies [rad]."""
    return wrapped(side_angle_rad(side) + lead_rad - roll_rad)


@njit(cache=True)
def shortfall_rad(direction_rad: float, strength: FloatArray) -> float:
    """How far a body direction lies outside what the living chambers can give, signed: subtract it to get inside.

    Zero inside. With several dead chambers, of the worst of them.
    """
    worst = 0.0
    for chamber in range(CHAMBERS):
        if strength[chamber] <= 0.0:
            off = wrapped(direction_rad - chamber * _QUARTER_RAD)
            excess = abs(off) - _QUARTER_RAD
            if excess > abs(worst):
                worst = math.copysign(excess, off)
    return worst


@njit(cache=True)
def room_rad(side: int, roll_rad: float, forward: int, strength: FloatArray) -> float:
    """How far the body can still roll on this side before a dead chamber stops it [rad]; infinite with none.

    `forward` +1 is a positive lead (left), −1 a negative one. Negative when it is past the stop already; over π when it
    lies before the beginning of what the living chambers can give, and a lead brings it there.
    """
    room = math.inf
    for chamber in range(CHAMBERS):
        if strength[chamber] <= 0.0:
            here = wrapped(side_angle_rad(side) - roll_rad - chamber * _QUARTER_RAD)
            room = min(room, _QUARTER_RAD - forward * here)
    return room


def can_roll(dead: Sequence[int]) -> bool:
    """Whether curvature reversal can roll on with these chambers dead: with none or one.

    With two opposite ones the reachable directions are a line, with two adjacent ones a quarter plane without its
    opposite: neither allows a quasi-static reversal with lead (design part 3).
    """
    return len(set(dead)) <= 1
