"""Sensors: truth plus bias plus noise, rounded; stuck and offset ones; gravity in the accelerometer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.body import Motion
from sim.sensors import Sensors
from softbot.faults import Fault, FaultKind, SENSOR_OFFSET_Pa
from softbot.plant_conditions import PlantConditions
from softbot.sensing import Readings, SensorParameters

IDEAL = SensorParameters(*[0.0] * 8)
TRUE_Pa = np.array([10e3, 20e3, 30e3, 40e3, 250e3])
OPENING = np.array([0.1, -0.2, 0.0, 1.0])
HEALTHY = PlantConditions()


def at_rest(rotation: np.ndarray | None = None) -> Motion:
    zero = np.zeros(3)
    return Motion(np.eye(3) if rotation is None else rotation, zero, zero, zero, 1.0, np.zeros(2), zero, zero)


def some_rotation(seed: int) -> np.ndarray:
    matrix, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return matrix * np.sign(np.linalg.det(matrix))


def many(parameters: SensorParameters, seed: int, count: int = 4000) -> list[Readings]:
    sensors = Sensors(parameters, 9.81, seed)
    return [sensors.read(0.01 * n, at_rest(), TRUE_Pa, OPENING, HEALTHY) for n in range(count)]


def test_ideal_sensors_tell_the_truth() -> None:
    spin = np.array([0.3, -0.2, 0.1])
    reading = Sensors(IDEAL, 9.81, 0).read(
        0.5, replace(at_rest(), angular_velocity_rad_s=spin), TRUE_Pa, OPENING, HEALTHY
    )
    assert reading.t_s == 0.5
    np.testing.assert_array_equal(reading.pressure_Pa, TRUE_Pa[:4])
    assert reading.supply_Pa == TRUE_Pa[4]
    np.testing.assert_array_equal(reading.gyro_rad_s, spin)
    np.testing.assert_array_equal(reading.opening, OPENING)
    assert reading.opening is not OPENING  # the valves move on, the reading does not


@given(seed=st.integers(0, 10**6))
def test_accelerometer_at_rest_reads_g_upwards_in_the_axes_of_the_body(seed: int) -> None:
    rotation = some_rotation(seed)
    reading = Sensors(IDEAL, 9.81, 0).read(0.0, at_rest(rotation), TRUE_Pa, OPENING, HEALTHY)
    np.testing.assert_allclose(rotation @ reading.accelerometer_m_s2, [0.0, 0.0, 9.81], atol=1e-12)


@given(seed=st.integers(0, 10**6))
def test_gyro_and_acceleration_are_in_the_axes_of_the_body(seed: int) -> None:
    rotation = some_rotation(seed)
    sensors = Sensors(IDEAL, 0.0, 0)
    spin, velocity = np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.0, -0.2])
    sensors.read(0.0, at_rest(rotation), TRUE_Pa, OPENING, HEALTHY)
    moving = replace(at_rest(rotation), angular_velocity_rad_s=spin, mid_velocity_m_s=velocity)
    reading = sensors.read(0.01, moving, TRUE_Pa, OPENING, HEALTHY)
    np.testing.assert_allclose(rotation @ reading.gyro_rad_s, spin, atol=1e-12)
    np.testing.assert_allclose(rotation @ reading.accelerometer_m_s2, velocity / 0.01, atol=1e-9)
    again = sensors.read(0.02, moving, TRUE_Pa, OPENING, HEALTHY)  # it goes on at that speed
    np.testing.assert_allclose(again.accelerometer_m_s2, 0.0, atol=1e-12)


def test_noise_has_the_stated_deviation_and_no_mean() -> None:
    stated = replace(
        IDEAL, pressure_noise_Pa=500.0, supply_noise_Pa=1000.0, gyro_noise_rad_s=0.005, accelerometer_noise_m_s2=0.05
    )
    readings = many(stated, seed=7)
    samples = {
        500.0: np.array([r.pressure_Pa - TRUE_Pa[:4] for r in readings]),
        1000.0: np.array([[r.supply_Pa - TRUE_Pa[4]] for r in readings]),
        0.005: np.array([r.gyro_rad_s for r in readings]),
        0.05: np.array([r.accelerometer_m_s2 - [0, 0, 9.81] for r in readings]),
    }
    for deviation, sample in samples.items():
        np.testing.assert_allclose(sample.std(axis=0), deviation, rtol=0.05)  # 4000 samples: 1.1 % is one sigma
        np.testing.assert_allclose(sample.mean(axis=0), 0.0, atol=4.0 * deviation / np.sqrt(len(sample)))
        one, next_one = sample[:-1, 0], sample[1:, 0]
        assert abs(np.corrcoef(one, next_one)[0, 1]) < 0.06  # white
    pair = samples[500.0]
    assert abs(np.corrcoef(pair[:, 0], pair[:, 1])[0, 1]) < 0.06  # each sensor its own


def test_bias_is_drawn_once_a_run_with_the_stated_deviation() -> None:
    stated = replace(IDEAL, pressure_bias_Pa=300.0, gyro_bias_rad_s=0.01, accelerometer_bias_m_s2=0.05)
    runs = [many(stated, seed, count=3) for seed in range(400)]
    for readings in runs:
        np.testing.assert_array_equal(readings[0].pressure_Pa, readings[2].pressure_Pa)
        np.testing.assert_array_equal(readings[0].gyro_rad_s, readings[2].gyro_rad_s)
    assert np.std([r[0].pressure_Pa - TRUE_Pa[:4] for r in runs]) == pytest.approx(300.0, rel=0.08)
    assert np.std([r[0].gyro_rad_s for r in runs]) == pytest.approx(0.01, rel=0.08)
    assert np.std([r[0].accelerometer_m_s2 - [0, 0, 9.81] for r in runs]) == pytest.approx(0.05, rel=0.08)


def test_pressure_readings_are_multiples_of_the_resolution_near_the_truth() -> None:
    sensors = Sensors(replace(IDEAL, pressure_resolution_Pa=250.0), 9.81, 0)
    for true in np.linspace(0.0, 3e3, 31):
        shown = sensors.read(0.0, at_rest(), np.full(5, true), OPENING, HEALTHY).pressure_Pa
        np.testing.assert_allclose(shown / 250.0, np.round(shown / 250.0))
        assert np.all(np.abs(shown - true) <= 125.0)


def test_same_seed_same_readings_another_seed_others() -> None:
    def first(seed: int) -> np.ndarray:
        reading = many(SensorParameters(), seed, count=1)[0]
        return np.concatenate([reading.pressure_Pa, reading.gyro_rad_s, reading.accelerometer_m_s2])

    np.testing.assert_array_equal(first(3), first(3))
    assert np.all(first(3)[4:] != first(4)[4:])


def test_stuck_sensor_repeats_its_last_reading_and_an_offset_one_reads_high() -> None:
    conditions = PlantConditions(
        [Fault(1.0, 1, FaultKind.SENSOR_STUCK), Fault(1.0, 2, FaultKind.SENSOR_OFFSET, severity=0.5)]
    )
    sensors = Sensors(IDEAL, 9.81, 0)
    sensors.read(0.5, at_rest(), TRUE_Pa, OPENING, conditions)
    conditions.advance(1.0)
    for n in range(3):
        shown = sensors.read(1.0 + n, at_rest(), TRUE_Pa + 7e3 * (n + 1), OPENING, conditions).pressure_Pa
        assert shown[1] == TRUE_Pa[1]
        assert shown[2] == TRUE_Pa[2] + 7e3 * (n + 1) + 0.5 * SENSOR_OFFSET_Pa
        assert shown[0] == TRUE_Pa[0] + 7e3 * (n + 1)
