"""Kinematics, inertia and the implicit step of the reduced-order rod (plain arrays, compiled, no allocation).

The rod: a Kirchhoff tube, base pose (x, Q0) at its mid cross-section, rotation per reference length w = (−k2, k1,
twist) in the section's axes as a sum of Legendre modes, and (where it stretches) one uniform stretch ℓ:

    Q' = Q [w]×,   r' = ℓ t,   t = Q e3           by a Magnus step between points, by spectral integration
    ω' = Q ẇ,      v' = ℓ̇ t + ℓ ω × t            so the velocities are linear in u = (ẋ, ω0, modes' rates, ℓ̇),

all in world axes, relative to the middle. With A_m = ∫Q P_m ds and B_m = ∫P_m r × Q ds a mode's columns are
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
from sim.rod_contact import contact_rows, contradicted, drop_contacts, find_contacts, keep_contacts
from sim.rod_drive import rest_curvature
from sim.rod_ground import profile_gap
from sim.rod_memory import INERTIA_ROWS, Layout, Physics, State, Work, carve
from sim.rod_rule import Rule

FloatArray = NDArray[np.float64]

_SMALLEST_PIVOT = 1e-300
_LARGEST_SPEED = 1e8  # m/s, rad/s, rad/(m s): beyond, the state means nothing
_RESOLVED = 10.0  # of a coordinate's natural angle a step: θ is half-way between ½ and 1 there
_PASSES = 4  # of one step, at most
_AGAIN = 1e-4  # b is taken again when its change is more than this share of the velocity
_LARGEST_TURN = 1.0  # rad in a step, of the base or from end to end
_LARGEST_STRETCH = 0.3  # in a step
_HALVINGS = 14
_AFTER_KINK = 0.02  # bending stiffness beyond the kink over that of the straight tube: keeps the tube finite
_REST_TIME_S = 0.1

ALOFT, RESTED, TIME, WORK, ADVICE, KINKED, STEPS, ASLEEP, SOLVES = range(9)


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


@inlined
def _place(state: State, physics: Physics, rule: Rule, work: Work, layout: Layout, ahead_s: float) -> None:
    """Place the rod where its velocity takes it in `ahead_s`, and fill the rows of G."""
    axes = work.section.shape[0]  # not written as 3: the compiler would unroll every loop, for longer than it saves
    strain, section, r, rows = work.strain, work.section, work.place_m, work.rows
    velocity = state.velocity
    for a in range(strain.shape[0]):
        strain[a] = state.strain[a] + ahead_s * velocity[6 + a]
    for k in range(axes):
        for c in range(axes):
            work.rotation[k, c] = state.rotation[k, c]
    if ahead_s != 0.0:
        _turn_by(ahead_s * velocity[3], ahead_s * velocity[4], ahead_s * velocity[5], work.rotation)
    n, modes, half, base, columns = layout.points, layout.modes, layout.half, layout.base, layout.columns
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
def _rates(state: State, work: Work, layout: Layout) -> None:
    """rate ← G u."""
    for d in range(layout.columns):
        work.vector[d] = state.velocity[int(work.column[d])]
    _times(work.rows, layout.columns, work.vector, work.rate)


@inner
def _take_momentum(work: Work, layout: Layout, momentum: FloatArray) -> None:
    """The momentum about the centre of mass of a rod that moves as `rate` says, shape (6,)."""
    arm = work.arm_m
    for k in range(6):
        momentum[k] = 0.0
    for d in range(layout.base):
        momentum[int(work.column[d])] = _dot(work.rows[d], work.rate)
    momentum[3] -= arm[1] * momentum[2] - arm[2] * momentum[1]
    momentum[4] -= arm[2] * momentum[0] - arm[0] * momentum[2]
    momentum[5] -= arm[0] * momentum[1] - arm[1] * momentum[0]


@inner
def _base_momentum(momentum: FloatArray, work: Work, layout: Layout, out: FloatArray) -> None:
    """Linear momentum, and angular about the middle of the tube, from that about its centre of mass."""
    arm = work.arm_m
    for d in range(layout.base):
        f = int(work.column[d])
        value = momentum[f]
        if f >= 3:
            k1, k2 = (f + 1) % 3, (f + 2) % 3
            value += arm[k1] * momentum[k2] - arm[k2] * momentum[k1]
        out[d] = value


@inner
def _accelerations(
    h: float,
    velocity: FloatArray,
    rate: FloatArray,
    state: State,
    physics: Physics,
    rule: Rule,
    work: Work,
    layout: Layout,
) -> float:
    """bias ← −h b + h (gravity and outside forces); returns |h b|² without these."""
    section, bias, triple = work.section, work.bias, work.triple
    modes, n = layout.modes, layout.points
    bend = 0.5 * physics.radius_m
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
        scale = rule.inverse_root[i] / bend
        ox, oy, oz = scale * rate[3, i], scale * rate[4, i], scale * rate[5, i]
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
    # the velocities that strains carry stand for the time (1 − θ)h after the middle of the step (u̇ = −Gᵀb, steadily)
    _add_scaled(work.rate, work.theta[6] - 1.0, bias, work.ahead)
    size = _dot(bias, bias)
    for i in range(n):
        root, less = h * rule.root_mass[i], h * rule.inverse_root[i]
        bias[0, i] += root * physics.gravity_x_m_s2 + less * state.push_N[i, 0]
        bias[1, i] += root * physics.gravity_y_m_s2 + less * state.push_N[i, 1]
        bias[2, i] += root * physics.gravity_z_m_s2 + less * state.push_N[i, 2]
    return size


@inner
def _set_theta(h: float, state: State, physics: Physics, work: Work) -> None:
    """θ of each coordinate for steps of h."""
    size = state.velocity.shape[0]
    if work.theta[size] == h:
        return
    work.theta[size] = h
    for f in range(size):
        square = state.modal_rate_1_s2[f]
        angle = h * h * square
        if f >= 6:
            angle += (h * physics.damping_time_s * square) ** 2
        work.theta[f] = 0.5 + 0.5 * angle / (_RESOLVED * _RESOLVED + angle)


@inner
def _softened(bend_squared: float, physics: Physics) -> tuple[float, float]:
    """1 − (passive moment over EIκ), and the elastic energy that is missing over EI, of a section that ovalises."""
    a = physics.softening_m2
    kink_squared = 1.0 / (3.0 * a)
    if bend_squared <= kink_squared:
        return a * bend_squared, 0.25 * a * bend_squared * bend_squared
    kink, bend = np.sqrt(kink_squared), np.sqrt(bend_squared)
    beyond = bend - kink
    moment = kink * 2.0 / 3.0 + _AFTER_KINK * beyond
    energy = 5.0 / 12.0 * kink_squared + beyond * (kink * 2.0 / 3.0 + 0.5 * _AFTER_KINK * beyond)
    return 1.0 - moment / bend, 0.5 * bend_squared - energy


@inner
def _elastic_forces(h: float, state: State, physics: Physics, rule: Rule, work: Work, layout: Layout) -> None:
    """Add strain, damping and what ovalisation takes off them to the equations."""
    base, columns, modes = layout.base, layout.columns, layout.modes
    matrix, vector, theta = work.matrix, work.vector, work.theta
    tau = physics.damping_time_s
    for a in range(base, columns):
        f = int(work.column[a])
        weight = np.sqrt(h * theta[f] * (tau + h * theta[f]))
        total = 0.0
        for s in range(state.strain.shape[0]):
            k = state.stiffness[f - 6, s]
            if k != 0.0:
                reach = theta[6 + s] * h + tau
                total += k * (state.strain[s] - state.rest_strain[s] + reach * state.velocity[6 + s])
        vector[a] -= h * total
        for b in range(base, a + 1):
            g = int(work.column[b])
            k = state.stiffness[f - 6, g - 6]
            if k != 0.0:
                matrix[a, b] += k * weight * np.sqrt(h * theta[g] * (tau + h * theta[g]))
    if physics.softening_m2 > 0.0:
        n = layout.points
        first, second = work.triple[0, 0], work.triple[0, 1]
        for i in range(n):
            x = y = 0.0
            for m in range(modes):
                p = rule.mode[m, i] * rule.outward[i]
                x += p * work.strain[3 * m]
                y += p * work.strain[3 * m + 1]
            less, _ = _softened(x * x + y * y, physics)
            share = less * physics.bending_N_m2 * physics.length_m * rule.root_mass[i] ** 2 / physics.mass_kg
            first[i], second[i] = share * x, share * y
        for a in range(base, columns):
            f = int(work.column[a]) - 6
            if f < 3 * modes and f % 3 < 2:
                total = 0.0
                for i in range(n):
                    total += rule.mode[f // 3, i] * rule.outward[i] * (first[i] if f % 3 == 0 else second[i])
                vector[a] += h * total


@inner
def _base_that_keeps_momentum(h: float, state: State, physics: Physics, work: Work, layout: Layout) -> None:
    """work.mean of the base from the momentum at the middle of the step, with the factors of the equations."""
    base, columns, matrix, vector = layout.base, layout.columns, work.matrix, work.vector
    gained, now = work.change.ravel(), work.bias.ravel()  # free at this point
    for k in range(6):
        now[k] = state.momentum[k]
    _outside_impulse(0.5 * h, state, physics, work, layout, now)
    _base_momentum(now, work, layout, gained)
    _forward(matrix, base, gained)
    for a in range(base, columns):
        speed = work.mean[int(work.column[a])]
        for b in range(base):
            gained[b] -= matrix[a, b] * speed
    _backward(matrix, base, gained)
    for d in range(base):
        work.mean[int(work.column[d])] = gained[d]
    _outside_impulse(h, state, physics, work, layout, state.momentum)
    for d in range(base):  # an estimate for the end of the step
        f = int(work.column[d])
        vector[d] = gained[d] + (1.0 - work.theta[f]) * vector[d] - state.velocity[f]


@inner
def _outside_impulse(
    span_s: float, state: State, physics: Physics, work: Work, layout: Layout, momentum: FloatArray
) -> None:
    """Add what gravity and outside forces give in `span_s`."""
    momentum[0] += span_s * physics.mass_kg * physics.gravity_x_m_s2
    momentum[1] += span_s * physics.mass_kg * physics.gravity_y_m_s2
    momentum[2] += span_s * physics.mass_kg * physics.gravity_z_m_s2
    for i in range(layout.points):
        fx, fy, fz = state.push_N[i, 0], state.push_N[i, 1], state.push_N[i, 2]
        if fx != 0.0 or fy != 0.0 or fz != 0.0:
            x, y, z = (
                work.place_m[0, i] - work.arm_m[0],
                work.place_m[1, i] - work.arm_m[1],
                work.place_m[2, i] - work.arm_m[2],
            )
            momentum[0] += span_s * fx
            momentum[1] += span_s * fy
            momentum[2] += span_s * fz
            momentum[3] += span_s * (y * fz - z * fy)
            momentum[4] += span_s * (z * fx - x * fz)
            momentum[5] += span_s * (x * fy - y * fx)


@inner
def _trusted(h: float, state: State, physics: Physics, work: Work, layout: Layout) -> int:
    """0: the step may stand; 1: it turns, bends or stretches the rod too far; 2: it is not finite."""
    mean = work.mean
    for d in range(layout.columns):
        if not (abs(work.vector[d]) < _LARGEST_SPEED and abs(mean[int(work.column[d])]) < _LARGEST_SPEED):
            return 2
    turn = h * np.sqrt(mean[3] ** 2 + mean[4] ** 2 + mean[5] ** 2)
    bend = 0.0
    for a in range(3 * layout.modes):
        bend += abs(mean[6 + a])
    if turn > _LARGEST_TURN or h * physics.length_m * bend > _LARGEST_TURN:
        return 1
    if physics.stretches:
        stretch = state.strain[3 * layout.modes]
        after = stretch + h * mean[6 + 3 * layout.modes]
        if abs(after - stretch) > _LARGEST_STRETCH * stretch:
            return 1
    return 0


@inner
def _error(h: float, physics: Physics, state: State, work: Work, layout: Layout) -> float:
    """Estimate of the step's error over the radius: h³ü/12 as a root mean square of the tube's points."""
    for d in range(layout.columns):
        work.vector[d] = work.vector[d] / h - state.gain[d]
    _times(work.rows, layout.columns, work.vector, work.bias)
    total = _dot(work.bias, work.bias)
    for d in range(layout.columns):
        work.vector[d] = (work.vector[d] + state.gain[d]) * h
    return h * h / 12.0 * np.sqrt(total / physics.mass_kg) / physics.radius_m


@inlined
def _step(h: float, state: State, physics: Physics, rule: Rule, work: Work, layout: Layout) -> int:
    """One step of h, or none: 0: done; 1: too coarse, nothing changed; 2: not finite, nothing changed."""
    size, base = layout.columns, layout.base
    strain, velocity, position = state.strain, state.velocity, state.position_m
    matrix, vector, mean = work.matrix, work.vector, work.mean
    _set_theta(h, state, physics, work)
    _place(state, physics, rule, work, layout, 0.5 * h)
    _rates(state, work, layout)
    for d in range(size):
        f = int(work.column[d])
        mean[f] = velocity[f] + 0.5 * h * state.gain[d]
        vector[d] = mean[f]
    _times(work.rows, size, vector, work.foretold)
    twisting = _accelerations(h, mean, work.foretold, state, physics, rule, work, layout)
    touching = False
    if physics.ground > 0:
        touching = find_contacts(h, state, physics, rule, work, layout)
    _gram(_flat(work.rows), size, work.inertia, False)
    kept = base > 0 and not touching
    if kept and state.flag[ALOFT] == 0.0:
        _take_momentum(work, layout, state.momentum)
    gravity = abs(physics.gravity_x_m_s2) + abs(physics.gravity_y_m_s2) + abs(physics.gravity_z_m_s2)
    moving = _dot(work.rate, work.rate)
    again = True
    for sweep in range(_PASSES):
        state.flag[SOLVES] += 1.0
        if touching:
            contact_rows(h, state, physics, rule, work, layout)
        for a in range(size):
            vector[a] = _dot(work.rows[a], work.bias)
            if touching:
                vector[a] += _dot(work.contact[a], work.drive)
            for b in range(a + 1):
                matrix[a, b] = work.inertia[a, b]
        if touching:
            _gram(_flat(work.contact), size, matrix, True)
        _elastic_forces(h, state, physics, rule, work, layout)
        if not _factor(matrix, size):
            return 2
        _forward(matrix, size, vector)
        _backward(matrix, size, vector)
        for d in range(size):
            f = int(work.column[d])
            mean[f] = velocity[f] + work.theta[f] * vector[d]
        _times(work.rows, size, vector, work.change)
        if sweep == _PASSES - 1:
            break
        repeat = False
        if physics.ground > 0:
            repeat = contradicted(h, state, physics, rule, work, layout)
            touching = touching or repeat
            kept = base > 0 and not touching
        if again:
            missed = _missed(work.rate, work.change, work.foretold)
            # b goes with the square of the velocity: its change is 2 |b| |what u was missed by| / |u|
            if 4.0 * twisting * missed > _AGAIN * _AGAIN * moving * (moving + physics.mass_kg * (h * gravity) ** 2):
                repeat = True
                again = False
                _add_scaled(work.rate, 0.5, work.change, work.foretold)
                _accelerations(h, mean, work.foretold, state, physics, rule, work, layout)
        if not repeat:
            break
    if kept:
        _base_that_keeps_momentum(h, state, physics, work, layout)
    verdict = _trusted(h, state, physics, work, layout)
    if verdict > 0:
        if kept:
            _outside_impulse(-h, state, physics, work, layout, state.momentum)
        return verdict
    if physics.tolerance > 0.0 and state.flag[STEPS] > 0.0:
        error = _error(h, physics, state, work, layout)
        state.flag[ADVICE] = h * min(2.0, max(0.25, 0.9 * (physics.tolerance / max(error, 1e-30)) ** (1.0 / 3.0)))
        if error > 2.0 * physics.tolerance and h > 2.0**-_HALVINGS * physics.step_s:
            if kept:
                _outside_impulse(-h, state, physics, work, layout, state.momentum)
            return 1
    else:
        state.flag[ADVICE] = 2.0 * h
    if touching:
        keep_contacts(h, state, physics, rule, work, layout)
        state.flag[ALOFT] = 0.0
    else:
        drop_contacts(state)
        state.flag[ALOFT] = 1.0
    for d in range(size):
        velocity[int(work.column[d])] += vector[d]
        state.gain[d] = vector[d] / h
    for a in range(strain.shape[0]):
        strain[a] += h * mean[6 + a]
    for k in range(3):
        position[k] += h * mean[k]
    _turn_by(h * mean[3], h * mean[4], h * mean[5], state.rotation)
    if moving < physics.mass_kg * physics.sleep_speed_m_s**2 and (
        touching or (physics.gravity_x_m_s2 == 0.0 and physics.gravity_y_m_s2 == 0.0 and physics.gravity_z_m_s2 == 0.0)
    ):
        state.flag[RESTED] += h
    else:
        state.flag[RESTED] = 0.0
    state.flag[STEPS] += 1.0
    return 0


@inner
def _note_kink(state: State, physics: Physics, rule: Rule, layout: Layout) -> float:
    """The greatest curvature along the tube, and the time of the first kink into the state."""
    greatest = 0.0
    for i in range(layout.points):
        x = y = 0.0
        for m in range(layout.modes):
            p = rule.mode[m, i] * rule.outward[i]
            x += p * state.strain[3 * m]
            y += p * state.strain[3 * m + 1]
        greatest = max(greatest, x * x + y * y)
    if physics.softening_m2 > 0.0 and state.flag[KINKED] < 0.0 and greatest * 3.0 * physics.softening_m2 > 1.0:
        state.flag[KINKED] = state.flag[TIME]
    return np.sqrt(greatest)


@inner
def _elastic_energy(state: State) -> float:
    total = 0.0
    for a in range(state.strain.shape[0]):
        off = state.strain[a] - state.rest_strain[a]
        for b in range(state.strain.shape[0]):
            total += 0.5 * off * state.stiffness[a, b] * (state.strain[b] - state.rest_strain[b])
    return total


@inner
def _write_row(state: State, physics: Physics, rule: Rule, work: Work, layout: Layout, row: FloatArray) -> None:
    """The rod as it is placed now, with its rates, as a row of `sim.motion_rows`."""
    n, half = layout.points, layout.half
    velocity, rows, rate, change = state.velocity, work.rows, work.rate, work.vector
    stretch = state.strain[3 * layout.modes] if physics.stretches else 1.0
    row[0] = state.flag[TIME]
    for k in range(3):
        row[1 + k] = state.position_m[k]
        row[19 + k] = state.position_m[k] + work.arm_m[k]
        row[16 + k] = velocity[k]
        row[13 + k] = velocity[3 + k]
        for c in range(3):
            row[4 + 3 * k + c] = state.rotation[k, c]
    if state.flag[ALOFT] == 1.0 and layout.base > 0:  # the base moves as the momentum asks
        _base_momentum(state.momentum, work, layout, change)
        for a in range(layout.base):
            change[a] -= _dot(rows[a], rate)
        _gram(_flat(rows), layout.base, work.matrix, False)
        if _factor(work.matrix, layout.base):
            _forward(work.matrix, layout.base, change)
            _backward(work.matrix, layout.base, change)
            for a in range(layout.base):
                f = int(work.column[a])
                row[16 + f if f < 3 else 10 + f] += change[a]
                _add_scaled(rate, change[a], rows[a], rate)
    momentum = work.foretold.ravel()  # free here
    _take_momentum(work, layout, momentum)
    row[22] = stretch
    row[23], row[24] = state.strain[1], -state.strain[0]
    chord = row[25:28]
    size = 0.0
    for k in range(3):
        total = 0.0
        for i in range(n):  # the integral to the end is the Gauss sum
            total += rule.root_mass[i] ** 2 * work.section[2, k, i]
        if physics.mirrored and k > 0:
            total = 0.0
        chord[k] = total
        size += total * total
    size = np.sqrt(size)
    for k in range(3):
        chord[k] = chord[k] / size if size > 0.0 else state.rotation[k, 2]
    for k in range(3):
        row[28 + k] = momentum[3 + k]
    kinetic, height = 0.5 * _dot(rate, rate), 0.0
    height += (state.position_m[0] + work.arm_m[0]) * physics.gravity_x_m_s2
    height += (state.position_m[1] + work.arm_m[1]) * physics.gravity_y_m_s2
    height += (state.position_m[2] + work.arm_m[2]) * physics.gravity_z_m_s2
    missing = 0.0
    if physics.softening_m2 > 0.0:
        for i in range(n):
            x = y = 0.0
            for m in range(layout.modes):
                p = rule.mode[m, i] * rule.outward[i]
                x += p * state.strain[3 * m]
                y += p * state.strain[3 * m + 1]
            _, less = _softened(x * x + y * y, physics)
            missing += less * physics.bending_N_m2 * physics.length_m * rule.root_mass[i] ** 2 / physics.mass_kg
    row[31] = kinetic + _elastic_energy(state) - missing - physics.mass_kg * height
    row[32] = state.flag[WORK]
    deepest = 0.0
    if physics.ground > 0:
        across = 1 - physics.grain
        for spot in range(layout.spots):
            for i in range(n):
                gap, _, _ = profile_gap(
                    physics.ground,
                    physics.ground_a_m,
                    physics.ground_b_m,
                    spot,
                    state.position_m[across] + work.place_m[across, i],
                    state.position_m[2] + work.place_m[2, i],
                    physics.radius_m,
                )
                deepest = max(deepest, -gap)
    row[33] = deepest
    row[34] = _note_kink(state, physics, rule, layout)
    row[35] = state.flag[ASLEEP]


@inner
def _change_rest(k1: float, k2: float, state: State) -> bool:
    """New rest curvature; the actuators' work goes into the ledger. False when it is the old one."""
    if state.rest_strain[0] == -k2 and state.rest_strain[1] == k1:
        return False
    before = _elastic_energy(state)
    state.rest_strain[0], state.rest_strain[1] = -k2, k1
    state.flag[WORK] += _elastic_energy(state) - before
    return True


