"""The plant: valves, chambers and twin together; valve openings in, sensor readings out.

Each step: faults that are due, gas balance at the volumes that the robot's shape leaves, the actuator law's rest
strains and stiffness at the new pressures, one step of the twin. Nothing here knows who commands the valves.

A rod is moved in compiled code for the whole control period (`sim.plant_kernel`), any other twin step by step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.body import Motion, Twin
from sim.floor_faults import Floor
from sim.plant_kernel import (
    DONE,
    HOLD,
    NO_ROWS,
    failure,
    gas_and_wall,
    handed_play,
    plant_memory,
    plant_parts,
    rod_parts,
    rod_period,
)
from sim.rod import RodTwin
from sim.rod_kernel import play
from sim.sensors import Sensors
from softbot.errors import SimulationError
from softbot.faults import CHAMBER_COUNT, Fault
from softbot.kernel_entry import entry
from softbot.plant_conditions import PlantConditions
from softbot.pneumatics import initial_state
from softbot.robot import Robot
from softbot.sensing import Readings

FloatArray = NDArray[np.float64]


class Plant:
    """One robot with its pneumatics. `pressure_Pa` (5,): four chambers and the manifold, true gauge pressures.

    gravity_m_s2: its size, downwards, or the vector in the axes of the floor, shape (3,). Raises InputError for a fault
    between robot and floor where the twin has other bodies about it.
    """

    def __init__(
        self, robot: Robot, twin: Twin, faults: Sequence[Fault], gravity_m_s2: float | FloatArray, seed: int
    ) -> None:
        self.robot, self.twin = robot, twin
        self.law = robot.actuator_law()
        self.conditions = PlantConditions(faults)
        self.floor = Floor(self.conditions, twin)
        self.parts = plant_parts(robot, self.law, self.conditions.rows)
        self.sensors = Sensors(robot.sensors, gravity_m_s2, seed)
        strain = twin.strain()
        volumes = self.law.chamber_volumes_m3(robot.length_m, float(strain[0]), strain[1:])
        self.memory = plant_memory(
            strain, initial_state(robot.pneumatics, volumes), robot.pneumatics.supply_pressure_Pa
        )
        self._own: Any = self.memory[0]
        self.rod = rod_parts(twin) if isinstance(twin, RodTwin) else None
        self._rod_period: Callable[..., int] | None = None
        self._commanded = np.zeros(CHAMBER_COUNT)
        self.t_s = 0.0
        self._steps = 0

    @property
    def pressure_Pa(self) -> FloatArray:
        """Four chambers and the manifold, true gauge pressures now, shape (5,) [Pa]."""
        pressure: FloatArray = self._own["pressure_Pa"].copy()
        return pressure

    @property
    def gas(self) -> FloatArray:
        """State of the pneumatics, as `softbot.pneumatics` lays it out."""
        gas: FloatArray = self._own["gas"]
        return gas

    @property
    def steps(self) -> int:
        """Steps of the twin so far."""
        return self._steps

    @property
    def motion(self) -> Motion:
        """The robot now."""
        return self.twin.motion()

    def moved_to(self, steps: int) -> tuple[Fault, ...]:
        """Take note that compiled code has moved this plant on to `steps` steps; the faults that struck meanwhile."""
        self._steps = steps
        self.t_s = steps * self.twin.step_s
        return self.conditions.note(self.t_s - 0.5 * self.twin.step_s)

    def advance(self, opening: FloatArray, main_supply_open: bool, steps: int) -> tuple[Fault, ...]:
        """Run `steps` steps with the valves commanded to `opening` (4,); the faults that struck meanwhile."""
        self._commanded = opening
        self.floor.lay(self.t_s)
        if isinstance(self.twin, RodTwin):
            done = self._advance_rod(self.twin, np.ascontiguousarray(opening), bool(main_supply_open), steps)
            if done != DONE:
                raise SimulationError(failure(done, self.twin.t_s + self.twin.step_s, self.pressure_Pa))
        else:
            for step in range(self._steps, self._steps + steps):
                self._step(opening, bool(main_supply_open), (step + 1) * self.twin.step_s)
        return self.moved_to(self._steps + steps)

    def period_arguments(self, rod: RodTwin) -> tuple[Any, ...]:
        """What `sim.plant_kernel.rod_period` takes of this plant, from the second argument to the valves."""
        return self.parts, self.memory, self.conditions.packed, self.rod, rod._physics, HOLD, NO_ROWS

    def _advance_rod(self, rod: RodTwin, opening: FloatArray, main_supply_open: bool, steps: int) -> int:
        arguments = (*self.period_arguments(rod), opening, main_supply_open, self._steps, steps)
        if self._rod_period is None:
            self._rod_period = entry(rod_period, handed_play(rod), *arguments)
        return self._rod_period(play, *arguments)

    def _step(self, opening: FloatArray, main_supply_open: bool, t_s: float) -> None:
        own, step_s = self._own, self.twin.step_s
        done = gas_and_wall(
            self.parts,
            self.memory,
            self.conditions.packed,
            opening,
            main_supply_open,
            t_s - 0.5 * step_s,
            step_s,
        )
        if done != DONE:
            raise SimulationError(failure(done, t_s, self.pressure_Pa))
        self.twin.set_rest(own["rest"].copy(), own["stiffness"].copy())
        self.twin.step()
        own["strain"] = self.twin.strain()

    def read_sensors(self) -> Readings:
        """What the sensors say now; valves have no position sensor, so the board knows what it commanded."""
        return self.sensors.read(self.t_s, self.motion, self.pressure_Pa, self._commanded, self.conditions)
