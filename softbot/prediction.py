"""Bend and length of a robot against the pressure of its chambers, with a band where its wall is a silicone's.

The band holds with 95 % by the library's own account of its stiffness (`softbot.silicone`); geometry is taken as
stated. A wall that is s times stiffer bends under p as this one under p/s, so the band costs no other law.

Of a robot with a memory each point is loaded once, from rest, and held until nothing creeps any more: what its wall
feels then bends it, as in `softbot inverse` and in a twin that comes to rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softbot.cross_section import CHAMBERS
from softbot.errors import InputError
from softbot.robot import Robot

FloatArray = NDArray[np.float64]

_QUANTILE = 1.96  # of the normal distribution: 95 % lie within
HELD_S = 1e6
"""Long enough for any creep to end [s]."""
FULL_CIRCLE_DEG = 360.0
"""Bend at which the ends of the arc touch: laws of a section know nothing of it, robots bend no further."""


@dataclass(frozen=True)
class Prediction:
    """Bend [rad] and length [m] at n pressures [Pa gauge] of the driven chambers; arrays of shape (n,)."""

    pressure_Pa: FloatArray
    bend_rad: FloatArray
    length_m: FloatArray
    bend_low_rad: FloatArray | None
    """Of a wall at the stiff end of the band; None where the robot names no silicone."""
    bend_high_rad: FloatArray | None
    length_low_m: FloatArray | None
    length_high_m: FloatArray | None

    @property
    def full_circle_Pa(self) -> float | None:
        """Pressure at which the arc closes to a full circle, in proportion between its neighbours; None: never."""
        beyond = np.flatnonzero(self.bend_rad >= math.radians(FULL_CIRCLE_DEG))
        if not beyond.size:
            return None
        near = slice(int(beyond[0]) - 1, int(beyond[0]) + 1)  # the first point is without pressure and bend
        return float(np.interp(math.radians(FULL_CIRCLE_DEG), self.bend_rad[near], self.pressure_Pa[near]))


def predict(
    robot: Robot, chambers: tuple[int, ...] = (0,), largest_Pa: float | None = None, points: int = 13
) -> Prediction:
    """Bend and length at `points` pressures from 0 to `largest_Pa` (default: the robot's highest) in `chambers`.

    Raises InputError for chambers or pressures that do not exist, SimulationError where the wall has no equilibrium.
    """
    if not chambers or any(chamber not in range(CHAMBERS) for chamber in chambers):
        raise InputError(f"chambers = {list(chambers)}: name some of 0 to {CHAMBERS - 1}")
    most_Pa = robot.max_pressure_Pa if largest_Pa is None else largest_Pa
    if not (math.isfinite(most_Pa) and most_Pa > 0.0 and points > 1):
        raise InputError(
            f"largest_Pa = {most_Pa!r}, points = {points}: give a pressure above zero and two points or more"
        )
    law = robot.actuator_law()
    pressure = np.linspace(0.0, most_Pa, points)
    felt = _felt_Pa(robot, pressure, chambers)

    def at(stiffer: float) -> tuple[FloatArray, FloatArray]:
        """Bend and length with a wall `stiffer` times as stiff; the dead band, which is no wall's, stays."""
        above = np.maximum(felt - law.dead_band_Pa, 0.0) / stiffer
        strain, _ = law.equilibria(np.where(above > 0.0, above + law.dead_band_Pa, 0.0))
        return robot.length_m * np.hypot(strain[:, 1], strain[:, 2]), robot.length_m * strain[:, 0]

    bend, length = at(1.0)
    spread = robot.stiffness_log_sd
    if spread is None:
        return Prediction(pressure, bend, length, None, None, None, None)
    (bend_low, length_low), (bend_high, length_high) = (at(math.exp(sign * _QUANTILE * spread)) for sign in (1, -1))
    return Prediction(pressure, bend, length, bend_low, bend_high, length_low, length_high)


def _felt_Pa(robot: Robot, pressure_Pa: FloatArray, chambers: tuple[int, ...]) -> FloatArray:
    """What the wall feels of n pressures, shape (n,), held in `chambers`: shape (n, 4) [Pa]."""
    rows = np.zeros((len(pressure_Pa), CHAMBERS))
    rows[:, list(chambers)] = pressure_Pa[:, None]
    memory = robot.actuator_memory()
    if memory is None:
        return rows
    rest = memory.rest()
    return np.array([memory.felt_at(rest, row, HELD_S) for row in rows])
