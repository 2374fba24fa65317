"""The actuator law: closed forms of a linear wall, virtual work, derivatives, and the inverse over the workspace."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from softbot import actuator
from softbot.actuator import ActuatorLaw
from softbot.cross_section import CHAMBER_ANGLES_RAD, CrossSection, default_cross_section
from softbot.errors import InputError, SimulationError, UnreachableError
from softbot.material import MATERIALS, energy_density, material_parameters, nominal_stress

SECTION = default_cross_section(0.01)
MODULUS_Pa = 1.2e5  # of the linear wall; the others take a quarter as their shear modulus
LIMIT_Pa = 60e3


def law(material: str = "neo-hookean", **parameters: Any) -> ActuatorLaw:
    modulus_Pa = MODULUS_Pa if material == "linear" else MODULUS_Pa / 4.0
    stiffening_Pa = 2e3 if material == "yeoh" else 0.0
    return ActuatorLaw(SECTION, material, modulus_Pa, stiffening_Pa, **parameters)


LAWS = [
    law("linear"),
    law("neo-hookean"),
    law("yeoh"),
    law("neo-hookean", gains=(1.0, 1.15, 0.9, 1.05)),
    law("yeoh", gains=(0.95, 1.0, 1.1, 1.0), dead_band_Pa=4e3),
    law("gent", limit_invariant=3.0, pre_stretch=1.2),
]
laws = st.sampled_from(LAWS)
chamber_pressures = st.tuples(*[st.floats(0.0, LIMIT_Pa)] * 4)
directions = st.floats(-math.pi, math.pi)


def energy_per_length(tube: ActuatorLaw, strain: np.ndarray) -> float:
    """W = ∫ w(λ_p λ) dA less the work of the force that holds the wall [J/m], from the energies of the materials."""
    keys = ("modulus_Pa", "stiffening_Pa", "stiffening_2_Pa", "limit_invariant", "second_share")
    wall = material_parameters(tube.material, {key: getattr(tube, key) for key in keys})
    code, pre = MATERIALS[tube.material].code, tube.pre_stretch
    held_Pa = pre * nominal_stress(code, wall, pre)
    return sum(
        area * (energy_density(code, wall, pre * stretch) - held_Pa * stretch)
        for x1, x2, area in tube.section.wall_points()
        for stretch in [strain[0] - strain[1] * x1 - strain[2] * x2]
    )


def assert_near(found: np.ndarray, expected: np.ndarray, within: ArrayLike) -> None:
    assert np.all(np.abs(found - expected) <= within), f"{found} is not {expected}"


# --- closed forms ------------------------------------------------------------


@pytest.mark.parametrize("chamber", range(4))
@pytest.mark.parametrize("pressure_Pa", [1e3, 20e3])
def test_linear_wall_meets_the_closed_forms_of_one_chamber(chamber: int, pressure_Pa: float) -> None:
    pressure = np.zeros(4)
    pressure[chamber] = pressure_Pa
    rest = law("linear").equilibrium(pressure)
    area, arm = SECTION.chamber_area_m2, SECTION.chamber_centroid_radius_m
    strain = pressure_Pa * area / (MODULUS_Pa * SECTION.wall_area_m2)
    curvature = pressure_Pa * area * arm / (MODULUS_Pa * SECTION.bending_area_moment_m4)
    angle = CHAMBER_ANGLES_RAD[chamber] + math.pi  # a chamber elongates its side and bends away from it
    assert rest.stretch == pytest.approx(1.0 + strain, rel=1e-12)
    np.testing.assert_allclose(
        rest.curvature_1_m, curvature * np.array([math.cos(angle), math.sin(angle)]), atol=1e-11 * curvature
    )


def test_linear_wall_superposes_and_four_equal_pressures_only_lengthen_it() -> None:
    tube = law("linear")
    alone = [tube.equilibrium(np.eye(4)[i] * p).curvature_1_m for i, p in enumerate((3e3, 8e3, 1e3, 20e3))]
    together = tube.equilibrium([3e3, 8e3, 1e3, 20e3])
    np.testing.assert_allclose(together.curvature_1_m, np.sum(alone, axis=0), rtol=1e-10)
    even = tube.equilibrium([10e3] * 4)
    expected = 1.0 + 4 * 10e3 * SECTION.chamber_area_m2 / (MODULUS_Pa * SECTION.wall_area_m2)
    assert even.stretch == pytest.approx(expected, rel=1e-12)
    np.testing.assert_allclose(even.curvature_1_m, 0.0, atol=1e-9)


@pytest.mark.parametrize("tube", LAWS[:5])
def test_every_wall_starts_as_the_linear_one_of_its_small_strain_modulus(tube: ActuatorLaw) -> None:
    small_Pa = np.array([1.0, 2.0, 0.5, 0.0])
    linear = law("linear").equilibrium(small_Pa * np.array(tube.gains))
    found = tube.equilibrium(small_Pa + tube.dead_band_Pa)
    np.testing.assert_allclose(found.curvature_1_m, linear.curvature_1_m, rtol=1e-3)
    assert found.stretch - 1.0 == pytest.approx(linear.stretch - 1.0, rel=1e-3)
    bending_stiffness = MODULUS_Pa * SECTION.bending_area_moment_m4
    assert tube.rest_bending_stiffness_N_m2 == pytest.approx(bending_stiffness, rel=1e-12)
    stiffness = tube.forces(1.0, [0.0, 0.0])[1]
    np.testing.assert_allclose(
        stiffness, np.diag([MODULUS_Pa * SECTION.wall_area_m2, bending_stiffness, bending_stiffness]), atol=1e-10
    )


# --- virtual work and derivatives ------------------------------------------------------------


@given(tube=laws, pressure=chamber_pressures)
def test_wall_carries_the_chamber_loads(tube: ActuatorLaw, pressure: tuple[float, ...]) -> None:
    rest = tube.equilibrium(pressure)
    force, stiffness = tube.forces(rest.stretch, rest.curvature_1_m)
    effective = np.maximum(np.array(pressure) - tube.dead_band_Pa, 0.0)
    np.testing.assert_allclose(force, tube.load_matrix @ effective, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(stiffness, rest.stiffness, rtol=1e-12)


@given(tube=laws, pressure=st.tuples(*[st.floats(5e3, LIMIT_Pa)] * 4))
def test_jacobian_is_the_slope_of_the_equilibrium(tube: ActuatorLaw, pressure: tuple[float, ...]) -> None:
    jacobian = tube.equilibrium(pressure).jacobian
    h = 10.0
    for chamber in range(4):
        nudge = np.eye(4)[chamber] * h
        up, down = (tube.equilibrium(np.array(pressure) + sign * nudge) for sign in (1, -1))
        slope = np.array([up.stretch - down.stretch, *(up.curvature_1_m - down.curvature_1_m)]) / (2.0 * h)
        assert_near(jacobian[:, chamber], slope, 2e-5 * np.abs(jacobian).max(axis=1))


def test_jacobian_of_the_unloaded_section_is_that_of_the_first_pascal() -> None:
    area, arm = SECTION.chamber_area_m2, SECTION.chamber_centroid_radius_m
    jacobian = law().equilibrium([0.0] * 4).jacobian
    per_Pa = area / (MODULUS_Pa * SECTION.wall_area_m2), area * arm / (MODULUS_Pa * SECTION.bending_area_moment_m4)
    expected = [[per_Pa[0]] * 4, [-per_Pa[1], 0, per_Pa[1], 0], [0, -per_Pa[1], 0, per_Pa[1]]]
    np.testing.assert_allclose(jacobian, expected, rtol=1e-9, atol=1e-16)


@given(tube=laws, stretch=st.floats(0.9, 1.6), k1=st.floats(-25.0, 25.0), k2=st.floats(-25.0, 25.0))
def test_wall_force_is_the_slope_of_the_energy_and_stiffness_that_of_the_force(
    tube: ActuatorLaw, stretch: float, k1: float, k2: float
) -> None:
    longest = tube.pre_stretch * (stretch + tube.section.radius_m * math.hypot(k1, k2))
    assume(tube.material != "gent" or longest**2 + longest**-2 - 2.0 < 0.9 * tube.limit_invariant)
    strain = np.array([stretch, k1, k2])
    force, stiffness = tube.forces(stretch, [k1, k2])
    step = np.array([1e-6, 1e-4, 1e-4])
    for column in range(3):
        nudge = np.eye(3)[column] * step
        up, down = (tube.forces((strain + s * nudge)[0], (strain + s * nudge)[1:])[0] for s in (1, -1))
        slope = (up - down) / (2.0 * step[column])
        assert_near(stiffness[:, column], slope, 1e-5 * np.sqrt(np.diag(stiffness) * stiffness[column, column]))
        energies = [energy_per_length(tube, strain + s * nudge) for s in (1, -1)]
        assert force[column] == pytest.approx((energies[0] - energies[1]) / (2.0 * step[column]), rel=1e-4, abs=1e-5)
    np.testing.assert_array_equal(stiffness, stiffness.T)


@given(tube=laws, pressure=st.tuples(*[st.floats(6e3, LIMIT_Pa)] * 4))
def test_chamber_volumes_answer_pressures_reciprocally(tube: ActuatorLaw, pressure: tuple[float, ...]) -> None:
    """∂V_i/∂p_j = ∂V_j/∂p_i: both are second derivatives of one potential, the co-energy of the wall."""
    length_m, h = 0.15, 5.0

    def volumes(at: np.ndarray) -> np.ndarray:
        rest = tube.equilibrium(at)
        return tube.chamber_volumes_m3(length_m, rest.stretch, rest.curvature_1_m)

    nudges = np.eye(4) * h
    slopes = np.column_stack([(volumes(pressure + n) - volumes(pressure - n)) / (2.0 * h) for n in nudges])
    np.testing.assert_allclose(slopes, slopes.T, atol=1e-5 * np.abs(slopes).max())
    assert np.all(np.linalg.eigvalsh(slopes) > -1e-5 * np.abs(slopes).max())  # three strains: rank 3 of 4
    assert np.linalg.matrix_rank(slopes, tol=1e-4 * np.abs(slopes).max()) == 3


@pytest.mark.parametrize("tube", LAWS[:4])
def test_work_of_the_gas_on_the_chambers_is_the_energy_in_the_wall(tube: ActuatorLaw) -> None:
    """Σ ∮ p_i dV_i along a crooked way of loading = L·W at its end, whatever the way."""
    length_m = 0.15

    def way(s: float) -> np.ndarray:
        return LIMIT_Pa * np.array([s, s**2, 0.3 * math.sin(math.pi * s / 2.0), 0.5 * s**3])

    nodes, weights = np.polynomial.legendre.leggauss(16)
    work = 0.0
    for node, weight in zip(nodes, weights, strict=True):
        s, h = 0.5 * (node + 1.0), 1e-5
        ends = [tube.equilibrium(way(at)) for at in (s - h, s + h)]
        volume = [tube.chamber_volumes_m3(length_m, rest.stretch, rest.curvature_1_m) for rest in ends]
        work += 0.5 * weight * float(way(s) @ (volume[1] - volume[0]) / (2.0 * h))
    end = tube.equilibrium(way(1.0))
    strain = np.array([end.stretch, *end.curvature_1_m])
    assert work == pytest.approx(length_m * energy_per_length(tube, strain), rel=1e-6)


def test_volume_at_rest_is_gain_times_area_times_length_and_grows_on_the_outer_side() -> None:
    tube = law(gains=(1.0, 1.2, 0.9, 1.0))
    rest = tube.chamber_volumes_m3(0.15, 1.0, [0.0, 0.0])
    np.testing.assert_allclose(rest, 0.15 * SECTION.chamber_area_m2 * np.array([1.0, 1.2, 0.9, 1.0]), rtol=1e-12)
    bent = tube.chamber_volumes_m3(0.15, 1.0, [10.0, 0.0])  # towards chamber 0: the far side, chamber 2, is longer
    assert bent[2] > rest[2]
    assert bent[0] < rest[0]
    np.testing.assert_allclose(bent[[1, 3]], rest[[1, 3]], rtol=1e-12)


def test_pressure_within_the_dead_band_does_nothing_and_beyond_counts_from_it() -> None:
    plain, banded = law(), law(dead_band_Pa=5e3)
    still = banded.equilibrium([4e3, 0.0, 4.9e3, 2e3])
    assert still.stretch == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_array_equal(still.jacobian, 0.0)
    edge = banded.equilibrium([5e3, 0.0, 0.0, 0.0]).jacobian  # one-sided: what a rising pressure does
    np.testing.assert_allclose(edge[:, 0], plain.equilibrium([0.0] * 4).jacobian[:, 0], rtol=1e-12)
    beyond, same = banded.equilibrium([20e3, 0, 7e3, 0]), plain.equilibrium([15e3, 0, 2e3, 0])
    np.testing.assert_allclose(beyond.curvature_1_m, same.curvature_1_m, rtol=1e-12)


def test_suction_shortens_its_side_whatever_the_dead_band() -> None:
    rest = law(dead_band_Pa=5e3).equilibrium([-3e3, 0, 0, 0])
    assert rest.stretch < 1.0
    assert rest.curvature_1_m[0] > 0.0
    assert rest.jacobian[1, 0] < 0.0


# --- pre-stretch, misalignment, locking ------------------------------------------------------------


def test_pre_stretched_wall_is_at_rest_at_its_length_and_softer_to_further_stretch() -> None:
    tubes = [law(pre_stretch=stretch) for stretch in (1.0, 1.3)]
    assert tubes[1].equilibrium([0.0] * 4).stretch == pytest.approx(1.0, abs=1e-12)
    # w'' = µ (1 + 3/λ⁴) of the neo-Hookean wall, once for each factor λ_p of the strain and of its work
    ratio = 1.3**2 * (1.0 + 3.0 / 1.3**4) / 4.0
    assert tubes[1].rest_bending_stiffness_N_m2 == pytest.approx(
        ratio * tubes[0].rest_bending_stiffness_N_m2, rel=1e-12
    )
    bends = [np.hypot(*tube.equilibrium([100.0, 0, 0, 0]).curvature_1_m) for tube in tubes]
    assert bends[0] / bends[1] == pytest.approx(ratio, rel=1e-3)


def test_linear_wall_does_not_feel_pre_stretch_but_by_its_scale() -> None:
    plain, stretched = law("linear"), law("linear", pre_stretch=1.2)
    found = stretched.equilibrium([1.44 * 9e3, 0, 1.44 * 2e3, 0])
    expected = plain.equilibrium([9e3, 0, 2e3, 0])
    np.testing.assert_allclose(found.curvature_1_m, expected.curvature_1_m, rtol=1e-10, atol=1e-12)


@given(offset=st.floats(-0.4, 0.4), chamber=st.integers(0, 3))
def test_chambers_all_turned_alike_turn_the_bend_and_nothing_else(offset: float, chamber: int) -> None:
    turned = CrossSection(SECTION.radius_m, SECTION.chamber_area_m2, SECTION.chamber_centroid_radius_m, (offset,) * 4)
    pressure = 20e3 * np.eye(4)[chamber]
    found = ActuatorLaw(turned, "neo-hookean", MODULUS_Pa / 4).equilibrium(pressure)
    plain = law().equilibrium(pressure)
    c, s = math.cos(offset), math.sin(offset)
    np.testing.assert_allclose(found.curvature_1_m, np.array([[c, -s], [s, c]]) @ plain.curvature_1_m, atol=2e-3)
    assert found.stretch == pytest.approx(plain.stretch, rel=1e-5)


def test_one_misaligned_chamber_bends_away_from_where_it_lies_and_couples_stretch_to_bend() -> None:
    crooked = CrossSection(0.01, SECTION.chamber_area_m2, SECTION.chamber_centroid_radius_m, (0.1, 0.0, 0.0, 0.0))
    tube = ActuatorLaw(crooked, "linear", MODULUS_Pa)
    bend = tube.equilibrium([5e3, 0, 0, 0]).curvature_1_m
    assert math.remainder(math.atan2(bend[1], bend[0]) - math.pi - 0.1, 2 * math.pi) == pytest.approx(0.0, abs=0.05)
    centroid = -SECTION.chamber_area_m2 * (crooked.chamber_centroids_m().sum(axis=0)) / SECTION.wall_area_m2
    coupling = -MODULUS_Pa * SECTION.wall_area_m2 * centroid
    np.testing.assert_allclose(tube.forces(1.0, [0.0, 0.0])[1][0, 1:], coupling, rtol=1e-9)
    for wrong in ((0.6, 0, 0, 0), (0.0, 0.0, 0.0), (math.nan, 0, 0, 0)):
        with pytest.raises(InputError, match="misalignment_rad"):
            CrossSection(0.01, SECTION.chamber_area_m2, SECTION.chamber_centroid_radius_m, wrong)


@given(pressure_Pa=st.floats(1e3, 1e9))
def test_gent_wall_locks_but_carries_any_pressure(pressure_Pa: float) -> None:
    tube = law("gent", limit_invariant=1.0)
    rest = tube.equilibrium([pressure_Pa, 0, 0, pressure_Pa])
    longest = rest.stretch + 0.01 * np.hypot(*rest.curvature_1_m)
    assert longest**2 + longest**-2 - 2.0 < 1.3  # of points of the quadrature, which reach to 0.96 R
    force, _ = tube.forces(rest.stretch, rest.curvature_1_m)
    load = tube.load_matrix @ np.array([pressure_Pa, 0, 0, pressure_Pa])
    np.testing.assert_allclose(force, load, rtol=1e-6, atol=1e-6 * np.abs(load).max())


# --- many at once, and what is refused ------------------------------------------------------------


@pytest.mark.parametrize("tube", LAWS)
def test_many_at_once_are_as_one_by_one_from_any_start(tube: ActuatorLaw) -> None:
    pressure = np.random.default_rng(3).uniform(0.0, LIMIT_Pa, (7, 4))
    strain, stiffness = tube.equilibria(pressure)
    for row, at in enumerate(pressure):
        one = tube.equilibrium(at)
        np.testing.assert_allclose(strain[row], [one.stretch, *one.curvature_1_m], rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(stiffness[row], one.stiffness, rtol=1e-9, atol=1e-12)
    again, _ = tube.equilibria(pressure, start=strain + 0.01)
    np.testing.assert_allclose(again, strain, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        ({"material": "granite"}, "material = 'granite': choose one of linear"),
        ({"modulus_Pa": 0.0}, "modulus_Pa"),
        ({"modulus_Pa": math.nan}, "modulus_Pa"),
        ({"stiffening_Pa": -1.0}, "stiffening_Pa"),
        ({"dead_band_Pa": -1.0}, "dead_band_Pa"),
        ({"gains": (1.0, 1.0, 1.0)}, "gains"),
        ({"gains": (1.0, 1.0, 0.0, 1.0)}, "gains"),
        ({"stiffening_Pa": 1.0}, "no such parameter; leave it out, or take yeoh"),
        ({"pre_stretch": 0.1}, "pre_stretch = 0.1: give 0.5 to 3"),
        ({"material": "gent", "limit_invariant": 0.5, "pre_stretch": 2.0}, "beyond what limit_invariant"),
    ],
)
def test_parameters_that_are_no_actuator_are_refused(arguments: dict[str, Any], names: str) -> None:
    with pytest.raises(InputError, match=names):
        ActuatorLaw(**{"section": SECTION, "material": "neo-hookean", "modulus_Pa": 3e4, **arguments})


def test_what_is_not_four_finite_pressures_is_refused() -> None:
    tube = law()
    for wrong in ([1.0, 2.0], [0.0, 0.0, math.nan, 0.0], [[0.0] * 4]):
        with pytest.raises(InputError, match="4 finite numbers"):
            tube.equilibrium(wrong)
    for wrong in ([0.0] * 4, [[0.0] * 3], [[math.inf] * 4]):
        with pytest.raises(InputError, match="rows of 4"):
            tube.equilibria(wrong)
    with pytest.raises(InputError, match="two finite numbers"):
        tube.pressures([1.0, math.nan], limit_Pa=LIMIT_Pa)
    with pytest.raises(InputError, match="co_contraction_Pa"):
        tube.pressures([1.0, 0.0], limit_Pa=LIMIT_Pa, co_contraction_Pa=2 * LIMIT_Pa)


def test_strains_that_no_wall_has_are_a_simulation_error() -> None:
    with pytest.raises(SimulationError, match="beyond its law"):
        law("gent", limit_invariant=1.0).forces(3.0, [0.0, 0.0])
    with pytest.raises(SimulationError, match="crush"):
        law().forces(1.0, [200.0, 0.0])


def test_pressures_that_crush_the_wall_are_a_simulation_error() -> None:
    tube = law("linear")
    with pytest.raises(SimulationError, match="crush"):
        tube.equilibrium([-1e7] * 4)
    with pytest.raises(SimulationError, match="crush"):
        tube.equilibria([[0.0] * 4, [-1e7] * 4])


# --- the inverse ------------------------------------------------------------

least_available = st.lists(st.booleans(), min_size=4, max_size=4)


@settings(max_examples=300)
@given(
    tube=laws,
    size=st.floats(0.0, 60.0),
    direction=directions,
    co_contraction_Pa=st.floats(0.0, 25e3),
    available=least_available,
)
def test_inverse_keeps_the_limits_the_dead_chambers_and_its_word(
    tube: ActuatorLaw, size: float, direction: float, co_contraction_Pa: float, available: list[bool]
) -> None:
    wanted = size * np.array([math.cos(direction), math.sin(direction)])
    found = tube.pressures(wanted, limit_Pa=LIMIT_Pa, co_contraction_Pa=co_contraction_Pa, available=available)
    live = np.array(available)
    assert np.all(found.pressure_Pa[~live] == 0.0)
    assert np.all(found.pressure_Pa[live] >= co_contraction_Pa)
    assert np.all(found.pressure_Pa <= LIMIT_Pa)
    given_now = tube.equilibrium(found.pressure_Pa).curvature_1_m
    np.testing.assert_allclose(found.curvature_1_m, given_now, rtol=1e-8, atol=1e-9)  # two ways to one equilibrium
    assert found.reached == (np.hypot(*(given_now - wanted)) <= 0.01 * max(size, 1e-4))


@settings(max_examples=200)
@given(
    tube=laws,
    direction=directions,
    share=st.floats(0.05, 0.95),
    co_contraction_Pa=st.floats(0.0, 20e3),
)
def test_every_direction_is_reached_up_to_the_pressure_limit(
    tube: ActuatorLaw, direction: float, share: float, co_contraction_Pa: float
) -> None:
    """Wanted: what pressures within the limits are known to give. The inverse must find some that give it too."""
    outside = direction + math.pi
    wave = np.maximum(np.cos(outside - np.array(CHAMBER_ANGLES_RAD)), 0.0)
    room = LIMIT_Pa - max(co_contraction_Pa, tube.dead_band_Pa)
    base = co_contraction_Pa if co_contraction_Pa > tube.dead_band_Pa else tube.dead_band_Pa * (wave > 0.0)
    known_Pa = np.maximum(base + share * room * wave, co_contraction_Pa)
    wanted = tube.equilibrium(known_Pa).curvature_1_m
    found = tube.pressures(wanted, limit_Pa=LIMIT_Pa, co_contraction_Pa=co_contraction_Pa)
    assert found.reached
    np.testing.assert_allclose(found.curvature_1_m, wanted, atol=0.01 * np.hypot(*wanted))
    assert found.pressure_Pa.sum() <= known_Pa.sum() * (1.0 + 1e-6)  # the least there are
    exact = tube.pressures_exactly(wanted, limit_Pa=LIMIT_Pa, co_contraction_Pa=co_contraction_Pa)
    np.testing.assert_array_equal(exact, found.pressure_Pa)


@pytest.mark.parametrize("co_contraction_Pa", [0.0, 1e3, 10e3])
@pytest.mark.parametrize("chamber", range(4))
def test_a_chamber_that_round_off_asks_for_is_not_filled(chamber: int, co_contraction_Pa: float) -> None:
    tube = law(dead_band_Pa=3e3, gains=(1.04, 0.99, 0.97, 1.02))
    angle = CHAMBER_ANGLES_RAD[chamber] + math.pi
    wanted = 2.0 * np.array([math.cos(angle), math.sin(angle)])  # one component is some 1e-16
    found = tube.pressures(wanted, limit_Pa=LIMIT_Pa, co_contraction_Pa=co_contraction_Pa)
    assert found.reached
    if co_contraction_Pa <= tube.dead_band_Pa:  # above it, unequal gains have others balance each other
        np.testing.assert_array_equal(np.delete(found.pressure_Pa, chamber), co_contraction_Pa)


@settings(max_examples=100)
@given(tube=laws, dead=st.integers(0, 3), off=st.floats(-math.pi, math.pi))
def test_one_dead_chamber_leaves_the_half_plane_about_itself(tube: ActuatorLaw, dead: int, off: float) -> None:
    """Without chamber j only bends within 90° of α_j can be had; the nearest edge stands in for the rest."""
    assume(abs(abs(off) - 0.5 * math.pi) > 0.02)
    direction = CHAMBER_ANGLES_RAD[dead] + off
    towards = np.array([math.cos(direction), math.sin(direction)])
    available = [chamber != dead for chamber in range(4)]
    found = tube.pressures(3.0 * towards, limit_Pa=LIMIT_Pa, available=available)
    assert found.reached == (abs(off) < 0.5 * math.pi)
    if not found.reached:
        edge_rad = CHAMBER_ANGLES_RAD[dead] + math.copysign(0.5 * math.pi, off)
        share = abs(math.sin(off))  # the wanted vector's part along that edge
        nearest = 3.0 * share * np.array([math.cos(edge_rad), math.sin(edge_rad)])
        assert_near(found.curvature_1_m, nearest, 0.05 * 3.0)


def test_two_opposite_dead_chambers_leave_a_line_and_two_adjacent_a_quarter() -> None:
    tube = law()

    def reached(degrees: float, dead: tuple[int, int]) -> bool:
        direction = math.radians(degrees)
        wanted = 3.0 * np.array([math.cos(direction), math.sin(direction)])
        return tube.pressures(wanted, limit_Pa=LIMIT_Pa, available=[i not in dead for i in range(4)]).reached

    assert [d for d in range(0, 360, 15) if reached(d, (0, 2))] == [90, 270]
    assert [d for d in range(0, 360, 15) if reached(d, (0, 1))] == list(range(0, 91, 15))


def test_no_live_chamber_gives_no_bend() -> None:
    found = law().pressures([5.0, 0.0], limit_Pa=LIMIT_Pa, available=[False] * 4)
    assert not found.reached
    np.testing.assert_array_equal(found.pressure_Pa, 0.0)


@given(tube=laws, direction=directions)
def test_bend_beyond_the_limit_becomes_the_largest_in_that_direction(tube: ActuatorLaw, direction: float) -> None:
    towards = np.array([math.cos(direction), math.sin(direction)])
    found = tube.pressures(80.0 * towards, limit_Pa=LIMIT_Pa)
    assert not found.reached
    assert found.pressure_Pa.max() == pytest.approx(LIMIT_Pa, rel=1e-4)
    assert float(found.curvature_1_m @ towards) > 0.97 * np.hypot(*found.curvature_1_m)
    with pytest.raises(UnreachableError, match="at most"):
        tube.pressures_exactly(80.0 * towards, limit_Pa=LIMIT_Pa)


def test_wall_that_softens_is_bent_further_by_filling_the_other_chambers_too() -> None:
    """A longer neo-Hookean tube is softer: with the two chambers beside it, one bends the tube further than alone."""
    tube = law()
    alone = float(np.hypot(*tube.equilibrium([0.0, 0.0, LIMIT_Pa, 0.0]).curvature_1_m))
    found = tube.pressures([1.3 * alone, 0.0], limit_Pa=LIMIT_Pa)
    assert found.reached
    assert found.pressure_Pa[1] == pytest.approx(found.pressure_Pa[3], rel=1e-6)
    assert found.pressure_Pa[1] > 1e3
    linear = law("linear")
    most = float(np.hypot(*linear.equilibrium([0.0, 0.0, LIMIT_Pa, 0.0]).curvature_1_m))
    assert not linear.pressures([1.05 * most, 0.0], limit_Pa=LIMIT_Pa).reached


def test_co_contraction_lengthens_and_holds_the_bend() -> None:
    tube = law()
    slack, tense = (tube.pressures([8.0, 3.0], limit_Pa=LIMIT_Pa, co_contraction_Pa=p) for p in (0.0, 15e3))
    np.testing.assert_allclose(slack.curvature_1_m, tense.curvature_1_m, rtol=1e-6)
    assert tube.equilibrium(tense.pressure_Pa).stretch > tube.equilibrium(slack.pressure_Pa).stretch + 0.02


def test_bend_that_would_crush_the_inner_wall_is_met_by_a_milder_one() -> None:
    found = law().pressures([2.0 / SECTION.radius_m, 0.0], limit_Pa=LIMIT_Pa)
    assert not found.reached
    assert np.isfinite(found.pressure_Pa).all()
    assert found.pressure_Pa.max() <= LIMIT_Pa


@settings(max_examples=300)
@given(
    tube=laws,
    known=st.lists(st.floats(0.0, LIMIT_Pa), min_size=4, max_size=4),
    available=least_available,
)
def test_bend_and_stretch_that_some_pressures_give_are_both_reached(
    tube: ActuatorLaw, known: list[float], available: list[bool]
) -> None:
    known_Pa = np.where(available, known, 0.0)
    wanted = tube.equilibrium(known_Pa)
    found = tube.pressures(wanted.curvature_1_m, limit_Pa=LIMIT_Pa, available=available, stretch=wanted.stretch)
    assert np.all(found.pressure_Pa[~np.array(available)] == 0.0)
    assert np.all((found.pressure_Pa >= 0.0) & (found.pressure_Pa <= LIMIT_Pa))
    size = max(float(np.hypot(*wanted.curvature_1_m)), 1e-2)
    assert_near(found.curvature_1_m, wanted.curvature_1_m, 1e-3 * size)
    assert found.stretch == pytest.approx(wanted.stretch, abs=1e-3 * (wanted.stretch - 1.0) + 1e-6)


@given(tube=laws, direction=directions, size=st.floats(0.5, 3.0), stretch=st.floats(0.5, 3.0))
def test_stretch_that_cannot_be_had_with_the_bend_gives_way_to_it(
    tube: ActuatorLaw, direction: float, size: float, stretch: float
) -> None:
    wanted = size * np.array([math.cos(direction), math.sin(direction)])
    free = tube.pressures(wanted, limit_Pa=LIMIT_Pa)
    found = tube.pressures(wanted, limit_Pa=LIMIT_Pa, stretch=stretch)
    assert found.reached
    assert found.stretch >= free.stretch - 1e-9  # the least pressures make the shortest tube of that bend
    if stretch - found.stretch > 0.011 * (stretch - 1.0):
        assert not found.stretch_reached
        assert found.pressure_Pa.max() == pytest.approx(LIMIT_Pa, rel=1e-4)  # there is no more
    elif 0.009 * (stretch - 1.0) > stretch - found.stretch and stretch > free.stretch:
        assert found.stretch_reached


@given(tube=laws, least=st.lists(st.floats(0.0, 2e4), min_size=4, max_size=4), direction=directions)
def test_chambers_may_each_have_limits_of_their_own(tube: ActuatorLaw, least: list[float], direction: float) -> None:
    wanted = 2.0 * np.array([math.cos(direction), math.sin(direction)])
    most = np.array(least) + 3e4
    found = tube.pressures_within(wanted, least_Pa=least, most_Pa=most)
    assert np.all((found.pressure_Pa >= least) & (found.pressure_Pa <= most))
    assert found.reached == (np.hypot(*(found.curvature_1_m - wanted)) <= 0.02)
    held = tube.pressures_within(wanted, least_Pa=least, most_Pa=least)
    np.testing.assert_array_equal(held.pressure_Pa, least)
    for wrong in ({"least_Pa": [-1.0] * 4, "most_Pa": most}, {"least_Pa": most, "most_Pa": least}):
        with pytest.raises(InputError, match="0 ≤ least_Pa ≤ most_Pa"):
            tube.pressures_within(wanted, **wrong)
    with pytest.raises(InputError, match="stretch = nan"):
        tube.pressures(wanted, limit_Pa=LIMIT_Pa, stretch=math.nan)


# --- the kernels as plain Python ------------------------------------------------------------


def test_interpreted_and_compiled_kernels_agree(interpreted: Callable[..., None]) -> None:
    tube = law("yeoh", gains=(1.0, 1.1, 0.9, 1.0), dead_band_Pa=2e3)
    batch = np.array([[20e3, 5e3, 0.0, 1e3], [0.0, 0.0, 30e3, 30e3]])

    def everything() -> list[np.ndarray]:
        return [
            np.hstack([tube.equilibrium(row).curvature_1_m for row in batch]),
            np.hstack([part.ravel() for part in tube.equilibria(batch)]),
            tube.pressures([7.0, -4.0], limit_Pa=LIMIT_Pa, co_contraction_Pa=3e3).pressure_Pa,
            tube.pressures([7.0, -4.0], limit_Pa=LIMIT_Pa, available=(True, False, False, True)).pressure_Pa,
            tube.pressures([-90.0, 4.0], limit_Pa=LIMIT_Pa).pressure_Pa,
            tube.pressures([200.0, 0.0], limit_Pa=LIMIT_Pa).pressure_Pa,
            tube.pressures([4.0, 3.0], limit_Pa=LIMIT_Pa, stretch=1.1).pressure_Pa,
            tube.pressures([4.0, 3.0], limit_Pa=LIMIT_Pa, stretch=2.0).pressure_Pa,
        ]

    compiled = everything()
    interpreted(actuator)
    for one, other in zip(compiled, everything(), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)
    with pytest.raises(SimulationError):
        law("linear").equilibria([[-1e7] * 4])
    start = np.array([[1.0, 400.0, 0.0]])  # a start that is itself crushed is forgotten
    np.testing.assert_allclose(tube.equilibria(batch[:1], start=start)[0], tube.equilibria(batch[:1])[0], atol=1e-9)
