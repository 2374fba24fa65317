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
from softbot.errors import InputError, SimulationError
from softbot.faults import CHAMBER_COUNT, Fault, FaultKind
from softbot.kernel_entry import entry
from softbot.plant_conditions import FRICTION_FACTOR, KERB_SHARE, PAYLOAD_SHARE, PlantConditions, conditions_at
from softbot.pneumatics import initial_state
from softbot.robot import Robot
from softbot.sensing import Readings

FloatArray = NDArray[np.float64]

ON_THE_FLOOR = frozenset({FaultKind.FRICTION_LOST, FaultKind.FRICTION_HIGH, FaultKind.PAYLOAD, FaultKind.OBSTACLE})
"""Faults that act between robot and floor; they change from one control period to the next, not within one."""


class Plant:
    """One robot with its pneumatics. `pressure_Pa` (5,): four chambers and the manifold, true gauge pressures.

    gravity_m_s2: its size, downwards, or the vector in the axes of the floor, shape (3,). Raises InputError for a fault
    between robot and floor where the twin is no rod.
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


_MOMENT_S = 1e-6
_KERB_AHEAD = 1.0  # of the radius, from the robot's side to the kerb


class Floor:
    """What faults change between robot and floor: friction, a weight that rests on the robot, a kerb in its way."""

    def __init__(self, conditions: PlantConditions, twin: Twin) -> None:
        self._faults = tuple(fault for fault in conditions.faults if fault.kind in ON_THE_FLOOR)
        if self._faults and not isinstance(twin, RodTwin):
            raise InputError(
                f"fault.kind = {str(self._faults[0].kind)!r}: only the rod twin alone on its floor can have that; "
                'take solver.twin = "rod" and no other bodies'
            )
        self._rows, self._scratch = conditions.rows, conditions.packed.copy()
        self._twin = twin
        self._sound = twin._physics.friction if isinstance(twin, RodTwin) else 0.0
        self._now = (1.0, 0.0)
        self._kerb_lies = False

    def changes_between(self, from_s: float, to_s: float) -> bool:
        """Whether the floor may be another at `to_s` than at `from_s`; for a moment more, as times are rounded."""
        return any(
            fault.t_s - _MOMENT_S <= to_s
            and (fault.period_s is not None or from_s <= fault.t_s + fault.ramp_s + _MOMENT_S)
            for fault in self._faults
        )

    def lay(self, t_s: float) -> None:
        """Make the floor what it is at `t_s`."""
        if not self._faults or not isinstance(self._twin, RodTwin):
            return
        conditions_at(t_s, self._rows, self._scratch)
        if self._scratch[KERB_SHARE] > 0.0 and not self._kerb_lies:
            _lay_kerb(self._twin, float(self._scratch[KERB_SHARE]))
            self._kerb_lies = True
        now = (float(self._scratch[FRICTION_FACTOR]), float(self._scratch[PAYLOAD_SHARE]))
        if now == self._now:
            return
        rod, self._now = self._twin, now
        rod._physics = rod._physics._replace(friction=self._sound * now[0])
        own = rod._physics
        weight_N = now[1] * np.array([own.gravity_x_m_s2, own.gravity_y_m_s2, own.gravity_z_m_s2])
        rod.push_N[:] = (rod._rule.root_mass**2)[:, None] * weight_N
        rod.wake()


def _lay_kerb(rod: RodTwin, share: float) -> None:
    """A step of a share of the radius, a radius ahead of the robot on the side to which it rolls; it rises outwards."""
    radius_m, motion = rod._physics.radius_m, rod.motion()
    ahead = 1.0 if motion.mid_velocity_m_s[1] >= 0.0 else -1.0
    front_m = float((ahead * rod.points()[0][1]).max()) + radius_m
    riser_m = ahead * max(front_m + _KERB_AHEAD * radius_m, radius_m)
    rod._physics = rod._physics._replace(ground_a_m=share * radius_m, ground_b_m=riser_m)
    rod.wake()
