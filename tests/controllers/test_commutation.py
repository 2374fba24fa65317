"""Commutation: directions, what dead chambers leave, and how far the body can roll."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.commutation import (
    can_roll,
    commanded_direction_rad,
    room_rad,
    shortfall_rad,
    side_angle_rad,
    without,
)
from softbot.rolling import reachable_half_plane

angles = st.floats(-20.0, 20.0)
chambers = st.integers(0, 3)
sides = st.sampled_from([1, -1])


@given(angles, sides, st.floats(-1.5, 1.5))
def test_the_command_leads_the_c_in_the_world(roll, side, lead):
    body = commanded_direction_rad(side, lead, roll)
    assert math.remainder(body + roll - side_angle_rad(side) - lead, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)


@given(angles, chambers)
def test_taking_the_shortfall_off_brings_a_direction_just_inside(direction, dead):
    reachable = reachable_half_plane([dead])
    shortfall = shortfall_rad(direction, without((dead,)))
    assert abs(shortfall) <= math.pi / 2 + 1e-9
    inside = direction - shortfall
    assert shortfall_rad(inside, without((dead,))) == pytest.approx(0.0, abs=1e-9)
    if shortfall == 0.0:
        assert reachable.contains(direction)


def test_nothing_is_short_without_dead_chambers():
    assert shortfall_rad(1.0, without(())) == 0.0
    assert room_rad(1, 0.3, 1, without(())) == math.inf


@given(angles, sides, st.sampled_from([1, -1]), chambers)
def test_the_room_is_what_a_body_rolls_before_its_direction_is_out_of_reach(roll, side, forward, dead):
    room = room_rad(side, roll, forward, without((dead,)))
    here = commanded_direction_rad(side, 0.0, roll)
    if abs(shortfall_rad(here, without((dead,)))) > 1e-6:
        assert room <= 1e-5 or room >= math.pi - 1e-5  # past the stop, or before the beginning
        return
    # rolling forward turns the body's curvature direction by +forward in the body frame
    assert abs(shortfall_rad(here + forward * (room - 1e-6), without((dead,)))) < 1e-5
    assert abs(shortfall_rad(here + forward * (room + 1e-3), without((dead,)))) > 1e-4
    assert -1e-5 <= room <= math.pi + 1e-5


@pytest.mark.parametrize(
    ("dead", "rolls"), [((), True), ((1,), True), ((2, 2), True), ((0, 2), False), ((0, 1), False), ((0, 1, 2), False)]
)
def test_reversal_rolls_on_with_one_dead_chamber_and_no_more(dead, rolls):
    assert can_roll(dead) is rolls
    assert reachable_half_plane(dead).allows_rolling_by_reversal is rolls
