"""What the controller knows of its robot, as compiled code takes it: the wall's law, the gas, limits, a pressure table.

The controller needs the actuator law both ways in every cycle. Forwards (pressures → bend) it follows by Newton's
method from the cycle before. Backwards (bend → pressures) it looks up a table of the law's own inverse: a curvature
lies between the directions of two neighbouring chambers, and for each of the four quarters the table holds their two
pressures over direction and size. Bilinear between nodes 5.6° apart it is right to 0.2 % of the pressure limit.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from softbot.actuator import ActuatorLaw
from softbot.cross_section import CHAMBER_ANGLES_RAD, CHAMBERS
from softbot.kernel_compiler import kernel
from softbot.pneumatics import valve_mass_flow
from softbot.robot import Robot
from softbot.rolling import coulomb_advance_ratio

FloatArray = NDArray[np.float64]

USE_OF_LIMIT = 0.9
"""Share of the pressure limit that rolling uses; the rest is for regulating."""
LARGEST_DEFAULT_BEND_rad = math.pi
"""Half a circle: of a C that is closed further the ends come towards each other, and at a full circle it is a ring."""
_ANGLES, _SIZES = 17, 9
_FILLING_POINTS = 9
_QUARTER_RAD = 0.5 * math.pi


class RobotModel(NamedTuple):
    """One robot as its controller believes it to be."""

    section: tuple[Any, ...]
    """The wall as the actuator law's kernels take it."""
    load: FloatArray
    """B of the actuator law, shape (3, 4)."""
    dead_band_Pa: float
    length_m: float
    pressure_limit_Pa: float
    curvature_1_m: float
    """That rolling asks for."""
    largest_1_m: float
    """Size of the last nodes of the table."""
    pressures_Pa: FloatArray
    """Of the two chambers of a quarter, shape (4 quarters, angles, sizes, 2)."""
    co_contraction_Pa: float
    advance_m_rad: float
    """Way rolled for each radian of roll."""
    lag_s: float
    """By about this a chamber's pressure follows what is asked of it."""
    agility_1_s2: float
    """Angular acceleration of the roll where the C and a curvature that rolling asks for stand square to each other."""
    pneumatics: FloatArray
    """`PneumaticsParameters.as_arrays()`."""
    pressure_noise_Pa: float
    memory: FloatArray
    """What the chambers remember, as `softbot.memory.chain.Memory.numbers`; empty for a robot without memory."""
    behind_lines: FloatArray
    """The same for pressures at the chambers themselves, behind their lines."""


def robot_model(
    robot: Robot,
    bend_rad: float | None = None,
    co_contraction_Pa: float = 0.0,
    setpoint_rate_Pa_s: float = math.inf,
) -> RobotModel:
    """The model of a robot file.

    bend_rad: of the C to roll with [rad]; None: what every chamber can give, but at most `LARGEST_DEFAULT_BEND_rad`.
    setpoint_rate_Pa_s: by which the board's pressure loop lets a setpoint move at most.
    """
    law, memory = robot.actuator_law(), robot.actuator_memory()
    if bend_rad is None:
        most = largest_for_all_chambers_1_m(law, USE_OF_LIMIT * robot.max_pressure_Pa, co_contraction_Pa)
        curvature = min(most, LARGEST_DEFAULT_BEND_rad / robot.length_m)
    else:
        curvature = bend_rad / robot.length_m
    largest = 1.25 * curvature
    half_bend = 0.5 * curvature * robot.length_m
    return RobotModel(
        (law._points, *law._material()),
        law.load_matrix,
        float(law.dead_band_Pa),
        float(robot.length_m),
        float(robot.max_pressure_Pa),
        float(curvature),
        float(largest),
        _pressure_table(law, robot.max_pressure_Pa, co_contraction_Pa, largest),
        float(co_contraction_Pa),
        float(robot.radius_m * coulomb_advance_ratio(half_bend)),
        pressure_lag_s(robot, USE_OF_LIMIT * robot.max_pressure_Pa, setpoint_rate_Pa_s),
        float(curvature**2 * law.rest_bending_stiffness_N_m2 * robot.length_m / _rolling_inertia_kg_m2(robot)),
        robot.pneumatics.as_arrays(),
        float(robot.sensors.pressure_noise_Pa),
        np.empty(0) if memory is None else memory.numbers,
        np.empty(0) if memory is None else memory.behind_lines,
    )


def largest_for_all_chambers_1_m(law: ActuatorLaw, pressure_Pa: float, co_contraction_Pa: float) -> float:
    """The least that a chamber alone bends with `pressure_Pa`, the others at the co-contraction [1/m]."""
    weakest = math.inf
    for chamber in range(CHAMBERS):
        pressure = np.full(CHAMBERS, co_contraction_Pa)
        pressure[chamber] = pressure_Pa
        weakest = min(weakest, float(np.hypot(*law.equilibrium(pressure).curvature_1_m)))
    return weakest


