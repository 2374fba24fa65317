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
_REACHED = 0.01  # of what was wanted
_STRAIGHT_1_M = 1e-6
_LOOKED_AT = 8  # stretches between the shortest tube and the longest
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
        if not _wall(self._points, *self._material(), strain, force, stiffness):
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
        if not _equilibrium(*numbers, pressure, strain, stiffness, jacobian):
            raise SimulationError(
                f"no equilibrium of the section at pressures {pressure.tolist()} Pa: they crush or burst it"
            )
        return Equilibrium(float(strain[0]), strain[1:], stiffness, jacobian)

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
        if not _inverse(*numbers, least, most, wanted, math.nan if stretch is None else stretch, pressure, given):
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
def _solve_symmetric(matrix: FloatArray, first: float, second: float, third: float, solution: FloatArray) -> bool:
    """x of a symmetric 3 × 3 system by its adjugate; False where it has none."""
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
    dd, ee, ff = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * aa + b * bb + c * cc
    if not abs(determinant) > 0.0:
        return False
    solution[0] = (aa * first + bb * second + cc * third) / determinant
    solution[1] = (bb * first + dd * second + ee * third) / determinant
    solution[2] = (cc * first + ee * second + ff * third) / determinant
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
    force, trial, step = np.empty(3), np.empty(3), np.empty(3)
    radius = 0.0
    for n in range(points.shape[0]):
        radius = max(radius, abs(points[n, 0]), abs(points[n, 1]))
    if not _wall(points, code, wall, strain, force, stiffness):
        strain[0], strain[1], strain[2] = 1.0, 0.0, 0.0
        _wall(points, code, wall, strain, force, stiffness)
    for _ in range(_NEWTON_STEPS):
        if not _solve_symmetric(stiffness, load[0] - force[0], load[1] - force[1], load[2] - force[2], step):
            return False
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
def _equilibrium(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    load: FloatArray,
    dead_band_Pa: float,
    pressure_Pa: FloatArray,
    strain: FloatArray,
    stiffness: FloatArray,
    jacobian: FloatArray,
) -> bool:
    """Strains (3,) at rest under the pressures (4,), from `strain`; their stiffness and ∂strain/∂pressure (3, 4)."""
    force, column = np.zeros(3), np.empty(3)
    for i in range(load.shape[1]):
        effective = max(pressure_Pa[i] - dead_band_Pa, 0.0) + min(pressure_Pa[i], 0.0)
        for k in range(3):
            force[k] += load[k, i] * effective
    if not _solve(points, code, wall, force, strain, stiffness):
        return False
    for i in range(load.shape[1]):
        # at the edge of the dead band the slope is that of rising pressure
        active = 1.0 if pressure_Pa[i] >= dead_band_Pa or pressure_Pa[i] < 0.0 else 0.0
        _solve_symmetric(stiffness, active * load[0, i], active * load[1, i], active * load[2, i], column)
        jacobian[:, i] = column
    return True


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
def _least_pressures(arms: FloatArray, wanted: FloatArray, room_Pa: FloatArray, pressure: FloatArray) -> None:
    """Non-negative pressures with Σ arms_i p_i nearest to `wanted` (shape (2,)), of least sum among the exact ones.

    The nearest point of a plane cone lies inside the cone of two chambers, on the ray of one, or at the tip; all are
    tried. Pressures beyond `room_Pa`, shape (4,), are scaled back together, which keeps the direction; chambers
    without room are not used.
    """
    best_miss = wanted[0] ** 2 + wanted[1] ** 2
    best_sum = 0.0
    scale = best_miss
    pressure[:] = 0.0
    for i in range(arms.shape[1]):
        if room_Pa[i] <= 0.0:
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
            if room_Pa[j] <= 0.0:
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
    share = 1.0
    for i in range(arms.shape[1]):
        if pressure[i] > room_Pa[i]:
            share = min(share, room_Pa[i] / pressure[i])
    for i in range(arms.shape[1]):
        pressure[i] *= share


