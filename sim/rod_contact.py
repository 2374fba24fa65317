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
from numpy.typing import NDArray

from sim.rod_compile import apart, inner
from sim.rod_ground import PLANE, profile_gap
from sim.rod_memory import Contacts, Physics

FloatArray = NDArray[np.float64]

_NEAR = 0.05  # of the radius: viscous friction acts below this gap
_ROLL_BRISTLE = 0.01  # rad: rolling gives way elastically by this much before it starts
_LOAD_SLACK = 0.02  # of gravity: a load on the wrong side by less is left to the next step
_FRICTION_SLACK = 0.05  # of the limit
_LEAST_GRAVITY_M_S2 = 1.0


@inner
def _hand(grain: int) -> float:
    """n × grain has this times (n_z, −n_a) along a and z."""
    return 1.0 if grain == 0 else -1.0


@inner
def _roll_stiffness(physics: Physics) -> tuple[float, float]:
    k = physics.resistance_m2_s2 / _ROLL_BRISTLE
    return k, physics.radius_m * np.sqrt(2.0 * k)


@inner
def _share(
    reach_s: float, limit: float, k: float, c: float, bristle: FloatArray, along: FloatArray, sideways: FloatArray,
    load: FloatArray, share: FloatArray,
) -> None:  # fmt: skip
    """share ← of sticking at which friction stays within `limit` times the load. reach_s: the step."""
    first, second = bristle[0], bristle[1]
    for i in range(load.shape[0]):
        p = k * first[i] + (reach_s * k + c) * along[i]
        q = k * second[i] + (reach_s * k + c) * sideways[i]
        size, most = np.sqrt(p * p + q * q), limit * max(load[i], 0.0)
        share[i] = 1.0 if size <= most else most / size


@apart
def find_contacts(
    h: float, theta: float, position: FloatArray, velocity: FloatArray, physics: Physics, contacts: Contacts,
    place_m: FloatArray, inverse_root: FloatArray, rate: FloatArray, foretold: FloatArray, ahead: FloatArray,
    bias: FloatArray,
) -> bool:  # fmt: skip
    """Gaps, normals and velocities of the contacts, and which of them will carry load. False: none.

    rate, foretold, ahead, bias: G u, the same at the middle of the step as the last step foretells it, what moves on
    steadily has at the end, and the right side of the inertia rows.
    """
    grain = physics.grain
    across, hand, n = 1 - grain, _hand(grain), rate.shape[1]
    k, c, near = physics.contact_stiffness_1_s2, physics.contact_damping_1_s, _NEAR * physics.radius_m
    middle_a = position[across] + 0.5 * h * velocity[across]
    middle_z = position[2] + 0.5 * h * velocity[2]
    along_a, along_z = place_m[across], place_m[2]
    fall_a = physics.gravity_y_m_s2 if grain == 0 else physics.gravity_x_m_s2
    fall_z = physics.gravity_z_m_s2
    touching = 0.0
    for spot in range(contacts.gap_m.shape[0]):
        gap, na, nz = contacts.gap_m[spot], contacts.normal[0, spot], contacts.normal[1, spot]
        if physics.ground == PLANE:
            for i in range(n):
                gap[i] = middle_z + along_z[i] - physics.radius_m
                na[i] = 0.0
                nz[i] = 1.0
        else:
            for i in range(n):
                gap[i], na[i], nz[i] = profile_gap(
                    physics.ground, physics.ground_a_m, physics.ground_b_m, spot,
                    middle_a + along_a[i], middle_z + along_z[i], physics.radius_m,
                )  # fmt: skip
        # the rod is placed half a step on: from there back to the step's start, and on to its end as it moves now
        va, vz, end_a, end_z = rate[across], rate[2], ahead[across], ahead[2]
        push_a, push_z = bias[across], bias[2]
        speed, carries = contacts.approach[0, spot], contacts.grip[0, spot]
        for i in range(n):
            less = inverse_root[i]
            fall = h * (na[i] * fall_a + nz[i] * fall_z)
            now = (na[i] * va[i] + nz[i] * vz[i]) * less
            curved = (na[i] * push_a[i] + nz[i] * push_z[i]) * less - fall
            gap[i] += 0.5 * h * now - 0.125 * h * curved
            speed[i] = (na[i] * end_a[i] + nz[i] * end_z[i]) * less
            load = -k * (gap[i] + h * theta * fall) - c * (speed[i] + fall)
            carries[i] = 1.0 if load > 0.0 else 0.0
            touching += carries[i]
        end_g, turn_a, turn_z, turn_g = ahead[grain], ahead[3 + across], ahead[5], ahead[3 + grain]
        along, sideways = contacts.approach[1, spot], contacts.approach[2, spot]
        for i in range(n):  # rows carry √µ v and √µ(R/2) ω
            less = inverse_root[i]
            along[i] = less * (end_g[i] - 2.0 * hand * (nz[i] * turn_a[i] - na[i] * turn_z[i]))
            sideways[i] = less * (hand * (nz[i] * end_a[i] - na[i] * end_z[i]) + 2.0 * turn_g[i])
        if physics.viscous:
            for i in range(n):
                if gap[i] < near:
                    touching += 1.0
        else:
            soon_a, soon_z, soon_g = foretold[across], foretold[2], foretold[grain]
            spin_a, spin_z, spin_g = foretold[3 + across], foretold[5], foretold[3 + grain]
            vg, wa, wz, wg = rate[grain], rate[3 + across], rate[5], rate[3 + grain]
            first, second = contacts.ends[1], contacts.ends[2]
            for i in range(n):  # with what the velocity gains until the end of the step, as it did in the last one
                more = 2.0 * inverse_root[i]
                turn = nz[i] * (spin_a[i] - wa[i]) - na[i] * (spin_z[i] - wz[i])
                first[i] = along[i] + more * (soon_g[i] - vg[i] - 2.0 * hand * turn)
                move = nz[i] * (soon_a[i] - va[i]) - na[i] * (soon_z[i] - vz[i])
                second[i] = sideways[i] + more * (hand * move + 2.0 * (spin_g[i] - wg[i]))
            _share(
                h, physics.friction, k, c, contacts.bristle_m[:, spot], first, second, contacts.load_m_s2[spot],
                contacts.grip[1, spot],
            )  # fmt: skip
    if physics.resistance_m2_s2 > 0.0:
        stiffness, damping = _roll_stiffness(physics)
        load_, share = contacts.load_m_s2[0], contacts.grip[2, 0]
        for i in range(n):
            rolling = (ahead[6, i] + 2.0 * (foretold[6, i] - rate[6, i])) * 2.0 * inverse_root[i] / physics.radius_m
            size = abs(stiffness * contacts.roll_bristle[i] + (h * stiffness + damping) * rolling)
            limit = physics.resistance_m2_s2 if load_[i] > 0.0 else 0.0
            share[i] = 1.0 if size <= limit else limit / size
    return touching > 0.0


