"""Gyro against accelerometer: the gyro's bias, the accelerometer's, and whether the mid section rolls without slip.

An extended Kalman filter of its own beside the estimator. States: the roll φ, the gyro's bias b, the grip γ and the
accelerometer's bias a₁, a₂ along e1 and e2 (over g, so in radians), and what is left:

    φ̇ = ω_gyro − b
    up = φ − γ R ω̇ / g + (a₁ cos φ − a₂ sin φ) + m

`up` is the direction of the specific force in the section. A tube that rolls without slip (γ = 1) accelerates by R ω̇
against the sense of its roll, and its specific force leans by R ω̇ / g; ω̇ is the difference of two gyro readings, as
the accelerometer averages over the same time. m is what this leaves out (slip that comes and goes, the curved axis): a
first-order Markov process, the larger the more jerkily the robot has rolled lately.

The innovation over its own deviation goes into a two-sided CUSUM (Page). On readings that are as the filter believes it
passes the threshold h, with the allowance k, once in about exp(2 k (h + 1.17)) / (2 k²) readings (Siegmund). Then the
bias is learnt anew, as if nothing had been known of it: one beyond what the sensor may have is a fault, and goes on
being known, so that the estimate can be freed of it; any other was none.

Left out: bias of the other two axes of the gyro, which nobody uses, and scale errors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from controllers.commutation import wrapped
from controllers.estimation import STANDARD_GRAVITY_M_S2
from softbot.kernel_compiler import kernel, part
from softbot.sensing import SensorParameters

ROLL, BIAS, GRIP, ACROSS_1, ACROSS_2, LEFT_OUT = range(6)
"""Places of the states."""
STATES = 6
NOTHING, LEARNT, FOUND = range(3)
"""What a reading tells of the gyro's bias."""

_LEAST_NOISE_RAD = 0.004
_DRIFT_RAD = 3e-4  # what the roll is off by more in a reading, beside the gyro's noise: pitch and yaw, scale
_LEFT_OUT_TIME_S, _LEFT_OUT_RAD, _LEFT_OUT_SHARE = 0.1, 0.004, 0.2  # of m; its deviation always, and over the lean's
_JERKS_TIME_S, _RATE_TIME_S = 1.0, 0.5
_GRIP_KNOWN, _GRIP_CHANGES, _GRIP_MOST = 0.1, 0.1, 0.3  # deviation of γ at first, of its change in a second, at most
_TELLS = 6.0  # deviations of a lean's noise, from which on it tells of the grip
_JUMP_RAD_S = 0.5  # what a bias that is learnt anew may be: its deviation
_DRIFTS_RAD_S = 2e-4  # change in a second of a healthy gyro's bias: its deviation
_BROKEN_RAD_S = 0.02  # change in a second of a bias that was found, and may be anything: its deviation
_SHOCK = 0.1  # share of g by which a specific force may be off, before its direction counts for less
_UNSEEN_S = 0.25  # for about which a bias has led the roll astray before the alarm
_ASTRAY_RAD = 0.03  # what the roll may have come to be off by before the alarm
_FITS = 3.0  # mean square of the innovations up to which a bias explains them
_WEIGHTLESS = 0.3  # share of g below which it has no direction
_LONGEST_STEP = 1.5  # periods
_FORGETTING_STEP = 10.0


@dataclass(frozen=True)
class InertialTuning:
    """Thresholds of the test. `allowance` and `alarm_at` are those of the CUSUM, in deviations; `beyond` deviations of
    its healthy bias make a gyro's bias a fault, once it is known to be beyond by `sure` deviations of what is known."""

    allowance: float = 1.0
    alarm_at: float = 12.0
    beyond: float = 5.0
    least_bias_rad_s: float = 0.02
    sure: float = 4.0
    confirm: int = 20
    """Readings after the alarm before which nothing is said: one that repeats itself is known by then."""
    patience: int = 100
    """… and after which a bias that is not beyond is taken for what it is."""
    wild: float = 4.0
    """Deviations that one reading counts at most."""
    slipping_grip: float = 0.3
    """A grip below it by `slipping_sure` deviations, for `slipping_readings` with a lean that tells, is lost."""
    slipping_sure: float = 3.0
    slipping_readings: int = 40
    fastest_rad_s: float = 5.5
    """Mean rate of the roll beyond which the grip is not judged: a robot that is jerked so much slips on any floor."""
    settle: int = 50
    """Readings at the start in which nothing is judged."""