@njit(cache=True)
def _invert(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    load: FloatArray,
    least_Pa: FloatArray,
    room_Pa: FloatArray,
    strain: FloatArray,
    extra: FloatArray,
) -> None:
    """Fixed point on the stretch: moments at the wanted curvature → pressures → stretch, until it rests.

    Pressures are those that load the wall: `least_Pa` (4,) and what comes on top, `extra` (4,) ≤ `room_Pa` (4,),
    written. `strain` holds the wanted curvature, and at the end the stretch too.
    """
    force, stiffness = np.empty(3), np.empty((3, 3))
    arms = load[1:, :].copy()
    extra[:] = 0.0
    for _ in range(100):
        crushed = not _wall(points, code, wall, strain, force, stiffness)
        if crushed:  # a curvature that this stretch cannot hold: ask for less of it
            strain[1:] *= 0.7
            continue
        moment = force[1:] - arms @ least_Pa
        _least_pressures(arms, moment, room_Pa, extra)
        axial = 0.0
        for i in range(load.shape[1]):
            axial += load[0, i] * (least_Pa[i] + extra[i])
        correction = (axial - force[0]) / stiffness[0, 0]
        correction = min(max(correction, -0.2), 0.2)
        strain[0] += correction
        if abs(correction) < 1e-12:
            break


@njit(cache=True)
def _longest_pressures(
    load: FloatArray, moment_N_m: FloatArray, axial_N: float, room_Pa: FloatArray, extra: FloatArray
) -> int:
    """Pressures within the room that carry the moments (2,) exactly, with an axial force as near `axial_N` as may be.

    The pressures that carry the moments are a convex set whose corners have all but two chambers at a limit: the ones
    of least and of largest axial force are found among those, and the force wanted lies on the line between them.
    Returns 0 where it is met, −1 or +1 where the least or the largest is too much or too little for it, 2 where the
    moments cannot be carried.
    """
    low_N, high_N = np.inf, -np.inf
    low, high, trial = np.empty(load.shape[1]), np.empty(load.shape[1]), np.empty(load.shape[1])
    scale = 0.0
    for i in range(load.shape[1]):
        scale = max(scale, room_Pa[i])
    slack = 1e-9 * scale
    for i in range(load.shape[1]):
        for j in range(i + 1, load.shape[1]):
            determinant = load[1, i] * load[2, j] - load[1, j] * load[2, i]
            if abs(determinant) < 1e-9 * (load[1, i] ** 2 + load[2, i] ** 2):
                continue
            for full in range(4):
                trial[:] = 0.0
                first, second = moment_N_m[0], moment_N_m[1]
                bit = 1
                for k in range(load.shape[1]):
                    if k not in (i, j):
                        if full & bit:
                            trial[k] = room_Pa[k]
                            first -= load[1, k] * room_Pa[k]
                            second -= load[2, k] * room_Pa[k]
                        bit *= 2
                trial[i] = (first * load[2, j] - second * load[1, j]) / determinant
                trial[j] = (load[1, i] * second - load[2, i] * first) / determinant
                if min(trial[i], trial[j]) < -slack or trial[i] > room_Pa[i] + slack or trial[j] > room_Pa[j] + slack:
                    continue
                force_N = 0.0
                for k in range(load.shape[1]):
                    force_N += load[0, k] * trial[k]
                if force_N < low_N:
                    low_N = force_N
                    low[:] = trial
                if force_N > high_N:
                    high_N = force_N
                    high[:] = trial
    if high_N < low_N:
        return 2
    span = high_N - low_N
    share = (axial_N - low_N) / span if span > 0.0 else (0.0 if axial_N <= low_N else 1.0)
    for k in range(load.shape[1]):
        between = low[k] + min(max(share, 0.0), 1.0) * (high[k] - low[k])
        extra[k] = min(max(between, 0.0), room_Pa[k])
    slip = 1e-9 * max(abs(low_N), abs(high_N))
    if axial_N < low_N - slip:
        return -1
    return 1 if axial_N > high_N + slip else 0


