"""The rod twin's memory: state, tables and scratch of one rod as views of a single array.

A compiled function takes one array in a microsecond and thirty of them in twenty. Coordinates are kept whole (six of
the base, three of each mode, the stretch where there is one), whichever of them a scene leaves to move: those are the
columns of the equations, listed in `Layout`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from sim.rod_rule import Rule

FloatArray = NDArray[np.float64]

INERTIA_ROWS, CONTACT_ROWS = 7, 3
_LANE = 8  # every array starts on a multiple of this
DRIVE_SIZE = 16


FLAGS = 13
ALOFT, RESTED, TIME, WORK, ADVICE, KINKED, STEPS, ASLEEP, SOLVES, AUDITED, CEILING, LARGEST, CREATED = range(FLAGS)
"""Places of `State.flag`."""


class Layout(NamedTuple):
    """Sizes of a rod: what its arrays are shaped by."""

    modes: int
    points: int
    """Looked at: both halves, or one of a tube that mirrors itself."""
    half: int
    """Points on a half."""
    strains: int
    """Strain coordinates: three a mode, and the stretch where there is one."""
    base: int
    """Columns of the base: 6; 3 of a tube that mirrors itself; 0 of a clamped one."""
    columns: int
    """Coordinates that move."""
    spots: int
    """Contacts that one point may have at once."""
    resists: int
    """1 where rolling is resisted, else 0."""


class Physics(NamedTuple):
    """The constants of a scene. Contact constants are per unit mass of the tube."""

    step_s: float
    tolerance: float
    radius_m: float
    tightest_1_m: float
    """Curvature at which a kinked tube resists again: its inner side folds, or its ends meet."""
    length_m: float
    mass_kg: float
    gravity_x_m_s2: float
    gravity_y_m_s2: float
    gravity_z_m_s2: float
    damping_time_s: float
    bending_N_m2: float
    softening_m2: float
    """a of the bending moment EI(κ − aκ³)."""
    mirrored: bool
    stretches: bool
    viscous: bool
    ground: int
    """Shape of the ground, as `sim.rod_ground` numbers them."""
    ground_a_m: float
    ground_b_m: float
    """What that shape needs."""
    grain: int
    """Axis along which the ground is straight: 0 or 1."""
    friction: float
    """Coefficient, or with `viscous` the drag over the mass per length [1/s]."""
    resistance_m2_s2: float
    """Moment that resists rolling over the mass."""
    contact_stiffness_1_s2: float
    contact_damping_1_s: float
    sleep_speed_m_s: float


class State(NamedTuple):
    """What a step changes, and the rest strains it is driven by. n points, s strain coordinates, c
    contacts of a point."""

    position_m: FloatArray
    """Middle, shape (3,)."""
    rotation: FloatArray
    """Mid cross-section, columns e1, e2, t, shape (3, 3)."""
    strain: FloatArray
    """Modes' w, three each, and the stretch where there is one, shape (s,)."""
    velocity: FloatArray
    """Of the middle, world axes; angular, world axes; of the strains; shape (6 + s,)."""
    momentum: FloatArray
    """Linear, and angular about the centre of mass, world axes, shape (6,)."""
    flag: FloatArray
    """0: 1 when nothing touched in the last step; 1: seconds at rest; 2: time [s]; 3: actuators' work [J]; 4: step that
    the last one left as advice [s]; 5: time of the first kink [s], or −1; 6: steps taken; 7: 1 while asleep;
    8: solves of the equations; 9: steps whose energy is to be audited one by one, 1: none, 0: none was yet; 10: what
    the energy less the work must not exceed [J]; 11: largest kinetic and elastic energy so far [J]; 12: energy that
    steps have made and that was taken out again [J]; shape (13,).
    """
    rest_strain: FloatArray
    """Shape (s,)."""
    lagged_1_m: FloatArray
    """Curvature that a lagging drive has reached, body frame, shape (2,)."""
    stiffness: FloatArray
    """∂²(elastic energy)/∂strain², shape (s, s)."""
    modal_rate_1_s2: FloatArray
    """Square of the natural frequency of each coordinate by itself, shape (6 + s,)."""
    push_N: FloatArray
    """Outside forces on the points, world axes, shape (n, 3)."""
    push_N_m: FloatArray
    """Outside moments on the sections there, world axes, shape (n, 3)."""
    gain: FloatArray
    """Velocity gained in the last step over its length, for the error of the next, shape (columns,)."""


