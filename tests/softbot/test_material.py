"""Wall materials: stress and tangent derive from the energy, the laws meet in their limits, parameters have bounds."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from softbot import material
from softbot.errors import InputError
from softbot.material import (
    MATERIALS,
    OPTIONAL_PARAMETERS,
    energy_density,
    is_within,
    material_parameters,
    nominal_stress,
    tangent_modulus,
    uniaxial_stress_Pa,
)

MODULUS_Pa = 5e4
VALUES = {"stiffening_Pa": 3e3, "stiffening_2_Pa": 40.0, "limit_invariant": 12.0, "second_share": 0.3}
stretches = st.floats(0.3, 3.0)
names = st.sampled_from(sorted(MATERIALS))


def values_of(name: str, **others: float) -> dict[str, float]:
    own = {key: VALUES[key] for key in MATERIALS[name].keys if key in VALUES}
    return {"modulus_Pa": MODULUS_Pa, **own, **others}


def wall(name: str, **others: float) -> tuple[int, np.ndarray]:
    return MATERIALS[name].code, material_parameters(name, values_of(name, **others))


def written_energy(name: str, stretch: float) -> float:
    """w(λ) of the module's table, as it is written there [J/m³]."""
    i1 = stretch**2 + 1.0 + stretch**-2
    i2 = stretch**2 + 1.0 + stretch**-2  # of diag(λ, 1, 1/λ): Σ λ_i² λ_j²
    j = i1 - 3.0
    share, limit = VALUES["second_share"], VALUES["limit_invariant"]
    return {
        "linear": 0.5 * MODULUS_Pa * (stretch - 1.0) ** 2,
        "neo-hookean": 0.5 * MODULUS_Pa * j,
        "mooney-rivlin": 0.5 * MODULUS_Pa * ((1.0 - share) * (i1 - 3.0) + share * (i2 - 3.0)),
        "yeoh": 0.5 * MODULUS_Pa * j + VALUES["stiffening_Pa"] * j**2 + VALUES["stiffening_2_Pa"] * j**3,
        "gent": -0.5 * MODULUS_Pa * limit * math.log(1.0 - j / limit) if j < limit else math.inf,
    }[name]


@given(name=names, stretch=stretches)
def test_energy_is_the_stated_one(name: str, stretch: float) -> None:
    assert energy_density(*wall(name), stretch) == pytest.approx(written_energy(name, stretch), rel=1e-9, abs=1e-9)


@given(name=names, stretch=stretches)
def test_stress_is_the_slope_of_the_energy(name: str, stretch: float) -> None:
    h = 1e-5 * stretch
    slope = (written_energy(name, stretch + h) - written_energy(name, stretch - h)) / (2.0 * h)
    assert nominal_stress(*wall(name), stretch) == pytest.approx(slope, rel=1e-5, abs=1e-4 * MODULUS_Pa)


@given(name=names, stretch=stretches)
def test_tangent_is_the_slope_of_the_stress(name: str, stretch: float) -> None:
    h = 1e-6 * stretch
    low, high = (nominal_stress(*wall(name), stretch + sign * h) for sign in (-1.0, 1.0))
    assert tangent_modulus(*wall(name), stretch) == pytest.approx((high - low) / (2.0 * h), rel=1e-5)


@pytest.mark.parametrize("name", sorted(MATERIALS))
def test_unstretched_wall_is_free_of_stress_and_has_the_stated_small_strain_modulus(name: str) -> None:
    assert energy_density(*wall(name), 1.0) == 0.0
    assert nominal_stress(*wall(name), 1.0) == 0.0
    expected = MATERIALS[name].modulus_ratio * MODULUS_Pa
    assert tangent_modulus(*wall(name), 1.0) == pytest.approx(expected, rel=1e-12)
    h = 1e-6
    strip = (uniaxial_stress_Pa(name, values_of(name), 1.0 + h) - uniaxial_stress_Pa(name, values_of(name), 1.0)) / h
    assert float(strip) == pytest.approx(0.75 * expected, rel=1e-4)  # without fibres: E instead of E/(1 − ν²)


