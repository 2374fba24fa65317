"""The paper's tube as a section law: wall forces and tangent stiffness from the strains, as of an actuator's wall.

The same contract as `ActuatorLaw.forces`: generalised forces F(e), shape (3,) [N, N m, N m], and K = ∂F/∂e, shape
(3, 3), for the strains e = (ℓ, k1, k2). Of a thin tube under internal gauge pressure p (`softbot.tube`):

    N  = 2πE₀Rh (ℓ − 1)                              about the length that the pressure gives it
    M  = πE₀R²h/(1 − ν²)·[κ̄ − 3κ̄³/(8p̄)] along k      κ̄ = |k|R: the section ovalises, and kinks at κ̄c = √(8p̄/9)

so that across the direction of bending the tangent is the secant M/|k|, and along it dM/dκ, which is zero at the kink.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softbot.errors import InputError
from softbot.tube import Tube, bending_moment_N_m, kink_curvature_1_m, positive_number, scaled_pressure

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class TubeLaw:
    """A thin tube under internal gauge pressure p > 0 [Pa]. Raises InputError for a pressure that is not above zero."""

    tube: Tube
    internal_pressure_Pa: float

    def __post_init__(self) -> None:
        positive_number("internal_pressure_Pa", self.internal_pressure_Pa)

    @property
    def rest_bending_stiffness_N_m2(self) -> float:
        """Bending stiffness of the straight tube [N m²]."""
        return self.tube.bending_stiffness_N_m2

    @property
    def kink_curvature_1_m(self) -> float:
        """Curvature at which the tangent along the bending direction is zero [1/m]."""
        return kink_curvature_1_m(self.tube, self.internal_pressure_Pa)

    def forces(self, stretch: float, curvature_1_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """F(e), shape (3,) [N, N m, N m], and K, shape (3, 3), at the stretch ℓ and the curvature vector (2,) [1/m].

        Raises KinkError for a curvature beyond the kink, InputError for strains that are not finite.
        """
        strain = np.array([stretch, *np.asarray(curvature_1_m, dtype=float)])
        if strain.shape != (3,) or not np.all(np.isfinite(strain)):
            raise InputError(f"strains = {strain.tolist()!r}: give a stretch and two curvatures, all finite")
        tube, curvature = self.tube, strain[1:]
        size = math.hypot(curvature[0], curvature[1])
        moment_N_m = bending_moment_N_m(tube, size, self.internal_pressure_Pa)
        axial_N = 2.0 * math.pi * tube.youngs_modulus_Pa * tube.radius_m * tube.wall_thickness_m
        p_bar = scaled_pressure(tube, self.internal_pressure_Pa)
        stiffness_N_m2 = tube.bending_stiffness_N_m2
        along = stiffness_N_m2 * (1.0 - 9.0 * (size * tube.radius_m) ** 2 / (8.0 * p_bar))
        across = moment_N_m / size if size > 0.0 else stiffness_N_m2
        direction = curvature / size if size > 0.0 else np.array([1.0, 0.0])
        force = np.array([axial_N * (stretch - 1.0), *(moment_N_m * direction)])
        stiffness = np.zeros((3, 3))
        stiffness[0, 0] = axial_N
        stiffness[1:, 1:] = across * np.eye(2) + (along - across) * np.outer(direction, direction)
        return force, stiffness
