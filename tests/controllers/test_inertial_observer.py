"""The gyro's bias is told from what a healthy sensor has, from slip, and from jerky rolling."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.inertial_observer import (
    BIAS,
    FOUND,
    GRIP,
    LEARNT,
    NOTHING,
    ROLL,
    inertial_memory,
    observe_inertial,
    parts_of_inertial,
)
from softbot.sensing import READINGS, SensorParameters

STEP_S, RADIUS_M, G = 0.01, 0.03, 9.81
SENSORS = SensorParameters()
PARTS = parts_of_inertial(SENSORS, RADIUS_M, STEP_S)


@dataclass
class Roll:
    """A tube that rolls with a mean rate and waves four times a revolution, and what its inertial unit says of it.

    grip: share of R ω̇ with which its middle follows; bias_rad_s of the gyro (constant), jump_rad_s from at_s on.
    """

    rate_rad_s: float = 3.0
    wave: float = 0.3
    grip: float = 1.0
    bias_rad_s: float = 0.0
    jump_rad_s: float = 0.0
    at_s: float = 5.0
    seconds: float = 12.0
    seed: int = 0

    def readings(self) -> tuple[Any, Any]:
        """Records of READINGS, and the true roll at each."""
        random = np.random.default_rng(self.seed)
        t_s = STEP_S * np.arange(round(self.seconds / STEP_S))
        phase = 4.0 * self.rate_rad_s * t_s
        rate = self.rate_rad_s * (1.0 + self.wave * np.sin(phase))
        roll = self.rate_rad_s * t_s - 0.25 * self.wave * np.cos(phase)
        gained = np.diff(rate, prepend=rate[0]) / STEP_S
        left = -self.grip * RADIUS_M * gained
        seen = np.zeros(len(t_s), READINGS)
        seen["t_s"] = t_s
        seen["gyro_rad_s"][:, 2] = rate + self.bias_rad_s + self.jump_rad_s * (t_s >= self.at_s)
        seen["gyro_rad_s"] += SENSORS.gyro_noise_rad_s * random.standard_normal((len(t_s), 3))
        lies = SENSORS.accelerometer_bias_m_s2 * random.standard_normal(2)
        seen["accelerometer_m_s2"][:, 0] = G * np.sin(roll) + left * np.cos(roll) + lies[0]
        seen["accelerometer_m_s2"][:, 1] = G * np.cos(roll) - left * np.sin(roll) + lies[1]
        seen["accelerometer_m_s2"] += SENSORS.accelerometer_noise_m_s2 * random.standard_normal((len(t_s), 3))
        return seen.view(np.recarray), roll


def watch(readings: Any, own: Any = None) -> tuple[list[tuple[float, int]], Any]:
    """What is told of these readings, with its times, and the observer's record."""
    own = inertial_memory()[0] if own is None else own
    told = [(float(one["t_s"]), observe_inertial(PARTS, own, one, True, True)) for one in readings]
    return [(t_s, code) for t_s, code in told if code != NOTHING], own


@settings(max_examples=8, deadline=None)
@given(rate=st.floats(-5.0, 5.0), wave=st.floats(0.0, 0.5), bias=st.floats(-0.03, 0.03), seed=st.integers(0, 2**31))
def test_a_bias_that_the_sensor_may_have_is_learnt_and_no_fault(rate, wave, bias, seed):
    readings, roll = Roll(rate_rad_s=rate, wave=wave, bias_rad_s=bias, seed=seed).readings()
    told, own = watch(readings)
    assert told == []
    assert abs(own["x"][BIAS] - bias) < 0.01
    assert abs(math.remainder(own["x"][ROLL] - roll[-1], 2.0 * math.pi)) < 0.03


@settings(max_examples=8, deadline=None)
@given(
    rate=st.floats(-5.0, 5.0),
    wave=st.floats(0.0, 0.5),
    size=st.floats(0.1, 0.5),
    sign=st.sampled_from([-1.0, 1.0]),
    seed=st.integers(0, 2**31),
)
def test_a_bias_beyond_that_is_found_and_learnt(rate, wave, size, sign, seed):
    readings, roll = Roll(rate_rad_s=rate, wave=wave, jump_rad_s=sign * size, seed=seed).readings()
    told, own = watch(readings)
    assert told[0][1] == FOUND
    assert 0.0 < told[0][0] - 5.0 < 0.5 / size + 1.5
    assert all(code == LEARNT for _, code in told[1:])
    assert abs(own["x"][BIAS] - sign * size) < 0.01 + 5.0 * math.sqrt(own["covariance"][BIAS, BIAS])
    assert abs(math.remainder(own["x"][ROLL] - roll[-1], 2.0 * math.pi)) < 0.06


