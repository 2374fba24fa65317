"""The plant: valves, chambers and twin together; valve openings in, sensor readings out.

Each step: faults that are due, gas balance at the volumes that the robot's shape leaves, the actuator law's rest
strains and stiffness at the new pressures, one step of the twin. Nothing here knows who commands the valves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim.body import Motion, Twin
from sim.sensors import Sensors
from softbot.errors import SimulationError
from softbot.faults import CHAMBER_COUNT, Fault, PlantConditions
from softbot.pneumatics import PRESSURES_SIZE, initial_state, step_in_place
from softbot.robot import Robot
from softbot.sensing import Readings

FloatArray = NDArray[np.float64]


class Plant:
    """One robot with its pneumatics. `pressure_Pa` (5,): four chambers and the manifold, true gauge pressures."""

    def __init__(self, robot: Robot, twin: Twin, faults: Sequence[Fault], gravity_m_s2: float, seed: int) -> None:
        self._robot, self._twin = robot, twin
        self._law = robot.actuator_law()
        self._parameters = robot.pneumatics.as_arrays()
        self.conditions = PlantConditions(faults)
        self._sensors = Sensors(robot.sensors, gravity_m_s2, seed)
        self._strain = twin.strain()
        self._state = initial_state(robot.pneumatics, self._volumes_m3())
        self.pressure_Pa: FloatArray = np.zeros(PRESSURES_SIZE)
        self.pressure_Pa[CHAMBER_COUNT] = robot.pneumatics.supply_pressure_Pa
        self._commanded = np.zeros(CHAMBER_COUNT)
        self.t_s = 0.0
        self._steps = 0

    @property
    def steps(self) -> int:
        """Steps of the twin so far."""
        return self._steps

    @property
    def motion(self) -> Motion:
        """The robot now."""
        return self._twin.motion()

    def advance(self, opening: FloatArray, main_supply_open: bool, steps: int) -> tuple[Fault, ...]:
        """Run `steps` steps with the valves commanded to `opening` (4,); the faults that struck meanwhile."""
        struck: tuple[Fault, ...] = ()
        step_s = self._twin.step_s
        self._commanded = opening
        for _ in range(steps):
            self._steps += 1
            self.t_s = self._steps * step_s
            struck += self.conditions.advance(self.t_s - 0.5 * step_s)
            failed = step_in_place(
                self._state,
                self.pressure_Pa,
                opening,
                main_supply_open,
                self._volumes_m3(),
                step_s,
                self.conditions.pneumatic.packed,
                self._parameters,
            )
            if failed:
                raise SimulationError(f"the gas balance of the chambers has no solution at t = {self.t_s:.3f} s")
            rest = self._law.equilibrium(self.pressure_Pa[:CHAMBER_COUNT])
            self._twin.set_rest(np.array([rest.stretch, *rest.curvature_1_m]), rest.stiffness)
            self._twin.step()
            self._strain = self._twin.strain()
        return struck

    def read_sensors(self) -> Readings:
        """What the sensors say now; valves have no position sensor, so the board knows what it commanded."""
        return self._sensors.read(self.t_s, self.motion, self.pressure_Pa, self._commanded, self.conditions)

    def _volumes_m3(self) -> FloatArray:
        return self._law.chamber_volumes_m3(self._robot.length_m, float(self._strain[0]), self._strain[1:])