@apart
def contact_rows(
    h: float, theta: float, physics: Physics, contacts: Contacts, root: FloatArray, inverse_root: FloatArray,
    rows: FloatArray, ahead: FloatArray, scratch: FloatArray,
) -> None:  # fmt: skip
    """Rows of the contacts that `grip` names, and their right side. scratch: shape (≥ 3, n)."""
    grain = physics.grain
    across, hand, n = 1 - grain, _hand(grain), root.shape[0]
    k, c = physics.contact_stiffness_1_s2, physics.contact_damping_1_s
    stiff, slip = c + h * theta * k, c + h * k
    heavy, lean, ease, near = np.sqrt(h * stiff), np.sqrt(h / stiff), k / slip, _NEAR * physics.radius_m
    along_n, along_z, weight = scratch[0], scratch[1], scratch[2]
    for spot in range(contacts.gap_m.shape[0]):
        na, nz, gap = contacts.normal[0, spot], contacts.normal[1, spot], contacts.gap_m[spot]
        speed, carries, share = contacts.approach[0, spot], contacts.grip[0, spot], contacts.grip[1, spot]
        along, sideways = contacts.approach[1, spot], contacts.approach[2, spot]
        bristle_a, bristle_b = contacts.bristle_m[0, spot], contacts.bristle_m[1, spot]
        press, first, second = (
            contacts.drive[3 * spot], contacts.drive[3 * spot + 1], contacts.drive[3 * spot + 2]
        )  # fmt: skip
        for i in range(n):
            along_n[i] = heavy * carries[i] * na[i]
            along_z[i] = heavy * carries[i] * nz[i]
            press[i] = carries[i] * root[i] * lean * (-k * gap[i] - c * speed[i])
        for i in range(n):
            if physics.viscous:
                weight[i] = np.sqrt(h * physics.friction) if gap[i] < near else 0.0
                first[i] = -root[i] * weight[i] * along[i]
                second[i] = -root[i] * weight[i] * sideways[i]
            else:
                weight[i] = carries[i] * np.sqrt(h * slip * share[i])
                first[i] = -root[i] * weight[i] * (ease * bristle_a[i] + along[i])
                second[i] = -root[i] * weight[i] * (ease * bristle_b[i] + sideways[i])
        for d in range(rows.shape[0]):
            row_a, row_z, row_g = rows[d, across], rows[d, 2], rows[d, grain]
            turn_a, turn_z, turn_g = rows[d, 3 + across], rows[d, 5], rows[d, 3 + grain]
            press, first, second = (
                contacts.rows[d, 3 * spot], contacts.rows[d, 3 * spot + 1], contacts.rows[d, 3 * spot + 2]
            )  # fmt: skip
            if physics.ground == PLANE:
                for i in range(n):
                    press[i] = along_z[i] * row_z[i]
                    first[i] = weight[i] * (row_g[i] - 2.0 * turn_a[i])
                    second[i] = weight[i] * (row_a[i] + 2.0 * turn_g[i])
            else:
                for i in range(n):
                    press[i] = along_n[i] * row_a[i] + along_z[i] * row_z[i]
                    first[i] = weight[i] * (row_g[i] - 2.0 * hand * (nz[i] * turn_a[i] - na[i] * turn_z[i]))
                    second[i] = weight[i] * (hand * (nz[i] * row_a[i] - na[i] * row_z[i]) + 2.0 * turn_g[i])
    if physics.resistance_m2_s2 > 0.0:
        line = 3 * contacts.gap_m.shape[0]
        k, c = _roll_stiffness(physics)
        carries, share = contacts.grip[0, 0], contacts.grip[2, 0]
        for i in range(n):
            weight[i] = carries[i] * np.sqrt(h * share[i] * (h * k + c))
            rolling = ahead[6, i] * 2.0 * inverse_root[i] / physics.radius_m
            contacts.drive[line, i] = -root[i] * weight[i] * (k / (h * k + c) * contacts.roll_bristle[i] + rolling)
        for d in range(rows.shape[0]):
            for i in range(n):
                contacts.rows[d, line, i] = weight[i] * 2.0 / physics.radius_m * rows[d, 6, i]


