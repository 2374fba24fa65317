"""What is wrong with the plant now, given its faults: one array that every part of the plant reads its share of.

`conditions_at` writes the array for a time from the faults alone, with no memory: the conditions at a time do not
depend on the steps taken to it. `PlantConditions` keeps the array of one plant and tells which faults are new.

This is a simulation module: it imports numba.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softbot.faults import (
    BALLOON_LOSS,
    CHAMBER_COUNT,
    CONDITIONS_SIZE,
    EXHAUST_FACTOR,
    FORCED_OPENING,
    FRICTION_GAIN,
    INLET_FACTOR,
    KIND_CODES,
    LAG_FACTOR,
    LEAK_CONDUCTANCE_RATIO,
    LEAK_RATIO,
    RUPTURE_CONDUCTANCE_RATIO,
    SENSOR_SCALE_LOSS,
    SUPPLY_FACTOR,
    SUPPLY_PRESSURE_FACTOR,
    VALVE_SLOWNESS,
    VOLUME_FACTOR,
    WALL_SOFTENING,
    BALLOON_VOLUME_1_Pa,
    Fault,
    FaultKind,
    FaultTimeline,
    IMU_BIAS_rad_s,
    PneumaticConditions,
    SENSOR_DRIFT_Pa_s,
    SENSOR_FLOOR_Pa,
    SENSOR_NOISE_Pa,
    SENSOR_OFFSET_Pa,
    WIDENING_1_Pa,
)
from softbot.kernel_compiler import kernel

FloatArray = NDArray[np.float64]

# Places in the array after the pneumatics' own, four chambers each; then single numbers.
SENSOR_OFFSET = CONDITIONS_SIZE
SENSOR_FACTOR = SENSOR_OFFSET + 4
SENSOR_NOISE = SENSOR_FACTOR + 4
SENSOR_STUCK = SENSOR_NOISE + 4
SENSOR_DEAD = SENSOR_STUCK + 4
SENSOR_SOURCE = SENSOR_DEAD + 4
WALL_FACTOR = SENSOR_SOURCE + 4
LOAD_FACTOR = WALL_FACTOR + 4
GYRO_OFFSET = LOAD_FACTOR + 4
IMU_STUCK = GYRO_OFFSET + 1
IMU_DEAD = IMU_STUCK + 1
FRICTION_FACTOR = IMU_DEAD + 1
PAYLOAD_SHARE = FRICTION_FACTOR + 1
KERB_SHARE = PAYLOAD_SHARE + 1
PLANT_CONDITIONS_SIZE = KERB_SHARE + 1

# Places in a row of the faults' array.
_T, _CHAMBER, _KIND, _SEVERITY, _RAMP, _PERIOD, _DUTY = range(7)
FAULT_SIZE = 7

_RUPTURE = KIND_CODES[FaultKind.RUPTURE]
_LEAK = KIND_CODES[FaultKind.LEAK]
_BLOCKED_INLET = KIND_CODES[FaultKind.BLOCKED_INLET]
_BLOCKED_EXHAUST = KIND_CODES[FaultKind.BLOCKED_EXHAUST]
_KINKED_LINE = KIND_CODES[FaultKind.KINKED_LINE]
_STUCK_OPEN = KIND_CODES[FaultKind.STUCK_OPEN]
_STUCK_CLOSED = KIND_CODES[FaultKind.STUCK_CLOSED]
_VALVE_SLOW = KIND_CODES[FaultKind.VALVE_SLOW]
_SUPPLY_SAG = KIND_CODES[FaultKind.SUPPLY_SAG]
_SUPPLY_LOSS = KIND_CODES[FaultKind.SUPPLY_LOSS]
_SENSOR_OFFSET = KIND_CODES[FaultKind.SENSOR_OFFSET]
_SENSOR_DRIFT = KIND_CODES[FaultKind.SENSOR_DRIFT]
_SENSOR_NOISE = KIND_CODES[FaultKind.SENSOR_NOISE]
_SENSOR_STUCK = KIND_CODES[FaultKind.SENSOR_STUCK]
_SENSOR_DROPOUT = KIND_CODES[FaultKind.SENSOR_DROPOUT]
_SENSOR_SCALE = KIND_CODES[FaultKind.SENSOR_SCALE]
_LINES_SWAPPED = KIND_CODES[FaultKind.LINES_SWAPPED]
_IMU_BIAS = KIND_CODES[FaultKind.IMU_BIAS]
_IMU_STUCK = KIND_CODES[FaultKind.IMU_STUCK]
_IMU_DROPOUT = KIND_CODES[FaultKind.IMU_DROPOUT]
_WALL_SOFTENING = KIND_CODES[FaultKind.WALL_SOFTENING]
_BALLOONING = KIND_CODES[FaultKind.BALLOONING]
_FRICTION_LOST = KIND_CODES[FaultKind.FRICTION_LOST]
_FRICTION_HIGH = KIND_CODES[FaultKind.FRICTION_HIGH]
_PAYLOAD = KIND_CODES[FaultKind.PAYLOAD]
_OBSTACLE = KIND_CODES[FaultKind.OBSTACLE]


def faults_array(faults: Sequence[Fault]) -> FloatArray:
    """The faults as rows for `conditions_at`, shape (n, 7), in their order."""
    rows = np.zeros((len(faults), FAULT_SIZE))
    for row, fault in zip(rows, faults, strict=True):
        assert fault.kind is not None
        row[:] = (
            fault.t_s,
            fault.chamber_number,
            KIND_CODES[fault.kind],
            fault.severity,
            fault.ramp_s,
            0.0 if fault.period_s is None else fault.period_s,
            fault.duty,
        )
    return rows


@kernel()
def _present(fault: FloatArray, t_s: float) -> float:
    """Share of a fault's severity that is there at a time, 0 … 1."""
    since_s = t_s - fault[_T]
    if not since_s >= 0.0:
        return 0.0
    if fault[_PERIOD] > 0.0 and since_s % fault[_PERIOD] >= fault[_DUTY] * fault[_PERIOD]:
        return 0.0
    return min(1.0, since_s / fault[_RAMP]) if fault[_RAMP] > 0.0 else 1.0


