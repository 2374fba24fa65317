"""The robot's sensors: chamber pressures, supply pressure, inertial unit at the mid cross-section.

Each reading is truth + bias + white noise; biases are drawn once from the run's seed. Pressure readings are rounded to
the sensor's resolution. The inertial unit's axes are e1, e2, t of the mid cross-section; its accelerometer gives
specific force (at rest: +g upwards), averaged over the sampling period, as such units do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.body import Motion
from softbot.faults import CHAMBER_COUNT, PlantConditions
from softbot.sensing import Readings, SensorParameters

FloatArray = NDArray[np.float64]


class Sensors:
    """The sensors of one run. Same parameters and seed, same readings of the same truth."""

    def __init__(self, parameters: SensorParameters, gravity_m_s2: float, seed: int) -> None:
        self._parameters, self._gravity_m_s2 = parameters, gravity_m_s2
        self._random = np.random.default_rng([seed, 0x5E])
        draw = self._random.standard_normal
        self._pressure_bias_Pa = parameters.pressure_bias_Pa * draw(CHAMBER_COUNT)
        self._gyro_bias_rad_s = parameters.gyro_bias_rad_s * draw(3)
        self._accelerometer_bias_m_s2 = parameters.accelerometer_bias_m_s2 * draw(3)
        self._last_pressure_Pa = np.zeros(CHAMBER_COUNT)
        self._last_velocity_m_s = np.zeros(3)
        self._last_t_s: float | None = None

    def read(
        self, t_s: float, motion: Motion, pressure_Pa: FloatArray, opening: FloatArray, conditions: PlantConditions
    ) -> Readings:
        """Readings at time `t_s`; `pressure_Pa` holds the four chambers and the manifold, shape (5,) [Pa gauge]."""
        own, draw = self._parameters, self._random.standard_normal
        chamber = pressure_Pa[:CHAMBER_COUNT] + self._pressure_bias_Pa + own.pressure_noise_Pa * draw(CHAMBER_COUNT)
        chamber = conditions.sensor_reading_Pa(chamber, self._last_pressure_Pa)
        if own.pressure_resolution_Pa > 0.0:
            chamber = np.round(chamber / own.pressure_resolution_Pa) * own.pressure_resolution_Pa
        self._last_pressure_Pa = chamber
        acceleration = np.zeros(3)
        if self._last_t_s is not None and t_s > self._last_t_s:
            acceleration = (motion.mid_velocity_m_s - self._last_velocity_m_s) / (t_s - self._last_t_s)
        self._last_t_s, self._last_velocity_m_s = t_s, motion.mid_velocity_m_s
        force = acceleration + np.array([0.0, 0.0, self._gravity_m_s2])
        to_body = motion.rotation.T
        return Readings(
            t_s=t_s,
            pressure_Pa=chamber,
            supply_Pa=float(pressure_Pa[CHAMBER_COUNT] + own.supply_noise_Pa * draw()),
            gyro_rad_s=to_body @ motion.angular_velocity_rad_s + self._gyro_bias_rad_s + own.gyro_noise_rad_s * draw(3),
            accelerometer_m_s2=to_body @ force + self._accelerometer_bias_m_s2 + own.accelerometer_noise_m_s2 * draw(3),
            opening=opening.copy(),
        )
