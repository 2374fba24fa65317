"""`softbot run`: simulate a scene."""

from __future__ import annotations

from softbot.cli.options import Assignments, Gui, Json, Out, SceneFile, WallClock


def run(
    scene: SceneFile,
    out: Out = None,
    assignments: Assignments = None,
    json: Json = False,
    gui: Gui = False,
    wall_clock: WallClock = False,
) -> None:
    """Simulate a scene.

    Writes a run folder: summary, telemetry, bus log and an HTML report.
    """
    from sim.scene import load_scene
    from softbot.cli.perform import perform
    from softbot.cli.run_folder import open_run_folder

    checked = load_scene(scene, tuple(assignments or ()))
    folder = open_run_folder(checked.name, out)
    perform(checked, folder, json=json, gui=gui, wall_clock=wall_clock)
