"""Quadrature tables of the rod twin: where the tube is looked at, and how to integrate along it.

Each half of the tube is looked at in its h Gauss-Legendre points, numbered outwards from the middle: first the half
towards the last end (s > 0), then, unless the tube is its own mirror image, the half towards the first end (s < 0). All
integrals along the tube start at its middle. Strains are sums of Legendre polynomials P_m(2 s/L), m = 0, 1, …
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial, legendre
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Rule(NamedTuple):
    """Tables for n points, h of them on each half that is looked at, and `modes` Legendre polynomials."""

    root_mass: FloatArray
    """√(mass that a point stands for), shape (n,) [√kg]: together the whole tube's, mirrored half included."""
    inverse_root: FloatArray
    """1/√(that mass), shape (n,)."""
    outward: FloatArray
    """+1 on the half s > 0, −1 on the other: what ds is when one goes outwards, shape (n,)."""
    mode: FloatArray
    """P_m at the points, times `outward`, shape (modes, n)."""
    integral: FloatArray
    """From the values of a function at the points of one half (rows) to its integral from the middle outwards to each
    of these points (columns), exact for polynomials of degree h − 1, shape (h, h) [m]."""
    turn: FloatArray
    """∫P_m ds from the point before (or the middle) to this one, shape (n, modes) [m]."""
    turn_pair: FloatArray
    """−½∫(P_m ∫P_n − P_n ∫P_m)ds over the same stretch for each pair m < n, shape (n, pairs) [m²]."""


def _half_points(half: int) -> tuple[FloatArray, FloatArray]:
    nodes, weights = legendre.leggauss(half)
    return 0.5 * (nodes + 1.0), 0.5 * weights


def _integrals_to(reach: FloatArray, half: int) -> FloatArray:
    """From values at the Gauss points of (0, 1) to integrals from 0 to each of `reach`, shape (half, len(reach))."""
    nodes, _ = legendre.leggauss(half)
    at = 2.0 * reach - 1.0
    coefficients = np.linalg.inv(legendre.legvander(nodes, half - 1))  # of the interpolating series, from the values
    high = legendre.legvander(at, half)  # ∫P_k over (−1, y) = (P_(k+1) − P_(k−1))/(2k + 1)
    primitive = np.empty((half, len(at)))
    primitive[0] = at + 1.0
    for k in range(1, half):
        primitive[k] = (high[:, k + 1] - high[:, k - 1]) / (2 * k + 1)
    integrals: FloatArray = 0.5 * coefficients.T @ primitive
    return integrals


def rod_rule(length_m: float, mass_kg: float, modes: int, half: int, sides: int) -> Rule:
    """The tables of a uniform tube. half: points on each half; sides: 2, or 1 for a tube that mirrors itself."""
    nodes, weights = _half_points(half)
    arm = 0.5 * length_m
    position = np.concatenate([nodes, -nodes][:sides])  # s/(L/2)
    outward = np.repeat([1.0, -1.0][:sides], half)
    mass = np.tile(weights, sides) * mass_kg / sides
    turn, turn_pair = _turns(position, half, modes)
    return Rule(
        root_mass=np.sqrt(mass),
        inverse_root=1.0 / np.sqrt(mass),
        outward=outward,
        mode=np.ascontiguousarray(legendre.legvander(position, modes - 1).T * outward),
        integral=np.ascontiguousarray(arm * _integrals_to(nodes, half)),
        turn=arm * turn,
        turn_pair=arm**2 * turn_pair,
    )


def _turns(position: FloatArray, half: int, modes: int) -> tuple[FloatArray, FloatArray]:
    series = [legendre.Legendre.basis(m).convert(kind=Polynomial) for m in range(modes)]
    pairs = [(m, n) for m in range(modes) for n in range(m + 1, modes)]
    turn, turn_pair = np.empty((len(position), modes)), np.empty((len(position), len(pairs)))
    for i, end in enumerate(position):
        start = 0.0 if i % half == 0 else position[i - 1]
        primitive = [p.integ(lbnd=start) for p in series]
        turn[i] = [p(end) for p in primitive]
        for j, (m, n) in enumerate(pairs):
            area = (series[m] * primitive[n] - series[n] * primitive[m]).integ(lbnd=start)
            turn_pair[i, j] = -0.5 * area(end)
    return turn, turn_pair


class Outline(NamedTuple):
    """Tables that carry values at the points of one half to `n` places from the middle to the end."""

    integral: FloatArray
    """Integral from the middle outwards, shape (h, n) [m]."""
    value: FloatArray
    """The value itself, shape (h, n)."""


def rod_outline(length_m: float, half: int, places: int) -> Outline:
    """Tables for `places` equally spaced places on each half, the middle and the end included."""
    nodes, _ = legendre.leggauss(half)
    reach = np.linspace(0.0, 1.0, places)
    coefficients = np.linalg.inv(legendre.legvander(nodes, half - 1))
    value = coefficients.T @ legendre.legvander(2.0 * reach - 1.0, half - 1).T
    return Outline(0.5 * length_m * _integrals_to(reach, half), value)
