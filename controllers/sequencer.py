"""The sequencer: orders and readings in, chamber pressures out. A state machine with named states.

    disarmed   nothing is commanded; waits for an order, disarms when the order is done
    priming    armed: bends the robot into a C that lies flat, without lead
    rolling    healthy: the curvature leads the C, the lead regulated for the speed
    stalled    rolling is wanted and does not happen: a dead chamber is needed and recovery is off (or too slow yet)
    degraded   one chamber is dead: rolls on with the others …
    reversing  … and reverses the curvature where the dead one would be needed
    safe       a fault that forbids rolling on: vents and stays until it is ordered to stop

Every quantity it acts on is estimated from the readings. It knows no bus and no twin. `cycle` is the whole of it in
compiled code, over plain records; `Sequencer` wraps it for those who hold a robot file and a clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controllers import (
    chamber_gas,
    chamber_observer,
    commutation,
    compensation,
    detector_parts,
    estimation,
    fault_answers,
    fault_candidates,
    fault_detection,
    fault_following,
    fault_naming,
    recovery,
    robot_model,
    supply_observer,
)
from controllers.commutation import commanded_direction_rad, shortfall_rad
from controllers.compensation import compensate
from controllers.detector_parts import DetectorMemory, DetectorParts, detector_memory, parts_of_detector
from controllers.estimation import estimator_memory, follow_bend, follow_roll
from controllers.fault_answers import BLIND, FORBIDS_FROM, answers, strength_left
from controllers.fault_detection import detect, detections_of
from controllers.interface import (
    STATES,
    STRATEGIES,
    Command,
    Order,
    Recovery,
    SequencerOutput,
    SequencerState,
)
from controllers.recovery import REVERSAL, begin_reversal, reversal_due, reversal_over
from controllers.robot_model import RobotModel, pressures_for
from softbot import actuator_equilibrium, actuator_inverse, material, pneumatics
from softbot.cross_section import CHAMBERS
from softbot.faults import KIND_CODES, FaultKind
from softbot.kernel_stamp import kernel_stamp
from softbot.memory import chain, hysteresis, line, prony, residual
from softbot.robot import Robot
from softbot.sensing import READINGS, Readings

FloatArray = NDArray[np.float64]

_STALL_RATE_RAD_S = 0.25
_STALL_RATE_TIME_S = 0.3  # a robot that only rocks has stalled: the rate is averaged over about this
_STALL_TIME_S = 0.4
_PRIMED_SHARE = 0.8
_PRIMING_LONGEST_S = 3.0
_HELD_SHARE = 0.2

_DISARMED, _PRIMING, _ROLLING, _STALLED, _REVERSING, _DEGRADED, _SAFE = (
    STATES.index(state)
    for state in (
        SequencerState.DISARMED,
        SequencerState.PRIMING,
        SequencerState.ROLLING,
        SequencerState.STALLED,
        SequencerState.REVERSING,
        SequencerState.DEGRADED,
        SequencerState.SAFE,
    )
)
_CURVATURE_REVERSAL, _SAFE_STOP = STRATEGIES.index("curvature_reversal"), STRATEGIES.index("safe_stop")
_STUCK_CLOSED = KIND_CODES[FaultKind.STUCK_CLOSED]
_TURNS = {Command.LEFT: 1, Command.RIGHT: -1, Command.STOP: 0}
_MOST_ANSWERS = 8
_PROBE_Pa = 6e3


class SequencerParts(NamedTuple):
    """What a sequencer is made of, as compiled code takes it."""

    model: RobotModel
    detector: DetectorParts
    recovers: bool
    lead_rad: float
    answers: FloatArray
    """`controllers.fault_answers.answers()`."""


SEQUENCER = np.dtype(
    [
        ("turn", np.int64),
        ("speed_rad_s", np.float64),
        ("distance_m", np.float64),
        ("armed", np.bool_),
        ("state", np.int64),
        ("side", np.int64),
        ("roll_at_order_rad", np.float64),
        ("entered_s", np.float64),
        ("still_since_s", np.float64),
        ("mean_rate_rad_s", np.float64),
        ("last_t_s", np.float64),
        ("lead_integral_rad", np.float64),
        ("strength", np.float64, CHAMBERS),
        ("sighted", np.float64, CHAMBERS),
        ("setpoint_Pa", np.float64, CHAMBERS),
        ("wants_armed", np.bool_),
        ("answered", np.int64),
        ("answer", np.int64, _MOST_ANSWERS),
    ],
    align=True,
)
"""What a sequencer was ordered, remembers and answers, as a record. `turn`: +1 left, −1 right, 0 stop; speed and
distance NaN where none was ordered; `strength` 0 of a chamber that is not used, `sighted` 0 of one whose sensor lies;
`answer`: numbers of STRATEGIES taken in this cycle."""


class SequencerMemory(NamedTuple):
    """All that a sequencer remembers: records of shape (1,), and its detector's."""

    own: Any
    estimator: Any
    detector: DetectorMemory
    reversal: Any