def _rolling_inertia_kg_m2(robot: Robot) -> float:
    """Of a straight robot about the line on which it rolls [kg m²], as of a solid cylinder."""
    return 1.5 * robot.mass_kg * robot.radius_m**2


def pressure_lag_s(robot: Robot, pressure_Pa: float, setpoint_rate_Pa_s: float = math.inf) -> float:
    """Time constant of the chambers [s]: with valves fully open up to, or down by, 1 − 1/e of this pressure.

    Mean of filling and venting and of the chambers, each bending the robot alone, with the lag of the valves; the gas
    is isothermal and the manifold stays at the regulator's pressure, as in `softbot.pneumatics`. Where the setpoint
    takes longer for as much at its rate, that is the time.
    """
    gas, law = robot.pneumatics, robot.actuator_law()
    share = -math.expm1(-1.0)
    mean_s = 0.0
    for chamber in range(CHAMBERS):
        for begin_Pa, end_Pa in ((0.0, share * pressure_Pa), (pressure_Pa, (1.0 - share) * pressure_Pa)):
            absolute_Pa = np.linspace(begin_Pa, end_Pa, _FILLING_POINTS) + gas.atmospheric_pressure_absolute_Pa
            filled = np.zeros((_FILLING_POINTS, CHAMBERS))
            filled[:, chamber] = absolute_Pa - gas.atmospheric_pressure_absolute_Pa
            strain = law.equilibria(filled, along=True)[0]
            volume_m3 = gas.dead_volume_m3[chamber] + robot.length_m * (strain @ law.load_matrix[:, chamber])
            amount_J = absolute_Pa * volume_m3
            middle_Pa = 0.5 * (absolute_Pa[1:] + absolute_Pa[:-1])
            flow_kg_s = [_flow_kg_s(robot, chamber, one, begin_Pa < end_Pa) for one in middle_Pa.tolist()]
            mass_kg = np.abs(np.diff(amount_J)) / gas.gas_constant_times_temperature_J_kg
            mean_s += float(np.sum(mass_kg / np.array(flow_kg_s))) / (2 * CHAMBERS)
    return max(mean_s, share * pressure_Pa / setpoint_rate_Pa_s) + gas.valve_lag_s


def _flow_kg_s(robot: Robot, chamber: int, absolute_Pa: float, fills: bool) -> float:
    gas = robot.pneumatics
    if fills:
        conductance, pair = gas.supply_valve_conductance_m3_s_Pa, (gas.supply_pressure_absolute_Pa, absolute_Pa)
    else:
        conductance, pair = gas.exhaust_valve_conductance_m3_s_Pa, (absolute_Pa, gas.atmospheric_pressure_absolute_Pa)
    return float(valve_mass_flow(conductance[chamber], gas.critical_ratio, *pair, gas.temperature_K))


def _pressure_table(law: ActuatorLaw, limit_Pa: float, co_contraction_Pa: float, largest_1_m: float) -> FloatArray:
    table = np.zeros((CHAMBERS, _ANGLES, _SIZES, 2))
    for quarter in range(CHAMBERS):
        pair = quarter, (quarter + 1) % CHAMBERS
        for a in range(_ANGLES):
            # chamber i bends the robot towards α_i + π
            direction = CHAMBER_ANGLES_RAD[quarter] + math.pi + _QUARTER_RAD * a / (_ANGLES - 1)
            towards = np.array([math.cos(direction), math.sin(direction)])
            for s in range(_SIZES):
                found = law.pressures(
                    largest_1_m * s / (_SIZES - 1) * towards, limit_Pa=limit_Pa, co_contraction_Pa=co_contraction_Pa
                ).pressure_Pa
                table[quarter, a, s] = found[pair[0]], found[pair[1]]
    return table


@kernel()
def pressures_for(model: RobotModel, direction_rad: float, size_1_m: float, out_Pa: FloatArray) -> None:
    """Chamber pressures, shape (4,) [Pa], that bend the robot towards a body direction; beyond the table: its end."""
    table = model.pressures_Pa
    angles, sizes = table.shape[1] - 1, table.shape[2] - 1
    turn = (direction_rad - math.pi) / _QUARTER_RAD
    turn -= 4.0 * math.floor(turn / 4.0)
    quarter = min(int(turn), 3)
    x = min(max(turn - quarter, 0.0), 1.0) * angles
    y = min(max(size_1_m / model.largest_1_m, 0.0), 1.0) * sizes
    a, s = min(int(x), angles - 1), min(int(y), sizes - 1)
    x -= a
    y -= s
    for i in range(4):
        out_Pa[i] = model.co_contraction_Pa
    for c in range(2):
        out_Pa[(quarter + c) % 4] = (1.0 - x) * (
            (1.0 - y) * table[quarter, a, s, c] + y * table[quarter, a, s + 1, c]
        ) + x * ((1.0 - y) * table[quarter, a + 1, s, c] + y * table[quarter, a + 1, s + 1, c])