@njit(cache=True)
def _holds(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    load: FloatArray,
    least_Pa: FloatArray,
    room_Pa: FloatArray,
    strain: FloatArray,
    extra: FloatArray,
) -> int:
    """Whether the chambers can hold a strain (3,), and with what: `_longest_pressures` of the wall's forces there.

    3 where the wall has none: its inner side is crushed, or it is drawn beyond its law.
    """
    force, stiffness = np.empty(3), np.empty((3, 3))
    if not _wall(points, code, wall, strain, force, stiffness):
        return 3
    for i in range(load.shape[1]):
        for k in range(3):
            force[k] -= load[k, i] * least_Pa[i]
    return _longest_pressures(load, force[1:], force[0], room_Pa, extra)


@njit(cache=True)
def _shortest_of_curvature(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    load: FloatArray,
    least_Pa: FloatArray,
    room_Pa: FloatArray,
    longest: float,
    tries: int,
    strain: FloatArray,
    extra: FloatArray,
) -> bool:
    """The shortest stretch from `strain[0]` to `longest`, by `tries` halvings, that can hold the curvature in `strain`.

    Writes it to `strain[0]` and its pressures to `extra`; False, and `extra` is spoilt, where there is none.
    """
    trial, found = strain.copy(), np.empty(load.shape[1])
    short, long, holds = strain[0], longest, False
    for n in range(_LOOKED_AT):  # what carries the bend may be neither the shortest nor the longest
        trial[0] = strain[0] + (longest - strain[0]) * (n + 1) / _LOOKED_AT
        if _holds(points, code, wall, load, least_Pa, room_Pa, trial, found) == 0:
            short, long = strain[0] + (longest - strain[0]) * n / _LOOKED_AT, trial[0]
            holds = True
            extra[:] = found
            break
    for _ in range(tries):
        trial[0] = 0.5 * (short + long)
        side = _holds(points, code, wall, load, least_Pa, room_Pa, trial, found)
        if side == 0:
            holds = True
            extra[:] = found
        if side in (0, 1):
            long = trial[0]
        else:
            short = trial[0]
    if holds:
        strain[0] = long
    return holds


@njit(cache=True)
def _invert_longer(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    load: FloatArray,
    least_Pa: FloatArray,
    room_Pa: FloatArray,
    wanted_1_m: FloatArray,
    strain: FloatArray,
    extra: FloatArray,
) -> bool:
    """From pressures that miss a curvature, `strain` (3,) and `extra` (4,), to those of a longer tube that has it.

    A wall that softens as it is stretched is bent further by filling the other chambers too. Where not even that
    gives the wanted curvature, as far towards it as can be. Both are moved on in place; False where nothing is gained.
    """
    across = abs(strain[1] * wanted_1_m[1] - strain[2] * wanted_1_m[0])
    along = strain[1] * wanted_1_m[0] + strain[2] * wanted_1_m[1]
    if across > 0.3 * along:  # the direction cannot be had, however long the tube is
        return False
    full, force, stiffness = np.array([1.0, 0.0, 0.0]), np.zeros(3), np.empty((3, 3))
    for i in range(load.shape[1]):
        force[0] += load[0, i] * (least_Pa[i] + room_Pa[i])
    if not _solve(points, code, wall, force, full, stiffness):
        return False
    near, trial, found = strain.copy(), strain.copy(), np.empty(load.shape[1])
    low, high, gained = 0.0, 2.0, False
    for _ in range(9):  # 1, then halves: as near as 1/256
        share = 0.5 * (low + high)
        trial[0] = near[0]
        trial[1:] = near[1:] + share * (wanted_1_m - near[1:])
        tries = 40 if share == 1.0 else 16
        if _shortest_of_curvature(points, code, wall, load, least_Pa, room_Pa, full[0], tries, trial, found):
            gained = True
            strain[:] = trial
            extra[:] = found
            if share == 1.0:
                break
            low = share
        else:
            high = share
    return gained


