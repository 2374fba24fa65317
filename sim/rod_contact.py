"""Contact of the rod with the ground, as rows of the implicit step (`sim.rod_kernel`).

A point of the tube touches with a sphere of radius R about it. Per unit mass, so that everything scales:

    normal     N = max(0, −k g⁺ − c v⁺): spring and damper at the end of the step
    friction   F = −s (k ξ + (hk + c) w⁺), |F| ≤ µN by the share s of sticking; ξ: the bristle, how far the contact has
               slid elastically: at rest it holds for ever, sliding steadily it lies along the slip with |kξ| = µN,
               which is Coulomb's law without a regularising speed
    or viscous F = −c w⁺ wherever the tube is near the ground
    rolling    the same as friction for the turning about the tangent, against a threshold moment

w: sliding velocity along the grain and across. Every force is linear in the velocity gained in the step, given which
contacts carry load and their s: from what the last step foretells, and once more where the solution contradicts it.
"""

from __future__ import annotations

import numpy as np

from sim.rod_compile import inner
from sim.rod_ground import PLANE, profile_gap
from sim.rod_memory import Layout, Physics, State, Work
from sim.rod_rule import Rule

_NEAR = 0.05  # of the radius: viscous friction acts below this gap
_ROLL_BRISTLE = 0.01  # rad: rolling gives way elastically by this much before it starts
_LOAD_SLACK = 0.02  # of gravity: a load on the wrong side by less is left to the next step
_FRICTION_SLACK = 0.05  # of the limit
_LEAST_GRAVITY_M_S2 = 1.0


@inner
def _hand(physics: Physics) -> float:
    """n × grain has this times (n_z, −n_a) along a and z."""
    return 1.0 if physics.grain == 0 else -1.0


@inner
def find_contacts(h: float, state: State, physics: Physics, rule: Rule, work: Work, layout: Layout) -> bool:
    """Gaps, normals and velocities of the contacts, and which of them will carry load. False: none."""
    n, grain = layout.points, physics.grain
    across, hand = 1 - grain, _hand(physics)
    theta, k, c = work.theta[0], physics.contact_stiffness_1_s2, physics.contact_damping_1_s
    middle_a = state.position_m[across] + 0.5 * h * state.velocity[across]
    middle_z = state.position_m[2] + 0.5 * h * state.velocity[2]
    along_a, along_z, less = work.place_m[across], work.place_m[2], rule.inverse_root
    fall_a = physics.gravity_y_m_s2 if grain == 0 else physics.gravity_x_m_s2
    fall_z = physics.gravity_z_m_s2
    touching = 0.0
    for spot in range(layout.spots):
        gap, na, nz = work.gap_m[spot], work.normal[0, spot], work.normal[1, spot]
        if physics.ground == PLANE:
            for i in range(n):
                gap[i] = middle_z + along_z[i] - physics.radius_m
                na[i] = 0.0
                nz[i] = 1.0
        else:
            for i in range(n):
                gap[i], na[i], nz[i] = profile_gap(
                    physics.ground,
                    physics.ground_a_m,
                    physics.ground_b_m,
                    spot,
                    middle_a + along_a[i],
                    middle_z + along_z[i],
                    physics.radius_m,
                )
        # the rod is placed half a step on: from there back to the step's start, and on to its end as it moves now
        va, vz = work.rate[across], work.rate[2]
        end_a, end_z = work.ahead[across], work.ahead[2]
        push_a, push_z = work.bias[across], work.bias[2]
        speed, carries = work.approach[0, spot], work.grip[0, spot]
        for i in range(n):
            now = (na[i] * va[i] + nz[i] * vz[i]) * less[i]
            curved = (na[i] * push_a[i] + nz[i] * push_z[i]) * less[i] - h * (na[i] * fall_a + nz[i] * fall_z)
            gap[i] += 0.5 * h * now - 0.125 * h * curved
            speed[i] = (na[i] * end_a[i] + nz[i] * end_z[i]) * less[i]
        for i in range(n):
            falling = h * (na[i] * fall_a + nz[i] * fall_z)
            load = -k * (gap[i] + h * theta * falling) - c * (speed[i] + falling)
            carries[i] = 1.0 if load > 0.0 else 0.0
            touching += carries[i]
        end_g, turn_a, turn_z, turn_g = work.ahead[grain], work.ahead[3 + across], work.ahead[5], work.ahead[3 + grain]
        along, sideways = work.approach[1, spot], work.approach[2, spot]
        for i in range(n):  # rows carry √µ v and √µ(R/2) ω
            along[i] = less[i] * (end_g[i] - 2.0 * hand * (nz[i] * turn_a[i] - na[i] * turn_z[i]))
        for i in range(n):
            sideways[i] = less[i] * (hand * (nz[i] * end_a[i] - na[i] * end_z[i]) + 2.0 * turn_g[i])
        if physics.viscous:
            for i in range(n):
                if gap[i] < _NEAR * physics.radius_m:
                    touching += 1.0
        else:
            bristle_a, bristle_b = state.bristle_m[0, spot], state.bristle_m[1, spot]
            load_, share = state.load_m_s2[spot], work.grip[1, spot]
            for i in range(n):
                p = k * bristle_a[i] + (h * k + c) * along[i]
                q = k * bristle_b[i] + (h * k + c) * sideways[i]
                size, limit = np.sqrt(p * p + q * q), physics.friction * load_[i]
                share[i] = 1.0 if size <= limit else limit / size
    if layout.resists:
        stiffness, damping = _roll_stiffness(physics)
        for i in range(n):
            rolling = work.ahead[6, i] * 2.0 * less[i] / physics.radius_m
            size = abs(stiffness * state.roll_bristle[i] + (h * stiffness + damping) * rolling)
            limit = physics.resistance_m2_s2 if state.load_m_s2[0, i] > 0.0 else 0.0
            work.grip[2, 0, i] = 1.0 if size <= limit else limit / size
    return touching > 0.0


