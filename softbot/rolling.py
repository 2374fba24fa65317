"""Closed-form theory of rolling by a turning C-bend: moments, friction, advance, dead chambers.

Implements X. Liang et al., "Mechanics of soft-body rolling motion without external torque" (below: the
paper): Eq. (1) and its N-segment form, the rotation moment, friction without slip and on a flat floor. The
floating ratio (conservation of angular momentum of a uniform rod bent to an arc) and the two advance ratios
(force balance of a slow arc on a floor) are this project's rulers for accuracy: two engines that share no
code reproduce them.

Symbols: half bend φ₀ = κL/2, so the bend is 2φ₀ [rad]; s = sinφ₀/φ₀; θ is the angle of the active muscle or
chamber from the inner side of the C, right-handed about the tangent t. A negative φ₀ is the C that opens the
other way, with θ still measured from the side that is inner at positive φ₀. Left is z × t, seen facing along
t with z up.

Left out: inertia and gravity in the moments, and the unlocking of fast sequences, which only a twin shows.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softbot.cross_section import CHAMBER_ANGLES_RAD, CHAMBERS
from softbot.errors import InputError
from softbot.tube import finite_number, positive_number

Actuator = Literal["muscle", "chamber"]  # a muscle contracts its side, a chamber elongates it

# 1 − v is under 0.014 φ₀² for half bends below 1e-6; below this one it is under half an ulp of 1.
_STRAIGHT_HALF_BEND_RAD = 1e-8
# Against the same root by elliptic integrals at 40 digits, over φ₀ = 1e-8 … 3.14, the slip 1 − v is right to
# 1e-14 of itself with 32 points; more points only add the rounding of the rule.
_GAUSS_POINTS = 32


def _half_bend(value: float, *, closed: bool) -> float:
    """|φ₀| of an arc that does not overlap itself: below π, or up to π where `closed` allows the circle."""
    size = abs(finite_number("half_bend_rad", value))
    if size > math.pi or (size == math.pi and not closed):
        raise InputError(
            f"half_bend_rad must stay {'within' if closed else 'below'} pi (the arc closes), got {value:g}"
        )
    return size


def _segments(value: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise InputError(f"segments must be a whole number of at least 1, got {value!r}")
    return int(value)


def wrap_angle_rad(angle_rad: float) -> float:
    """The same angle in (−π, π] [rad]."""
    wrapped = math.remainder(finite_number("angle_rad", angle_rad), 2.0 * math.pi)
    return math.pi if wrapped == -math.pi else wrapped


# --- moments ------------------------------------------------------------


def rolling_moment_N_m(force_N: float, radius_m: float, half_bend_rad: float, theta_rad: float) -> float:
    """Eq. (1): rolling moment along t of a contracting muscle, M_roll = −2F_mR·sinφ₀·sinθ [N m].

    force_N: muscle force F_m [N]; an elongating chamber is a muscle of negative force. Changing the signs of
    φ₀ and θ together leaves it as it was: the paper's recovery. Raises InputError for values that are not
    finite or radius ≤ 0.
    """
    force = finite_number("force_N", force_N)
    radius = positive_number("radius_m", radius_m)
    phi0 = finite_number("half_bend_rad", half_bend_rad)
    theta = finite_number("theta_rad", theta_rad)
    return -2.0 * force * radius * math.sin(phi0) * math.sin(theta)


def segmented_rolling_moment_N_m(
    force_N: float, radius_m: float, half_bend_rad: float, theta_rad: float, segments: int
) -> float:
    """Total rolling moment of N segments about the curved axis, N·2F_mR·sin(φ₀/N)·sinθ [N m].

    Printed in the paper without the minus of Eq. (1), and so here: at N = 1 it is minus `rolling_moment_N_m`.
    It grows with N to 2F_mR·φ₀·sinθ. Raises InputError as `rolling_moment_N_m` does, and for segments < 1.
    """
    count = _segments(segments)
    phi0 = finite_number("half_bend_rad", half_bend_rad)
    return -count * rolling_moment_N_m(force_N, radius_m, phi0 / count, theta_rad)


def rotation_moment_N_m(
    force_N: float, radius_m: float, half_bend_rad: float, theta_rad: float, segments: int
) -> float:
    """Moment of the end muscles that turns the C as a whole, M_rot = 2F_mR·cos(φ₀/N)·sinφ₀·sinθ [N m].

    Opposite in sign to Eq. (1): the whole turns against the rolling. Raises InputError as the segmented
    rolling moment does.
    """
    count = _segments(segments)
    phi0 = finite_number("half_bend_rad", half_bend_rad)
    return -math.cos(phi0 / count) * rolling_moment_N_m(force_N, radius_m, phi0, theta_rad)


# --- direction ------------------------------------------------------------


def _muscle_angle_rad(theta_rad: float, actuator: Actuator) -> float:
    """θ of the contraction that bends as this actuator does: an elongation at θ is one at θ + π."""
    if actuator not in ("muscle", "chamber"):
        raise InputError(f"actuator must be 'muscle' or 'chamber', got {actuator!r}")
    theta = finite_number("theta_rad", theta_rad)
    return wrap_angle_rad(theta + math.pi if actuator == "chamber" else theta)


def rolling_direction(half_bend_rad: float, theta_rad: float, actuator: Actuator) -> int:
    """Sign of the revolutions about t (−1, 0, +1) that one active element at θ drives: the sign of Eq. (1).

    A muscle (contracts) at 0 < θ < π gives −1, a chamber (elongates) at the same θ +1; 0 at θ = 0 and π, and
    without bend. −1 moves the body to its left, z × t. Raises InputError for another actuator or values that
    are not finite.
    """
    sines = (
        math.sin(finite_number("half_bend_rad", half_bend_rad)),
        math.sin(_muscle_angle_rad(theta_rad, actuator)),
    )
    # sin(pi) is not 0 in floating point; a sine at rounding level drives nothing.
    if any(abs(sine) < 1e-15 for sine in sines):
        return 0
    return -1 if (sines[0] > 0.0) == (sines[1] > 0.0) else 1


def bend_reverses(theta_rad: float, actuator: Actuator = "muscle") -> bool:
    """True when the active element flips the C instead of rolling it: |θ| > π/2 for a contracting muscle.

    θ is from the present inner side. An elongating chamber is a contraction at θ + π, so it flips the C when
    it lies on the inner half, |θ| < π/2. Raises InputError for another actuator or an angle that is not
    finite.
    """
    return abs(_muscle_angle_rad(theta_rad, actuator)) > math.pi / 2.0


def material_spin_rad_s(bend_direction_rate_rad_s: float) -> float:
    """Roll rate of the material about t against the plane of the C [rad/s]: −(rate of the bend direction).

    The direction of the C in space is roll + bend direction in the body. While the plane of the C holds still
    (a floor, phase lock) their sum is constant, so `direction = +1` gives negative revolutions.
    """
    return -finite_number("bend_direction_rate_rad_s", bend_direction_rate_rad_s)


def rolling_velocity_m_s(spin_rad_s: float, radius_m: float, tangent: ArrayLike) -> NDArray[np.float64]:
    """Velocity (3,) [m/s] of a section's centre that rolls without slip on the floor z = 0: spin·t × R·z.

    spin_rad_s: right-handed about t [rad/s]; tangent: t (3,), horizontal, any length. Negative spin moves
    along z × t, to the left. Raises InputError for a tangent that is not a horizontal, nonzero, finite
    3-vector, or radius ≤ 0.
    """
    spin = finite_number("spin_rad_s", spin_rad_s)
    radius = positive_number("radius_m", radius_m)
    try:
        direction = np.asarray(tangent, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"tangent must be three numbers, got {tangent!r}") from None
    if direction.shape != (3,) or not np.all(np.isfinite(direction)):
        raise InputError(f"tangent must be three finite numbers, got {tangent!r}")
    length = float(np.linalg.norm(direction))
    if length == 0.0 or abs(direction[2]) > 1e-9 * length:
        raise InputError(f"tangent must be horizontal and not zero, got {tangent!r}")
    return np.cross(spin * direction / length, (0.0, 0.0, radius))


# --- friction ------------------------------------------------------------


def non_slip_friction_N(rolling_moment_value_N_m: float, threshold_moment_N_m: float, radius_m: float) -> float:
    """Friction of rolling without slip, f = 2(M_roll − M_th)/(3R) [N], with the sign of M_roll [N m].

    threshold_moment_N_m: resistance M_th ≥ 0 [N m], against the rolling; at |M_roll| ≤ M_th the body stays
    and f is 0. It is the solid cylinder's balance f = ma, M_roll − M_th − fR = ½mR²·a/R. Raises InputError
    for M_th < 0 or radius ≤ 0.
    """
    moment = finite_number("rolling_moment_value_N_m", rolling_moment_value_N_m)
    threshold = finite_number("threshold_moment_N_m", threshold_moment_N_m)
    radius = positive_number("radius_m", radius_m)
    if threshold < 0.0:
        raise InputError(f"threshold_moment_N_m must not be negative, got {threshold:g}")
    excess = max(0.0, abs(moment) - threshold)
    return math.copysign(2.0 * excess / (3.0 * radius), moment) if excess else 0.0


class FlatFloorFriction(NamedTuple):
    """Friction on a flat floor [N]: `rolling_N` (f_r) against the roll, `translation_N` (f_t) the travel."""

    rolling_N: float
    translation_N: float


def _one_minus_s_squared(phi0: float) -> float:
    """1 − s² without cancellation: 1 − s from its series φ₀²/3! − φ₀⁴/5! + … where φ₀ < 1."""
    s = math.sin(phi0) / phi0
    if phi0 >= 1.0:
        return 1.0 - s * s
    term, total, n = phi0 * phi0 / 6.0, 0.0, 1
    while abs(term) > 1e-18 * abs(total):
        total += term
        n += 1
        term *= -phi0 * phi0 / (2 * n * (2 * n + 1))
    return total * (1.0 + s)


def flat_floor_friction(non_slip_friction_value_N: float, half_bend_rad: float) -> FlatFloorFriction:
    """Steady friction on a flat floor, f_r = 3f/(2(1 − s²)) and f_t = s·f_r [N], from the non-slip f [N].

    The paper prints this as "3f/2(1 − sin²φ₀/φ₀²)", where the line hides that the bracket divides: only so is
    its own balance met (`flat_floor_balance_N`). f_r grows without bound as the body gets straight. Raises
    InputError for |φ₀| > π and where the body is so straight (φ₀ = 0 included) that f_r overflows.
    """
    friction = finite_number("non_slip_friction_value_N", non_slip_friction_value_N)
    phi0 = _half_bend(half_bend_rad, closed=True)
    one_minus_s_squared = _one_minus_s_squared(phi0) if phi0 else 0.0
    rolling = 1.5 * friction / one_minus_s_squared if one_minus_s_squared else math.inf
    if not math.isfinite(rolling):
        raise InputError(f"half_bend_rad {phi0:g} is too slight: a straight body has no steady balance")
    return FlatFloorFriction(rolling, math.sin(phi0) / phi0 * rolling)


def flat_floor_balance_N(
    friction: FlatFloorFriction,
    half_bend_rad: float,
    rolling_moment_value_N_m: float,
    threshold_moment_N_m: float,
    radius_m: float,
) -> float:
    """Residual [N] of the paper's balance f_r(s/2 + 1) − (f_t/2)(1 + 2s) = (M_roll − M_th)/R; 0 when met.

    M_th takes the sign of M_roll. Raises InputError for radius ≤ 0, M_th < 0 or |φ₀| > π.
    """
    phi0 = _half_bend(half_bend_rad, closed=True)
    s = viscous_advance_ratio(phi0) if phi0 < math.pi else 0.0
    drive = 1.5 * non_slip_friction_N(rolling_moment_value_N_m, threshold_moment_N_m, radius_m)
    return friction.rolling_N * (s / 2.0 + 1.0) - friction.translation_N / 2.0 * (1.0 + 2.0 * s) - drive


# --- the rulers: floating, and advance on a floor ------------------------


def _arc_variance_over_phi0_squared(phi0: float) -> float:
    """(⟨cos²φ⟩ − ⟨cosφ⟩²)/φ₀² over the arc −φ₀…φ₀.

    ½(1 + s·cosφ₀) − s² cancels as φ₀⁴/45, so small arcs take its series Σₙ₌₂ (−1)ⁿ(n − 1)(2φ₀)²ⁿ/(2n + 2)!.
    """
    if phi0 >= 1.0:
        s = math.sin(phi0) / phi0
        return (0.5 * (1.0 + s * math.cos(phi0)) - s * s) / (phi0 * phi0)
    x_squared = (2.0 * phi0) ** 2
    power_over_factorial = 4.0 * x_squared / 720.0  # (2φ₀)⁴/6!, divided by φ₀²
    total, n = 0.0, 2
    while True:
        term = (n - 1) * power_over_factorial
        total += term
        if abs(term) <= 1e-18 * abs(total):
            return total
        n += 1
        power_over_factorial *= -x_squared / ((2 * n + 1) * (2 * n + 2))


def floating_ratio(length_m: float, radius_m: float, curvature_1_m: float) -> float:
    """Ω/α̇ = J_p·L·s/I_xx of a floating bent rod: whole-body rate over the spin of the curvature.

    length_m: L [m]; radius_m: R [m]; curvature_1_m: κ [1/m], either sign, |κ|L ≤ 2π. Ω is about the chord,
    opposite to the material's own rolling, and keeps the angular momentum at 0. J_p = λR²/2;
    I_xx = ∫[λ(y − ȳ)² + J_p·cos²φ + ½J_p·sin²φ]ds
         = λL·[(L/2)²·(½(1 + s·cosφ₀) − s²)/φ₀² + R²(3 + s·cosφ₀)/8].
    Check: L = 0.15, R = 0.01: κ = 12 → 0.3238, κ = 8 → 0.5231; straight → 1. Raises InputError for values
    out of range.
    """
    length = positive_number("length_m", length_m)
    radius = positive_number("radius_m", radius_m)
    phi0 = _half_bend(finite_number("curvature_1_m", curvature_1_m) * length / 2.0, closed=True)
    s = math.sin(phi0) / phi0 if phi0 else 1.0
    slenderness_squared = (length / radius) ** 2
    inertia = slenderness_squared / 4.0 * _arc_variance_over_phi0_squared(phi0)
    inertia += (3.0 + s * math.cos(phi0)) / 8.0
    return 0.5 * s / inertia


def viscous_advance_ratio(half_bend_rad: float) -> float:
    """Advance per revolution over 2πR on a flat floor under viscous friction: s = sinφ₀/φ₀.

    Friction per length is proportional to the sliding speed. Check: φ₀ = 0.9 → 0.8704. Even in φ₀. Raises
    InputError for |φ₀| ≥ π.
    """
    phi0 = _half_bend(half_bend_rad, closed=False)
    return math.sin(phi0) / phi0 if phi0 else 1.0


@lru_cache(maxsize=1)
def _gauss_rule() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    nodes, weights = np.polynomial.legendre.leggauss(_GAUSS_POINTS)
    return 0.5 * (nodes + 1.0), 0.5 * weights


def coulomb_force_balance(slip: float, half_bend_rad: float) -> float:
    """∫₀^φ₀ (v − cosφ)/√(sin²φ + (v − cosφ)²) dφ at v = 1 − slip.

    The net Coulomb friction against the travel on half the arc, over µ × load per angle. slip = 1 − v, in (0,
    1]; the argument because v is close to 1 for slight bends. The integrand turns over within φ ≈ slip (its
    poles lie near ±i·slip/√v), so the quadrature is taken in τ with φ = slip·sinh τ, where the poles are at
    least π/2 away whatever the slip. Increases with v, so its zero is unique. Raises InputError for values
    out of range.
    """
    slip = positive_number("slip", slip)
    if slip > 1.0:
        raise InputError(f"slip must be at most 1, got {slip:g}")
    phi0 = _half_bend(half_bend_rad, closed=False)
    nodes, weights = _gauss_rule()
    tau_end = math.asinh(phi0 / slip)
    tau = tau_end * nodes
    half_chord_squared = np.sin(0.5 * slip * np.sinh(tau)) ** 2
    across = 2.0 * half_chord_squared - slip  # v − cosφ without cancellation
    sliding = np.sqrt(slip * slip + 4.0 * (1.0 - slip) * half_chord_squared)
    return float(tau_end * slip * np.sum(weights * np.cosh(tau) * across / sliding))


def coulomb_advance_ratio(half_bend_rad: float) -> float:
    """Advance per revolution over 2πR of a slow arc on a flat floor under Coulomb friction and uniform load.

    The v with ∫₀^φ₀ (v − cosφ)/√(sin²φ + (v − cosφ)²) dφ = 0, to rounding; the coefficient of friction drops
    out. Check: φ₀ = 0.5 → 0.9853, 0.9 → 0.9428, 1.2 → 0.8879; 1 when straight. Even in φ₀. Raises InputError
    for |φ₀| ≥ π.
    """
    phi0 = _half_bend(half_bend_rad, closed=False)
    if phi0 < _STRAIGHT_HALF_BEND_RAD:
        return 1.0
    from scipy.optimize import brentq

    # v lies in (max(0, cosφ₀), 1): at cosφ₀ every point drags, at 0 the balance is −sinφ₀, at 1 every point
    # pushes.
    largest = min(1.0, 2.0 * math.sin(phi0 / 2.0) ** 2)
    slip = brentq(coulomb_force_balance, 1e-4 * largest, largest, args=(phi0,), xtol=1e-30, rtol=1e-15)
    return 1.0 - float(slip)


# --- chambers ------------------------------------------------------------


def _chamber(value: int) -> int:
    """`value` as a chamber index 0…3; InputError when it is none."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 0 <= value < CHAMBERS:
        raise InputError(f"chamber must be a whole number from 0 to {CHAMBERS - 1}, got {value!r}")
    return int(value)


