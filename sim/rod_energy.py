"""Energies of the rod, the softening of a section that ovalises, and the audit of the energy that steps have made."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.rod_algebra import combine_rows, dot, gather, solve_forward
from sim.rod_compile import apart, inner
from sim.rod_contact import ground_energy
from sim.rod_memory import ALOFT, AUDITED, CEILING, CREATED, LARGEST, WORK, Contacts, Layout, Physics, State, Work
from sim.rod_momentum import base_momentum, settle_base
from sim.rod_placement import place_rod
from sim.rod_rule import Rule

FloatArray = NDArray[np.float64]

_AFTER_KINK = 0.02  # bending stiffness beyond the kink over that of the straight tube: keeps the tube finite
_ENERGY_SLACK = 2e-3
_WATCHED_STEPS = 512.0  # halved and audited one by one after one that had made energy


@inner
def softened_moment(bend_squared: float, a: float, tightest_1_m: float) -> tuple[float, float]:
    """1 − (passive moment over EIκ), and the elastic energy that is missing over EI, of a section that ovalises.

    Beyond the kink it hardly resists, until at `tightest_1_m` its inner side folds on itself or its ends meet.
    """
    kink_squared = 1.0 / (3.0 * a)
    if bend_squared <= kink_squared:
        return a * bend_squared, 0.25 * a * bend_squared * bend_squared
    kink, bend = np.sqrt(kink_squared), np.sqrt(bend_squared)
    fold = max(kink, tightest_1_m)
    beyond, folded = min(bend, fold) - kink, max(bend - fold, 0.0)
    moment = kink * 2.0 / 3.0 + _AFTER_KINK * beyond
    energy = 5.0 / 12.0 * kink_squared + beyond * (kink * 2.0 / 3.0 + 0.5 * _AFTER_KINK * beyond)
    energy += folded * (moment + 0.5 * folded)
    moment += folded
    return 1.0 - moment / bend, 0.5 * bend_squared - energy


@inner
def curvature_squared(i: int, strain: FloatArray, mode: FloatArray) -> float:
    """At a point; the sign of `outward` in `mode` does not matter."""
    x = y = 0.0
    for m in range(mode.shape[0]):
        x += mode[m, i] * strain[3 * m]
        y += mode[m, i] * strain[3 * m + 1]
    return x * x + y * y


@inner
def elastic_energy_J(strain: FloatArray, rest: FloatArray, stiffness: FloatArray) -> float:
    """½ (e − e₀)ᵀ K (e − e₀) [J]. strain, rest: shape (s,); stiffness: shape (s, s)."""
    total = 0.0
    for a in range(strain.shape[0]):
        off = strain[a] - rest[a]
        for b in range(strain.shape[0]):
            total += 0.5 * off * stiffness[a, b] * (strain[b] - rest[b])
    return total


@inner
def mechanical_energy_J(state: State, physics: Physics, rule: Rule, work: Work) -> float:
    """Kinetic, elastic and gravitational energy of the rod as it is placed, with its rates [J]."""
    missing = 0.0
    if physics.softening_m2 > 0.0:
        for i in range(rule.root_mass.shape[0]):
            bend_squared = curvature_squared(i, state.strain, rule.mode)
            _, less = softened_moment(bend_squared, physics.softening_m2, physics.tightest_1_m)
            missing += less * physics.bending_N_m2 * physics.length_m * rule.root_mass[i] ** 2 / physics.mass_kg
    fallen = (
        (state.position_m[0] + work.arm_m[0]) * physics.gravity_x_m_s2
        + (state.position_m[1] + work.arm_m[1]) * physics.gravity_y_m_s2
        + (state.position_m[2] + work.arm_m[2]) * physics.gravity_z_m_s2
    )
    elastic = elastic_energy_J(state.strain, state.rest_strain, state.stiffness)
    return 0.5 * dot(work.rate, work.rate) + elastic - missing - physics.mass_kg * fallen


@apart
def audit_energy(state: State, physics: Physics, rule: Rule, contacts: Contacts, work: Work, layout: Layout) -> None:
    """Take out of the motion what energy the steps have made.

    Kinetic, elastic and gravitational energy and that of the ground's springs, less the actuators' work, only ever
    falls. Where coarse steps let it rise by more than `_ENERGY_SLACK` of the largest energy so far, velocities are
    scaled down: aloft those of the strains only, for the momentum's sake.
    """
    flag, velocity, base = state.flag, state.velocity, layout.base
    place_rod(state, physics, rule, work, layout, 0.0)
    gather(velocity, work.column, work.vector)
    combine_rows(work.rows, layout.columns, work.vector, work.rate)
    rigid = 0.0
    kept = flag[ALOFT] == 1.0 and base > 0
    if kept:
        settle_base(base, state.momentum, work.column, work.arm_m, work.rows, work.matrix, work.vector, work.rate)
        base_momentum(base, state.momentum, work.column, work.arm_m, work.vector)
        solve_forward(work.matrix, base, work.vector)
        for a in range(base):
            rigid += 0.5 * work.vector[a] * work.vector[a]
    kinetic = 0.5 * dot(work.rate, work.rate)
    energy = mechanical_energy_J(state, physics, rule, work) - flag[WORK]
    if flag[ALOFT] == 0.0 and physics.ground > 0:
        energy += ground_energy(state.position_m, physics, contacts, rule.root_mass, work.place_m)
    elastic = elastic_energy_J(state.strain, state.rest_strain, state.stiffness)
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