@inner
def _find_ends(
    h: float, theta: float, physics: Physics, contacts: Contacts, inverse_root: FloatArray, change: FloatArray,
    spot: int,
) -> None:  # fmt: skip
    """contacts.ends: load, sliding velocity along the grain and across at the end of the step."""
    grain = physics.grain
    across, hand, n = 1 - grain, _hand(grain), change.shape[1]
    k, c = physics.contact_stiffness_1_s2, physics.contact_damping_1_s
    na, nz, gap = contacts.normal[0, spot], contacts.normal[1, spot], contacts.gap_m[spot]
    va, vz, vg = change[across], change[2], change[grain]
    turn_a, turn_z, turn_g = change[3 + across], change[5], change[3 + grain]
    load, along, sideways = contacts.ends[0], contacts.ends[1], contacts.ends[2]
    speed, slide, cross = contacts.approach[0, spot], contacts.approach[1, spot], contacts.approach[2, spot]
    for i in range(n):
        less = inverse_root[i]
        gained = (na[i] * va[i] + nz[i] * vz[i]) * less
        load[i] = -k * (gap[i] + h * theta * gained) - c * (speed[i] + gained)
        along[i] = slide[i] + less * (vg[i] - 2.0 * hand * (nz[i] * turn_a[i] - na[i] * turn_z[i]))
        sideways[i] = cross[i] + less * (hand * (nz[i] * va[i] - na[i] * vz[i]) + 2.0 * turn_g[i])


@inner
def contradicted(
    h: float, theta: float, physics: Physics, contacts: Contacts, inverse_root: FloatArray, change: FloatArray
) -> bool:
    """Whether the solution contradicts the contacts it was made with; `grip` is then what it asks for."""
    n = change.shape[1]
    slack = _LOAD_SLACK * max(abs(physics.gravity_z_m_s2), _LEAST_GRAVITY_M_S2)
    k, c = physics.contact_stiffness_1_s2, physics.contact_damping_1_s
    again = 0.0
    for spot in range(contacts.gap_m.shape[0]):
        _find_ends(h, theta, physics, contacts, inverse_root, change, spot)
        load, along, sideways, asked = contacts.ends[0], contacts.ends[1], contacts.ends[2], contacts.ends[3]
        carries, share = contacts.grip[0, spot], contacts.grip[1, spot]
        wrong = 0.0
        for i in range(n):
            side = 2.0 * carries[i] - 1.0
            if side * load[i] < -slack:
                carries[i] = 1.0 - carries[i]
                wrong += 1.0
        if not physics.viscous:
            first, second = contacts.bristle_m[0, spot], contacts.bristle_m[1, spot]
            _share(h, physics.friction, k, c, contacts.bristle_m[:, spot], along, sideways, load, asked)
            for i in range(n):
                p = k * first[i] + (h * k + c) * along[i]
                q = k * second[i] + (h * k + c) * sideways[i]
                size, limit = np.sqrt(p * p + q * q), physics.friction * max(load[i], 0.0)
                gap = abs(asked[i] - share[i]) * size - _FRICTION_SLACK * limit - 0.1 * slack
                wrong += carries[i] * max(gap, 0.0)
            if wrong > 0.0:
                for i in range(n):
                    share[i] = asked[i]
        again += wrong
    return again > 0.0


