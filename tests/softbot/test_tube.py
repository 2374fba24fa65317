"""Section mechanics of the pressurised tube: check values, consistency between relations, and the kink."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softbot import tube as section
from softbot.errors import InputError, KinkError
from softbot.tube import Tube

LARVA = Tube(radius_m=300e-6, wall_thickness_m=30e-6, youngs_modulus_Pa=1.8e6, poisson_ratio=0.5)
P_BAR = 3.3
LARVA_PRESSURE_PA = section.pressure_from_scaled_Pa(LARVA, P_BAR)

p_bars = st.floats(1e-3, 1e3)
poissons = st.floats(0.0, 0.5)
fractions = st.floats(-1.0, 1.0)


@pytest.mark.parametrize(("modulus_Pa", "pressure_MPa"), [(1.8e6, 0.792), (3.2e6, 1.408)])
def test_larva_pressure_is_the_papers_0_79_to_1_41_MPa(modulus_Pa: float, pressure_MPa: float) -> None:
    larva = Tube(300e-6, 30e-6, modulus_Pa, 0.5)
    assert section.pressure_from_scaled_Pa(larva, P_BAR) == pytest.approx(pressure_MPa * 1e6, rel=1e-12)


@given(p_bar=p_bars, poisson=poissons)
@settings(deadline=None, max_examples=50)
def test_scaled_pressure_is_inverted_and_is_twice_the_strain(p_bar: float, poisson: float) -> None:
    tube = Tube(0.01, 0.001, 5e5, poisson)
    pressure = section.pressure_from_scaled_Pa(tube, p_bar)
    assert section.scaled_pressure(tube, pressure) == pytest.approx(p_bar, rel=1e-12)
    assert p_bar == pytest.approx(2 * (1 - poisson**2) * section.axial_strain(tube, pressure), rel=1e-12)


def test_axial_strain_is_the_closed_ends_thrust_over_the_wall() -> None:
    tube = Tube(0.01, 0.001, 5e5)
    thrust_N = 20e3 * math.pi * 0.01**2
    wall_stress_Pa = thrust_N / (2 * math.pi * 0.01 * 0.001)
    assert section.axial_strain(tube, 20e3) == pytest.approx(wall_stress_Pa / 5e5, rel=1e-14)
    assert section.axial_strain(tube, 0.0) == 0.0


def test_strain_moment_is_the_integral_of_a_strain_linear_in_the_angle() -> None:
    from scipy.integrate import quad

    strain_difference = 0.13
    # Stress E(ε − ε₀) on the wall element hR dθ, at the distance R cosθ towards the inner side; ε₀ drops out.
    half, _ = quad(lambda theta: strain_difference * (1 - 2 * theta / math.pi) * math.cos(theta), 0, math.pi)
    expected = 2 * half * LARVA.youngs_modulus_Pa * LARVA.wall_thickness_m * LARVA.radius_m**2
    assert section.strain_moment_N_m(LARVA, strain_difference) == pytest.approx(expected, rel=1e-12)
    force = section.muscle_force_N(LARVA, strain_difference)
    assert force * LARVA.radius_m == pytest.approx(expected, rel=1e-12)


def test_muscle_strain_from_lengths_inverts_the_strains_of_the_inner_and_the_outer_side() -> None:
    strain, difference, poisson = 2.2, 0.4, 0.5
    p_bar = 2 * (1 - poisson**2) * strain
    inner, outer = (strain - difference) * 1e-3, (strain + difference) * 1e-3
    found = section.strain_difference_from_lengths(inner, outer, p_bar, poisson)
    assert found == pytest.approx(difference, rel=1e-12)


def test_kink_at_scaled_pressure_3_3_is_1_7127() -> None:
    assert section.kink_scaled_curvature(P_BAR) == pytest.approx(1.7127, abs=5e-5)
    expected = section.kink_scaled_curvature(P_BAR) / LARVA.radius_m
    assert section.kink_curvature_1_m(LARVA, LARVA_PRESSURE_PA) == pytest.approx(expected, rel=1e-12)


def test_moment_has_its_maximum_of_two_thirds_at_the_kink() -> None:
    kink = section.kink_curvature_1_m(LARVA, LARVA_PRESSURE_PA)
    top = section.max_moment_N_m(LARVA, LARVA_PRESSURE_PA)
    scale = math.pi * 1.8e6 * (300e-6) ** 2 * 30e-6 / 0.75
    assert top == pytest.approx(2 / 3 * scale * math.sqrt(8 * P_BAR / 9), rel=1e-12)
    assert section.bending_moment_N_m(LARVA, kink, LARVA_PRESSURE_PA) == pytest.approx(top, rel=1e-12)
    step = 1e-4 * kink
    below = section.bending_moment_N_m(LARVA, kink - step, LARVA_PRESSURE_PA)
    # dM/dκ = 0 there, so the fall is of second order: M'' step²/2 with M'' = −M_max · 3/κc².
    assert (top - below) / top == pytest.approx(1.5e-8, rel=1e-3)


def test_small_curvature_meets_the_bending_stiffness_of_a_thin_ring() -> None:
    moment = section.bending_moment_N_m(LARVA, 1e-3, LARVA_PRESSURE_PA)
    ring = math.pi * 1.8e6 * (300e-6) ** 3 * 30e-6 / 0.75
    assert moment / 1e-3 == pytest.approx(ring, rel=1e-9)
    assert LARVA.bending_stiffness_N_m2 == pytest.approx(ring, rel=1e-14)


@given(p_bar=p_bars, poisson=poissons, fraction=fractions)
@settings(deadline=None, max_examples=200)
def test_equation_2_goes_both_ways_on_the_stable_branch(p_bar: float, poisson: float, fraction: float) -> None:
    kink = section.kink_scaled_curvature(p_bar)
    curvature = fraction * kink
    strain = section.strain_difference_from_curvature(curvature, p_bar, poisson)
    back = section.curvature_from_strain_difference(strain, p_bar, poisson)
    # The slope of Eq. (2) is zero at the kink: there the root is only as good as the square root of rounding.
    tolerance = 1e-13 / max(1 - fraction**2, 1e-6)
    assert back == pytest.approx(curvature, abs=kink * tolerance)
    again = section.strain_difference_from_curvature(back, p_bar, poisson)
    assert again == pytest.approx(strain, rel=1e-12, abs=1e-300)


@given(fraction=st.floats(0.0, 0.999))
@settings(deadline=None, max_examples=50)
def test_root_of_equation_2_is_the_one_a_bracketing_solver_finds(fraction: float) -> None:
    from scipy.optimize import brentq

    strain = fraction * section.max_strain_difference(P_BAR, 0.4)
    kink = section.kink_scaled_curvature(P_BAR)
    scale = math.pi**2 / (8 * (1 - 0.4**2))
    root = brentq(lambda k: scale * (k - 3 * k**3 / (8 * P_BAR)) - strain, 0, kink, xtol=1e-14)
    assert section.curvature_from_strain_difference(strain, P_BAR, 0.4) == pytest.approx(root, abs=1e-11)


@given(fraction=fractions)
@settings(deadline=None, max_examples=50)
def test_moment_and_curvature_invert_each_other(fraction: float) -> None:
    moment = fraction * section.max_moment_N_m(LARVA, LARVA_PRESSURE_PA)
    curvature = section.curvature_from_moment_1_m(LARVA, moment, LARVA_PRESSURE_PA)
    assert abs(curvature) <= section.kink_curvature_1_m(LARVA, LARVA_PRESSURE_PA)
    back = section.bending_moment_N_m(LARVA, curvature, LARVA_PRESSURE_PA)
    assert back == pytest.approx(moment, rel=1e-12, abs=1e-25)


def test_equation_2_is_the_balance_of_the_muscles_moment_and_the_bent_tubes() -> None:
    curvature_1_m = 1.2 / LARVA.radius_m
    strain = section.strain_difference_from_curvature(1.2, P_BAR, LARVA.poisson_ratio)
    muscle = section.strain_moment_N_m(LARVA, strain)
    bent = section.bending_moment_N_m(LARVA, curvature_1_m, LARVA_PRESSURE_PA)
    assert muscle == pytest.approx(bent, rel=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("ask", "limit"),
    [
        (lambda x: section.strain_difference_from_curvature(x, P_BAR, 0.5), math.sqrt(8 * P_BAR / 9)),
        (
            lambda x: section.curvature_from_strain_difference(x, P_BAR, 0.5),
            math.pi**2 / 9 * math.sqrt(8 * P_BAR / 9),
        ),
        (
            lambda x: section.bending_moment_N_m(LARVA, x, LARVA_PRESSURE_PA) * LARVA.radius_m,
            math.sqrt(8 * P_BAR / 9) / LARVA.radius_m,
        ),
        (
            lambda x: section.curvature_from_moment_1_m(LARVA, x, LARVA_PRESSURE_PA),
            section.max_moment_N_m(LARVA, LARVA_PRESSURE_PA),
        ),
    ],
    ids=["curvature", "strain", "curvature of the tube", "moment"],
)
def test_beyond_the_kink_is_refused_with_limit_and_value(
    ask: Callable[[float], float], limit: float, sign: float
) -> None:
    assert math.isfinite(ask(sign * limit * (1 - 1e-9)))
    assert math.isfinite(ask(sign * limit))
    value = sign * limit * (1 + 1e-6)
    with pytest.raises(KinkError) as refused:
        ask(value)
    message = str(refused.value)
    scale = LARVA.radius_m if "scaled curvature" in message and limit > 100 else 1.0
    assert f"{limit * scale:.6g}" in message
    assert f"{value * scale:.6g}" in message


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Tube(-0.01, 0.001, 5e5),
        lambda: Tube(0.01, 0.0, 5e5),
        lambda: Tube(0.01, 0.01, 5e5),
        lambda: Tube(0.01, 0.001, math.nan),
        lambda: Tube(0.01, 0.001, math.inf),
        lambda: Tube("0.01", 0.001, 5e5),  # type: ignore[arg-type]
        lambda: Tube(0.01, True, 5e5),
        lambda: Tube(0.01, 0.001, 5e5, 0.51),
        lambda: Tube(0.01, 0.001, 5e5, -1.0),
        lambda: section.axial_strain(LARVA, -1.0),
        lambda: section.axial_strain(LARVA, math.nan),
        lambda: section.scaled_pressure(LARVA, 0.0),
        lambda: section.pressure_from_scaled_Pa(LARVA, -3.3),
        lambda: section.strain_moment_N_m(LARVA, math.inf),
        lambda: section.muscle_force_N(LARVA, math.nan),
        lambda: section.strain_difference_from_lengths(0.0, 1e-3, P_BAR, 0.5),
        lambda: section.strain_difference_from_lengths(1e-3, 1e-3, 0.0, 0.5),
        lambda: section.kink_scaled_curvature(0.0),
        lambda: section.kink_curvature_1_m(LARVA, -5.0),
        lambda: section.max_strain_difference(-1.0, 0.5),
        lambda: section.strain_difference_from_curvature(math.nan, P_BAR, 0.5),
        lambda: section.strain_difference_from_curvature(0.1, 0.0, 0.5),
        lambda: section.strain_difference_from_curvature(0.1, P_BAR, 0.7),
        lambda: section.curvature_from_strain_difference(0.1, -1.0, 0.5),
        lambda: section.curvature_from_strain_difference(math.nan, P_BAR, 0.5),
        lambda: section.bending_moment_N_m(LARVA, 1.0, 0.0),
        lambda: section.curvature_from_moment_1_m(LARVA, math.nan, 1e5),
    ],
)
def test_input_that_is_no_tube_or_no_state_is_refused_and_is_not_called_a_kink(
    wrong: Callable[[], object],
) -> None:
    with pytest.raises(InputError) as refused:
        wrong()
    assert not isinstance(refused.value, KinkError)
