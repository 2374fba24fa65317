"""A closed loop without a bus: ideal roller, plant, pressure loop and sequencer, for the tests of the controllers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from controllers.interface import Command, Detection, Order, Recovery, SequencerState
from controllers.pressure_loop import PressureLoop, PressureLoopGains
from controllers.sequencer import Sequencer
from controllers.sequencer_parts import SequencerConfig
from sim.body import Motion
from sim.plant import Plant
from softbot.faults import Fault
from softbot.robot import Robot, load_robot

CYCLE_S = 0.01


class IdealRoller:
    """The kinematic limit of a twin: the C lies flat and the material rolls so that its curvature stays level."""

    step_s = 0.005

    def __init__(self, radius_m: float) -> None:
        self._radius_m = radius_m
        self._strain = np.array([1.0, 0.0, 0.0])
        self._rest = self._strain
        self.roll_rad, self._rate_rad_s, self._side, self._y_m = 0.0, 0.0, 0, 0.0

    def set_rest(self, strain: Any, _stiffness: Any) -> None:
        self._rest = strain

    def step(self) -> None:
        self._strain = self._strain + 0.2 * (self._rest - self._strain)
        size = math.hypot(self._strain[1], self._strain[2])
        self._rate_rad_s = 0.0
        if size < 0.8:
            self._side = 0
        else:
            direction = math.atan2(self._strain[2], self._strain[1])
            if self._side == 0:
                self._side = 1 if math.cos(direction + self.roll_rad) >= 0.0 else -1
            level = (0.0 if self._side > 0 else math.pi) - direction
            turn = math.remainder(level - self.roll_rad, 2.0 * math.pi)
            turn = min(max(turn, -0.3), 0.3)
            self.roll_rad += turn
            self._rate_rad_s = turn / self.step_s
        self._y_m -= self._rate_rad_s * self._radius_m * self.step_s

    def strain(self) -> Any:
        return self._strain

    def motion(self) -> Motion:
        c, s = math.cos(self.roll_rad), math.sin(self.roll_rad)
        return Motion(
            rotation=np.array([[0.0, 0.0, 1.0], [c, -s, 0.0], [s, c, 0.0]]),
            angular_velocity_rad_s=np.array([self._rate_rad_s, 0.0, 0.0]),
            mid_velocity_m_s=np.array([0.0, -self._rate_rad_s * self._radius_m, 0.0]),
            centre_of_mass_m=np.array([0.0, self._y_m, self._radius_m]),
            stretch=float(self._strain[0]),
            curvature_1_m=self._strain[1:].copy(),
            chord=np.array([1.0, 0.0, 0.0]),
            angular_momentum_kg_m2_s=np.zeros(3),
        )

    def shape(self) -> tuple[Any, Any]:
        return np.zeros((2, 3)), np.zeros((2, 3))

    def close(self) -> None:
        pass


@dataclass
class LoopRun:
    """What a closed-loop run left behind; one row a cycle."""

    t_s: list[float] = field(default_factory=list)
    revolutions: list[float] = field(default_factory=list)
    states: list[SequencerState] = field(default_factory=list)
    setpoint_Pa: list[Any] = field(default_factory=list)
    pressure_Pa: list[Any] = field(default_factory=list)
    bend_direction_rad: list[float] = field(default_factory=list)
    detections: list[Detection] = field(default_factory=list)
    recoveries: list[Recovery] = field(default_factory=list)

    def turned(self, from_s: float, to_s: float) -> float:
        """Revolutions between two times."""
        t = np.array(self.t_s)
        r = np.array(self.revolutions)
        return float(np.interp(to_s, t, r) - np.interp(from_s, t, r))


@pytest.fixture(scope="session")
def robot() -> Robot:
    return load_robot("default")


@pytest.fixture(scope="session")
def with_other_valves(robot: Robot) -> Callable[[int], Robot]:
    """`with_other_valves(seed)`: the robot, its valves' conductances up to 20 % from what its file says."""

    def make(seed: int) -> Robot:
        random, nominal = np.random.default_rng(seed), robot.pneumatics
        other: dict[str, Any] = {
            name: tuple(random.uniform(0.8, 1.2, 4) * getattr(nominal, name))
            for name in ("supply_valve_conductance_m3_s_Pa", "exhaust_valve_conductance_m3_s_Pa")
        }
        return robot.model_copy(update={"pneumatics": replace(nominal, **other)})

    return make


@pytest.fixture(scope="session")
def closed_loop(robot: Robot) -> Callable[..., LoopRun]:
    """`closed_loop(duration_s, orders, faults, seed, **config)` → LoopRun.

    real: the robot that is there, where it is not the one that is believed in; heard: whether the sequencer hears the
    readings of a cycle.
    """

    def run(
        duration_s: float,
        *,
        command: Command = Command.LEFT,
        speed_rev_s: float | None = 0.5,
        distance_m: float | None = None,
        faults: tuple[Fault, ...] = (),
        seed: int = 0,
        orders: tuple[tuple[float, Order], ...] = (),
        real: Robot = robot,
        heard: Callable[[int], bool] = lambda cycle: True,
        **config: Any,
    ) -> LoopRun:
        twin = IdealRoller(robot.radius_m)
        plant = Plant(real, twin, faults, 9.81, seed)
        gains = PressureLoopGains(proportional_1_s=20.0, integral_1_s2=20.0, sample_s=CYCLE_S, model_lag_s=0.03)
        valves = PressureLoop(gains, robot.pneumatics, 62e-6)
        sequencer = Sequencer(SequencerConfig(robot, **config))
        sequencer.order(Order(command, speed_rev_s, distance_m), 0.0)
        pending = list(orders)
        is_armed = False
        result = LoopRun()
        output = None
        for cycle in range(round(duration_s / CYCLE_S)):
            t_s = cycle * CYCLE_S
            while pending and pending[0][0] <= t_s:
                sequencer.order(pending.pop(0)[1], t_s)
            readings = plant.read_sensors()
            sequencer.armed(is_armed)
            if output is None or heard(cycle):
                output = sequencer.update(t_s, readings)
                result.detections += output.detections
                result.recoveries += output.recoveries
            is_armed = output.wants_armed
            if is_armed:
                opening = valves.step(output.setpoint_Pa, readings.pressure_Pa, readings.supply_Pa)
            else:
                valves.reset()
                opening = np.full(4, -1.0)
            plant.advance(opening, is_armed, 2)
            result.t_s.append(plant.t_s)
            result.revolutions.append(twin.roll_rad / (2.0 * math.pi))
            result.states.append(output.state)
            result.setpoint_Pa.append(output.setpoint_Pa)
            result.pressure_Pa.append(plant.pressure_Pa.copy())
            curvature = plant.motion.curvature_1_m
            result.bend_direction_rad.append(math.atan2(curvature[1], curvature[0]))
        return result

    return run
