"""Roll, C-plane and sides of made-up motions: signs, unwrapping, and what is undefined."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim import motion_rows, trajectory
from sim.body import Motion
from sim.trajectory import Posture, Postures, Trajectory, motion_row, wrapped

LENGTH_m = 0.15
angles = st.floats(-math.pi, math.pi)


def about(axis: np.ndarray, angle_rad: float) -> np.ndarray:
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle_rad) * cross + (1.0 - math.cos(angle_rad)) * cross @ cross


def motion(
    heading_rad: float = 0.0,
    roll_rad: float = 0.0,
    bend_direction_rad: float = 0.0,
    curvature_1_m: float = 10.0,
    turned: np.ndarray | None = None,
    stretch: float = 1.0,
) -> Motion:
    """A level robot: tangent in `heading`, e1 turned by `roll` from its left about the tangent; then all `turned`."""
    tangent = np.array([math.cos(heading_rad), math.sin(heading_rad), 0.0])
    left = np.array([-tangent[1], tangent[0], 0.0])
    e1 = about(tangent, roll_rad) @ left
    rotation = np.column_stack([e1, np.cross(tangent, e1), tangent])
    chord = tangent
    if turned is not None:
        rotation, chord = turned @ rotation, turned @ chord
    zero = np.zeros(3)
    curvature = curvature_1_m * np.array([math.cos(bend_direction_rad), math.sin(bend_direction_rad)])
    return Motion(rotation, zero, zero, zero, stretch, curvature, chord, zero)


def last(motions: list[Motion], *, grounded: bool = True) -> Posture:
    trajectory = Trajectory(LENGTH_m, grounded=grounded)
    return [trajectory.follow(one) for one in motions][-1]


@given(heading=angles, roll=st.floats(-3.1, 3.1))
def test_roll_is_right_handed_about_the_tangent_from_chamber_0_to_the_left(heading: float, roll: float) -> None:
    assert last([motion(heading, roll)]).roll_rad == pytest.approx(roll, abs=1e-9)


@given(heading=angles, turns=st.floats(-4.0, 4.0), yaw=st.floats(-1.0, 1.0))
def test_roll_counts_whole_turns_with_their_sign_whatever_the_heading_does(
    heading: float, turns: float, yaw: float
) -> None:
    rolls = np.linspace(0.0, 2.0 * math.pi * turns, 60)
    path = [motion(heading + yaw * n / 60, roll) for n, roll in enumerate(rolls)]
    assert last(path).roll_rad == pytest.approx(rolls[-1], abs=1e-8)


@given(pitch=st.floats(-1.2, 1.2), roll=st.floats(-3.0, 3.0))
def test_roll_of_a_pitched_robot_is_against_the_vertical_plane_of_its_tangent(pitch: float, roll: float) -> None:
    pitched = about(np.array([0.0, 1.0, 0.0]), pitch)  # about the left of a robot that faces along x
    assert last([motion(0.0, roll, turned=pitched)]).roll_rad == pytest.approx(roll, abs=1e-9)


def test_upright_robot_still_has_a_posture() -> None:
    upright = about(np.array([0.0, 1.0, 0.0]), -0.5 * math.pi)
    posture = last([motion(turned=upright)])
    assert math.isfinite(posture.roll_rad)
    assert posture.bend_rad == pytest.approx(1.5)


@given(turns=st.floats(-3.0, 3.0))
def test_floating_robot_rolls_against_its_bend_direction(turns: float) -> None:
    path = [motion(bend_direction_rad=angle) for angle in np.linspace(0.0, 2.0 * math.pi * turns, 50)]
    assert last(path, grounded=False).roll_rad == pytest.approx(-2.0 * math.pi * turns, abs=1e-9)


def test_floating_roll_starts_at_zero_and_waits_for_a_bend() -> None:
    path = [motion(bend_direction_rad=2.0, curvature_1_m=0.0), motion(bend_direction_rad=1.0)]
    assert last(path, grounded=False).roll_rad == 0.0


@given(turns=st.floats(-2.0, 2.0), heading=angles)
def test_plane_of_the_c_turns_right_handedly_about_the_chord_from_first_end_to_last(
    turns: float, heading: float
) -> None:
    chord = np.array([math.cos(heading), math.sin(heading), 0.0])
    path = [motion(heading, turned=about(chord, angle)) for angle in np.linspace(0.0, 2.0 * math.pi * turns, 40)]
    for grounded in (True, False):
        assert last(path, grounded=grounded).plane_rotation_rad == pytest.approx(2.0 * math.pi * turns, abs=1e-8)


def test_rolling_in_place_leaves_the_plane_of_the_c_where_it_is() -> None:
    path = [motion(roll_rad=angle, bend_direction_rad=-angle) for angle in np.linspace(0.0, 9.0, 60)]
    posture = last(path)
    assert posture.roll_rad == pytest.approx(9.0)
    assert posture.plane_rotation_rad == pytest.approx(0.0, abs=1e-9)


@given(heading=angles, roll=angles)
def test_side_of_the_c_is_that_of_one_who_faces_along_the_tangent(heading: float, roll: float) -> None:
    left = last([motion(heading, roll, bend_direction_rad=-roll + 0.2)])
    right = last([motion(heading, roll, bend_direction_rad=-roll + math.pi - 0.2)])
    assert (left.c_bend_side, right.c_bend_side) == (1, -1)


def test_straight_robot_has_no_side_and_no_plane() -> None:
    spun = [motion(curvature_1_m=0.0, turned=about(np.array([1.0, 0.0, 0.0]), angle)) for angle in (0.0, 1.0, 2.0)]
    posture = last(spun)
    assert (posture.c_bend_side, posture.plane_rotation_rad, posture.bend_rad) == (0, 0.0, 0.0)


def test_bend_and_length_are_those_of_the_reference_length() -> None:
    posture = last([motion(bend_direction_rad=-2.0, curvature_1_m=8.0, stretch=1.2)])
    assert posture.bend_rad == pytest.approx(8.0 * LENGTH_m)
    assert posture.bend_direction_rad == pytest.approx(-2.0)
    assert posture.length_m == pytest.approx(1.2 * LENGTH_m)


def tumbling(seed: int, samples: int) -> list[Motion]:
    """A robot that turns, bends, straightens and pitches at random, a little from sample to sample."""
    drawn = np.random.default_rng(seed)
    angles = np.cumsum(drawn.normal(0.0, 0.4, (samples, 4)), axis=0)
    bends_1_m = np.where(drawn.random(samples) < 0.2, 0.0, 15.0 * drawn.random(samples))
    stretches = drawn.uniform(0.8, 1.3, samples)
    return [
        motion(a, b, c, bend, about(np.array([0.3, 1.0, 0.2]), d), stretch)
        for (a, b, c, d), bend, stretch in zip(angles, bends_1_m, stretches, strict=True)
    ]


@given(seed=st.integers(0, 10_000), cuts=st.sets(st.integers(1, 29), max_size=5), grounded=st.booleans())
def test_rows_in_blocks_are_followed_exactly_as_one_by_one(seed: int, cuts: set[int], grounded: bool) -> None:
    motions = tumbling(seed, 30)
    alone, together = (Trajectory(LENGTH_m, grounded=grounded) for _ in range(2))
    one_by_one = [alone.follow(one) for one in motions]
    rows = np.array([motion_row(one) for one in motions])
    blocks = [together.follow_rows(block) for block in np.split(rows, sorted(cuts))]
    for name in Postures._fields:
        columns = np.concatenate([getattr(block, name) for block in blocks])
        np.testing.assert_array_equal(columns, [getattr(posture, name) for posture in one_by_one])


@pytest.mark.parametrize("grounded", [True, False])
def test_compiled_and_interpreted_loops_agree(interpreted: Callable[..., None], grounded: bool) -> None:
    rows = np.array([motion_row(one) for one in tumbling(3, 200)])
    compiled = Trajectory(LENGTH_m, grounded=grounded).follow_rows(rows)
    interpreted(trajectory)
    plain = Trajectory(LENGTH_m, grounded=grounded).follow_rows(rows)
    np.testing.assert_allclose(np.array(plain), np.array(compiled), atol=1e-12)


def test_a_row_holds_the_motion_and_nan_for_what_it_does_not_tell() -> None:
    row = motion_row(motion(0.3, roll_rad=0.2, stretch=1.2), 0.5)
    assert (row[motion_rows.TIME], row[motion_rows.STRETCH]) == (0.5, 1.2)
    np.testing.assert_array_equal(row[motion_rows.ROTATION].reshape(3, 3), motion(0.3, roll_rad=0.2).rotation)
    assert np.isnan(row[[motion_rows.ENERGY, motion_rows.WORK, motion_rows.ASLEEP]]).all()


@given(angle=st.floats(-100.0, 100.0))
def test_wrapped_is_the_same_angle_within_one_turn(angle: float) -> None:
    same = wrapped(angle)
    assert -math.pi < same <= math.pi
    assert math.cos(same - angle) == pytest.approx(1.0, abs=1e-12)


def test_wrapped_keeps_pi() -> None:
    assert wrapped(math.pi) == math.pi
    assert wrapped(-math.pi) == math.pi
    np.testing.assert_array_equal(wrapped(np.array([-math.pi, 0.5])), [math.pi, wrapped(0.5)])
