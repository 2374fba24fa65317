"""Curvature reversal: when it begins, what it commands, when it is over."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.commutation import shortfall_rad
from controllers.estimation import Estimate
from controllers.recovery import ReversalPlanner, ReversalTuning


def estimate(roll_rad=0.0, rate_rad_s=0.0, direction_rad=0.0, size_1_m=5.0) -> Estimate:
    curvature = size_1_m * np.array([math.cos(direction_rad), math.sin(direction_rad)])
    return Estimate(roll_rad, rate_rad_s, curvature, 1.1)


@pytest.mark.parametrize("forward", [1, -1])
def test_it_is_due_where_the_dead_chamber_is_needed_and_not_before(forward):
    planner = ReversalPlanner()
    fast = -forward * 3.0
    # chamber 0 dead: directions within π/2 of its own are left; on side +1 the body direction is −roll
    assert not planner.due(estimate(roll_rad=0.0, rate_rad_s=fast), 1, forward, (0,))
    near = -forward * (math.pi / 2 - 0.05)
    assert planner.due(estimate(roll_rad=near, rate_rad_s=fast), 1, forward, (0,))
    assert not planner.due(estimate(roll_rad=near, rate_rad_s=fast), 1, -forward, (0,))


def test_a_robot_that_stands_still_shortly_before_the_stop_need_not_wait():
    planner = ReversalPlanner()
    short = -(math.pi / 2 - 0.4)
    assert planner.due(estimate(roll_rad=short, rate_rad_s=0.0), 1, 1, (0,))
    assert not planner.due(estimate(roll_rad=short, rate_rad_s=-2.0), 1, 1, (0,))
    assert not planner.due(estimate(roll_rad=0.0, rate_rad_s=0.0), 1, 1, (0,))


@pytest.mark.parametrize("bent_to_rad", [math.pi / 2, math.pi / 2 - 0.2, -math.pi / 2 + 0.1])
def test_it_goes_through_straight_to_the_opposite_that_can_be_had(bent_to_rad):
    planner = ReversalPlanner()
    reversal = planner.begin(1.0, estimate(direction_rad=bent_to_rad), 1, (0,))
    assert reversal.side == -1
    assert shortfall_rad(reversal.direction_rad, (0,)) == pytest.approx(0.0, abs=1e-9)
    off = math.remainder(reversal.direction_rad - bent_to_rad - math.pi, 2 * math.pi)
    assert abs(off) <= 0.25  # the exact opposite, or the edge of the half plane beside it


def test_it_is_over_when_the_c_has_flipped():
    planner = ReversalPlanner()
    planner.begin(0.0, estimate(direction_rad=math.pi / 2), 1, (0,))
    assert not planner.over(0.1, estimate(direction_rad=math.pi / 2, size_1_m=2.0), 5.0)
    assert not planner.over(0.2, estimate(direction_rad=-math.pi / 2, size_1_m=1.0), 5.0)
    assert planner.over(0.3, estimate(direction_rad=-math.pi / 2, size_1_m=4.0), 5.0)
    assert planner.reversal is None


def test_it_does_not_wait_for_ever():
    planner = ReversalPlanner(ReversalTuning(longest_s=1.0))
    planner.begin(0.0, estimate(direction_rad=math.pi / 2), 1, (0,))
    assert not planner.over(0.9, estimate(direction_rad=math.pi / 2), 5.0)
    assert planner.over(1.1, estimate(direction_rad=math.pi / 2), 5.0)