def sequencer_memory() -> SequencerMemory:
    """Memory of a sequencer that has seen nothing and was ordered nothing."""
    own = np.zeros(1, SEQUENCER).view(np.recarray)
    first = own[0]
    for name in ("speed_rad_s", "distance_m", "roll_at_order_rad", "still_since_s", "last_t_s"):
        first[name] = math.nan
    first["side"] = 1
    first["strength"] = first["sighted"] = 1.0
    return SequencerMemory(own, estimator_memory(), detector_memory(), np.zeros(1, REVERSAL).view(np.recarray))


@dataclass(frozen=True)
class SequencerConfig:
    """The robot as the sequencer knows it, and its tuning."""

    robot: Robot
    recovery: bool = True
    lead_rad: float = 0.8
    bend_rad: float | None = None
    co_contraction_Pa: float = 0.0

    @classmethod
    def of(
        cls,
        robot: Robot,
        *,
        recovery: bool = True,
        lead_rad: float = 0.8,
        bend_rad: float | None = None,
        co_contraction_Pa: float = 0.0,
    ) -> SequencerConfig:
        """Configuration for a robot file."""
        return cls(robot, recovery, lead_rad, bend_rad, co_contraction_Pa)

    def parts(self) -> SequencerParts:
        """As compiled code takes it."""
        return SequencerParts(
            robot_model.robot_model(self.robot, self.bend_rad, self.co_contraction_Pa),
            parts_of_detector(self.robot.pneumatics, self.robot.sensors),
            bool(self.recovery),
            float(self.lead_rad),
            answers(),
        )


LAG_S = 0.12
"""By about this the curvature follows its command late, so a steady roll at ω needs a lead of ω·LAG_S …"""
PROPORTIONAL_S = 0.05
INTEGRAL = 0.15
"""… and what friction asks for."""


@njit(cache=True)
def regulated_lead_rad(own: Any, largest_rad: float, measured_rad_s: float, step_s: float) -> float:
    """The lead for this cycle, 0 … the largest [rad]; speeds are positive in the ordered direction.

    Feed-forward of the pressure lag, and a PI correction. Without a wanted speed the lead is the largest.
    """
    wanted = own.speed_rad_s
    if math.isnan(wanted):
        return largest_rad
    error = wanted - measured_rad_s
    lead = wanted * LAG_S + PROPORTIONAL_S * error + own.lead_integral_rad
    if 0.0 < lead < largest_rad or (lead <= 0.0) == (error > 0.0):  # no wind-up against a bound
        own.lead_integral_rad += INTEGRAL * error * step_s
    return min(max(lead, 0.0), largest_rad)


@njit(cache=True)
def _c_bend_side(estimate: Any) -> int:
    direction = math.atan2(estimate.curvature_1_m[1], estimate.curvature_1_m[0])
    return 1 if math.cos(direction + estimate.roll_rad) >= 0.0 else -1