def chamber_angle_rad(chamber: int) -> float:
    """Body angle αᵢ = i·90° of chamber i [rad], from e1 towards e2, in (−π, π]."""
    return wrap_angle_rad(CHAMBER_ANGLES_RAD[_chamber(chamber)])


def chamber_bend_direction_rad(chamber: int) -> float:
    """Body direction of the curvature that chamber i alone gives [rad]: αᵢ + π, away from its own side."""
    return wrap_angle_rad(chamber_angle_rad(chamber) + math.pi)


def chamber_theta_rad(chamber: int, bend_direction_rad: float) -> float:
    """θ of chamber i [rad] in (−π, π]: its angle from the inner side, αᵢ − bend direction (body frame)."""
    return wrap_angle_rad(chamber_angle_rad(chamber) - finite_number("bend_direction_rad", bend_direction_rad))


@dataclass(frozen=True)
class ReachableDirections:
    """The body directions of the curvature vector that the live chambers can give with pressures ≥ 0.

    centre_rad, half_width_rad: the closed arc of directions [rad]; for "line" the arc is one of its two rays
    (width 0), and the opposite one is reachable too. "none": no live chamber, half_width_rad is −1 and
    centre_rad 0.
    """

    kind: Literal["plane", "half plane", "quarter plane", "line", "ray", "none"]
    centre_rad: float
    half_width_rad: float

    def contains(self, direction_rad: float, tolerance_rad: float = 1e-9) -> bool:
        """True when the direction [rad] is reachable, its edge included to `tolerance_rad`."""
        off_centre = abs(wrap_angle_rad(finite_number("direction_rad", direction_rad) - self.centre_rad))
        if self.kind == "line":
            off_centre = min(off_centre, math.pi - off_centre)
        return self.kind != "none" and off_centre <= self.half_width_rad + tolerance_rad

    @property
    def allows_rolling_by_reversal(self) -> bool:
        """True when the reachable directions let the body roll for ever, with reversals where needed.

        Sweep, reverse, sweep again (the paper's recovery) needs an arc that holds the opposite of its own
        edge: a half plane or more. The line holds opposites and no sweep, the quarter plane a sweep and no
        opposite.
        """
        return self.half_width_rad >= math.pi / 2.0


