"""The elastic line: known frequencies, small and large deflections, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_bvp

from softbot.elastica import free_frequencies_rad_s, heavy_cantilever
from softbot.errors import InputError


def test_a_slight_load_bends_as_the_beam_formula_says():
    load = 1e-4
    tip = heavy_cantilever(2.0, 3.0, load * 3.0 / 8.0)
    assert tip.drop_m == pytest.approx(2.0 * load / 8.0, rel=1e-6)
    assert tip.tip_angle_rad == pytest.approx(load / 6.0, rel=1e-6)
    assert tip.reach_m == pytest.approx(2.0, rel=1e-8)


def test_without_weight_it_stays_straight():
    tip = heavy_cantilever(0.15, 3.93e-3, 0.0)
    assert tip.reach_m == pytest.approx(0.15, abs=1e-12)
    assert tip.drop_m == pytest.approx(0.0, abs=1e-12)


@given(load=st.floats(0.1, 60.0))
@settings(max_examples=8)
def test_a_boundary_value_solver_finds_the_same_tip(load):
    def slopes(s, y):
        return [y[1], -load * (1.0 - s) * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])]

    def ends(a, b):
        return [a[0], b[1], a[2], a[3]]

    tip = heavy_cantilever(1.0, 1.0, load)
    at = np.linspace(0.0, 1.0, 200)
    angle = tip.tip_angle_rad * (1.0 - (1.0 - at) ** 3)
    guess = np.stack([angle, np.gradient(angle, at), at, np.zeros_like(at)])
    other = solve_bvp(slopes, ends, at, guess, tol=1e-9, max_nodes=50_000)
    assert other.success
    assert tip.reach_m == pytest.approx(other.y[2, -1], abs=1e-7)
    assert tip.drop_m == pytest.approx(other.y[3, -1], abs=1e-7)


def test_a_very_heavy_one_hangs_straight_down():
    tip = heavy_cantilever(1.0, 1.0, 1000.0)
    # close to the clamp δ″ = load·sinδ with δ from π/2 to 0: the line leaves it by ∫sinδ = √2/√load
    assert tip.reach_m == pytest.approx(math.sqrt(2.0 / 1000.0), rel=0.05)
    assert tip.reach_m + tip.drop_m > 1.0
    assert tip.tip_angle_rad == pytest.approx(math.pi / 2.0, abs=1e-8)


def test_tip_scales_with_the_length():
    small, large = heavy_cantilever(1.0, 1.0, 3.0), heavy_cantilever(10.0, 1000.0, 3.0)
    assert np.allclose([10.0 * small.reach_m, 10.0 * small.drop_m], [large.reach_m, large.drop_m], rtol=1e-10)


def test_frequencies_of_the_euler_bernoulli_beam():
    squares = [4.730040744862704**2, 7.853204624095838**2, 10.995607838001671**2, 14.13716549125746**2]
    assert free_frequencies_rad_s(1.0, 1.0, 1.0, count=4) == pytest.approx(squares, rel=1e-12)
    scaled = free_frequencies_rad_s(0.5, 4.0, 0.25)
    assert scaled == pytest.approx([16.0 * square for square in squares[:3]], rel=1e-12)


@given(rotary=st.floats(1e-5, 0.01))
@settings(max_examples=10)
def test_rotary_inertia_gives_the_frequencies_of_a_discretised_rod(rotary):
    """Against the eigenvalues of λẅ − Jẅ″ + w⁗ = 0 in Legendre polynomials, free ends natural (Ritz)."""
    from numpy.polynomial import legendre

    count = 16
    nodes, weights = legendre.leggauss(2 * count)
    derivative = [legendre.legvander(nodes, count - 1)]
    basis = np.eye(count)
    for order in (1, 2):
        derivative.append(np.stack([legendre.legval(nodes, legendre.legder(row, order)) for row in basis], axis=1))
    # on (−½, ½): each derivative brings a factor 2
    value, slope, bend = derivative[0], 2.0 * derivative[1], 4.0 * derivative[2]
    mass = value.T @ (weights[:, None] * value) + rotary * slope.T @ (weights[:, None] * slope)
    stiffness = bend.T @ (weights[:, None] * bend)
    squares = np.sort(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real)
    found = free_frequencies_rad_s(1.0, 1.0, 1.0, rotary)
    assert found == pytest.approx(np.sqrt(squares[2:5]), rel=1e-6)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((0.0, 1.0, 1.0), "length_m"),
        ((1.0, -1.0, 1.0), "bending_stiffness_N_m2"),
        ((1.0, 1.0, -1.0), "weight_N_m"),
        ((1.0, 1.0, math.nan), "weight_N_m"),
        ((1.0, 1.0, 1001.0), "at most 1000"),
    ],
)
def test_a_cantilever_out_of_range_is_refused(arguments, named):
    with pytest.raises(InputError, match=named):
        heavy_cantilever(*arguments)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((1.0, 1.0, 0.0), "mass_per_length_kg_m"),
        ((1.0, 1.0, 1.0, -1e-3), "rotary_inertia_kg_m"),
        ((1.0, 1.0, 1.0, 0.0, 0), "count"),
        ((1.0, 1.0, 1.0, 0.0, True), "count"),
    ],
)
def test_frequencies_out_of_range_are_refused(arguments, named):
    with pytest.raises(InputError, match=named):
        free_frequencies_rad_s(*arguments)
