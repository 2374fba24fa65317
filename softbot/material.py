"""Wall materials of a hoop-constrained section: axial stress and tangent from the axial stretch.

Hoop fibres hold λ_θ = 1 and silicone keeps its volume, so λ_r = 1/λ and the strain energy per reference volume
is a function w(λ) of the axial stretch alone. A material is that function's first and second derivative:

    law            w(λ)                                parameters           small-strain modulus w''(1)
    linear         E/2 (λ − 1)²                        E [Pa]               E
    neo-hookean    µ/2 (λ² + λ⁻² − 2)                  µ [Pa]               4µ
    yeoh           µ/2 J + c J²,  J = λ² + λ⁻² − 2     µ [Pa], c [Pa]       4µ

To add a material, add a branch to `nominal_stress` and `tangent_modulus` and a row to `MATERIALS`; nothing else
in the project names one. Left out here: viscosity (the twins' Kelvin–Voigt damping) and hysteresis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from numba import njit

MaterialName = Literal["linear", "neo-hookean", "yeoh"]

LINEAR, NEO_HOOKEAN, YEOH = 0, 1, 2


@dataclass(frozen=True)
class MaterialKind:
    """What the rest of the program needs to know of a material law.

    `code` selects the branch in the kernels; `modulus_ratio` is the small-strain axial modulus over the first
    parameter; `has_stiffening` says whether the second parameter is used.
    """

    code: int
    modulus_ratio: float
    has_stiffening: bool


MATERIALS: dict[str, MaterialKind] = {
    "linear": MaterialKind(LINEAR, 1.0, False),
    "neo-hookean": MaterialKind(NEO_HOOKEAN, 4.0, False),
    "yeoh": MaterialKind(YEOH, 4.0, True),
}


@njit(cache=True)
def nominal_stress(code: int, modulus_Pa: float, stiffening_Pa: float, stretch: float) -> float:
    """First derivative w'(λ): axial force per reference area [Pa] at the axial stretch λ > 0."""
    if code == LINEAR:
        return modulus_Pa * (stretch - 1.0)
    inverse = 1.0 / stretch
    slope = 2.0 * (stretch - inverse * inverse * inverse)  # dJ/dλ
    if code == NEO_HOOKEAN:
        return 0.5 * modulus_Pa * slope
    invariant = stretch * stretch + inverse * inverse - 2.0  # J = I1 − 3
    return (0.5 * modulus_Pa + 2.0 * stiffening_Pa * invariant) * slope


@njit(cache=True)
def tangent_modulus(code: int, modulus_Pa: float, stiffening_Pa: float, stretch: float) -> float:
    """Second derivative w''(λ) [Pa] at the axial stretch λ > 0."""
    if code == LINEAR:
        return modulus_Pa
    inverse = 1.0 / stretch
    slope = 2.0 * (stretch - inverse * inverse * inverse)
    curvature = 2.0 * (1.0 + 3.0 * inverse**4)  # d²J/dλ²
    if code == NEO_HOOKEAN:
        return 0.5 * modulus_Pa * curvature
    invariant = stretch * stretch + inverse * inverse - 2.0
    return (0.5 * modulus_Pa + 2.0 * stiffening_Pa * invariant) * curvature + 2.0 * stiffening_Pa * slope * slope
