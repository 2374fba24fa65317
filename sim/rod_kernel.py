"""Kinematics, inertia and the implicit step of the reduced-order rod (plain arrays, compiled, no allocation).

The rod: a Kirchhoff tube, base pose (x, Q0) at its mid cross-section, rotation per reference length w = (−k2, k1,
twist) in the section's axes as a sum of modes ψ_m, and (where it stretches) one uniform stretch ℓ:

    Q' = Q [w]×,   r' = ℓ t,   t = Q e3           by a Magnus step between points, by spectral integration
    ω' = Q ẇ,      v' = ℓ̇ t + ℓ ω × t            so the velocities are linear in u = (ẋ, ω0, modes' rates, ℓ̇),

all in world axes, relative to the middle. With A_m = ∫Q ψ_m ds and B_m = ∫ψ_m r × Q ds a mode's columns are
∂ω = A_m and ∂v = A_m × r + B_m. Each point carries its mass µ and the cross-section's rotary inertia
µ(R²/4)(1 + t tᵀ), so its inertia is the sum of squares of 7 rows: √µ v, √µ(R/2) ω, √µ(R/2) t·ω. With all rows of all
points as columns of G, the mass matrix is Gᵀ G; a linear damper or spring of a contact is one more row.

One step of length h finds the velocity gained, Δ, with G and the accelerations at u̇ = 0, b, at the middle of the step
as u foretells it, and all that is stiff (strain, damping, contact) taken implicitly:

    (GᵀG + hθC + h²θ²K + contact) Δ = −h Gᵀb − hK(q + θhu − q_rest) − hCu + contact,
    ū = u + θΔ,   u⁺ = u + Δ,   q⁺ = q + hū,   Q0⁺ = exp(hω̄) Q0

θ is each coordinate's own: ½ where the step resolves its natural motion (then the method is of second order), towards 1
where it does not (then it is damped out instead of rung); θ − ½ falls with h². b is quadratic in the velocity: where it
has changed by more than is negligible it is taken again with ū, and the same factors solve again. Contacts that the
solution contradicts are mended and solved again (`sim.rod_contact`). A step that turns or bends the rod too far to be
trusted is halved, and so is, under a tolerance, one whose error is too large.

When nothing touches, the velocity of the base that moves the rod follows from the momentum itself, which is so kept to
round-off: this turns the floating robot.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.motion_rows import ROW_SIZE
from sim.rod_compile import FAST_MATH, inlined, inner, source_stamp
from sim.rod_contact import contact_rows, contradicted, drop_contacts, find_contacts, ground_energy, keep_contacts
from sim.rod_drive import growing_step_s, quiet_until_s, rest_curvature
from sim.rod_ground import profile_gap
from sim.rod_memory import Contacts, Layout, Physics, State, Work, carve
from sim.rod_rule import Rule

FloatArray = NDArray[np.float64]

_SMALLEST_PIVOT = 1e-300
_LARGEST_SPEED = 1e8  # m/s, rad/s, rad/(m s): beyond, the state means nothing
_RESOLVED = 10.0  # of a coordinate's natural angle a step: θ is half-way between ½ and 1 there
_PASSES = 4  # of one step, at most
_AGAIN = 1e-4  # b is taken again when its change is more than this share of the velocity
_LARGEST_TURN = 0.32  # rad in a step, of the tangent in the middle: 20 steps a turn
_LARGEST_ROLL = 0.8  # rad in a step, about that tangent
_LARGEST_BEND = 1.0  # rad in a step, from end to end
_LARGEST_SWING = 0.5  # turn of the velocity in a step, by inertia alone
_LARGEST_STRETCH = 0.3  # in a step
_LARGEST_LIFT = 0.01  # of the radius, in a step
_LEAST_STRETCH = 0.1
_WAKING = 0.125  # of a step: the first one of a robot that slept
_HALVINGS = 14
_AFTER_KINK = 0.02  # bending stiffness beyond the kink over that of the straight tube: keeps the tube finite
_REST_TIME_S = 0.1

_ENERGY_SLACK = 2e-3
_AUDIT_STEPS = 16  # from one audit of the energy to the next, where steps are neither divided
_EASY_SOLVES = 2.0  # nor solved more often than so
_WATCHED_STEPS = 512.0  # halved and audited one by one after one that had made energy

ALOFT, RESTED, TIME, WORK, ADVICE, KINKED, STEPS, ASLEEP, SOLVES, AUDITED, CEILING, LARGEST, CREATED = range(13)


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
def _advance_rotation(
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
def _carry(start: FloatArray, end: FloatArray, velocity: FloatArray) -> None:
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
def _rolling(rotation: FloatArray, velocity: FloatArray) -> float:
    """Rate at which the mid cross-section turns about its tangent [rad/s]."""
    return rotation[0, 2] * velocity[3] + rotation[1, 2] * velocity[4] + rotation[2, 2] * velocity[5]


@inner
def _bend_on(
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
def _carry_bends(
    turn: float, rolling: float, modes: int, start: FloatArray, end: FloatArray, velocity: FloatArray
) -> None:
    """Rates of the bends from axes in which they are `start` to axes that have rolled on by `turn`: steady in space."""
    cosine, sine = np.cos(turn), np.sin(turn)
    for a in range(0, 3 * modes, 3):
        x, y = velocity[6 + a] - rolling * start[a + 1], velocity[7 + a] + rolling * start[a]
        velocity[6 + a] = cosine * x + sine * y + rolling * end[a + 1]
        velocity[7 + a] = cosine * y - sine * x - rolling * end[a]


@inner
def _turn_gain(turn: float, base: int, modes: int, column: FloatArray, gain: FloatArray) -> None:
    """What the bends' rates gained in the last step, in axes that have rolled on by `turn`."""
    cosine, sine = np.cos(turn), np.sin(turn)
    for d in range(base, column.shape[0] - 1):
        a = int(column[d]) - 6
        if a % 3 == 0 and a < 3 * modes:  # both bends of a mode move, or neither
            x, y = gain[d], gain[d + 1]
            gain[d], gain[d + 1] = cosine * x + sine * y, cosine * y - sine * x


