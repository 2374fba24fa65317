"""The balance of the roll learns a robot's nature, and tells a soft wall and an obstacle from it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.estimation import ESTIMATOR
from controllers.roll_balance import (
    DRY,
    GAIN,
    HELD,
    NOTHING,
    SOFTENED,
    balance_memory,
    observe_balance,
    pause_balance,
)

STEP_S, CURVATURE_1_M, LIMIT_Pa = 0.01, 5.0, 120e3
WORK_Pa = 100e3  # bends to the whole curvature
ANGLES = 0.5 * math.pi * np.arange(4)


@dataclass
class Roll:
    """A C that rolls by the balance's own law, and what is believed of it: gains of 1 where they are 1 + error.

    stops_s: when something stops it and the moment grows; softens_s: when one chamber's gain rises by `rise`.
    """

    rate_rad_s: float = 3.0
    wave: float = 0.2
    errors: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    dry: float = 0.04
    damping_s: float = 0.015
    agility_1_s2: float = 500.0
    seconds: float = 24.0
    softens_s: float = math.inf
    chamber: int = 0
    rise: float = 0.0
    stops_s: float = math.inf
    seed: int = 0

    def estimates(self) -> Any:
        """Records of ESTIMATOR."""
        random = np.random.default_rng(self.seed)
        t_s = STEP_S * np.arange(round(self.seconds / STEP_S))
        stopped = t_s >= self.stops_s
        phase = 4.0 * self.rate_rad_s * t_s
        rate = np.where(stopped, 0.0, self.rate_rad_s * (1.0 + self.wave * np.sin(phase)))
        gained = np.where(stopped, 0.0, 4.0 * self.rate_rad_s**2 * self.wave * np.cos(phase))
        roll = np.concatenate([[0.0], np.cumsum(rate[:-1]) * STEP_S])
        moment = np.sign(self.rate_rad_s) * self.dry + self.damping_s * rate + gained / self.agility_1_s2
        pushes = np.clip((t_s - self.stops_s) / 1.0, 0.0, 1.0) * 0.45 * np.sign(self.rate_rad_s)
        moment = np.where(stopped, pushes, np.clip(moment, -0.45, 0.45))
        direction = -0.5 * np.arcsin(2.0 * moment) - roll
        error = np.tile(np.array(self.errors), (len(t_s), 1))
        error[t_s >= self.softens_s, self.chamber] += self.rise
        along = -np.cos(direction[:, None] - ANGLES)
        share = np.maximum(along, 0.0) / (1.0 + error) + 0.003 * random.standard_normal((len(t_s), 4))
        seen = np.zeros(len(t_s), ESTIMATOR)
        seen["roll_rad"] = roll + 0.003 * random.standard_normal(len(t_s))
        seen["spin_rad_s"] = rate + 0.005 * random.standard_normal(len(t_s))
        seen["felt_Pa"] = WORK_Pa * np.maximum(share, 0.0)
        seen["curvature_1_m"][:, 0] = -CURVATURE_1_M * (share * np.cos(ANGLES)).sum(axis=1)
        seen["curvature_1_m"][:, 1] = -CURVATURE_1_M * (share * np.sin(ANGLES)).sum(axis=1)
        return seen.view(np.recarray)


def watch(estimates: Any, own: Any = None) -> tuple[list[tuple[float, int]], Any]:
    """What is told, with its times, and the balance's record."""
    own = balance_memory()[0] if own is None else own
    told = [(STEP_S * n, observe_balance(own, one, CURVATURE_1_M, LIMIT_Pa, STEP_S)) for n, one in enumerate(estimates)]
    return [(t_s, code) for t_s, code in told if code != NOTHING], own


gains = st.tuples(*[st.floats(-0.2, 0.2)] * 4)
rates = st.one_of(st.floats(-5.0, -1.2), st.floats(1.2, 5.0))


@settings(max_examples=8, deadline=None)
@given(gains, rates, st.floats(0.0, 0.3), st.integers(0, 2**31))
def test_gains_that_are_off_are_learnt_and_no_fault(errors, rate, wave, seed):
    told, own = watch(Roll(rate_rad_s=rate, wave=wave, errors=errors, seed=seed).estimates())
    assert told == []
    off = np.array(errors) - np.mean(errors)
    assert np.abs(own["x"][GAIN:] * WORK_Pa / LIMIT_Pa - off).max() < 0.12


@settings(max_examples=8, deadline=None)
@given(gains, rates, st.integers(0, 3), st.floats(0.45, 0.8), st.integers(0, 2**31))
def test_a_gain_that_rises_is_a_soft_wall_beside_that_chamber(errors, rate, chamber, rise, seed):
    roll = Roll(rate_rad_s=rate, errors=errors, softens_s=12.0, chamber=chamber, rise=rise, seconds=36.0, seed=seed)
    told, own = watch(roll.estimates())
    assert [code for _, code in told] == [SOFTENED]
    assert own["soft_chamber"] == chamber
    assert told[0][0] > 12.0


@settings(max_examples=8, deadline=None)
@given(gains, rates, st.integers(0, 2**31))
def test_a_robot_that_stands_under_a_moment_is_held(errors, rate, seed):
    told, _ = watch(Roll(rate_rad_s=rate, errors=errors, stops_s=10.0, seconds=13.0, seed=seed).estimates())
    assert told[0][1] == HELD
    assert 10.0 < told[0][0] < 12.0  # the moment has come after 1 s


def test_a_robot_that_stands_without_a_moment_is_not_held():
    estimates = Roll(seconds=10.0).estimates()
    estimates["spin_rad_s"] = 0.0
    estimates["roll_rad"] = 0.0
    estimates["curvature_1_m"] = (CURVATURE_1_M, 0.1 * CURVATURE_1_M)
    assert watch(estimates)[0] == []


def test_after_a_hold_the_balance_is_learnt_anew():
    _, own = watch(Roll(stops_s=10.0, seconds=14.0, errors=(0.2, -0.2, 0.0, 0.0)).estimates())
    told, own = watch(Roll(errors=(0.2, -0.2, 0.0, 0.0)).estimates(), own)
    assert told == []
    assert own["x"][GAIN] > own["x"][GAIN + 1] + 0.2


def test_friction_is_learnt_as_resistance():
    little, much = (watch(Roll(dry=dry).estimates())[1]["x"][DRY] for dry in (0.03, 0.12))
    assert much - little == pytest.approx(0.09, abs=0.04)


def test_a_pause_drops_what_is_suspected_and_keeps_what_was_learnt():
    own = watch(Roll(errors=(0.2, 0.0, 0.0, -0.2)).estimates())[1]
    own["held"], own["changed"], own["alarm"] = 11.0, 39.0, True
    before = own["x"].copy()
    pause_balance(own)
    assert (own["held"], own["changed"], bool(own["alarm"])) == (0.0, 0.0, False)
    assert np.array_equal(own["x"], before)
