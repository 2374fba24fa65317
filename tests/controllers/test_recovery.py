"""Recovery as it is planned: what can be reached, on which side the most moment lies, and how the C is reversed."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from controllers.commutation import side_angle_rad, without
from controllers.recovery import RECOVERY, RecoveryTuning, best_on_side, plan_roll, reach
from softbot.rolling import reachable_half_plane

TUNING = RecoveryTuning()
WEAK_AND_NOT = [(0.0, 0.0, 0.0), (0.7, 0.0, 0.12), (0.7, 0.1, 0.0), (0.95, 0.0, 0.0)]
LAG_S, AGILITY_1_S2 = 0.15, 500.0
angles = st.floats(-20.0, 20.0)
sides = st.sampled_from([1, -1])
strengths = st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4).map(np.array)


def fresh() -> Any:
    return np.zeros(2, RECOVERY).view(np.recarray)


class Rolling:
    """A plan for a robot whose roll is given, and whose curvature follows at once: `cycle` plans once."""

    def __init__(self, strength: Any, side: int = 1, forward: int = 1, lead_rad: float = 0.5) -> None:
        self.strength, self.side, self.forward, self.lead_rad = strength, side, forward, lead_rad
        self.plans, self.t_s, self.held = fresh(), 0.0, np.zeros(4)
        self.plans[0]["direction_rad"] = math.nan

    def cycle(self, roll_rad: float, rate_rad_s: float = 0.0, bent_rad: float | None = None, size: float = 1.0) -> Any:
        direction = self.plans[0]["direction_rad"] if bent_rad is None else bent_rad
        bent = size * np.array([math.cos(direction), math.sin(direction)])
        self.side = plan_roll(
            TUNING,
            self.plans[0],
            self.plans[1],
            self.side,
            self.forward,
            self.lead_rad,
            roll_rad,
            rate_rad_s,
            bent,
            self.strength,
            self.held,
            self.t_s,
            LAG_S,
            AGILITY_1_S2,
        )
        self.t_s += 0.01
        return self.plans[0]


@settings(deadline=None, max_examples=100)
@given(direction=angles, strength=strengths)
def test_what_is_reached_is_within_what_each_chamber_can_do(direction, strength):
    most = reach(direction, strength)
    assert 0.0 <= most <= 1.0
    x, y = most * math.cos(direction), most * math.sin(direction)
    assert -strength[0] - 1e-9 <= x <= strength[2] + 1e-9
    assert -strength[1] - 1e-9 <= y <= strength[3] + 1e-9
    if most < 1.0 - 1e-9:  # and no more would be
        x, y = 1.001 * x + 1e-6 * math.cos(direction), 1.001 * y + 1e-6 * math.sin(direction)
        assert not (-strength[0] <= x <= strength[2] and -strength[1] <= y <= strength[3])


@settings(deadline=None, max_examples=100)
@given(direction=angles, dead=st.sets(st.integers(0, 3), max_size=3))
def test_directions_that_are_reached_are_those_of_the_theory(direction, dead):
    reachable = reachable_half_plane(dead)
    reached = reach(direction, without(tuple(dead)))
    if reached > 1e-6:
        assert reachable.contains(direction, 1e-5)
    elif reachable.kind != "line":
        assert not reachable.contains(direction, -1e-5)


@settings(deadline=None, max_examples=100)
@given(roll=angles, side=sides, forward=sides, lead=st.floats(0.05, 1.5), strength=strengths)
def test_the_best_of_a_side_is_no_less_than_any_lead_tried(roll, side, forward, lead, strength):
    plan = fresh()[0]
    most = best_on_side(plan, side, forward, lead, roll, strength)
    assert most >= 0.0
    for share in (0.125, 0.5, 1.0):
        tried = share * min(lead, math.pi / 4)
        reached = reach(side_angle_rad(side) + forward * tried - roll, strength)
        assert most >= 0.5 * reached**2 * math.sin(2.0 * tried) - 2e-3


@pytest.mark.parametrize("forward", [1, -1])
@pytest.mark.parametrize("chamber", [0, 1, 2, 3])
@pytest.mark.parametrize("lead", [0.2, 0.5, 0.7])
def test_the_curvature_is_reversed_where_the_lead_begins_to_fall_short(chamber, forward, lead):
    rolling = Rolling(without((chamber,)), forward=forward, lead_rad=lead)
    begin_rad = -chamber * math.pi / 2
    for rolled in np.arange(0.0, math.pi / 2, 0.01):
        plan = rolling.cycle(begin_rad - forward * rolled)
        if plan["reversing"]:
            break
    assert rolling.side == -1
    assert math.pi / 2 - lead < rolled < math.pi / 2 - 0.75 * lead
    edge = chamber * math.pi / 2 - forward * math.pi / 2  # straight through: the opposite of the edge that it came to
    assert math.remainder(plan["direction_rad"] - edge, 2 * math.pi) == pytest.approx(0.0, abs=1e-6)
    assert plan["share"] == pytest.approx(1.0)


def test_a_robot_that_rolls_fast_reverses_early_for_the_pressures_follow_late():
    def begins(rate_rad_s: float) -> float:
        rolling = Rolling(without((0,)))
        for rolled in np.arange(0.0, math.pi / 2, 0.01):
            if rolling.cycle(-rolled, -rate_rad_s)["reversing"]:
                return float(rolled)
        raise AssertionError

    assert begins(5.0) == pytest.approx(begins(0.0) - TUNING.ahead * LAG_S * 5.0, abs=0.02)


def test_a_reversal_waits_for_what_would_roll_the_robot_back():
    roll = -math.pi / 2 + 0.2
    lingering = math.pi / 2 - 0.6  # a third chamber still pushes towards where the dead one would be needed
    for rate_rad_s, doubt, begins in ((0.0, 0.0, False), (-8.0, 0.0, True), (-8.0, 1.0, False)):
        rolling = Rolling(without((0,)))
        rolling.plans[0]["doubt"] = doubt
        assert bool(rolling.cycle(roll, rate_rad_s, bent_rad=lingering)["reversing"]) is begins


def test_momentum_is_doubted_after_a_reversal_that_rolled_back():
    roll, doubts = -math.pi / 2 + 0.2, []
    rolling = Rolling(without((0,)))
    for rolled_rad in (0.5, -0.5):
        rolling.side = 1
        rolling.plans[0]["reversing"] = False
        assert rolling.cycle(roll, bent_rad=math.pi / 2)["reversing"]
        rolling.cycle(roll + rolled_rad, bent_rad=-math.pi / 2)
        doubts.append(float(rolling.plans[0]["doubt"]))
    assert doubts[0] > doubts[1] > 0.0


def test_a_reversal_is_held_until_the_c_has_flipped_but_not_for_ever():
    for flips in (True, False):
        rolling = Rolling(without((0,)))
        roll = -math.pi / 2 + 0.2
        assert rolling.cycle(roll, bent_rad=math.pi / 2)["reversing"]
        held = 0
        while rolling.plans[0]["reversing"]:
            held += 1
            size = 1.0 - 0.1 * held if flips else 1.0
            rolling.cycle(roll, bent_rad=math.pi / 2, size=size)
            assert rolling.side == -1 or held > 1000
        assert held <= 11 if flips else held * 0.01 == pytest.approx(TUNING.longest * LAG_S, abs=0.03)


@pytest.mark.parametrize(
    ("strength", "held", "left"), [(0.0, 0.0, 0.0), (0.7, 0.0, 0.12), (0.7, 0.1, 0.0), (0.95, 0.0, 0.0)]
)
def test_with_a_weak_chamber_in_use_the_line_is_left_while_a_little_is_still_on_the_old_side(strength, held, left):
    rolling = Rolling(np.array([1.0, 1.0, strength, 1.0]), side=-1)
    rolling.held[0] = held
    plan, roll_rad = rolling.plans[0], math.pi / 2 + 0.2
    plan["forward"], plan["reversing"] = rolling.forward, True
    plan["line_rad"], plan["began_rad"] = math.pi / 2, roll_rad
    for size in np.arange(0.3, -0.1, -0.01):
        if not rolling.cycle(roll_rad, bent_rad=-math.pi / 2, size=size)["reversing"]:
            break
    assert size == pytest.approx(left, abs=0.011)


@pytest.mark.parametrize("strength", [0.98, 0.92])
def test_a_chamber_that_is_a_little_weak_costs_no_reversal(strength):
    weak = np.array([strength, 1.0, 1.0, 1.0])
    rolling = Rolling(weak, lead_rad=0.8)
    for rolled in np.arange(0.0, 2 * math.pi, 0.02):
        plan = rolling.cycle(-rolled, -2.0)
        assert not plan["reversing"]
        assert plan["moment"] >= 0.5 * strength**2 * math.sin(2.0 * 0.4)


@settings(deadline=None, max_examples=50)
@given(roll=angles, side=sides, forward=sides, weaker=strengths, chamber=st.integers(0, 3))
def test_a_stronger_chamber_never_offers_less(roll, side, forward, weaker, chamber):
    stronger = weaker.copy()
    stronger[chamber] = 1.0
    plan = fresh()[0]
    less = best_on_side(plan, side, forward, 0.8, roll, weaker)
    assert best_on_side(plan, side, forward, 0.8, roll, stronger) >= less - 5e-3


def test_where_neither_side_gives_anything_the_robot_is_straightened():
    pair = without((0, 2))  # chambers 1 and 3 bend along a line
    for side in (1, -1):
        plan = Rolling(pair, side).cycle(math.pi / 2 - 0.3, bent_rad=math.pi / 2)
        assert plan["share"] == 0.0
        assert Rolling(pair, side).cycle(math.pi / 2 + 0.3, bent_rad=math.pi / 2)["share"] == 1.0


@settings(deadline=None, max_examples=60)
@given(
    roll=angles,
    rate=st.floats(-6.0, 6.0),
    side=sides,
    forward=sides,
    lead=st.floats(0.1, 1.5),
    strength=strengths,
    bent=angles,
    size=st.floats(0.0, 1.0),
)
def test_the_plan_for_the_right_is_the_mirror_image_of_that_for_the_left(
    roll, rate, side, forward, lead, strength, bent, size
):
    """Mirrored at the vertical plane of the tangent, and in the body at the axis through chambers 0 and 2."""

    def commanded(rolling, roll_rad, rate_rad_s, bent_rad):
        plan = rolling.cycle(roll_rad, rate_rad_s, bent_rad, size)
        towards = np.array([math.cos(plan["direction_rad"]), math.sin(plan["direction_rad"])])
        return bool(plan["reversing"]), plan["share"] * towards

    # where two plans are worth the same, as with two chambers as strong, either may be taken
    assume(np.unique(strength[strength > 0.0]).size == np.count_nonzero(strength))
    nearby = [commanded(Rolling(strength, side, forward, lead), roll + off, rate, bent)[1] for off in (-1e-4, 1e-4)]
    assume(np.hypot(*(nearby[1] - nearby[0])) < 0.05)
    here, there = Rolling(strength, side, forward, lead), Rolling(strength[[0, 3, 2, 1]], -side, -forward, lead)
    reversing, plan = commanded(here, roll, rate, bent)
    reversing_there, image = commanded(there, math.pi - roll, -rate, -bent)
    assert there.side == -here.side
    assert reversing_there is reversing
    assert image == pytest.approx(plan * [1.0, -1.0], abs=1e-6)


def test_to_roll_the_other_way_ends_a_reversal_without_a_doubt():
    rolling = Rolling(without((0,)))
    roll = -math.pi / 2 + 0.2
    assert rolling.cycle(roll, bent_rad=math.pi / 2)["reversing"]
    rolling.forward = -1
    plan = rolling.cycle(roll - 0.5, bent_rad=math.pi / 2)
    assert plan["doubt"] == 0.0
    rolling.forward = 1
    rolling.cycle(roll + 1.0, bent_rad=-math.pi / 2)
    assert plan["doubt"] == 0.0
