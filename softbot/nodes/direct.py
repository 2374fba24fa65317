"""Sequencer, valve board and rod in lock-step without frames, in compiled code: for thousands of runs.

The same controller, pressure loop, plant, sensors and rod as on the bus, in the same order (board, sequencer, robot),
with the bus's rounding and the cycles that arming takes (`softbot.nodes.ideal_bus`); what is missing is the frames
themselves. A run through here is the run through `softbot.nodes.lockstep` (tests/nodes/test_direct.py).

The controller may believe in another robot than the one that is simulated: `known`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.interface import STATES, Detection, Recovery
from controllers.manifold_relief import relief_memory, relieve_manifold
from controllers.offer import recovery_of
from controllers.pressure_loop import PressureLoopGains, pack_pressure_loop, pressure_loop_step
from controllers.sequencer import cycle as sequencer_cycle
from controllers.sequencer import give_order
from controllers.sequencer_parts import SequencerConfig, SequencerMemory, SequencerParts, sequencer_memory
from sim.motion_rows import ROW_SIZE, TIME
from sim.plant import Plant
from sim.plant_kernel import DONE, PlantParts, RodParts, failure, handed_play, rod_period
from sim.recorder import Record, Recorder, active_side_rad, samples_of
from sim.rod import RodTwin
from sim.rod_kernel import play
from sim.rod_memory import Physics, carve
from sim.run import RunResult
from sim.scene import CONTROL_PERIOD_S, Scene
from sim.sensors import DRAWS, read_sensors
from sim.twins import make_twin, steps_per_period, world_of
from softbot.errors import InputError, SimulationError
from softbot.faults import CHAMBER_COUNT, KINDS
from softbot.kernel_compiler import kernel, part
from softbot.kernel_entry import entry, handed
from softbot.nodes.ideal_bus import (
    BusRules,
    answer_board,
    board_cycle,
    bus_memory,
    bus_rules,
    hear_board,
    tell_readings,
)
from softbot.nodes.plant_node import board_limits
from softbot.nodes.sequencer_node import ordered, sequencer_tuning
from softbot.nodes.valve_loop import designed_gains, nominal_volumes_m3
from softbot.robot import Robot
from softbot.sensing import READINGS

FloatArray = NDArray[np.float64]
_MOST_EVENTS = 64
_ALOFT = 0  # of the rod's flags


class Valves(NamedTuple):
    """The pressure loop as compiled code takes it, and its memory."""

    packed: FloatArray
    reference_Pa: FloatArray
    model_Pa: FloatArray
    integral_Pa_s: FloatArray
    opening: FloatArray
    """Commanded from this cycle on."""
    acted: FloatArray
    """Commanded until this cycle."""
    main_supply_shut: NDArray[np.bool_]
    """Shape (1,), until this cycle."""
    relief: Any
    """Memory of `controllers.manifold_relief`."""


class Heard(NamedTuple):
    """What the sequencer found and answered: rows (time, chamber, kind, confidence) and (time, strategy, and
    how far a stop leaves it to be pushed to the left and right), and how many."""

    found: FloatArray
    answers: FloatArray
    counts: NDArray[np.int64]


class Traces(NamedTuple):
    """What is kept of a run, a row for each cycle from where the loop was called; see TRACE. `rows` may be empty."""

    trace: FloatArray
    rows: FloatArray


TRACE = (
    "t_s",
    "roll_rad",
    "x_m",
    "y_m",
    "heading_rad",
    "estimated_roll_rad",
    "curvature_1_1_m",
    "curvature_2_1_m",
    "side",
    "state",
    "heard_state",
    "supply_Pa",
    *(f"pressure_{i}_Pa" for i in range(CHAMBER_COUNT)),
    *(f"setpoint_{i}_Pa" for i in range(CHAMBER_COUNT)),
)
"""Columns of a trace: roll (unwrapped), place of the middle and heading of the tangent, all true; what the sequencer
believes and does; true pressures, and setpoints as the board obeys them."""
_ROLL = TRACE.index("roll_rad")
_FIRST_PRESSURE, _FIRST_SETPOINT = TRACE.index("pressure_0_Pa"), TRACE.index("setpoint_0_Pa")


@kernel(nogil=True)
def cycles(
    play: Any,
    rod_period: Any,
    sequencer_cycle: Any,
    read_sensors: Any,
    rules: BusRules,
    bus: Any,
    sequencer: SequencerParts,
    memory: SequencerMemory,
    plant: PlantParts,
    plant_memory: Any,
    conditions: FloatArray,
    rod: RodParts,
    physics: Physics,
    hold: FloatArray,
    no_rows: FloatArray,
    sensor_memory: Any,
    draws: FloatArray,
    reading: Any,
    heard_reading: Any,
    valves: Valves,
    heard: Heard,
    traces: Traces,
    first: int,
    count: int,
    period_s: float,
    steps: int,
) -> int:
    """`count` control cycles from number `first` on; as many rows of `traces`.

    DONE, or what `rod_period` says of the cycle that failed and ten times its number, from 0.
    """
    own, state, truth = memory.own[0], carve(rod.memory, rod.places)[1], plant_memory[0]
    look = np.zeros((1, traces.rows.shape[1]))
    pressure_Pa = np.zeros(CHAMBER_COUNT + 1)
    for n in range(count):
        cycle = first + n
        t_s = np.round(1e6 * (cycle * period_s)) / 1e6
        velocity = state.velocity
        if state.flag[_ALOFT] == 1.0:  # the base's own velocity is not yet what its momentum asks for
            play(rod.memory, rod.places, physics, hold, 1, 0, look, no_rows)
            spin, speed = look[0, 13:16], look[0, 16:19]
        else:
            spin, speed = velocity[3:6], velocity[0:3]
        for i in range(CHAMBER_COUNT + 1):
            pressure_Pa[i] = truth.pressure_Pa[i]
        read_sensors(
            sensor_memory,
            cycle * steps * rod.step_s,
            state.rotation,
            spin,
            speed,
            pressure_Pa,
            valves.opening,
            conditions,
            draws[n],
            reading,
        )
        seen = reading[0]
        for i in range(CHAMBER_COUNT):
            valves.acted[i] = valves.opening[i]
        obeys = board_cycle(rules, bus, seen.pressure_Pa)
        board = bus[0]
        if obeys:
            pressure_loop_step(
                valves.reference_Pa,
                valves.model_Pa,
                valves.integral_Pa_s,
                valves.opening,
                board.setpoint_Pa,
                seen.pressure_Pa,
                seen.supply_Pa,
                valves.packed,
            )
        else:
            for i in range(CHAMBER_COUNT):
                valves.reference_Pa[i] = valves.model_Pa[i] = seen.pressure_Pa[i]
                valves.integral_Pa_s[i] = 0.0
                valves.opening[i] = -1.0
        relieves = relieve_manifold(
            valves.relief, seen.pressure_Pa, seen.supply_Pa, rules.over_pressure_Pa, not obeys, valves.opening
        )
        tell_readings(rules, seen, valves.acted, valves.main_supply_shut[0], heard_reading[0])
        valves.main_supply_shut[0] = relieves or not obeys
        heard_reading[0].t_s = t_s
        own.armed = hear_board(rules, bus, cycle)
        sequencer_cycle(sequencer, memory, heard_reading, t_s)
        _keep_events(memory, heard, t_s)
        answer_board(rules, bus, cycle, t_s, own.wants_armed, own.setpoint_Pa, own.state)
        done = rod_period(
            play,
            plant,
            plant_memory,
            conditions,
            rod,
            physics,
            hold,
            no_rows,
            valves.opening,
            not valves.main_supply_shut[0],
            cycle * steps,
            steps,
        )
        if done != DONE:
            return done + 10 * n
        row, estimate = traces.trace[n], memory.estimator[0]
        rotation = state.rotation
        row[0] = (cycle + 1) * steps * rod.step_s
        roll = math.atan2(rotation[2, 0], rotation[2, 1])
        before = traces.trace[n - 1, _ROLL] if n > 0 else traces.trace[traces.trace.shape[0] - 1, _ROLL]
        row[1] = before + (roll - before) - 2.0 * math.pi * np.round((roll - before) / (2.0 * math.pi))
        row[2], row[3] = state.position_m[0], state.position_m[1]
        row[4] = math.atan2(rotation[1, 2], rotation[0, 2])
        row[5] = estimate.roll_rad
        row[6], row[7] = state.strain[1], -state.strain[0]
        row[8], row[9], row[10] = own.side, own.state, board.heard_state
        row[11] = truth.pressure_Pa[CHAMBER_COUNT]
        for i in range(CHAMBER_COUNT):
            row[_FIRST_PRESSURE + i] = truth.pressure_Pa[i]
            row[_FIRST_SETPOINT + i] = board.setpoint_Pa[i] if obeys else 0.0
        if traces.rows.shape[0] > 0:
            play(rod.memory, rod.places, physics, hold, 1, 0, traces.rows[n : n + 1], no_rows)
    return DONE


@part()
def _keep_events(memory: SequencerMemory, heard: Heard, t_s: float) -> None:
    own, detector = memory.own[0], memory.detector.own[0]
    for e in range(detector.found):
        k = heard.counts[0]
        if k < heard.found.shape[0]:
            heard.found[k, 0], heard.found[k, 1] = t_s, detector.found_chamber[e]
            heard.found[k, 2], heard.found[k, 3] = detector.found_kind[e], detector.found_confidence[e]
            heard.counts[0] = k + 1
    for e in range(own.answered):
        k = heard.counts[1]
        if k < heard.answers.shape[0]:
            heard.answers[k, 0], heard.answers[k, 1] = t_s, own.answer[e]
            heard.answers[k, 2], heard.answers[k, 3] = own.offered_rad[0], own.offered_rad[1]
            heard.counts[1] = k + 1


@lru_cache(maxsize=16)
def _known(robot: str, tuning: tuple[tuple[str, Any], ...], gains: PressureLoopGains | None) -> Any:
    """Controller and pressure loop of a robot file's text: the same for thousands of runs."""
    known = Robot.model_validate_json(robot)
    gains = gains or designed_gains(known)
    parts = SequencerConfig(known, **dict(tuning), setpoint_rate_Pa_s=gains.setpoint_rate_Pa_s).parts()
    volumes_m3 = nominal_volumes_m3(known)
    return parts, pack_pressure_loop(gains, known.pneumatics, volumes_m3), bus_rules(board_limits(known))


