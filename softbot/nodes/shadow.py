"""A robot watched by its twin: the sequencer's estimation and fault detection over what the board says on a bus.

The board's frames, live or recorded, go into a sequencer's node as it stands on a bus; what the node says goes nowhere,
and it is never ordered to move, so it estimates, learns and detects and does nothing else. It is the same compiled code
as in the robot's own sequencer. Beside the verdicts it tells what was learnt of each chamber (what its paths pass, over
what the robot file says, and how much leaks), so that a drift is seen before it hurts; `Health` carries that from one
session to the next.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from controllers.chamber_observer import HOLE, INLET, OFFSET, OUTLET
from controllers.inertial_observer import BIAS, GRIP
from controllers.interface import Command, Detection, Order, SequencerState
from controllers.roll_balance import DRY, GAIN
from controllers.sequencer import Sequencer
from controllers.sequencer_parts import SequencerConfig
from firmware_protocol.codec import decode
from firmware_protocol.enumerations import BoardMode
from firmware_protocol.errors import ProtocolError
from firmware_protocol.frame import Frame
from firmware_protocol.sequencer_link import SequencerLink
from firmware_protocol.spec import BOARD, spec
from firmware_protocol.trace import read_trace
from sim.scene import scene_from
from softbot.errors import SimulationError
from softbot.faults import CHAMBER_COUNT, KINDS, NO_CHAMBER
from softbot.nodes.chamber_health import Health, Learnt, Session, carry_into
from softbot.nodes.heard import Heard
from softbot.nodes.sequencer_node import LAST_MEASUREMENT, SequencerNode
from softbot.robot import Robot
from softbot.sensing import Readings

TURN_RAD = 2.0 * math.pi
_ROLLS = (SequencerState.ROLLING, SequencerState.STALLED)
_CALENDAR_FROM_S = 1e9  # stamps beyond are seconds since 1970, as candump writes them
Seen = tuple[float, list[Frame]]
"""Time [s] and the frames that came then."""


class ListeningLink(SequencerLink):
    """A link that asks for nothing: it counts as armed while the board says that it is."""

    @property
    def armed(self) -> bool:
        """Whether the board says that it is armed."""
        return self.readings.board_mode is BoardMode.ARMED


@dataclass(frozen=True)
class ChamberEstimate:
    """What the shadow believes of a chamber now.

    `suspicion`: its test over the threshold, 1 and more raises an alarm; `effectiveness`: what is left of it, 1 all,
    0 not to be used; `named`: what it was found to have, and how badly.
    """

    pressure_Pa: float
    learnt: Learnt
    suspicion: float
    effectiveness: float
    named: str | None
    severity: float | None


@dataclass(frozen=True)
class RollEstimate:
    """What the shadow has learnt of the roll (`controllers.inertial_observer`, `controllers.roll_balance`).

    `grip`: share of the acceleration of a roll without slip; `resistance`: of the floor, over EI L κ² of the C;
    `gains`: how much more than is believed each chamber bends, beyond what all four do.
    """

    gyro_bias_rad_s: float
    gyro_bias_deviation_rad_s: float
    grip: float
    resistance: float
    gains: tuple[float, ...]


@dataclass(frozen=True)
class ShadowEstimate:
    """What the shadow believes now: the roll since it began to watch, the C, the chambers, and what rolls them."""

    t_s: float
    board_mode: str | None
    sequencer_state: str
    roll_rev: float
    roll_rate_rev_s: float
    bend_rad: float
    chambers: tuple[ChamberEstimate, ...]
    roll: RollEstimate


@dataclass(frozen=True)
class Counts:
    """The board's frames that were accepted and refused, and whole samplings."""

    accepted: int
    refused: int
    samplings: int


