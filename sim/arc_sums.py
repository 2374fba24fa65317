"""What sums over Gauss points make of a circular arc: its friction balance on a slow roll, and its spin when it floats.

For both the integral is known too (`softbot.rolling`), so that their errors can be computed and need not be measured.
"""

from __future__ import annotations

from functools import cache, lru_cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_STICKS, _LEAVES = 1e-6, 0.05  # over ωR: a point that hardly slides; the first try to let it go
_LEAST_GAIN = 1e-15
_FINE_HALF, _FINE_SPIN_HALF = 64, 24
_BENDS = np.array([0.7, 0.8, 0.9, 1.0])
"""Of the largest bend: where the errors are looked at."""


@cache
def _half_rule(half: int) -> tuple[FloatArray, FloatArray]:
    nodes, weights = legendre.leggauss(half)
    return 0.5 * (nodes + 1.0), 0.5 * weights


@cache
def _integral(half: int) -> FloatArray:
    """From values at the Gauss points of (0, 1), along the last axis, to integrals from 0 to each of these points."""
    at = 2.0 * _half_rule(half)[0] - 1.0
    primitive = np.stack([legendre.legval(at, legendre.legint(row, lbnd=-1)) for row in np.eye(half)])
    return np.asarray(0.5 * np.linalg.solve(legendre.legvander(at, half - 1).T, primitive), dtype=np.float64)


def slow_speed_of_sum(half_bend_rad: FloatArray, half: int, downhill: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    """Speed (along, across the chord) over ωR at which friction balances, summed over `half` points of each half.

    One row for each half bend; Gauss points. The contact of a slow arc slides at (sinφ + u, v − cosφ); friction of even
    load balances the pull of a slope, `downhill` of what it can hold, where the sum of |sliding| + downhill·(u, v) is
    least. On a floor v is the advance ratio, and the sum the one that stands in for the integral of
    `softbot.rolling.coulomb_force_balance`.
    """
    nodes, weights = _half_rule(half)
    weights = np.concatenate([weights, weights]) / 2.0
    along, across = downhill
    speeds = []
    for bend in half_bend_rad:
        angle = bend * np.concatenate([nodes, -nodes])
        sine, cosine = np.sin(angle), np.cos(angle)
        speed = np.array([0.0, float(weights @ cosine)])
        value = _sliding(speed, sine, cosine, weights, along, across)
        for _ in range(60):
            x, y = sine + speed[0], speed[1] - cosine
            size = np.maximum(np.hypot(x, y), 1e-12)  # at rest on the ground: a kink of the sum
            gradient = np.array([weights @ (x / size) + along, weights @ (y / size) + across])
            nearest = int(np.argmin(size))
            if size[nearest] < _STICKS:  # there it is least where friction holds the point against all the others
                stuck, weight = np.array([x[nearest], y[nearest]]) / size[nearest], weights[nearest]
                others = gradient - weight * stuck
                pull = float(np.hypot(*others))
                if pull <= weight:
                    break
                move = -_LEAVES / pull * others
            else:
                cube = weights / size**3
                xx, yy, xy = cube @ (y * y), cube @ (x * x), -(cube @ (x * y))
                move = np.array([yy * gradient[0] - xy * gradient[1], xx * gradient[1] - xy * gradient[0]])
                move /= -(xx * yy - xy * xy)
            if not np.abs(move).max() > 1e-12:
                break
            for _ in range(30):
                tried = _sliding(speed + move, sine, cosine, weights, along, across)
                if tried < value:
                    break
                move *= 0.5
            if not tried < value - _LEAST_GAIN:
                break
            speed, value = speed + move, tried
        speeds.append(speed)
    return np.array(speeds)


def _sliding(
    speed: FloatArray, sine: FloatArray, cosine: FloatArray, weights: FloatArray, along: float, across: float
) -> float:
    sliding = np.hypot(sine + speed[0], speed[1] - cosine)
    return float(weights @ sliding + along * speed[0] + across * speed[1])


@lru_cache(maxsize=64)
def _friction_balance(bend_rad: float, downhill: tuple[float, float]) -> FloatArray:
    return slow_speed_of_sum(0.5 * bend_rad * _BENDS, _FINE_HALF, downhill)


def friction_sum_errors(bend_rad: float, downhill: tuple[float, float], half: int) -> FloatArray:
    """Relative errors of the speed at which friction balances, summed over `half` points, for bends up to this one."""
    exact = _friction_balance(bend_rad, downhill)
    off = np.hypot(*(slow_speed_of_sum(0.5 * bend_rad * _BENDS, half, downhill) - exact).T)
    return off / np.maximum(np.hypot(*exact.T), 0.03)  # an arc of half a circle and more hardly advances


def spin_sum_errors(bend_rad: float, half: int, slenderness: float) -> FloatArray:
    """Relative errors of the floating ratio summed over `half` points, for bends up to this one."""
    found = _floating_ratio_of_sum(0.5 * bend_rad * _BENDS, half, slenderness)
    return np.abs(found / _floating_ratio_of_sum(0.5 * bend_rad * _BENDS, _FINE_SPIN_HALF, slenderness) - 1.0)


def _floating_ratio_of_sum(half_bend_rad: FloatArray, half: int, slenderness: float) -> FloatArray:
    """Ω/α̇ of `softbot.rolling.floating_ratio`, lengths over L, from sums and integrals over `half` points."""
    nodes, weights = _half_rule(half)
    integral = _integral(half)
    bend = half_bend_rad[:, None]
    sine, cosine = np.sin(bend * nodes), np.cos(bend * nodes)
    depth = 0.5 * sine @ integral
    # what moves when the curvature direction turns: ω' = ẇ, v' = ω × t
    spin, swing = bend * sine @ integral, bend * cosine @ integral
    moved = 0.5 * (spin * sine + swing * cosine) @ integral
    depth, moved = depth - (depth @ weights)[:, None], moved - (moved @ weights)[:, None]
    rotary = 0.5 / slenderness**2
    inertia = (depth * depth) @ weights + rotary * ((cosine**2 + 0.5 * sine**2) @ weights)
    ratio: FloatArray = (rotary * (cosine @ weights) - (depth * (moved - depth)) @ weights) / inertia
    return ratio
