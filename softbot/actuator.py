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
from numba import njit
from numpy.typing import ArrayLike, NDArray

from softbot.cross_section import CHAMBERS, CrossSection
from softbot.errors import InputError, SimulationError, UnreachableError
from softbot.material import (
    MATERIALS,
    OPTIONAL_PARAMETERS,
    PARAMETERS,
    is_within,
    material_parameters,
    nominal_stress,
    tangent_modulus,
)

FloatArray = NDArray[np.float64]

_MIN_STRETCH = 0.05  # below this the wall is crushed and no law means anything
_NEWTON_STEPS = 60
_PRE_STRETCH = PARAMETERS  # its place in the kernels' numbers of a wall, after those of the material
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
        """Wall forces F(e), shape (3,) [N, N m, N m], and tangent stiffness K, shape (3, 3)."""
        strain = np.array([stretch, *np.asarray(curvature_1_m, dtype=float)])
        force, stiffness = np.empty(3), np.empty((3, 3))
        _wall(self._points, *self._material(), strain, force, stiffness)
        return force, stiffness

    def equilibrium(self, pressure_Pa: ArrayLike) -> Equilibrium:
        """Strains at which the wall carries the chamber pressures, shape (4,) [Pa gauge].

        Raises InputError for pressures that are not four finite numbers and SimulationError when the pressures
        crush the wall or the equation has no solution.
        """
        pressure = _four(pressure_Pa, "pressure_Pa")
        effective_Pa = np.maximum(pressure - self.dead_band_Pa, 0.0) + np.minimum(pressure, 0.0)
        strain, stiffness = np.array([1.0, 0.0, 0.0]), np.empty((3, 3))
        if not _solve(self._points, *self._material(), self._load @ effective_Pa, strain, stiffness):
            raise SimulationError(
                f"no equilibrium of the section at pressures {pressure.tolist()} Pa: they crush or burst it"
            )
        active = (pressure >= self.dead_band_Pa) | (pressure < 0.0)  # at the band's edge the slope of rising pressure
        jacobian = np.asarray(np.linalg.solve(stiffness, self._load * active), dtype=np.float64)
        return Equilibrium(float(strain[0]), strain[1:].copy(), stiffness, jacobian)

    def equilibria(self, pressure_Pa: ArrayLike, start: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """`equilibrium` for many pressures at once, shape (n, 4) [Pa gauge], without the Jacobians.

        Returns strains (ℓ, k1, k2), shape (n, 3), and tangent stiffnesses, shape (n, 3, 3). `start`, shape (n, 3),
        are strains to begin from (those of a law nearby). Raises as `equilibrium` does.
        """
        pressure = np.asarray(pressure_Pa, dtype=float)
        if pressure.ndim != 2 or pressure.shape[1] != CHAMBERS or not np.all(np.isfinite(pressure)):
            raise InputError(f"pressure_Pa of shape {pressure.shape}: give rows of {CHAMBERS} finite numbers")
        strain = np.tile([1.0, 0.0, 0.0], (len(pressure), 1)) if start is None else np.array(start, dtype=float)
        stiffness = np.empty((len(pressure), 3, 3))
        effective_Pa = np.maximum(pressure - self.dead_band_Pa, 0.0) + np.minimum(pressure, 0.0)
        loads = np.ascontiguousarray(effective_Pa @ self._load.T)
        failed = _solve_each(self._points, *self._material(), loads, strain, stiffness)
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
    ) -> InverseSolution:
        """Pressures in [0, limit_Pa] that bend the section to the wanted curvature vector, shape (2,) [1/m].

        Every available chamber holds at least `co_contraction_Pa` (which stiffens and lengthens the tube); chambers
        that are not available stay at zero. Of all solutions the one of least total pressure is taken. A direction
        that the available chambers cannot give is replaced by the nearest that they can, and a size beyond the
        limit by the largest in that direction; `reached` then is False.
        """
        wanted = np.asarray(curvature_1_m, dtype=float)
        if wanted.shape != (2,) or not np.all(np.isfinite(wanted)):
            raise InputError(f"curvature_1_m = {wanted.tolist()!r}: give two finite numbers [1/m]")
        if not 0.0 <= co_contraction_Pa <= limit_Pa:
            raise InputError(f"co_contraction_Pa = {co_contraction_Pa:g}: give 0 … limit_Pa = {limit_Pa:g}")
        usable = np.array([bool(a) for a in available])
        pressure, strain = np.empty(CHAMBERS), np.array([1.0, wanted[0], wanted[1]])
        _invert(
            self._points,
            *self._material(),
            self._load,
            usable,
            co_contraction_Pa,
            limit_Pa,
            self.dead_band_Pa,
            strain,
            pressure,
        )
        given = self.equilibrium(pressure).curvature_1_m
        tolerance = 0.01 * max(float(np.hypot(*wanted)), 1e-6 / self.section.radius_m)
        return InverseSolution(pressure, given, bool(np.hypot(*(given - wanted)) <= tolerance))

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


