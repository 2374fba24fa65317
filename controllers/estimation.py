"""Roll, curvature and its direction, estimated from the inertial unit and the pressures alone.

Roll is the right-handed turning of the mid cross-section about its tangent against the vertical (chamber 0 to the left:
0; up: +90°). The gyro's tangential rate is integrated; the accelerometer, whose specific force points up when the robot
moves steadily, corrects the angle and the gyro's bias (a complementary filter with integral action after Mahony),
trusted the less the further its size is from g. The curvature follows from the measured pressures by the actuator law,
through the chambers' memory where the robot has one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controllers.compensation import Compensator
from softbot.actuator import ActuatorLaw
from softbot.errors import SimulationError
from softbot.sensing import Readings

FloatArray = NDArray[np.float64]

STANDARD_GRAVITY_M_S2 = 9.81


@dataclass(frozen=True)
class RollFilterGains:
    """Gains of the complementary filter and of the rate's low-pass."""

    correction_1_s: float = 1.5
    bias_1_s2: float = 0.15
    rate_time_s: float = 0.15


@dataclass(frozen=True)
class Estimate:
    """What the controller believes of the robot."""

    roll_rad: float
    """Unwrapped."""
    roll_rate_rad_s: float
    curvature_1_m: FloatArray
    """Body frame, per reference length, shape (2,) [1/m]."""
    stretch: float

    @property
    def curvature_size_1_m(self) -> float:
        """Size of the curvature [1/m]."""
        return math.hypot(self.curvature_1_m[0], self.curvature_1_m[1])

    @property
    def curvature_direction_rad(self) -> float:
        """Body angle of the inner side of the C [rad]."""
        return math.atan2(self.curvature_1_m[1], self.curvature_1_m[0])

    @property
    def c_bend_side(self) -> int:
        """+1: the C opens to the left, −1: to the right."""
        return 1 if math.cos(self.curvature_direction_rad + self.roll_rad) >= 0.0 else -1


class Estimator:
    """Follows the robot from cycle to cycle. One `update` a cycle."""

    def __init__(
        self, law: ActuatorLaw, gains: RollFilterGains | None = None, compensator: Compensator | None = None
    ) -> None:
        self._law, self._gains = law, gains or RollFilterGains()
        self._compensator = compensator or Compensator(law)
        self._roll_rad, self._rate_rad_s, self._bias_rad_s = 0.0, 0.0, 0.0
        self._last_t_s: float | None = None
        self._last_curvature: FloatArray = np.zeros(2)
        self._last_stretch = 1.0

    def update(self, readings: Readings, dead: Sequence[int] = ()) -> Estimate:
        """The estimate after these readings. Readings that are not finite are skipped over.

        Chambers known to be `dead` are taken as vented, whatever their sensors say.
        """
        force, spin = readings.accelerometer_m_s2, float(readings.gyro_rad_s[2])
        up_rad = math.atan2(force[0], force[1])
        if not (math.isfinite(spin) and math.isfinite(up_rad)):
            spin, up_rad, trust = self._rate_rad_s + self._bias_rad_s, self._roll_rad, 0.0
        else:
            size = math.hypot(force[0], force[1])
            trust = math.exp(-(((size / STANDARD_GRAVITY_M_S2 - 1.0) / 0.25) ** 2))
        step_s = 0.0 if self._last_t_s is None else max(readings.t_s - self._last_t_s, 0.0)
        if self._last_t_s is None:
            self._roll_rad = up_rad
        else:
            self._follow(step_s, spin, up_rad, trust)
        self._last_t_s = readings.t_s
        self._bend(readings.pressure_Pa, dead, step_s)
        return Estimate(self._roll_rad, self._rate_rad_s, self._last_curvature, self._last_stretch)

    def _follow(self, step_s: float, spin_rad_s: float, up_rad: float, trust: float) -> None:
        gains = self._gains
        rate = spin_rad_s - self._bias_rad_s
        self._roll_rad += step_s * rate
        error = trust * math.remainder(up_rad - self._roll_rad, 2.0 * math.pi)
        self._roll_rad += step_s * gains.correction_1_s * error
        self._bias_rad_s -= step_s * gains.bias_1_s2 * error
        self._rate_rad_s += (rate - self._rate_rad_s) * min(1.0, step_s / gains.rate_time_s)

    def _bend(self, pressure_Pa: FloatArray, dead: Sequence[int], step_s: float) -> None:
        if not np.isfinite(pressure_Pa).all():
            return
        living = np.maximum(pressure_Pa, 0.0)
        living[list(dead)] = 0.0
        try:
            bent = self._law.equilibrium(self._compensator.observe(living, step_s))
        except SimulationError:
            return  # a reading that no section could carry: keep what was believed before
        self._last_curvature, self._last_stretch = bent.curvature_1_m, bent.stretch
