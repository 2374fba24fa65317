"""Curvature reversal: when it begins, what it commands, when it is over."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from controllers.commutation import shortfall_rad, without
from controllers.estimation import estimator_memory
from controllers.recovery import LONGEST_S, REVERSAL, begin_reversal, reversal_due, reversal_over

CHAMBER_0_DEAD = without((0,))


def estimate(roll_rad=0.0, rate_rad_s=0.0, direction_rad=0.0, size_1_m=5.0) -> Any:
    own = estimator_memory()[0]
    own["roll_rad"], own["roll_rate_rad_s"] = roll_rad, rate_rad_s
    own["curvature_1_m"] = size_1_m * np.array([math.cos(direction_rad), math.sin(direction_rad)])
    return own


@pytest.fixture
def reversal() -> Any:
    return np.zeros(1, REVERSAL).view(np.recarray)[0]


@pytest.mark.parametrize("forward", [1, -1])
def test_it_is_due_where_the_dead_chamber_is_needed_and_not_before(forward):
    fast = -forward * 3.0
    # chamber 0 dead: directions within π/2 of its own are left; on side +1 the body direction is −roll
    assert not reversal_due(estimate(roll_rad=0.0, rate_rad_s=fast), 1, forward, CHAMBER_0_DEAD)
    near = -forward * (math.pi / 2 - 0.05)
    assert reversal_due(estimate(roll_rad=near, rate_rad_s=fast), 1, forward, CHAMBER_0_DEAD)
    assert not reversal_due(estimate(roll_rad=near, rate_rad_s=fast), 1, -forward, CHAMBER_0_DEAD)
    assert not reversal_due(estimate(roll_rad=near, rate_rad_s=fast), 1, forward, without(()))


def test_a_robot_that_stands_still_shortly_before_the_stop_need_not_wait():
    short = -(math.pi / 2 - 0.4)
    assert reversal_due(estimate(roll_rad=short, rate_rad_s=0.0), 1, 1, CHAMBER_0_DEAD)
    assert not reversal_due(estimate(roll_rad=short, rate_rad_s=-2.0), 1, 1, CHAMBER_0_DEAD)
    assert not reversal_due(estimate(roll_rad=0.0, rate_rad_s=0.0), 1, 1, CHAMBER_0_DEAD)


@pytest.mark.parametrize("bent_to_rad", [math.pi / 2, math.pi / 2 - 0.2, -math.pi / 2 + 0.1])
def test_it_goes_through_straight_to_the_opposite_that_can_be_had(bent_to_rad, reversal):
    begin_reversal(reversal, 1.0, estimate(direction_rad=bent_to_rad), 1, CHAMBER_0_DEAD)
    assert reversal["side"] == -1
    assert shortfall_rad(reversal["direction_rad"], CHAMBER_0_DEAD) == pytest.approx(0.0, abs=1e-9)
    off = math.remainder(reversal["direction_rad"] - bent_to_rad - math.pi, 2 * math.pi)
    assert abs(off) <= 0.25  # the exact opposite, or the edge of the half plane beside it


def test_it_is_over_when_the_c_has_flipped(reversal):
    begin_reversal(reversal, 0.0, estimate(direction_rad=math.pi / 2), 1, CHAMBER_0_DEAD)
    assert not reversal_over(reversal, 0.1, estimate(direction_rad=math.pi / 2, size_1_m=2.0), 5.0)
    assert not reversal_over(reversal, 0.2, estimate(direction_rad=-math.pi / 2, size_1_m=1.0), 5.0)
    assert reversal_over(reversal, 0.3, estimate(direction_rad=-math.pi / 2, size_1_m=4.0), 5.0)
    assert not reversal["under_way"]


def test_it_does_not_wait_for_ever(reversal):
    begin_reversal(reversal, 0.0, estimate(direction_rad=math.pi / 2), 1, CHAMBER_0_DEAD)
    assert not reversal_over(reversal, 0.9 * LONGEST_S, estimate(direction_rad=math.pi / 2), 5.0)
    assert reversal_over(reversal, 1.1 * LONGEST_S, estimate(direction_rad=math.pi / 2), 5.0)
