"""Commutation: which way the curvature is commanded."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.commutation import commanded_direction_rad, side_angle_rad

angles = st.floats(-20.0, 20.0)
sides = st.sampled_from([1, -1])


@given(angles, sides, st.floats(-1.5, 1.5))
def test_the_command_leads_the_c_in_the_world(roll, side, lead):
    body = commanded_direction_rad(side, lead, roll)
    assert math.remainder(body + roll - side_angle_rad(side) - lead, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