def _compile(stamp: str):  # type: ignore[no-untyped-def]
    @njit(cache=True, fastmath=FAST_MATH)
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
        state, rule, work, _ = carve(memory, layout)
        going = len(stamp) > 0
        macro = physics.step_s
        flag = state.flag
        for sample in range(samples):
            for _ in range(steps):
                _set_theta(macro, state, physics, work)
                if drive[0] > 0.0:
                    k1, k2 = rest_curvature(drive, flag[TIME], macro, work.theta[6], state.strain, state.lagged_1_m)
                    if _change_rest(k1, k2, state):
                        flag[RESTED] = flag[ASLEEP] = 0.0
                if flag[ASLEEP] > 0.0:
                    flag[TIME] += macro
                    continue
                done = 0.0
                while done < macro:
                    h = macro - done
                    if flag[ADVICE] < h:
                        h /= np.ceil(h / flag[ADVICE] - 1e-9)
                    verdict = _step(h, state, physics, rule, work, layout)
                    if verdict == 0:
                        done = macro if h >= (macro - done) * (1.0 - 1e-12) else done + h
                    else:
                        flag[ADVICE] = 0.5 * h
                        if flag[ADVICE] < 2.0**-_HALVINGS * macro:
                            going = False
                            break
                if not going:
                    break
                flag[TIME] += macro
                if physics.softening_m2 > 0.0:
                    _note_kink(state, physics, rule, layout)
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
                    _rates(state, work, layout)
                    _write_row(state, physics, rule, work, layout, out[sample])
        return samples

    return play


play = _compile(source_stamp())