@kernel()
def conditions_at(t_s: float, faults: FloatArray, out: FloatArray) -> None:
    """Write what the plant is like at `t_s` [s] into `out`, float64[PLANT_CONDITIONS_SIZE]; faults (n, 7)."""
    for i in range(CHAMBER_COUNT):
        out[LEAK_RATIO + i] = 0.0
        out[INLET_FACTOR + i] = out[EXHAUST_FACTOR + i] = out[LAG_FACTOR + i] = out[VOLUME_FACTOR + i] = 1.0
        out[FORCED_OPENING + i] = math.nan
        out[SENSOR_OFFSET + i] = out[SENSOR_NOISE + i] = out[SENSOR_STUCK + i] = out[SENSOR_DEAD + i] = 0.0
        out[SENSOR_FACTOR + i] = out[WALL_FACTOR + i] = out[LOAD_FACTOR + i] = 1.0
        out[SENSOR_SOURCE + i] = i
        out[WIDENING_1_Pa + i] = 0.0
    out[SUPPLY_FACTOR] = out[SUPPLY_PRESSURE_FACTOR] = out[FRICTION_FACTOR] = 1.0
    out[GYRO_OFFSET] = out[IMU_STUCK] = out[IMU_DEAD] = out[PAYLOAD_SHARE] = out[KERB_SHARE] = 0.0
    for n in range(faults.shape[0]):
        fault = faults[n]
        there = _present(fault, t_s)
        if there <= 0.0:
            continue
        kind, i, s = int(fault[_KIND]), int(fault[_CHAMBER]), there * fault[_SEVERITY]
        if kind == _RUPTURE:
            out[LEAK_RATIO + i] += s * RUPTURE_CONDUCTANCE_RATIO
        elif kind == _LEAK:
            out[LEAK_RATIO + i] += s * LEAK_CONDUCTANCE_RATIO
        elif kind == _BLOCKED_INLET:
            out[INLET_FACTOR + i] *= 1.0 - s
        elif kind == _BLOCKED_EXHAUST:
            out[EXHAUST_FACTOR + i] *= 1.0 - s
        elif kind == _KINKED_LINE:
            out[INLET_FACTOR + i] *= 1.0 - s
            out[EXHAUST_FACTOR + i] *= 1.0 - s
        elif kind == _STUCK_OPEN:
            out[FORCED_OPENING + i] = s
        elif kind == _STUCK_CLOSED:
            out[FORCED_OPENING + i] = 0.0
        elif kind == _VALVE_SLOW:
            out[LAG_FACTOR + i] *= 1.0 + VALVE_SLOWNESS * s
        elif kind == _SUPPLY_SAG:
            out[SUPPLY_PRESSURE_FACTOR] *= 1.0 - s
        elif kind == _SUPPLY_LOSS:
            out[SUPPLY_FACTOR] *= 1.0 - s
        elif kind == _SENSOR_OFFSET:
            out[SENSOR_OFFSET + i] += s * SENSOR_OFFSET_Pa
        elif kind == _SENSOR_DRIFT:
            out[SENSOR_OFFSET + i] += min(s * SENSOR_DRIFT_Pa_s * (t_s - fault[_T]), SENSOR_OFFSET_Pa)
        elif kind == _SENSOR_NOISE:
            out[SENSOR_NOISE + i] = math.hypot(out[SENSOR_NOISE + i], s * SENSOR_NOISE_Pa)
        elif kind == _SENSOR_STUCK:
            out[SENSOR_STUCK + i] = 1.0
        elif kind == _SENSOR_DROPOUT:
            out[SENSOR_DEAD + i] = 1.0
        elif kind == _SENSOR_SCALE:
            out[SENSOR_FACTOR + i] *= 1.0 - SENSOR_SCALE_LOSS * s
        elif kind == _LINES_SWAPPED:
            j = (i + 1) % CHAMBER_COUNT
            out[SENSOR_SOURCE + i], out[SENSOR_SOURCE + j] = out[SENSOR_SOURCE + j], out[SENSOR_SOURCE + i]
        elif kind == _IMU_BIAS:
            out[GYRO_OFFSET] += s * IMU_BIAS_rad_s
        elif kind == _IMU_STUCK:
            out[IMU_STUCK] = 1.0
        elif kind == _IMU_DROPOUT:
            out[IMU_DEAD] = 1.0
        elif kind == _WALL_SOFTENING:
            out[WALL_FACTOR + i] *= 1.0 - WALL_SOFTENING * s
        elif kind == _BALLOONING:
            out[LOAD_FACTOR + i] *= 1.0 - BALLOON_LOSS * s
            out[WIDENING_1_Pa + i] += s * BALLOON_VOLUME_1_Pa
        elif kind == _FRICTION_LOST:
            out[FRICTION_FACTOR] *= 1.0 - s
        elif kind == _FRICTION_HIGH:
            out[FRICTION_FACTOR] *= 1.0 + FRICTION_GAIN * s
        elif kind == _PAYLOAD:
            out[PAYLOAD_SHARE] += s
        elif kind == _OBSTACLE:
            out[KERB_SHARE] = s


