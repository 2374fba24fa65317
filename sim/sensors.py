"""The robot's sensors: chamber pressures, supply pressure, inertial unit at the mid cross-section.

Each reading is truth + bias + white noise; biases are drawn once from the run's seed. Pressure readings are rounded to
the sensor's resolution. The inertial unit's axes are e1, e2, t of the mid cross-section; its accelerometer gives
specific force (at rest: +g upwards), averaged over the sampling period, as such units do.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.body import Motion
from softbot.faults import CHAMBER_COUNT
from softbot.kernel_compiler import kernel
from softbot.plant_conditions import GYRO_OFFSET, IMU_DEAD, IMU_STUCK, PlantConditions, pressure_reading
from softbot.sensing import READINGS, Readings, SensorParameters

FloatArray = NDArray[np.float64]

DRAWS = CHAMBER_COUNT + 1 + 3 + 3
"""Standard normals that a reading takes: chambers, supply, gyro, accelerometer."""

SENSORS = np.dtype(
    [
        ("pressure_noise_Pa", np.float64),
        ("pressure_resolution_Pa", np.float64),
        ("supply_noise_Pa", np.float64),
        ("gyro_noise_rad_s", np.float64),
        ("accelerometer_noise_m_s2", np.float64),
        ("gravity_m_s2", np.float64, 3),
        ("pressure_bias_Pa", np.float64, CHAMBER_COUNT),
        ("gyro_bias_rad_s", np.float64, 3),
        ("accelerometer_bias_m_s2", np.float64, 3),
        ("last_pressure_Pa", np.float64, CHAMBER_COUNT),
        ("last_velocity_m_s", np.float64, 3),
        ("last_gyro_rad_s", np.float64, 3),
        ("last_accelerometer_m_s2", np.float64, 3),
        ("last_t_s", np.float64),
    ],
    align=True,
)
"""What the sensors of a run are like and remember, as a record for compiled code."""


@kernel(nogil=True)
def read_sensors(
    memory: Any,
    t_s: float,
    rotation: FloatArray,
    angular_velocity_rad_s: FloatArray,
    velocity_m_s: FloatArray,
    pressure_Pa: FloatArray,
    opening: FloatArray,
    conditions: FloatArray,
    draws: FloatArray,
    out: Any,
) -> None:
    """Write a reading into out[0] (READINGS). memory[0]: SENSORS. draws: shape (11,); conditions as of now.

    rotation: columns e1, e2, t; pressure_Pa: four chambers and the manifold, shape (5,).
    """
    own, reading = memory[0], out[0]
    for i in range(CHAMBER_COUNT):
        shown = pressure_reading(
            i,
            pressure_Pa,
            own.pressure_bias_Pa[i],
            draws[i],
            own.pressure_noise_Pa,
            own.last_pressure_Pa[i],
            conditions,
        )
        if own.pressure_resolution_Pa > 0.0:
            shown = np.round(shown / own.pressure_resolution_Pa) * own.pressure_resolution_Pa
        own.last_pressure_Pa[i] = reading.pressure_Pa[i] = shown
        reading.opening[i] = opening[i]
    reading.supply_Pa = pressure_Pa[CHAMBER_COUNT] + own.supply_noise_Pa * draws[CHAMBER_COUNT]
    since_s = t_s - own.last_t_s
    for k in range(3):
        spin = force = 0.0
        for c in range(3):
            spin += rotation[c, k] * angular_velocity_rad_s[c]
            gained = (velocity_m_s[c] - own.last_velocity_m_s[c]) / since_s if since_s > 0.0 else 0.0
            force += rotation[c, k] * (gained - own.gravity_m_s2[c])
        reading.gyro_rad_s[k] = spin + own.gyro_bias_rad_s[k] + own.gyro_noise_rad_s * draws[5 + k]
        reading.accelerometer_m_s2[k] = (
            force + own.accelerometer_bias_m_s2[k] + own.accelerometer_noise_m_s2 * draws[8 + k]
        )
    reading.gyro_rad_s[2] += conditions[GYRO_OFFSET]
    for k in range(3):
        own.last_velocity_m_s[k] = velocity_m_s[k]
        if conditions[IMU_STUCK] > 0.0:
            reading.gyro_rad_s[k] = own.last_gyro_rad_s[k]
            reading.accelerometer_m_s2[k] = own.last_accelerometer_m_s2[k]
        elif conditions[IMU_DEAD] > 0.0:
            reading.gyro_rad_s[k] = reading.accelerometer_m_s2[k] = 0.0
        own.last_gyro_rad_s[k] = reading.gyro_rad_s[k]
        own.last_accelerometer_m_s2[k] = reading.accelerometer_m_s2[k]
    own.last_t_s = t_s
    reading.t_s = t_s


def sensors_memory(
    parameters: SensorParameters, gravity_m_s2: float | FloatArray, seed: int
) -> tuple[Any, np.random.Generator]:
    """Memory of the sensors of a run, shape (1,) of SENSORS with its biases drawn, and the source of its noise.

    gravity_m_s2: its size, downwards, or the vector in world axes, shape (3,).
    """
    random = np.random.default_rng([seed, 0x5E])
    memory = np.zeros(1, SENSORS).view(np.recarray)
    own = memory[0]
    for name in SENSORS.names or ():
        if name.endswith(("noise_Pa", "resolution_Pa", "noise_rad_s", "noise_m_s2")):
            own[name] = getattr(parameters, name)
    own["gravity_m_s2"] = np.broadcast_to(gravity_m_s2, 3) * ([0.0, 0.0, -1.0] if np.ndim(gravity_m_s2) == 0 else 1.0)
    own["pressure_bias_Pa"] = parameters.pressure_bias_Pa * random.standard_normal(CHAMBER_COUNT)
    own["gyro_bias_rad_s"] = parameters.gyro_bias_rad_s * random.standard_normal(3)
    own["accelerometer_bias_m_s2"] = parameters.accelerometer_bias_m_s2 * random.standard_normal(3)
    own["last_t_s"] = math.inf
    return memory, random


class Sensors:
    """The sensors of one run. Same parameters and seed, same readings of the same truth."""

    def __init__(self, parameters: SensorParameters, gravity_m_s2: float | FloatArray, seed: int) -> None:
        self.memory, self.random = sensors_memory(parameters, gravity_m_s2, seed)
        self._reading = np.zeros(1, READINGS).view(np.recarray)

    def read(
        self, t_s: float, motion: Motion, pressure_Pa: FloatArray, opening: FloatArray, conditions: PlantConditions
    ) -> Readings:
        """Readings at time `t_s`; `pressure_Pa` holds the four chambers and the manifold, shape (5,) [Pa gauge]."""
        read_sensors(
            self.memory,
            t_s,
            np.ascontiguousarray(motion.rotation, dtype=np.float64),
            motion.angular_velocity_rad_s,
            motion.mid_velocity_m_s,
            pressure_Pa,
            opening,
            conditions.packed,
            self.random.standard_normal(DRAWS),
            self._reading,
        )
        return Readings.of(self._reading[0])
