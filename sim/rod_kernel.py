"""Kinematics, inertia and the implicit step of the reduced-order rod (plain arrays, compiled, no allocation).

The rod: a Kirchhoff tube, base pose (x, Q0) at its mid cross-section, rotation per reference length w = (−k2, k1,
twist) in the section's axes as a sum of Legendre modes, and (where it stretches) one uniform stretch ℓ:

    Q' = Q [w]×,   r' = ℓ t,   t = Q e3           by a Magnus step between points, by spectral integration
    ω' = Q ẇ,      v' = ℓ̇ t + ℓ ω × t            so the velocities are linear in u = (ẋ, ω0, modes' rates, ℓ̇),

all in world axes, relative to the middle. With A_m = ∫Q P_m ds and B_m = ∫P_m r × Q ds a mode's columns are
∂ω = A_m and ∂v = A_m × r + B_m. Each point carries its mass µ and the cross-section's rotary inertia
µ(R²/4)(1 + t tᵀ), so its inertia is the sum of squares of 7 rows: √µ v, √µ(R/2) ω, √µ(R/2) t·ω. With all rows of all
points as columns of G: mass matrix = Gᵀ G, and a linear damper or spring of a contact is one more row.

One step, linearly implicit in all that is stiff (strain, contact, friction):

    (Gᵀ G + hC + h²K) u⁺ = Gᵀ(G u − h b) − hK(q − q_rest),    then   q ← q + h q̇⁺, x ← x + h ẋ⁺, Q0 ← exp(h ω0⁺) Q0

with G and b at the configuration half a step on, as the last velocity foretells it: the displacement h u⁺ is then
seen from its own middle, which makes the kinematics (rolling, the floating robot's turning) second order. b: the rows'
accelerations at u̇ = 0 (centrifugal, Coriolis and gyroscopic) less gravity. When nothing touches, the right side of the
six equations of the base is the momentum itself, which is so kept to round-off: this turns the floating robot.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.rod_compile import FAST_MATH, inlined, inner, source_stamp
from sim.rod_contact import contact_loads, contact_rows
from sim.rod_memory import INERTIA_ROWS, ROWS, Physics, State, Work, carve
from sim.rod_rule import Rule

FloatArray = NDArray[np.float64]

_SMALLEST_PIVOT = 1e-300
_LARGEST_SPEED = 1e8  # m/s, rad/s, rad/(m s): beyond, the state means nothing


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
def _place_sections(strain: FloatArray, rotation: FloatArray, rule: Rule, section: FloatArray) -> None:
    """Q at the points, outwards from the middle, by a fourth-order Magnus step from point to point."""
    points, modes = rule.turn.shape
    half = points // 2
    for side in range(2):
        a0, a1, a2 = rotation[0, 0], rotation[1, 0], rotation[2, 0]
        b0, b1, b2 = rotation[0, 1], rotation[1, 1], rotation[2, 1]
        c0, c1, c2 = rotation[0, 2], rotation[1, 2], rotation[2, 2]
        for i in range(side * half, (side + 1) * half):
            x = y = z = 0.0
            pair = 0
            for m in range(modes):
                mx, my, mz = strain[3 * m], strain[3 * m + 1], strain[3 * m + 2]
                weight = rule.turn[i, m]
                x += weight * mx
                y += weight * my
                z += weight * mz
                for n in range(m + 1, modes):
                    nx, ny, nz = strain[3 * n], strain[3 * n + 1], strain[3 * n + 2]
                    weight = rule.turn_pair[i, pair]
                    x += weight * (my * nz - mz * ny)
                    y += weight * (mz * nx - mx * nz)
                    z += weight * (mx * ny - my * nx)
                    pair += 1
            # exp as a unit quaternion, s the sine of the half angle over the angle
            angle_squared = x * x + y * y + z * z
            if angle_squared < 0.06:
                q = 0.25 * angle_squared
                s = 0.5 * (1.0 - q / 6.0 * (1.0 - q / 20.0 * (1.0 - q / 42.0 * (1.0 - q / 72.0))))
                w = 1.0 - q / 2.0 * (1.0 - q / 12.0 * (1.0 - q / 30.0 * (1.0 - q / 56.0 * (1.0 - q / 90.0))))
            else:
                angle = np.sqrt(angle_squared)
                s = np.sin(0.5 * angle) / angle
                w = np.cos(0.5 * angle)
            x, y, z = s * x, s * y, s * z
            e00, e11, e22 = 1.0 - 2.0 * (y * y + z * z), 1.0 - 2.0 * (x * x + z * z), 1.0 - 2.0 * (x * x + y * y)
            e01, e10 = 2.0 * (x * y - z * w), 2.0 * (x * y + z * w)
            e02, e20 = 2.0 * (x * z + y * w), 2.0 * (x * z - y * w)
            e12, e21 = 2.0 * (y * z - x * w), 2.0 * (y * z + x * w)
            p0, p1, p2 = a0, a1, a2
            q0, q1, q2 = b0, b1, b2
            a0, a1, a2 = p0 * e00 + q0 * e10 + c0 * e20, p1 * e00 + q1 * e10 + c1 * e20, p2 * e00 + q2 * e10 + c2 * e20
            b0, b1, b2 = p0 * e01 + q0 * e11 + c0 * e21, p1 * e01 + q1 * e11 + c1 * e21, p2 * e01 + q2 * e11 + c2 * e21
            c0, c1, c2 = p0 * e02 + q0 * e12 + c0 * e22, p1 * e02 + q1 * e12 + c1 * e22, p2 * e02 + q2 * e12 + c2 * e22
            section[0, 0, i], section[0, 1, i], section[0, 2, i] = a0, a1, a2
            section[1, 0, i], section[1, 1, i], section[1, 2, i] = b0, b1, b2
            section[2, 0, i], section[2, 1, i], section[2, 2, i] = c0, c1, c2


@inner
def _integrate_three(values: FloatArray, integral: FloatArray, out: FloatArray) -> None:
    """Integrals from the middle outwards of three components (3, n), `outward` already in the values."""
    half = integral.shape[0]
    for k in range(values.shape[0]):
        for i in range(values.shape[1]):
            out[k, i] = 0.0
        for side in range(values.shape[1] // half):
            start = side * half
            for j in range(half):
                value = values[k, start + j]
                for i in range(half):
                    out[k, start + i] += value * integral[j, i]


@inlined
def _place(state: State, physics: Physics, rule: Rule, work: Work, ahead_s: float) -> None:
    """Place the rod where its velocity takes it in `ahead_s`, and fill the inertia rows of G."""
    axes = work.section.shape[
        0
    ]  # read, not written as 3: the compiler would unroll every loop, for longer than it saves
    strain, section, r, rows = work.strain, work.section, work.place_m, work.rows
    velocity = state.velocity
    for a in range(strain.shape[0]):
        strain[a] = state.strain[a] + ahead_s * velocity[6 + a]
    for k in range(axes):
        for c in range(axes):
            work.rotation[k, c] = state.rotation[k, c]
    if ahead_s != 0.0:
        _turn_by(ahead_s * velocity[3], ahead_s * velocity[4], ahead_s * velocity[5], work.rotation)
    modes, points = rule.mode.shape
    half = points // 2
    stretch = strain[3 * modes] if physics.stretches else 1.0
    _place_sections(strain, work.rotation, rule, section)
    scratch = work.triple[0]
    for k in range(axes):
        for i in range(points):
            scratch[k, i] = stretch * rule.outward[i] * section[2, k, i]
    _integrate_three(scratch, rule.integral, r)
    # short loops over few arrays from here on: the compiler turns only these into vector instructions
    density, swept, cross = work.density, work.swept, work.cross
    for c in range(axes):
        for k in range(axes):
            k1, k2 = (k + 1) % 3, (k + 2) % 3
            for i in range(points):
                cross[c, k, i] = r[k1, i] * section[c, k2, i] - r[k2, i] * section[c, k1, i]
    for m in range(modes):
        for c in range(axes):
            for k in range(axes):
                for i in range(points):
                    density[0, m, c, k, i] = rule.mode[m, i] * section[c, k, i]
                for i in range(points):
                    density[1, m, c, k, i] = rule.mode[m, i] * cross[c, k, i]
    lines = 36 * modes
    np.dot(density.reshape(lines, half), rule.integral, swept.reshape(lines, half))

    bend = 0.5 * physics.radius_m
    n = points
    for i in range(n):
        root = rule.root_mass[i]
        x, y, z = root * r[0, i], root * r[1, i], root * r[2, i]
        rows[0, i] = rows[1, n + i] = rows[2, 2 * n + i] = root
        rows[3, n + i], rows[3, 2 * n + i] = -z, y
        rows[4, i], rows[4, 2 * n + i] = z, -x
        rows[5, i], rows[5, n + i] = -y, x
        root *= bend
        rows[3, 3 * n + i] = rows[4, 4 * n + i] = rows[5, 5 * n + i] = root
        for k in range(axes):
            rows[3 + k, 6 * n + i] = root * section[2, k, i]
    for m in range(modes):
        for c in range(axes):
            d = 6 + 3 * m + c
            a = swept[0, m, c]
            for k in range(axes):
                k1, k2 = (k + 1) % 3, (k + 2) % 3
                for i in range(n):
                    arm = a[k1, i] * r[k2, i] - a[k2, i] * r[k1, i]
                    rows[d, k * n + i] = rule.root_mass[i] * (arm + swept[1, m, c, k, i])
                for i in range(n):
                    rows[d, (3 + k) * n + i] = bend * rule.root_mass[i] * a[k, i]
            for i in range(n):
                along = a[0, i] * section[2, 0, i] + a[1, i] * section[2, 1, i] + a[2, i] * section[2, 2, i]
                rows[d, 6 * n + i] = bend * rule.root_mass[i] * along
    if physics.stretches:
        for k in range(axes):
            for i in range(n):
                rows[6 + 3 * modes, k * n + i] = rule.root_mass[i] * r[k, i] / stretch


@inner
def _gram(rows: FloatArray, size: int, length: int, out: FloatArray) -> None:
    """Lower triangle of GᵀG over the first `length` rows and `size` columns of G."""
    for a in range(size):
        b = 0
        while b + 3 <= a:  # four at once: each load of row a serves four products
            s0 = s1 = s2 = s3 = 0.0
            for k in range(length):
                x = rows[a, k]
                s0 += x * rows[b, k]
                s1 += x * rows[b + 1, k]
                s2 += x * rows[b + 2, k]
                s3 += x * rows[b + 3, k]
            out[a, b], out[a, b + 1], out[a, b + 2], out[a, b + 3] = s0, s1, s2, s3
            b += 4
        while b <= a:
            s0 = 0.0
            for k in range(length):
                s0 += rows[a, k] * rows[b, k]
            out[a, b] = s0
            b += 1


@inner
def _solve(matrix: FloatArray, size: int, vector: FloatArray) -> bool:
    """vector ← matrix⁻¹ vector by Cholesky, in place on the lower triangle. False when not positive definite."""
    for a in range(size):
        for b in range(a):
            total = matrix[a, b]
            for k in range(b):
                total -= matrix[a, k] * matrix[b, k]
            matrix[a, b] = total * matrix[b, b]
        total = matrix[a, a]
        for k in range(a):
            total -= matrix[a, k] * matrix[a, k]
        if not total > _SMALLEST_PIVOT:
            return False
        matrix[a, a] = 1.0 / np.sqrt(total)  # kept as its inverse
        total = vector[a]
        for k in range(a):
            total -= matrix[a, k] * vector[k]
        vector[a] = total * matrix[a, a]
    for a in range(size - 1, -1, -1):
        value = vector[a] * matrix[a, a]
        vector[a] = value
        for k in range(a):
            vector[k] -= value * matrix[a, k]
    return True


@inner
def _rates(state: State, physics: Physics, rule: Rule, work: Work) -> None:
    """G u of the inertia rows; the centre of mass; and, unless the momentum is kept, the momentum."""
    rows, rate, velocity, momentum, arm = work.rows, work.rate, state.velocity, state.momentum, work.arm_m
    n = rule.outward.shape[0]
    length = INERTIA_ROWS * n
    for k in range(length):
        rate[k] = 0.0
    for a in range(rows.shape[0]):
        speed = velocity[a]
        for k in range(length):
            rate[k] += speed * rows[a, k]
    x = y = z = 0.0
    for i in range(n):
        weight = rule.root_mass[i] ** 2 / physics.mass_kg
        x += weight * work.place_m[0, i]
        y += weight * work.place_m[1, i]
        z += weight * work.place_m[2, i]
    arm[0], arm[1], arm[2] = x, y, z
    if state.aloft[0] == 0.0:
        for a in range(6):
            total = 0.0
            for k in range(length):
                total += rows[a, k] * rate[k]
            momentum[a] = total
        momentum[3] -= arm[1] * momentum[2] - arm[2] * momentum[1]
        momentum[4] -= arm[2] * momentum[0] - arm[0] * momentum[2]
        momentum[5] -= arm[0] * momentum[1] - arm[1] * momentum[0]


@inner
def _base_momentum(momentum: FloatArray, arm: FloatArray, out: FloatArray) -> None:
    """Linear momentum, and angular about the middle of the tube, from that about its centre of mass."""
    px, py, pz = momentum[0], momentum[1], momentum[2]
    out[0], out[1], out[2] = px, py, pz
    out[3] = momentum[3] + arm[1] * pz - arm[2] * py
    out[4] = momentum[4] + arm[2] * px - arm[0] * pz
    out[5] = momentum[5] + arm[0] * py - arm[1] * px


@inlined
def _accelerations(state: State, physics: Physics, rule: Rule, work: Work) -> None:
    """rate ← rate − h b: the rows' accelerations at u̇ = 0, less gravity."""
    section, rate, triple = work.section, work.rate, work.triple
    modes, n = rule.mode.shape
    velocity, h, bend = state.velocity, physics.step_s, 0.5 * physics.radius_m
    stretch, stretch_rate = 1.0, 0.0
    if physics.stretches:
        stretch, stretch_rate = work.strain[3 * modes], velocity[6 + 3 * modes]
    spin, source, turning, moving = triple[0], triple[1], triple[2], triple[3]
    for i in range(n):  # α' = ω × Q ẇ
        wx = wy = wz = 0.0
        for m in range(modes):
            p = rule.mode[m, i]
            wx += p * velocity[6 + 3 * m]
            wy += p * velocity[7 + 3 * m]
            wz += p * velocity[8 + 3 * m]
        x = section[0, 0, i] * wx + section[1, 0, i] * wy + section[2, 0, i] * wz
        y = section[0, 1, i] * wx + section[1, 1, i] * wy + section[2, 1, i] * wz
        z = section[0, 2, i] * wx + section[1, 2, i] * wy + section[2, 2, i] * wz
        scale = 1.0 / (bend * rule.root_mass[i])
        ox, oy, oz = scale * rate[3 * n + i], scale * rate[4 * n + i], scale * rate[5 * n + i]
        spin[0, i], spin[1, i], spin[2, i] = ox, oy, oz
        source[0, i], source[1, i], source[2, i] = oy * z - oz * y, oz * x - ox * z, ox * y - oy * x
    _integrate_three(source, rule.integral, turning)
    for i in range(n):  # a' = 2ℓ̇ ω × t + ℓ(α × t + ω × (ω × t))
        out = rule.outward[i]
        tx, ty, tz = section[2, 0, i], section[2, 1, i], section[2, 2, i]
        ox, oy, oz = spin[0, i], spin[1, i], spin[2, i]
        cx, cy, cz = oy * tz - oz * ty, oz * tx - ox * tz, ox * ty - oy * tx
        ax, ay, az = turning[0, i], turning[1, i], turning[2, i]
        x = stretch * (ay * tz - az * ty + oy * cz - oz * cy) + 2.0 * stretch_rate * cx
        y = stretch * (az * tx - ax * tz + oz * cx - ox * cz) + 2.0 * stretch_rate * cy
        z = stretch * (ax * ty - ay * tx + ox * cy - oy * cx) + 2.0 * stretch_rate * cz
        source[0, i], source[1, i], source[2, i] = out * x, out * y, out * z
        # gyroscopic: d(Iω)/dt = (µR²/4)(α + t(t·α) + (t·ω) ω × t)
        along = tx * ox + ty * oy + tz * oz
        scale = h * bend * rule.root_mass[i]
        rate[3 * n + i] -= scale * (ax + along * cx)
        rate[4 * n + i] -= scale * (ay + along * cy)
        rate[5 * n + i] -= scale * (az + along * cz)
        rate[6 * n + i] -= scale * (tx * ax + ty * ay + tz * az)
    _integrate_three(source, rule.integral, moving)
    for i in range(n):
        scale = h * rule.root_mass[i]
        rate[i] -= scale * moving[0, i]
        rate[n + i] -= scale * moving[1, i]
        rate[2 * n + i] -= scale * (moving[2, i] + physics.gravity_m_s2)


