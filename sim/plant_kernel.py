"""One control period of the plant in compiled code: faults, gas, wall, and where the twin is a rod, its motion too.

`gas_and_wall` takes one step: what is wrong now, the gas balance at the volumes that the robot's shape leaves, what
the chambers remember where they do, the actuator law's rest strains and stiffness at the pressures felt. `rod_period`
does so for all steps of a control period and moves the rod between. The rod's own kernel is handed in as a function:
it takes long to compile, and so is compiled once.

Softening scales the wall around a chamber: the quarter of the section nearest to it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.motion_rows import ROW_SIZE
from sim.rod import RodTwin
from sim.rod_drive import hold
from sim.rod_kernel import play
from sim.rod_memory import Physics, carve
from sim.rod_rest import set_rest
from softbot.actuator import ActuatorLaw
from softbot.actuator_equilibrium import solve_strain
from softbot.cross_section import CHAMBER_ANGLES_RAD
from softbot.faults import CHAMBER_COUNT, CONDITIONS_SIZE
from softbot.kernel_compiler import kernel
from softbot.kernel_entry import Handed, handed
from softbot.memory.chain import advance
from softbot.plant_conditions import LOAD_FACTOR, WALL_FACTOR, conditions_at
from softbot.pneumatics import PRESSURES_SIZE, STATE_SIZE, step_in_place
from softbot.robot import Robot

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

PLANT = np.dtype(
    [
        ("gas", np.float64, STATE_SIZE),
        ("pressure_Pa", np.float64, PRESSURES_SIZE),
        ("strain", np.float64, 3),
        ("rest", np.float64, 3),
        ("stiffness", np.float64, (3, 3)),
        ("load", np.float64, 3),
        ("volume_m3", np.float64, CHAMBER_COUNT),
        ("wall_factor", np.float64, CHAMBER_COUNT),
        ("felt_Pa", np.float64, CHAMBER_COUNT),
    ],
    align=True,
)
"""State of a plant as a record: gas, gauge pressures (four chambers, manifold), strains (ℓ, k1, k2) that the robot has
and those that its section would rest at, tangent stiffness; scratch; pressures that the wall feels, through memory."""

DONE, NO_GAS_BALANCE, NO_SECTION, ROD_LOST = range(4)
"""What a kernel of the plant returns."""


class PlantParts(NamedTuple):
    """What a plant is made of, as compiled code takes it."""

    pneumatics: FloatArray
    section: tuple[Any, ...]
    """The wall as the actuator law's kernels take it; its points are this plant's own."""
    sound_areas_m2: FloatArray
    """Area weights of the wall's points while nothing has softened, shape (n,)."""
    nearest_chamber: NDArray[np.int64]
    """Of each point of the wall, shape (n,)."""
    load: FloatArray
    """B of the actuator law, shape (3, 4)."""
    dead_band_Pa: float
    length_m: float
    twisting_stiffness_N_m2: float
    faults: FloatArray
    """Rows of `softbot.plant_conditions.faults_array`."""
    chamber_memory: FloatArray
    """What the chambers remember, as `softbot.memory.chain.Memory.numbers`; empty for a robot without memory."""
    chamber_state: FloatArray
    """Its state, shape (4, n), this plant's own; moved on with the plant."""


def plant_parts(robot: Robot, law: ActuatorLaw, faults: FloatArray) -> PlantParts:
    """The parts of a robot's plant."""
    memory = robot.actuator_memory()
    points, *wall = law._points.copy(), *law._material()
    angle = np.arctan2(points[:, 1], points[:, 0])
    off = np.abs(np.angle(np.exp(1j * (angle[:, None] - np.array(CHAMBER_ANGLES_RAD)))))
    return PlantParts(
        robot.pneumatics.as_arrays(),
        (points, *wall),
        points[:, 2].copy(),
        np.argmin(off.round(9), axis=1).astype(np.int64),
        law.load_matrix,
        float(law.dead_band_Pa),
        float(robot.length_m),
        float(robot.twisting_stiffness),
        faults,
        np.empty(0) if memory is None else memory.numbers,
        np.empty((CHAMBER_COUNT, 0)) if memory is None else memory.rest(),
    )


def plant_memory(strain: FloatArray, gas: FloatArray, supply_Pa: float) -> Any:
    """Memory of a plant at rest with its chambers vented, shape (1,) of PLANT."""
    memory = np.zeros(1, PLANT).view(np.recarray)
    own = memory[0]
    own["gas"], own["strain"], own["rest"] = gas, strain, (1.0, 0.0, 0.0)
    own["pressure_Pa"][CHAMBER_COUNT] = supply_Pa
    own["wall_factor"] = 1.0
    return memory


class RodParts(NamedTuple):
    """A rod as its kernel takes it."""

    memory: FloatArray
    places: IntArray
    shares: FloatArray
    """Of the bending energy in each mode, shape (modes,)."""
    stretches: bool
    step_s: float


