"""Every wall law keeps the one contract: its stiffness is the slope of its forces, both ways and in all directions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softbot.actuator import ActuatorLaw
from softbot.cross_section import CrossSection, default_cross_section
from softbot.errors import InputError, KinkError
from softbot.section_law import SectionLaw
from softbot.tube import Tube, bending_moment_N_m
from softbot.tube_law import TubeLaw

ROUND = default_cross_section(0.01)
CROOKED = CrossSection(0.01, ROUND.chamber_area_m2, ROUND.chamber_centroid_radius_m, (0.1, -0.05, 0.0, 0.08))
LARVA = TubeLaw(Tube(0.01, 1e-3, 1e6), 3e5)
LAWS: list[SectionLaw] = [
    ActuatorLaw(ROUND, "linear", 1.2e5),
    ActuatorLaw(ROUND, "neo-hookean", 3e4),
    ActuatorLaw(ROUND, "mooney-rivlin", 3e4, second_share=0.4),
    ActuatorLaw(ROUND, "yeoh", 3e4, 2e3, stiffening_2_Pa=50.0),
    ActuatorLaw(ROUND, "gent", 3e4, limit_invariant=4.0),
    ActuatorLaw(ROUND, "gent", 3e4, limit_invariant=4.0, pre_stretch=1.3),
    ActuatorLaw(CROOKED, "yeoh", 3e4, 2e3, pre_stretch=0.9),
    LARVA,
]
laws = st.sampled_from(LAWS)
curvatures = st.tuples(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0))


@given(law=laws, stretch=st.floats(0.9, 1.4), curvature=curvatures)
def test_stiffness_is_the_slope_of_the_forces_and_symmetric(
    law: SectionLaw, stretch: float, curvature: tuple[float, float]
) -> None:
    strain = np.array([stretch, *curvature])
    _, stiffness = law.forces(stretch, curvature)
    np.testing.assert_allclose(stiffness, stiffness.T, atol=1e-12 * np.abs(stiffness).max())
    steps = np.array([1e-6, 1e-3, 1e-3])
    scale = np.sqrt(np.outer(np.abs(np.diag(stiffness)), np.abs(np.diag(stiffness)))) + 1e-12
    for column, step in enumerate(steps):
        nudge = np.eye(3)[column] * step
        up, down = (law.forces(at[0], at[1:])[0] for at in (strain + nudge, strain - nudge))
        assert np.all(np.abs(stiffness[:, column] - (up - down) / (2 * step)) <= 2e-4 * scale[:, column])


@pytest.mark.parametrize("law", LAWS)
def test_unloaded_section_is_at_rest_with_the_stated_bending_stiffness(law: SectionLaw) -> None:
    force, stiffness = law.forces(1.0, [0.0, 0.0])
    np.testing.assert_allclose(force, 0.0, atol=1e-12)
    mean = 0.5 * (stiffness[1, 1] + stiffness[2, 2])  # of misaligned chambers the bending stiffness has two axes
    assert mean == pytest.approx(law.rest_bending_stiffness_N_m2, rel=1e-9)


@given(law=laws, stretch=st.floats(0.95, 1.3), curvature=curvatures)
def test_wall_resists_strains_more_than_rest(law: SectionLaw, stretch: float, curvature: tuple[float, float]) -> None:
    force, _ = law.forces(stretch, curvature)
    assert float(force @ (np.array([stretch, *curvature]) - [1.0, 0.0, 0.0])) >= 0.0


# --- the paper's tube ------------------------------------------------------------


@given(size=st.floats(0.0, 100.0), direction=st.floats(-math.pi, math.pi))
def test_tube_has_the_papers_moment_in_every_direction_and_both_ways(size: float, direction: float) -> None:
    towards = np.array([math.cos(direction), math.sin(direction)])
    force, _ = LARVA.forces(1.0, size * towards)
    moment_N_m = bending_moment_N_m(LARVA.tube, size, LARVA.internal_pressure_Pa)
    np.testing.assert_allclose(force[1:], moment_N_m * towards, atol=1e-12)
    np.testing.assert_allclose(LARVA.forces(1.0, -size * towards)[0], -force, atol=1e-12)


def test_tangent_of_the_tube_vanishes_at_its_kink_and_beyond_it_nothing_is_computed() -> None:
    kink = LARVA.kink_curvature_1_m
    stiffness = LARVA.forces(1.0, [kink, 0.0])[1]
    assert stiffness[1, 1] == pytest.approx(0.0, abs=1e-9 * LARVA.rest_bending_stiffness_N_m2)
    assert stiffness[2, 2] == pytest.approx(2.0 / 3.0 * LARVA.rest_bending_stiffness_N_m2, rel=1e-9)
    with pytest.raises(KinkError, match="kink"):
        LARVA.forces(1.0, [0.0, 1.01 * kink])
    with pytest.raises(InputError, match="finite"):
        LARVA.forces(math.nan, [0.0, 0.0])
    with pytest.raises(InputError, match="internal_pressure_Pa"):
        TubeLaw(LARVA.tube, 0.0)