_ENTRIES: dict[tuple[type, ...], Callable[..., int]] = {}
"""Ways into `cycles` of this process, by the types of the numbers of the wall's law."""


@dataclass
class DirectRun:
    """One run of a scene under its sequencer, without a bus. `advance` cycles; the rest is to be read.

    known: the robot that controller and board believe in; None: the scene's own. rows: whether rows of motion are kept
    beside the trace. gains: of the pressure loop; None: designed for the known robot.
    """

    scene: Scene
    known: Robot | None = None
    rows: bool = False
    gains: PressureLoopGains | None = None

    def __post_init__(self) -> None:
        scene, own = self.scene, self.scene.sequencer
        if scene.drive.kind != "sequencer" or scene.solver.twin != "rod" or scene.body:
            raise InputError(
                'a run without a bus: takes drive.kind = "sequencer", solver.twin = "rod" and no other bodies; '
                "softbot.nodes.lockstep runs any"
            )
        known = self.known or scene.robot
        twin = make_twin(scene)
        assert isinstance(twin, RodTwin)
        self.twin = twin
        self.plant = Plant(scene.robot, twin, scene.fault, world_of(scene).gravity_vector_m_s2, scene.solver.seed)
        self.sequencer, packed, self._rules = _known(
            known.model_dump_json(by_alias=True, exclude_none=True),
            tuple(sequencer_tuning(own).items()),
            self.gains,
        )
        self.memory = sequencer_memory()
        self._bus = bus_memory()
        reference, model, integral, opening, acted = (np.zeros(CHAMBER_COUNT) for _ in range(5))
        shut = np.ones(1, dtype=np.bool_)
        relief = relief_memory(known.pneumatics.valve_lag_s, CONTROL_PERIOD_S)
        self._valves = Valves(packed, reference, model, integral, opening, acted, shut, relief)
        self.heard = Heard(np.zeros((_MOST_EVENTS, 4)), np.zeros((_MOST_EVENTS, 4)), np.zeros(2, dtype=np.int64))
        self._readings = np.zeros(1, READINGS).view(np.recarray), np.zeros(1, READINGS).view(np.recarray)
        self._steps = steps_per_period(twin.step_s)
        self._order_cycle = max(0, math.ceil(own.start_s / CONTROL_PERIOD_S - 1e-7))
        self._last_roll_rad = 0.0
        self.done = 0
        """Cycles so far."""

    def advance(self, count: int) -> Traces:
        """Run `count` control cycles; their trace and, where they are kept, rows of motion. Raises SimulationError."""
        traces = Traces(np.empty((count, len(TRACE))), np.empty((count if self.rows else 0, ROW_SIZE)))
        at = 0
        while at < count:
            if self.done == self._order_cycle:
                give_order(self.memory, ordered(self.scene.sequencer), self.done * CONTROL_PERIOD_S)
            part = self._until_something_changes(count - at)
            self._run(Traces(traces.trace[at : at + part], traces.rows[at : at + part]), part)
            at += part
        return traces

    def _until_something_changes(self, most: int) -> int:
        """Cycles that compiled code may run by itself: to the order, to the next change of the floor."""
        part = most
        if self.done < self._order_cycle:
            part = min(part, self._order_cycle - self.done)
        now_s = self.done * CONTROL_PERIOD_S
        if not self.plant.floor.changes_between(now_s, now_s + part * CONTROL_PERIOD_S):
            return part
        for n in range(1, part):
            if self.plant.floor.changes_between(now_s, now_s + n * CONTROL_PERIOD_S):
                return n
        return part

    def _run(self, traces: Traces, count: int) -> None:
        plant, twin = self.plant, self.twin
        plant.floor.lay(plant.t_s)
        assert plant.rod is not None
        traces.trace[-1, _ROLL] = self._last_roll_rad
        arguments = (
            self._rules,
            self._bus,
            self.sequencer,
            self.memory,
            *plant.period_arguments(twin),
            plant.sensors.memory,
            plant.sensors.random.standard_normal((count, DRAWS)),
            *self._readings,
            self._valves,
            self.heard,
            traces,
            self.done,
            count,
            CONTROL_PERIOD_S,
            self._steps,
        )
        done = self._entry(arguments)(play, rod_period, sequencer_cycle, read_sensors, *arguments)
        if done != DONE:
            t_s = (self.done + done // 10) * CONTROL_PERIOD_S
            raise SimulationError(failure(done % 10, t_s, plant.pressure_Pa))
        self.done += count
        self._last_roll_rad = float(traces.trace[-1, _ROLL])
        self.struck = plant.moved_to(self.done * self._steps)

    def _entry(self, arguments: tuple[Any, ...]) -> Callable[..., int]:
        # finding out the types of sixty arrays takes as long as half a run; only the wall's law has others
        types = tuple(type(one) for one in (*self.plant.parts.section, *self.sequencer.model.section))
        if types not in _ENTRIES:
            _ENTRIES[types] = self._compiled(arguments)
        return _ENTRIES[types]

    def _compiled(self, arguments: tuple[Any, ...]) -> Callable[..., int]:
        plant, twin = self.plant, self.twin
        moved = handed_play(twin)
        opening = self._valves.opening
        return entry(
            cycles,
            moved,
            handed(rod_period, moved, *plant.period_arguments(twin), opening, True, 0, 1),
            handed(sequencer_cycle, self.sequencer, self.memory, self._readings[1], 0.0),
            handed(
                read_sensors,
                plant.sensors.memory,
                0.0,
                twin._state.rotation,
                opening[0:3],
                opening[0:3],
                plant.pressure_Pa,
                opening,
                plant.conditions.packed,
                opening,
                self._readings[0],
            ),
            *arguments,
        )

    def detections(self) -> list[Detection]:
        """Faults that the sequencer has named so far."""
        return [
            Detection(float(t_s), int(chamber), str(KINDS[int(kind) - 1]), float(confidence))
            for t_s, chamber, kind, confidence in self.heard.found[: self.heard.counts[0]]
        ]

    def recoveries(self) -> list[Recovery]:
        """Changes of strategy so far."""
        answers = self.heard.answers[: self.heard.counts[1]].tolist()
        return [recovery_of(t_s, int(n), left_rad, right_rad) for t_s, n, left_rad, right_rad in answers]


def run_direct(
    scene: Scene, known: Robot | None = None, *, record: Record = "all", gains: PressureLoopGains | None = None
) -> RunResult:
    """Run a scene that a sequencer drives, into memory and without a bus: summary and telemetry as of any run.

    known: the robot that controller and board believe in. Raises InputError for a scene with another twin or other
    bodies, SimulationError when the run fails.
    """
    run = DirectRun(scene, known, rows=True, gains=gains)
    recorder = Recorder(scene, None, record=record)
    total = samples_of(scene)
    recorder.start_clock()
    traces = run.advance(total)
    recorder.stop_clock()
    rows, trace = traces.rows, traces.trace
    rows[:, TIME] = trace[:, 0]
    pressure = np.column_stack([trace[:, _FIRST_PRESSURE : _FIRST_PRESSURE + 4], trace[:, TRACE.index("supply_Pa")]])
    recorder.block(
        rows,
        pressure_Pa=pressure,
        command_Pa=trace[:, _FIRST_SETPOINT : _FIRST_SETPOINT + 4],
        active_rad=np.array([active_side_rad(row) for row in pressure[:, :4]]),
        states=[str(STATES[int(state)]) for state in trace[:, TRACE.index("heard_state")]],
    )
    recorder.note_faults(run.plant.conditions.active)
    recorder.events.detections = [asdict(found) for found in run.detections()]
    recorder.events.recoveries = [answer.entry() for answer in run.recoveries()]
    return RunResult(*recorder.finish(run.plant.steps, run.plant.t_s, "done"))


def warm_up(scene: Scene) -> None:
    """Compile what a run without a bus needs, so that a campaign's processes find it on disk."""
    DirectRun(scene).advance(1)