@inner
def _roll_stiffness(physics: Physics) -> tuple[float, float]:
    k = physics.resistance_m2_s2 / _ROLL_BRISTLE
    return k, physics.radius_m * np.sqrt(2.0 * k)


@inner
def contact_rows(h: float, state: State, physics: Physics, rule: Rule, work: Work, layout: Layout) -> None:
    """Rows of the contacts that `grip` names, and their right side."""
    n, grain = layout.points, physics.grain
    across, hand = 1 - grain, _hand(physics)
    k, c = physics.contact_stiffness_1_s2, physics.contact_damping_1_s
    stiff, slip = c + h * work.theta[0] * k, c + h * k
    heavy, lean = np.sqrt(h * stiff), np.sqrt(h / stiff)
    root = rule.root_mass
    along_n, along_z, weight = work.triple[0, 0], work.triple[0, 1], work.triple[0, 2]
    for spot in range(layout.spots):
        na, nz, gap = work.normal[0, spot], work.normal[1, spot], work.gap_m[spot]
        speed, carries, share = work.approach[0, spot], work.grip[0, spot], work.grip[1, spot]
        drive = work.drive[3 * spot]
        for i in range(n):
            along_n[i] = heavy * carries[i] * na[i]
            along_z[i] = heavy * carries[i] * nz[i]
            drive[i] = carries[i] * root[i] * lean * (-k * gap[i] - c * speed[i])
        first, second = work.drive[3 * spot + 1], work.drive[3 * spot + 2]
        along, sideways = work.approach[1, spot], work.approach[2, spot]
        if physics.viscous:
            for i in range(n):
                weight[i] = np.sqrt(h * physics.friction) if gap[i] < _NEAR * physics.radius_m else 0.0
                first[i] = -root[i] * weight[i] * along[i]
                second[i] = -root[i] * weight[i] * sideways[i]
        else:
            bristle_a, bristle_b, ease = state.bristle_m[0, spot], state.bristle_m[1, spot], k / slip
            for i in range(n):
                weight[i] = carries[i] * np.sqrt(h * slip * share[i])
            for i in range(n):
                first[i] = -root[i] * weight[i] * (ease * bristle_a[i] + along[i])
                second[i] = -root[i] * weight[i] * (ease * bristle_b[i] + sideways[i])
        for d in range(layout.columns):
            row_a, row_z, row_g = work.rows[d, across], work.rows[d, 2], work.rows[d, grain]
            turn_a, turn_z, turn_g = work.rows[d, 3 + across], work.rows[d, 5], work.rows[d, 3 + grain]
            normal, first, second = (
                work.contact[d, 3 * spot],
                work.contact[d, 3 * spot + 1],
                work.contact[d, 3 * spot + 2],
            )
            if physics.ground == PLANE:
                for i in range(n):
                    normal[i] = along_z[i] * row_z[i]
                for i in range(n):
                    first[i] = weight[i] * (row_g[i] - 2.0 * turn_a[i])
                for i in range(n):
                    second[i] = weight[i] * (row_a[i] + 2.0 * turn_g[i])
            else:
                for i in range(n):
                    normal[i] = along_n[i] * row_a[i] + along_z[i] * row_z[i]
                for i in range(n):
                    first[i] = weight[i] * (row_g[i] - 2.0 * hand * (nz[i] * turn_a[i] - na[i] * turn_z[i]))
                for i in range(n):
                    second[i] = weight[i] * (hand * (nz[i] * row_a[i] - na[i] * row_z[i]) + 2.0 * turn_g[i])
    if layout.resists:
        line = 3 * layout.spots
        k, c = _roll_stiffness(physics)
        for i in range(n):
            weight[i] = work.grip[0, 0, i] * np.sqrt(h * work.grip[2, 0, i] * (h * k + c))
            rolling = work.ahead[6, i] * 2.0 * rule.inverse_root[i] / physics.radius_m
            work.drive[line, i] = -root[i] * weight[i] * (k / (h * k + c) * state.roll_bristle[i] + rolling)
        for d in range(layout.columns):
            for i in range(n):
                work.contact[d, line, i] = weight[i] * 2.0 / physics.radius_m * work.rows[d, 6, i]


