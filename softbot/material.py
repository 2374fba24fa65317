"""Wall materials of a hoop-constrained section: axial stress and tangent from the axial stretch.

Hoop fibres hold λ_θ = 1 and silicone keeps its volume, so λ_r = 1/λ and the strain energy per reference volume
is a function w(λ) of the axial stretch alone. A material is that function's first and second derivative. With
J = I₁ − 3 = λ² + λ⁻² − 2:

    law             w(λ)                       parameters                              small-strain modulus w''(1)
    linear          E/2 (λ − 1)²               E = modulus_Pa                          E
    neo-hookean     µ/2 J                      µ = modulus_Pa                          4µ
    mooney-rivlin   µ/2 J                      µ, share of I₂ = second_share           4µ
    yeoh            µ/2 J + c J² + d J³        µ, c, d = stiffening_Pa, stiffening_2_Pa 4µ
    gent            −µ Jm/2 ln(1 − J/Jm)       µ, Jm = limit_invariant                 4µ

Under the hoop constraint I₂ = I₁, so Mooney–Rivlin, µ/2 [(1 − β)(I₁ − 3) + β(I₂ − 3)], bends a section as neo-Hookean
does, whatever β; in a tensile test the two differ. `uniaxial_stress_Pa` is the wall in such a test, without fibres.

To add a material, add a branch to the three kernels and to `uniaxial_stress_Pa`, and a row to `MATERIALS`; nothing else
in the project names one. Viscosity, hysteresis and set are in `softbot.memory`, which acts on the load.

Sources: M. Mooney (1940), R. S. Rivlin (1948), O. H. Yeoh (1993), A. N. Gent (1996).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softbot.errors import InputError
from softbot.kernel_compiler import kernel

MaterialName = Literal["linear", "neo-hookean", "mooney-rivlin", "yeoh", "gent"]
FloatArray = NDArray[np.float64]

LINEAR, NEO_HOOKEAN, MOONEY_RIVLIN, YEOH, GENT = 0, 1, 2, 3, 4
PARAMETERS = 3
"""Numbers that the kernels take for every material; those that a law does not have are not looked at."""


@dataclass(frozen=True)
class WallParameter:
    """A parameter of a wall material: its key in a robot file, unit ("1": none), bounds, and what it is."""

    key: str
    unit: str
    low: float
    high: float
    default: float
    meaning: str
    felt_by_section: bool = True
    """Whether a hoop-constrained section can feel it; if not, no bending table determines it."""


MODULUS = WallParameter("modulus_Pa", "Pa", 0.0, 1e12, math.nan, "E of linear, µ of the others")
_SECOND_SHARE = WallParameter("second_share", "1", 0.0, 1.0, 0.0, "share of µ that goes with I₂", felt_by_section=False)
_STIFFENING = WallParameter("stiffening_Pa", "Pa", 0.0, 1e12, 0.0, "factor of (I₁ − 3)²")
_STIFFENING_2 = WallParameter("stiffening_2_Pa", "Pa", 0.0, 1e12, 0.0, "factor of (I₁ − 3)³")
_LIMIT = WallParameter("limit_invariant", "1", 0.05, 1e9, 30.0, "I₁ − 3 at which the chains are fully drawn out")


@dataclass(frozen=True)
class MaterialKind:
    """What the rest of the program needs to know of a material law.

    `code` selects the branch in the kernels; `modulus_ratio` is the small-strain axial modulus of the hoop-constrained
    wall over the first parameter; `parameters` are in the order in which the kernels take them.
    """

    code: int
    modulus_ratio: float
    parameters: tuple[WallParameter, ...]

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(one.key for one in self.parameters)

    @property
    def has_stiffening(self) -> bool:
        """Whether the law has the parameter `stiffening_Pa`."""
        return "stiffening_Pa" in self.keys


MATERIALS: dict[str, MaterialKind] = {
    "linear": MaterialKind(LINEAR, 1.0, (MODULUS,)),
    "neo-hookean": MaterialKind(NEO_HOOKEAN, 4.0, (MODULUS,)),
    "mooney-rivlin": MaterialKind(MOONEY_RIVLIN, 4.0, (MODULUS, _SECOND_SHARE)),
    "yeoh": MaterialKind(YEOH, 4.0, (MODULUS, _STIFFENING, _STIFFENING_2)),
    "gent": MaterialKind(GENT, 4.0, (MODULUS, _LIMIT)),
}

OPTIONAL_PARAMETERS: dict[str, WallParameter] = {
    one.key: one for kind in MATERIALS.values() for one in kind.parameters[1:]
}
"""Every parameter but the modulus, by its key."""


def material_parameters(material: str, values: Mapping[str, float]) -> FloatArray:
    """The kernels' parameters, shape (3,), of a material from `values` by key; missing ones take their default.

    Raises InputError for an unknown material, a value out of its bounds, and one that the material does not have
    (unless it is the default, which says nothing).
    """
    if material not in MATERIALS:
        raise InputError(f"material = {material!r}: choose one of {', '.join(MATERIALS)}")
    kind = MATERIALS[material]
    found = np.zeros(PARAMETERS)
    for place, one in enumerate(kind.parameters):
        value = values.get(one.key, one.default)
        above = value > one.low if one is MODULUS else value >= one.low
        if not (math.isfinite(value) and above and value <= one.high):
            unit = "" if one.unit == "1" else f" {one.unit}"
            least = "above" if one is MODULUS else "from"
            raise InputError(
                f"{one.key} = {value!r}: give a finite number {least} {one.low:g} to {one.high:g}{unit} ({one.meaning})"
            )
        found[place] = value
    for key, value in values.items():
        if key in OPTIONAL_PARAMETERS and key not in kind.keys and value != OPTIONAL_PARAMETERS[key].default:
            owners = [name for name, other in MATERIALS.items() if key in other.keys]
            raise InputError(
                f"{key} = {value!r}: {material} has no such parameter; leave it out, or take {' or '.join(owners)}"
            )
    return found


@kernel()
def is_within(code: int, parameters: FloatArray, stretch: float) -> bool:
    """Whether the law is defined at the axial stretch: of Gent's only below its limit, of the others where λ > 0."""
    if not stretch > 0.0:
        return False
    if code == GENT:
        return stretch * stretch + 1.0 / (stretch * stretch) - 2.0 < parameters[1] * (1.0 - 1e-9)
    return True


