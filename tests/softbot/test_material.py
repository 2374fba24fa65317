"""Stress and tangent are the derivatives of the energies that the material table states."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softbot import material
from softbot.material import MATERIALS, nominal_stress, tangent_modulus

MODULUS_Pa, STIFFENING_Pa = 5e4, 3e3
stretches = st.floats(0.3, 3.0)
names = st.sampled_from(sorted(MATERIALS))


def energy(name: str, stretch: float) -> float:
    """w(λ) of the module's table [J/m³]."""
    invariant = stretch**2 + stretch**-2 - 2.0
    return {
        "linear": 0.5 * MODULUS_Pa * (stretch - 1.0) ** 2,
        "neo-hookean": 0.5 * MODULUS_Pa * invariant,
        "yeoh": 0.5 * MODULUS_Pa * invariant + STIFFENING_Pa * invariant**2,
    }[name]


def stress(name: str, stretch: float) -> float:
    return nominal_stress(MATERIALS[name].code, MODULUS_Pa, STIFFENING_Pa, stretch)


def tangent(name: str, stretch: float) -> float:
    return tangent_modulus(MATERIALS[name].code, MODULUS_Pa, STIFFENING_Pa, stretch)


@given(name=names, stretch=stretches)
def test_stress_is_the_slope_of_the_energy(name: str, stretch: float) -> None:
    h = 1e-5 * stretch
    slope = (energy(name, stretch + h) - energy(name, stretch - h)) / (2.0 * h)
    assert stress(name, stretch) == pytest.approx(slope, rel=1e-6, abs=1e-4 * MODULUS_Pa)


@given(name=names, stretch=stretches)
def test_tangent_is_the_slope_of_the_stress(name: str, stretch: float) -> None:
    h = 1e-5 * stretch
    slope = (stress(name, stretch + h) - stress(name, stretch - h)) / (2.0 * h)
    assert tangent(name, stretch) == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("name", sorted(MATERIALS))
def test_unstretched_wall_is_free_of_stress_and_has_the_stated_small_strain_modulus(name: str) -> None:
    assert stress(name, 1.0) == 0.0
    assert tangent(name, 1.0) == pytest.approx(MATERIALS[name].modulus_ratio * MODULUS_Pa, rel=1e-12)


@given(name=names, stretch=stretches)
def test_wall_is_stable_and_resists_in_the_direction_of_its_strain(name: str, stretch: float) -> None:
    assert tangent(name, stretch) > 0.0
    assert stress(name, stretch) * (stretch - 1.0) >= 0.0


def test_yeoh_without_stiffening_is_neo_hookean_and_with_it_stiffer() -> None:
    yeoh, neo = MATERIALS["yeoh"].code, MATERIALS["neo-hookean"].code
    assert nominal_stress(yeoh, MODULUS_Pa, 0.0, 1.4) == nominal_stress(neo, MODULUS_Pa, 0.0, 1.4)
    assert tangent_modulus(yeoh, MODULUS_Pa, 0.0, 1.4) == tangent_modulus(neo, MODULUS_Pa, 0.0, 1.4)
    assert stress("yeoh", 1.4) > stress("neo-hookean", 1.4)


def test_only_a_material_that_says_so_uses_the_second_parameter() -> None:
    for kind in MATERIALS.values():
        changes = nominal_stress(kind.code, MODULUS_Pa, 0.0, 1.3) != nominal_stress(kind.code, MODULUS_Pa, 1e3, 1.3)
        assert changes == kind.has_stiffening


def test_interpreted_and_compiled_laws_agree(interpreted: Callable[..., None]) -> None:
    places = [(name, stretch) for name in MATERIALS for stretch in (0.7, 1.0, 1.6)]
    compiled = [(stress(*place), tangent(*place)) for place in places]
    interpreted(material)
    for place, (expected_stress, expected_tangent) in zip(places, compiled, strict=True):
        code = MATERIALS[place[0]].code
        arguments = (code, MODULUS_Pa, STIFFENING_Pa, place[1])
        assert material.nominal_stress(*arguments) == pytest.approx(expected_stress, rel=1e-12)
        assert material.tangent_modulus(*arguments) == pytest.approx(expected_tangent, rel=1e-12)