@given(name=names, stretch=stretches)
def test_wall_is_stable_and_resists_in_the_direction_of_its_strain(name: str, stretch: float) -> None:
    assert tangent_modulus(*wall(name), stretch) > 0.0
    assert nominal_stress(*wall(name), stretch) * (stretch - 1.0) >= 0.0


@given(name=names, stretch=st.floats(0.4, 2.5))
def test_strip_without_fibres_has_the_stress_of_its_own_energy(name: str, stretch: float) -> None:
    """dw/dλ along λ_θ = λ_r = λ^(−1/2), from the invariants; the linear law is E ε by definition."""
    assume(name != "linear")

    def energy(at: float) -> float:
        i1, i2 = at**2 + 2.0 / at, 2.0 * at + at**-2
        j, limit, share = i1 - 3.0, VALUES["limit_invariant"], VALUES["second_share"]
        return {
            "neo-hookean": 0.5 * MODULUS_Pa * j,
            "mooney-rivlin": 0.5 * MODULUS_Pa * ((1.0 - share) * j + share * (i2 - 3.0)),
            "yeoh": 0.5 * MODULUS_Pa * j + VALUES["stiffening_Pa"] * j**2 + VALUES["stiffening_2_Pa"] * j**3,
            "gent": -0.5 * MODULUS_Pa * limit * math.log(1.0 - j / limit),
        }[name]

    h = 1e-5 * stretch
    slope = (energy(stretch + h) - energy(stretch - h)) / (2.0 * h)
    found = float(uniaxial_stress_Pa(name, values_of(name), stretch))
    assert found == pytest.approx(slope, rel=1e-6, abs=1e-4 * MODULUS_Pa)


# --- limits in which the laws meet ------------------------------------------------------------


@given(stretch=stretches)
def test_laws_are_neo_hookean_in_their_limits(stretch: float) -> None:
    expected = [kernel(*wall("neo-hookean"), stretch) for kernel in (energy_density, nominal_stress, tangent_modulus)]
    for limit in (
        wall("yeoh", stiffening_Pa=0.0, stiffening_2_Pa=0.0),
        wall("gent", limit_invariant=1e9),
        wall("mooney-rivlin"),  # under the hoop constraint I₂ = I₁: whatever its share
    ):
        found = [kernel(*limit, stretch) for kernel in (energy_density, nominal_stress, tangent_modulus)]
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-3)


@given(stretch=st.floats(0.9, 1.1))
def test_gent_is_to_second_order_the_yeoh_law_of_its_series(stretch: float) -> None:
    """−Jm ln(1 − J/Jm)/2 = J/2 + J²/(4 Jm) + J³/(6 Jm²) + …"""
    limit = VALUES["limit_invariant"]
    series = wall("yeoh", stiffening_Pa=MODULUS_Pa / (4 * limit), stiffening_2_Pa=MODULUS_Pa / (6 * limit**2))
    found = nominal_stress(*wall("gent"), stretch)
    assert found == pytest.approx(nominal_stress(*series, stretch), rel=1e-4, abs=1e-9)


def test_mooney_rivlin_differs_from_neo_hookean_in_a_tensile_test_only() -> None:
    strip = [float(uniaxial_stress_Pa(name, values_of(name), 2.0)) for name in ("mooney-rivlin", "neo-hookean")]
    assert strip[0] == pytest.approx(strip[1] * (1.0 - 0.3 + 0.3 / 2.0), rel=1e-12)
    felt = [one.felt_by_section for one in MATERIALS["mooney-rivlin"].parameters]
    assert felt == [True, False]


@pytest.mark.parametrize("name", ["yeoh", "gent"])
def test_stiffening_walls_are_stiffer_than_neo_hookean(name: str) -> None:
    assert nominal_stress(*wall(name), 1.8) > 1.05 * nominal_stress(*wall("neo-hookean"), 1.8)