class InertialParts(NamedTuple):
    """What the observer is made of, as compiled code takes it."""

    period_s: float
    radius_m: float
    noise_rad: float
    """Of the direction of the specific force."""
    gyro_noise_rad_s: float
    bias_known_rad_s: float
    """Deviation of a healthy gyro's bias …"""
    across_known_rad: float
    """… and of a healthy accelerometer's, over g."""
    largest_bias_rad_s: float
    """That a healthy gyro has."""
    allowance: float
    alarm_at: float
    sure: float
    confirm: int
    patience: int
    wild: float
    slipping_grip: float
    slipping_sure: float
    slipping_readings: int
    fastest_rad_s: float
    settle: int


INERTIAL = np.dtype(
    [
        ("x", np.float64, STATES),
        ("covariance", np.float64, (STATES, STATES)),
        ("row", np.float64, STATES),
        ("last_t_s", np.float64),
        ("last_rad_s", np.float64),
        ("mean_rad_s", np.float64),
        ("seen", np.int64),
        ("jerks_rad2", np.float64),
        ("innovation", np.float64),
        ("rising", np.float64),
        ("falling", np.float64),
        ("alarm", np.int64),
        ("misfit", np.float64),
        ("biased", np.bool_),
        ("slipping", np.int64),
        ("slips", np.bool_),
    ],
    align=True,
)
"""What the observer believes and remembers, as a record: states and their covariance, scratch, the last reading's time
and rate, the mean rate, readings since the start or a long gap, the most (squared) that it has leant lately, the
innovation over its deviation, the CUSUMs, readings since the alarm (−1: there is none), the mean square of the
innovations since then, whether the gyro has been found biased; readings in which the grip was low, or has come back,
and whether it is lost."""


def inertial_memory() -> Any:
    """Memory of an observer that has seen nothing, shape (1,) of INERTIAL."""
    memory = np.zeros(1, INERTIAL).view(np.recarray)
    memory[0]["last_t_s"] = math.nan
    memory[0]["alarm"] = -1
    return memory


def parts_of_inertial(
    sensors: SensorParameters, radius_m: float, period_s: float, tuning: InertialTuning | None = None
) -> InertialParts:
    """The parts for these sensors, in a robot of this radius. period_s: of the samplings."""
    own = tuning or InertialTuning()
    return InertialParts(
        period_s,
        radius_m,
        max(sensors.accelerometer_noise_m_s2 / STANDARD_GRAVITY_M_S2, _LEAST_NOISE_RAD),
        sensors.gyro_noise_rad_s,
        max(sensors.gyro_bias_rad_s, 0.2 * own.least_bias_rad_s),
        sensors.accelerometer_bias_m_s2 / STANDARD_GRAVITY_M_S2,
        max(own.beyond * sensors.gyro_bias_rad_s, own.least_bias_rad_s),
        own.allowance,
        own.alarm_at,
        own.sure,
        own.confirm,
        own.patience,
        own.wild,
        own.slipping_grip,
        own.slipping_sure,
        own.slipping_readings,
        own.fastest_rad_s,
        own.settle,
    )


@part()
def _begin(parts: InertialParts, own: Any, up_rad: float) -> None:
    """Anew, from a first reading; a bias that was found stays known."""
    bias = own.x[BIAS] if own.biased else 0.0
    for i in range(STATES):
        own.x[i] = 0.0
        for j in range(STATES):
            own.covariance[i, j] = 0.0
    own.x[ROLL], own.x[BIAS], own.x[GRIP] = up_rad, bias, 1.0
    own.covariance[ROLL, ROLL] = parts.noise_rad**2 + parts.across_known_rad**2
    own.covariance[BIAS, BIAS] = parts.bias_known_rad_s**2
    own.covariance[GRIP, GRIP] = _GRIP_KNOWN**2
    own.covariance[ACROSS_1, ACROSS_1] = own.covariance[ACROSS_2, ACROSS_2] = parts.across_known_rad**2
    own.covariance[LEFT_OUT, LEFT_OUT] = _LEFT_OUT_RAD**2
    own.rising = own.falling = own.jerks_rad2 = 0.0
    own.alarm, own.seen = -1, 0


