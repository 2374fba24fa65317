"""The rod twin's memory: state, tables and scratch of one rod as views of a single array.

A compiled function takes one array in a microsecond and thirty of them in twenty.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from sim.rod_rule import Rule

FloatArray = NDArray[np.float64]

INERTIA_ROWS, CONTACT_ROWS = 7, 3
ROWS = INERTIA_ROWS + CONTACT_ROWS
_LANE = 8  # every array starts on a multiple of this


class Physics(NamedTuple):
    """The constants of a scene. Contact constants are per unit mass of the tube."""

    step_s: float
    radius_m: float
    mass_kg: float
    gravity_m_s2: float
    damping_time_s: float
    touches: bool
    stretches: bool
    viscous: bool
    friction: float
    """Coefficient, or with `viscous` the drag over the mass per length [1/s]."""
    contact_stiffness_1_s2: float
    contact_damping_1_s: float
    regular_speed: float
    """Regularising speed of Coulomb friction over the rolling speed."""
    least_speed_m_s: float
    """Its floor."""


class State(NamedTuple):
    """What a step changes, and the rest strains it is driven by. n: points, s: strain coordinates."""

    position_m: FloatArray
    """Middle, shape (3,)."""
    rotation: FloatArray
    """Mid cross-section, columns e1, e2, t, shape (3, 3)."""
    strain: FloatArray
    """Modes' w, three each, and the stretch where there is one, shape (s,)."""
    velocity: FloatArray
    """Of the middle, world axes; angular, world axes; of the strains; shape (6 + s,)."""
    load_m_s2: FloatArray
    """Normal contact force over mass of each point, shape (n,)."""
    momentum: FloatArray
    """Linear, and angular about the centre of mass, world axes, shape (6,)."""
    aloft: FloatArray
    """1 when nothing touched in the last step, else 0, shape (1,)."""
    rest_strain: FloatArray
    """Shape (s,)."""
    stiffness: FloatArray
    """∂²(elastic energy)/∂strain², shape (s, s)."""


class Work(NamedTuple):
    """Scratch of a step; after `observe` it holds the placed rod. n points, m modes, s strains, d = 6 + s."""

    strain: FloatArray
    """Strains the rod is placed with, shape (s,)."""
    rotation: FloatArray
    """And its mid cross-section, shape (3, 3)."""

    section: FloatArray
    """Column c of Q at the points, component k, shape (3, 3, n)."""
    place_m: FloatArray
    """r, from the middle, world axes, shape (3, n)."""
    cross: FloatArray
    """r × those columns, shape (3, 3, n)."""
    density: FloatArray
    """Integrands of A and B, shape (2, m, 3, 3, n)."""
    swept: FloatArray
    """A and B, shape (2, m, 3, 3, n)."""
    rows: FloatArray
    """G, shape (d, 10 n): rows of inertia, then of contact."""
    rate: FloatArray
    """G u, then the right side's rows, shape (10 n)."""
    triple: FloatArray
    """Vectors along the tube, shape (4, 3, n)."""
    arm_m: FloatArray
    """Centre of mass from the middle, shape (3,)."""
    gap_m: FloatArray
    """Of each point above the floor, shape (n,)."""
    grip: FloatArray
    """Roots of the normal and the sliding damper of each point, shape (2, n)."""
    matrix: FloatArray
    """Shape (d, d)."""
    vector: FloatArray
    """Shape (d,)."""


@register_jitable
def _line(memory: FloatArray, at: int, size: int) -> tuple[FloatArray, int]:
    return memory[at : at + size], at + (size + _LANE - 1) // _LANE * _LANE


@register_jitable
def carve(memory: FloatArray, modes: int, points: int, strains: int) -> tuple[State, Rule, Work, int]:
    """The views of a rod's memory, and the length used."""
    size, half, at = 6 + strains, points // 2, 0
    pairs = modes * (modes - 1) // 2
    position_m, at = _line(memory, at, 3)
    flat, at = _line(memory, at, 3 * 3)
    rotation = flat.reshape(3, 3)
    strain, at = _line(memory, at, strains)
    velocity, at = _line(memory, at, size)
    load_m_s2, at = _line(memory, at, points)
    momentum, at = _line(memory, at, 6)
    aloft, at = _line(memory, at, 1)
    rest_strain, at = _line(memory, at, strains)
    flat, at = _line(memory, at, strains * strains)
    stiffness = flat.reshape(strains, strains)
    root_mass, at = _line(memory, at, points)
    outward, at = _line(memory, at, points)
    flat, at = _line(memory, at, modes * points)
    mode = flat.reshape(modes, points)
    flat, at = _line(memory, at, half * half)
    integral = flat.reshape(half, half)
    flat, at = _line(memory, at, points * modes)
    turn = flat.reshape(points, modes)
    flat, at = _line(memory, at, points * pairs)
    turn_pair = flat.reshape(points, pairs)
    strain_, at = _line(memory, at, strains)
    flat, at = _line(memory, at, 3 * 3)
    rotation_ = flat.reshape(3, 3)
    flat, at = _line(memory, at, 3 * 3 * points)
    section = flat.reshape(3, 3, points)
    flat, at = _line(memory, at, 3 * points)
    place_m = flat.reshape(3, points)
    flat, at = _line(memory, at, 3 * 3 * points)
    cross = flat.reshape(3, 3, points)
    flat, at = _line(memory, at, 2 * modes * 3 * 3 * points)
    density = flat.reshape(2, modes, 3, 3, points)
    flat, at = _line(memory, at, 2 * modes * 3 * 3 * points)
    swept = flat.reshape(2, modes, 3, 3, points)
    flat, at = _line(memory, at, size * (ROWS * points))
    rows = flat.reshape(size, ROWS * points)
    rate, at = _line(memory, at, ROWS * points)
    flat, at = _line(memory, at, 4 * 3 * points)
    triple = flat.reshape(4, 3, points)
    arm_m, at = _line(memory, at, 3)
    gap_m, at = _line(memory, at, points)
    flat, at = _line(memory, at, 2 * points)
    grip = flat.reshape(2, points)
    flat, at = _line(memory, at, size * size)
    matrix = flat.reshape(size, size)
    vector, at = _line(memory, at, size)
    state = State(position_m, rotation, strain, velocity, load_m_s2, momentum, aloft, rest_strain, stiffness)
    rule = Rule(root_mass, outward, mode, integral, turn, turn_pair)
    work = Work(
        strain_,
        rotation_,
        section,
        place_m,
        cross,
        density,
        swept,
        rows,
        rate,
        triple,
        arm_m,
        gap_m,
        grip,
        matrix,
        vector,
    )
    return state, rule, work, at


def rod_memory(modes: int, points: int, strains: int) -> FloatArray:
    """Zeroed memory of the right length for a rod."""
    enough = np.zeros(100 * (points + 1) * (modes + 10) + (16 * points + strains + 6) * (strains + 6))
    return np.zeros(carve(enough, modes, points, strains)[3])