class Contacts(NamedTuple):
    """What a step knows of the contacts; the first three last from step to step. n points, d columns, c contacts of a
    point."""

    load_m_s2: FloatArray
    """Normal contact force over mass of each contact, shape (c, n)."""
    bristle_m: FloatArray
    """Elastic part of each contact's sliding, along the grain and across, shape (2, c, n)."""
    roll_bristle: FloatArray
    """Elastic part of each point's rolling, shape (n,) [rad]."""
    rows: FloatArray
    """Rows of contact: three of each contact, one of rolling where it is resisted, shape (d, lines, n)."""
    drive: FloatArray
    """Their right side, shape (lines, n)."""
    ends: FloatArray
    """Load, sliding along the grain and across at the end of the step, share of sticking asked for, shape (4, n)."""
    gap_m: FloatArray
    """Of each contact at the end of the step if it moves on as it does, shape (c, n)."""
    normal: FloatArray
    """Of the ground at each contact, along a and z, shape (2, c, n)."""
    approach: FloatArray
    """Velocity of each contact if it moves on: normal, along the grain, across, shape (3, c, n)."""
    grip: FloatArray
    """Of each contact: 1 while it carries load; share of sticking; the same for rolling; shape (3, c, n)."""


class Work(NamedTuple):
    """Scratch of a step. n points, m modes, s strains, d columns, c contacts of a point."""

    column: FloatArray
    """Coordinate of each column, as a number of `velocity`, shape (d,)."""
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
    """Integrands of A and B of each strain column, shape (d, 2, 3, n)."""
    swept: FloatArray
    """A and B, shape (d, 2, 3, n)."""
    rows: FloatArray
    """G, shape (d, 7, n)."""
    rate: FloatArray
    """G u, shape (7, n)."""
    foretold: FloatArray
    """G u at the middle of the step as the last step foretells it, shape (7, n)."""
    ahead: FloatArray
    """G u + (1 − θ) h b: what moves on steadily has at the end of the step, shape (7, n)."""
    change: FloatArray
    """G Δ, shape (7, n)."""
    bias: FloatArray
    """Right side of the inertia rows: −h b and outside forces, shape (7, n)."""
    triple: FloatArray
    """Vectors along the tube, shape (4, 3, n)."""
    arm_m: FloatArray
    """Centre of mass from the middle, shape (3,)."""
    inertia: FloatArray
    """GᵀG of the inertia rows, shape (d, d)."""
    matrix: FloatArray
    """Shape (d, d)."""
    vector: FloatArray
    """Shape (d,)."""
    mean: FloatArray
    """Velocity that moves the rod in the step, all coordinates, shape (6 + s,)."""
    before: FloatArray
    """Velocity at the start of the step, all coordinates, shape (6 + s,)."""
    off: FloatArray
    """Strains off their rest, θ of the step on, and damping, shape (s,)."""
    theta: FloatArray
    """Weight of the step's end of each coordinate, shape (6 + s,), and the step it was made for."""


@register_jitable
def _line(memory: FloatArray, at: int, size: int) -> tuple[FloatArray, int]:
    return memory[at : at + size], at + (size + _LANE - 1) // _LANE * _LANE


