"""Roll, curvature and its direction, estimated from the inertial unit and the pressures alone.

Roll is the right-handed turning of the mid cross-section about its tangent against the vertical (chamber 0 to the left:
0; up: +90°). The gyro's tangential rate is integrated; the accelerometer, whose specific force points up when the robot
moves steadily, corrects the angle and the gyro's bias (a complementary filter with integral action after Mahony),
trusted the less the further its size is from g. The curvature follows from the measured pressures by the actuator law,
through what the chambers remember where the robot has a memory.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.commutation import wrapped
from controllers.robot_model import RobotModel
from softbot.actuator_equilibrium import wall_forces
from softbot.cross_section import CHAMBERS
from softbot.kernel_compiler import kernel, part
from softbot.memory.chain import STATE_MOST, advance
from softbot.sensing import READINGS, Readings

FloatArray = NDArray[np.float64]

STANDARD_GRAVITY_M_S2 = 9.81

CORRECTION_1_S = 1.5
BIAS_1_S2 = 0.15
RATE_TIME_S = 0.15
"""Gains of the complementary filter, and of the low-pass of the rate."""
LONGEST_GAP_S = 0.5
"""Between readings, over which the rate still says how far the robot has rolled."""

_SETTLED = 1e-4  # of the last Newton step, in strain: the next would be its square
_NEWTON_STEPS = 12

ESTIMATOR = np.dtype(
    [
        ("roll_rad", np.float64),
        ("roll_rate_rad_s", np.float64),
        ("spin_rad_s", np.float64),
        ("bias_rad_s", np.float64),
        ("curvature_1_m", np.float64, 2),
        ("stretch", np.float64),
        ("strain", np.float64, 3),
        ("last_t_s", np.float64),
        ("force", np.float64, 3),
        ("stiffness", np.float64, (3, 3)),
        ("load", np.float64, 3),
        ("step", np.float64, 3),
        ("trial", np.float64, 3),
        ("volume_m3", np.float64, 4),
        ("step_s", np.float64),
        ("felt_Pa", np.float64, 4),
        ("chamber_state", np.float64, (4, STATE_MOST)),
        ("chamber_scratch", np.float64, (4, STATE_MOST)),
    ],
    align=True,
)
"""What the estimator believes and remembers, as a record. `roll_rate_rad_s` is smoothed, `spin_rad_s` is not.
`volume_m3`: of the chambers by the law, dead volume not counted; the four before it are scratch. After it: time since
the last reading, pressures that the wall feels, and what the chambers remember, with scratch."""


def estimator_memory() -> Any:
    """Memory of an estimator that has seen nothing, shape (1,) of ESTIMATOR."""
    memory = np.zeros(1, ESTIMATOR).view(np.recarray)
    memory[0]["stretch"] = 1.0
    memory[0]["strain"] = (1.0, 0.0, 0.0)
    memory[0]["last_t_s"] = math.nan
    return memory


@part()
def follow_roll(own: Any, reading: Any) -> None:
    """The roll after a reading. One that is not finite is bridged with the rate as it was."""
    force_1, force_2, spin = reading.accelerometer_m_s2[0], reading.accelerometer_m_s2[1], reading.gyro_rad_s[2]
    if math.isfinite(spin) and math.isfinite(force_1) and math.isfinite(force_2):
        up_rad = math.atan2(force_1, force_2)
        off = (math.hypot(force_1, force_2) / STANDARD_GRAVITY_M_S2 - 1.0) / 0.25
        trust = math.exp(-off * off)
    else:
        spin, up_rad, trust = own.roll_rate_rad_s + own.bias_rad_s, own.roll_rad, 0.0
    own.step_s = 0.0
    if math.isnan(own.last_t_s):
        own.roll_rad = up_rad
    else:
        step_s = max(reading.t_s - own.last_t_s, 0.0)
        own.step_s = step_s
        rate = spin - own.bias_rad_s
        if step_s > LONGEST_GAP_S:  # nobody knows how far it has rolled, if time has passed at all
            own.roll_rad += trust * wrapped(up_rad - own.roll_rad)
        else:
            own.roll_rad += step_s * rate
            error = trust * wrapped(up_rad - own.roll_rad)
            own.roll_rad += step_s * CORRECTION_1_S * error
            own.bias_rad_s -= step_s * BIAS_1_S2 * error
        own.spin_rad_s = rate
        own.roll_rate_rad_s += (rate - own.roll_rate_rad_s) * min(1.0, step_s / RATE_TIME_S)
    own.last_t_s = reading.t_s


@part()
def take_bias(own: Any, bias_rad_s: float, roll_rad: float) -> None:
    """Go on with a bias of the gyro that was learnt elsewhere, and the roll (but for whole turns) that goes with it."""
    own.roll_rate_rad_s += own.bias_rad_s - bias_rad_s
    own.spin_rad_s += own.bias_rad_s - bias_rad_s
    own.bias_rad_s = bias_rad_s
    own.roll_rad += wrapped(roll_rad - own.roll_rad)


@part()
def solve_three(matrix: FloatArray, right: FloatArray, out: FloatArray) -> bool:
    """Solve a symmetric 3 × 3 system by its adjugate. False when it is singular."""
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * aa + b * bb + c * cc
    if not abs(determinant) > 0.0:
        return False
    dd, ee, ff = a * f - c * c, b * c - a * e, a * d - b * b
    out[0] = (aa * right[0] + bb * right[1] + cc * right[2]) / determinant
    out[1] = (bb * right[0] + dd * right[1] + ee * right[2]) / determinant
    out[2] = (cc * right[0] + ee * right[1] + ff * right[2]) / determinant
    return True


@part()
def follow_bend(model: RobotModel, own: Any, pressure_Pa: FloatArray, usable: FloatArray) -> None:
    """The bend at these pressures. usable (4,): 0 for a chamber taken as vented whatever its sensor says.

    Pressures that no section could carry, or that are no numbers, leave what was believed before.
    """
    load, section = model.load, model.section
    for a in range(3):
        own.load[a] = 0.0
    for i in range(CHAMBERS):
        if not math.isfinite(pressure_Pa[i]):
            return
        own.felt_Pa[i] = usable[i] * max(pressure_Pa[i], 0.0)
    if model.memory.size > 0:
        advance(model.memory, own.chamber_state, own.felt_Pa, own.step_s, own.felt_Pa)
    for i in range(CHAMBERS):
        effective_Pa = max(own.felt_Pa[i] - model.dead_band_Pa, 0.0)
        for a in range(3):
            own.load[a] += load[a, i] * effective_Pa
    for a in range(3):
        own.trial[a] = own.strain[a]
    settled = False
    for _ in range(_NEWTON_STEPS):
        if not wall_forces(*section, own.trial, own.force, own.stiffness):
            break
        for a in range(3):
            own.force[a] = own.load[a] - own.force[a]
        if not solve_three(own.stiffness, own.force, own.step):
            break
        reach = 1.0 / load[0, 0] * (abs(load[1, 0]) + abs(load[2, 0]))  # of a chamber from the axis
        size = abs(own.step[0]) + reach * (abs(own.step[1]) + abs(own.step[2]))
        share = min(1.0, 0.5 / size) if size > 0.0 else 1.0
        for a in range(3):
            own.trial[a] += share * own.step[a]
        if size < _SETTLED:
            settled = True
            break
    if settled:
        for a in range(3):
            own.strain[a] = own.trial[a]
        own.stretch = own.strain[0]
        own.curvature_1_m[0], own.curvature_1_m[1] = own.strain[1], own.strain[2]
    for i in range(CHAMBERS):
        volume = 0.0
        for a in range(3):
            volume += load[a, i] * own.strain[a]
        own.volume_m3[i] = model.length_m * volume


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

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        self.memory = estimator_memory()
        self._reading = np.zeros(1, READINGS).view(np.recarray)

    def update(self, readings: Readings, dead: Sequence[int] = ()) -> Estimate:
        """The estimate after these readings. Readings that are not finite are skipped over.

        Chambers known to be `dead` are taken as vented, whatever their sensors say.
        """
        own, reading = self.memory[0], self._reading[0]
        readings.write(reading)
        usable = np.ones(CHAMBERS)
        usable[list(dead)] = 0.0
        _follow(self._model, self.memory, self._reading, usable)
        return Estimate(
            float(own["roll_rad"]), float(own["roll_rate_rad_s"]), own["curvature_1_m"].copy(), float(own["stretch"])
        )


@kernel()
def _follow(model: RobotModel, memory: Any, reading: Any, usable: FloatArray) -> None:
    follow_roll(memory[0], reading[0])
    follow_bend(model, memory[0], reading[0].pressure_Pa, usable)
