"""The rod between two steps: pose and shape as cubics that meet position and rate at both ends.

A steady roll takes steps of a tenth of a second, at which a picture of it jerks. In between, each coordinate of the rod
follows the cubic (Hermite) that its values and rates at both ends ask for, in axes that go with the tangent of the
middle but do not roll: there the bends of a steady roll stay where they are and roll itself is linear in time, so that
both are met to rounding. Pose, shape and their rates are continuous from step to step.

Left out: what a step was divided into. Where the rates do not fit the way that was gone (a blow in the middle of the
step), the way is gone evenly.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.motion_rows import TIME

FloatArray = NDArray[np.float64]
Vector = tuple[float, float, float]

_FITS = 1.0  # of the radius, and rad: more may a step not be off its rates


class Instant(NamedTuple):
    """A rod at one time: what its pose, shape and motion follow from (as in `rod_memory.State`), and its row."""

    position_m: FloatArray
    rotation: FloatArray
    strain: FloatArray
    velocity: FloatArray
    momentum: FloatArray
    flag: FloatArray
    row: FloatArray


def instants_between(start: Instant, end: Instant, count: int, modes: int, radius_m: float) -> Iterator[Instant]:
    """The `count` − 1 instants that part the time from `start` to `end` into `count` equal spans.

    Energy and work (in `row`) are laid straight between the ends: the work of a drive is known once a step.
    """
    span_s = float(end.row[TIME] - start.row[TIME])
    share = np.arange(1, count) / count
    way, rates = end.position_m - start.position_m, (span_s * start.velocity[:3], span_s * end.velocity[:3])
    if np.abs(0.5 * (rates[0] + rates[1]) - way).max() > _FITS * radius_m:
        rates = (way, way)
    position, velocity = _cubic(start.position_m, end.position_m, *rates, share)
    first, last = _tangent(start), _tangent(end)
    spun = [_cross(_spin(one), tangent) for one, tangent in ((start, first), (end, last))]
    tangent, _ = _cubic(np.array(first), np.array(last), span_s * np.array(spun[0]), span_s * np.array(spun[1]), share)
    tangent /= np.sqrt(np.einsum("ij,ij->i", tangent, tangent))[:, None]
    rolled, roll_rates = _roll(start, end, span_s)
    if max(abs(rate - rolled) for rate in roll_rates) > _FITS:
        roll_rates = (rolled, rolled)
    zero, unit = np.zeros(1), np.ones(1)
    roll, rolling = _cubic(zero, rolled * unit, roll_rates[0] * unit, roll_rates[1] * unit, share)
    rotation = _carried(first, tangent) @ start.rotation @ _turned(roll[:, 0])
    spin = start.velocity[3:6] + share[:, None] * (end.velocity[3:6] - start.velocity[3:6])
    strain, gained = _cubic(start.strain, end.strain, span_s * start.velocity[6:], span_s * end.velocity[6:], share)
    _bends_in_space(start, end, span_s, modes, rolled, roll_rates, roll, rolling, share, strain, gained)
    rate = np.hstack([velocity / span_s, spin, gained / span_s])
    momentum = start.momentum + share[:, None] * (end.momentum - start.momentum)
    row = start.row + share[:, None] * (end.row - start.row)
    for j in range(count - 1):
        yield Instant(position[j], rotation[j], strain[j], rate[j], momentum[j], end.flag, row[j])


def _cubic(
    start: NDArray, end: NDArray, rate_0: NDArray, rate_1: NDArray, share: FloatArray
) -> tuple[NDArray, NDArray]:
    """Values and rates at shares of a span, shape (n, k) each; rates per span."""
    s = share[:, None]
    t, way = 1.0 - s, end - start
    value = start + s * s * (3.0 - 2.0 * s) * way + s * t * (t * rate_0 - s * rate_1)
    rate = 6.0 * s * t * way + t * (1.0 - 3.0 * s) * rate_0 - s * (2.0 - 3.0 * s) * rate_1
    return value, rate


def _tangent(one: Instant) -> Vector:
    return float(one.rotation[0, 2]), float(one.rotation[1, 2]), float(one.rotation[2, 2])


def _spin(one: Instant) -> Vector:
    return float(one.velocity[3]), float(one.velocity[4]), float(one.velocity[5])


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _roll(start: Instant, end: Instant, span_s: float) -> tuple[float, tuple[float, float]]:
    """Roll from start to end against axes that are carried along with the tangent [rad], its rates per span.

    Of the angles a whole turn apart it is the one that the rates ask for.
    """
    first, last = _tangent(start), _tangent(end)
    # axes carried the shortest way from `first` roll a little where the tangent goes round it
    round_it = _dot(_cross(last, _cross(_spin(end), last)), first) / (1.0 + _dot(first, last))
    rates = (span_s * _dot(_spin(start), first), span_s * (_dot(_spin(end), last) + round_it))
    left = (_carried(first, np.array([last]))[0] @ start.rotation).T @ end.rotation
    angle = math.atan2(left[1, 0] - left[0, 1], left[0, 0] + left[1, 1])
    turns = round((0.5 * (rates[0] + rates[1]) - angle) / (2.0 * math.pi))
    return angle + 2.0 * math.pi * turns, rates


def _bends_in_space(
    start: Instant, end: Instant, span_s: float, modes: int, rolled: float, roll_rates: tuple[float, float],
    roll: FloatArray, rolling: FloatArray, share: FloatArray, strain: FloatArray, gained: FloatArray,
) -> None:  # fmt: skip
    """Bends and what they gain in a span, at the shares: cubics in axes that do not roll, seen from those that do."""
    ends = []
    for one, angle, roll_rate in ((start, 0.0, roll_rates[0]), (end, rolled, roll_rates[1])):
        bend = one.strain[0 : 3 * modes : 3] + 1j * one.strain[1 : 3 * modes : 3]
        moving = one.velocity[6 : 6 + 3 * modes : 3] + 1j * one.velocity[7 : 6 + 3 * modes : 3]
        out = cmath.exp(1j * angle)
        ends.append((out * bend, out * (span_s * moving + 1j * roll_rate * bend)))
    (bend_0, rate_0), (bend_1, rate_1) = ends
    bend, rate = _cubic(bend_0, bend_1, rate_0, rate_1, share)
    back = np.exp(-1j * roll)
    bend, rate = bend * back, (rate - 1j * rolling * bend) * back
    strain[:, 0 : 3 * modes : 3], strain[:, 1 : 3 * modes : 3] = bend.real, bend.imag
    gained[:, 0 : 3 * modes : 3], gained[:, 1 : 3 * modes : 3] = rate.real, rate.imag


def _carried(first: Vector, tangent: FloatArray) -> FloatArray:
    """Rotations that take one direction to others the shortest way, shape (n, 3, 3)."""
    x, y, z = _cross(first, tuple(tangent.T))
    zero = np.zeros_like(x)
    across = np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), -1, 0)
    less = (1.0 + tangent @ np.array(first))[:, None, None]
    rotation: FloatArray = np.eye(3) + across + across @ across / less
    return rotation


def _turned(angle_rad: FloatArray) -> FloatArray:
    """Turns about the tangent, in the section's axes, shape (n, 3, 3)."""
    cosine, sine, zero = np.cos(angle_rad), np.sin(angle_rad), np.zeros_like(angle_rad)
    matrix = [[cosine, -sine, zero], [sine, cosine, zero], [zero, zero, zero + 1.0]]
    return np.moveaxis(np.array(matrix), -1, 0)
