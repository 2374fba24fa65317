"""The rod on the floor, as rows of the implicit step (`sim.rod_kernel`).

The floor is z = 0. A point of the tube touches with the lowest point of a sphere of radius R. Per unit mass, so
that everything scales: normal spring and damper, Coulomb friction −µ a_n v/√(v² + v_ε²) with v⁺ in the numerator and
the last step's normal load and sliding speed in the factor (a linear damper in each step: it never overshoots).
"""

from __future__ import annotations

import numpy as np

from sim.rod_compile import inner
from sim.rod_memory import Physics, State, Work
from sim.rod_rule import Rule


@inner
def contact_rows(state: State, physics: Physics, rule: Rule, work: Work) -> bool:
    """Rows of contact: normal spring and damper, friction along x and y. False when nothing touches."""
    rows, rate, r, n = work.rows, work.rate, work.place_m, rule.outward.shape[0]
    h, radius = physics.step_s, physics.radius_m
    stiffness, damping = physics.contact_stiffness_1_s2, physics.contact_damping_1_s
    touching = False
    normal, slide = work.grip[0], work.grip[1]
    w = state.velocity
    spin = np.sqrt(w[3] ** 2 + w[4] ** 2 + w[5] ** 2)
    regular = max(physics.regular_speed * spin * radius, physics.least_speed_m_s)
    for i in range(n):
        root = rule.root_mass[i]
        vx = (rate[i] - 2.0 * rate[4 * n + i]) / root  # of the lowest point
        vy = (rate[n + i] + 2.0 * rate[3 * n + i]) / root
        vz = rate[2 * n + i] / root
        # the rod is placed half a step on; the implicit spring wants the gap at the step's start
        gap = state.position_m[2] + 0.5 * h * w[2] + r[2, i] - radius - 0.5 * h * vz
        work.gap_m[i] = gap
        normal[i] = slide[i] = 0.0
        rate[7 * n + i] = rate[8 * n + i] = rate[9 * n + i] = 0.0
        # where it would fall to by the end of the step is below the floor, and the floor would not have to pull
        falling = vz - h * physics.gravity_m_s2
        if gap + h * falling < 0.0 and stiffness * (gap + h * falling) + damping * falling < 0.0:
            touching = True
            weight = np.sqrt(h * (damping + h * stiffness))
            normal[i] = weight
            rate[7 * n + i] = -h * stiffness * root * gap / weight
        if physics.viscous:
            if gap < 0.05 * radius:
                touching = True
                slide[i] = np.sqrt(h * physics.friction)
        elif normal[i] > 0.0:
            speed = np.sqrt(vx * vx + vy * vy + regular * regular)
            slide[i] = np.sqrt(h * physics.friction * state.load_m_s2[i] / speed)
    if touching:
        for d in range(rows.shape[0]):
            for i in range(n):
                rows[d, 7 * n + i] = normal[i] * rows[d, 2 * n + i]
                rows[d, 8 * n + i] = slide[i] * (rows[d, i] - 2.0 * rows[d, 4 * n + i])
                rows[d, 9 * n + i] = slide[i] * (rows[d, n + i] + 2.0 * rows[d, 3 * n + i])
    return touching


@inner
def contact_loads(touching: bool, state: State, physics: Physics, rule: Rule, work: Work) -> None:
    """Normal loads at the end of the step, from the new velocities in work.vector."""
    n, h = rule.outward.shape[0], physics.step_s
    stiffness, damping = physics.contact_stiffness_1_s2, physics.contact_damping_1_s
    load = state.load_m_s2
    for i in range(n):
        load[i] = 0.0
    if not touching:
        return
    for d in range(work.rows.shape[0]):
        speed = work.vector[d]
        for i in range(n):
            load[i] += speed * work.rows[d, 2 * n + i]
    for i in range(n):
        if work.grip[0, i] > 0.0:
            vz = load[i] / rule.root_mass[i]
            load[i] = max(0.0, -stiffness * work.gap_m[i] - (damping + h * stiffness) * vz)
        else:
            load[i] = 0.0