class Shadow:
    """Watches one robot. `see` what came on its bus, in order; it answers with what it has just found.

    robot: as its file says; health: what earlier sessions have learnt of it.
    """

    def __init__(self, robot: Robot, health: Health | None = None) -> None:
        scene = scene_from(
            {"robot": robot.table(), "drive": {"kind": "sequencer"}, "sequencer": {"command": "stop"}},
            robot.name,
            Path(),
        )
        self.robot = robot
        self.heard = Heard()
        self.detections: list[Detection] = []
        """All verdicts so far."""
        self.armed_s = 0.0
        self.t_s = 0.0
        self._sequencer = Sequencer(SequencerConfig(robot))
        self._node = SequencerNode(scene, self._sequencer)
        self._node.link = ListeningLink()
        self._of_the_board = {message.frame_id for message in spec().messages if message.sender == BOARD}
        self._health = health
        self._first_s: float | None = None
        self._first_roll_rad = math.nan

    def see(self, stamp_s: float, frames: Iterable[Frame]) -> list[Detection]:
        """What came at `stamp_s` (any clock that does not run backwards); the verdicts that it leads to.

        Times are counted from the first stamp. Raises SimulationError when the detector fails.
        """
        came = list(frames)
        self._first_s = stamp_s if self._first_s is None else self._first_s
        before_s, self.t_s = self.t_s, max(self.t_s, round(stamp_s - self._first_s, 6))
        self.armed_s += (self.t_s - before_s) * self._node.link.armed
        known = len(self._node.detections)
        self._sequencer.memory.roll.state[0]["heard"] = self.heard.state in _ROLLS
        self._node.cycle(self.t_s, [frame for frame in came if frame.frame_id in self._of_the_board])
        if self._node.failure is not None:
            raise SimulationError(
                f"the shadow failed at t = {self.t_s:.2f} s: {self._node.failure}"
            ) from self._node.failure
        for frame in came:
            with contextlib.suppress(ProtocolError):  # not of this protocol, or damaged
                self.heard.listen(*decode(*frame), self.t_s)
        self._begin()
        if self._sequencer.state is SequencerState.SAFE:  # it goes on watching what no robot should go on with
            self._sequencer.order(Order(Command.STOP), self.t_s)
        found = self._node.detections[known:]
        self.detections += found
        return found

    def _begin(self) -> None:
        """At the first sampling: take over what is known of the chambers, and count the roll from here."""
        memory = self._sequencer.memory
        if math.isnan(self._first_roll_rad) and not math.isnan(memory.estimator[0]["last_t_s"]):
            self._first_roll_rad = float(memory.estimator[0]["roll_rad"])
            if self._health is not None:
                carry_into(memory.detector, self._health)

    def session(self) -> Session | None:
        """What was learnt so far, as a session that ends now; None where nothing was.

        It ended when the last frame came where the stamps are a calendar's, and else at this moment.
        """
        learnt = tuple(self._learnt(chamber) for chamber in range(CHAMBER_COUNT))
        if min(one.cycles for one in learnt) == 0 or max(one.fills for one in learnt) == 0:
            return None
        stamp_s = (self._first_s or 0.0) + self.t_s
        calendar = stamp_s > _CALENDAR_FROM_S
        ended = datetime.fromtimestamp(stamp_s, UTC) if calendar else datetime.now(UTC)
        return Session(ended=ended.replace(microsecond=0), watched_s=self.t_s, chambers=learnt)

    def _learnt(self, chamber: int) -> Learnt:
        detector = self._sequencer.memory.detector
        x, spread = detector.own[0]["trusted"][chamber], np.diag(detector.observer[chamber]["covariance"])
        if detector.own[0]["learnt"][chamber] == 0:
            x = detector.observer[chamber]["x"]
        return Learnt(
            sensor_offset_Pa=float(x[OFFSET]),
            supply_path=float(x[INLET]),
            exhaust_path=float(x[OUTLET]),
            leak=float(x[HOLE]),
            supply_path_deviation=math.sqrt(float(spread[INLET])),
            exhaust_path_deviation=math.sqrt(float(spread[OUTLET])),
            leak_deviation=math.sqrt(float(spread[HOLE])),
            cycles=int(detector.own[0]["learnt"][chamber]),
            fills=int(detector.own[0]["filled"][chamber]),
        )

    def estimate(self) -> ShadowEstimate:
        """What is believed now."""
        memory, link = self._sequencer.memory, self._node.link
        estimator, own, detector = memory.estimator[0], memory.own[0], memory.detector.own[0]
        alarm_at = self._sequencer.parts.detector.alarm_at
        chambers = []
        for chamber in range(CHAMBER_COUNT):
            kind = int(detector["named"][chamber])
            suspicion = max(float(detector["rising"][chamber]), float(detector["falling"][chamber])) / alarm_at
            chambers.append(
                ChamberEstimate(
                    float(detector["last_Pa"][chamber]),
                    self._learnt(chamber),
                    suspicion,
                    float(own["strength"][chamber]),
                    str(KINDS[kind - 1]) if kind else None,
                    float(detector["severity"][chamber]) if kind else None,
                )
            )
        mode = link.readings.board_mode
        began = not math.isnan(self._first_roll_rad)
        return ShadowEstimate(
            self.t_s,
            None if mode is None else mode.name.lower(),
            str(self.heard.state),
            (float(estimator["roll_rad"]) - self._first_roll_rad) / TURN_RAD if began else 0.0,
            float(estimator["roll_rate_rad_s"]) / TURN_RAD,
            float(np.hypot(*estimator["curvature_1_m"])) * self.robot.length_m,
            tuple(chambers),
            self._roll(),
        )

    def _roll(self) -> RollEstimate:
        inertial, balance = (one[0] for one in self._sequencer.memory.roll[:2])
        gains = balance["x"][GAIN:]
        return RollEstimate(
            float(inertial["x"][BIAS]),
            math.sqrt(max(float(inertial["covariance"][BIAS, BIAS]), 0.0)),
            float(inertial["x"][GRIP]),
            float(balance["x"][DRY]),
            tuple((gains - gains.mean()).tolist()),
        )

    def counts(self) -> Counts:
        """How many of the board's frames were accepted and refused so far."""
        received = self._node.link.reception.messages
        every = [(status, count) for entry in received.values() for status, count in entry.counts.items()]
        accepted = sum(count for status, count in every if status.accepted)
        whole = sum(count for status, count in received[LAST_MEASUREMENT].counts.items() if status.accepted)
        return Counts(accepted, sum(count for _, count in every) - accepted, whole)

    def severity(self, found: Detection) -> float | None:
        """How bad what was found in a chamber is, as it is estimated now; None of what the chambers share."""
        if found.chamber == NO_CHAMBER:
            return None
        return float(self._sequencer.memory.detector.own[0]["severity"][found.chamber])