def rod_parts(rod: RodTwin) -> RodParts:
    """The parts of a rod that `rod_period` moves."""
    return RodParts(
        rod._memory,
        rod._places,
        np.ascontiguousarray(rod._shares, dtype=np.float64),
        bool(rod._physics.stretches),
        rod.step_s,
    )


HOLD = hold()
"""A drive that leaves the rest strains as they are."""
NO_ROWS: FloatArray = np.empty((0, ROW_SIZE))


@kernel(nogil=True)
def gas_and_wall(
    parts: PlantParts,
    memory: Any,
    conditions: FloatArray,
    opening: FloatArray,
    main_supply_open: bool,
    t_s: float,
    step_s: float,
) -> int:
    """One step of gas and wall under the faults of the time t_s; memory[0] (PLANT) and conditions are moved."""
    own = memory[0]
    conditions_at(t_s, parts.faults, conditions)
    section, load = parts.section, parts.load
    points = section[0]
    softened = False
    for i in range(CHAMBER_COUNT):
        volume = 0.0
        for a in range(3):
            volume += load[a, i] * own.strain[a]
        own.volume_m3[i] = parts.length_m * volume
        softened = softened or own.wall_factor[i] != conditions[WALL_FACTOR + i]
    if softened:
        for i in range(CHAMBER_COUNT):
            own.wall_factor[i] = conditions[WALL_FACTOR + i]
        for n in range(points.shape[0]):
            points[n, 2] = parts.sound_areas_m2[n] * own.wall_factor[parts.nearest_chamber[n]]
    failed = step_in_place(
        own.gas,
        own.pressure_Pa,
        opening,
        main_supply_open,
        own.volume_m3,
        step_s,
        conditions[:CONDITIONS_SIZE],
        parts.pneumatics,
    )
    if failed:
        return NO_GAS_BALANCE
    for a in range(3):
        own.load[a] = 0.0
    for i in range(CHAMBER_COUNT):
        own.felt_Pa[i] = own.pressure_Pa[i]
    if parts.chamber_memory.size > 0:
        advance(parts.chamber_memory, parts.chamber_state, own.pressure_Pa, step_s, own.felt_Pa)
    for i in range(CHAMBER_COUNT):
        pressure = own.felt_Pa[i]
        effective_Pa = max(pressure - parts.dead_band_Pa, 0.0) + min(pressure, 0.0)
        for a in range(3):
            own.load[a] += load[a, i] * effective_Pa * conditions[LOAD_FACTOR + i]
    if not solve_strain(*section, own.load, own.rest, own.stiffness):
        return NO_SECTION
    return DONE


# another kernel in its closure would never be found again in numba's cache: each has a name of its own
@kernel(nogil=True)
def rod_period(
    play: Any,
    parts: PlantParts,
    memory: Any,
    conditions: FloatArray,
    rod: RodParts,
    physics: Physics,
    hold_drive: FloatArray,
    no_rows: FloatArray,
    opening: FloatArray,
    main_supply_open: bool,
    first: int,
    steps: int,
) -> int:
    """`steps` steps of the plant, the first of them step number `first` (from 0), with the valves as they are."""
    own = memory[0]
    state = carve(rod.memory, rod.places)[1]
    for step in range(first, first + steps):
        t_s = (step + 1) * rod.step_s
        done = gas_and_wall(parts, memory, conditions, opening, main_supply_open, t_s - 0.5 * rod.step_s, rod.step_s)
        if done != DONE:
            return done
        set_rest(
            state.strain, state.rest_strain, state.stiffness, state.flag, rod.shares, rod.stretches, parts.length_m,
            parts.twisting_stiffness_N_m2, own.rest, own.stiffness,
        )  # fmt: skip
        if play(rod.memory, rod.places, physics, hold_drive, 1, 1, no_rows, no_rows) < 1:
            return ROD_LOST
        own.strain[0] = state.strain[-1] if rod.stretches else 1.0
        own.strain[1], own.strain[2] = state.strain[1], -state.strain[0]
    return DONE


def handed_play(rod: RodTwin) -> Handed:
    """The rod's kernel, to be handed to `rod_period`."""
    return handed(play, rod._memory, rod._places, rod._physics, HOLD, 1, 1, NO_ROWS, NO_ROWS)


def failure(done: int, t_s: float, pressure_Pa: FloatArray) -> str:
    """What a kernel of the plant returned, in words."""
    if done == NO_GAS_BALANCE:
        return f"the gas balance of the chambers has no solution at t = {t_s:.3f} s"
    if done == NO_SECTION:
        return (
            f"no equilibrium of the section at pressures {pressure_Pa[:CHAMBER_COUNT].tolist()} Pa, t = {t_s:.3f} s: "
            "they crush or burst it"
        )
    assert done == ROD_LOST
    return (
        f"the rod twin left its range at t = {t_s:.4g} s (a strain or a speed is not finite, or the tube "
        "shrank to nothing): use a milder command or a heavier, softer or more damped robot"
    )
