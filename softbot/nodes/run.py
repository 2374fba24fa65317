"""Any scene in, its run out: who drives the robot follows from `drive.kind`."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from sim.plan import GIVEN
from sim.recorder import Record
from sim.run import Progress, RunResult, quiet, simulate
from sim.scene import Scene
from softbot.nodes.warm_up import warm_up
from softbot.robot import Robot


def run_scene(
    scene: Scene,
    run_dir: Path | None = None,
    *,
    record: Record = "all",
    progress: Progress = quiet,
    gui: bool = False,
    known: Robot | None = None,
) -> RunResult:
    """Run a scene, into `run_dir` or (None) into memory, where `record = "summary"` keeps what the summary needs.

    "curvature" and "contraction": the twin alone; "pressure": the plant with the pressure loop on its valves;
    "sequencer": plant and sequencer in lock-step on a bus. What a scene has no use for is not imported.

    known: the robot that controller and board believe in, where it is another than the scene's.

    Raises InputError for a scene that cannot be run, SimulationError when it fails; when it fails or is interrupted,
    what was recorded is kept.
    """
    warm_up(scene)
    if scene.drive.kind in GIVEN:
        return simulate(scene, run_dir, record=record, progress=progress, gui=gui)
    if scene.drive.kind == "pressure":
        from softbot.nodes.valve_loop import ValveLoop

        return simulate(
            scene, run_dir, valves=ValveLoop(known or scene.robot), record=record, progress=progress, gui=gui
        )
    from softbot.nodes.lockstep import run_lockstep

    return run_lockstep(scene, run_dir, record=record, progress=progress, gui=gui, known=known)


def paced(
    progress: Progress,
    *,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Progress:
    """A progress that also holds a run back to wall-clock time, for watching it; a slower run is left alone."""
    started_s: float | None = None

    def hold(t_s: float) -> None:
        nonlocal started_s
        if started_s is None:
            started_s = clock() - t_s
        progress(t_s)
        ahead_s = started_s + t_s - clock()
        if ahead_s > 0.0:
            sleep(ahead_s)

    return hold
