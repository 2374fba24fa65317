"""Where the points of the rod are and how they move with each coordinate, from its strains and its middle's pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.rod_algebra import copy_into, integrate_rows, integrate_three
from sim.rod_compile import apart, inner
from sim.rod_memory import Layout, Physics, State, Work
from sim.rod_rotation import advance_rotation, bend_on, roll_rate
from sim.rod_rule import Rule
from sim.rod_views import flat

FloatArray = NDArray[np.float64]


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


@apart
def place_rod(state: State, physics: Physics, rule: Rule, work: Work, layout: Layout, ahead_s: float) -> None:
    """Place the rod where its velocity takes it in `ahead_s`, and fill the rows of G."""
    axes = work.section.shape[0]  # not written as 3: the compiler would unroll every loop, for longer than it saves
    strain, section, r, rows = work.strain, work.section, work.place_m, work.rows
    velocity = state.velocity
    n, modes, base, columns = layout.points, layout.modes, layout.base, layout.columns
    if ahead_s == 0.0:
        copy_into(state.strain, strain)
    else:
        bend_on(ahead_s, roll_rate(state.rotation, velocity), modes, state.strain, velocity, state.strain, strain)
        if physics.stretches:
            strain[3 * modes] = state.strain[3 * modes] + ahead_s * velocity[6 + 3 * modes]
    for k in range(axes):
        for c in range(axes):
            work.rotation[k, c] = state.rotation[k, c]
    if ahead_s != 0.0:
        advance_rotation(ahead_s, state.rotation[:, 2], velocity[3], velocity[4], velocity[5], work.rotation)
    stretch = strain[3 * modes] if physics.stretches else 1.0
    _place_sections(strain, work.rotation, rule, section)
    scratch = work.triple[0]
    for k in range(axes):
        for i in range(n):
            scratch[k, i] = stretch * rule.outward[i] * section[2, k, i]
    integrate_three(scratch, rule.integral, r)
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
    first, last = base * 6 * n, (base + bends) * 6 * n
    integrate_rows(flat(density)[first:last], rule.integral, flat(swept)[first:last])

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