@kernel()
def energy_density(code: int, parameters: FloatArray, stretch: float) -> float:
    """w(λ) [J/m³] at the axial stretch λ > 0, zero at λ = 1."""
    if code == LINEAR:
        return 0.5 * parameters[0] * (stretch - 1.0) ** 2
    invariant = (stretch - 1.0 / stretch) ** 2  # J = I1 − 3
    if code == YEOH:
        return invariant * (0.5 * parameters[0] + invariant * (parameters[1] + invariant * parameters[2]))
    if code == GENT:
        return -0.5 * parameters[0] * parameters[1] * math.log1p(-invariant / parameters[1])
    return 0.5 * parameters[0] * invariant


@kernel()
def nominal_stress(code: int, parameters: FloatArray, stretch: float) -> float:
    """First derivative w'(λ): axial force per reference area [Pa] at the axial stretch λ > 0."""
    if code == LINEAR:
        return parameters[0] * (stretch - 1.0)
    inverse = 1.0 / stretch
    slope = 2.0 * (stretch - inverse * inverse * inverse)  # dJ/dλ
    half = 0.5 * parameters[0]
    if code in (NEO_HOOKEAN, MOONEY_RIVLIN):
        return half * slope
    invariant = stretch * stretch + inverse * inverse - 2.0
    if code == YEOH:
        return (half + invariant * (2.0 * parameters[1] + 3.0 * parameters[2] * invariant)) * slope
    return half * parameters[1] / (parameters[1] - invariant) * slope


@kernel()
def tangent_modulus(code: int, parameters: FloatArray, stretch: float) -> float:
    """Second derivative w''(λ) [Pa] at the axial stretch λ > 0."""
    if code == LINEAR:
        return parameters[0]
    inverse = 1.0 / stretch
    curvature = 2.0 * (1.0 + 3.0 * inverse**4)  # d²J/dλ²
    half = 0.5 * parameters[0]
    if code in (NEO_HOOKEAN, MOONEY_RIVLIN):
        return half * curvature
    slope = 2.0 * (stretch - inverse * inverse * inverse)
    invariant = stretch * stretch + inverse * inverse - 2.0
    if code == YEOH:
        by_invariant = half + invariant * (2.0 * parameters[1] + 3.0 * parameters[2] * invariant)
        again = 2.0 * parameters[1] + 6.0 * parameters[2] * invariant
    else:
        room = parameters[1] - invariant
        by_invariant = half * parameters[1] / room
        again = by_invariant / room
    return by_invariant * curvature + again * slope * slope


def uniaxial_stress_Pa(material: str, values: Mapping[str, float], stretch: ArrayLike) -> FloatArray:
    """Nominal stress [Pa] of a free strip in a tensile test, at stretches λ > 0 of any shape.

    The same material as in the section, without fibres: λ_θ = λ_r = λ^(−1/2), so I₁ = λ² + 2/λ and I₂ = 2λ + λ⁻².
    Its small-strain modulus is three quarters of the section's. Infinite beyond Gent's limit. Raises as
    `material_parameters` does.
    """
    first, second, third = material_parameters(material, values)
    ratio = np.asarray(stretch, dtype=float)
    if MATERIALS[material].code == LINEAR:
        return np.asarray(0.75 * first * (ratio - 1.0))
    shape = ratio - ratio**-2
    invariant = ratio**2 + 2.0 / ratio - 3.0
    code = MATERIALS[material].code
    factor = np.full_like(ratio, first)
    if code == MOONEY_RIVLIN:
        factor = first * (1.0 - second + second / ratio)
    elif code == YEOH:
        factor = first + 4.0 * second * invariant + 6.0 * third * invariant**2
    elif code == GENT:
        room = second - invariant
        factor = np.where(room > 0.0, first * second / np.where(room > 0.0, room, 1.0), np.inf)
    return np.asarray(factor * shape)
