"""A rod given as a row of rigid links or elements, seen as `sim.body.Motion`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.body import Motion

FloatArray = NDArray[np.float64]


def motion_of_links(rotation: FloatArray, centre_m: FloatArray, length_m: float, stretch: float = 1.0) -> Motion:
    """Motion of n equal links: rotations (n, 3, 3), columns e1, e2, t, and centres (n, 3) [m] of a tube of `length_m`.

    The mid cross-section is the middle link, or halfway between the two middle ones. Rates are NaN.
    """
    count = len(centre_m)
    half = count // 2
    middle = rotation[half] if count % 2 else _halfway(rotation[half - 1], rotation[half])
    turn = np.einsum("nji,njk->nik", rotation[:-1], rotation[1:])  # from each link to the next, in its axes
    angle = np.arccos(np.clip(0.5 * (np.trace(turn, axis1=1, axis2=2) - 1.0), -1.0, 1.0))
    axial = 0.5 * np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1
    )
    scale = np.where(angle < 1e-6, 1.0, angle / np.maximum(np.sin(angle), 1e-12))
    bend = (axial * scale[:, None]).mean(axis=0) * count / length_m
    ends = (centre_m[-1] + 0.5 * length_m / count * rotation[-1, :, 2]) - (
        centre_m[0] - 0.5 * length_m / count * rotation[0, :, 2]
    )
    unknown = np.full(3, np.nan)
    return Motion(
        rotation=middle,
        angular_velocity_rad_s=unknown,
        mid_velocity_m_s=unknown,
        centre_of_mass_m=centre_m.mean(axis=0),
        stretch=stretch,
        curvature_1_m=np.array([bend[1], -bend[0]]),
        chord=ends / np.linalg.norm(ends),
        angular_momentum_kg_m2_s=unknown,
    )


def _halfway(first: FloatArray, second: FloatArray) -> FloatArray:
    mean = first + second
    tangent = mean[:, 2] / np.linalg.norm(mean[:, 2])
    across = mean[:, 0] - tangent * (tangent @ mean[:, 0])
    across /= np.linalg.norm(across)
    return np.column_stack([across, np.cross(tangent, across), tangent])