@inner
def _strain_forces(
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


@inner
def _copy(source: FloatArray, target: FloatArray) -> None:
    for k in range(source.shape[0]):
        target[k] = source[k]


@inner
def _place_sections(strain: FloatArray, rotation: FloatArray, rule: Rule, section: FloatArray) -> None:
    """Q at the points, outwards from the middle, by a fourth-order Magnus step from point to point."""
    points, modes = rule.turn.shape
    half = rule.integral.shape[0]
    for side in range(points // half):
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


@inner
def _place(state: State, physics: Physics, rule: Rule, work: Work, layout: Layout, ahead_s: float) -> None:
    """Place the rod where its velocity takes it in `ahead_s`, and fill the rows of G."""
    axes = work.section.shape[0]  # not written as 3: the compiler would unroll every loop, for longer than it saves
    strain, section, r, rows = work.strain, work.section, work.place_m, work.rows
    velocity = state.velocity
    n, modes, half, base, columns = layout.points, layout.modes, layout.half, layout.base, layout.columns
    if ahead_s == 0.0:
        _copy(state.strain, strain)
    else:
        _bend_on(ahead_s, _rolling(state.rotation, velocity), modes, state.strain, velocity, state.strain, strain)
        if physics.stretches:
            strain[3 * modes] = state.strain[3 * modes] + ahead_s * velocity[6 + 3 * modes]
    for k in range(axes):
        for c in range(axes):
            work.rotation[k, c] = state.rotation[k, c]
    if ahead_s != 0.0:
        _advance_rotation(ahead_s, state.rotation[:, 2], velocity[3], velocity[4], velocity[5], work.rotation)
    stretch = strain[3 * modes] if physics.stretches else 1.0
    _place_sections(strain, work.rotation, rule, section)
    scratch = work.triple[0]
    for k in range(axes):
        for i in range(n):
            scratch[k, i] = stretch * rule.outward[i] * section[2, k, i]
    _integrate_three(scratch, rule.integral, r)
    # short loops over few arrays from here on: the compiler turns only these into vector instructions
    density, swept, cross = work.density, work.swept, work.cross
    for c in range(axes):
        for k in range(axes):
            k1, k2 = (k + 1) % 3, (k + 2) % 3
            for i in range(n):
                cross[c, k, i] = r[k1, i] * section[c, k2, i] - r[k2, i] * section[c, k1, i]
    bends = columns - base - (1 if physics.stretches else 0)
    for d in range(base, base + bends):
        f = int(work.column[d]) - 6
        m, c = f // 3, f % 3
        for k in range(axes):
            for i in range(n):
                density[d, 0, k, i] = rule.mode[m, i] * section[c, k, i]
            for i in range(n):
                density[d, 1, k, i] = rule.mode[m, i] * cross[c, k, i]
    lines = bends * 6 * (n // half)
    np.dot(
        density[base : base + bends].reshape(lines, half),
        rule.integral,
        swept[base : base + bends].reshape(lines, half),
    )

    bend = 0.5 * physics.radius_m
    for d in range(base):
        f = int(work.column[d])
        if f < 3:
            for i in range(n):
                rows[d, f, i] = rule.root_mass[i]
        else:
            k = f - 3
            k1, k2 = (k + 1) % 3, (k + 2) % 3
            for i in range(n):
                root = rule.root_mass[i]
                rows[d, k1, i] = -root * r[k2, i]
                rows[d, k2, i] = root * r[k1, i]
                rows[d, 3 + k, i] = root * bend
                rows[d, 6, i] = root * bend * section[2, k, i]
    for d in range(base, base + bends):
        a, b = swept[d, 0], swept[d, 1]
        for k in range(axes):
            k1, k2 = (k + 1) % 3, (k + 2) % 3
            for i in range(n):
                arm = a[k1, i] * r[k2, i] - a[k2, i] * r[k1, i]
                rows[d, k, i] = rule.root_mass[i] * (arm + b[k, i])
            for i in range(n):
                rows[d, 3 + k, i] = bend * rule.root_mass[i] * a[k, i]
        for i in range(n):
            along = a[0, i] * section[2, 0, i] + a[1, i] * section[2, 1, i] + a[2, i] * section[2, 2, i]
            rows[d, 6, i] = bend * rule.root_mass[i] * along
    if physics.stretches:
        for k in range(axes):
            for i in range(n):
                rows[columns - 1, k, i] = rule.root_mass[i] * r[k, i] / stretch
    arm_m = work.arm_m
    for k in range(axes):
        total = 0.0
        for i in range(n):
            total += rule.root_mass[i] ** 2 * r[k, i]
        arm_m[k] = total / physics.mass_kg
    if physics.mirrored:
        arm_m[0] = 0.0


@inner
def _flat(rows: FloatArray) -> FloatArray:
    """Rows of one length, shape (columns, lines · points)."""
    return rows.reshape(rows.shape[0], rows.shape[1] * rows.shape[2])


@inner
def _gram(rows: FloatArray, size: int, out: FloatArray, add: bool) -> None:
    """Lower triangle of GᵀG over the first `size` columns of G, shape (columns, rows); added to `out` where asked."""
    length = rows.shape[1]
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
            if add:
                out[a, b] += s0
                out[a, b + 1] += s1
                out[a, b + 2] += s2
                out[a, b + 3] += s3
            else:
                out[a, b], out[a, b + 1], out[a, b + 2], out[a, b + 3] = s0, s1, s2, s3
            b += 4
        while b <= a:
            s0 = 0.0
            for k in range(length):
                s0 += rows[a, k] * rows[b, k]
            out[a, b] = out[a, b] + s0 if add else s0
            b += 1


@inner
def _factor(matrix: FloatArray, size: int) -> bool:
    """Cholesky in place on the lower triangle, the diagonal as its inverse. False when not positive definite."""
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
        matrix[a, a] = 1.0 / np.sqrt(total)
    return True


@inner
def _forward(matrix: FloatArray, size: int, vector: FloatArray) -> None:
    """vector ← L⁻¹ vector."""
    for a in range(size):
        total = vector[a]
        for k in range(a):
            total -= matrix[a, k] * vector[k]
        vector[a] = total * matrix[a, a]


@inner
def _backward(matrix: FloatArray, size: int, vector: FloatArray) -> None:
    """vector ← L⁻ᵀ vector."""
    for a in range(size - 1, -1, -1):
        value = vector[a] * matrix[a, a]
        vector[a] = value
        for k in range(a):
            vector[k] -= value * matrix[a, k]


@inner
def _times(rows: FloatArray, size: int, vector: FloatArray, product: FloatArray) -> None:
    """product ← G vector, over `size` columns; rows and product as they are shaped in Work."""
    columns, out = _flat(rows), product.ravel()
    length = out.shape[0]
    for k in range(length):
        out[k] = 0.0
    for a in range(size):
        share, column = vector[a], columns[a]
        for k in range(length):
            out[k] += share * column[k]


@inner
def _dot(column: FloatArray, other: FloatArray) -> float:
    """Sum of the products of two arrays of one shape."""
    x, y = column.ravel(), other.ravel()
    total = 0.0
    for k in range(x.shape[0]):
        total += x[k] * y[k]
    return total


@inner
def _add_scaled(first: FloatArray, share: float, second: FloatArray, total: FloatArray) -> None:
    """total ← first + share · second, of one shape."""
    x, y, out = first.ravel(), second.ravel(), total.ravel()
    for k in range(x.shape[0]):
        out[k] = x[k] + share * y[k]


@inner
def _missed(rate: FloatArray, change: FloatArray, foretold: FloatArray) -> float:
    """|G(u + Δ/2) − what was foretold of it|²."""
    x, y, z = rate.ravel(), change.ravel(), foretold.ravel()
    total = 0.0
    for k in range(x.shape[0]):
        total += (x[k] + 0.5 * y[k] - z[k]) ** 2
    return total


@inner
def _gather(coordinates: FloatArray, column: FloatArray, out: FloatArray) -> None:
    """out ← the columns' part of all coordinates."""
    for d in range(column.shape[0]):
        out[d] = coordinates[int(column[d])]


@inner
def _take_momentum(
    base: int, rows: FloatArray, rate: FloatArray, column: FloatArray, arm: FloatArray, momentum: FloatArray
) -> None:
    """The momentum about the centre of mass of a rod that moves as `rate` says, shape (6,)."""
    for k in range(6):
        momentum[k] = 0.0
    for d in range(base):
        momentum[int(column[d])] = _dot(rows[d], rate)
    momentum[3] -= arm[1] * momentum[2] - arm[2] * momentum[1]
    momentum[4] -= arm[2] * momentum[0] - arm[0] * momentum[2]
    momentum[5] -= arm[0] * momentum[1] - arm[1] * momentum[0]


@inner
def _base_momentum(base: int, momentum: FloatArray, column: FloatArray, arm: FloatArray, out: FloatArray) -> None:
    """Linear momentum, and angular about the middle of the tube, from that about its centre of mass."""
    for d in range(base):
        f = int(column[d])
        value = momentum[f]
        if f >= 3:
            k1, k2 = (f + 1) % 3, (f + 2) % 3
            value += arm[k1] * momentum[k2] - arm[k2] * momentum[k1]
        out[d] = value


@inner
def _accelerations(
    h: float, rotation: FloatArray, velocity: FloatArray, rate: FloatArray, stretch: float, stretch_rate: float,
    bend: float, rule: Rule, strain: FloatArray, section: FloatArray, triple: FloatArray, bias: FloatArray,
) -> float:  # fmt: skip
    """bias ← −h b; returns its square. velocity: all coordinates; rate: G of them; bend: half the radius."""
    # the axes in which the base's ω is kept go with its tangent, but do not roll: ω' = −(t·ω) t × ω there
    rolling = _rolling(rotation, velocity)
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
    _integrate_three(source, rule.integral, turning)
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
    _integrate_three(source, rule.integral, moving)
    for i in range(n):
        scale = h * rule.root_mass[i]
        bias[0, i] = -scale * moving[0, i]
        bias[1, i] = -scale * moving[1, i]
        bias[2, i] = -scale * moving[2, i]
    return _dot(bias, bias)


@inner
def _push(
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
def _set_theta(h: float, damping_time_s: float, rate_1_s2: FloatArray, theta: FloatArray) -> None:
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
def _softened(bend_squared: float, a: float, radius_m: float) -> tuple[float, float]:
    """1 − (passive moment over EIκ), and the elastic energy that is missing over EI, of a section that ovalises.

    Beyond the kink it hardly resists, until at κ = 1/R its inner side folds on itself.
    """
    kink_squared = 1.0 / (3.0 * a)
    if bend_squared <= kink_squared:
        return a * bend_squared, 0.25 * a * bend_squared * bend_squared
    kink, bend = np.sqrt(kink_squared), np.sqrt(bend_squared)
    fold = max(kink, 1.0 / radius_m)
    beyond, folded = min(bend, fold) - kink, max(bend - fold, 0.0)
    moment = kink * 2.0 / 3.0 + _AFTER_KINK * beyond
    energy = 5.0 / 12.0 * kink_squared + beyond * (kink * 2.0 / 3.0 + 0.5 * _AFTER_KINK * beyond)
    energy += folded * (moment + 0.5 * folded)
    moment += folded
    return 1.0 - moment / bend, 0.5 * bend_squared - energy


@inner
def _elastic_forces(
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
def _softening(
    h: float, softening_m2: float, radius_m: float, stiffness_1_kg: float, base: int, column: FloatArray,
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
        less, _ = _softened(x * x + y * y, softening_m2, radius_m)
        share = less * stiffness_1_kg * rule.root_mass[i] ** 2 * rule.outward[i]
        first[i], second[i] = share * x, share * y
    for a in range(base, column.shape[0]):
        f = int(column[a]) - 6
        if f < 3 * modes and f % 3 < 2:
            total = 0.0
            for i in range(n):
                total += rule.mode[f // 3, i] * (first[i] if f % 3 == 0 else second[i])
            vector[a] += h * total


@inner
def _base_that_keeps_momentum(
    base: int, momentum: FloatArray, column: FloatArray, arm: FloatArray, theta: FloatArray, velocity: FloatArray,
    matrix: FloatArray, mean: FloatArray, vector: FloatArray, scratch: FloatArray,
) -> None:  # fmt: skip
    """mean of the base from the momentum at the middle of the step, with the factors of the equations."""
    _base_momentum(base, momentum, column, arm, scratch)
    _forward(matrix, base, scratch)
    for a in range(base, column.shape[0]):
        speed = mean[int(column[a])]
        for b in range(base):
            scratch[b] -= matrix[a, b] * speed
    _backward(matrix, base, scratch)
    for d in range(base):
        f = int(column[d])
        mean[f] = scratch[d]
        vector[d] = scratch[d] + (1.0 - theta[f]) * vector[d] - velocity[f]  # an estimate for the end of the step


@inner
def _outside_impulse(
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
def _trusted(
    h: float, length_m: float, radius_m: float, modes: int, stretch: float, touching: bool, rolling: float,
    vector: FloatArray, mean: FloatArray, column: FloatArray, theta: FloatArray, strain: FloatArray,
) -> int:  # fmt: skip
    """0: the step may stand; 1: it turns, bends or stretches the rod too far; 2: it is not finite.

    rolling: of the middle about its tangent; bends that only go round with it are none. strain: half-way.
    """
    gained = 0.0  # of the base's ω
    for d in range(vector.shape[0]):
        f = int(column[d])
        if not (abs(vector[d]) < _LARGEST_SPEED and abs(mean[f]) < _LARGEST_SPEED):
            return 2
        if 3 <= f < 6:
            gained += vector[d] * vector[d]
    turned = mean[3] ** 2 + mean[4] ** 2 + mean[5] ** 2 - rolling * rolling
    if h * h * turned > _LARGEST_TURN * _LARGEST_TURN or h * abs(rolling) > _LARGEST_ROLL:
        return 1
    bend = 0.0
    for a in range(0, 3 * modes, 3):
        bend += abs(mean[6 + a] - rolling * strain[a + 1]) + abs(mean[7 + a] + rolling * strain[a]) + abs(mean[8 + a])
    if h * length_m * bend > _LARGEST_BEND:
        return 1
    if mean.shape[0] > 6 + 3 * modes and abs(h * mean[6 + 3 * modes]) > _LARGEST_STRETCH * stretch:
        return 1
    if touching:  # what lies flat rolls and bends at once: where these have θ of their own it leaves the ground
        arch = 0.125 * length_m * min(length_m * np.sqrt(strain[0] * strain[0] + strain[1] * strain[1]), 4.0)
        if h * abs(theta[3] - theta[6]) * np.sqrt(gained) * arch > _LARGEST_LIFT * radius_m:
            return 1
    return 0


@inner
def _swinging(base: int, mirrored: bool, root: FloatArray, rate: FloatArray) -> float:
    """|rate|² without the mean of the velocity, which all points share; never below its round-off."""
    whole, mass = _dot(rate, rate), _dot(root, root)
    total = whole
    for k in range(1 if mirrored else 0, 3 if base > 0 else 0):
        mean = _dot(root, rate[k])
        total -= mean * mean / mass
    return max(total, 1e-10 * whole)


@inner
def _error(
    h: float, mass_kg: float, radius_m: float, rows: FloatArray, vector: FloatArray, gain: FloatArray,
    scratch: FloatArray, product: FloatArray,
) -> float:  # fmt: skip
    """Estimate of the step's error over the radius: h³ü/12 as a root mean square of the tube's points."""
    for d in range(vector.shape[0]):
        scratch[d] = vector[d] / h - gain[d]
    _times(rows, vector.shape[0], scratch, product)
    return h * h / 12.0 * np.sqrt(_dot(product, product) / mass_kg) / radius_m


@inner
def _curvature_squared(i: int, strain: FloatArray, mode: FloatArray) -> float:
    """At a point; the sign of `outward` in `mode` does not matter."""
    x = y = 0.0
    for m in range(mode.shape[0]):
        x += mode[m, i] * strain[3 * m]
        y += mode[m, i] * strain[3 * m + 1]
    return x * x + y * y


@inlined
def _step(h: float, state: State, physics: Physics, rule: Rule, contacts: Contacts, work: Work, layout: Layout) -> int:
    """One step of h, or none: 0: done; 1: too coarse, nothing changed; 2: not finite, nothing changed."""
    size, base, modes = layout.columns, layout.base, layout.modes
    strain, velocity, position, flag = state.strain, state.velocity, state.position_m, state.flag
    matrix, vector, mean, theta, column = work.matrix, work.vector, work.mean, work.theta, work.column
    rows, rate, ahead, change, bias = work.rows, work.rate, work.ahead, work.change, work.bias
    arm, less, bend = work.arm_m, rule.inverse_root, 0.5 * physics.radius_m
    gx, gy, gz = physics.gravity_x_m_s2, physics.gravity_y_m_s2, physics.gravity_z_m_s2
    stretch = strain[3 * modes] if physics.stretches else 1.0
    stretching = velocity[6 + 3 * modes] if physics.stretches else 0.0
    _set_theta(h, physics.damping_time_s, state.modal_rate_1_s2, theta)
    _place(state, physics, rule, work, layout, 0.5 * h)
    _copy(velocity, work.before)
    rolling = _rolling(state.rotation, velocity)
    _carry(state.rotation, work.rotation, velocity)
    _carry_bends(0.5 * h * rolling, rolling, modes, strain, work.strain, velocity)
    _strain_forces(
        h, physics.damping_time_s, rolling, modes, theta, strain, work.strain, state.rest_strain, velocity, work.off
    )  # fmt: skip
    _gather(velocity, column, vector)
    _times(rows, size, vector, rate)
    _turn_gain(h * rolling, base, modes, column, state.gain)
    for d in range(size):
        f = int(column[d])
        mean[f] = velocity[f] + 0.5 * h * state.gain[d]
        vector[d] = mean[f]
    _times(rows, size, vector, work.foretold)
    twisting = _accelerations(
        h, work.rotation, mean, work.foretold, stretch, stretching, bend, rule, work.strain, work.section,
        work.triple, bias,
    )  # fmt: skip
    swinging = _swinging(base, physics.mirrored, rule.root_mass, work.foretold)
    if twisting > _LARGEST_SWING**2 * (swinging + physics.mass_kg * physics.sleep_speed_m_s**2):
        _copy(work.before, velocity)
        return 1
    # the velocities that strains carry stand for the time (1 − θ)h after the middle of the step (u̇ = −Gᵀb, steadily)
    _add_scaled(rate, theta[6] - 1.0, bias, ahead)
    _push(h, bend, gx, gy, gz, rule, state.push_N, state.push_N_m, bias)
    touching = False
    if physics.ground > 0:
        touching = find_contacts(
            h, theta[0], position, velocity, physics, contacts, work.place_m, less, rate, work.foretold, ahead, bias
        )  # fmt: skip
    _gram(_flat(rows), size, work.inertia, False)
    kept = base > 0 and not touching
    if kept and flag[ALOFT] == 0.0:  # the momentum that it takes off with
        _copy(work.before, velocity)
        _place(state, physics, rule, work, layout, 0.0)
        _gather(velocity, column, vector)
        _times(rows, size, vector, rate)
        _take_momentum(base, rows, rate, column, arm, state.momentum)
        _place(state, physics, rule, work, layout, 0.5 * h)
        _carry(state.rotation, work.rotation, velocity)
        _carry_bends(0.5 * h * rolling, rolling, modes, strain, work.strain, velocity)
        _gather(velocity, column, vector)
        _times(rows, size, vector, rate)
    moving = _dot(rate, rate)
    again = True
    for sweep in range(_PASSES):
        flag[SOLVES] += 1.0
        if touching:
            contact_rows(h, theta[0], physics, contacts, rule.root_mass, less, rows, ahead, work.triple[0])
        for a in range(size):
            vector[a] = _dot(rows[a], bias)
            if touching:
                vector[a] += _dot(contacts.rows[a], contacts.drive)
            for b in range(a + 1):
                matrix[a, b] = work.inertia[a, b]
        if touching:
            _gram(_flat(contacts.rows), size, matrix, True)
        _elastic_forces(
            h, physics.damping_time_s, base, column, theta, state.stiffness, work.off, matrix, vector
        )  # fmt: skip
        if physics.softening_m2 > 0.0:
            _softening(
                h, physics.softening_m2, physics.radius_m, physics.bending_N_m2 * physics.length_m / physics.mass_kg,
                base, column, work.strain, rule, work.triple[0], vector,
            )  # fmt: skip
        if not _factor(matrix, size):
            _copy(work.before, velocity)
            return 2
        _forward(matrix, size, vector)
        _backward(matrix, size, vector)
        for d in range(size):
            f = int(column[d])
            mean[f] = velocity[f] + theta[f] * vector[d]
        _times(rows, size, vector, change)
        if sweep == _PASSES - 1:
            break
        repeat = False
        if physics.ground > 0:
            repeat = contradicted(h, theta[0], physics, contacts, less, change)
            touching = touching or repeat
            kept = base > 0 and not touching
        if again:
            missed = _missed(rate, change, work.foretold)
            # b goes with the square of the velocity: its change is 2 |b| |what u was missed by| / |u|
            pull = physics.mass_kg * (h * (abs(gx) + abs(gy) + abs(gz))) ** 2
            if 4.0 * twisting * missed > _AGAIN * _AGAIN * moving * (moving + pull):
                repeat = True
                again = False
                stretching = mean[6 + 3 * modes] if physics.stretches else 0.0
                _add_scaled(rate, 0.5, change, work.foretold)
                _accelerations(
                    h, work.rotation, mean, work.foretold, stretch, stretching, bend, rule, work.strain, work.section,
                    work.triple, bias,
                )  # fmt: skip
                _push(h, bend, gx, gy, gz, rule, state.push_N, state.push_N_m, bias)
        if not repeat:
            break
    after = bias.ravel()  # free from here on
    if kept:
        now, scratch = after[:6], change.ravel()
        _outside_impulse(
            0.5 * h, physics.mass_kg, gx, gy, gz, state.push_N, state.push_N_m, work.place_m, arm, state.momentum, now
        )  # fmt: skip
        _base_that_keeps_momentum(base, now, column, arm, theta, velocity, matrix, mean, vector, scratch)
    verdict = _trusted(
        h, physics.length_m, physics.radius_m, modes, stretch, touching, _rolling(work.rotation, mean), vector, mean,
        column, theta, work.strain,
    )  # fmt: skip
    if verdict > 0:
        _copy(work.before, velocity)
        return verdict
    flag[ADVICE] = 2.0 * h
    if physics.tolerance > 0.0 and flag[STEPS] > 0.0:
        error = _error(
            h, physics.mass_kg, physics.radius_m, rows, vector, state.gain, work.triple.ravel(), work.foretold
        )  # fmt: skip
        flag[ADVICE] = h * min(2.0, max(0.25, 0.9 * (physics.tolerance / max(error, 1e-30)) ** (1.0 / 3.0)))
        if error > 2.0 * physics.tolerance and h > 2.0**-_HALVINGS * physics.step_s:
            _copy(work.before, velocity)
            return 1
    if touching:
        keep_contacts(h, theta[0], physics, contacts, less, change, ahead)
        flag[ALOFT] = 0.0
    else:
        if flag[ALOFT] == 0.0:
            drop_contacts(contacts.load_m_s2, contacts.bristle_m, contacts.roll_bristle)
        flag[ALOFT] = 1.0
        if kept:
            now = after[:6]
            _outside_impulse(
                h, physics.mass_kg, gx, gy, gz, state.push_N, state.push_N_m, work.place_m, arm, state.momentum, now
            )  # fmt: skip
            for k in range(6):
                state.momentum[k] = now[k]
    for d in range(size):
        velocity[int(column[d])] += vector[d]
        state.gain[d] = vector[d] / h
    rolled = h * _rolling(work.rotation, mean)
    _bend_on(h, rolled / h, modes, strain, mean, work.strain, strain)
    if physics.stretches:
        strain[3 * modes] += h * mean[6 + 3 * modes]
    _carry_bends(rolled - 0.5 * h * rolling, _rolling(work.rotation, velocity), modes, work.strain, strain, velocity)
    if physics.stretches and strain[3 * modes] < _LEAST_STRETCH:  # squeezed flat: no law of the wall goes further
        strain[3 * modes] = _LEAST_STRETCH
        velocity[6 + 3 * modes] = max(velocity[6 + 3 * modes], 0.0)
    for k in range(3):
        position[k] += h * mean[k]
    _advance_rotation(h, work.rotation[:, 2], mean[3], mean[4], mean[5], state.rotation)
    _carry(work.rotation, state.rotation, velocity)
    still = moving < physics.mass_kg * physics.sleep_speed_m_s**2
    if still and (touching or (gx == 0.0 and gy == 0.0 and gz == 0.0)):
        flag[RESTED] += h
    else:
        flag[RESTED] = 0.0
    flag[STEPS] += 1.0
    return 0


@inner
def _note_kink(strain: FloatArray, mode: FloatArray, softening_m2: float, flag: FloatArray) -> float:
    """The greatest curvature along the tube, and the time of the first kink into the state's flags."""
    greatest = 0.0
    for i in range(mode.shape[1]):
        greatest = max(greatest, _curvature_squared(i, strain, mode))
    if softening_m2 > 0.0 and flag[KINKED] < 0.0 and greatest * 3.0 * softening_m2 > 1.0:
        flag[KINKED] = flag[TIME]
    return np.sqrt(greatest)


@inner
def _elastic_energy(strain: FloatArray, rest: FloatArray, stiffness: FloatArray) -> float:
    total = 0.0
    for a in range(strain.shape[0]):
        off = strain[a] - rest[a]
        for b in range(strain.shape[0]):
            total += 0.5 * off * stiffness[a, b] * (strain[b] - rest[b])
    return total


@inner
def _settle_base(
    base: int, momentum: FloatArray, column: FloatArray, arm: FloatArray, rows: FloatArray, matrix: FloatArray,
    change: FloatArray, rate: FloatArray,
) -> None:  # fmt: skip
    """Let the base move as the momentum asks: its `change`, and `rate` with it. matrix ← factors of its inertia."""
    _base_momentum(base, momentum, column, arm, change)
    for a in range(base):
        change[a] -= _dot(rows[a], rate)
    _gram(_flat(rows), base, matrix, False)
    if not _factor(matrix, base):
        for a in range(base):
            change[a] = 0.0
    _forward(matrix, base, change)
    _backward(matrix, base, change)
    for a in range(base):
        _add_scaled(rate, change[a], rows[a], rate)


@inner
def _mechanical_energy(state: State, physics: Physics, rule: Rule, work: Work) -> float:
    """Kinetic, elastic and gravitational energy of the rod as it is placed, with its rates [J]."""
    missing = 0.0
    if physics.softening_m2 > 0.0:
        for i in range(rule.root_mass.shape[0]):
            bend_squared = _curvature_squared(i, state.strain, rule.mode)
            _, less = _softened(bend_squared, physics.softening_m2, physics.radius_m)
            missing += less * physics.bending_N_m2 * physics.length_m * rule.root_mass[i] ** 2 / physics.mass_kg
    fallen = (
        (state.position_m[0] + work.arm_m[0]) * physics.gravity_x_m_s2
        + (state.position_m[1] + work.arm_m[1]) * physics.gravity_y_m_s2
        + (state.position_m[2] + work.arm_m[2]) * physics.gravity_z_m_s2
    )
    elastic = _elastic_energy(state.strain, state.rest_strain, state.stiffness)
    return 0.5 * _dot(work.rate, work.rate) + elastic - missing - physics.mass_kg * fallen


@inner
def _audit(state: State, physics: Physics, rule: Rule, contacts: Contacts, work: Work, layout: Layout) -> None:
    """Take out of the motion what energy the steps have made.

    Kinetic, elastic and gravitational energy and that of the ground's springs, less the actuators' work, only ever
    falls. Where coarse steps let it rise by more than `_ENERGY_SLACK` of the largest energy so far, velocities are
    scaled down: aloft those of the strains only, for the momentum's sake.
    """
    flag, velocity, base = state.flag, state.velocity, layout.base
    _place(state, physics, rule, work, layout, 0.0)
    _gather(velocity, work.column, work.vector)
    _times(work.rows, layout.columns, work.vector, work.rate)
    rigid = 0.0
    kept = flag[ALOFT] == 1.0 and base > 0
    if kept:
        _settle_base(base, state.momentum, work.column, work.arm_m, work.rows, work.matrix, work.vector, work.rate)
        _base_momentum(base, state.momentum, work.column, work.arm_m, work.vector)
        _forward(work.matrix, base, work.vector)
        for a in range(base):
            rigid += 0.5 * work.vector[a] * work.vector[a]
    kinetic = 0.5 * _dot(work.rate, work.rate)
    energy = _mechanical_energy(state, physics, rule, work) - flag[WORK]
    if flag[ALOFT] == 0.0 and physics.ground > 0:
        energy += ground_energy(state.position_m, physics, contacts, rule.root_mass, work.place_m)
    elastic = _elastic_energy(state.strain, state.rest_strain, state.stiffness)
    excess = energy - flag[CEILING]
    if flag[AUDITED] > 0.0 and excess > 0.0:
        least = rigid if kept else 0.0
        share = max(0.0, 1.0 - excess / max(kinetic - least, 1e-300))
        flag[CREATED] += (1.0 - share) * (kinetic - least)
        for f in range(6 if kept else 0, velocity.shape[0]):
            velocity[f] *= np.sqrt(share)
        energy -= (1.0 - share) * (kinetic - least)
        kinetic = least + share * (kinetic - least)
        flag[CEILING] = max(flag[CEILING], energy)  # what is left is in the walls and the weight
        flag[AUDITED] = _WATCHED_STEPS
    flag[LARGEST] = max(flag[LARGEST], kinetic + elastic)
    reached = energy + _ENERGY_SLACK * flag[LARGEST]
    flag[CEILING] = min(flag[CEILING], reached) if flag[AUDITED] > 0.0 else reached
    flag[AUDITED] = max(flag[AUDITED] - 1.0, 1.0)


@inner
def _write_row(state: State, physics: Physics, rule: Rule, work: Work, layout: Layout, row: FloatArray) -> None:
    """The rod as it is placed now, with its rates, as a row of `sim.motion_rows`."""
    n, base = layout.points, layout.base
    velocity, rows, rate, change, flag = state.velocity, work.rows, work.rate, work.vector, state.flag
    arm, mass = work.arm_m, rule.root_mass
    row[0] = flag[TIME]
    for k in range(3):
        row[1 + k] = state.position_m[k]
        row[19 + k] = state.position_m[k] + arm[k]
        row[16 + k] = velocity[k]
        row[13 + k] = velocity[3 + k]
        for c in range(3):
            row[4 + 3 * k + c] = state.rotation[k, c]
    if flag[ALOFT] == 1.0 and base > 0:
        _settle_base(base, state.momentum, work.column, arm, rows, work.matrix, change, rate)
        for a in range(base):
            f = int(work.column[a])
            row[16 + f if f < 3 else 10 + f] += change[a]
    momentum = work.foretold.ravel()  # free here
    _take_momentum(base, rows, rate, work.column, arm, momentum)
    row[22] = state.strain[3 * layout.modes] if physics.stretches else 1.0
    row[23], row[24] = state.strain[1], -state.strain[0]
    chord = row[25:28]
    size = 0.0
    for k in range(3):
        total = 0.0
        for i in range(n):  # the integral to the end is the Gauss sum
            total += mass[i] ** 2 * work.section[2, k, i]
        if physics.mirrored and k > 0:
            total = 0.0
        chord[k] = total
        size += total * total
    size = np.sqrt(size)
    for k in range(3):
        chord[k] = chord[k] / size if size > 0.0 else state.rotation[k, 2]
        row[28 + k] = momentum[3 + k]
    deepest = 0.0
    row[31] = _mechanical_energy(state, physics, rule, work)
    row[32] = flag[WORK]
    if physics.ground > 0:
        across = 1 - physics.grain
        for spot in range(layout.spots):
            for i in range(n):
                gap, _, _ = profile_gap(
                    physics.ground, physics.ground_a_m, physics.ground_b_m, spot,
                    state.position_m[across] + work.place_m[across, i], state.position_m[2] + work.place_m[2, i],
                    physics.radius_m,
                )  # fmt: skip
                deepest = max(deepest, -gap)
    row[33] = deepest
    row[34] = _note_kink(state.strain, rule.mode, physics.softening_m2, flag)
    row[35] = flag[ASLEEP]


@inner
def _follow_drive(drive: FloatArray, t_s: float, h: float, state: State, physics: Physics, theta: FloatArray) -> bool:
    """Rest curvature for the step of h from t_s; the actuators' work goes into the ledger. False when it is the old."""
    strain, rest, velocity, flag = state.strain, state.rest_strain, state.velocity, state.flag
    _set_theta(h, physics.damping_time_s, state.modal_rate_1_s2, theta)
    # the bend as it will lie at the middle of the step, for the second order
    bend_1, bend_2 = strain[1] + 0.5 * h * velocity[7], -strain[0] - 0.5 * h * velocity[6]
    k1, k2 = rest_curvature(drive, t_s, h, theta[6], bend_1, bend_2, state.lagged_1_m)
    if rest[0] == -k2 and rest[1] == k1:
        return False
    before = _elastic_energy(strain, rest, state.stiffness)
    rest[0], rest[1] = -k2, k1
    flag[WORK] += _elastic_energy(strain, rest, state.stiffness) - before
    flag[RESTED] = flag[ASLEEP] = 0.0
    return True


def _compile(stamp: str):  # type: ignore[no-untyped-def]
    @njit(cache=True, nogil=True, fastmath=FAST_MATH)
    def play(
        memory: FloatArray,
        layout: Layout,
        physics: Physics,
        drive: FloatArray,
        samples: int,
        steps: int,
        out: FloatArray,
    ) -> int:
        """Advance a rod by samples × steps steps; a row of `out` after each sample. Returns the samples done.

        memory: as `rod_memory.carve` lays it out. drive: as `rod_drive` lays it out. out: (samples, ROW_SIZE), or
        (0, ROW_SIZE) for none. steps = 0 only looks at the rod as it is.
        """
        state, rule, contacts, work, _ = carve(memory, layout)
        going = len(stamp) > 0
        macro = physics.step_s
        flag = state.flag
        pushed = _dot(state.push_N, state.push_N) + _dot(state.push_N_m, state.push_N_m) > 0.0
        if pushed:  # the work of these is in no ledger
            flag[AUDITED] = 0.0
        quiet_s = quiet_until_s(drive) - 2.0 * macro  # a straight tube that sleeps has nothing to look at until then
        if drive[0] > 0.0 and (state.rest_strain[0] != 0.0 or state.rest_strain[1] != 0.0):
            quiet_s = -1.0
        if physics.stretches and not state.rest_strain[3 * layout.modes] > 0.0:
            return 0
        for sample in range(samples):
            for _ in range(steps):
                if flag[ASLEEP] > 0.0 and flag[TIME] < quiet_s:
                    flag[TIME] += macro
                    continue
                if flag[ASLEEP] > 0.0:
                    lagged_1, lagged_2 = state.lagged_1_m[0], state.lagged_1_m[1]
                    if drive[0] == 0.0 or not _follow_drive(drive, flag[TIME], macro, state, physics, work.theta):
                        flag[TIME] += macro
                        continue
                    # nothing is known yet of what it wakes to
                    state.lagged_1_m[0], state.lagged_1_m[1] = lagged_1, lagged_2
                    flag[ADVICE], flag[AUDITED] = _WAKING * macro, 1.0 / _WAKING
                done = 0.0
                while done < macro:
                    h = macro - done
                    if flag[AUDITED] > 1.0:  # this step makes energy
                        h = min(h, 0.5 * macro)
                    longest = min(flag[ADVICE], growing_step_s(drive, flag[TIME] + done))
                    if longest < h:
                        h /= np.ceil(h / longest - 1e-9)
                    solves = flag[SOLVES]
                    lagged_1, lagged_2 = state.lagged_1_m[0], state.lagged_1_m[1]
                    if drive[0] > 0.0:
                        _follow_drive(drive, flag[TIME] + done, h, state, physics, work.theta)
                    verdict = _step(h, state, physics, rule, contacts, work, layout)
                    if verdict == 0:
                        troubled = h < macro or flag[SOLVES] > solves + _EASY_SOLVES or flag[AUDITED] > 1.0
                        if not pushed and (troubled or flag[STEPS] % _AUDIT_STEPS == 1.0):
                            _audit(state, physics, rule, contacts, work, layout)
                        done = macro if h >= (macro - done) * (1.0 - 1e-12) else done + h
                    else:
                        state.lagged_1_m[0], state.lagged_1_m[1] = lagged_1, lagged_2
                        flag[ADVICE] = 0.5 * h
                        if flag[ADVICE] < 2.0**-_HALVINGS * macro:
                            going = False
                            break
                if not going:
                    break
                flag[TIME] += macro
                if physics.softening_m2 > 0.0:
                    _note_kink(state.strain, rule.mode, physics.softening_m2, flag)
                if flag[RESTED] > _REST_TIME_S:
                    flag[ASLEEP] = 1.0
                    for f in range(state.velocity.shape[0]):
                        state.velocity[f] = 0.0
            if not going:
                return sample
            if out.shape[0] > 0:
                if flag[ASLEEP] > 0.0 and sample > 0 and out[sample - 1, 35] > 0.0:
                    for k in range(ROW_SIZE):
                        out[sample, k] = out[sample - 1, k]
                    out[sample, 0] = flag[TIME]
                else:
                    _place(state, physics, rule, work, layout, 0.0)
                    _gather(state.velocity, work.column, work.vector)
                    _times(work.rows, layout.columns, work.vector, work.rate)
                    _write_row(state, physics, rule, work, layout, out[sample])
        return samples

    return play


play = _compile(source_stamp())
