"""Muscles: the curvature that a contraction asks for, and their forces summed against the paper's closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softbot.errors import InputError
from softbot.muscle import linear_rest_curvature_1_m, muscle_pulls, pull_moments
from softbot.rolling import rolling_moment_N_m, rotation_moment_N_m, segmented_rolling_moment_N_m
from softbot.tube import Tube, curvature_from_strain_difference, max_strain_difference

LENGTH_M, RADIUS_M = 0.15, 0.01
BENDS = st.floats(-math.pi, math.pi)
ANGLES = st.floats(-math.pi, math.pi)
COUNTS = st.integers(1, 40)


@given(share=st.floats(-1.0, 1.0), pressure=st.floats(0.1, 50.0), poisson_ratio=st.floats(-0.5, 0.5))
def test_ovalising_tube_under_a_muscles_moment_rests_at_the_papers_curvature(
    share: float, pressure: float, poisson_ratio: float
) -> None:
    """κ − aκ³ = the linear rest curvature, a = 3R²/(8p̄), is Eq. (2)."""
    tube = Tube(RADIUS_M, 0.001, 2e6, poisson_ratio)
    contraction = share * max_strain_difference(pressure, poisson_ratio)
    kappa = curvature_from_strain_difference(contraction, pressure, poisson_ratio) / RADIUS_M
    softened = kappa - 3.0 * RADIUS_M**2 / (8.0 * pressure) * kappa**3
    assert linear_rest_curvature_1_m(tube, contraction) == pytest.approx(softened, rel=1e-9, abs=1e-9)


@given(half_bend=BENDS, theta=ANGLES, segments=COUNTS, force=st.floats(-3.0, 3.0))
def test_forces_summed_over_the_junctions_are_the_papers_moments(
    half_bend: float, theta: float, segments: int, force: float
) -> None:
    summed = pull_moments(muscle_pulls(force, RADIUS_M, LENGTH_M, half_bend, theta, segments))
    rolling = segmented_rolling_moment_N_m(force, RADIUS_M, half_bend, theta, segments)
    rotation = rotation_moment_N_m(force, RADIUS_M, half_bend, theta, segments)
    assert summed.rolling_N_m == pytest.approx(-rolling, abs=1e-14)
    assert summed.rotation_N_m == pytest.approx(rotation, abs=1e-14)
    if segments == 1:
        assert summed.rolling_N_m == pytest.approx(rolling_moment_N_m(force, RADIUS_M, half_bend, theta), abs=1e-14)


@given(half_bend=BENDS, theta=ANGLES, segments=COUNTS)
def test_muscles_exert_no_force_and_no_moment_on_the_whole_so_rotation_cancels_rolling(
    half_bend: float, theta: float, segments: int
) -> None:
    summed = pull_moments(muscle_pulls(1.0, RADIUS_M, LENGTH_M, half_bend, theta, segments))
    np.testing.assert_allclose(summed.force_N, 0.0, atol=1e-14)
    np.testing.assert_allclose(summed.moment_N_m, 0.0, atol=1e-15)
    assert summed.rolling_along_chord_N_m == pytest.approx(-summed.rotation_N_m, abs=1e-14)


@given(half_bend=st.floats(0.1, 3.0), theta=ANGLES, segments=COUNTS)
def test_rolling_moment_is_what_the_muscles_gain_in_length_as_the_body_rolls(
    half_bend: float, theta: float, segments: int
) -> None:
    """Virtual work, −F_m ∂(length of the muscles)/∂θ by central differences; θ grows with the roll about t."""

    def length_m(angle: float) -> float:
        place = muscle_pulls(1.0, RADIUS_M, LENGTH_M, half_bend, angle, segments).place_m
        return float(np.sum(np.linalg.norm(np.diff(place, axis=0), axis=1)))

    rate_m = (length_m(theta + 1e-5) - length_m(theta - 1e-5)) / 2e-5
    summed = pull_moments(muscle_pulls(1.0, RADIUS_M, LENGTH_M, half_bend, theta, segments))
    assert summed.rolling_N_m == pytest.approx(-rate_m, abs=1e-9)


def test_more_segments_roll_harder_towards_the_continuous_muscle() -> None:
    moments = [
        abs(pull_moments(muscle_pulls(1.0, RADIUS_M, LENGTH_M, 0.9, 1.0, count)).rolling_N_m)
        for count in (1, 2, 3, 11, 1000)
    ]
    assert moments == sorted(moments)
    assert moments[-1] == pytest.approx(2.0 * RADIUS_M * 0.9 * math.sin(1.0), rel=1e-6)
    assert moments[0] / moments[-1] == pytest.approx(math.sin(0.9) / 0.9, rel=1e-6)


def test_a_straight_body_is_neither_rolled_nor_turned() -> None:
    summed = pull_moments(muscle_pulls(1.0, RADIUS_M, LENGTH_M, 0.0, 1.0, 11))
    assert (summed.rolling_N_m, summed.rotation_N_m) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"force_N": math.nan}, "force_N must be finite"),
        ({"radius_m": 0.0}, "radius_m must be above zero"),
        ({"length_m": -1.0}, "length_m must be above zero"),
        ({"half_bend_rad": 8.0}, "folds the inner side"),
        ({"theta_rad": math.inf}, "theta_rad must be finite"),
        ({"segments": 0}, "segments must be a whole number"),
        ({"segments": True}, "segments must be a whole number"),
        ({"segments": 2.0}, "segments must be a whole number"),
    ],
)
def test_values_out_of_range_are_refused_by_name(changes: dict[str, float], says: str) -> None:
    right = {"force_N": 1.0, "radius_m": RADIUS_M, "length_m": LENGTH_M, "half_bend_rad": 0.9, "theta_rad": 1.0}
    with pytest.raises(InputError, match=says):
        muscle_pulls(**{**right, "segments": 3, **changes})
    with pytest.raises(InputError, match="strain_difference must be finite"):
        linear_rest_curvature_1_m(Tube(RADIUS_M, 0.001, 2e6), math.nan)