@njit(cache=True)
def _bend_towards(parts: SequencerParts, own: Any, estimate: Any, direction_rad: float) -> None:
    pressures_for(parts.model, direction_rad, parts.model.curvature_1_m, own.setpoint_Pa)
    if parts.model.memory.size > 0:
        compensate(parts.model, estimate, own.strength, own.setpoint_Pa)
    for i in range(CHAMBERS):
        if own.strength[i] <= 0.0:
            own.setpoint_Pa[i] = 0.0


@njit(cache=True)
def _enter(memory: SequencerMemory, state: int, t_s: float) -> None:
    own = memory.own[0]
    own.state, own.entered_s, own.still_since_s = state, t_s, math.nan
    if state in (_DISARMED, _SAFE, _PRIMING):
        memory.reversal[0].under_way = False
        own.lead_integral_rad = 0.0


@njit(cache=True)
def _dead(own: Any) -> int:
    count = 0
    for i in range(CHAMBERS):
        if own.strength[i] <= 0.0:
            count += 1
    return count


@njit(cache=True)
def _rolling_state(parts: SequencerParts, own: Any) -> int:
    return _DEGRADED if parts.recovers and _dead(own) > 0 else _ROLLING


@njit(cache=True)
def _answer(parts: SequencerParts, memory: SequencerMemory, reading: Any, t_s: float) -> None:
    """React to what was found: reverse from now on, or fall back to the safe state."""
    own, detector = memory.own[0], memory.detector.own[0]
    own.answered = 0
    died = False
    for i in range(CHAMBERS):
        kind = detector.named[i]
        left = strength_left(parts.answers, kind, detector.severity[i])
        died = died or (left <= 0.0 < own.strength[i])
        own.strength[i] = left
        blinds = parts.answers[kind, BLIND]
        own.sighted[i] = max(own.sighted[i] - blinds, 0.0) if blinds > 0.0 else 1.0
    for n in range(0 if own.state == _SAFE else detector.found):  # in the safe state names may still be corrected
        kind, chamber = detector.found_kind[n], detector.found_chamber[n]
        held_Pa = reading.pressure_Pa[chamber] if kind == _STUCK_CLOSED else 0.0
        holds = held_Pa > _HELD_SHARE * parts.model.pressure_limit_Pa
        dies = died and chamber >= 0 and own.strength[chamber] <= 0.0
        answer = -1
        if detector.found_severity[n] >= parts.answers[kind, FORBIDS_FROM] or holds or (dies and _dead(own) > 1):
            _enter(memory, _SAFE, t_s)
            answer = _SAFE_STOP
        elif dies and parts.recovers:
            if own.state == _ROLLING or own.state == _DEGRADED or own.state == _STALLED:
                _enter(memory, _DEGRADED, t_s)
            answer = _CURVATURE_REVERSAL
        if answer >= 0 and own.answered < _MOST_ANSWERS:
            own.answer[own.answered] = answer
            own.answered += 1


@njit(cache=True)
def _arrived(parts: SequencerParts, own: Any, estimate: Any) -> bool:
    rolled_rad = -own.turn * (estimate.roll_rad - own.roll_at_order_rad)
    return parts.model.advance_m_rad * rolled_rad >= own.distance_m  # False where either is NaN


@njit(cache=True)
def _easier_side(own: Any, estimate: Any) -> int:
    """The side on which the living chambers can bend the robot best as it lies."""
    left = abs(shortfall_rad(commanded_direction_rad(1, 0.0, estimate.roll_rad), own.strength))
    right = abs(shortfall_rad(commanded_direction_rad(-1, 0.0, estimate.roll_rad), own.strength))
    return 1 if left <= right else -1


@njit(cache=True)
def _prime(parts: SequencerParts, memory: SequencerMemory, estimate: Any, t_s: float) -> None:
    own = memory.own[0]
    if t_s == own.entered_s or math.isnan(own.roll_at_order_rad):
        own.roll_at_order_rad = estimate.roll_rad
        own.side = _easier_side(own, estimate)
    size = math.hypot(estimate.curvature_1_m[0], estimate.curvature_1_m[1])
    bent = size > _PRIMED_SHARE * parts.model.curvature_1_m
    if bent or t_s - own.entered_s > _PRIMING_LONGEST_S:
        if bent:
            own.side = _c_bend_side(estimate)
        _enter(memory, _rolling_state(parts, own), t_s)
    _bend_towards(parts, own, estimate, commanded_direction_rad(own.side, 0.0, estimate.roll_rad))


