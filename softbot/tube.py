"""Section mechanics of a thin-walled, internally pressurised, linear-elastic tube.

Implements the section relations of X. Liang et al., "Mechanics of soft-body rolling motion without external
torque" (below: the paper): axial strain from pressure, moment of a strain that is linear in the angle's place
on the section, muscle force, the moment–curvature relation with ovalisation, Eq. (2) in both directions, and
the kink that ends its stable branch. The moment–curvature relation is the paper's reference [25] (Qiu,
Hutchinson and Amir, 2022).

Scaled symbols: κ̄ = κR (scaled curvature) and p̄ = pR(1 − ν²)/(E₀h) (scaled pressure), both without unit.
Signs: the moment, the strain and the curvature are odd in one another, so either sign may be asked for.
Pressures are gauge.

Beyond the kink nothing is computed: a curvature, strain or moment outside the stable branch is a `KinkError`.
Left out: hoop fibres (a fibre-reinforced wall does not ovalise as this one does), hyperelasticity, and
post-kink states.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real

from softbot.errors import InputError, KinkError

# A limit that has gone through a rounded inverse may come back a few ulp beyond itself; that is no kink.
_LIMIT_ROUNDING = 1e-12


def finite_number(name: str, value: float) -> float:
    """Return `value` as a float; `InputError` naming `name` when it is not a finite real number."""
    # A text that looks like a number, or a truth value, is a mistake upstream.
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputError(f"{name} must be a number, got {value!r}")
    number = float(value)
    if not math.isfinite(number):
        raise InputError(f"{name} must be finite, got {number}")
    return number


def positive_number(name: str, value: float) -> float:
    """Return `value` as a float; `InputError` naming `name` when it is not finite and above zero."""
    number = finite_number(name, value)
    if number <= 0.0:
        raise InputError(f"{name} must be above zero, got {number:g}")
    return number


def _poisson(value: float) -> float:
    number = finite_number("poisson_ratio", value)
    if not -1.0 < number <= 0.5:
        raise InputError(f"poisson_ratio must be above -1 and at most 0.5, got {number:g}")
    return number


@dataclass(frozen=True)
class Tube:
    """A thin-walled circular tube of one linear-elastic material.

    radius_m: R [m]; wall_thickness_m: h [m], below R; youngs_modulus_Pa: E₀ [Pa]; poisson_ratio: ν, −1 < ν ≤
    0.5. Raises InputError for a value out of its range.
    """

    radius_m: float
    wall_thickness_m: float
    youngs_modulus_Pa: float
    poisson_ratio: float = 0.5

    def __post_init__(self) -> None:
        positive_number("radius_m", self.radius_m)
        positive_number("wall_thickness_m", self.wall_thickness_m)
        positive_number("youngs_modulus_Pa", self.youngs_modulus_Pa)
        _poisson(self.poisson_ratio)
        if self.wall_thickness_m >= self.radius_m:
            raise InputError(
                f"wall_thickness_m must be below radius_m, got {self.wall_thickness_m:g} and {self.radius_m:g}"
            )

    @property
    def bending_stiffness_N_m2(self) -> float:
        """Stiffness at zero curvature, πE₀R³h/(1 − ν²) [N m²]: M = this × κ before the section ovalises."""
        return (
            math.pi * self.youngs_modulus_Pa * self.radius_m**3 * self.wall_thickness_m / (1.0 - self.poisson_ratio**2)
        )


def axial_strain(tube: Tube, pressure_Pa: float) -> float:
    """Axial strain of the closed tube, ε₀ = pR/(2E₀h), from gauge pressure p ≥ 0 [Pa].

    Raises InputError for a negative pressure. Source: the paper, before Eq. (1).
    """
    pressure = finite_number("pressure_Pa", pressure_Pa)
    if pressure < 0.0:
        raise InputError(f"pressure_Pa must not be negative, got {pressure:g}")
    return pressure * tube.radius_m / (2.0 * tube.youngs_modulus_Pa * tube.wall_thickness_m)


def scaled_pressure(tube: Tube, pressure_Pa: float) -> float:
    """p̄ = pR(1 − ν²)/(E₀h) = 2(1 − ν²)ε₀, without unit, from gauge pressure p > 0 [Pa].

    Raises InputError unless the pressure is above zero. Source: the paper, above Eq. (2).
    """
    positive_number("pressure_Pa", pressure_Pa)
    return 2.0 * (1.0 - tube.poisson_ratio**2) * axial_strain(tube, pressure_Pa)


def pressure_from_scaled_Pa(tube: Tube, scaled_pressure_value: float) -> float:
    """Gauge pressure p = p̄E₀h/(R(1 − ν²)) [Pa] at a scaled pressure p̄ > 0: the paper's estimate for the
    larva.

    Check: p̄ = 3.3, h/R = 0.1, ν = 0.5, E₀ = 1.8…3.2 MPa gives 0.79…1.41 MPa. Raises InputError for p̄ ≤ 0.
    """
    p_bar = positive_number("scaled pressure", scaled_pressure_value)
    return p_bar * tube.youngs_modulus_Pa * tube.wall_thickness_m / (tube.radius_m * (1.0 - tube.poisson_ratio**2))


def strain_moment_N_m(tube: Tube, strain_difference: float) -> float:
    """Moment M = 8E₀R²hΔε/π [N m] of an axial strain that falls linearly with the angle θ round the section.

    The strain goes from ε₀ − Δε at θ = 0 through ε₀ at π/2 to ε₀ + Δε at π. Source: the paper, before Eq.
    (1).
    """
    strain = finite_number("strain_difference", strain_difference)
    return 8.0 * tube.youngs_modulus_Pa * tube.radius_m**2 * tube.wall_thickness_m * strain / math.pi


def muscle_force_N(tube: Tube, strain_difference: float) -> float:
    """Force of the active axial muscle that balances `strain_moment_N_m`: F_m = M/R = 8E₀RhΔε/π [N]."""
    return strain_moment_N_m(tube, strain_difference) / tube.radius_m


def strain_difference_from_lengths(
    inner_length_m: float, outer_length_m: float, scaled_pressure_value: float, poisson_ratio: float
) -> float:
    """Muscle strain Δε = p̄(l₂ − l₁)/(2(1 − ν²)(l₂ + l₁)) from its lengths at θ = 0 (l₁, inner) and π (l₂,
    outer) [m].

    Raises InputError for a length or p̄ that is not above zero. Source: the paper, note [26].
    """
    inner = positive_number("inner_length_m", inner_length_m)
    outer = positive_number("outer_length_m", outer_length_m)
    p_bar = positive_number("scaled pressure", scaled_pressure_value)
    nu = _poisson(poisson_ratio)
    return p_bar * (outer - inner) / (2.0 * (1.0 - nu**2) * (outer + inner))


def kink_scaled_curvature(scaled_pressure_value: float) -> float:
    """Scaled curvature κ̄c = √(8p̄/9) at which the stable branch ends (dM/dκ̄ = 0).

    Check: p̄ = 3.3 gives 1.7127. Raises InputError for p̄ ≤ 0.
    """
    return math.sqrt(8.0 * positive_number("scaled pressure", scaled_pressure_value) / 9.0)


def kink_curvature_1_m(tube: Tube, pressure_Pa: float) -> float:
    """Curvature κc = κ̄c/R [1/m] at which the tube kinks under gauge pressure p > 0 [Pa]."""
    return kink_scaled_curvature(scaled_pressure(tube, pressure_Pa)) / tube.radius_m


def _softened_curvature(scaled_curvature: float, p_bar: float) -> float:
    """The bracket κ̄ − 3κ̄³/(8p̄); `KinkError` beyond the stable branch."""
    kappa = finite_number("scaled curvature", scaled_curvature)
    limit = kink_scaled_curvature(p_bar)
    if abs(kappa) > limit * (1.0 + _LIMIT_ROUNDING):
        raise KinkError(
            f"scaled curvature {kappa:.6g} is beyond the kink limit {limit:.6g} (= sqrt(8 p/9) at scaled "
            f"pressure p = {p_bar:.6g}): the tube would kink; ask for less curvature or more pressure"
        )
    return kappa - 3.0 * kappa * kappa * kappa / (8.0 * p_bar)


def _stable_root(softened: float, limit: float) -> float:
    """The κ̄ in [−κ̄c, κ̄c] with κ̄ − 3κ̄³/(8p̄) = `softened`, for |softened| ≤ ⅔κ̄c.

    With κ̄ = 2κ̄c·sin u the cubic is ⅔κ̄c·sin 3u, so the stable root is exact and needs no iteration.
    """
    sine = max(-1.0, min(1.0, softened / (2.0 / 3.0 * limit)))
    return 2.0 * limit * math.sin(math.asin(sine) / 3.0)


def strain_difference_from_curvature(
    scaled_curvature: float, scaled_pressure_value: float, poisson_ratio: float
) -> float:
    """Eq. (2): Δε = π²/(8(1 − ν²))·[κ̄ − 3κ̄³/(8p̄)], on the stable branch.

    Raises KinkError for |κ̄| above √(8p̄/9), InputError for p̄ ≤ 0 or a Poisson ratio out of range.
    """
    p_bar = positive_number("scaled pressure", scaled_pressure_value)
    nu = _poisson(poisson_ratio)
    return math.pi**2 / (8.0 * (1.0 - nu**2)) * _softened_curvature(scaled_curvature, p_bar)


def max_strain_difference(scaled_pressure_value: float, poisson_ratio: float) -> float:
    """The largest Δε of the stable branch, Eq. (2) at the kink: π²/(8(1 − ν²))·⅔κ̄c."""
    nu = _poisson(poisson_ratio)
    return math.pi**2 / (8.0 * (1.0 - nu**2)) * 2.0 / 3.0 * kink_scaled_curvature(scaled_pressure_value)


def curvature_from_strain_difference(
    strain_difference: float, scaled_pressure_value: float, poisson_ratio: float
) -> float:
    """Eq. (2) solved for the scaled curvature κ̄ on the stable branch, |κ̄| ≤ √(8p̄/9).

    Raises KinkError when |Δε| is above `max_strain_difference`, InputError for p̄ ≤ 0 or a Poisson ratio out
    of range.
    """
    strain = finite_number("strain_difference", strain_difference)
    limit = max_strain_difference(scaled_pressure_value, poisson_ratio)
    if abs(strain) > limit * (1.0 + _LIMIT_ROUNDING):
        raise KinkError(
            f"strain difference {strain:.6g} is beyond the kink limit {limit:.6g} at scaled pressure "
            f"{scaled_pressure_value:.6g}: the tube would kink; ask for less strain or more pressure"
        )
    kink = kink_scaled_curvature(scaled_pressure_value)
    return _stable_root(strain / limit * (2.0 / 3.0 * kink), kink)


def bending_moment_N_m(tube: Tube, curvature_1_m: float, pressure_Pa: float) -> float:
    """Moment with ovalisation, M = πE₀R²h/(1 − ν²)·[κ̄ − 3κ̄³/(8p̄)] [N m], at curvature κ [1/m] and gauge p
    > 0 [Pa].

    Raises KinkError for |κ| above `kink_curvature_1_m`, InputError for p ≤ 0. Source: the paper, above Eq.
    (2).
    """
    kappa = finite_number("curvature_1_m", curvature_1_m)
    softened = _softened_curvature(kappa * tube.radius_m, scaled_pressure(tube, pressure_Pa))
    return tube.bending_stiffness_N_m2 / tube.radius_m * softened


def max_moment_N_m(tube: Tube, pressure_Pa: float) -> float:
    """Largest moment of the stable branch, M_max = ⅔·πE₀R²h/(1 − ν²)·κ̄c [N m], at gauge p > 0 [Pa]."""
    kink = kink_scaled_curvature(scaled_pressure(tube, pressure_Pa))
    return 2.0 / 3.0 * tube.bending_stiffness_N_m2 / tube.radius_m * kink


def curvature_from_moment_1_m(tube: Tube, moment_N_m: float, pressure_Pa: float) -> float:
    """Curvature κ [1/m] on the stable branch at moment M [N m] and gauge pressure p > 0 [Pa].

    Raises KinkError when |M| is above `max_moment_N_m`, InputError for p ≤ 0.
    """
    moment = finite_number("moment_N_m", moment_N_m)
    limit = max_moment_N_m(tube, pressure_Pa)
    if abs(moment) > limit * (1.0 + _LIMIT_ROUNDING):
        raise KinkError(
            f"moment {moment:.6g} N m is beyond the kink limit {limit:.6g} N m at gauge pressure "
            f"{pressure_Pa:.6g} Pa: the tube would kink; ask for less moment or more pressure"
        )
    kink = kink_scaled_curvature(scaled_pressure(tube, pressure_Pa))
    return _stable_root(moment / limit * (2.0 / 3.0 * kink), kink) / tube.radius_m
