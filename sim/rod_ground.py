"""Shapes of the ground under the rod twin: all of them straight along one axis, the grain.

A ground is a profile in the plane across its grain: coordinate a (y where the grain is x, x where it is y) and z. For
the centre of a sphere of radius R it gives, for each spot where the two may touch, the gap and the outward normal.
"""

from __future__ import annotations

import numpy as np

from sim.rod_compile import inner

NO_GROUND, PLANE, STEP, PIPE = range(4)
SPOTS = {NO_GROUND: 1, PLANE: 1, STEP: 2, PIPE: 1}
"""Contacts that one sphere can have at once: with a step its floor and its riser or edge."""

_FAR_M = 1e9


@inner
def profile_gap(
    ground: int, first_m: float, second_m: float, spot: int, a: float, z: float, radius_m: float
) -> tuple[float, float, float]:
    """Gap [m] and normal (along a, along z) between the ground and a sphere about (a, z).

    STEP: first_m: height; second_m: where the riser is, the ground rises away from 0. PIPE: first_m: outer radius;
    its top is at z = 0.
    """
    if ground == PLANE:
        return z - radius_m, 0.0, 1.0
    if ground == PIPE:
        up = z + first_m
        distance = np.sqrt(a * a + up * up)
        if not distance > 0.0:
            return -first_m - radius_m, 0.0, 1.0
        return distance - first_m - radius_m, a / distance, up / distance
    side = 1.0 if second_m >= 0.0 else -1.0
    beyond = side * a - abs(second_m)
    above = z - first_m
    if spot == 0:
        if beyond < 0.0:
            return z - radius_m, 0.0, 1.0
        if above > 0.0:
            return above - radius_m, 0.0, 1.0
        return _FAR_M, 0.0, 1.0
    if above <= 0.0:
        return -beyond - radius_m, -side, 0.0
    if beyond >= 0.0:
        return _FAR_M, 0.0, 1.0
    distance = np.sqrt(beyond * beyond + above * above)
    return distance - radius_m, side * beyond / distance, above / distance
