"""What a chamber that cannot be vented holds: a bend that stays, and what the others can still do beside it.

A chamber i with its valve stuck shut bends the robot towards α_i + π by a share h of what rolling asks for, whatever is
commanded. Along its axis the curvatures that can be had are then −h … s − h, s being the strength of the chamber
opposite: as of a chamber of strength h that faces one of strength s − h. What the free chambers have to add to get a
curvature is that curvature and h towards α_i.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from controllers.robot_model import RobotModel
from softbot.cross_section import CHAMBERS
from softbot.kernel_compiler import kernel

FloatArray = NDArray[np.float64]

_QUARTER_RAD = 0.5 * math.pi


@kernel(cache=False)
def bend_held(model: RobotModel, chamber: int, pressure_Pa: float) -> float:
    """The bend that a chamber gives alone at this pressure, over what rolling asks for; at most the table's largest."""
    sizes = model.pressures_Pa.shape[2]
    largest = model.largest_1_m / model.curvature_1_m
    before_Pa = model.pressures_Pa[chamber, 0, 0, 0]
    for s in range(1, sizes):
        after_Pa = model.pressures_Pa[chamber, 0, s, 0]
        if pressure_Pa < after_Pa:
            share = (pressure_Pa - before_Pa) / (after_Pa - before_Pa)
            return largest * (s - 1 + min(max(share, 0.0), 1.0)) / (sizes - 1)
        before_Pa = after_Pa
    return largest


@kernel(cache=False)
def beside_held(held: FloatArray, strength: FloatArray) -> None:
    """strength (4,) ← of chambers that reach the same curvatures with nothing held (4,)."""
    for i in range(CHAMBERS):
        if held[i] > 0.0:
            opposite = (i + 2) % CHAMBERS
            strength[i] = min(held[i], 1.0)
            strength[opposite] = max(strength[opposite] - held[i], 0.0)


@kernel(cache=False)
def pinned(held: FloatArray, strength: FloatArray, slack: float) -> bool:
    """Whether the robot cannot be straightened any more, by more than `slack` of the bend that rolling asks for."""
    most = 0.0
    for i in range(CHAMBERS):
        most = max(most, held[i] - strength[(i + 2) % CHAMBERS])
    return most > slack


@kernel(cache=False)
def free_bend(held: FloatArray, direction_rad: float, share: float) -> tuple[float, float]:
    """Body direction [rad] and share of the bend that the free chambers have to give for this bend of the robot."""
    x, y = share * math.cos(direction_rad), share * math.sin(direction_rad)
    for i in range(CHAMBERS):
        x += held[i] * math.cos(i * _QUARTER_RAD)
        y += held[i] * math.sin(i * _QUARTER_RAD)
    return math.atan2(y, x), math.hypot(x, y)