@part()
def _predict(parts: InertialParts, own: Any, spin_rad_s: float, step_s: float) -> None:
    covariance = own.covariance
    own.x[ROLL] += step_s * (spin_rad_s - own.x[BIAS])
    # only the roll moves, by the bias: its row and column
    square = covariance[ROLL, ROLL] - 2.0 * step_s * covariance[ROLL, BIAS] + step_s * step_s * covariance[BIAS, BIAS]
    for j in range(1, STATES):
        covariance[ROLL, j] -= step_s * covariance[BIAS, j]
        covariance[j, ROLL] = covariance[ROLL, j]
    lost = step_s > _LONGEST_STEP * parts.period_s
    unknown = abs(spin_rad_s - own.last_rad_s) * step_s if lost else parts.gyro_noise_rad_s * step_s
    covariance[ROLL, ROLL] = square + unknown * unknown + _DRIFT_RAD * _DRIFT_RAD * step_s / parts.period_s
    changes = _BROKEN_RAD_S if own.biased or own.alarm >= 0 else _DRIFTS_RAD_S
    covariance[BIAS, BIAS] += changes * changes * step_s
    if covariance[GRIP, GRIP] < _GRIP_MOST * _GRIP_MOST:
        covariance[GRIP, GRIP] += _GRIP_CHANGES * _GRIP_CHANGES * step_s
    kept = math.exp(-step_s / _LEFT_OUT_TIME_S)
    own.x[LEFT_OUT] *= kept
    for j in range(STATES):
        covariance[LEFT_OUT, j] *= kept
        covariance[j, LEFT_OUT] *= kept
    error = _LEFT_OUT_RAD * _LEFT_OUT_RAD + _LEFT_OUT_SHARE * _LEFT_OUT_SHARE * own.jerks_rad2
    covariance[LEFT_OUT, LEFT_OUT] += (1.0 - kept * kept) * error


@part()
def _judge_grip(parts: InertialParts, own: Any) -> None:
    """Whether the grip is lost, by what it was before this reading."""
    margin = parts.slipping_sure * math.sqrt(own.covariance[GRIP, GRIP])
    changed = own.x[GRIP] - margin > parts.slipping_grip if own.slips else own.x[GRIP] + margin < parts.slipping_grip
    own.slipping = own.slipping + 1 if changed and own.mean_rad_s < parts.fastest_rad_s else 0
    if own.slipping >= parts.slipping_readings:
        own.slips, own.slipping = not own.slips, 0


@part()
def _correct(parts: InertialParts, own: Any, up_rad: float, size: float, lean: float) -> None:
    """Meet a reading. size: of the specific force, over g; lean: of it for each unit of grip [rad]."""
    x, covariance, row = own.x, own.covariance, own.row
    c, s = math.cos(x[ROLL]), math.sin(x[ROLL])
    off = wrapped(up_rad - x[ROLL] - x[GRIP] * lean - x[ACROSS_1] * c + x[ACROSS_2] * s - x[LEFT_OUT])
    shock = (size - 1.0) / _SHOCK
    spread = parts.noise_rad**2 * (1.0 + shock * shock)
    for i in range(STATES):
        row[i] = covariance[i, ROLL] + lean * covariance[i, GRIP] + c * covariance[i, ACROSS_1]
        row[i] += covariance[i, LEFT_OUT] - s * covariance[i, ACROSS_2]
    spread += row[ROLL] + lean * row[GRIP] + c * row[ACROSS_1] - s * row[ACROSS_2] + row[LEFT_OUT]
    own.innovation = off / math.sqrt(spread)
    if abs(own.innovation) > parts.wild:  # a knock: it teaches little
        spread *= (own.innovation / parts.wild) ** 2
    noise = math.sqrt(2.0) * parts.gyro_noise_rad_s * parts.radius_m / (parts.period_s * STANDARD_GRAVITY_M_S2)
    tells = abs(lean) >= _TELLS * noise  # else the grip is taken into account and not learnt (Schmidt)
    if tells:
        _judge_grip(parts, own)
    for i in range(STATES):
        if i != GRIP or tells:
            x[i] += row[i] / spread * off
        for j in range(STATES):
            if i != GRIP or j != GRIP or tells:
                covariance[i, j] -= row[i] * row[j] / spread


