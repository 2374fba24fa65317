"""How fast a chamber fills when its supply valve stands open: what a valve board's time limits have to beat.

    dp/dt = n R T q_m(p) / V        q_m: ISO 6358 (`pneumatics.valve_mass_flow`), V the volume at rest

The worst case on every side: the valve is fully open from the start, the manifold stays at the regulator's pressure,
the chamber does not give way (a real one grows and fills more slowly), and the gas is compressed without heat leaving
it, so that it is faster by the ratio of its specific heats n = 1.4 than the isothermal filling of `pneumatics`
(charging a volume from a line at the same temperature: d(pV)/dt = n R T q_m).

    python -m softbot.filling [ROBOT.toml]      the table of docs/safety.md for a robot
"""

from __future__ import annotations

import math
import sys

import numpy as np
from scipy.integrate import quad, solve_ivp

from softbot.errors import InputError
from softbot.pneumatics import PneumaticsParameters, valve_mass_flow
from softbot.robot import Robot, load_robot

ADIABATIC_EXPONENT_AIR = 1.4


def fill_rate_Pa_s(
    pneumatics: PneumaticsParameters,
    volume_m3: float,
    pressure_Pa: float,
    *,
    chamber: int = 0,
    exponent: float = ADIABATIC_EXPONENT_AIR,
) -> float:
    """Rise of a chamber's pressure [Pa/s] at gauge `pressure_Pa` with its supply valve fully open.

    `volume_m3`: of the chamber with its dead volume. `exponent`: 1 isothermal, 1.4 adiabatic.
    """
    flow_kg_s = valve_mass_flow(
        pneumatics.supply_valve_conductance_m3_s_Pa[chamber],
        pneumatics.critical_ratio,
        pneumatics.supply_pressure_absolute_Pa,
        pressure_Pa + pneumatics.atmospheric_pressure_absolute_Pa,
        pneumatics.temperature_K,
    )
    return exponent * pneumatics.gas_constant_times_temperature_J_kg * flow_kg_s / volume_m3


def fill_time_s(
    pneumatics: PneumaticsParameters,
    volume_m3: float,
    from_Pa: float,
    to_Pa: float,
    *,
    chamber: int = 0,
    exponent: float = ADIABATIC_EXPONENT_AIR,
) -> float:
    """Shortest time from one gauge pressure to a higher one [s]; infinite where the supply does not reach it.

    Raises InputError when `to_Pa` is below `from_Pa` or the volume is not positive.
    """
    if not (from_Pa <= to_Pa and 0.0 < volume_m3 < math.inf):
        raise InputError(f"filling {volume_m3} m3 from {from_Pa} to {to_Pa} Pa: must be a volume, and upwards")
    if to_Pa >= pneumatics.supply_pressure_Pa:
        return math.inf
    return float(
        quad(
            lambda pressure_Pa: (
                1.0 / fill_rate_Pa_s(pneumatics, volume_m3, pressure_Pa, chamber=chamber, exponent=exponent)
            ),
            from_Pa,
            to_Pa,
        )[0]
    )


def pressure_after_Pa(
    pneumatics: PneumaticsParameters,
    volume_m3: float,
    from_Pa: float,
    duration_s: float,
    *,
    chamber: int = 0,
    exponent: float = ADIABATIC_EXPONENT_AIR,
) -> float:
    """The highest gauge pressure that a chamber reaches from `from_Pa` in `duration_s`."""
    solution = solve_ivp(
        lambda t_s, y: [fill_rate_Pa_s(pneumatics, volume_m3, y[0], chamber=chamber, exponent=exponent)],
        (0.0, duration_s),
        [from_Pa],
        rtol=1e-8,
    )
    return float(solution.y[0, -1])


def smallest_volume_m3(robot: Robot) -> float:
    """The smallest chamber of a robot at rest, dead volume included [m3]."""
    volumes_m3 = robot.actuator_law().chamber_volumes_m3(robot.length_m, 1.0, np.zeros(2))
    return float((volumes_m3 + np.array(robot.pneumatics.dead_volume_m3)).min())


def filling_table(robot: Robot) -> str:
    """The times and pressures that the board's time limits are derived from, as a Markdown table."""
    pneumatics, volume_m3 = robot.pneumatics, smallest_volume_m3(robot)
    limit_Pa, highest_Pa = pneumatics.max_chamber_pressure_Pa, robot.max_pressure_Pa
    rows = ["| supply valve fully open, chamber of {:.1f} ml | isothermal | adiabatic |", "|---|---|---|"]
    rows[0] = rows[0].format(1e6 * volume_m3)
    for start_Pa, end_Pa in ((0.0, highest_Pa), (0.0, limit_Pa), (highest_Pa, limit_Pa)):
        times = [1e3 * fill_time_s(pneumatics, volume_m3, start_Pa, end_Pa, exponent=n) for n in _EXPONENTS]
        rows.append(f"| {_kPa(start_Pa)} to {_kPa(end_Pa)} kPa | {times[0]:.0f} ms | {times[1]:.0f} ms |")
    for start_Pa, duration_s in ((0.0, 0.1), (0.0, 0.14), (0.0, 0.2), (limit_Pa, 0.02)):
        ends = [pressure_after_Pa(pneumatics, volume_m3, start_Pa, duration_s, exponent=n) for n in _EXPONENTS]
        rows.append(
            f"| {1e3 * duration_s:.0f} ms from {_kPa(start_Pa)} kPa | {_kPa(ends[0])} kPa | {_kPa(ends[1])} kPa |"
        )
    return "\n".join(rows)


_EXPONENTS = (1.0, ADIABATIC_EXPONENT_AIR)


def _kPa(pressure_Pa: float) -> str:
    return f"{1e-3 * pressure_Pa:.0f}"


if __name__ == "__main__":
    print(filling_table(load_robot(sys.argv[1] if len(sys.argv) > 1 else "default")))
