"""Rotations of the rod's kernel: the middle turned by its spin, spins and bends carried along into axes that roll."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.rod_compile import inner

FloatArray = NDArray[np.float64]


@inner
def _turn_by(x: float, y: float, z: float, rotation: FloatArray) -> None:
    """rotation ← exp([(x, y, z)]×) rotation, kept orthonormal by one Newton step."""
    size_squared = x * x + y * y + z * z
    if size_squared < 1e-4:
        a = 1.0 - size_squared / 6.0 * (1.0 - size_squared / 20.0)
        b = 0.5 - size_squared / 24.0 * (1.0 - size_squared / 30.0)
    else:
        size = np.sqrt(size_squared)
        a = np.sin(size) / size
        b = (1.0 - np.cos(size)) / size_squared
    for c in range(3):
        px, py, pz = rotation[0, c], rotation[1, c], rotation[2, c]
        qx, qy, qz = y * pz - z * py, z * px - x * pz, x * py - y * px
        rotation[0, c] = px + a * qx + b * (y * qz - z * qy)
        rotation[1, c] = py + a * qy + b * (z * qx - x * qz)
        rotation[2, c] = pz + a * qz + b * (x * qy - y * qx)
    g00 = rotation[0, 0] ** 2 + rotation[1, 0] ** 2 + rotation[2, 0] ** 2
    g11 = rotation[0, 1] ** 2 + rotation[1, 1] ** 2 + rotation[2, 1] ** 2
    g22 = rotation[0, 2] ** 2 + rotation[1, 2] ** 2 + rotation[2, 2] ** 2
    g01 = rotation[0, 0] * rotation[0, 1] + rotation[1, 0] * rotation[1, 1] + rotation[2, 0] * rotation[2, 1]
    g02 = rotation[0, 0] * rotation[0, 2] + rotation[1, 0] * rotation[1, 2] + rotation[2, 0] * rotation[2, 2]
    g12 = rotation[0, 1] * rotation[0, 2] + rotation[1, 1] * rotation[1, 2] + rotation[2, 1] * rotation[2, 2]
    for k in range(3):
        px, py, pz = rotation[k, 0], rotation[k, 1], rotation[k, 2]
        rotation[k, 0] = 0.5 * ((3.0 - g00) * px - g01 * py - g02 * pz)
        rotation[k, 1] = 0.5 * ((3.0 - g11) * py - g01 * px - g12 * pz)
        rotation[k, 2] = 0.5 * ((3.0 - g22) * pz - g02 * px - g12 * py)


@inner
def advance_rotation(
    span_s: float, tangent: FloatArray, omega_x: float, omega_y: float, omega_z: float, rotation: FloatArray
) -> None:
    """Turn a section for `span_s` at ω: its tangent by what is across, then about itself by what is along.

    Together they would be a turn about one fixed axis, and the tangent of a fast roll would nutate about that.
    tangent: in the middle of the turn, shape (3,).
    """
    tx, ty, tz = tangent[0], tangent[1], tangent[2]
    along = tx * omega_x + ty * omega_y + tz * omega_z
    _turn_by(
        span_s * (omega_x - along * tx), span_s * (omega_y - along * ty), span_s * (omega_z - along * tz), rotation
    )
    cosine, sine = np.cos(span_s * along), np.sin(span_s * along)
    for k in range(3):
        first, second = rotation[k, 0], rotation[k, 1]
        rotation[k, 0] = cosine * first + sine * second
        rotation[k, 1] = cosine * second - sine * first


@inner
def carry_spin(start: FloatArray, end: FloatArray, velocity: FloatArray) -> None:
    """Turn the base's ω as its tangent turns from one rotation to another, the shortest way."""
    px, py, pz = start[0, 2], start[1, 2], start[2, 2]
    qx, qy, qz = end[0, 2], end[1, 2], end[2, 2]
    ax, ay, az = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    cosine = px * qx + py * qy + pz * qz
    x, y, z = velocity[3], velocity[4], velocity[5]
    along = (ax * x + ay * y + az * z) / (1.0 + cosine)
    velocity[3] = cosine * x + ay * z - az * y + along * ax
    velocity[4] = cosine * y + az * x - ax * z + along * ay
    velocity[5] = cosine * z + ax * y - ay * x + along * az


@inner
def roll_rate(rotation: FloatArray, velocity: FloatArray) -> float:
    """Rate at which the mid cross-section turns about its tangent [rad/s]."""
    return rotation[0, 2] * velocity[3] + rotation[1, 2] * velocity[4] + rotation[2, 2] * velocity[5]


@inner
def bend_on(
    span_s: float, rolling: float, modes: int, start: FloatArray, rate: FloatArray, middle: FloatArray, end: FloatArray
) -> None:
    """end ← bends after `span_s` of rolling; rate: of all coordinates, in the axes half-way, where bends are `middle`.

    A bend that stays where it is in space turns backwards in axes that roll, exactly.
    """
    cosine, sine = np.cos(0.5 * span_s * rolling), np.sin(0.5 * span_s * rolling)
    for a in range(0, 3 * modes, 3):
        x = cosine * start[a] + sine * start[a + 1] + span_s * (rate[6 + a] - rolling * middle[a + 1])
        y = cosine * start[a + 1] - sine * start[a] + span_s * (rate[7 + a] + rolling * middle[a])
        end[a], end[a + 1] = cosine * x + sine * y, cosine * y - sine * x
        end[a + 2] = start[a + 2] + span_s * rate[8 + a]


@inner
def carry_bends(
    turn: float, rolling: float, modes: int, start: FloatArray, end: FloatArray, velocity: FloatArray
) -> None:
    """Rates of the bends from axes in which they are `start` to axes that have rolled on by `turn`: steady in space."""
    cosine, sine = np.cos(turn), np.sin(turn)
    for a in range(0, 3 * modes, 3):
        x, y = velocity[6 + a] - rolling * start[a + 1], velocity[7 + a] + rolling * start[a]
        velocity[6 + a] = cosine * x + sine * y + rolling * end[a + 1]
        velocity[7 + a] = cosine * y - sine * x - rolling * end[a]


@inner
def turn_gain(turn: float, base: int, modes: int, column: FloatArray, gain: FloatArray) -> None:
    """What the bends' rates gained in the last step, in axes that have rolled on by `turn`."""
    cosine, sine = np.cos(turn), np.sin(turn)
    for d in range(base, column.shape[0] - 1):
        a = int(column[d]) - 6
        if a % 3 == 0 and a < 3 * modes:  # both bends of a mode move, or neither
            x, y = gain[d], gain[d + 1]
            gain[d], gain[d + 1] = cosine * x + sine * y, cosine * y - sine * x
