"""The section's areas and moments, and the quadrature that stands for its wall."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softbot.cross_section import CHAMBER_ANGLES_RAD, CHAMBERS, CrossSection, default_cross_section
from softbot.errors import InputError

RADIUS_m = 0.01

sections = st.builds(
    lambda radius, area, centroid: CrossSection(radius, area * math.pi * radius**2, centroid * radius),
    st.floats(1e-3, 1.0),
    st.floats(0.01, 0.15),
    st.floats(0.3, 0.6),
)


def disc_moment(a: int, b: int, radius: float, centre: tuple[float, float]) -> float:
    """∫ x^a y^b over a disc, by the binomial expansion about its centre and the Beta function."""

    def centred(i: int, j: int) -> float:
        if i % 2 or j % 2:
            return 0.0
        angular = 2.0 * math.gamma((i + 1) / 2) * math.gamma((j + 1) / 2) / math.gamma((i + j + 2) / 2)
        return angular * radius ** (i + j + 2) / (i + j + 2)

    return sum(
        math.comb(a, i) * math.comb(b, j) * centre[0] ** (a - i) * centre[1] ** (b - j) * centred(i, j)
        for i in range(a + 1)
        for j in range(b + 1)
    )


@pytest.mark.parametrize(("a", "b"), [(a, b) for a in range(6) for b in range(6 - a)])
def test_wall_quadrature_is_exact_for_every_moment_up_to_degree_five(a: int, b: int) -> None:
    section = CrossSection(1.0, 0.3, 0.5)
    points = section.wall_points()
    found = float(np.sum(points[:, 2] * points[:, 0] ** a * points[:, 1] ** b))
    chamber_radius = math.sqrt(0.3 / math.pi)
    exact = disc_moment(a, b, 1.0, (0.0, 0.0))
    for x1, x2 in section.chamber_centroids_m():
        exact -= disc_moment(a, b, chamber_radius, (float(x1), float(x2)))
    assert found == pytest.approx(exact, rel=1e-12, abs=1e-14)


@given(section=sections)
def test_area_and_second_moment_are_those_of_the_quadrature(section: CrossSection) -> None:
    points = section.wall_points()
    x1, x2, weight = points.T
    moment = section.bending_area_moment_m4
    assert weight.sum() == pytest.approx(section.wall_area_m2, rel=1e-12)
    assert float(weight @ x1**2) == pytest.approx(moment, rel=1e-11)
    assert float(weight @ x2**2) == pytest.approx(moment, rel=1e-11)
    assert float(weight @ (x1 * x2)) == pytest.approx(0.0, abs=1e-12 * moment)


def test_chamber_centroids_lie_at_quarter_turns_from_e1_towards_e2() -> None:
    section = CrossSection(RADIUS_m, 3e-5, 0.005)
    expected = 0.005 * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    np.testing.assert_allclose(section.chamber_centroids_m(), expected, atol=1e-17)
    assert len(CHAMBER_ANGLES_RAD) == CHAMBERS


@given(radius_m=st.floats(1e-4, 10.0))
def test_default_section_scales_with_the_radius_and_its_chambers_are_apart(radius_m: float) -> None:
    section = default_cross_section(radius_m)
    chamber_radius_m = math.sqrt(section.chamber_area_m2 / math.pi)
    assert section.chamber_centroid_radius_m + chamber_radius_m < radius_m
    assert 2.0 * chamber_radius_m < math.sqrt(2.0) * section.chamber_centroid_radius_m
    unit = default_cross_section(1.0)
    assert section.bending_area_moment_m4 == pytest.approx(unit.bending_area_moment_m4 * radius_m**4, rel=1e-12)


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"radius_m": 0.0}, "radius_m"),
        ({"radius_m": math.nan}, "radius_m"),
        ({"chamber_area_m2": -1e-5}, "chamber_area_m2"),
        ({"chamber_area_m2": math.inf}, "chamber_area_m2"),
        ({"chamber_centroid_radius_m": RADIUS_m}, "inside"),
        ({"chamber_area_m2": 0.23 * math.pi * RADIUS_m**2}, "10 % wall"),
        ({"chamber_area_m2": 0.2 * math.pi * RADIUS_m**2, "chamber_centroid_radius_m": 0.9 * RADIUS_m}, "bending"),
    ],
)
def test_section_that_cannot_be_is_refused_with_the_mend(change: dict[str, Any], names: str) -> None:
    values = {"radius_m": RADIUS_m, "chamber_area_m2": 3e-5, "chamber_centroid_radius_m": 0.005, **change}
    with pytest.raises(InputError, match=names):
        CrossSection(**values)
