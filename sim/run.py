"""Runs of open-loop scenes: a scene in, telemetry and summary out.

`simulate` runs drives of a given curvature or contraction by itself: a twin that plays a drive inside compiled code
does so in blocks of half a second, between which rows are recorded, faults strike and an interrupt is heard; any other
twin goes step by step. Where a step is longer than the control period, a twin that knows where it was between two steps
fills in the samples (`sim.between_steps`), unless only the summary is asked for. Driven by pressure, the valves need
someone who opens them: a `ValveController` (the valve board's pressure loop), handed in by whoever composes the run.
Scenes that a sequencer drives are run by the nodes, on a bus.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from sim import motion_rows
from sim.body import Body, BrokenOff, Twin
from sim.drive import active_side_rad, amplitude, bend_1_m, lost_shares, pressures_Pa
from sim.recorder import Record, Recorder, samples_of
from sim.resolution import growing_step_s
from sim.rod_drive import drive_array, rest_curvature
from sim.scene import CONTROL_PERIOD_S, Scene, sample_period_s, steps_per_period
from sim.trajectory import motion_row
from sim.twins import make_twin, world_of
from softbot.errors import InputError, SimulationError
from softbot.faults import FaultTimeline
from softbot.interruption import interruption_asked, raise_if_asked
from softbot.sensing import Readings

FloatArray = NDArray[np.float64]
Progress = Callable[[float], None]
"""Told the simulated time [s] now and then."""

BLOCK_S, BLOCK_STEPS = 0.5, 50
ASLEEP_BLOCK_S = 10.0
"""Simulated time that a twin plays at once, awake (so many steps at least) and asleep: what an interrupt waits for and
what a killed run loses."""
_PROGRESS_S = 0.1


class ValveController(Protocol):
    """Setpoints and readings in, valve openings out."""

    def openings(self, setpoint_Pa: FloatArray, readings: Readings) -> FloatArray:
        """Valve openings (4,), −1 … +1, for setpoints (4,) [Pa gauge]."""


@runtime_checkable
class PlayingTwin(Twin, Protocol):
    """A twin that runs a whole drive inside compiled code."""

    def play(self, drive: FloatArray, samples: int, steps: int) -> FloatArray:
        """Run samples × steps steps under `drive` (`sim.rod_drive.drive_array`); a row of motion for each sample."""


@runtime_checkable
class FilledTwin(PlayingTwin, Protocol):
    """One that knows where it was between two steps."""

    def play_seen(self, drive: FloatArray, samples: int) -> tuple[FloatArray, FloatArray]:
        """A step each sample: rows of motion and where the twin was, before the first and after each."""

    def fill(self, rows: FloatArray, seen: FloatArray, parts: int) -> tuple[FloatArray, FloatArray]:
        """The same after the first, `parts` for each step."""

    def seen_at(self, instant: FloatArray) -> Twin:
        """The twin at one of these, to be looked at."""


@dataclass(frozen=True)
class RunResult:
    """Summary (as in `summary.json`) and telemetry of a run."""

    summary: dict[str, Any]
    telemetry: pa.Table


def quiet(_t_s: float) -> None:
    """No progress."""


def simulate(
    scene: Scene,
    run_dir: Path | None = None,
    *,
    valves: ValveController | None = None,
    record: Record = "all",
    progress: Progress = quiet,
    gui: bool = False,
) -> RunResult:
    """Run an open-loop scene, into `run_dir` or (None) into memory.

    `record`: "all", or in memory "summary": only the columns that the summary is made from (`sim.recorder` says which
    are left out). Raises SimulationError when the run fails; what was recorded is kept in `run_dir`.
    """
    if scene.drive.kind == "sequencer":
        raise InputError('drive.kind = "sequencer": is run by softbot.nodes, on a bus')
    twin = make_twin(scene, gui=gui)
    try:
        if scene.solver.question == "equilibrium":
            return _at_rest(scene, twin, run_dir, record)
        steps = steps_per_period(twin.step_s)
        filled = twin if record == "all" and isinstance(twin, FilledTwin) else None
        sample_s = sample_period_s(twin.step_s) if filled is None else CONTROL_PERIOD_S
        recorder = Recorder(scene, run_dir, record=record, sample_s=sample_s)
        if scene.drive.kind == "pressure":
            if valves is None:
                raise InputError('drive.kind = "pressure": needs a valve controller (softbot.nodes.run_scene has one)')
            return run_samples(scene, recorder, steps, _given_pressures(scene, twin, recorder, steps, valves), progress)
        if isinstance(twin, PlayingTwin):
            advance = _InBlocks(scene, twin, recorder, filled).advance
        else:
            advance = _StepByStep(scene, twin, recorder).advance
        return _run(scene, recorder, twin.step_s, advance, progress)
    finally:
        twin.close()


def _at_rest(scene: Scene, twin: Twin, run_dir: Path | None, record: Record) -> RunResult:
    from sim.equilibrium import run_equilibrium  # not for a motion
    from sim.rod import RodTwin

    assert isinstance(twin, RodTwin)  # a scene with another twin or other bodies is refused
    recorder = Recorder(scene, run_dir, record=record)
    return RunResult(*run_equilibrium(scene, twin, recorder, run_dir))


def run_samples(
    scene: Scene, recorder: Recorder, steps: int, advance: Callable[[int], None], progress: Progress
) -> RunResult:
    """Call `advance(sample)` for each control period, and finish the recording whatever happens on the way."""

    def advance_one(sample: int) -> int:
        advance(sample)
        return 1

    return _run(scene, recorder, CONTROL_PERIOD_S / steps, advance_one, progress)


def _run(
    scene: Scene, recorder: Recorder, step_s: float, advance: Callable[[int], int], progress: Progress
) -> RunResult:
    """Call `advance(done)`, which says how many samples it got on, to the end; the recording is always finished."""
    sample_s, steps = sample_period_s(step_s), steps_per_period(step_s)
    total = samples_of(scene, sample_s)
    between = max(1, round(_PROGRESS_S / sample_s))
    done = told = 0

    def finish(outcome: str) -> RunResult:
        return RunResult(*recorder.finish(done * steps, done * sample_s, outcome))

    try:
        while done < total:
            raise_if_asked()
            done += advance(done)
            if done - told >= between:
                told = done
                progress(done * sample_s)
    except KeyboardInterrupt:
        finish("interrupted")
        raise
    except Exception as error:
        asked = interruption_asked()
        if asked is not None:  # a library that swallowed it may stumble in its wake
            finish("interrupted")
            raise asked from error
        if isinstance(error, SimulationError):
            finish(f"failed: {error}")
        raise
    return finish("done")


def phase_name(scene: Scene, t_s: float) -> str:
    """The open-loop drive's phase, for the telemetry's `state`."""
    return _phase_names(scene, np.array([t_s]))[0]


def _phase_names(scene: Scene, t_s: FloatArray) -> list[str]:
    before = np.where(amplitude(scene.drive, t_s) > 0.0, "bending", "straight")
    names: list[str] = np.where(t_s >= scene.drive.start_s, "turning", before).tolist()
    return names


class _Given:
    """A given curvature with its faults, as the numbers that `sim.rod_drive` takes, and its recording."""

    def __init__(self, scene: Scene, twin: Twin, recorder: Recorder) -> None:
        self._scene, self._recorder = scene, recorder
        self._step_s, self._sample_s = twin.step_s, recorder.sample_s
        self._timeline = FaultTimeline(scene.fault)
        # a fault acts in the step at whose end it is due
        self._strikes = [max(0, math.ceil(fault.t_s / self._step_s - 1e-9) - 1) for fault in self._timeline.faults]
        self._size_1_m = bend_1_m(scene.drive, scene.robot)
        self.numbers = self._numbers()

    def _numbers(self) -> FloatArray:
        robot, lost = self._scene.robot, lost_shares(self._timeline.active)
        muscle = robot.actuation == "muscle"
        return drive_array(
            self._scene.drive,
            lost.tolist(),
            curvature_1_m=self._size_1_m,
            muscle=muscle,
            growing_step_s=growing_step_s(self._scene),
        )

    def strike(self, step: int) -> int | None:
        """Let the faults due in this step strike; steps from here to the next one, None if there is none."""
        active = len(self._timeline.active)
        if active < len(self._strikes) and self._strikes[active] <= step:
            until = self._timeline.faults[active].t_s
            while active < len(self._strikes) and self._strikes[active] <= step:
                until = self._timeline.faults[active].t_s
                active += 1
            self._recorder.note_faults(self._timeline.note(until))
            self.numbers = self._numbers()
        return self._strikes[active] - step if active < len(self._strikes) else None

    def record(self, rows: FloatArray, done: int) -> None:
        """The next samples after the first `done` that were recorded, but for their shapes."""
        t_s = np.asarray((done + 1 + np.arange(len(rows))) * self._sample_s, dtype=np.float64)
        rows[:, motion_rows.TIME] = t_s
        k1, k2 = rows[:, motion_rows.CURVATURE].T
        active = active_side_rad(self._scene.drive, self._scene.robot, t_s, np.arctan2(k2, k1))
        self._recorder.block(rows, active_rad=active, states=_phase_names(self._scene, t_s))


class _InBlocks:
    """A given curvature played by the twin itself, in blocks.

    filled: the twin again, if it is to fill in samples where its step is longer than a control period.
    """

    def __init__(self, scene: Scene, twin: PlayingTwin, recorder: Recorder, filled: FilledTwin | None = None) -> None:
        self._scene, self._twin, self._recorder = scene, twin, recorder
        self._given = _Given(scene, twin, recorder)
        self._sample_s, self._steps = sample_period_s(twin.step_s), steps_per_period(twin.step_s)
        self._total = samples_of(scene, self._sample_s)
        self._parts = round(self._sample_s / recorder.sample_s)
        self._filled = filled if self._parts > 1 else None
        self._asleep = False
        self._failure: SimulationError | None = None

    def advance(self, done: int) -> int:
        """Play and record the next block after `done` samples; its number of samples."""
        if self._failure is not None:
            raise self._failure
        end, parts, at = done + self._block(done), [], done
        try:
            while at < end:
                rows = self._play(at, end) if self._filled is None else self._play_filled(self._filled, at, end)
                parts.append(rows)
                at += len(rows) // self._parts
                self._asleep = bool(rows[-1, motion_rows.ASLEEP] == 1.0)
        except SimulationError as error:
            if isinstance(error, BrokenOff) and len(error.rows) > 0:
                parts.append(error.rows)
                at += len(error.rows) // self._parts
            if not parts:
                raise
            self._failure = error  # once what came before it is recorded
        self._given.record(np.concatenate(parts), done * self._parts)
        return at - done

    def _play(self, at: int, end: int) -> FloatArray:
        """Samples from `at` on: to the next that has a shape, or to where a fault strikes, but not beyond `end`."""
        every, steps = self._recorder.shape_every, self._steps
        count = end - at
        if every is not None:
            undisturbed = self._undisturbed(at) if self._asleep else 0
            count = min(count, max(undisturbed, -at % every + 1))
        ahead = self._given.strike(at * steps)
        if ahead is not None and ahead < count * steps:
            count = max(1, ahead // steps)
        self._recorder.start_clock()
        if ahead is None or ahead >= count * steps:
            rows = self._twin.play(self._given.numbers, count, steps)
        else:
            rows = self._split_sample(at * steps, ahead)
        self._recorder.stop_clock()
        if every is not None:
            self._record_shapes(rows, at, every)
        return rows

    def _play_filled(self, twin: FilledTwin, at: int, end: int) -> FloatArray:
        """Samples from `at` on, to where a fault strikes, but not beyond `end`, each a step with samples in it."""
        parts, first = self._parts, at * self._parts
        undisturbed = self._undisturbed(at) if self._asleep else 0
        count = end - at if undisturbed < 1 else min(end - at, undisturbed)
        ahead = self._given.strike(at)
        if ahead is not None and ahead < count:
            count = max(1, ahead)
        self._recorder.start_clock()
        if undisturbed > 0:
            rows = np.repeat(twin.play(self._given.numbers, count, 1), parts, axis=0)
            self._recorder.stop_clock()
            self._recorder.shape([(n + 1) * self._recorder.sample_s for n in self._due(first, len(rows))], twin)
            return rows
        broken = None
        try:
            rows, seen = twin.play_seen(self._given.numbers, count)
        except BrokenOff as error:
            broken, rows, seen = error, error.rows, error.seen
        self._recorder.stop_clock()
        rows, seen = twin.fill(rows, seen, parts)
        for n in self._due(first, len(rows)):
            self._recorder.shape(((n + 1) * self._recorder.sample_s,), twin.seen_at(seen[n - first]))
        if broken is not None:
            broken.rows = rows
            raise broken
        return rows

    def _due(self, first: int, count: int) -> range:
        """Samples from `first` on that have a shape."""
        every = self._recorder.shape_every
        return range(first + -first % every, first + count, every) if every is not None else range(0)

    def _undisturbed(self, at: int) -> int:
        """Samples from `at` on in which the drive leaves a sleeping robot alone, so that its shape stays."""
        drive = self._scene.drive
        if bend_1_m(drive, self._scene.robot) == 0.0:
            return self._total
        return math.floor((drive.start_s - drive.ramp_s) / self._sample_s) - 1 - at

    def _split_sample(self, step: int, ahead: int | None) -> FloatArray:
        """One sample, which begins at `step` and in the middle of which a fault strikes."""
        end = step + self._steps
        while True:
            part = end - step if ahead is None else min(ahead, end - step)
            rows = self._twin.play(self._given.numbers, 1, part)
            step += part
            if step == end:
                return rows
            ahead = self._given.strike(step)

    def _record_shapes(self, rows: FloatArray, at: int, every: int) -> None:
        """The shape at the last of these samples, if it has one; a robot that slept had the same all along."""
        last = at + len(rows) - 1
        slept = self._asleep and bool(np.all(rows[:, motion_rows.ASLEEP] == 1.0))
        due = self._due(at, len(rows)) if slept else range(last, last + (last % every == 0))
        if len(due):
            self._recorder.shape([(n + 1) * self._sample_s for n in due], self._twin)

    def _block(self, done: int) -> int:
        """Samples to play between two looks at the outside world."""
        block_s = ASLEEP_BLOCK_S if self._asleep else max(BLOCK_S, BLOCK_STEPS * self._twin.step_s)
        return min(max(1, math.floor(block_s / self._sample_s + 1e-9)), self._total - done)


class _StepByStep:
    """A given curvature for a twin that cannot play it."""

    def __init__(self, scene: Scene, twin: Twin, recorder: Recorder) -> None:
        self._twin, self._recorder = twin, recorder
        self._given = _Given(scene, twin, recorder)
        self._sample_s, self._steps = sample_period_s(twin.step_s), steps_per_period(twin.step_s)
        self._stiffness = Body.of(scene.robot).rest_stiffness()
        self._lagged_1_m = np.zeros(2)

    def advance(self, done: int) -> int:
        """One sample."""
        self._recorder.start_clock()
        for step in range(done * self._steps, (done + 1) * self._steps):
            self._given.strike(step)
            self._twin.set_rest(np.array([1.0, *self._rest_1_m(step)]), self._stiffness)
            self._twin.step()
        motion = self._twin.motion()
        self._recorder.stop_clock()
        every = self._recorder.shape_every
        if every is not None and done % every == 0:
            self._recorder.shape(((done + 1) * self._sample_s,), self._twin)
        self._given.record(motion_row(motion)[None], done)
        return 1

    def _rest_1_m(self, step: int) -> tuple[float, float]:
        """Rest curvature at the end of the step, as the rod's compiled loop has it."""
        step_s = self._twin.step_s
        _, k1, k2 = self._twin.strain()
        numbers = self._given.numbers
        asked: tuple[float, float] = _rest_curvature(numbers, step * step_s, step_s, 1.0, k1, k2, self._lagged_1_m)
        return asked


_rest_curvature = rest_curvature.py_func  # compiled it can be called from compiled code only


def _given_pressures(
    scene: Scene, twin: Twin, recorder: Recorder, steps: int, valves: ValveController
) -> Callable[[int], None]:
    from sim.plant import Plant  # gas and sensors: not for a given curvature

    gravity_m_s2 = world_of(scene).gravity_vector_m_s2
    plant = Plant(scene.robot, twin, scene.fault, gravity_m_s2, scene.solver.seed)

    def advance(sample: int) -> None:
        setpoint = pressures_Pa(scene.drive, sample * CONTROL_PERIOD_S)
        recorder.start_clock()
        opening = valves.openings(setpoint, plant.read_sensors())
        struck = plant.advance(opening, True, steps)
        recorder.stop_clock()
        recorder.note_faults(struck)
        recorder.sample(
            plant.t_s,
            twin,
            plant.motion,
            pressure_Pa=plant.pressure_Pa,
            command_Pa=setpoint,
            state=phase_name(scene, plant.t_s),
        )

    return advance