@inner
def keep_contacts(
    h: float, theta: float, physics: Physics, contacts: Contacts, inverse_root: FloatArray, change: FloatArray,
    ahead: FloatArray,
) -> None:  # fmt: skip
    """Loads and bristles at the end of the step."""
    n = change.shape[1]
    k, c = physics.contact_stiffness_1_s2, physics.contact_damping_1_s
    for spot in range(contacts.gap_m.shape[0]):
        _find_ends(h, theta, physics, contacts, inverse_root, change, spot)
        load, along, sideways = contacts.ends[0], contacts.ends[1], contacts.ends[2]
        carries, share, kept = contacts.grip[0, spot], contacts.grip[1, spot], contacts.load_m_s2[spot]
        first, second = contacts.bristle_m[0, spot], contacts.bristle_m[1, spot]
        for i in range(n):
            kept[i] = carries[i] * max(load[i], 0.0)
        if not physics.viscous:
            for i in range(n):
                # sliding, the whole force goes into the bristle; sticking, the damper's part does not
                more = h + c / k if share[i] < 1.0 else h
                p = share[i] * (first[i] + more * along[i])
                q = share[i] * (second[i] + more * sideways[i])
                size, limit = np.sqrt(p * p + q * q), physics.friction * kept[i] / k
                less = 1.0 if size <= limit else limit / size
                first[i] = less * p
                second[i] = less * q
    if physics.resistance_m2_s2 > 0.0:
        stiffness, damping = _roll_stiffness(physics)
        kept, share = contacts.load_m_s2[0], contacts.grip[2, 0]
        for i in range(n):
            rolling = (ahead[6, i] + change[6, i]) * 2.0 * inverse_root[i] / physics.radius_m
            more = h + damping / stiffness if share[i] < 1.0 else h
            angle = share[i] * (contacts.roll_bristle[i] + more * rolling)
            held = min(max(angle, -_ROLL_BRISTLE), _ROLL_BRISTLE)
            contacts.roll_bristle[i] = held if kept[i] > 0.0 else 0.0


@inner
def ground_energy(
    position: FloatArray, physics: Physics, contacts: Contacts, root: FloatArray, place_m: FloatArray
) -> float:  # fmt: skip
    """What the springs and bristles of the contacts hold [J], the rod as it is placed."""
    across, n = 1 - physics.grain, root.shape[0]
    total = 0.0
    for spot in range(contacts.gap_m.shape[0]):
        first, second = contacts.bristle_m[0, spot], contacts.bristle_m[1, spot]
        for i in range(n):
            gap, _, _ = profile_gap(
                physics.ground, physics.ground_a_m, physics.ground_b_m, spot, position[across] + place_m[across, i],
                position[2] + place_m[2, i], physics.radius_m,
            )  # fmt: skip
            sunk = min(gap, 0.0)
            total += root[i] ** 2 * (sunk * sunk + first[i] ** 2 + second[i] ** 2)
    total *= 0.5 * physics.contact_stiffness_1_s2
    if physics.resistance_m2_s2 > 0.0:
        stiffness, _ = _roll_stiffness(physics)
        for i in range(n):
            total += 0.5 * stiffness * root[i] ** 2 * contacts.roll_bristle[i] ** 2
    return total


@inner
def drop_contacts(load_m_s2: FloatArray, bristle_m: FloatArray, roll_bristle: FloatArray) -> None:
    """Nothing touches: no load, no bristle."""
    for i in range(roll_bristle.shape[0]):
        roll_bristle[i] = 0.0
        for spot in range(load_m_s2.shape[0]):
            load_m_s2[spot, i] = bristle_m[0, spot, i] = bristle_m[1, spot, i] = 0.0
