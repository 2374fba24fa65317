"""What is left when rolling as ordered proves impossible, and why it is the same both ways."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.commutation import TURN_RAD, without
from controllers.offer import pushed_rad
from controllers.recovery import RECOVERY
from softbot.rolling import reachable_half_plane

LEFT, RIGHT = 1, -1
EITHER = 0
DEAD = [set(some) for count in range(5) for some in itertools.combinations(range(4), count)]
ROLLS_RAD = np.arange(0.0, TURN_RAD, math.radians(1.0))
angles = st.floats(-20.0, 20.0)
strengths = st.lists(st.sampled_from([0.0, 0.3, 0.7, 1.0]), min_size=4, max_size=4).map(np.array)


def pushed(towards: int, roll_rad: float, strength: Any, only_side: int = EITHER) -> float:
    return pushed_rad(np.zeros(1, RECOVERY).view(np.recarray)[0], towards, only_side, roll_rad, strength)


@pytest.mark.parametrize("towards", [LEFT, RIGHT])
@pytest.mark.parametrize("dead", DEAD, ids=str)
def test_it_is_pushed_for_ever_where_and_only_where_the_reachable_directions_allow_rolling(dead, towards):
    for_ever = [pushed(towards, roll_rad, without(tuple(dead))) == TURN_RAD for roll_rad in ROLLS_RAD[::15]]
    assert all(for_ever) if reachable_half_plane(dead).allows_rolling_by_reversal else not any(for_ever)


@settings(deadline=None, max_examples=60)
@given(strength=strengths)
def test_what_cannot_be_rolled_one_way_cannot_be_rolled_the_other(strength):
    gaps = [sum(pushed(towards, roll_rad, strength) == 0.0 for roll_rad in ROLLS_RAD) for towards in (LEFT, RIGHT)]
    assert gaps[0] == pytest.approx(gaps[1], abs=8)  # of 360; the plan's leads are a grid
    assert (gaps[0] == 0) == (gaps[1] == 0)


@settings(deadline=None, max_examples=100)
@given(roll=angles, strength=strengths)
def test_to_the_right_it_is_the_mirror_image_of_the_left(roll, strength):
    mirrored = strength[[0, 3, 2, 1]]
    assert pushed(RIGHT, math.pi - roll, mirrored) == pytest.approx(pushed(LEFT, roll, strength), abs=0.041)


@pytest.mark.parametrize("pair", [(1, 3), (0, 2)])
def test_on_the_line_of_two_opposite_chambers_it_is_pushed_level_and_no_further(pair):
    level_rad = math.pi / 2 if pair == (0, 2) else 0.0
    for off_rad in (0.3, 0.8, 1.3):
        assert pushed(LEFT, level_rad + off_rad, without(pair)) == pytest.approx(off_rad, abs=0.03)
        assert pushed(RIGHT, level_rad + off_rad, without(pair)) == 0.0
        assert pushed(RIGHT, level_rad - off_rad, without(pair)) == pytest.approx(off_rad, abs=0.03)
    assert pushed(LEFT, level_rad, without(pair)) == pushed(RIGHT, level_rad, without(pair)) == 0.0


@pytest.mark.parametrize("pair", [(0, 1), (1, 2), (2, 3), (3, 0)])
def test_with_two_adjacent_dead_chambers_it_can_be_rocked_over_three_quarters_of_a_turn(pair):
    middle_rad = math.pi / 2 - reachable_half_plane(pair).centre_rad  # both living chambers push, one each way
    both = [pushed(towards, middle_rad, without(pair)) for towards in (LEFT, RIGHT)]
    assert both[0] == pytest.approx(both[1], abs=0.03)
    assert sum(both) == pytest.approx(1.5 * math.pi, abs=0.25)


def test_a_c_that_cannot_be_straightened_is_pushed_on_its_own_side_alone():
    strength = without((2,))
    for side in (1, -1):
        for towards in (LEFT, RIGHT):
            assert pushed(towards, 0.5, strength, side) < 1.5 * math.pi  # half a turn to lie level over, and a lead
    assert pushed(LEFT, 0.5, strength) == TURN_RAD
