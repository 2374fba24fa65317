"""The one contract of wall laws: generalised section forces and their tangent, from the strains of the section.

Strains e = (ℓ, k1, k2): axial stretch of the centre line [-] and curvature vector per reference length [1/m], towards
the centre of curvature. What fulfils it: `softbot.actuator.ActuatorLaw` (a hoop-constrained section of any wall
material, with its chambers) and `softbot.tube_law.TubeLaw` (the paper's tube, which ovalises and kinks).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray


class SectionLaw(Protocol):
    """A wall that resists its strains."""

    def forces(self, stretch: float, curvature_1_m: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """F(e), shape (3,) [N, N m, N m], and the tangent stiffness K = ∂F/∂e, shape (3, 3)."""
        ...

    @property
    def rest_bending_stiffness_N_m2(self) -> float:
        """Bending stiffness of the unloaded, straight section [N m²]."""
        ...
