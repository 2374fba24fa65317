"""The plant: valves, gas, wall and twin together, with a twin that simply takes the shape it is given."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sim.body import Motion
from sim.plant import Plant
from softbot.errors import SimulationError
from softbot.faults import Fault, FaultKind
from softbot.pneumatics import pressures
from softbot.robot import Robot, robot_from

OPEN_0 = np.array([1.0, 0.0, 0.0, 0.0])
VENT = -np.ones(4)


class ObedientTwin:
    """A robot without mass: it has its rest shape at once. Counts its steps."""

    def __init__(self) -> None:
        self._strain, self.stiffness, self.steps, self.step_s = np.array([1.0, 0.0, 0.0]), np.eye(3), 0, 0.002

    def set_rest(self, strain: np.ndarray, stiffness: np.ndarray) -> None:
        self._strain, self.stiffness = strain, stiffness

    def step(self) -> None:
        self.steps += 1

    def strain(self) -> np.ndarray:
        return self._strain

    def motion(self) -> Motion:
        zero = np.zeros(3)
        return Motion(np.eye(3), zero, zero, zero, self._strain[0], self._strain[1:], np.array([0.0, 0, 1]), zero)

    def shape(self) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros((2, 3)), np.zeros((2, 3))

    def close(self) -> None:
        """Holds nothing."""


@pytest.fixture
def robot(robot_table: dict[str, Any]) -> Robot:
    return robot_from(robot_table, "r.toml")


def plant_of(robot: Robot, *faults: Fault) -> tuple[Plant, ObedientTwin]:
    twin = ObedientTwin()
    return Plant(robot, twin, faults, 9.81, seed=0), twin


def test_plant_starts_vented_with_the_manifold_at_the_supply(robot: Robot) -> None:
    plant, _ = plant_of(robot)
    np.testing.assert_array_equal(plant.pressure_Pa, [0.0, 0.0, 0.0, 0.0, robot.pneumatics.supply_pressure_Pa])
    plant.advance(np.zeros(4), True, 20)
    np.testing.assert_allclose(plant.pressure_Pa[:4], 0.0, atol=1e-6)
    assert (plant.steps, plant.t_s) == (20, pytest.approx(0.04))


def test_open_valve_fills_its_chamber_and_bends_the_robot_away_from_it(robot: Robot) -> None:
    plant, twin = plant_of(robot)
    plant.advance(OPEN_0, True, 10)
    assert plant.pressure_Pa[0] > 1e3
    assert plant.pressure_Pa[1] == pytest.approx(plant.pressure_Pa[3])
    assert plant.pressure_Pa[1] < 0.0  # shut, and the tube is longer
    assert plant.pressure_Pa[2] > plant.pressure_Pa[1]  # shut, and on the inner side of the bend
    assert twin.strain()[1] < 0.0  # chamber 0 is at e1
    expected = robot.actuator_law().equilibrium(plant.pressure_Pa[:4])
    np.testing.assert_allclose(twin.strain(), [expected.stretch, *expected.curvature_1_m], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(twin.stiffness, expected.stiffness, rtol=1e-12, atol=1e-15)
    assert twin.steps == plant.steps == 10


def test_chambers_lose_gas_only_through_valves_and_pressures_fit_their_volumes(robot: Robot) -> None:
    plant, twin = plant_of(robot)
    plant.advance(OPEN_0, True, 15)
    plant.advance(np.zeros(4), True, 500)  # the valve lags behind its command
    before = plant.gas.copy()
    plant.advance(np.zeros(4), False, 40)
    np.testing.assert_allclose(plant.gas[4:8], before[4:8], rtol=1e-9)
    law = robot.actuator_law()
    volume = law.chamber_volumes_m3(robot.length_m, twin.strain()[0], twin.strain()[1:])
    np.testing.assert_allclose(pressures(plant.gas, volume, robot.pneumatics), plant.pressure_Pa, rtol=1e-3, atol=5)
    plant.advance(VENT, True, 500)
    np.testing.assert_allclose(plant.pressure_Pa[:4], 0.0, atol=50.0)


def test_shut_main_supply_starves_the_manifold(robot: Robot) -> None:
    plant, _ = plant_of(robot)
    fed, _ = plant_of(robot)
    for one, main_supply_open in ((plant, False), (fed, True)):
        one.advance(np.ones(4), main_supply_open, 300)
    assert fed.pressure_Pa[4] > 0.99 * robot.pneumatics.supply_pressure_Pa
    assert plant.pressure_Pa[4] < 0.8 * robot.pneumatics.supply_pressure_Pa
    assert plant.pressure_Pa[0] <= plant.pressure_Pa[4] * (1.0 + 1e-9)


def test_fault_strikes_once_at_its_step_and_acts(robot: Robot) -> None:
    plant, _ = plant_of(robot, Fault(0.0205, 0, FaultKind.RUPTURE), Fault(0.5, 1, FaultKind.LEAK))
    struck = [plant.advance(OPEN_0, True, 5) for _ in range(4)]
    assert [len(faults) for faults in struck] == [0, 0, 1, 0]
    assert struck[2][0].kind == FaultKind.RUPTURE
    healthy, _ = plant_of(robot)
    healthy.advance(OPEN_0, True, 20)
    assert plant.pressure_Pa[0] < 0.3 * healthy.pressure_Pa[0]


def test_sensors_see_the_plant_now(robot: Robot) -> None:
    plant, _ = plant_of(robot)
    plant.advance(OPEN_0, True, 15)
    reading = plant.read_sensors()
    assert reading.t_s == plant.t_s
    np.testing.assert_allclose(reading.pressure_Pa, plant.pressure_Pa[:4], atol=4000.0)
    assert reading.supply_Pa == pytest.approx(plant.pressure_Pa[4], abs=6000.0)
    np.testing.assert_array_equal(reading.opening, OPEN_0)  # as commanded: a valve has no sensor


def test_same_seed_gives_the_same_readings(robot: Robot) -> None:
    first, second = (plant_of(robot)[0].read_sensors() for _ in range(2))
    np.testing.assert_array_equal(first.pressure_Pa, second.pressure_Pa)


def test_gas_balance_that_is_no_longer_a_number_is_a_simulation_error(robot: Robot) -> None:
    plant, _ = plant_of(robot)
    with pytest.raises(SimulationError, match=r"gas balance .* at t = 0\.002 s"):
        plant.advance(np.array([np.nan, 0.0, 0.0, 0.0]), True, 1)


MEMORY = {
    "line": {"filling_conductance_m3_s_Pa": 2e-10, "venting_conductance_m3_s_Pa": 1e-10, "growth_1_Pa": 3e-6},
    "hysteresis": {"thresholds_Pa": [2e3, 8e3], "weights": [0.1, 0.1], "unloading_slope": 1.3},
    "creep": {"shares": [0.1], "times_s": [1.0]},
    "residual": {"share": 0.05, "growth_time_s": 5.0, "recovery_time_s": 30.0},
}


def test_section_rests_where_the_pressures_put_it_that_the_memory_lets_through(robot_table: dict[str, Any]) -> None:
    robot = robot_from({**robot_table, "memory": MEMORY}, "r.toml")
    plant, twin = plant_of(robot)
    law, memory = robot.actuator_law(), robot.actuator_memory()
    assert memory is not None
    state = memory.rest()
    for opening in (OPEN_0, VENT):
        for _ in range(60):
            plant.advance(opening, True, 1)
            state, felt = memory.step(state, plant.pressure_Pa[:4], twin.step_s)
            expected = law.equilibrium(felt)
            np.testing.assert_allclose(twin.strain(), [expected.stretch, *expected.curvature_1_m], atol=1e-9)
    assert felt[0] > plant.pressure_Pa[0] + 1e3  # a vented chamber's wall lags behind its sensor


def test_robot_without_memory_feels_its_pressures_and_keeps_no_state(robot: Robot) -> None:
    plant, twin = plant_of(robot)
    assert plant.parts.chamber_memory.size == plant.parts.chamber_state.size == 0
    plant.advance(OPEN_0, True, 30)
    expected = robot.actuator_law().equilibrium(plant.pressure_Pa[:4])
    np.testing.assert_allclose(twin.strain(), [expected.stretch, *expected.curvature_1_m], atol=1e-9)


def test_two_plants_of_one_robot_do_not_share_what_their_chambers_remember(robot_table: dict[str, Any]) -> None:
    robot = robot_from({**robot_table, "memory": MEMORY}, "r.toml")
    used, _ = plant_of(robot)
    used.advance(OPEN_0, True, 50)
    fresh, _ = plant_of(robot)
    assert np.all(fresh.parts.chamber_state == 0.0)
    assert np.any(used.parts.chamber_state != 0.0)