@njit(cache=True)
def _reverse(parts: SequencerParts, memory: SequencerMemory, estimate: Any, t_s: float) -> None:
    own, reversal = memory.own[0], memory.reversal[0]
    if reversal_over(reversal, t_s, estimate, parts.model.curvature_1_m):
        own.side = _c_bend_side(estimate)
        own.lead_integral_rad = 0.0
        _enter(memory, _DEGRADED, t_s)
    _bend_towards(parts, own, estimate, reversal.direction_rad)


@njit(cache=True)
def _watch_stall(parts: SequencerParts, memory: SequencerMemory, estimate: Any, t_s: float, step_s: float) -> None:
    own = memory.own[0]
    share = min(1.0, step_s / _STALL_RATE_TIME_S)
    own.mean_rate_rad_s += share * (estimate.roll_rate_rad_s - own.mean_rate_rad_s)
    if abs(own.mean_rate_rad_s) > _STALL_RATE_RAD_S:
        own.still_since_s = math.nan
        if own.state == _STALLED:
            _enter(memory, _rolling_state(parts, own), t_s)
    elif math.isnan(own.still_since_s):
        own.still_since_s = t_s
    elif own.state != _STALLED and t_s - own.still_since_s > _STALL_TIME_S:
        _enter(memory, _STALLED, t_s)


@njit(cache=True)
def _roll(parts: SequencerParts, memory: SequencerMemory, estimate: Any, t_s: float, step_s: float) -> None:
    own, reversal = memory.own[0], memory.reversal[0]
    if parts.recovers and reversal_due(estimate, own.side, own.turn, own.strength):
        begin_reversal(reversal, t_s, estimate, own.side, own.strength)
        _enter(memory, _REVERSING, t_s)
        _reverse(parts, memory, estimate, t_s)
        return
    _watch_stall(parts, memory, estimate, t_s, step_s)
    lead = regulated_lead_rad(own, parts.lead_rad, -own.turn * estimate.roll_rate_rad_s, step_s)
    direction = commanded_direction_rad(own.side, own.turn * lead, estimate.roll_rad)
    if parts.recovers:
        direction -= shortfall_rad(direction, own.strength)
    _bend_towards(parts, own, estimate, direction)


@njit(cache=True)
def _act(parts: SequencerParts, memory: SequencerMemory, t_s: float, step_s: float) -> None:
    own, estimate = memory.own[0], memory.estimator[0]
    for i in range(CHAMBERS):
        own.setpoint_Pa[i] = 0.0
    if own.state == _SAFE:
        return
    if own.turn == 0 or _arrived(parts, own, estimate):
        if own.state != _DISARMED:
            _enter(memory, _DISARMED, t_s)
    elif own.state == _DISARMED:
        _enter(memory, _PRIMING, t_s)
    elif not own.armed:
        if own.state != _PRIMING:  # the board fell back to its safe state: begin anew
            _enter(memory, _PRIMING, t_s)
        own.entered_s = t_s
    elif own.state == _PRIMING:
        _prime(parts, memory, estimate, t_s)
    elif own.state == _REVERSING:
        _reverse(parts, memory, estimate, t_s)
    else:
        _roll(parts, memory, estimate, t_s, step_s)


@njit(cache=True)
def _probe(parts: SequencerParts, memory: SequencerMemory, reading: Any) -> None:
    """Ask for a little more pressure where the detector wants to see whether a chamber fills."""
    own, probe = memory.own[0], memory.detector.own[0].probe
    for i in range(CHAMBERS):
        if probe[i] > 0 and own.armed and own.state != _SAFE and own.state != _DISARMED:
            most_Pa = max(parts.model.pressure_limit_Pa - _PROBE_Pa, 0.0)
            own.setpoint_Pa[i] = min(max(reading.pressure_Pa[i], 0.0), most_Pa) + _PROBE_Pa