@inner
def _show_kept_momentum(state: State, rule: Rule, work: Work) -> None:
    """Correct work.rate, by work.vector[:6], to the base's velocity that a kept momentum asks for."""
    rows, rate, change = work.rows, work.rate, work.vector
    base, length = state.momentum.shape[0], INERTIA_ROWS * rule.outward.shape[0]
    for a in range(base):
        change[a] = 0.0
    if state.aloft[0] == 0.0:
        return
    _base_momentum(state.momentum, work.arm_m, change)
    for a in range(base):
        for k in range(length):
            change[a] -= rows[a, k] * rate[k]
    _gram(rows, base, length, work.matrix)
    if _solve(work.matrix, base, change):
        for a in range(base):
            for k in range(length):
                rate[k] += change[a] * rows[a, k]


@inlined
def _step(state: State, physics: Physics, rule: Rule, work: Work) -> bool:
    """One step of a rod that is placed half a step on. False when the state is no longer finite."""
    size, n = work.rows.shape[0], rule.outward.shape[0]
    strain, velocity, position = state.strain, state.velocity, state.position_m
    matrix, vector, rows, rate = work.matrix, work.vector, work.rows, work.rate
    h = physics.step_s
    touching = physics.touches and contact_rows(state, physics, rule, work)
    _accelerations(state, physics, rule, work)
    length = (ROWS if touching else INERTIA_ROWS) * n
    _gram(rows, size, length, matrix)
    for a in range(size):
        total = 0.0
        for k in range(length):
            total += rows[a, k] * rate[k]
        vector[a] = total
    if touching:
        state.aloft[0] = 0.0
    else:
        state.aloft[0] = 1.0
        state.momentum[2] -= h * physics.mass_kg * physics.gravity_m_s2
        _base_momentum(state.momentum, work.arm_m, vector)
    implicit = h * (physics.damping_time_s + h)
    for a in range(size - 6):
        total = 0.0
        for b in range(size - 6):
            total += state.stiffness[a, b] * (strain[b] - state.rest_strain[b])
        vector[6 + a] -= h * total
        for b in range(a + 1):
            matrix[6 + a, 6 + b] += implicit * state.stiffness[a, b]
    if not _solve(matrix, size, vector):
        return False
    contact_loads(touching, state, physics, rule, work)
    for a in range(size):
        velocity[a] = vector[a]
        if not abs(vector[a]) < _LARGEST_SPEED:
            return False
    for a in range(size - 6):
        strain[a] += h * velocity[6 + a]
    if physics.stretches and not strain[size - 7] > 0.0:
        return False
    for k in range(3):
        position[k] += h * velocity[k]
    _turn_by(h * velocity[3], h * velocity[4], h * velocity[5], state.rotation)
    return True


def _compile(stamp: str):  # type: ignore[no-untyped-def]
    @njit(cache=True, fastmath=FAST_MATH)
    def steps(count: int, memory: FloatArray, modes: int, points: int, strains: int, physics: Physics) -> bool:
        """Advance a rod by `count` steps under constant rest strains. False when the state is no longer finite.

        memory: as `rod_memory.carve` lays it out. count = 0 only looks at the rod as it is: fills work.section,
        place_m, arm_m, rows (inertia) and rate; work.vector[:6] is then what the velocity of the middle (linear,
        angular) lacks where the momentum is kept.
        """
        state, rule, work, _ = carve(memory, modes, points, strains)
        going = len(stamp) > 0
        for _ in range(max(count, 1)):
            _place(state, physics, rule, work, 0.5 * physics.step_s if count > 0 else 0.0)
            _rates(state, physics, rule, work)
            if count == 0:
                _show_kept_momentum(state, rule, work)
            else:
                going = going and _step(state, physics, rule, work)
        return going

    return steps


steps = _compile(source_stamp())
