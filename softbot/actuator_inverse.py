"""Pressures for a wanted bend and stretch of a section: the kernels of the inverse of `softbot.actuator`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from softbot.actuator_equilibrium import equilibrium_under, solve_strain, wall_forces
from softbot.kernel_compiler import kernel, part

FloatArray = NDArray[np.float64]

_STRAIGHT_1_M = 1e-6
_ROUNDING = 1e-9
"""Of the largest load: a chamber that is to bear less is not used."""
_LOOKED_AT = 8  # stretches between the shortest tube and the longest


@part()
def _least_pressures(arms: FloatArray, wanted: FloatArray, room_Pa: FloatArray, pressure: FloatArray) -> None:
    """Non-negative pressures with Σ arms_i p_i nearest to `wanted` (shape (2,)), of least sum among the exact ones.

    The nearest point of a plane cone lies inside the cone of two chambers, on the ray of one, or at the tip; all are
    tried. Pressures beyond `room_Pa`, shape (4,), are scaled back together, which keeps the direction; chambers
    without room are not used.
    """
    best_miss = wanted[0] ** 2 + wanted[1] ** 2
    best_sum = 0.0
    scale = best_miss
    pressure[:] = 0.0
    for i in range(arms.shape[1]):
        if room_Pa[i] <= 0.0:
            continue
        square = arms[0, i] ** 2 + arms[1, i] ** 2
        alone = (arms[0, i] * wanted[0] + arms[1, i] * wanted[1]) / square
        if alone > 0.0:
            miss = (arms[0, i] * alone - wanted[0]) ** 2 + (arms[1, i] * alone - wanted[1]) ** 2
            if miss < best_miss * (1.0 - 1e-12):
                best_miss, best_sum = miss, alone
                pressure[:] = 0.0
                pressure[i] = alone
        for j in range(i + 1, arms.shape[1]):
            if room_Pa[j] <= 0.0:
                continue
            determinant = arms[0, i] * arms[1, j] - arms[1, i] * arms[0, j]
            if abs(determinant) < 1e-9 * square:
                continue
            first = (wanted[0] * arms[1, j] - wanted[1] * arms[0, j]) / determinant
            second = (arms[0, i] * wanted[1] - arms[1, i] * wanted[0]) / determinant
            if first >= 0.0 and second >= 0.0:
                exact_before = best_miss <= 1e-20 * scale
                if not exact_before or first + second < best_sum:
                    best_miss, best_sum = 0.0, first + second
                    pressure[:] = 0.0
                    pressure[i], pressure[j] = first, second
    share = 1.0
    for i in range(arms.shape[1]):
        if pressure[i] > room_Pa[i]:
            share = min(share, room_Pa[i] / pressure[i])
    for i in range(arms.shape[1]):
        pressure[i] *= share


@part()
def _invert(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    load: FloatArray,
    least_Pa: FloatArray,
    room_Pa: FloatArray,
    strain: FloatArray,
    extra: FloatArray,
) -> None:
    """Fixed point on the stretch: moments at the wanted curvature → pressures → stretch, until it rests.

    Pressures are those that load the wall: `least_Pa` (4,) and what comes on top, `extra` (4,) ≤ `room_Pa` (4,),
    written. `strain` holds the wanted curvature, and at the end the stretch too.
    """
    force, stiffness = np.empty(3), np.empty((3, 3))
    arms = load[1:, :].copy()
    extra[:] = 0.0
    for _ in range(100):
        crushed = not wall_forces(points, code, wall, strain, force, stiffness)
        if crushed:  # a curvature that this stretch cannot hold: ask for less of it
            strain[1:] *= 0.7
            continue
        moment = force[1:] - arms @ least_Pa
        _least_pressures(arms, moment, room_Pa, extra)
        axial = 0.0
        for i in range(load.shape[1]):
            axial += load[0, i] * (least_Pa[i] + extra[i])
        correction = (axial - force[0]) / stiffness[0, 0]
        correction = min(max(correction, -0.2), 0.2)
        strain[0] += correction
        if abs(correction) < 1e-12:
            break


@part()
def _longest_pressures(
    load: FloatArray, moment_N_m: FloatArray, axial_N: float, room_Pa: FloatArray, extra: FloatArray
) -> int:
    """Pressures within the room that carry the moments (2,) exactly, with an axial force as near `axial_N` as may be.

    The pressures that carry the moments are a convex set whose corners have all but two chambers at a limit: the ones
    of least and of largest axial force are found among those, and the force wanted lies on the line between them.
    Returns 0 where it is met, −1 or +1 where the least or the largest is too much or too little for it, 2 where the
    moments cannot be carried.
    """
    low_N, high_N = np.inf, -np.inf
    low, high, trial = np.empty(load.shape[1]), np.empty(load.shape[1]), np.empty(load.shape[1])
    scale = 0.0
    for i in range(load.shape[1]):
        scale = max(scale, room_Pa[i])
    slack = 1e-9 * scale
    for i in range(load.shape[1]):
        for j in range(i + 1, load.shape[1]):
            determinant = load[1, i] * load[2, j] - load[1, j] * load[2, i]
            if abs(determinant) < 1e-9 * (load[1, i] ** 2 + load[2, i] ** 2):
                continue
            for full in range(4):
                trial[:] = 0.0
                first, second = moment_N_m[0], moment_N_m[1]
                bit = 1
                for k in range(load.shape[1]):
                    if k not in (i, j):
                        if full & bit:
                            trial[k] = room_Pa[k]
                            first -= load[1, k] * room_Pa[k]
                            second -= load[2, k] * room_Pa[k]
                        bit *= 2
                trial[i] = (first * load[2, j] - second * load[1, j]) / determinant
                trial[j] = (load[1, i] * second - load[2, i] * first) / determinant
                if min(trial[i], trial[j]) < -slack or trial[i] > room_Pa[i] + slack or trial[j] > room_Pa[j] + slack:
                    continue
                force_N = 0.0
                for k in range(load.shape[1]):
                    force_N += load[0, k] * trial[k]
                if force_N < low_N:
                    low_N = force_N
                    low[:] = trial
                if force_N > high_N:
                    high_N = force_N
                    high[:] = trial
    if high_N < low_N:
        return 2
    span = high_N - low_N
    share = (axial_N - low_N) / span if span > 0.0 else (0.0 if axial_N <= low_N else 1.0)
    for k in range(load.shape[1]):
        between = low[k] + min(max(share, 0.0), 1.0) * (high[k] - low[k])
        extra[k] = min(max(between, 0.0), room_Pa[k])
    slip = 1e-9 * max(abs(low_N), abs(high_N))
    if axial_N < low_N - slip:
        return -1
    return 1 if axial_N > high_N + slip else 0


@part()
def _holds(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    load: FloatArray,
    least_Pa: FloatArray,
    room_Pa: FloatArray,
    strain: FloatArray,
    extra: FloatArray,
) -> int:
    """Whether the chambers can hold a strain (3,), and with what: `_longest_pressures` of the wall's forces there.

    3 where the wall has none: its inner side is crushed, or it is drawn beyond its law.
    """
    force, stiffness = np.empty(3), np.empty((3, 3))
    if not wall_forces(points, code, wall, strain, force, stiffness):
        return 3
    for i in range(load.shape[1]):
        for k in range(3):
            force[k] -= load[k, i] * least_Pa[i]
    return _longest_pressures(load, force[1:], force[0], room_Pa, extra)


@part()
def _shortest_of_curvature(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    load: FloatArray,
    least_Pa: FloatArray,
    room_Pa: FloatArray,
    longest: float,
    tries: int,
    strain: FloatArray,
    extra: FloatArray,
) -> bool:
    """The shortest stretch from `strain[0]` to `longest`, by `tries` halvings, that can hold the curvature in `strain`.

    Writes it to `strain[0]` and its pressures to `extra`; False, and `extra` is spoilt, where there is none.
    """
    trial, found = strain.copy(), np.empty(load.shape[1])
    short, long, holds = strain[0], longest, False
    for n in range(_LOOKED_AT):  # what carries the bend may be neither the shortest nor the longest
        trial[0] = strain[0] + (longest - strain[0]) * (n + 1) / _LOOKED_AT
        if _holds(points, code, wall, load, least_Pa, room_Pa, trial, found) == 0:
            short, long = strain[0] + (longest - strain[0]) * n / _LOOKED_AT, trial[0]
            holds = True
            extra[:] = found
            break
    for _ in range(tries):
        trial[0] = 0.5 * (short + long)
        side = _holds(points, code, wall, load, least_Pa, room_Pa, trial, found)
        if side == 0:
            holds = True
            extra[:] = found
        if side in (0, 1):
            long = trial[0]
        else:
            short = trial[0]
    if holds:
        strain[0] = long
    return holds


@part()
def _invert_longer(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    load: FloatArray,
    least_Pa: FloatArray,
    room_Pa: FloatArray,
    wanted_1_m: FloatArray,
    strain: FloatArray,
    extra: FloatArray,
) -> bool:
    """From pressures that miss a curvature, `strain` (3,) and `extra` (4,), to those of a longer tube that has it.

    A wall that softens as it is stretched is bent further by filling the other chambers too. Where not even that
    gives the wanted curvature, as far towards it as can be. Both are moved on in place; False where nothing is gained.
    """
    across = abs(strain[1] * wanted_1_m[1] - strain[2] * wanted_1_m[0])
    along = strain[1] * wanted_1_m[0] + strain[2] * wanted_1_m[1]
    if across > 0.3 * along:  # the direction cannot be had, however long the tube is
        return False
    full, force, stiffness = np.array([1.0, 0.0, 0.0]), np.zeros(3), np.empty((3, 3))
    for i in range(load.shape[1]):
        force[0] += load[0, i] * (least_Pa[i] + room_Pa[i])
    if not solve_strain(points, code, wall, force, full, stiffness):
        return False
    near, trial, found = strain.copy(), strain.copy(), np.empty(load.shape[1])
    low, high, gained = 0.0, 2.0, False
    for _ in range(9):  # 1, then halves: as near as 1/256
        share = 0.5 * (low + high)
        trial[0] = near[0]
        trial[1:] = near[1:] + share * (wanted_1_m - near[1:])
        tries = 40 if share == 1.0 else 16
        if _shortest_of_curvature(points, code, wall, load, least_Pa, room_Pa, full[0], tries, trial, found):
            gained = True
            strain[:] = trial
            extra[:] = found
            if share == 1.0:
                break
            low = share
        else:
            high = share
    return gained


@part()
def _invert_stretched(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    load: FloatArray,
    least_Pa: FloatArray,
    room_Pa: FloatArray,
    stretch: float,
    strain: FloatArray,
    extra: FloatArray,
) -> None:
    """From `_invert`'s solution of least pressure to a longer tube of the same curvature: `stretch`, or the longest.

    `strain` (3,) and `extra` (4,) are moved on in place; left as they are where the chambers cannot carry the bend.
    """
    trial, found = strain.copy(), np.empty(load.shape[1])
    shortest, longest = strain[0], stretch
    trial[0] = stretch
    for _ in range(40):
        side = _holds(points, code, wall, load, least_Pa, room_Pa, trial, found)
        if side == 0:
            strain[:] = trial
            extra[:] = found
            if trial[0] == stretch:
                return
        if side > 0:
            longest = trial[0]
        else:
            shortest = trial[0]
        if longest - shortest < 1e-12:
            return
        trial[0] = 0.5 * (shortest + longest)


@part()
def _loaded(
    load: FloatArray,
    dead_band_Pa: float,
    least_Pa: FloatArray,
    most_Pa: FloatArray,
    least_load_Pa: FloatArray,
    extra: FloatArray,
    pressure_Pa: FloatArray,
) -> None:
    """Chamber pressures (4,) of what loads the wall: a chamber at its least is left there.

    So is one that round-off asks for (a bend along a chamber's own axis has some of the next one's, too): it would be
    filled up to its dead band for nothing.
    """
    largest_Pa = 0.0
    for i in range(load.shape[1]):
        largest_Pa = max(largest_Pa, least_load_Pa[i] + extra[i])
    for i in range(load.shape[1]):
        pressure_Pa[i] = least_Pa[i]
        if extra[i] > _ROUNDING * largest_Pa:
            pressure_Pa[i] = max(least_Pa[i], min(least_load_Pa[i] + extra[i] + dead_band_Pa, most_Pa[i]))


@kernel()
def pressures_for(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    load: FloatArray,
    dead_band_Pa: float,
    least_Pa: FloatArray,
    most_Pa: FloatArray,
    wanted_1_m: FloatArray,
    stretch: float,
    pressure_Pa: FloatArray,
    given: FloatArray,
) -> bool:
    """Pressures (4,) for a curvature (2,) and a stretch (NaN: whatever goes with least pressure), and what they give.

    What loads the wall are pressures less the dead band. False where the pressures have no equilibrium.
    """
    chambers = load.shape[1]
    least_load, room, extra = np.empty(chambers), np.empty(chambers), np.empty(chambers)
    for i in range(chambers):
        least_load[i] = max(least_Pa[i] - dead_band_Pa, 0.0)
        room[i] = max(most_Pa[i] - dead_band_Pa, 0.0) - least_load[i]
    stiffness, jacobian = np.empty((3, 3)), np.empty((3, chambers))
    strain = np.array([stretch, wanted_1_m[0], wanted_1_m[1]])
    if stretch > 0.0 and _holds(points, code, wall, load, least_load, room, strain, extra) == 0:
        _loaded(load, dead_band_Pa, least_Pa, most_Pa, least_load, extra, pressure_Pa)
        given[0], given[1], given[2] = 1.0, 0.0, 0.0
        return equilibrium_under(points, code, wall, load, dead_band_Pa, pressure_Pa, given, stiffness, jacobian)
    strain[0] = 1.0
    _invert(points, code, wall, load, least_load, room, strain, extra)
    _loaded(load, dead_band_Pa, least_Pa, most_Pa, least_load, extra, pressure_Pa)
    given[0], given[1], given[2] = 1.0, 0.0, 0.0
    if not equilibrium_under(points, code, wall, load, dead_band_Pa, pressure_Pa, given, stiffness, jacobian):
        return False
    missed = math.hypot(given[1] - wanted_1_m[0], given[2] - wanted_1_m[1])
    moved = False
    if missed > 1e-4 * math.hypot(wanted_1_m[0], wanted_1_m[1]) + _STRAIGHT_1_M:
        strain[:] = given
        moved = _invert_longer(points, code, wall, load, least_load, room, wanted_1_m, strain, extra)
    if stretch > strain[0]:
        _invert_stretched(points, code, wall, load, least_load, room, stretch, strain, extra)
        moved = True
    if not moved:
        return True
    _loaded(load, dead_band_Pa, least_Pa, most_Pa, least_load, extra, pressure_Pa)
    given[0], given[1], given[2] = 1.0, 0.0, 0.0
    return equilibrium_under(points, code, wall, load, dead_band_Pa, pressure_Pa, given, stiffness, jacobian)
