"""Momentum of the rod: taken from its rates, changed from outside, turned into the motion of a base that keeps it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.rod_algebra import add_scaled, dot, factorise, gram, solve_backward, solve_forward
from sim.rod_compile import inner
from sim.rod_views import flat_rows

FloatArray = NDArray[np.float64]


@inner
def take_momentum(
    base: int, rows: FloatArray, rate: FloatArray, column: FloatArray, arm: FloatArray, momentum: FloatArray
) -> None:
    """The momentum about the centre of mass of a rod that moves as `rate` says, shape (6,)."""
    for k in range(6):
        momentum[k] = 0.0
    for d in range(base):
        momentum[int(column[d])] = dot(rows[d], rate)
    momentum[3] -= arm[1] * momentum[2] - arm[2] * momentum[1]
    momentum[4] -= arm[2] * momentum[0] - arm[0] * momentum[2]
    momentum[5] -= arm[0] * momentum[1] - arm[1] * momentum[0]


@inner
def base_momentum(base: int, momentum: FloatArray, column: FloatArray, arm: FloatArray, out: FloatArray) -> None:
    """Linear momentum, and angular about the middle of the tube, from that about its centre of mass."""
    for d in range(base):
        f = int(column[d])
        value = momentum[f]
        if f >= 3:
            k1, k2 = (f + 1) % 3, (f + 2) % 3
            value += arm[k1] * momentum[k2] - arm[k2] * momentum[k1]
        out[d] = value


@inner
def base_that_keeps_momentum(
    base: int, momentum: FloatArray, column: FloatArray, arm: FloatArray, theta: FloatArray, velocity: FloatArray,
    matrix: FloatArray, mean: FloatArray, vector: FloatArray, scratch: FloatArray,
) -> None:  # fmt: skip
    """mean of the base from the momentum at the middle of the step, with the factors of the equations."""
    base_momentum(base, momentum, column, arm, scratch)
    solve_forward(matrix, base, scratch)
    for a in range(base, column.shape[0]):
        speed = mean[int(column[a])]
        for b in range(base):
            scratch[b] -= matrix[a, b] * speed
    solve_backward(matrix, base, scratch)
    for d in range(base):
        f = int(column[d])
        mean[f] = scratch[d]
        vector[d] = scratch[d] + (1.0 - theta[f]) * vector[d] - velocity[f]  # an estimate for the end of the step


@inner
def outside_impulse(
    span_s: float, mass_kg: float, gravity_x: float, gravity_y: float, gravity_z: float, push_N: FloatArray,
    push_N_m: FloatArray, place_m: FloatArray, arm_m: FloatArray, momentum: FloatArray, result: FloatArray,
) -> None:  # fmt: skip
    """result ← momentum and what gravity and outside forces give in `span_s`."""
    for k in range(6):
        result[k] = momentum[k]
    result[0] += span_s * mass_kg * gravity_x
    result[1] += span_s * mass_kg * gravity_y
    result[2] += span_s * mass_kg * gravity_z
    for i in range(push_N.shape[0]):
        fx, fy, fz = push_N[i, 0], push_N[i, 1], push_N[i, 2]
        x, y, z = place_m[0, i] - arm_m[0], place_m[1, i] - arm_m[1], place_m[2, i] - arm_m[2]
        result[0] += span_s * fx
        result[1] += span_s * fy
        result[2] += span_s * fz
        result[3] += span_s * (y * fz - z * fy + push_N_m[i, 0])
        result[4] += span_s * (z * fx - x * fz + push_N_m[i, 1])
        result[5] += span_s * (x * fy - y * fx + push_N_m[i, 2])


@inner
def settle_base(
    base: int, momentum: FloatArray, column: FloatArray, arm: FloatArray, rows: FloatArray, matrix: FloatArray,
    change: FloatArray, rate: FloatArray,
) -> None:  # fmt: skip
    """Let the base move as the momentum asks: its `change`, and `rate` with it. matrix ← factors of its inertia."""
    base_momentum(base, momentum, column, arm, change)
    for a in range(base):
        change[a] -= dot(rows[a], rate)
    gram(flat_rows(rows), base, matrix, False)
    if not factorise(matrix, base):
        for a in range(base):
            change[a] = 0.0
    solve_forward(matrix, base, change)
    solve_backward(matrix, base, change)
    for a in range(base):
        add_scaled(rate, change[a], rows[a], rate)
