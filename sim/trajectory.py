"""A twin's motion as the quantities that a person and the metrics read: unwrapped roll, C-plane, bend, θ.

Frames: facing along the tangent t with z up, left = z × t. Roll is the right-handed turning of the mid cross-section
about its own tangent, against the vertical: chamber 0 to the left is roll 0, up is +90°. Where nothing holds the robot
down, "against the plane of the C" is minus the turning of the curvature direction in the body frame.

Many samples at once (`follow_rows`) or one (`follow`) go through the same compiled loop, so they give the same numbers
to the last bit, however a run is cut into blocks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim import motion_rows
from sim.body import Motion
from softbot.kernel_compiler import kernel

FloatArray = NDArray[np.float64]
Angle = TypeVar("Angle", float, FloatArray)

_STRAIGHT_RAD = 1e-3  # a bend smaller than this has no plane

# places in the memory of a trajectory
_ROLL, _PLANE, _LAST_ROLL, _HAS_ROLL, _HAS_SIDE = range(5)
_LAST_SIDE = 5
_MEMORY_SIZE = 8

# the same slices as numbers, which compiled code takes for constants
_ROTATION, _CHORD = motion_rows.ROTATION.start, motion_rows.CHORD.start
_CURVATURE, _STRETCH = motion_rows.CURVATURE.start, motion_rows.STRETCH


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


class Postures(NamedTuple):
    """`Posture` of many instants: a column each, shape (samples,)."""

    roll_rad: FloatArray
    plane_rotation_rad: FloatArray
    bend_rad: FloatArray
    bend_direction_rad: FloatArray
    length_m: FloatArray
    c_bend_side: FloatArray

    def last(self) -> Posture:
        """The latest of them."""
        roll, plane, bend, direction, length, side = (float(column[-1]) for column in self)
        return Posture(roll, plane, bend, direction, length, int(side))


class Trajectory:
    """Follows a robot from sample to sample, so that angles can be unwrapped."""

    def __init__(self, length_m: float, *, grounded: bool) -> None:
        self._length_m, self._grounded = length_m, grounded
        self._memory = np.zeros(_MEMORY_SIZE)

    def follow(self, motion: Motion) -> Posture:
        """The posture at the next sample. Samples must be closer than half a turn of anything."""
        return self.follow_rows(motion_row(motion)[None]).last()

    def follow_rows(self, rows: FloatArray) -> Postures:
        """The postures at the next samples, rows as `sim.motion_rows` lays them out, shape (samples, ROW_SIZE)."""
        columns = np.empty((len(Postures._fields), len(rows)))
        _follow(rows, self._length_m, self._grounded, self._memory, columns)
        return Postures(*columns)


def motion_row(motion: Motion, t_s: float = math.nan) -> FloatArray:
    """One instant as a row of `sim.motion_rows`; NaN for what a `Motion` does not tell (energies, position)."""
    row = np.full(motion_rows.ROW_SIZE, np.nan)
    row[motion_rows.TIME] = t_s
    row[motion_rows.ROTATION] = motion.rotation.ravel()
    row[motion_rows.ANGULAR_VELOCITY] = motion.angular_velocity_rad_s
    row[motion_rows.VELOCITY] = motion.mid_velocity_m_s
    row[motion_rows.CENTRE_OF_MASS] = motion.centre_of_mass_m
    row[motion_rows.STRETCH] = motion.stretch
    row[motion_rows.CURVATURE] = motion.curvature_1_m
    row[motion_rows.CHORD] = motion.chord
    row[motion_rows.ANGULAR_MOMENTUM] = motion.angular_momentum_kg_m2_s
    return row


def wrapped(angle_rad: Angle) -> Angle:
    """The same angle in (−π, π] [rad], of a number or of each number of an array."""
    return math.pi - (math.pi - angle_rad) % (2.0 * math.pi)


_wrapped = njit(cache=True)(wrapped)


@kernel()
def _follow(rows: FloatArray, length_m: float, grounded: bool, memory: FloatArray, out: FloatArray) -> None:
    """`Postures` of `rows` into `out`, shape (6, samples); `memory` carries what unwrapping needs."""
    for n in range(rows.shape[0]):
        row = rows[n]
        # columns of the mid cross-section's rotation: e1 = (a0, a1, a2), e2 = (b0, b1, b2), t = (t0, t1, t2)
        a0, b0, t0 = row[_ROTATION], row[_ROTATION + 1], row[_ROTATION + 2]
        a1, b1, t1 = row[_ROTATION + 3], row[_ROTATION + 4], row[_ROTATION + 5]
        a2, b2, t2 = row[_ROTATION + 6], row[_ROTATION + 7], row[_ROTATION + 8]
        level = math.hypot(t0, t1)
        if level > 1e-9:
            l0, l1, l2 = -t1 / level, t0 / level, 0.0
        else:
            l0, l1, l2 = a0, a1, a2
        u0, u1, u2 = t1 * l2 - t2 * l1, t2 * l0 - t0 * l2, t0 * l1 - t1 * l0
        k1, k2 = row[_CURVATURE], row[_CURVATURE + 1]
        bend = math.hypot(k1, k2) * length_m
        direction = math.atan2(k2, k1)
        bent = bend > _STRAIGHT_RAD
        if grounded:
            angle = math.atan2(a0 * u0 + a1 * u1 + a2 * u2, a0 * l0 + a1 * l1 + a2 * l2)
        else:
            angle = -direction
        if grounded or bent:
            if memory[_HAS_ROLL] != 0.0:
                memory[_ROLL] += _wrapped(angle - memory[_LAST_ROLL])
            elif grounded:
                memory[_ROLL] = angle
            memory[_LAST_ROLL], memory[_HAS_ROLL] = angle, 1.0
        side = 0.0
        if bent:
            # world direction of the centre of curvature
            w0, w1, w2 = a0 * k1 + b0 * k2, a1 * k1 + b1 * k2, a2 * k1 + b2 * k2
            side = 1.0 if w0 * l0 + w1 * l1 + w2 * l2 >= 0.0 else -1.0
            c0, c1, c2 = row[_CHORD], row[_CHORD + 1], row[_CHORD + 2]
            along = w0 * c0 + w1 * c1 + w2 * c2
            w0, w1, w2 = w0 - along * c0, w1 - along * c1, w2 - along * c2
            p0, p1, p2 = memory[_LAST_SIDE], memory[_LAST_SIDE + 1], memory[_LAST_SIDE + 2]
            if memory[_HAS_SIDE] != 0.0:
                turn = c0 * (p1 * w2 - p2 * w1) + c1 * (p2 * w0 - p0 * w2) + c2 * (p0 * w1 - p1 * w0)
                memory[_PLANE] += math.atan2(turn, p0 * w0 + p1 * w1 + p2 * w2)
            memory[_LAST_SIDE], memory[_LAST_SIDE + 1], memory[_LAST_SIDE + 2] = w0, w1, w2
            memory[_HAS_SIDE] = 1.0
        out[0, n], out[1, n], out[2, n] = memory[_ROLL], memory[_PLANE], bend
        out[3, n], out[4, n], out[5, n] = direction, length_m * row[_STRETCH], side
