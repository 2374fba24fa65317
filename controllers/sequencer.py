"""The sequencer: orders and readings in, chamber pressures out. A state machine with named states.

    disarmed   nothing is commanded; waits for an order, disarms when the order is done
    priming    armed: bends the robot into a C that lies flat, without lead
    rolling    healthy: the curvature leads the C, the lead regulated for the speed
    stalled    rolling is wanted and does not happen: a dead chamber is needed and recovery is off (or too slow yet)
    degraded   one chamber is dead: rolls on with the others …
    reversing  … and reverses the curvature where the dead one would be needed
    safe       a fault that forbids rolling on: vents and stays until it is ordered to stop

Every quantity it acts on is estimated from the readings. It knows no bus and no twin.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from controllers.commutation import can_roll, commanded_direction_rad, shortfall_rad
from controllers.compensation import Compensator
from controllers.estimation import Estimate, Estimator
from controllers.fault_detection import FaultDetector
from controllers.interface import (
    Command,
    Detection,
    FloatArray,
    Order,
    Recovery,
    SequencerOutput,
    SequencerState,
)
from controllers.recovery import ReversalPlanner
from softbot.actuator import ActuatorLaw
from softbot.cross_section import CHAMBERS
from softbot.faults import FaultKind
from softbot.robot import Robot
from softbot.rolling import coulomb_advance_ratio
from softbot.sensing import Readings

KILLS_CHAMBER = frozenset(
    {
        FaultKind.RUPTURE,
        FaultKind.BLOCKED_INLET,
        FaultKind.STUCK_CLOSED,
        FaultKind.SENSOR_OFFSET,
        FaultKind.SENSOR_STUCK,
    }
)
"""Faults after which the chamber is no longer used. A leak is reported, and the pressure loop feeds it."""
FORBIDS_ROLLING = frozenset({FaultKind.STUCK_OPEN})
"""Faults that only shutting the supply answers. (A valve stuck shut is one while its chamber holds pressure.)"""

_STALL_RATE_RAD_S = 0.25
_STALL_RATE_TIME_S = 0.3  # a robot that only rocks has stalled: the rate is averaged over about this
_STALL_TIME_S = 0.4
_PRIMED_SHARE = 0.8
_PRIMING_LONGEST_S = 3.0
_USE_OF_LIMIT = 0.9
_HELD_SHARE = 0.2
_MOVING = (SequencerState.ROLLING, SequencerState.DEGRADED, SequencerState.STALLED)


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


class Sequencer:
    """Rolls one robot. `armed` and `update` once a control cycle, `order` whenever the operator wants something."""

    def __init__(self, config: SequencerConfig) -> None:
        self._config = config
        self._law: ActuatorLaw = config.robot.actuator_law()
        self._compensator = Compensator(self._law, config.robot.actuator_memory())
        self._estimator = Estimator(self._law, compensator=self._compensator)
        self._detector = FaultDetector(config.robot.pneumatics, config.robot.sensors)
        self._planner = ReversalPlanner()
        self._speed = SpeedRegulator(config.lead_rad)
        self._curvature_1_m = self._wanted_curvature_1_m()
        half_bend = 0.5 * self._curvature_1_m * config.robot.length_m
        self._advance_m_rad = config.robot.radius_m * coulomb_advance_ratio(half_bend)
        self._order = Order(Command.STOP)
        self._is_armed = False
        self._state = SequencerState.DISARMED
        self._side = 1
        self._roll_at_order_rad: float | None = None
        self._entered_s = 0.0
        self._still_since_s: float | None = None
        self._mean_rate_rad_s = 0.0
        self._last_t_s: float | None = None
        self._step_s = 0.0

    @property
    def state(self) -> SequencerState:
        """The state now."""
        return self._state

    @property
    def dead_chambers(self) -> tuple[int, ...]:
        """Chambers that are no longer used."""
        return tuple(c for c in range(CHAMBERS) if self._detector.named.get(c) in KILLS_CHAMBER)

    @property
    def _blind_chambers(self) -> tuple[int, ...]:
        """Chambers whose sensor lies: they are vented, whatever it says."""
        lying = (FaultKind.SENSOR_OFFSET, FaultKind.SENSOR_STUCK)
        return tuple(c for c in range(CHAMBERS) if self._detector.named.get(c) in lying)

    def order(self, order: Order, t_s: float) -> None:
        """What is wanted from now on. A stop also leaves the safe state, for a new start."""
        self._order = order
        self._roll_at_order_rad = None
        self._speed.reset()
        if order.command is Command.STOP and self._state is SequencerState.SAFE:
            self._enter(SequencerState.DISARMED, t_s)

    def armed(self, is_armed: bool) -> None:
        """Whether the valve board is armed now."""
        self._is_armed = is_armed

    def update(self, t_s: float, readings: Readings) -> SequencerOutput:
        """One control cycle."""
        step_s = 0.0 if self._last_t_s is None else max(t_s - self._last_t_s, 0.0)
        self._last_t_s, self._step_s = t_s, step_s
        estimate = self._estimator.update(readings, self._blind_chambers)
        volume = self._law.chamber_volumes_m3(self._config.robot.length_m, estimate.stretch, estimate.curvature_1_m)
        detections = self._detector.update(readings, volume) if self._state is not SequencerState.SAFE else ()
        recoveries = self._answer(t_s, detections, readings)
        setpoint = self._act(t_s, step_s, estimate)
        wants_armed = self._state not in (SequencerState.DISARMED, SequencerState.SAFE)
        return SequencerOutput(setpoint, self._state, wants_armed, detections, recoveries)

    # ---------------------------------------------------------------- states

    def _act(self, t_s: float, step_s: float, estimate: Estimate) -> FloatArray:
        nothing = np.zeros(CHAMBERS)
        state = self._state
        if state is SequencerState.SAFE:
            return nothing
        if self._order.command is Command.STOP or self._arrived(estimate):
            if state is not SequencerState.DISARMED:
                self._enter(SequencerState.DISARMED, t_s)
            return nothing
        if state is SequencerState.DISARMED:
            self._enter(SequencerState.PRIMING, t_s)
            return nothing
        if not self._is_armed:
            if state is not SequencerState.PRIMING:  # the board fell back to its safe state: begin anew
                self._enter(SequencerState.PRIMING, t_s)
            self._entered_s = t_s
            return nothing
        if state is SequencerState.PRIMING:
            return self._prime(t_s, estimate)
        if state is SequencerState.REVERSING:
            return self._reverse(t_s, estimate)
        return self._roll(t_s, step_s, estimate)

    def _prime(self, t_s: float, estimate: Estimate) -> FloatArray:
        if t_s == self._entered_s or self._roll_at_order_rad is None:
            self._roll_at_order_rad = estimate.roll_rad
            self._side = self._easier_side(estimate)
        bent = estimate.curvature_size_1_m > _PRIMED_SHARE * self._curvature_1_m
        if bent or t_s - self._entered_s > _PRIMING_LONGEST_S:
            self._side = estimate.c_bend_side if bent else self._side
            self._enter(self._rolling_state(), t_s)
        return self._bend_towards(commanded_direction_rad(self._side, 0.0, estimate.roll_rad))

    def _roll(self, t_s: float, step_s: float, estimate: Estimate) -> FloatArray:
        forward = self._forward
        dead = self.dead_chambers if self._config.recovery else ()
        if dead and self._planner.due(estimate, self._side, forward, dead):
            self._planner.begin(t_s, estimate, self._side, dead)
            self._enter(SequencerState.REVERSING, t_s)
            return self._reverse(t_s, estimate)
        self._watch_stall(t_s, step_s, estimate)
        speed = None if self._order.speed_rev_s is None else 2.0 * math.pi * self._order.speed_rev_s
        lead = self._speed.lead_rad(speed, -forward * estimate.roll_rate_rad_s, step_s)
        direction = commanded_direction_rad(self._side, forward * lead, estimate.roll_rad)
        return self._bend_towards(direction - shortfall_rad(direction, dead))

    def _reverse(self, t_s: float, estimate: Estimate) -> FloatArray:
        reversal = self._planner.reversal
        assert reversal is not None
        if self._planner.over(t_s, estimate, self._curvature_1_m):
            self._side = reversal.side if estimate.c_bend_side == reversal.side else estimate.c_bend_side
            self._speed.reset()
            self._enter(SequencerState.DEGRADED, t_s)
        return self._bend_towards(reversal.direction_rad)

    def _answer(self, t_s: float, detections: tuple[Detection, ...], readings: Readings) -> tuple[Recovery, ...]:
        """React to what was found: reverse from now on, or fall back to the safe state."""
        answers = []
        for found in detections:
            kind = FaultKind(found.kind)
            held_Pa = float(readings.pressure_Pa[found.chamber]) if kind is FaultKind.STUCK_CLOSED else 0.0
            holds = held_Pa > _HELD_SHARE * self._config.robot.max_pressure_Pa
            if kind in FORBIDS_ROLLING or holds or not can_roll(self.dead_chambers):
                self._enter(SequencerState.SAFE, t_s)
                answers.append(Recovery(t_s, "safe_stop"))
            elif kind in KILLS_CHAMBER and self._config.recovery:
                if self._state in _MOVING:
                    self._enter(SequencerState.DEGRADED, t_s)
                answers.append(Recovery(t_s, "curvature_reversal"))
        return tuple(answers)

    def _watch_stall(self, t_s: float, step_s: float, estimate: Estimate) -> None:
        share = min(1.0, step_s / _STALL_RATE_TIME_S)
        self._mean_rate_rad_s += share * (estimate.roll_rate_rad_s - self._mean_rate_rad_s)
        if abs(self._mean_rate_rad_s) > _STALL_RATE_RAD_S:
            self._still_since_s = None
            if self._state is SequencerState.STALLED:
                self._enter(self._rolling_state(), t_s)
        elif self._still_since_s is None:
            self._still_since_s = t_s
        elif self._state is not SequencerState.STALLED and t_s - self._still_since_s > _STALL_TIME_S:
            self._enter(SequencerState.STALLED, t_s)

    # ---------------------------------------------------------------- helpers

    @property
    def _forward(self) -> int:
        """+1: a positive lead, negative revolutions, to the left."""
        return 1 if self._order.command is Command.LEFT else -1

    def _rolling_state(self) -> SequencerState:
        return SequencerState.DEGRADED if self.dead_chambers and self._config.recovery else SequencerState.ROLLING

    def _enter(self, state: SequencerState, t_s: float) -> None:
        self._state, self._entered_s = state, t_s
        self._still_since_s = None
        if state in (SequencerState.DISARMED, SequencerState.SAFE, SequencerState.PRIMING):
            self._planner.reversal = None
            self._speed.reset()

    def _arrived(self, estimate: Estimate) -> bool:
        distance_m, start_rad = self._order.distance_m, self._roll_at_order_rad
        if distance_m is None or start_rad is None:
            return False
        return self._advance_m_rad * -self._forward * (estimate.roll_rad - start_rad) >= distance_m

    def _easier_side(self, estimate: Estimate) -> int:
        """The side on which the living chambers can bend the robot best as it lies."""
        left, right = (
            abs(shortfall_rad(commanded_direction_rad(side, 0.0, estimate.roll_rad), self.dead_chambers))
            for side in (1, -1)
        )
        return 1 if left <= right else -1

    def _bend_towards(self, direction_rad: float) -> FloatArray:
        usable = [c not in self.dead_chambers for c in range(CHAMBERS)]
        wanted = self._curvature_1_m * np.array([math.cos(direction_rad), math.sin(direction_rad)])
        return self._compensator.pressures(
            wanted,
            dt_s=self._step_s,
            limit_Pa=self._config.robot.max_pressure_Pa,
            co_contraction_Pa=self._config.co_contraction_Pa,
            available=usable,
        ).pressure_Pa

    def _wanted_curvature_1_m(self) -> float:
        """The curvature to roll with: as ordered, or what every chamber can give well inside the pressure limit."""
        robot, config = self._config.robot, self._config
        if config.bend_rad is not None:
            return config.bend_rad / robot.length_m
        weakest = math.inf
        for chamber in range(CHAMBERS):
            pressure = np.full(CHAMBERS, config.co_contraction_Pa)
            pressure[chamber] = _USE_OF_LIMIT * robot.max_pressure_Pa
            weakest = min(weakest, float(np.hypot(*self._law.equilibrium(pressure).curvature_1_m)))
        return weakest


class SpeedRegulator:
    """Lead from wanted and measured rolling speed: feed-forward of the pressure lag, and a PI correction.

    The curvature follows its command late, by about `LAG_S`, so a steady roll at ω needs a lead of ω·LAG_S and what
    friction asks for. Without a wanted speed the lead is the largest.
    """

    LAG_S = 0.12
    PROPORTIONAL_S = 0.05
    INTEGRAL = 0.15

    def __init__(self, largest_lead_rad: float) -> None:
        self._largest_rad = largest_lead_rad
        self._integral_rad = 0.0

    def reset(self) -> None:
        """Forget the past."""
        self._integral_rad = 0.0

    def lead_rad(self, wanted_rad_s: float | None, measured_rad_s: float, step_s: float) -> float:
        """The lead for this cycle, 0 … the largest [rad]; speeds are positive in the ordered direction."""
        if wanted_rad_s is None:
            return self._largest_rad
        error = wanted_rad_s - measured_rad_s
        forward = wanted_rad_s * self.LAG_S + self.PROPORTIONAL_S * error
        lead = forward + self._integral_rad
        if 0.0 < lead < self._largest_rad or (lead <= 0.0) == (error > 0.0):  # no wind-up against a bound
            self._integral_rad += self.INTEGRAL * error * step_s
        return min(max(lead, 0.0), self._largest_rad)
