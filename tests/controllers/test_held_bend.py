"""Chambers that cannot be vented: what they hold is bent around, so the robot rolls on with it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.held_bend import bend_held, beside_held, free_bend, pinned
from controllers.recovery import reach
from controllers.robot_model import robot_model
from softbot.robot import load_robot

ROBOT = load_robot("default")
MODEL = robot_model(ROBOT)
shares = st.floats(0.0, 1.0)


@settings(deadline=None, max_examples=30)
@given(chamber=st.integers(0, 3), pressure_Pa=st.floats(0.0, 100e3))
def test_what_a_pressure_holds_is_the_bend_that_the_law_gives_for_it(chamber, pressure_Pa):
    alone = np.zeros(4)
    alone[chamber] = pressure_Pa
    by_law = float(np.hypot(*ROBOT.actuator_law().equilibrium(alone).curvature_1_m)) / MODEL.curvature_1_m
    assert bend_held(MODEL, chamber, pressure_Pa) == pytest.approx(by_law, abs=0.01)


@settings(deadline=None, max_examples=100)
@given(chamber=st.integers(0, 3), held=shares, direction=st.floats(-4.0, 4.0))
def test_what_is_reached_beside_a_held_chamber_asks_of_no_chamber_more_than_it_has(chamber, held, direction):
    holds, strength = np.zeros(4), np.ones(4)
    holds[chamber] = held
    strength[chamber] = 0.0
    left = strength.copy()
    beside_held(holds, left)
    towards, share = free_bend(holds, direction, reach(direction, left))
    asked = -share * np.array([math.cos(towards), math.sin(towards)])  # chamber i bends towards α_i + π
    each = np.array([asked[0], asked[1], -asked[0], -asked[1]])
    assert (each <= strength + 1e-9).all()


def test_nothing_held_changes_nothing():
    strength = np.array([1.0, 0.3, 0.0, 0.8])
    left = strength.copy()
    beside_held(np.zeros(4), left)
    assert (left == strength).all()
    assert free_bend(np.zeros(4), 0.7, 0.4) == pytest.approx((0.7, 0.4))


@pytest.mark.parametrize(("opposite", "is_pinned"), [(1.0, False), (0.6, False), (0.0, True)])
def test_a_robot_is_pinned_where_the_chamber_opposite_cannot_straighten_it(opposite, is_pinned):
    held, strength = np.array([0.0, 0.7, 0.0, 0.0]), np.array([1.0, 0.0, 1.0, opposite])
    assert pinned(held, strength, 0.2) is is_pinned


@pytest.mark.parametrize("at_s", [4.0, 4.4, 4.8])
@pytest.mark.parametrize("kind", ["stuck_closed", "blocked_exhaust"])
def test_a_robot_rolls_on_with_a_chamber_that_holds_its_pressure(inject_fault, kind, at_s):
    run = inject_fault(kind, chamber=1, severity=0.99, at_s=at_s, settings=["solver.duration_s=12"])
    assert run.final_state in ("degraded", "reversing")
    assert run.speed_kept > 0.9
    assert run.highest_pressure_share < 0.8


def test_a_robot_that_is_pinned_stops_safely(inject_fault):
    rupture = {"t_s": 9.0, "kind": "rupture", "chamber": 3}
    run = inject_fault("stuck_closed", chamber=1, at_s=6.0, more=[rupture], settings=["solver.duration_s=14"])
    assert run.final_state == "safe"
