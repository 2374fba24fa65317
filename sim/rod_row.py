"""A row of motion of the rod, and the first time it kinks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.rod_compile import apart, inner
from sim.rod_energy import curvature_squared, mechanical_energy_J
from sim.rod_ground import profile_gap
from sim.rod_memory import ALOFT, ASLEEP, KINKED, TIME, WORK, Layout, Physics, State, Work
from sim.rod_momentum import settle_base, take_momentum
from sim.rod_rule import Rule
from sim.rod_views import flat

FloatArray = NDArray[np.float64]


@inner
def note_kink(strain: FloatArray, mode: FloatArray, softening_m2: float, flag: FloatArray) -> float:
    """The greatest curvature along the tube, and the time of the first kink into the state's flags."""
    greatest = 0.0
    for i in range(mode.shape[1]):
        greatest = max(greatest, curvature_squared(i, strain, mode))
    if softening_m2 > 0.0 and flag[KINKED] < 0.0 and greatest * 3.0 * softening_m2 > 1.0:
        flag[KINKED] = flag[TIME]
    return np.sqrt(greatest)


@apart
def write_row(state: State, physics: Physics, rule: Rule, work: Work, layout: Layout, row: FloatArray) -> None:
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
        settle_base(base, state.momentum, work.column, arm, rows, work.matrix, change, rate)
        for a in range(base):
            f = int(work.column[a])
            row[16 + f if f < 3 else 10 + f] += change[a]
    momentum = flat(work.foretold)  # free here
    take_momentum(base, rows, rate, work.column, arm, momentum)
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
    row[31] = mechanical_energy_J(state, physics, rule, work)
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
    row[34] = note_kink(state.strain, rule.mode, physics.softening_m2, flag)
    row[35] = flag[ASLEEP]