@inner
def _find_ends(h: float, physics: Physics, rule: Rule, work: Work, layout: Layout, spot: int) -> None:
    """work.ends: load, sliding velocity along the grain and across at the end of the step."""
    n, grain = layout.points, physics.grain
    across, hand = 1 - grain, _hand(physics)
    k, c, theta = physics.contact_stiffness_1_s2, physics.contact_damping_1_s, work.theta[0]
    na, nz, gap, less = work.normal[0, spot], work.normal[1, spot], work.gap_m[spot], rule.inverse_root
    va, vz, vg = work.change[across], work.change[2], work.change[grain]
    turn_a, turn_z, turn_g = work.change[3 + across], work.change[5], work.change[3 + grain]
    load, along, sideways = work.ends[0], work.ends[1], work.ends[2]
    speed = work.approach[0, spot]
    for i in range(n):
        gained = (na[i] * va[i] + nz[i] * vz[i]) * less[i]
        load[i] = -k * (gap[i] + h * theta * gained) - c * (speed[i] + gained)
    speed = work.approach[1, spot]
    for i in range(n):
        along[i] = speed[i] + less[i] * (vg[i] - 2.0 * hand * (nz[i] * turn_a[i] - na[i] * turn_z[i]))
    speed = work.approach[2, spot]
    for i in range(n):
        sideways[i] = speed[i] + less[i] * (hand * (nz[i] * va[i] - na[i] * vz[i]) + 2.0 * turn_g[i])


