"""`softbot run`: simulate a scene, or explain how it would be solved."""

from __future__ import annotations

from typing import Annotated

import typer

from softbot.cli.options import Assignments, Gui, Json, Out, SceneFile, WallClock


def run(
    scene: SceneFile,
    out: Out = None,
    assignments: Assignments = None,
    json: Json = False,
    gui: Gui = False,
    wall_clock: WallClock = False,
    explain: Annotated[
        bool,
        typer.Option("--explain", help="Run nothing: print how fine the twin would be, what is left out, and why."),
    ] = False,
) -> None:
    """Simulate a scene.

    Writes a run folder: summary, telemetry, bus log and an HTML report.
    """
    from sim.scene import load_scene

    checked = load_scene(scene, tuple(assignments or ()))
    if explain:
        from softbot.cli.explanation import explain_plan

        explain_plan(checked, json=json)
        return
    from softbot.cli.board_room import check_board_room
    from softbot.cli.perform import perform
    from softbot.cli.run_folder import open_run_folder

    check_board_room(checked, scene, tuple(assignments or ()))
    folder = open_run_folder(checked.name, out)
    perform(checked, folder, json=json, gui=gui, wall_clock=wall_clock)