def rehearse_shadow(robot: Robot) -> None:
    """Compile what a shadow needs, so that it misses nothing when it listens."""
    still = Readings(0.0, np.zeros(CHAMBER_COUNT), 0.0, np.zeros(3), np.zeros(3), np.zeros(CHAMBER_COUNT))
    Sequencer(SequencerConfig(robot)).update(0.0, still)


def trace_frames(path: Path) -> Iterator[Seen]:
    """The frames of a recording, those of one time together. Raises TraceError for one that cannot be read."""
    for stamp_s, records in groupby(read_trace(path), key=lambda record: record.t_s):
        yield stamp_s, [record.frame for record in records]


Tell = Callable[[dict[str, Any]], None]
"""Told each finding, as plain values: `event` is "estimate" or "verdict"."""


def watch(shadow: Shadow, came: Iterable[Seen], tell: Tell, every_s: float = 1.0) -> None:
    """Let a shadow see all that comes. `tell` hears each verdict at once, and every `every_s` what is believed."""
    due_s = every_s
    for stamp_s, frames in came:
        for found in shadow.see(stamp_s, frames):
            tell({"event": "verdict", **asdict(found), "severity": shadow.severity(found)})
        if shadow.t_s >= due_s - 1e-9:
            due_s = shadow.t_s + every_s
            tell({"event": "estimate", **asdict(shadow.estimate())})
