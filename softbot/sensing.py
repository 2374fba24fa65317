"""The robot's sensors: what they are like (noise, resolution, bias) and what they say (readings)."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
import pydantic
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

LEAST_READING_Pa = -6e3
"""Gauge pressure below which no sound sensor of a chamber in air reads."""


@dataclass(frozen=True)
class SensorParameters:
    """Chamber and supply pressure sensors and the inertial unit at the mid cross-section.

    Noise is the standard deviation of one reading (white), the bias is drawn once a run, both Gaussian.
    """

    __pydantic_config__: ClassVar[pydantic.ConfigDict] = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)

    pressure_noise_Pa: float = 500.0
    pressure_resolution_Pa: float = 100.0
    pressure_bias_Pa: float = 300.0
    supply_noise_Pa: float = 1000.0
    gyro_noise_rad_s: float = 0.005
    gyro_bias_rad_s: float = 0.01
    accelerometer_noise_m_s2: float = 0.05
    accelerometer_bias_m_s2: float = 0.05

    def __post_init__(self) -> None:
        for name in (item.name for item in fields(self)):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} must be zero or positive")


READINGS = np.dtype(
    [
        ("t_s", np.float64),
        ("pressure_Pa", np.float64, 4),
        ("supply_Pa", np.float64),
        ("gyro_rad_s", np.float64, 3),
        ("accelerometer_m_s2", np.float64, 3),
        ("opening", np.float64, 4),
        ("main_supply_shut", np.bool_),
    ],
    align=True,
)
"""`Readings` as a record, for compiled code."""


@dataclass(frozen=True)
class Readings:
    """What the robot's sensors say at one instant."""

    t_s: float
    pressure_Pa: FloatArray
    """Chambers, shape (4,) [Pa gauge]."""
    supply_Pa: float
    """Manifold [Pa gauge]."""
    gyro_rad_s: FloatArray
    """Angular velocity in the axes e1, e2, t, shape (3,)."""
    accelerometer_m_s2: FloatArray
    """Specific force in the axes e1, e2, t, shape (3,)."""
    opening: FloatArray
    """Valve openings that the board commanded over the period before, shape (4,), −1 exhaust … +1 supply."""
    main_supply_shut: bool = False
    """Whether the board had shut the main supply over the period before, as far as it told."""

    @classmethod
    def of(cls, record: Any) -> Readings:
        """What a record of READINGS holds, copied."""
        return cls(
            float(record["t_s"]),
            record["pressure_Pa"].copy(),
            float(record["supply_Pa"]),
            record["gyro_rad_s"].copy(),
            record["accelerometer_m_s2"].copy(),
            record["opening"].copy(),
            bool(record["main_supply_shut"]),
        )

    def write(self, record: Any) -> None:
        """Copy into a record of READINGS."""
        record["t_s"] = self.t_s
        record["pressure_Pa"] = self.pressure_Pa
        record["supply_Pa"] = self.supply_Pa
        record["gyro_rad_s"] = self.gyro_rad_s
        record["accelerometer_m_s2"] = self.accelerometer_m_s2
        record["opening"] = self.opening
        record["main_supply_shut"] = self.main_supply_shut
