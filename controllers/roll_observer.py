"""What is wrong with the roll: the inertial unit, the floor and the wall, that the pressures do not show.

One call a cycle, after the estimate and the detector. What it finds joins the detector's verdicts of the cycle; an
estimate that rested on a biased gyro is put right.

- The gyro's bias, and the grip of the floor: `controllers.inertial_observer`.
- What holds the robot, and a wall that has grown soft: `controllers.roll_balance`; on a robot that rolls with all its
  chambers and is suspected of nothing, as a wrong pressure is a wrong moment.

Left out: more friction and more weight, which change the balance and not the speed (decision 0038).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from controllers.estimation import take_bias
from controllers.fault_detection import report, tell
from controllers.inertial_observer import (
    BIAS,
    FOUND,
    GRIP,
    ROLL,
    InertialParts,
    inertial_memory,
    observe_inertial,
    parts_of_inertial,
)
from controllers.robot_model import RobotModel
from controllers.roll_balance import HELD, SOFTENED, balance_memory, observe_balance, pause_balance
from softbot.faults import CHAMBER_COUNT, KIND_CODES, NO_CHAMBER, FaultKind, IMU_BIAS_rad_s
from softbot.kernel_compiler import part
from softbot.robot import Robot

_IMU_BIAS = KIND_CODES[FaultKind.IMU_BIAS]
_IMU_STUCK, _IMU_DROPOUT = KIND_CODES[FaultKind.IMU_STUCK], KIND_CODES[FaultKind.IMU_DROPOUT]
_FRICTION_LOST, _OBSTACLE = KIND_CODES[FaultKind.FRICTION_LOST], KIND_CODES[FaultKind.OBSTACLE]
_WALL_SOFTENING = KIND_CODES[FaultKind.WALL_SOFTENING]
NOT_HEARD = -1
_STATE = np.dtype([("cycles", np.int64), ("heard", np.int64)], align=True)
_SETTLES_S = 1.5
_SOFTEST_RISE = 0.55  # of a gain, of a softening of severity 1
_SURE = 0.99


class RollParts(NamedTuple):
    """What the observer of the roll is made of, as compiled code takes it."""

    period_s: float
    inertial: InertialParts


class RollMemory(NamedTuple):
    """All that the observer of the roll remembers: records of shape (1,)."""

    inertial: Any
    balance: Any
    state: Any
    """For how many cycles the robot has rolled, and whether it does (1, 0) as another sequencer says, if that is the
    one that moves it, else NOT_HEARD."""


def parts_of_roll(robot: Robot, period_s: float) -> RollParts:
    """The parts for a robot whose readings come at this period."""
    return RollParts(period_s, parts_of_inertial(robot.sensors, robot.radius_m, period_s))


def roll_memory() -> RollMemory:
    """Memory of an observer that has seen nothing."""
    state = np.zeros(1, _STATE).view(np.recarray)
    state[0]["heard"] = NOT_HEARD
    return RollMemory(inertial_memory(), balance_memory(), state)


@part()
def _watch_inertial(
    parts: RollParts, memory: RollMemory, detector: Any, estimate: Any, reading: Any, judges: bool
) -> None:
    """The gyro's bias, told once and taken off the estimate from then on."""
    own = memory.inertial[0]
    alive = detector.imu_repeats == 0 and detector.named_shared[_IMU_STUCK] + detector.named_shared[_IMU_DROPOUT] == 0
    learnt = observe_inertial(parts.inertial, own, reading, alive, judges)
    if learnt == FOUND and detector.named_shared[_IMU_BIAS] == 0:
        deviations = abs(own.x[BIAS]) - parts.inertial.largest_bias_rad_s
        deviations /= math.sqrt(own.covariance[BIAS, BIAS])
        confidence = 1.0 / (1.0 + math.exp(-min(0.5 * deviations * deviations, 700.0)))
        tell(detector, NO_CHAMBER, _IMU_BIAS, min(abs(own.x[BIAS]) / IMU_BIAS_rad_s, 1.0), confidence)
    if own.biased and alive and own.alarm < 0:
        take_bias(estimate, own.x[BIAS], own.x[ROLL])


@part()
def _watch_grip(memory: RollMemory, detector: Any) -> None:
    own = memory.inertial[0]
    known = detector.named_shared[_FRICTION_LOST] > 0
    if own.slips and not known:
        tell(detector, NO_CHAMBER, _FRICTION_LOST, min(max(1.0 - own.x[GRIP], 0.0), 1.0), _SURE)
    elif known and not own.slips:
        detector.named_shared[_FRICTION_LOST] = 0  # the floor holds again: what comes after is another one


@part()
def _watch_balance(memory: RollMemory, detector: Any, estimate: Any, model: RobotModel, step_s: float) -> None:
    own = memory.balance[0]
    told = observe_balance(own, estimate, model.curvature_1_m, model.pressure_limit_Pa, step_s)
    if told == HELD:
        tell(detector, NO_CHAMBER, _OBSTACLE, 1.0, _SURE)
    elif told == SOFTENED and not memory.inertial[0].slips:
        severity = min(own.soft[own.soft_chamber] / _SOFTEST_RISE, 1.0)
        report(detector, own.soft_chamber, _WALL_SOFTENING, severity, _SURE)


@part()
def _sound(detector: Any) -> bool:
    """Whether nothing is known or suspected of the chambers and of the gyro."""
    sound = True
    for c in range(CHAMBER_COUNT):
        sound = sound and detector.named[c] == 0 and detector.alarm[c] < 0
    return sound


@part()
def watch_roll(
    parts: RollParts,
    memory: RollMemory,
    model: RobotModel,
    detector: Any,
    estimate: Any,
    reading: Any,
    rolls: bool,
) -> None:
    """One cycle: a record of READINGS, the estimate after it, the detector's own record that gets the verdicts.

    rolls: whether the robot is made to, with all its chambers. As it begins to, as it reverses its C and as it falls
    into its safe state it slips, and nothing is judged.
    """
    state = memory.state[0]
    rolls = rolls if state.heard == NOT_HEARD else state.heard > 0
    state.cycles = state.cycles + 1 if rolls else 0
    steady = state.cycles * parts.period_s > _SETTLES_S
    _watch_inertial(parts, memory, detector, estimate, reading, steady)
    if steady and _sound(detector):
        _watch_grip(memory, detector)
        if memory.inertial[0].alarm < 0:
            _watch_balance(memory, detector, estimate, model, parts.period_s)
    else:
        pause_balance(memory.balance[0])
        memory.inertial[0].slipping, memory.inertial[0].slips = 0, False