@njit(cache=True)
def _wall(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    strain: FloatArray,
    force: FloatArray,
    stiffness: FloatArray,
) -> bool:
    """Wall force and tangent stiffness at a strain; False when some fibre is crushed or beyond its law."""
    force[:] = 0.0
    stiffness[:, :] = 0.0
    pre_stretch = wall[_PRE_STRETCH]
    held_Pa = nominal_stress(code, wall, pre_stretch)
    for n in range(points.shape[0]):
        x1, x2, area = points[n, 0], points[n, 1], points[n, 2]
        stretch = strain[0] - strain[1] * x1 - strain[2] * x2
        if not (stretch > _MIN_STRETCH and is_within(code, wall, pre_stretch * stretch)):
            return False
        stress = pre_stretch * (nominal_stress(code, wall, pre_stretch * stretch) - held_Pa) * area
        tangent = pre_stretch * pre_stretch * tangent_modulus(code, wall, pre_stretch * stretch) * area
        force[0] += stress
        force[1] -= stress * x1
        force[2] -= stress * x2
        stiffness[0, 0] += tangent
        stiffness[0, 1] -= tangent * x1
        stiffness[0, 2] -= tangent * x2
        stiffness[1, 1] += tangent * x1 * x1
        stiffness[1, 2] += tangent * x1 * x2
        stiffness[2, 2] += tangent * x2 * x2
    stiffness[1, 0] = stiffness[0, 1]
    stiffness[2, 0] = stiffness[0, 2]
    stiffness[2, 1] = stiffness[1, 2]
    return True


@njit(cache=True)
def _solve(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    load: FloatArray,
    strain: FloatArray,
    stiffness: FloatArray,
) -> bool:
    """Newton with step halving on F(e) = load, from `strain`, in place; leaves K at the solution."""
    force = np.empty(3)
    trial = np.empty(3)
    radius = 0.0
    for n in range(points.shape[0]):
        radius = max(radius, abs(points[n, 0]), abs(points[n, 1]))
    if not _wall(points, code, wall, strain, force, stiffness):
        strain[0], strain[1], strain[2] = 1.0, 0.0, 0.0
        _wall(points, code, wall, strain, force, stiffness)
    for _ in range(_NEWTON_STEPS):
        step = np.linalg.solve(stiffness, load - force)
        size = abs(step[0]) + radius * (abs(step[1]) + abs(step[2]))
        fraction = min(1.0, 0.5 / size) if size > 0.0 else 1.0  # at most a strain of 50 % at once
        while True:
            trial[:] = strain + fraction * step
            if _wall(points, code, wall, trial, force, stiffness):
                break
            fraction *= 0.5
            if fraction < 1e-6:
                return False
        strain[:] = trial
        if size < 1e-13:
            return True
    return size < 1e-9


@njit(cache=True)
def _solve_each(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    loads: FloatArray,
    strains: FloatArray,
    stiffnesses: FloatArray,
) -> int:
    """`_solve` for each row of `loads`; the first row without an equilibrium, or -1."""
    for n in range(loads.shape[0]):
        if not _solve(points, code, wall, loads[n], strains[n], stiffnesses[n]):
            return n
    return -1