def _lines(*sizes: int) -> list[int]:
    """Where arrays of these sizes begin, one after another, and where the last one ends."""
    starts = [0]
    for size in sizes:
        starts.append(starts[-1] + (size + _LANE - 1) // _LANE * _LANE)
    return starts


class Instants(NamedTuple):
    """What pose, shape and motion of a rod follow from, at many instants: the beginning of a rod's memory, as views.

    Axes as in `State`, behind those of the instants.
    """

    position_m: FloatArray
    rotation: FloatArray
    strain: FloatArray
    velocity: FloatArray
    momentum: FloatArray
    flag: FloatArray


def _instant_sizes(layout: Layout) -> tuple[int, ...]:
    return 3, 9, layout.strains, 6 + layout.strains, 6, FLAGS


def instant_size(layout: Layout) -> int:
    """Numbers that an instant takes."""
    return _lines(*_instant_sizes(layout))[-1]


def instants(memory: FloatArray, layout: Layout) -> Instants:
    """Views of instants, shape (…, instant_size); of a rod's whole memory, its own."""
    sizes = _instant_sizes(layout)
    lines = [memory[..., at : at + size] for at, size in zip(_lines(*sizes), sizes, strict=False)]
    lines[1] = lines[1].reshape(*lines[1].shape[:-1], 3, 3)
    return Instants(*lines)


@register_jitable
def carve(memory: FloatArray, layout: Layout) -> tuple[State, Rule, Contacts, Work, int]:
    """The views of a rod's memory, and the length used. It begins with what `Instants` has, in that order."""
    modes, points, half, strains = layout.modes, layout.points, layout.half, layout.strains
    columns = layout.columns
    spots = layout.spots
    touches = spots * points
    size, at = 6 + strains, 0
    pairs = modes * (modes - 1) // 2
    position_m, at = _line(memory, at, 3)
    flat, at = _line(memory, at, 3 * 3)
    rotation = flat.reshape(3, 3)
    strain, at = _line(memory, at, strains)
    velocity, at = _line(memory, at, size)
    momentum, at = _line(memory, at, 6)
    flag, at = _line(memory, at, FLAGS)
    flat, at = _line(memory, at, touches)
    load_m_s2 = flat.reshape(spots, points)
    flat, at = _line(memory, at, 2 * touches)
    bristle_m = flat.reshape(2, spots, points)
    roll_bristle, at = _line(memory, at, points)
    rest_strain, at = _line(memory, at, strains)
    lagged_1_m, at = _line(memory, at, 2)
    flat, at = _line(memory, at, strains * strains)
    stiffness = flat.reshape(strains, strains)
    modal_rate_1_s2, at = _line(memory, at, size)
    flat, at = _line(memory, at, points * 3)
    push_N = flat.reshape(points, 3)
    flat, at = _line(memory, at, points * 3)
    push_N_m = flat.reshape(points, 3)
    gain, at = _line(memory, at, columns)
    root_mass, at = _line(memory, at, points)
    inverse_root, at = _line(memory, at, points)
    outward, at = _line(memory, at, points)
    flat, at = _line(memory, at, modes * points)
    mode = flat.reshape(modes, points)
    flat, at = _line(memory, at, half * half)
    integral = flat.reshape(half, half)
    flat, at = _line(memory, at, points * modes)
    turn = flat.reshape(points, modes)
    flat, at = _line(memory, at, points * pairs)
    turn_pair = flat.reshape(points, pairs)
    column, at = _line(memory, at, columns)
    strain_, at = _line(memory, at, strains)
    flat, at = _line(memory, at, 3 * 3)
    rotation_ = flat.reshape(3, 3)
    flat, at = _line(memory, at, 3 * 3 * points)
    section = flat.reshape(3, 3, points)
    flat, at = _line(memory, at, 3 * points)
    place_m = flat.reshape(3, points)
    flat, at = _line(memory, at, 3 * 3 * points)
    cross = flat.reshape(3, 3, points)
    flat, at = _line(memory, at, columns * 6 * points)
    density = flat.reshape(columns, 2, 3, points)
    flat, at = _line(memory, at, columns * 6 * points)
    swept = flat.reshape(columns, 2, 3, points)
    flat, at = _line(memory, at, columns * INERTIA_ROWS * points)
    rows = flat.reshape(columns, INERTIA_ROWS, points)
    flat, at = _line(memory, at, INERTIA_ROWS * points)
    rate = flat.reshape(INERTIA_ROWS, points)
    flat, at = _line(memory, at, INERTIA_ROWS * points)
    foretold = flat.reshape(INERTIA_ROWS, points)
    flat, at = _line(memory, at, INERTIA_ROWS * points)
    ahead = flat.reshape(INERTIA_ROWS, points)
    flat, at = _line(memory, at, INERTIA_ROWS * points)
    change = flat.reshape(INERTIA_ROWS, points)
    flat, at = _line(memory, at, INERTIA_ROWS * points)
    bias = flat.reshape(INERTIA_ROWS, points)
    lines = CONTACT_ROWS * spots + layout.resists
    flat, at = _line(memory, at, columns * lines * points)
    contact = flat.reshape(columns, lines, points)
    flat, at = _line(memory, at, lines * points)
    drive = flat.reshape(lines, points)
    flat, at = _line(memory, at, 4 * points)
    ends = flat.reshape(4, points)
    flat, at = _line(memory, at, 4 * 3 * points)
    triple = flat.reshape(4, 3, points)
    arm_m, at = _line(memory, at, 3)
    flat, at = _line(memory, at, touches)
    gap_m = flat.reshape(spots, points)
    flat, at = _line(memory, at, 2 * touches)
    normal = flat.reshape(2, spots, points)
    flat, at = _line(memory, at, 3 * touches)
    approach = flat.reshape(3, spots, points)
    flat, at = _line(memory, at, 3 * touches)
    grip = flat.reshape(3, spots, points)
    flat, at = _line(memory, at, columns * columns)
    inertia = flat.reshape(columns, columns)
    flat, at = _line(memory, at, columns * columns)
    matrix = flat.reshape(columns, columns)
    vector, at = _line(memory, at, columns)
    mean, at = _line(memory, at, size)
    before, at = _line(memory, at, size)
    off, at = _line(memory, at, strains)
    theta, at = _line(memory, at, size + 1)
    state = State(
        position_m, rotation, strain, velocity, momentum, flag, rest_strain, lagged_1_m, stiffness, modal_rate_1_s2,
        push_N, push_N_m, gain,
    )  # fmt: skip
    rule = Rule(root_mass, inverse_root, outward, mode, integral, turn, turn_pair)
    contacts = Contacts(
        load_m_s2, bristle_m, roll_bristle, contact, drive, ends, gap_m, normal, approach, grip
    )  # fmt: skip
    work = Work(
        column, strain_, rotation_, section, place_m, cross, density, swept, rows, rate, foretold, ahead, change, bias,
        triple, arm_m, inertia, matrix, vector, mean, before, off, theta,
    )  # fmt: skip
    return state, rule, contacts, work, at


def rod_memory(layout: Layout) -> FloatArray:
    """Zeroed memory of the right length for a rod."""
    modes, points, size = layout.modes, layout.points, 6 + layout.strains
    enough = np.zeros(200 * (points + 1) * (modes + 10) + (30 * points + 4 * size + 40) * (size + 6) * layout.spots)
    return np.zeros(carve(enough, layout)[4])