@njit(cache=True)
def _invert_stretched(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    load: FloatArray,
    least_Pa: FloatArray,
    room_Pa: FloatArray,
    stretch: float,
    strain: FloatArray,
    extra: FloatArray,
) -> None:
    """From `_invert`'s solution of least pressure to a longer tube of the same curvature: `stretch`, or the longest.

    `strain` (3,) and `extra` (4,) are moved on in place; left as they are where the chambers cannot carry the bend.
    """
    trial, found = strain.copy(), np.empty(load.shape[1])
    shortest, longest = strain[0], stretch
    trial[0] = stretch
    for _ in range(40):
        side = _holds(points, code, wall, load, least_Pa, room_Pa, trial, found)
        if side == 0:
            strain[:] = trial
            extra[:] = found
            if trial[0] == stretch:
                return
        if side > 0:
            longest = trial[0]
        else:
            shortest = trial[0]
        if longest - shortest < 1e-12:
            return
        trial[0] = 0.5 * (shortest + longest)


@njit(cache=True)
def _loaded(
    load: FloatArray,
    dead_band_Pa: float,
    least_Pa: FloatArray,
    most_Pa: FloatArray,
    least_load_Pa: FloatArray,
    extra: FloatArray,
    pressure_Pa: FloatArray,
) -> None:
    """Chamber pressures (4,) of what loads the wall: a chamber at its least is left there."""
    for i in range(load.shape[1]):
        pressure_Pa[i] = least_Pa[i]
        if extra[i] > 0.0:
            pressure_Pa[i] = max(least_Pa[i], min(least_load_Pa[i] + extra[i] + dead_band_Pa, most_Pa[i]))


@njit(cache=True)
def _inverse(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    load: FloatArray,
    dead_band_Pa: float,
    least_Pa: FloatArray,
    most_Pa: FloatArray,
    wanted_1_m: FloatArray,
    stretch: float,
    pressure_Pa: FloatArray,
    given: FloatArray,
) -> bool:
    """Pressures (4,) for a curvature (2,) and a stretch (NaN: whatever goes with least pressure), and what they give.

    What loads the wall are pressures less the dead band. False where the pressures have no equilibrium.
    """
    chambers = load.shape[1]
    least_load, room, extra = np.empty(chambers), np.empty(chambers), np.empty(chambers)
    for i in range(chambers):
        least_load[i] = max(least_Pa[i] - dead_band_Pa, 0.0)
        room[i] = max(most_Pa[i] - dead_band_Pa, 0.0) - least_load[i]
    stiffness, jacobian = np.empty((3, 3)), np.empty((3, chambers))
    strain = np.array([stretch, wanted_1_m[0], wanted_1_m[1]])
    if stretch > 0.0 and _holds(points, code, wall, load, least_load, room, strain, extra) == 0:
        _loaded(load, dead_band_Pa, least_Pa, most_Pa, least_load, extra, pressure_Pa)
        given[0], given[1], given[2] = 1.0, 0.0, 0.0
        return _equilibrium(points, code, wall, load, dead_band_Pa, pressure_Pa, given, stiffness, jacobian)
    strain[0] = 1.0
    _invert(points, code, wall, load, least_load, room, strain, extra)
    _loaded(load, dead_band_Pa, least_Pa, most_Pa, least_load, extra, pressure_Pa)
    given[0], given[1], given[2] = 1.0, 0.0, 0.0
    if not _equilibrium(points, code, wall, load, dead_band_Pa, pressure_Pa, given, stiffness, jacobian):
        return False
    missed = math.hypot(given[1] - wanted_1_m[0], given[2] - wanted_1_m[1])
    moved = False
    if missed > 1e-4 * math.hypot(wanted_1_m[0], wanted_1_m[1]) + _STRAIGHT_1_M:
        strain[:] = given
        moved = _invert_longer(points, code, wall, load, least_load, room, wanted_1_m, strain, extra)
    if stretch > strain[0]:
        _invert_stretched(points, code, wall, load, least_load, room, stretch, strain, extra)
        moved = True
    if not moved:
        return True
    _loaded(load, dead_band_Pa, least_Pa, most_Pa, least_load, extra, pressure_Pa)
    given[0], given[1], given[2] = 1.0, 0.0, 0.0
    return _equilibrium(points, code, wall, load, dead_band_Pa, pressure_Pa, given, stiffness, jacobian)