def test_a_bias_that_goes_again_is_learnt_back():
    readings, _ = Roll(jump_rad_s=0.3, seconds=20.0).readings()
    readings["gyro_rad_s"][1200:, 2] -= 0.3
    told, own = watch(readings)
    assert [code for _, code in told] == [FOUND, LEARNT]
    assert abs(own["x"][BIAS]) < 0.02


@pytest.mark.parametrize("grip", [0.2, 0.6, 1.0])
def test_the_grip_is_learnt(grip):
    _, own = watch(Roll(rate_rad_s=4.0, wave=0.5, grip=grip).readings()[0])
    assert abs(own["x"][GRIP] - grip) < 0.1


@pytest.mark.parametrize(("grip", "slips"), [(0.0, True), (0.45, False), (1.0, False)])
def test_the_floor_is_lost_where_the_middle_hardly_follows_and_not_where_it_follows_by_half(grip, slips):
    """On the segment twin a sound robot's filter makes about half of it."""
    readings, _ = Roll(rate_rad_s=4.0, wave=0.5, grip=grip).readings()
    own = inertial_memory()[0]
    lost = [watch(readings[n : n + 1], own)[1]["slips"] for n in range(len(readings))]
    assert any(lost) == slips


@pytest.mark.parametrize(("rate", "wave"), [(1.5, 0.15), (0.4, 0.0), (3.0, 0.3)])
def test_the_filter_stays_sound_over_a_long_roll_and_when_it_is_unsure(rate, wave):
    readings, roll = Roll(rate_rad_s=rate, wave=wave, jump_rad_s=0.05, seconds=60.0).readings()
    _, own = watch(readings)
    assert np.linalg.eigvalsh(own["covariance"]).min() > 0.0
    assert abs(own["x"][BIAS] - 0.05) < 0.02
    assert 0.3 < own["x"][GRIP] < 1.7
    assert abs(math.remainder(own["x"][ROLL] - roll[-1], 2.0 * math.pi)) < 0.03


def test_readings_that_no_robot_gives_leave_a_filter_that_goes_on():
    readings, _ = Roll(seconds=6.0).readings()
    broken = readings[:300].copy()
    random = np.random.default_rng(0)
    broken["accelerometer_m_s2"] = 1e9 * random.standard_normal((300, 3))
    broken["gyro_rad_s"] = 1e9 * random.standard_normal((300, 3))
    own = inertial_memory()[0]
    watch(broken, own)
    own["last_t_s"] = math.nan
    assert all(code != FOUND for _, code in watch(readings, own)[0])
    assert np.isfinite(own["x"]).all()
    assert np.linalg.eigvalsh(own["covariance"]).min() > 0.0


def test_a_knock_is_no_bias():
    readings, _ = Roll().readings()
    readings["accelerometer_m_s2"][600:606, :2] += (9.0, -4.0)
    readings["gyro_rad_s"][600:603, 2] += 2.0
    assert watch(readings)[0] == []


@pytest.mark.parametrize("gap", [3, 40])
def test_readings_that_are_missing_or_no_numbers_are_no_bias(gap):
    readings, _ = Roll(seconds=8.0).readings()
    broken = readings[:500].copy()
    broken["gyro_rad_s"][300:310, 2] = math.nan
    broken["accelerometer_m_s2"][320:330] = math.inf
    told, own = watch(broken)
    assert told == []
    assert watch(readings[500 + gap :], own)[0] == []


def test_weightless_readings_have_no_direction():
    readings, _ = Roll(seconds=3.0).readings()
    readings["accelerometer_m_s2"] = 0.0
    told, own = watch(readings)
    assert told == []
    assert own["seen"] == 0


def test_a_worse_sensor_is_allowed_more():
    worse = parts_of_inertial(replace(SENSORS, gyro_bias_rad_s=0.1), RADIUS_M, STEP_S)
    assert worse.largest_bias_rad_s > 5.0 * PARTS.largest_bias_rad_s