@part()
def _judge(parts: InertialParts, own: Any) -> int:
    """The sequential test: NOTHING, or LEARNT or FOUND where a bias has just been learnt anew."""
    z = min(max(own.innovation, -parts.wild), parts.wild)
    if own.alarm < 0:
        own.rising = max(0.0, own.rising + z - parts.allowance)
        own.falling = max(0.0, own.falling - z - parts.allowance)
        if max(own.rising, own.falling) >= parts.alarm_at:
            own.alarm = 0
            own.misfit = 0.0
            own.covariance[BIAS, BIAS] += _JUMP_RAD_S**2
            own.covariance[ROLL, ROLL] += _ASTRAY_RAD**2 + (_JUMP_RAD_S * _UNSEEN_S) ** 2
            own.covariance[ROLL, BIAS] -= _JUMP_RAD_S**2 * _UNSEEN_S
            own.covariance[BIAS, ROLL] = own.covariance[ROLL, BIAS]
        return NOTHING
    own.alarm += 1
    own.misfit += (z * z - own.misfit) / own.alarm
    spread = math.sqrt(own.covariance[BIAS, BIAS])
    beyond = abs(own.x[BIAS]) - parts.largest_bias_rad_s
    known = abs(beyond) > parts.sure * spread and own.misfit < _FITS
    if own.alarm < (parts.confirm if known else parts.patience):
        return NOTHING
    own.alarm = -1
    own.rising = own.falling = 0.0
    if known and beyond > 0.0:
        was, own.biased = own.biased, True
        return LEARNT if was else FOUND
    return LEARNT if own.biased else NOTHING


@kernel(cache=False)
def observe_inertial(parts: InertialParts, own: Any, reading: Any, alive: bool, judges: bool) -> int:
    """One reading: NOTHING, FOUND when the gyro is now found biased (`x[BIAS]` says by how much), LEARNT when the
    bias of such a one has just been learnt anew. alive: whether the unit is believed to be. judges: whether the robot
    moves as the filter believes; else it only learns."""
    force_1, force_2, spin = reading.accelerometer_m_s2[0], reading.accelerometer_m_s2[1], reading.gyro_rad_s[2]
    size = math.hypot(force_1, force_2) / STANDARD_GRAVITY_M_S2
    if not (alive and math.isfinite(spin) and math.isfinite(size) and math.isfinite(reading.t_s)):
        return NOTHING
    up_rad = math.atan2(force_1, force_2)
    step_s = reading.t_s - own.last_t_s
    if not 0.0 < step_s < _FORGETTING_STEP * parts.period_s:
        if size > _WEIGHTLESS:
            _begin(parts, own, up_rad)
            own.last_t_s, own.last_rad_s = reading.t_s, spin
        return NOTHING
    _predict(parts, own, spin, step_s)
    steady = step_s < _LONGEST_STEP * parts.period_s
    lean = -parts.radius_m * (spin - own.last_rad_s) / (step_s * STANDARD_GRAVITY_M_S2) if steady else 0.0
    own.last_t_s, own.last_rad_s = reading.t_s, spin
    own.jerks_rad2 = max(lean * lean, own.jerks_rad2 * (1.0 - min(1.0, step_s / _JERKS_TIME_S)))
    own.mean_rad_s += min(1.0, step_s / _RATE_TIME_S) * (abs(spin - own.x[BIAS]) - own.mean_rad_s)
    own.seen += 1
    if size <= _WEIGHTLESS:
        return NOTHING
    _correct(parts, own, up_rad, size, lean)
    for i in range(STATES):
        if not own.covariance[i, i] > 0.0:  # lost to rounding, or to readings that no robot gives
            _begin(parts, own, up_rad)
            return NOTHING
    if judges and own.seen > parts.settle:
        return _judge(parts, own)
    own.rising = own.falling = 0.0
    own.alarm = -1
    own.slipping, own.slips = 0, False
    return NOTHING
