"""Actuator law of the four-chamber fibre-reinforced tube: chamber pressures → stretch and curvature, and back.

Strains of a section, e = (ℓ, k1, k2): axial stretch ℓ of the centre line [-] and curvature vector (k1, k2) per
*reference* length [1/m], pointing to the centre of curvature. A fibre at (x1, x2) is stretched by λ = ℓ − k·x, and
chamber i holds the volume L·g_i·A_c·λ(x_i), g_i its gain. Virtual work per reference length,

    ∫ w'(λ) δλ dA = Σ_i p_i g_i A_c δλ(x_i)        for every δe,

is F(e) = B p with F = ∂W/∂e, W = ∫ w dA. Its derivative gives the analytic Jacobian ∂e/∂p = K⁻¹ B, where
K = ∂F/∂e is at the same time the section's tangent stiffness (axial, bending and their coupling).

A `dead_band_Pa` is taken off each pressure first (folded chambers that must open before they load the wall).

A wall that is already stretched by λ_p when the robot has its rest length (wound or mounted under tension, held there
by its fibres and ends) has W = ∫ w(λ_p λ) dA less the work of the force that holds it: `pre_stretch`. Chambers that lie
off their nominal angles are part of the section (`CrossSection.misalignment_rad`).

Rate and memory effects act on the pressures before they come here (`softbot.memory`). Left out: shear, and the thinning
of the wall by its own curvature.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softbot.actuator_equilibrium import equilibria_under, equilibrium_under, wall_forces
from softbot.actuator_inverse import pressures_for
from softbot.cross_section import CHAMBERS, CrossSection
from softbot.errors import InputError, SimulationError, UnreachableError
from softbot.material import (
    MATERIALS,
    OPTIONAL_PARAMETERS,
    is_within,
    material_parameters,
    tangent_modulus,
)

FloatArray = NDArray[np.float64]

_REACHED = 0.01  # of what was wanted
PRE_STRETCH_BOUNDS = (0.5, 3.0)


@dataclass(frozen=True)
class Equilibrium:
    """The section at rest under its pressures, with nothing else pulling on it."""

    stretch: float
    """Axial stretch of the centre line [-]."""
    curvature_1_m: FloatArray
    """Curvature vector per reference length, shape (2,) [1/m], towards the centre of curvature."""
    stiffness: FloatArray
    """Tangent stiffness K, shape (3, 3): [N, N m; N m, N m²] for strains (ℓ, k1, k2)."""
    jacobian: FloatArray
    """∂(ℓ, k1, k2)/∂p, shape (3, 4) [1/Pa, 1/(m Pa)]."""


@dataclass(frozen=True)
class InverseSolution:
    """Pressures for a wanted curvature vector, and what they really give."""

    pressure_Pa: FloatArray
    """Chamber pressures, shape (4,) [Pa gauge]."""
    curvature_1_m: FloatArray
    """The curvature vector they give, shape (2,) [1/m]."""
    reached: bool
    """Whether that is the wanted vector (within 1 % of its size)."""
    stretch: float
    """The axial stretch that goes with it."""
    stretch_reached: bool
    """Whether that is the wanted stretch (within 1 % of its part beyond 1); True where none was wanted."""


@dataclass(frozen=True)
class ActuatorLaw:
    """The law of one robot: section, wall material, chamber gains, dead band, pre-stretch.

    `modulus_Pa`, `stiffening_Pa`, `stiffening_2_Pa`, `limit_invariant` and `second_share` are the parameters of the
    material (see `softbot.material`; each has only some of them); `gains` scale the load of each chamber;
    `pre_stretch` is that of the wall at the robot's rest length. Raises InputError for parameters that are no actuator.
    """

    section: CrossSection
    material: str
    modulus_Pa: float
    stiffening_Pa: float = 0.0
    gains: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    dead_band_Pa: float = 0.0
    stiffening_2_Pa: float = OPTIONAL_PARAMETERS["stiffening_2_Pa"].default
    limit_invariant: float = OPTIONAL_PARAMETERS["limit_invariant"].default
    second_share: float = OPTIONAL_PARAMETERS["second_share"].default
    pre_stretch: float = 1.0
    _points: FloatArray = field(init=False, repr=False, compare=False)
    _load: FloatArray = field(init=False, repr=False, compare=False)
    _wall_numbers: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        parameters = material_parameters(
            self.material, {key: getattr(self, key) for key in ("modulus_Pa", *OPTIONAL_PARAMETERS)}
        )
        if not (math.isfinite(self.dead_band_Pa) and self.dead_band_Pa >= 0.0):
            raise InputError(f"dead_band_Pa = {self.dead_band_Pa!r}: give zero or a positive number of pascals")
        if len(self.gains) != CHAMBERS or not all(math.isfinite(g) and g > 0.0 for g in self.gains):
            raise InputError(f"gains = {self.gains!r}: give {CHAMBERS} positive numbers, one a chamber")
        low, high = PRE_STRETCH_BOUNDS
        if not low <= self.pre_stretch <= high:
            raise InputError(f"pre_stretch = {self.pre_stretch!r}: give {low:g} to {high:g} (1: the wall is at ease)")
        if not is_within(MATERIALS[self.material].code, parameters, self.pre_stretch):
            raise InputError(
                f"pre_stretch = {self.pre_stretch!r}: is beyond what limit_invariant = {self.limit_invariant:g} allows"
            )
        centroids = self.section.chamber_centroids_m()
        effective_area_m2 = np.array(self.gains) * self.section.chamber_area_m2
        load = np.vstack([effective_area_m2, -(effective_area_m2[:, None] * centroids).T])
        object.__setattr__(self, "_points", self.section.wall_points())
        object.__setattr__(self, "_load", np.ascontiguousarray(load))
        object.__setattr__(self, "_wall_numbers", np.append(parameters, self.pre_stretch))

    @property
    def load_matrix(self) -> FloatArray:
        """B, shape (3, 4): generalised section force (N, N m, N m) per chamber pressure [Pa]."""
        return self._load.copy()

    @property
    def rest_bending_stiffness_N_m2(self) -> float:
        """Bending stiffness of the unloaded section [N m²]."""
        code, wall = self._material()
        modulus_Pa = self.pre_stretch**2 * tangent_modulus(code, wall, self.pre_stretch)
        return modulus_Pa * self.section.bending_area_moment_m4

    def forces(self, stretch: float, curvature_1_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Wall forces F(e), shape (3,) [N, N m, N m], and tangent stiffness K, shape (3, 3).

        Raises SimulationError for strains that crush the wall or draw it beyond its law.
        """
        strain = np.array([stretch, *np.asarray(curvature_1_m, dtype=float)])
        force, stiffness = np.empty(3), np.empty((3, 3))
        if not wall_forces(self._points, *self._material(), strain, force, stiffness):
            raise SimulationError(f"strains {strain.tolist()}: they crush the wall, or draw it beyond its law")
        return force, stiffness

    def equilibrium(self, pressure_Pa: ArrayLike) -> Equilibrium:
        """Strains at which the wall carries the chamber pressures, shape (4,) [Pa gauge].

        Raises InputError for pressures that are not four finite numbers and SimulationError when the pressures
        crush the wall or the equation has no solution.
        """
        pressure = _four(pressure_Pa, "pressure_Pa")
        strain, stiffness, jacobian = np.array([1.0, 0.0, 0.0]), np.empty((3, 3)), np.empty((3, CHAMBERS))
        numbers = (self._points, *self._material(), self._load, self.dead_band_Pa)
        if not equilibrium_under(*numbers, pressure, strain, stiffness, jacobian):
            raise SimulationError(
                f"no equilibrium of the section at pressures {pressure.tolist()} Pa: they crush or burst it"
            )
        return Equilibrium(float(strain[0]), strain[1:], stiffness, jacobian)

    def equilibria(
        self, pressure_Pa: ArrayLike, start: FloatArray | None = None, *, along: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """`equilibrium` for many pressures at once, shape (n, 4) [Pa gauge], without the Jacobians.

        Returns strains (ℓ, k1, k2), shape (n, 3), and tangent stiffnesses, shape (n, 3, 3). `start`, shape (n, 3),
        are strains to begin from (those of a law nearby). `along`: the rows follow each other closely, and each is
        begun from the row before it. Raises as `equilibrium` does.
        """
        pressure = np.asarray(pressure_Pa, dtype=float)
        if pressure.ndim != 2 or pressure.shape[1] != CHAMBERS or not np.all(np.isfinite(pressure)):
            raise InputError(f"pressure_Pa of shape {pressure.shape}: give rows of {CHAMBERS} finite numbers")
        strain = np.tile([1.0, 0.0, 0.0], (len(pressure), 1)) if start is None else np.array(start, dtype=float)
        if strain.shape != (len(pressure), 3):
            raise InputError(f"start of shape {strain.shape}: give the strains of {len(pressure)} rows")
        stiffness = np.empty((len(pressure), 3, 3))
        effective_Pa = np.maximum(pressure - self.dead_band_Pa, 0.0) + np.minimum(pressure, 0.0)
        loads = np.ascontiguousarray(effective_Pa @ self._load.T)
        failed = equilibria_under(self._points, *self._material(), loads, along, strain, stiffness)
        if failed >= 0:
            raise SimulationError(
                f"no equilibrium of the section at pressures {pressure[failed].tolist()} Pa: they crush or burst it"
            )
        return strain, stiffness

    def chamber_volumes_m3(self, length_m: float, stretch: float, curvature_1_m: ArrayLike) -> FloatArray:
        """Chamber volumes, shape (4,) [m³], of a robot of reference length `length_m`: ∂/∂p of the virtual work."""
        strain = np.array([stretch, *np.asarray(curvature_1_m, dtype=float)])
        return length_m * (self._load.T @ strain)

    def pressures(
        self,
        curvature_1_m: ArrayLike,
        *,
        limit_Pa: float,
        co_contraction_Pa: float = 0.0,
        available: Sequence[bool] = (True, True, True, True),
        stretch: float | None = None,
    ) -> InverseSolution:
        """Pressures in [0, limit_Pa] that bend the section to the wanted curvature vector, shape (2,) [1/m].

        Every available chamber holds at least `co_contraction_Pa` (which stiffens and lengthens the tube); chambers
        that are not available stay at zero. The rest is as in `pressures_within`.
        """
        if not 0.0 <= co_contraction_Pa <= limit_Pa:
            raise InputError(f"co_contraction_Pa = {co_contraction_Pa:g}: give 0 … limit_Pa = {limit_Pa:g}")
        usable = np.array([bool(a) for a in available])
        least, most = np.where(usable, co_contraction_Pa, 0.0), np.where(usable, limit_Pa, 0.0)
        return self.pressures_within(curvature_1_m, least_Pa=least, most_Pa=most, stretch=stretch)

    def pressures_within(
        self, curvature_1_m: ArrayLike, *, least_Pa: ArrayLike, most_Pa: ArrayLike, stretch: float | None = None
    ) -> InverseSolution:
        """Pressures from `least_Pa` to `most_Pa`, shape (4,) each, that bend the section to a curvature vector (2,).

        The solution of least total pressure is taken where only the chambers on the outer side are needed, or else the
        shortest tube that can hold the bend (a wall that softens bends further when it is longer). With a wanted
        `stretch` it is the one that has it, or else the nearest that goes with the bend. A direction that the chambers
        cannot give is replaced by the nearest that they can, and a size beyond their limits by the largest in that
        direction; `reached` then is False. Raises InputError for what is not finite, or limits that cross.
        """
        wanted = np.asarray(curvature_1_m, dtype=float)
        if wanted.shape != (2,) or not np.all(np.isfinite(wanted)):
            raise InputError(f"curvature_1_m = {wanted.tolist()!r}: give two finite numbers [1/m]")
        least, most = _four(least_Pa, "least_Pa"), _four(most_Pa, "most_Pa")
        if np.any(least < 0.0) or np.any(most < least):
            raise InputError(f"least_Pa = {least.tolist()}, most_Pa = {most.tolist()}: give 0 ≤ least_Pa ≤ most_Pa")
        if stretch is not None and not (math.isfinite(stretch) and stretch > 0.0):
            raise InputError(f"stretch = {stretch!r}: give a positive, finite number (1: the length at rest)")
        pressure, given = np.empty(CHAMBERS), np.empty(3)
        numbers = (self._points, *self._material(), self._load, self.dead_band_Pa)
        if not pressures_for(*numbers, least, most, wanted, math.nan if stretch is None else stretch, pressure, given):
            raise SimulationError(
                f"no equilibrium of the section at pressures {pressure.tolist()} Pa: they crush or burst it"
            )
        size = max(math.hypot(wanted[0], wanted[1]), 1e-6 / self.section.radius_m)
        reached = bool(math.hypot(given[1] - wanted[0], given[2] - wanted[1]) <= _REACHED * size)
        long = stretch is None or bool(abs(given[0] - stretch) <= _REACHED * max(abs(stretch - 1.0), 1e-6))
        return InverseSolution(pressure, given[1:], reached, float(given[0]), long)

    def pressures_exactly(
        self, curvature_1_m: ArrayLike, *, limit_Pa: float, co_contraction_Pa: float = 0.0
    ) -> FloatArray:
        """As `pressures` with all four chambers, but raises UnreachableError when the bend cannot be had."""
        solution = self.pressures(curvature_1_m, limit_Pa=limit_Pa, co_contraction_Pa=co_contraction_Pa)
        if not solution.reached:
            raise UnreachableError(
                f"curvature {np.hypot(*np.asarray(curvature_1_m, dtype=float)):.3g} /m needs more than the limit of "
                f"{limit_Pa / 1e3:g} kPa; at most {np.hypot(*solution.curvature_1_m):.3g} /m can be had"
            )
        return solution.pressure_Pa

    def _material(self) -> tuple[int, FloatArray]:
        return MATERIALS[self.material].code, self._wall_numbers


def _four(values: ArrayLike, name: str) -> FloatArray:
    array = np.asarray(values, dtype=float)
    if array.shape != (CHAMBERS,) or not np.all(np.isfinite(array)):
        raise InputError(f"{name} = {array.tolist()!r}: give {CHAMBERS} finite numbers, one a chamber")
    return array
