"""Axial muscles of a bent tube: what a contraction does to its curvature, and the forces with which they roll it.

The paper (X. Liang et al., "Mechanics of soft-body rolling motion without external torque") gives the moments of the
muscles in closed form (Eq. (1) and its N-segment form, in `softbot.rolling`). Here they are summed from the forces
themselves, which shares no formula with them: the axis is an arc cut by N + 1 junctions into N equal segments, in
each of which one muscle spans straight from junction to junction, at the angle θ from the inner side, and pulls at
both its ends with F_m.

The pulls are internal: they add up to no force and no moment. What rolls the body is their moment about the curved
axis, what turns it as a whole is the axial pull at its two ends; their parts along the chord cancel (`PullMoments`).

Frame of the sums: x along the chord, right-handed with y towards the inner side of the C (towards its centre for a
positive half bend) and z = x × y, origin on the axis at the middle. The tangent at the middle is x.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softbot.errors import InputError
from softbot.tube import Tube, finite_number, positive_number, strain_moment_N_m

FloatArray = NDArray[np.float64]


def linear_rest_curvature_1_m(tube: Tube, contraction: float) -> float:
    """Curvature M/EI [1/m] that the muscles' moment M = 8E₀R²hΔε/π would give a tube that keeps its round section.

    contraction: Δε of the side that shortens (muscles), or by which the other side lengthens (chambers). A rod whose
    moment is EI(κ − aκ³ − this), a = 3R²/(8p̄), rests at the curvature of the paper's Eq. (2). It is
    8(1 − ν²)Δε/(π²R). Raises InputError for a contraction that is not finite.
    """
    return strain_moment_N_m(tube, contraction) / tube.bending_stiffness_N_m2


@dataclass(frozen=True)
class Pulls:
    """Forces of the muscles on the N + 1 junctions; arrays of shape (N + 1, 3), axes as in the module's docstring."""

    centre_m: FloatArray
    """Of the junctions' sections, on the axis."""
    tangent: FloatArray
    """Of the axis at the junctions, unit."""
    place_m: FloatArray
    """Where the muscles are attached."""
    force_N: FloatArray
    """Of the one or two muscles that end there."""


@dataclass(frozen=True)
class PullMoments:
    """Moments of `Pulls` [N m]."""

    rolling_N_m: float
    """Σ tᵢ·((placeᵢ − centreᵢ) × Fᵢ) over the junctions, about the curved axis: −N·2F_mR·sin(φ₀/N)·sinθ."""
    rotation_N_m: float
    """Moment along the chord of the axial pulls at the two ends: 2F_mR·cos(φ₀/N)·sinφ₀·sinθ."""
    rolling_along_chord_N_m: float
    """The rolling moments added as vectors, along the chord: minus `rotation_N_m`."""
    force_N: FloatArray
    """Sum of the forces, shape (3,): none."""
    moment_N_m: FloatArray
    """Σ r × F about the origin, shape (3,): none."""


def muscle_pulls(
    force_N: float, radius_m: float, length_m: float, half_bend_rad: float, theta_rad: float, segments: int
) -> Pulls:
    """Forces of the active muscles at θ [rad] of a tube bent to an arc of half bend φ₀ [rad], in N segments.

    force_N: F_m of each, positive where it contracts. Raises InputError for values that are not finite, a radius or
    length ≤ 0, segments < 1, and a bend so tight that the inner side folds (2|φ₀|R ≥ length).
    """
    force, theta = finite_number("force_N", force_N), finite_number("theta_rad", theta_rad)
    radius, length = positive_number("radius_m", radius_m), positive_number("length_m", length_m)
    phi0 = finite_number("half_bend_rad", half_bend_rad)
    if isinstance(segments, bool) or not isinstance(segments, int | np.integer) or segments < 1:
        raise InputError(f"segments must be a whole number of at least 1, got {segments!r}")
    if 2.0 * abs(phi0) * radius >= length:
        raise InputError(f"half_bend_rad {phi0:g} folds the inner side: stay below length_m/(2 radius_m)")
    share = np.linspace(-1.0, 1.0, int(segments) + 1)
    angle = phi0 * share
    chord = 0.5 * length * share * np.sinc(0.5 * angle / math.pi)  # of the arc from the middle to the junction
    zero, one = np.zeros_like(angle), np.ones_like(angle)
    centre = np.column_stack([chord * np.cos(0.5 * angle), chord * np.sin(0.5 * angle), zero])
    tangent = np.column_stack([np.cos(angle), np.sin(angle), zero])
    inwards = np.column_stack([-np.sin(angle), np.cos(angle), zero])
    upwards = np.column_stack([zero, zero, one])
    place = centre + radius * (math.cos(theta) * inwards + math.sin(theta) * upwards)
    span = np.diff(place, axis=0)
    pull = force * span / np.linalg.norm(span, axis=1, keepdims=True)
    total = np.zeros_like(place)
    total[:-1] += pull
    total[1:] -= pull
    return Pulls(centre, tangent, place, total)


def pull_moments(pulls: Pulls) -> PullMoments:
    """The sums Σ r × F of the muscles' forces, and the parts of them that the paper names."""
    about_axis = np.sum(pulls.tangent * np.cross(pulls.place_m - pulls.centre_m, pulls.force_N), axis=1)
    ends = slice(None, None, len(pulls.tangent) - 1)
    tangent, force = pulls.tangent[ends], pulls.force_N[ends]
    axial = np.sum(force * tangent, axis=1, keepdims=True) * tangent
    return PullMoments(
        rolling_N_m=float(np.sum(about_axis)),
        rotation_N_m=float(np.sum(np.cross(pulls.place_m[ends], axial), axis=0)[0]),
        rolling_along_chord_N_m=float(about_axis @ pulls.tangent[:, 0]),
        force_N=np.sum(pulls.force_N, axis=0),
        moment_N_m=np.sum(np.cross(pulls.place_m, pulls.force_N), axis=0),
    )
