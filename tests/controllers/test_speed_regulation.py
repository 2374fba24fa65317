"""The two regulators of the speed, over speeds that are given."""

from __future__ import annotations

import math

import pytest

from controllers.sequencer_parts import sequencer_memory
from controllers.speed_regulation import regulated_lead_rad, regulated_push


def test_the_lead_stays_within_its_bounds_and_does_not_wind_up():
    own = sequencer_memory().own[0]

    def lead_rad(wanted_rad_s: float, measured_rad_s: float) -> float:
        own["speed_rad_s"] = wanted_rad_s
        return regulated_lead_rad(own, 0.8, measured_rad_s, 0.01)

    assert lead_rad(math.nan, 0.0) == 0.8
    for _ in range(1000):
        assert lead_rad(30.0, 0.0) == 0.8  # out of reach
    assert lead_rad(1.0, 2.0) < 0.3  # and at once free again
    own["lead_integral_rad"] = 0.0
    leads = [lead_rad(1.0, 0.9) for _ in range(500)]
    assert leads[-1] > leads[0]


def test_pushes_are_as_strong_as_speed_is_wanting_and_do_not_wind_up():
    own = sequencer_memory().own[0]

    def push(wanted_rad_s: float, measured_rad_s: float) -> float:
        own["speed_rad_s"] = wanted_rad_s
        return regulated_push(own, measured_rad_s, 0.01)

    assert push(math.nan, 9.0) == 1.0
    for _ in range(1000):
        assert push(30.0, 0.0) == 1.0
    assert push(2.0, 2.1) == 0.0  # it coasts
    for _ in range(1000):
        assert push(2.0, 9.0) == pytest.approx(-0.05 * 6.8)
    assert push(2.0, 90.0) == -1.0
    assert push(2.0, 1.0) == pytest.approx(0.25, abs=0.01)
    own["runs_up"] = True
    assert push(2.0, 1.0) == 1.0
    assert push(2.0, 2.1) == 0.0
    assert push(2.0, 1.0) < 0.3  # it has been that fast: no run-up any more
    own["least_rad_s"] = 3.0  # by its stalls
    assert push(2.0, 2.0) == pytest.approx(0.25, abs=0.01)
    own["least_rad_s"] = 0.0
    pushes = [push(2.0, 1.9) for _ in range(500)]
    assert pushes[-1] > pushes[0] > 0.0