def test_gent_has_no_stress_beyond_its_limit() -> None:
    code, parameters = wall("gent")
    at_limit = math.sqrt(1.0 + 0.5 * 12.0 + math.sqrt((1.0 + 0.5 * 12.0) ** 2 - 1.0))  # λ² + λ⁻² = 2 + Jm
    assert at_limit**2 + at_limit**-2 - 2.0 == pytest.approx(12.0)
    assert is_within(code, parameters, at_limit * (1.0 - 1e-6))
    for beyond in (at_limit * (1.0 + 1e-6), 1.0 / at_limit - 1e-6, 0.0, -1.0, math.nan):
        assert not is_within(code, parameters, beyond)
    assert nominal_stress(code, parameters, at_limit * (1.0 - 1e-6)) > 1e4 * MODULUS_Pa
    assert np.isinf(uniaxial_stress_Pa("gent", values_of("gent"), 10.0))


# --- parameters ------------------------------------------------------------


def test_only_a_material_that_has_a_parameter_looks_at_it() -> None:
    for name, kind in MATERIALS.items():
        plain = nominal_stress(kind.code, np.array([MODULUS_Pa, 7.0, 0.0]), 1.3)
        changes = [
            nominal_stress(kind.code, np.array([MODULUS_Pa, 9.0, 0.0]), 1.3) != plain,
            nominal_stress(kind.code, np.array([MODULUS_Pa, 7.0, 5e3]), 1.3) != plain,
        ]
        felt = [one.felt_by_section for one in kind.parameters[1:]]
        assert changes == [*felt, False, False][:2], name
        assert kind.has_stiffening == (name == "yeoh")


@pytest.mark.parametrize(
    ("name", "values", "says"),
    [
        ("granite", {"modulus_Pa": 1.0}, "'granite': choose one of linear, neo-hookean, mooney-rivlin, yeoh, gent"),
        ("linear", {}, "modulus_Pa = nan"),
        ("linear", {"modulus_Pa": 0.0}, "modulus_Pa = 0.0: give a finite number above 0 to 1e.12 Pa"),
        ("yeoh", {"modulus_Pa": 1.0, "stiffening_2_Pa": -1.0}, "stiffening_2_Pa = -1.0"),
        ("gent", {"modulus_Pa": 1.0, "limit_invariant": 0.0}, "limit_invariant = 0.0: .*from 0.05"),
        ("mooney-rivlin", {"modulus_Pa": 1.0, "second_share": 1.5}, "second_share = 1.5: .* I₂"),
        ("gent", {"modulus_Pa": 1.0, "stiffening_Pa": 5.0}, "gent has no such parameter; leave it out, or take yeoh"),
    ],
)
def test_wrong_parameters_are_refused_by_key_and_mend(name: str, values: dict[str, float], says: str) -> None:
    with pytest.raises(InputError, match=says):
        material_parameters(name, values)


def test_parameters_left_out_take_their_default_and_defaults_of_other_laws_say_nothing() -> None:
    assert material_parameters("gent", {"modulus_Pa": 2.0})[1] == OPTIONAL_PARAMETERS["limit_invariant"].default
    defaults = {key: one.default for key, one in OPTIONAL_PARAMETERS.items()}
    for name in MATERIALS:
        np.testing.assert_array_equal(
            material_parameters(name, {"modulus_Pa": 2.0, **defaults}), material_parameters(name, {"modulus_Pa": 2.0})
        )


def test_interpreted_and_compiled_laws_agree(interpreted: Callable[..., None]) -> None:
    kernels = ("energy_density", "nominal_stress", "tangent_modulus", "is_within")
    places = [(name, stretch) for name in MATERIALS for stretch in (0.7, 1.0, 1.6)]
    compiled = [[getattr(material, kernel)(*wall(name), at) for kernel in kernels] for name, at in places]
    interpreted(material)
    for (name, at), expected in zip(places, compiled, strict=True):
        found = [getattr(material, kernel)(*wall(name), at) for kernel in kernels]
        assert found == pytest.approx(expected, rel=1e-12)