def reachable_half_plane(dead_chambers: Iterable[int]) -> ReachableDirections:
    """Reachable curvature directions without `dead_chambers` (indices 0…3, any number, repeats allowed).

    With one dead chamber j: the half plane centred on αⱼ. Its edges are where θⱼ = ±π/2, which is where a
    roll under feedback stops; the exactly opposite curvature is on the other edge, and from there the sweep
    goes on. Two adjacent dead leave a quarter plane, two opposite a line, three a ray. Raises InputError for
    an index that is no chamber.
    """
    dead = {_chamber(chamber) for chamber in dead_chambers}
    live = [chamber for chamber in range(CHAMBERS) if chamber not in dead]
    if not dead:
        return ReachableDirections("plane", 0.0, math.pi)
    if not live:
        return ReachableDirections("none", 0.0, -1.0)
    if len(dead) == 1:
        return ReachableDirections("half plane", chamber_angle_rad(dead.pop()), math.pi / 2.0)
    first = chamber_bend_direction_rad(live[0])
    if len(live) == 1:
        return ReachableDirections("ray", first, 0.0)
    apart = wrap_angle_rad(chamber_bend_direction_rad(live[1]) - first)
    if abs(apart) > 0.75 * math.pi:
        return ReachableDirections("line", first, 0.0)
    return ReachableDirections("quarter plane", wrap_angle_rad(first + apart / 2.0), abs(apart) / 2.0)