@kernel()
def pressure_reading(
    i: int, true_Pa: FloatArray, error_Pa: float, draw: float, noise_Pa: float, last_Pa: float, conditions: FloatArray
) -> float:
    """What the pressure sensor of chamber i says [Pa], before it is rounded.

    true_Pa: of the four chambers; error_Pa: its own bias; draw: of a standard normal; last_Pa: its last reading.
    """
    if conditions[SENSOR_STUCK + i] > 0.0:
        return last_Pa
    if conditions[SENSOR_DEAD + i] > 0.0:
        return SENSOR_FLOOR_Pa
    extra_Pa = conditions[SENSOR_NOISE + i]
    spread_Pa = math.sqrt(noise_Pa * noise_Pa + extra_Pa * extra_Pa) if extra_Pa > 0.0 else noise_Pa
    seen_Pa = true_Pa[int(conditions[SENSOR_SOURCE + i])] * conditions[SENSOR_FACTOR + i]
    return seen_Pa + error_Pa + conditions[SENSOR_OFFSET + i] + spread_Pa * draw


class PlantConditions(FaultTimeline):
    """What is wrong with the plant now, given the faults of a scene.

    `faults`: any order. `packed`: the array that `conditions_at` writes; `pneumatic`: a view of the gas's share of it.
    All healthy until `advance` has reached a fault.
    """

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        super().__init__(faults)
        self.rows: FloatArray = faults_array(self.faults)
        self.packed: FloatArray = np.zeros(PLANT_CONDITIONS_SIZE)
        conditions_at(-math.inf, self.rows, self.packed)
        self.pneumatic = PneumaticConditions(self.packed[:CONDITIONS_SIZE])

    def advance(self, t_s: float) -> tuple[Fault, ...]:
        """What is wrong at `t_s` [s]; returns the faults that are new since the last call.

        Raises InputError when time runs backwards.
        """
        struck = self.note(t_s)
        conditions_at(t_s, self.rows, self.packed)
        return struck

    def sensor_reading_Pa(self, true_Pa: ArrayLike, last_reading_Pa: ArrayLike) -> FloatArray:
        """What four pressure sensors without errors of their own say [Pa], given true pressures [4] and the last
        readings [4]."""
        true, last = np.asarray(true_Pa, dtype=np.float64), np.asarray(last_reading_Pa, dtype=np.float64)
        return np.array([pressure_reading(i, true, 0.0, 0.0, 0.0, last[i], self.packed) for i in range(CHAMBER_COUNT)])
