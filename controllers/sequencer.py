"""The sequencer: orders and readings in, chamber pressures out. A state machine with named states.

    disarmed   nothing is commanded; waits for an order, disarms when the order is done
    priming    armed: chambers that were given up prove themselves; then bends the robot into a C that lies flat
    rolling    healthy: the curvature leads the C, the lead regulated for the speed
    stalled    rolling is wanted and does not happen: a dead chamber is needed and recovery is off (or too slow yet)
    degraded   a chamber is dead or weak: rolls on as `controllers.recovery` plans it with what is left …
    reversing  … while the curvature is being reversed, where a dead chamber would be needed
    safe       a fault forbids rolling on, what is held cannot be bent back, or what is left makes no way: vents,
               says what is left (`controllers.offer`), and stays until it is ordered to stop, or for a moment if
               it was ordered to turn back then and something pushes it that way

Every quantity it acts on is estimated from the readings. It knows no bus and no twin. `cycle` is the whole of it in
compiled code, over plain records; `Sequencer` wraps it for those who hold a robot file and a clock.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.commutation import commanded_direction_rad
from controllers.compensation import compensate
from controllers.estimation import follow_bend, follow_roll
from controllers.excitation import excite
from controllers.fault_answers import BLIND, FORBIDS_FROM, HOLDS_FROM, LEAVES_OTHER_WAY, strength_left
from controllers.fault_detection import detect, detections_of, forget_chamber
from controllers.gas_ledger import keep_ledger, vent_full
from controllers.held_bend import bend_held, beside_held, free_bend, pinned
from controllers.interface import (
    STATES,
    STRATEGIES,
    Command,
    Order,
    SequencerOutput,
    SequencerState,
)
from controllers.offer import BOTH_WAYS, NOTHING, OTHER_WAY, WORTH_TURNING_RAD, offer_ways, pushed_rad, recovery_of
from controllers.proof import NOT_ANY, PROVED, TEST_SHARE, UNDER_WAY, begin_proof, follow_proof
from controllers.recovery import arch, most_moment, needs_momentum, plan_roll, reach, use_of
from controllers.robot_model import pressures_for
from controllers.roll_observer import watch_roll
from controllers.sequencer_parts import (
    MOST_ANSWERS,
    SequencerConfig,
    SequencerMemory,
    SequencerParts,
    sequencer_memory,
)
from controllers.speed_regulation import regulated_lead_rad, regulated_push
from softbot.cross_section import CHAMBERS
from softbot.kernel_compiler import kernel, part
from softbot.sensing import READINGS, Readings

FloatArray = NDArray[np.float64]

_STALL_RATE_RAD_S, _STALL_SHARE = 0.25, 0.4  # and of an ordered speed
_STALL_RATE_TIME_S = 0.3  # a robot that only rocks has stalled: the rate is averaged over about this
_STALL_TIME_S = 0.4
_FASTER = 1.5  # from the second stall on: over the speed at which momentum did not carry the robot
_PRIMED_SHARE = 0.8
_PRIMING_LONGEST_S = 3.0
_FOLLOWS_HELD = 0.1  # in a cycle: its sensor's noise must not be the others' command
_PINNED = 0.2  # of the bend that rolling asks for: a robot so bent for good does not roll
_PROGRESS_RAD, _REGAINS_S = 0.5 * math.pi, 60.0
_RESTS_LAGS = 6.0  # in the safe state, before it rolls the other way
_RUN_UP_RAD, _GOOD_PUSH, _FARTHEST_BACK_RAD = 0.25, 0.9, 2.0

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
_CURVATURE_REVERSAL, _SAFE_STOP, _MOMENTUM, _ROCK_FREE, _OTHER_WAY = (
    STRATEGIES.index(strategy) for strategy in ("curvature_reversal", "safe_stop", "momentum", "rock_free", "other_way")
)
_TURNS = {Command.LEFT: 1, Command.RIGHT: -1, Command.STOP: 0}
_PROBE_Pa = 6e3


@part()
def _c_bend_side(estimate: Any) -> int:
    direction = math.atan2(estimate.curvature_1_m[1], estimate.curvature_1_m[0])
    return 1 if math.cos(direction + estimate.roll_rad) >= 0.0 else -1


@part()
def _bend_towards(parts: SequencerParts, own: Any, estimate: Any, direction_rad: float, share: float) -> None:
    direction_rad, share = free_bend(own.held, direction_rad, share)
    pressures_for(parts.model, direction_rad, share * parts.model.curvature_1_m, own.setpoint_Pa)
    for i in range(CHAMBERS):  # a weak chamber needs more for the same
        if 0.0 < own.strength[i] < 1.0:
            own.setpoint_Pa[i] = min(own.setpoint_Pa[i] / own.strength[i], parts.model.pressure_limit_Pa)
    if parts.model.memory.size > 0:
        compensate(parts.model, estimate, own.strength, own.setpoint_Pa)
    for i in range(CHAMBERS):
        if own.strength[i] <= 0.0:
            own.setpoint_Pa[i] = 0.0


@kernel()
def _enter(memory: SequencerMemory, state: int, t_s: float) -> None:
    own = memory.own[0]
    own.state, own.entered_s, own.still_since_s = state, t_s, math.nan
    if state in (_DISARMED, _SAFE, _PRIMING):
        own.rocking, own.runs_up, own.farthest_s = False, False, math.nan
        memory.recovery[0].reversing = False
        own.lead_integral_rad = own.push_integral = own.least_rad_s = 0.0


@part()
def _dead(own: Any) -> int:
    count = 0
    for i in range(CHAMBERS):
        if own.strength[i] <= 0.0:
            count += 1
    return count


@part()
def _weakened(own: Any) -> bool:
    return bool(own.strength.min() < 1.0)


@part()
def _rolling_state(parts: SequencerParts, own: Any) -> int:
    return _DEGRADED if parts.recovers and _weakened(own) else _ROLLING


@part()
def _answer(parts: SequencerParts, memory: SequencerMemory, reading: Any, t_s: float) -> None:
    """React to what was found: reverse from now on, or fall back to the safe state."""
    own, detector = memory.own[0], memory.detector.own[0]
    own.answered = 0
    died = False
    for i in range(CHAMBERS):
        kind = detector.named[i]
        left = strength_left(parts.answers, kind, detector.severity[i])
        if own.state != _DISARMED:  # more only at rest, or proved
            left = min(left, own.strength[i])
        died = died or (left <= 0.0 < own.strength[i])
        own.strength[i] = left
        blinds = parts.answers[kind, BLIND]
        if blinds > 0.0:
            own.sighted[i] = max(own.sighted[i] - blinds, 0.0)
        else:
            own.sighted[i] = left if left > 0.0 else 1.0
        holds = detector.severity[i] >= parts.answers[kind, HOLDS_FROM]
        held = bend_held(parts.model, i, reading.pressure_Pa[i]) if holds else 0.0
        own.held[i] += _FOLLOWS_HELD * (held - own.held[i])
    stopped = own.state == _SAFE  # where names may still be corrected
    for n in range(detector.found):
        kind, chamber = detector.found_kind[n], detector.found_chamber[n]
        forbids = detector.found_severity[n] >= parts.answers[kind, FORBIDS_FROM]
        leaves_other_way = parts.answers[kind, LEAVES_OTHER_WAY] > 0.0
        if stopped:
            own.turning = own.turning and (leaves_other_way or not forbids)
            continue
        dies = died and chamber >= 0 and own.strength[chamber] <= 0.0
        answer = -1
        if forbids:
            _stop_safely(memory, OTHER_WAY if leaves_other_way else NOTHING, 0, t_s)
        elif dies and _dead(own) > (CHAMBERS - 1 if parts.recovers else 1):
            _stop_safely(memory, BOTH_WAYS, 0, t_s)
        elif dies and parts.recovers:
            if own.state == _ROLLING or own.state == _DEGRADED or own.state == _STALLED:
                _enter(memory, _DEGRADED, t_s)
            answer = _MOMENTUM if _dead(own) > 1 else _CURVATURE_REVERSAL
        if answer >= 0:
            _say(own, answer)


@part()
def _say(own: Any, answer: int) -> None:
    if own.answered < MOST_ANSWERS:
        own.answer[own.answered] = answer
        own.answered += 1


@part()
def _stop_safely(memory: SequencerMemory, freedom: int, only_side: int, t_s: float) -> None:
    """Into the safe state, and say what is left. freedom: what the reason of the stop leaves to be offered.

    only_side: of a C that cannot be straightened; 0: of one that can.
    """
    own = memory.own[0]
    left_rad, right_rad = math.inf, math.inf
    if own.state == _SAFE:  # two reasons at once
        left_rad, right_rad = own.offered_rad[0], own.offered_rad[1]
    own.used[:] = own.strength
    beside_held(own.held, own.used)
    roll_rad = memory.estimator[0].roll_rad
    offer_ways(memory.recovery[1], freedom, own.turn, only_side, roll_rad, own.used, own.offered_rad)
    own.offered_rad[0], own.offered_rad[1] = min(own.offered_rad[0], left_rad), min(own.offered_rad[1], right_rad)
    own.turning = own.turn_back and freedom != NOTHING
    _enter(memory, _SAFE, t_s)
    _say(own, _SAFE_STOP)


@part()
def _turn_back(parts: SequencerParts, memory: SequencerMemory, t_s: float) -> None:
    """Once the robot has come to rest in the safe state: leave it for the other way, where what is left pushes it."""
    own = memory.own[0]
    if own.turning and t_s - own.entered_s > _RESTS_LAGS * parts.model.lag_s:
        own.turning = own.turn_back = False
        only_side = own.side if pinned(own.held, own.strength, _PINNED) else 0
        roll_rad = memory.estimator[0].roll_rad
        if pushed_rad(memory.recovery[1], -own.turn, only_side, roll_rad, own.used) >= WORTH_TURNING_RAD:
            own.turn = -own.turn
            own.roll_at_order_rad = math.nan
            _enter(memory, _DISARMED, t_s)
            _say(own, _OTHER_WAY)


@part()
def _arrived(parts: SequencerParts, own: Any, estimate: Any) -> bool:
    rolled_rad = -own.turn * (estimate.roll_rad - own.roll_at_order_rad)
    return parts.model.advance_m_rad * rolled_rad >= own.distance_m  # False where either is NaN


@part()
def _easier_side(own: Any, estimate: Any) -> int:
    """The side on which the living chambers can bend the robot best as it lies."""
    left = reach(commanded_direction_rad(1, 0.0, estimate.roll_rad), own.used)
    right = reach(commanded_direction_rad(-1, 0.0, estimate.roll_rad), own.used)
    return 1 if left >= right else -1


@part()
def _prime(parts: SequencerParts, memory: SequencerMemory, estimate: Any, t_s: float) -> None:
    own = memory.own[0]
    own.used[:] = own.strength
    beside_held(own.held, own.used)
    if t_s == own.entered_s or math.isnan(own.roll_at_order_rad):
        own.roll_at_order_rad = estimate.roll_rad
        own.side = _easier_side(own, estimate)
    size = math.hypot(estimate.curvature_1_m[0], estimate.curvature_1_m[1])
    bent = size > _PRIMED_SHARE * parts.model.curvature_1_m
    if bent or t_s - own.entered_s > _PRIMING_LONGEST_S:
        if bent:
            own.side = _c_bend_side(estimate)
        _enter(memory, _rolling_state(parts, own), t_s)
    direction = commanded_direction_rad(own.side, 0.0, estimate.roll_rad)
    _bend_towards(parts, own, estimate, direction, reach(direction, own.used))


@part()
def _watch_stall(parts: SequencerParts, memory: SequencerMemory, estimate: Any, t_s: float, step_s: float) -> None:
    own = memory.own[0]
    share = min(1.0, step_s / _STALL_RATE_TIME_S)
    own.mean_rate_rad_s += share * (estimate.roll_rate_rad_s - own.mean_rate_rad_s)
    still_rad_s = _STALL_RATE_RAD_S
    if own.speed_rad_s > 0.0:
        still_rad_s = min(still_rad_s, _STALL_SHARE * own.speed_rad_s)
    if abs(own.mean_rate_rad_s) > still_rad_s:
        own.still_since_s = math.nan
        if own.state == _STALLED:
            _enter(memory, _rolling_state(parts, own), t_s)
    elif math.isnan(own.still_since_s):
        own.still_since_s = t_s
    elif own.state != _STALLED and t_s - own.still_since_s > _STALL_TIME_S:
        _enter(memory, _STALLED, t_s)


@part()
def _roll(parts: SequencerParts, memory: SequencerMemory, estimate: Any, t_s: float, step_s: float) -> None:
    own = memory.own[0]
    _watch_stall(parts, memory, estimate, t_s, step_s)
    if parts.recovers and _weakened(own):
        _roll_on(parts, memory, estimate, t_s, step_s)
    else:
        lead = regulated_lead_rad(own, parts.lead_rad, -own.turn * estimate.roll_rate_rad_s, step_s)
        _bend_towards(parts, own, estimate, commanded_direction_rad(own.side, own.turn * lead, estimate.roll_rad), 1.0)
    for i in range(CHAMBERS):
        unclear = memory.detector.own[0].alarm[i] >= 0 or memory.detector.follower[i].busy
        own.excited[i] = 1 if own.strength[i] > 0.0 or unclear else 0
    excite(parts.excitation, parts.model.co_contraction_Pa, t_s, own.excited, own.setpoint_Pa)


@part()
def _makes_no_way(parts: SequencerParts, own: Any, estimate: Any, t_s: float) -> bool:
    """Whether a robot that lives on its momentum has not got a quarter of a turn further for long.

    It may have been rolled back as far as a turn, and gains that at the ordered speed.
    """
    rolled_rad = -own.turn * estimate.roll_rad
    if math.isnan(own.farthest_s) or rolled_rad > own.farthest_rad + _PROGRESS_RAD:
        own.farthest_rad, own.farthest_s = rolled_rad, t_s
    regains_s = min(2.0 * math.pi / own.speed_rad_s, _REGAINS_S) if own.speed_rad_s > 0.0 else 0.0
    return t_s - own.farthest_s > parts.tuning.gives_up * parts.model.lag_s + regains_s


@part()
def _rocks(parts: SequencerParts, memory: SequencerMemory, estimate: Any, t_s: float) -> bool:
    """Whether the robot is rolled back now, to where its chambers can give it a good push forward."""
    own = memory.own[0]
    if not own.rocking:
        if own.state == _STALLED:
            own.rocking, own.rocked_s, own.rocked_rad = True, t_s, estimate.roll_rad
            if own.speed_rad_s > 0.0:  # NaN where none was ordered
                own.least_rad_s = _FASTER * own.least_rad_s if own.least_rad_s > 0.0 else own.speed_rad_s
            own.still_since_s = math.nan
            _say(own, _ROCK_FREE)
    else:
        away_rad = own.turn * (estimate.roll_rad - own.rocked_rad)
        push = most_moment(
            memory.recovery[1], own.turn, parts.tuning.lead_with_momentum_rad, estimate.roll_rad, own.strength
        )
        away = abs(away_rad) > _RUN_UP_RAD and push > _GOOD_PUSH
        if away or abs(away_rad) > _FARTHEST_BACK_RAD or t_s - own.rocked_s > parts.tuning.rocks * parts.model.lag_s:
            own.rocking, own.still_since_s = False, math.nan
            own.runs_up = True
            own.state = _DEGRADED
    return bool(own.rocking)


@part()
def _roll_on(parts: SequencerParts, memory: SequencerMemory, estimate: Any, t_s: float, step_s: float) -> None:
    """Roll as recovery plans it: degraded, and reversing for as long as the C flips."""
    own, plan, wanted = memory.own[0], memory.recovery[0], parts.model.curvature_1_m
    forward = own.turn
    use_of(parts.tuning, own.strength, estimate.spin_rad_s * parts.model.lag_s, own.used)
    beside_held(own.held, own.used)
    push = 1.0
    if needs_momentum(parts.tuning, own.used):
        if _makes_no_way(parts, own, estimate, t_s):
            _stop_safely(memory, BOTH_WAYS, 0, t_s)
            return
        lead_rad = max(parts.lead_rad, parts.tuning.lead_with_momentum_rad)
        if _rocks(parts, memory, estimate, t_s):
            forward = -own.turn
        else:
            push = regulated_push(own, -own.turn * estimate.spin_rad_s, step_s)
            forward = own.turn if push >= 0.0 else -own.turn
            push = abs(push)
    else:
        lead_rad = regulated_lead_rad(own, parts.lead_rad, -own.turn * estimate.roll_rate_rad_s, step_s)
    own.side = plan_roll(
        parts.tuning,
        plan,
        memory.recovery[1],
        own.side,
        forward,
        lead_rad,
        estimate.roll_rad,
        estimate.spin_rad_s,
        estimate.curvature_1_m / wanted,
        own.used,
        own.held,
        t_s,
        parts.model.lag_s,
        parts.model.agility_1_s2,
    )
    if own.state != _STALLED:
        own.state = _REVERSING if plan.reversing else _DEGRADED
    if own.rocking and plan.share <= 0.0:
        arch(plan, own.used)
    _bend_towards(parts, own, estimate, plan.direction_rad, math.sqrt(push) * plan.share)  # the moment has its square


@part()
def _ask_for_proof(parts: SequencerParts, memory: SequencerMemory) -> None:
    """At rest, before the robot rolls again: which of the chambers that are not used may prove themselves."""
    own, proof = memory.own[0], memory.proof[0]
    proof.chamber = NOT_ANY
    for i in range(CHAMBERS):
        lies = parts.answers[memory.detector.own[0].named[i], BLIND] > 0.0
        proof.owed[i] = 1 if parts.recovers and own.strength[i] <= 0.0 and not lies else 0


@part()
def _proves(parts: SequencerParts, memory: SequencerMemory, pressure_Pa: FloatArray, t_s: float) -> bool:
    """Whether a chamber is being tried now; one that has proved itself is used again."""
    own, proof = memory.own[0], memory.proof[0]
    if proof.chamber == NOT_ANY:
        for i in range(CHAMBERS):
            if proof.owed[i] > 0 and proof.chamber == NOT_ANY:
                begin_proof(proof, i, t_s)
    tried = proof.chamber
    if tried == NOT_ANY:
        return False
    test_Pa = TEST_SHARE * parts.model.pressure_limit_Pa
    outcome = follow_proof(proof, pressure_Pa[tried], test_Pa, t_s, parts.model.lag_s)
    if outcome == PROVED:
        forget_chamber(memory.detector, tried)
        own.strength[tried] = 1.0
    elif outcome == UNDER_WAY and proof.filling:
        own.setpoint_Pa[tried] = test_Pa
    return True


@part()
def _act(parts: SequencerParts, memory: SequencerMemory, pressure_Pa: FloatArray, t_s: float, step_s: float) -> None:
    own, estimate = memory.own[0], memory.estimator[0]
    for i in range(CHAMBERS):
        own.setpoint_Pa[i] = 0.0
    if own.state == _SAFE:
        _turn_back(parts, memory, t_s)
        return
    if pinned(own.held, own.strength, _PINNED):
        _stop_safely(memory, BOTH_WAYS, own.side, t_s)
    elif own.turn == 0 or _arrived(parts, own, estimate):
        if own.state != _DISARMED:
            _enter(memory, _DISARMED, t_s)
    elif own.state == _DISARMED:
        _enter(memory, _PRIMING, t_s)
        _ask_for_proof(parts, memory)
    elif not own.armed:
        if own.state != _PRIMING:  # the board fell back to its safe state: begin anew
            _enter(memory, _PRIMING, t_s)
        own.entered_s = t_s
    elif own.state == _PRIMING and _proves(parts, memory, pressure_Pa, t_s):
        own.entered_s = t_s
    elif own.state == _PRIMING:
        _prime(parts, memory, estimate, t_s)
    else:
        _roll(parts, memory, estimate, t_s, step_s)


@part()
def _rolls(own: Any) -> bool:
    return bool(own.armed and (own.state == _ROLLING or own.state == _STALLED))


@part()
def _probe(parts: SequencerParts, memory: SequencerMemory, reading: Any) -> None:
    """Ask for a little more pressure where the detector wants to see whether a chamber fills."""
    own, probe = memory.own[0], memory.detector.own[0].probe
    for i in range(CHAMBERS):
        if probe[i] > 0 and own.armed and own.state != _SAFE and own.state != _DISARMED:
            most_Pa = max(parts.model.pressure_limit_Pa - _PROBE_Pa, 0.0)
            own.setpoint_Pa[i] = min(max(reading.pressure_Pa[i], 0.0), most_Pa) + _PROBE_Pa


@kernel(nogil=True)
def cycle(parts: SequencerParts, memory: SequencerMemory, reading: Any, t_s: float) -> None:
    """One control cycle at t_s: readings in reading[0] (READINGS); the answer stands in memory.own[0]."""
    own, estimate = memory.own[0], memory.estimator[0]
    step_s = 0.0 if math.isnan(own.last_t_s) else max(t_s - own.last_t_s, 0.0)
    own.last_t_s = t_s
    follow_roll(estimate, reading[0])
    follow_bend(parts.model, estimate, reading[0].pressure_Pa, own.sighted)
    memory.detector.own[0].rests = own.state == _SAFE
    for i in range(CHAMBERS):
        memory.detector.own[0].felt[i] = own.sighted[i]
    detect(parts.detector, memory.detector, reading, estimate.volume_m3)
    keep_ledger(parts.detector, memory.detector, memory.ledger[0], reading[0])
    if parts.detects:
        watch_roll(parts.roll, memory.roll, parts.model, memory.detector.own[0], estimate, reading[0], _rolls(own))
    _answer(parts, memory, reading[0], t_s)
    _act(parts, memory, reading[0].pressure_Pa, t_s, step_s)
    _probe(parts, memory, reading[0])
    if parts.detects:
        vent_full(parts.detector, memory.ledger[0], parts.model.pressure_limit_Pa, own.setpoint_Pa)
    own.wants_armed = own.state != _DISARMED and own.state != _SAFE


def give_order(memory: SequencerMemory, order: Order, t_s: float) -> None:
    """What is wanted from now on. A stop also leaves the safe state, for a new start."""
    own = memory.own[0]
    own["turn"] = _TURNS[order.command]
    own["speed_rad_s"] = math.nan if order.speed_rev_s is None else 2.0 * math.pi * order.speed_rev_s
    own["distance_m"] = math.nan if order.distance_m is None else order.distance_m
    own["roll_at_order_rad"] = math.nan
    own["lead_integral_rad"] = own["push_integral"] = own["least_rad_s"] = 0.0
    own["farthest_s"], own["rocking"], own["runs_up"] = math.nan, False, False
    own["turn_back"], own["turning"] = order.turn_back, False
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
            tuple(recovery_of(t_s, int(n), *own["offered_rad"].tolist()) for n in own["answer"][: own["answered"]]),
        )