@njit(cache=True)
def _least_pressures(
    arms: FloatArray, wanted: FloatArray, usable: NDArray[np.bool_], room_Pa: float, pressure: FloatArray
) -> None:
    """Non-negative pressures with Σ arms_i p_i nearest to `wanted` (shape (2,)), of least sum among the exact ones.

    The nearest point of a plane cone lies inside the cone of two chambers, on the ray of one, or at the tip; all are
    tried. Pressures beyond `room_Pa` are scaled back together, which keeps the direction.
    """
    best_miss = wanted[0] ** 2 + wanted[1] ** 2
    best_sum = 0.0
    scale = best_miss
    pressure[:] = 0.0
    for i in range(arms.shape[1]):
        if not usable[i]:
            continue
        square = arms[0, i] ** 2 + arms[1, i] ** 2
        alone = (arms[0, i] * wanted[0] + arms[1, i] * wanted[1]) / square
        if alone > 0.0:
            miss = (arms[0, i] * alone - wanted[0]) ** 2 + (arms[1, i] * alone - wanted[1]) ** 2
            if miss < best_miss * (1.0 - 1e-12):
                best_miss, best_sum = miss, alone
                pressure[:] = 0.0
                pressure[i] = alone
        for j in range(i + 1, arms.shape[1]):
            if not usable[j]:
                continue
            determinant = arms[0, i] * arms[1, j] - arms[1, i] * arms[0, j]
            if abs(determinant) < 1e-9 * square:
                continue
            first = (wanted[0] * arms[1, j] - wanted[1] * arms[0, j]) / determinant
            second = (arms[0, i] * wanted[1] - arms[1, i] * wanted[0]) / determinant
            if first >= 0.0 and second >= 0.0:
                exact_before = best_miss <= 1e-20 * scale
                if not exact_before or first + second < best_sum:
                    best_miss, best_sum = 0.0, first + second
                    pressure[:] = 0.0
                    pressure[i], pressure[j] = first, second
    largest = 0.0
    for i in range(arms.shape[1]):
        largest = max(largest, pressure[i])
    if largest > room_Pa:
        for i in range(arms.shape[1]):
            pressure[i] *= room_Pa / largest


@njit(cache=True)
def _invert(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    load: FloatArray,
    usable: NDArray[np.bool_],
    co_contraction_Pa: float,
    limit_Pa: float,
    dead_band_Pa: float,
    strain: FloatArray,
    pressure: FloatArray,
) -> None:
    """Fixed point on the stretch: moments at the wanted curvature → pressures → stretch, until it rests."""
    force, stiffness = np.empty(3), np.empty((3, 3))
    bias = np.zeros(load.shape[1])
    for i in range(load.shape[1]):
        if usable[i]:
            bias[i] = max(co_contraction_Pa - dead_band_Pa, 0.0)
    wanted = strain[1:].copy()
    arms = load[1:, :].copy()
    extra = np.zeros(load.shape[1])
    room_Pa = max(limit_Pa - max(dead_band_Pa, co_contraction_Pa), 0.0)
    for _ in range(100):
        crushed = not _wall(points, code, wall, strain, force, stiffness)
        if crushed:  # a curvature that this stretch cannot hold: ask for less of it
            strain[1:] *= 0.7
            wanted[:] = strain[1:]
            continue
        moment = force[1:] - arms @ bias
        _least_pressures(arms, moment, usable, room_Pa, extra)
        axial = 0.0
        for i in range(load.shape[1]):
            axial += load[0, i] * (bias[i] + extra[i])
        correction = (axial - force[0]) / stiffness[0, 0]
        correction = min(max(correction, -0.2), 0.2)
        strain[0] += correction
        if abs(correction) < 1e-12:
            break
    for i in range(load.shape[1]):
        pressure[i] = 0.0
        if usable[i]:
            pressure[i] = co_contraction_Pa
            if extra[i] > 0.0:
                pressure[i] = min(bias[i] + extra[i] + dead_band_Pa, limit_Pa)