def _compile(stamp: str):  # type: ignore[no-untyped-def]
    @njit(cache=True, nogil=True)
    def cycle(parts: SequencerParts, memory: SequencerMemory, reading: Any, t_s: float) -> bool:
        """One control cycle at t_s: readings in reading[0] (READINGS); the answer stands in memory.own[0]."""
        own, estimate = memory.own[0], memory.estimator[0]
        step_s = 0.0 if math.isnan(own.last_t_s) else max(t_s - own.last_t_s, 0.0)
        own.last_t_s = t_s
        follow_roll(estimate, reading[0])
        follow_bend(parts.model, estimate, reading[0].pressure_Pa, own.sighted)
        memory.detector.own[0].rests = own.state == _SAFE
        detect(parts.detector, memory.detector, reading, estimate.volume_m3)
        _answer(parts, memory, reading[0], t_s)
        _act(parts, memory, t_s, step_s)
        _probe(parts, memory, reading[0])
        own.wants_armed = own.state != _DISARMED and own.state != _SAFE
        return len(stamp) > 0

    return cycle


cycle = _compile(
    kernel_stamp(
        actuator_equilibrium,
        actuator_inverse,
        chain,
        chamber_gas,
        chamber_observer,
        commutation,
        compensation,
        detector_parts,
        estimation,
        fault_answers,
        fault_candidates,
        fault_detection,
        fault_following,
        fault_naming,
        hysteresis,
        line,
        material,
        pneumatics,
        prony,
        recovery,
        residual,
        robot_model,
        supply_observer,
        __file__,
    )
)


def give_order(memory: SequencerMemory, order: Order, t_s: float) -> None:
    """What is wanted from now on. A stop also leaves the safe state, for a new start."""
    own = memory.own[0]
    own["turn"] = _TURNS[order.command]
    own["speed_rad_s"] = math.nan if order.speed_rev_s is None else 2.0 * math.pi * order.speed_rev_s
    own["distance_m"] = math.nan if order.distance_m is None else order.distance_m
    own["roll_at_order_rad"] = math.nan
    own["lead_integral_rad"] = 0.0
    if order.command is Command.STOP and own["state"] == _SAFE:
        _enter(memory, _DISARMED, t_s)


class Sequencer:
    """Rolls one robot. `armed` and `update` once a control cycle, `order` whenever the operator wants something."""

    def __init__(self, config: SequencerConfig) -> None:
        self.parts = config.parts()
        self.memory = sequencer_memory()
        self._own: Any = self.memory.own[0]
        self._reading = np.zeros(1, READINGS).view(np.recarray)

    @property
    def state(self) -> SequencerState:
        """The state now."""
        return STATES[int(self._own["state"])]

    @property
    def dead_chambers(self) -> tuple[int, ...]:
        """Chambers that are no longer used."""
        return tuple(int(chamber) for chamber in np.flatnonzero(self._own["strength"] <= 0.0))

    def order(self, order: Order, t_s: float) -> None:
        """What is wanted from now on. A stop also leaves the safe state, for a new start."""
        give_order(self.memory, order, t_s)

    def armed(self, is_armed: bool) -> None:
        """Whether the valve board is armed now."""
        self._own["armed"] = is_armed

    def update(self, t_s: float, readings: Readings) -> SequencerOutput:
        """One control cycle."""
        own = self._own
        readings.write(self._reading[0])
        cycle(self.parts, self.memory, self._reading, float(t_s))
        return SequencerOutput(
            own["setpoint_Pa"].copy(),
            self.state,
            bool(own["wants_armed"]),
            detections_of(self.memory.detector, readings.t_s),
            tuple(Recovery(t_s, STRATEGIES[int(own["answer"][n])]) for n in range(int(own["answered"]))),
        )
