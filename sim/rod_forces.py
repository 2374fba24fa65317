"""What pulls the rod in a step: inertia, weight, outside forces, the walls θ of the step on, and their softening."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.rod_algebra import dot, integrate_three
from sim.rod_compile import apart, inner
from sim.rod_energy import softened_moment
from sim.rod_rotation import roll_rate
from sim.rod_rule import Rule

FloatArray = NDArray[np.float64]

_RESOLVED = 10.0  # of a coordinate's natural angle a step: θ is half-way between ½ and 1 there


@inner
def strain_forces(
    h: float, tau: float, rolling: float, modes: int, theta: FloatArray, start: FloatArray, middle: FloatArray,
    rest: FloatArray, velocity: FloatArray, off: FloatArray,
) -> None:  # fmt: skip
    """off ← strains off their rest and damping, θ of the step on if velocities stay; in the axes half-way."""
    for a in range(off.shape[0]):
        t = theta[6 + a] * h
        off[a] = start[a] - rest[a] + (t + tau) * velocity[6 + a]
    cosine, sine = np.cos(0.5 * h * rolling), np.sin(0.5 * h * rolling)
    for a in range(0, 3 * modes, 3):
        x, y, t = start[a], start[a + 1], theta[6 + a] * h * rolling
        off[a] += (cosine - 1.0) * x + sine * y - t * middle[a + 1]
        off[a + 1] += (cosine - 1.0) * y - sine * x + t * middle[a]
    turn = (theta[6] - 0.5) * h * rolling  # by which the axes are further on when the rest curvature is what it is
    cosine, sine = np.cos(turn), np.sin(turn)
    off[0] -= (cosine - 1.0) * rest[0] - sine * rest[1]
    off[1] -= (cosine - 1.0) * rest[1] + sine * rest[0]


@apart
def accelerations(
    h: float, rotation: FloatArray, velocity: FloatArray, rate: FloatArray, stretch: float, stretch_rate: float,
    bend: float, rule: Rule, strain: FloatArray, section: FloatArray, triple: FloatArray, bias: FloatArray,
) -> float:  # fmt: skip
    """bias ← −h b; returns its square. velocity: all coordinates; rate: G of them; bend: half the radius."""
    # the axes in which the base's ω is kept go with its tangent, but do not roll: ω' = −(t·ω) t × ω there
    rolling = roll_rate(rotation, velocity)
    base_x = -rolling * (rotation[1, 2] * velocity[5] - rotation[2, 2] * velocity[4])
    base_y = -rolling * (rotation[2, 2] * velocity[3] - rotation[0, 2] * velocity[5])
    base_z = -rolling * (rotation[0, 2] * velocity[4] - rotation[1, 2] * velocity[3])
    modes, n = rule.mode.shape
    spin, source, turning, moving = triple[0], triple[1], triple[2], triple[3]
    for i in range(n):  # α' = ω × Q ẇ + Q ẅ, where steady bends have ẅ in axes that roll
        wx = wy = wz = qx = qy = 0.0
        for m in range(modes):
            p = rule.mode[m, i]
            wx += p * velocity[6 + 3 * m]
            wy += p * velocity[7 + 3 * m]
            wz += p * velocity[8 + 3 * m]
            qx += p * strain[3 * m]
            qy += p * strain[3 * m + 1]
        qx, qy = rolling * (rolling * qx + 2.0 * wy), rolling * (rolling * qy - 2.0 * wx)
        x = section[0, 0, i] * wx + section[1, 0, i] * wy + section[2, 0, i] * wz
        y = section[0, 1, i] * wx + section[1, 1, i] * wy + section[2, 1, i] * wz
        z = section[0, 2, i] * wx + section[1, 2, i] * wy + section[2, 2, i] * wz
        scale = rule.inverse_root[i] / bend
        ox, oy, oz = scale * rate[3, i], scale * rate[4, i], scale * rate[5, i]
        spin[0, i], spin[1, i], spin[2, i] = ox, oy, oz
        source[0, i] = oy * z - oz * y + section[0, 0, i] * qx + section[1, 0, i] * qy
        source[1, i] = oz * x - ox * z + section[0, 1, i] * qx + section[1, 1, i] * qy
        source[2, i] = ox * y - oy * x + section[0, 2, i] * qx + section[1, 2, i] * qy
    integrate_three(source, rule.integral, turning)
    for i in range(n):  # a' = 2ℓ̇ ω × t + ℓ(α × t + ω × (ω × t))
        out = rule.outward[i]
        tx, ty, tz = section[2, 0, i], section[2, 1, i], section[2, 2, i]
        ox, oy, oz = spin[0, i], spin[1, i], spin[2, i]
        cx, cy, cz = oy * tz - oz * ty, oz * tx - ox * tz, ox * ty - oy * tx
        ax, ay, az = base_x + turning[0, i], base_y + turning[1, i], base_z + turning[2, i]
        x = stretch * (ay * tz - az * ty + oy * cz - oz * cy) + 2.0 * stretch_rate * cx
        y = stretch * (az * tx - ax * tz + oz * cx - ox * cz) + 2.0 * stretch_rate * cy
        z = stretch * (ax * ty - ay * tx + ox * cy - oy * cx) + 2.0 * stretch_rate * cz
        source[0, i], source[1, i], source[2, i] = out * x, out * y, out * z
        # gyroscopic: d(Iω)/dt = (µR²/4)(α + t(t·α) + (t·ω) ω × t)
        along = tx * ox + ty * oy + tz * oz
        scale = h * bend * rule.root_mass[i]
        bias[3, i] = -scale * (ax + along * cx)
        bias[4, i] = -scale * (ay + along * cy)
        bias[5, i] = -scale * (az + along * cz)
        bias[6, i] = -scale * (tx * ax + ty * ay + tz * az)
    integrate_three(source, rule.integral, moving)
    for i in range(n):
        scale = h * rule.root_mass[i]
        bias[0, i] = -scale * moving[0, i]
        bias[1, i] = -scale * moving[1, i]
        bias[2, i] = -scale * moving[2, i]
    return dot(bias, bias)


@inner
def push(
    h: float, bend: float, gravity_x: float, gravity_y: float, gravity_z: float, rule: Rule, push_N: FloatArray,
    push_N_m: FloatArray, bias: FloatArray,
) -> None:  # fmt: skip
    """Add gravity and outside forces and moments to the right side of the inertia rows."""
    for i in range(bias.shape[1]):
        root, less = h * rule.root_mass[i], h * rule.inverse_root[i]
        bias[0, i] += root * gravity_x + less * push_N[i, 0]
        bias[1, i] += root * gravity_y + less * push_N[i, 1]
        bias[2, i] += root * gravity_z + less * push_N[i, 2]
        for k in range(3):
            bias[3 + k, i] += less / bend * push_N_m[i, k]


@inner
def set_theta(h: float, damping_time_s: float, rate_1_s2: FloatArray, theta: FloatArray) -> None:
    """θ of each coordinate for steps of h."""
    size = rate_1_s2.shape[0]
    if theta[size] == h:
        return
    theta[size] = h
    for f in range(size):
        angle = h * h * rate_1_s2[f]
        if f >= 6:
            angle += (h * damping_time_s * rate_1_s2[f]) ** 2
        theta[f] = 0.5 + 0.5 * angle / (_RESOLVED * _RESOLVED + angle)


@inner
def elastic_forces(
    h: float, tau: float, base: int, column: FloatArray, theta: FloatArray, stiffness: FloatArray, off: FloatArray,
    matrix: FloatArray, vector: FloatArray,
) -> None:  # fmt: skip
    """Add strain and damping to the equations."""
    for a in range(base, column.shape[0]):
        f = int(column[a])
        line = stiffness[f - 6]
        weight = np.sqrt(h * theta[f] * (tau + h * theta[f]))
        total = 0.0
        for s in range(off.shape[0]):
            total += line[s] * off[s]
        vector[a] -= h * total
        for b in range(base, a + 1):
            g = int(column[b])
            if line[g - 6] != 0.0:
                matrix[a, b] += line[g - 6] * weight * np.sqrt(h * theta[g] * (tau + h * theta[g]))


@inner
def softening(
    h: float, softening_m2: float, tightest_1_m: float, stiffness_1_kg: float, base: int, column: FloatArray,
    strain: FloatArray, rule: Rule, scratch: FloatArray, vector: FloatArray,
) -> None:  # fmt: skip
    """Add what ovalisation takes off the bending moment. stiffness_1_kg: EI L/m; strain: as the rod is placed."""
    modes, n = rule.mode.shape
    first, second = scratch[0], scratch[1]
    for i in range(n):
        x = y = 0.0
        for m in range(modes):
            p = rule.mode[m, i] * rule.outward[i]
            x += p * strain[3 * m]
            y += p * strain[3 * m + 1]
        less, _ = softened_moment(x * x + y * y, softening_m2, tightest_1_m)
        share = less * stiffness_1_kg * rule.root_mass[i] ** 2 * rule.outward[i]
        first[i], second[i] = share * x, share * y
    for a in range(base, column.shape[0]):
        f = int(column[a]) - 6
        if f < 3 * modes and f % 3 < 2:
            total = 0.0
            for i in range(n):
                total += rule.mode[f // 3, i] * (first[i] if f % 3 == 0 else second[i])
            vector[a] += h * total