@inner
def contradicted(h: float, state: State, physics: Physics, rule: Rule, work: Work, layout: Layout) -> bool:
    """Whether the solution contradicts the contacts it was made with; `grip` is then what it asks for."""
    n = layout.points
    slack = _LOAD_SLACK * max(abs(physics.gravity_z_m_s2), _LEAST_GRAVITY_M_S2)
    k, c = physics.contact_stiffness_1_s2, physics.contact_damping_1_s
    again = 0.0
    for spot in range(layout.spots):
        _find_ends(h, physics, rule, work, layout, spot)
        load, along, sideways, asked = work.ends[0], work.ends[1], work.ends[2], work.ends[3]
        carries, share = work.grip[0, spot], work.grip[1, spot]
        wrong = 0.0
        for i in range(n):
            side = 2.0 * carries[i] - 1.0
            if side * load[i] < -slack:
                carries[i] = 1.0 - carries[i]
                wrong += 1.0
        if not physics.viscous:
            bristle_a, bristle_b = state.bristle_m[0, spot], state.bristle_m[1, spot]
            off = 0.0
            for i in range(n):
                p = k * bristle_a[i] + (h * k + c) * along[i]
                q = k * bristle_b[i] + (h * k + c) * sideways[i]
                size, limit = np.sqrt(p * p + q * q), physics.friction * max(load[i], 0.0)
                asked[i] = 1.0 if size <= limit else limit / size
                gap = abs(asked[i] - share[i]) * size - _FRICTION_SLACK * limit - 0.1 * slack
                off += carries[i] * max(gap, 0.0)
            if wrong > 0.0 or off > 0.0:
                for i in range(n):
                    share[i] = asked[i]
                wrong += 1.0
        again += wrong
    return again > 0.0


@inner
def keep_contacts(h: float, state: State, physics: Physics, rule: Rule, work: Work, layout: Layout) -> None:
    """Loads and bristles at the end of the step."""
    n = layout.points
    k, c = physics.contact_stiffness_1_s2, physics.contact_damping_1_s
    for spot in range(layout.spots):
        _find_ends(h, physics, rule, work, layout, spot)
        load, along, sideways = work.ends[0], work.ends[1], work.ends[2]
        carries, share = work.grip[0, spot], work.grip[1, spot]
        kept, bristle_a, bristle_b = state.load_m_s2[spot], state.bristle_m[0, spot], state.bristle_m[1, spot]
        for i in range(n):
            kept[i] = carries[i] * max(load[i], 0.0)
        if not physics.viscous:
            for i in range(n):
                # sliding, the whole force goes into the bristle; sticking, the damper's part does not
                more = h + c / k if share[i] < 1.0 else h
                p = share[i] * (bristle_a[i] + more * along[i])
                q = share[i] * (bristle_b[i] + more * sideways[i])
                size, limit = np.sqrt(p * p + q * q), physics.friction * kept[i] / k
                less = 1.0 if size <= limit else limit / size
                bristle_a[i] = less * p
                bristle_b[i] = less * q
    if layout.resists:
        stiffness, damping = _roll_stiffness(physics)
        for i in range(n):
            rolling = (work.ahead[6, i] + work.change[6, i]) * 2.0 * rule.inverse_root[i] / physics.radius_m
            share_ = work.grip[2, 0, i]
            more = h + damping / stiffness if share_ < 1.0 else h
            angle = share_ * (state.roll_bristle[i] + more * rolling)
            held = min(max(angle, -_ROLL_BRISTLE), _ROLL_BRISTLE)
            state.roll_bristle[i] = held if state.load_m_s2[0, i] > 0.0 else 0.0


@inner
def drop_contacts(state: State) -> None:
    """Nothing touches: no load, no bristle."""
    for spot in range(state.load_m_s2.shape[0]):
        for i in range(state.load_m_s2.shape[1]):
            state.load_m_s2[spot, i] = state.bristle_m[0, spot, i] = state.bristle_m[1, spot, i] = 0.0
    for i in range(state.roll_bristle.shape[0]):
        state.roll_bristle[i] = 0.0
