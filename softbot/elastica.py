"""Closed forms and near-closed forms of an elastic line: heavy cantilever, free vibration of a free rod.

The heavy cantilever is Euler's elastica under its own weight, EI·θ″ + w·(L − s)·cosθ = 0 with θ(0) = 0 (clamped,
horizontal) and θ′(L) = 0 (free), at any size of the deflection. The free-free rod is Rayleigh's: a bending line whose
cross-sections have rotary inertia, which for a tube as stout as the robot (R/L = 1/15) lowers the first frequency by
2.6 %; without it, the Euler–Bernoulli beam.

Left out: stretch and shear, as in the rod that these are rulers for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from softbot.errors import InputError
from softbot.tube import finite_number, positive_number

if TYPE_CHECKING:
    from numpy.typing import NDArray

_RELATIVE_TOLERANCE, _ABSOLUTE_TOLERANCE = 1e-12, 1e-14
# The tip's angle from the vertical shrinks as exp(−⅔√load): beyond this load it is lost in the tolerance.
_LARGEST_LOAD = 1000.0


class HeavyCantilever(NamedTuple):
    """Tip of a cantilever that bends under its own weight."""

    reach_m: float
    """Horizontal distance of the tip from the clamp [m]."""
    drop_m: float
    """How far the tip hangs below the clamp [m]."""
    tip_angle_rad: float
    """Slope of the tip below the horizontal [rad]."""


def heavy_cantilever(length_m: float, bending_stiffness_N_m2: float, weight_N_m: float) -> HeavyCantilever:
    """Tip of a horizontal cantilever under its own weight, to about 1e-10 of the length.

    length_m: L [m]; bending_stiffness_N_m2: EI [N m²]; weight_N_m: w, weight per length ≥ 0 [N/m]. With the angle from
    the vertical δ = π/2 − θ and u = (L − s)/L, measured from the free end, the equation is δ″ = (wL³/EI)·u·sinδ, δ′(0)
    = 0; the shooting parameter δ(0) is unique where θ stays within the quadrant. Raises InputError for values out of
    range and for wL³/EI > 1000.
    """
    length = positive_number("length_m", length_m)
    stiffness = positive_number("bending_stiffness_N_m2", bending_stiffness_N_m2)
    weight = finite_number("weight_N_m", weight_N_m)
    if weight < 0.0:
        raise InputError(f"weight_N_m must not be negative, got {weight:g}")
    load = weight * length**3 / stiffness
    if load > _LARGEST_LOAD:
        raise InputError(f"weight_N_m · length_m³/bending_stiffness_N_m2 = {load:g}: at most {_LARGEST_LOAD:g}")
    from scipy.optimize import brentq

    def clamp_error(log_tip: float) -> float:
        return float(_from_tip(load, math.exp(log_tip))[0]) - 0.5 * math.pi

    lowest = math.log(0.5 * math.pi) - 2.0 - math.sqrt(load)  # δ grows by less than exp(√load) on its way
    highest = math.log(0.5 * math.pi)
    log_tip = highest if load == 0.0 else float(brentq(clamp_error, lowest, highest, xtol=1e-14, rtol=1e-15))
    _, _, reach, drop = _from_tip(load, math.exp(log_tip))
    return HeavyCantilever(float(reach) * length, float(drop) * length, 0.5 * math.pi - math.exp(log_tip))


def _from_tip(load: float, tip: float) -> NDArray[np.float64]:
    """δ, δ′, reach and drop at the clamp of the line that starts at the free end with δ = tip, lengths over L.

    Once δ has passed π/2 it only grows: what counts is that it has.
    """
    from scipy.integrate import solve_ivp

    def slopes(u: float, y: NDArray[np.float64]) -> list[float]:
        sine = math.sin(min(y[0], 0.5 * math.pi + 1.0))
        return [y[1], load * u * sine, math.sin(y[0]), math.cos(y[0])]

    solution = solve_ivp(
        slopes, (0.0, 1.0), [tip, 0.0, 0.0, 0.0], method="DOP853", rtol=_RELATIVE_TOLERANCE, atol=_ABSOLUTE_TOLERANCE
    )
    end: NDArray[np.float64] = solution.y[:, -1]
    return end


def free_frequencies_rad_s(
    length_m: float,
    bending_stiffness_N_m2: float,
    mass_per_length_kg_m: float,
    rotary_inertia_kg_m: float = 0.0,
    count: int = 3,
) -> tuple[float, ...]:
    """Angular frequencies [rad/s] of the first `count` bending vibrations of a rod with both ends free, lowest first.

    length_m: L [m]; bending_stiffness_N_m2: EI [N m²]; mass_per_length_kg_m: λ [kg/m]; rotary_inertia_kg_m: J, moment
    of inertia of the section about its diameter per length [kg m] (λR²/4 for a solid round; 0: Euler–Bernoulli).
    λẅ − Jẅ″ + EI·w⁗ = 0 has solutions cosh ax, cos bx (even modes about the middle; sinh, sin the odd ones) with
    a²b² = λω²/EI and b² − a² = Jω²/EI; the free ends x = ±L/2 ask for b³·tanh(aL/2)·cos(bL/2) + a³·sin(bL/2) = 0, the
    odd ones for a³·tanh(aL/2)·cos(bL/2) − b³·sin(bL/2) = 0. Check (J = 0): (βL)² = 22.3733, 61.6728, 120.9034. Raises
    InputError for values out of range.
    """
    length = positive_number("length_m", length_m)
    stiffness = positive_number("bending_stiffness_N_m2", bending_stiffness_N_m2)
    mass = positive_number("mass_per_length_kg_m", mass_per_length_kg_m)
    rotary = finite_number("rotary_inertia_kg_m", rotary_inertia_kg_m)
    if rotary < 0.0:
        raise InputError(f"rotary_inertia_kg_m must not be negative, got {rotary:g}")
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        raise InputError(f"count must be a whole number of at least 1, got {count!r}")
    from scipy.optimize import brentq

    half = 0.5 * length
    found = []
    for mode in range(count):
        # even modes: bL/2 in (π/2, π), (3π/2, 2π), …; odd ones in (π, 3π/2), (2π, 5π/2), …: one root in each
        low = 0.5 * math.pi * (mode + 1)
        condition = _end_condition(half, rotary / mass, even=mode % 2 == 0)
        wave = float(brentq(condition, low, low + 0.5 * math.pi, xtol=1e-14, rtol=1e-15)) / half
        found.append(math.sqrt(stiffness * wave**4 / (mass + rotary * wave**2)))
    return tuple(found)


def _end_condition(half_m: float, rotary_over_mass_m2: float, *, even: bool) -> Callable[[float], float]:
    def condition(turn: float) -> float:
        b = turn / half_m
        a = b / math.sqrt(1.0 + rotary_over_mass_m2 * b * b)
        across, along = math.tanh(a * half_m) * math.cos(turn), math.sin(turn)
        return b**3 * across + a**3 * along if even else a**3 * across - b**3 * along

    return condition
