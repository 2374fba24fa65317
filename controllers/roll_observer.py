"""What is wrong with the roll: the inertial unit, the floor and the wall, that the pressures do not show.

One call a cycle, after the estimate and the detector. What it finds joins the detector's verdicts of the cycle; an
estimate that rested on a biased gyro is put right.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from controllers.estimation import take_bias
from controllers.fault_detection import tell
from controllers.inertial_observer import (
    BIAS,
    FOUND,
    NOTHING,
    ROLL,
    InertialParts,
    inertial_memory,
    observe_inertial,
    parts_of_inertial,
)
from softbot.faults import KIND_CODES, NO_CHAMBER, FaultKind, IMU_BIAS_rad_s
from softbot.kernel_compiler import part
from softbot.robot import Robot

_IMU_BIAS = KIND_CODES[FaultKind.IMU_BIAS]
_IMU_STUCK, _IMU_DROPOUT = KIND_CODES[FaultKind.IMU_STUCK], KIND_CODES[FaultKind.IMU_DROPOUT]
_SETTLES_S = 1.5


class RollParts(NamedTuple):
    """What the observer of the roll is made of, as compiled code takes it."""

    inertial: InertialParts


class RollMemory(NamedTuple):
    """All that the observer of the roll remembers: records of shape (1,)."""

    inertial: Any


def parts_of_roll(robot: Robot, period_s: float) -> RollParts:
    """The parts for a robot whose readings come at this period."""
    return RollParts(parts_of_inertial(robot.sensors, robot.radius_m, period_s))


def roll_memory() -> RollMemory:
    """Memory of an observer that has seen nothing."""
    return RollMemory(inertial_memory())


@part()
def _watch_inertial(
    parts: RollParts, memory: RollMemory, detector: Any, estimate: Any, reading: Any, steady: bool
) -> None:
    """The gyro's bias: told once, and taken off the estimate whenever it has been learnt."""
    own = memory.inertial[0]
    alive = detector.imu_repeats == 0 and detector.named_shared[_IMU_STUCK] + detector.named_shared[_IMU_DROPOUT] == 0
    learnt = observe_inertial(parts.inertial, own, reading, alive, steady)
    if learnt == NOTHING:
        return
    take_bias(estimate, own.x[BIAS], own.x[ROLL])
    if learnt == FOUND:
        deviations = abs(own.x[BIAS]) - parts.inertial.largest_bias_rad_s
        deviations /= math.sqrt(own.covariance[BIAS, BIAS])
        confidence = 1.0 / (1.0 + math.exp(-min(0.5 * deviations * deviations, 700.0)))
        tell(detector, NO_CHAMBER, _IMU_BIAS, min(abs(own.x[BIAS]) / IMU_BIAS_rad_s, 1.0), confidence)


@part()
def watch_roll(
    parts: RollParts, memory: RollMemory, detector: Any, estimate: Any, reading: Any, entered_s: float
) -> None:
    """One cycle: a record of READINGS, the estimate after it, the detector's own record that gets the verdicts.

    entered_s: since when the sequencer is in its state; as it begins to roll, the C flops over and slips.
    """
    steady = reading.t_s - entered_s > _SETTLES_S
    _watch_inertial(parts, memory, detector, estimate, reading, steady)
