"""A twin's motion as the quantities that a person and the metrics read: unwrapped roll, C-plane, bend, θ.

Frames: facing along the tangent t with z up, left = z × t. Roll is the right-handed turning of the mid cross-section
about its own tangent, against the vertical: chamber 0 to the left is roll 0, up is +90°. Where nothing holds the robot
down, "against the plane of the C" is minus the turning of the curvature direction in the body frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.body import Motion

FloatArray = NDArray[np.float64]

_STRAIGHT_RAD = 1e-3  # a bend smaller than this has no plane


@dataclass(frozen=True)
class Posture:
    """One instant of the trajectory."""

    roll_rad: float
    plane_rotation_rad: float
    bend_rad: float
    bend_direction_rad: float
    length_m: float
    c_bend_side: int
    """+1: the C opens to the left, −1: to the right, 0: straight."""


class Trajectory:
    """Follows a robot from sample to sample, so that angles can be unwrapped."""

    def __init__(self, length_m: float, *, grounded: bool) -> None:
        self._length_m, self._grounded = length_m, grounded
        self._roll_rad, self._plane_rad = 0.0, 0.0
        self._last_roll: float | None = None
        self._last_side: FloatArray | None = None

    def follow(self, motion: Motion) -> Posture:
        """The posture at the next sample. Samples must be closer than half a turn of anything."""
        rotation, tangent = motion.rotation, motion.rotation[:, 2]
        level = math.hypot(tangent[0], tangent[1])
        left = np.array([-tangent[1], tangent[0], 0.0]) / level if level > 1e-9 else rotation[:, 0]
        up = np.array(
            [
                tangent[1] * left[2] - tangent[2] * left[1],
                tangent[2] * left[0] - tangent[0] * left[2],
                tangent[0] * left[1] - tangent[1] * left[0],
            ]
        )
        curvature = motion.curvature_1_m
        bend_rad = float(math.hypot(curvature[0], curvature[1])) * self._length_m
        direction = math.atan2(curvature[1], curvature[0])
        if self._grounded:
            roll = math.atan2(float(rotation[:, 0] @ up), float(rotation[:, 0] @ left))
            self._turn(roll)
        elif bend_rad > _STRAIGHT_RAD:
            self._turn(-direction)
        side = 0
        if bend_rad > _STRAIGHT_RAD:
            towards = rotation[:, :2] @ curvature  # world direction of the centre of curvature
            self._turn_plane(towards, motion.chord)
            side = 1 if float(towards @ left) >= 0.0 else -1
        return Posture(self._roll_rad, self._plane_rad, bend_rad, direction, self._length_m * motion.stretch, side)

    def _turn(self, angle: float) -> None:
        if self._last_roll is not None:
            self._roll_rad += wrapped(angle - self._last_roll)
        elif self._grounded:
            self._roll_rad = angle
        self._last_roll = angle

    def _turn_plane(self, towards: FloatArray, chord: FloatArray) -> None:
        side = towards - chord * float(chord @ towards)
        if self._last_side is not None:
            last = self._last_side
            turn = np.array(
                [
                    last[1] * side[2] - last[2] * side[1],
                    last[2] * side[0] - last[0] * side[2],
                    last[0] * side[1] - last[1] * side[0],
                ]
            )
            self._plane_rad += math.atan2(float(chord @ turn), float(last @ side))
        self._last_side = side


def wrapped(angle_rad: float) -> float:
    """The same angle in (−π, π] [rad]."""
    return math.pi - (math.pi - angle_rad) % (2.0 * math.pi)
