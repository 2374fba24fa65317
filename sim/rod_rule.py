"""Quadrature tables of the rod twin: where the tube is looked at, and how to integrate along it.

Each half of the tube is looked at in its h Gauss-Legendre points, numbered outwards from the middle: first the half
towards the last end (s > 0), then, unless the tube is its own mirror image, the half towards the first end (s < 0). All
integrals along the tube start at its middle.

Strains are sums of modes ψ_m(2 s/L): ψ_0 = 1, and for m ≥ 1 the orthogonal polynomials that span, with ψ_0, all
(1 − x²)² p(x). Neither moment nor shear force acts on a free end, so what bends a tube off its uniform rest curvature
vanishes there twice, as these do: they take fewer modes than Legendre's polynomials for the same accuracy. ψ_m is even
for m = 0, 1, 3, 5 … and odd for m = 2, 4, 6 …; its largest size is 1. A cantilever, the half of a tube that is held in
the middle, has the same modes of x from 0 to 1 with (1 − x)² instead.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial, legendre
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Rule(NamedTuple):
    """Tables for n points, h of them on each half that is looked at, and `modes` modes."""

    root_mass: FloatArray
    """√(mass that a point stands for), shape (n,) [√kg]: together the whole tube's, mirrored half included."""
    inverse_root: FloatArray
    """1/√(that mass), shape (n,)."""
    outward: FloatArray
    """+1 on the half s > 0, −1 on the other: what ds is when one goes outwards, shape (n,)."""
    mode: FloatArray
    """ψ_m at the points, times `outward`, shape (modes, n)."""
    integral: FloatArray
    """From the values of a function at the points of one half (rows) to its integral from the middle outwards to each
    of these points (columns), exact for polynomials of degree h − 1, shape (h, h) [m]."""
    turn: FloatArray
    """∫ψ_m ds from the point before (or the middle) to this one, shape (n, modes) [m]."""
    turn_pair: FloatArray
    """−½∫(ψ_m ∫ψ_n − ψ_n ∫ψ_m)ds over the same stretch for each pair m < n, shape (n, pairs) [m²]."""


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


def mode_polynomials(modes: int, cantilever: bool = False) -> list[Polynomial]:
    """ψ_0 … ψ_(modes−1) of x = 2 s/L."""
    first = 0.0 if cantilever else -1.0
    edge = Polynomial([1.0, -1.0]) ** 2 if cantilever else Polynomial([1.0, 0.0, -1.0]) ** 2
    onto = Polynomial([-1.0, 2.0]) if cantilever else Polynomial([0.0, 1.0])
    span = [Polynomial([1.0])]
    span += [edge * legendre.Legendre.basis(k).convert(kind=Polynomial)(onto) for k in range(modes - 1)]
    basis: list[Polynomial] = []
    for function in span[:modes]:
        for _ in range(2):  # twice, against rounding
            for other in basis:
                function = function - other * (_mean(function * other, first) / _mean(other * other, first))
        basis.append(function / np.abs(function(np.linspace(first, 1.0, 201))).max())
    return basis


def _mean(function: Polynomial, first: float) -> float:
    whole = function.integ()
    return float(whole(1.0) - whole(first)) / (1.0 - first)


def is_even(mode: int) -> bool:
    """Whether ψ_mode is an even function."""
    return mode == 0 or mode % 2 == 1


@lru_cache(maxsize=64)
def mode_shares(modes: int, cantilever: bool = False) -> FloatArray:
    """∫ψ_m² ds over the tube's length, shape (modes,)."""
    first = 0.0 if cantilever else -1.0
    return np.array([_mean(function * function, first) for function in mode_polynomials(modes, cantilever)])


def rod_rule(length_m: float, mass_kg: float, modes: int, half: int, sides: int, cantilever: bool = False) -> Rule:
    """The tables of a uniform tube. half: points on each half; sides: 2, or 1 for a tube that mirrors itself."""
    nodes, weights = _half_points(half)
    arm = 0.5 * length_m
    position = np.concatenate([nodes, -nodes][:sides])  # s/(L/2)
    outward = np.repeat([1.0, -1.0][:sides], half)
    mass = np.tile(weights, sides) * mass_kg / sides
    series = mode_polynomials(modes, cantilever)
    turn, turn_pair = _turns(position, half, series)
    return Rule(
        root_mass=np.sqrt(mass),
        inverse_root=1.0 / np.sqrt(mass),
        outward=outward,
        mode=np.array([function(position) * outward for function in series]),
        integral=np.ascontiguousarray(arm * _integrals_to(nodes, half)),
        turn=arm * turn,
        turn_pair=arm**2 * turn_pair,
    )


def _turns(position: FloatArray, half: int, series: list[Polynomial]) -> tuple[FloatArray, FloatArray]:
    modes = len(series)
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


@lru_cache(maxsize=64)
def rod_outline(length_m: float, half: int, places: int) -> Outline:
    """Tables for `places` equally spaced places on each half, the middle and the end included."""
    nodes, _ = legendre.leggauss(half)
    reach = np.linspace(0.0, 1.0, places)
    coefficients = np.linalg.inv(legendre.legvander(nodes, half - 1))
    value = coefficients.T @ legendre.legvander(2.0 * reach - 1.0, half - 1).T
    return Outline(0.5 * length_m * _integrals_to(reach, half), value)
