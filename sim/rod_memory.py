"""The rod twin's memory: state, tables and scratch of one rod as views of a single array.

A compiled function takes one array in a microsecond and thirty of them in twenty. Coordinates are kept whole (six of
the base, three of each mode, the stretch where there is one), whichever of them a scene leaves to move: those are the
columns of the equations, listed in `Layout`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.rod_groups import Group, compiled_carving
from sim.rod_rule import Rule

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

INERTIA_ROWS, CONTACT_ROWS = 7, 3
_LANE = 8  # every array starts on a multiple of this
_LINES = 5  # of the table for each array


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


def _shapes(layout: Layout) -> dict[Any, tuple[tuple[int, ...], ...]]:
    """Of the arrays of each group, in their order in the memory. `Instants` are the first of them."""
    modes, points, half, strains, _, columns, spots, resists = layout
    size, pairs, lines = 6 + strains, modes * (modes - 1) // 2, CONTACT_ROWS * spots + resists
    along, contact = (points,), (spots, points)
    inertia = (INERTIA_ROWS, points)
    return {
        State: (
            (3,), (3, 3), (strains,), (size,), (6,), (FLAGS,), (strains,), (2,), (strains, strains), (size,),
            (points, 3), (points, 3), (columns,),
        ),
        Rule: (along, along, along, (modes, points), (half, half), (points, modes), (points, pairs)),
        Contacts: (
            contact, (2, *contact), along, (columns, lines, points), (lines, points), (4, points), contact,
            (2, *contact), (3, *contact), (3, *contact),
        ),
        Work: (
            (columns,), (strains,), (3, 3), (3, 3, points), (3, points), (3, 3, points), (columns, 2, 3, points),
            (columns, 2, 3, points), (columns, *inertia), inertia, inertia, inertia, inertia, inertia, (4, 3, points),
            (3,), (columns, columns), (columns, columns), (columns,), (size,), (size,), (strains,), (size + 1,),
        ),
    }  # fmt: skip


def _starts(shapes: Iterable[tuple[int, ...]]) -> list[int]:
    """Where arrays of these shapes begin, one after another, and where the last one ends."""
    starts = [0]
    for shape in shapes:
        starts.append(starts[-1] + (math.prod(shape) + _LANE - 1) // _LANE * _LANE)
    return starts


def _part(memory: FloatArray, at: int, shape: tuple[int, ...]) -> FloatArray:
    """A view of an array in memory, or of one in each of many memories."""
    return memory[..., at : at + math.prod(shape)].reshape(*memory.shape[:-1], *shape)


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


def _instant_shapes(layout: Layout) -> tuple[tuple[int, ...], ...]:
    return _shapes(layout)[State][: len(Instants._fields)]


def instant_size(layout: Layout) -> int:
    """Numbers that an instant takes."""
    return _starts(_instant_shapes(layout))[-1]


def instants(memory: FloatArray, layout: Layout) -> Instants:
    """Views of instants, shape (…, instant_size); of a rod's whole memory, its own."""
    shapes = _instant_shapes(layout)
    return Instants(*(_part(memory, at, shape) for at, shape in zip(_starts(shapes), shapes, strict=False)))


@lru_cache(maxsize=64)
def places(layout: Layout) -> IntArray:
    """The table of a rod's memory: its layout, then of each array where it begins and the lengths of four axes."""
    shapes = [shape for group in _shapes(layout).values() for shape in group]
    table = np.zeros((len(shapes), _LINES), dtype=np.int64)
    for line, at, shape in zip(table, _starts(shapes), shapes, strict=False):
        line[: 1 + len(shape)] = at, *shape
    return np.concatenate([np.array(layout, dtype=np.int64), table.ravel()])


def carve(memory: FloatArray, places: IntArray) -> tuple[Layout, State, Rule, Contacts, Work]:
    """The layout and the views of a rod's memory. It begins with what `Instants` has, in that order."""
    layout = Layout(*places[: len(Layout._fields)].tolist())
    table = iter(places[len(layout) :].reshape(-1, _LINES))
    groups: list[Any] = []
    for group, shapes in _shapes(layout).items():
        starts = [int(next(table)[0]) for _ in shapes]
        groups.append(group(*(_part(memory, at, shape) for at, shape in zip(starts, shapes, strict=True))))
    return (layout, *groups)


def carved_types() -> tuple[Group, ...]:
    """The types of what `carve` gives in compiled code."""
    some = Layout(1, 1, 1, 1, 1, 1, 1, 1)
    groups = [Group("Layout", {name: (line, 0) for line, name in enumerate(Layout._fields)})]
    line = len(some)
    for group, shapes in _shapes(some).items():
        fields = {}
        for name, shape in zip(group._fields, shapes, strict=True):
            fields[name] = line, len(shape)
            line += _LINES
        groups.append(Group(group.__name__, fields))
    return tuple(groups)


compiled_carving(carve, carved_types())


def rod_memory(layout: Layout) -> FloatArray:
    """Zeroed memory of the right length for a rod."""
    return np.zeros(_starts(shape for group in _shapes(layout).values() for shape in group)[-1])
