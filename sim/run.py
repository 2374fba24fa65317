"""Runs of open-loop scenes: a scene in, telemetry and summary out.

`simulate` runs drive.kind "curvature" by itself. Driven by pressure, the valves need someone who opens them: a
`ValveController` (the valve board's pressure loop), handed in by whoever composes the run. Scenes that a sequencer
drives are run by the nodes, on a bus.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from sim.body import Body, Twin
from sim.drive import amplitude, curvature_1_m, phase_rad, pressures_Pa, without_chamber
from sim.plant import Plant
from sim.recorder import Recorder, samples_of
from sim.scene import CONTROL_PERIOD_S, Scene
from sim.twins import make_twin, steps_per_period
from softbot.errors import InputError, SimulationError
from softbot.faults import EMPTIES_CHAMBER, PlantConditions
from softbot.sensing import Readings

FloatArray = NDArray[np.float64]
Progress = Callable[[float], None]
"""Told the simulated time [s] now and then."""


class ValveController(Protocol):
    """Setpoints and readings in, valve openings out."""

    def openings(self, setpoint_Pa: FloatArray, readings: Readings) -> FloatArray:
        """Valve openings (4,), −1 … +1, for setpoints (4,) [Pa gauge]."""


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
    progress: Progress = quiet,
    gui: bool = False,
) -> RunResult:
    """Run an open-loop scene. Raises SimulationError when it fails; what was recorded is kept in `run_dir`."""
    if scene.drive.kind == "sequencer":
        raise InputError('drive.kind = "sequencer": is run by softbot.nodes, on a bus')
    twin = make_twin(scene, gui=gui)
    recorder = Recorder(scene, run_dir)
    steps = steps_per_period(twin.step_s)
    try:
        if scene.drive.kind == "curvature":
            advance = _given_curvature(scene, twin, recorder, steps)
        elif valves is None:
            raise InputError('drive.kind = "pressure": needs a valve controller (softbot.nodes.run_scene has one)')
        else:
            advance = _given_pressures(scene, twin, recorder, steps, valves)
        return run_samples(scene, recorder, steps, advance, progress)
    finally:
        twin.close()


def run_samples(
    scene: Scene, recorder: Recorder, steps: int, advance: Callable[[int], None], progress: Progress
) -> RunResult:
    """Call `advance(sample)` for each control period, and finish the recording whatever happens on the way."""
    total = samples_of(scene)
    done = 0
    try:
        for sample in range(total):
            advance(sample)
            done = sample + 1
            if done % 10 == 0:
                progress(done * CONTROL_PERIOD_S)
    except SimulationError as error:
        recorder.finish(done * steps, done * CONTROL_PERIOD_S, f"failed: {error}")
        raise
    except KeyboardInterrupt:
        recorder.finish(done * steps, done * CONTROL_PERIOD_S, "interrupted")
        raise
    return RunResult(*recorder.finish(done * steps, done * CONTROL_PERIOD_S, "done"))


def phase_name(scene: Scene, t_s: float) -> str:
    """The open-loop drive's phase, for the telemetry's `state`."""
    if t_s >= scene.drive.start_s:
        return "turning"
    return "bending" if amplitude(scene.drive, t_s) > 0.0 else "straight"


def _given_curvature(scene: Scene, twin: Twin, recorder: Recorder, steps: int) -> Callable[[int], None]:
    stiffness = Body.of(scene.robot).rest_stiffness()
    conditions = PlantConditions(scene.fault)

    def advance(sample: int) -> None:
        recorder.start_clock()
        for step in range(steps):
            t_s = sample * CONTROL_PERIOD_S + (step + 1) * twin.step_s
            recorder.note_faults(conditions.advance(t_s))
            curvature = curvature_1_m(scene.drive, t_s)
            for fault in conditions.active:
                if fault.kind in EMPTIES_CHAMBER:  # the other kinds need pneumatics, which a given curvature has not
                    curvature = without_chamber(curvature, fault.chamber, fault.severity)
            twin.set_rest(np.array([1.0, *curvature]), stiffness)
            twin.step()
        motion = twin.motion()
        recorder.stop_clock()
        t_s = (sample + 1) * CONTROL_PERIOD_S
        outside = phase_rad(scene.drive, t_s) + math.pi
        recorder.sample(t_s, twin, motion, active_rad=outside, state=phase_name(scene, t_s))

    return advance


def _given_pressures(
    scene: Scene, twin: Twin, recorder: Recorder, steps: int, valves: ValveController
) -> Callable[[int], None]:
    plant = Plant(scene.robot, twin, scene.fault, scene.world.gravity_m_s2, scene.solver.seed)

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
