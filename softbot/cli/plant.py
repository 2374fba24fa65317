"""`softbot plant`: valve board and robot on a CAN bus, in wall-clock time."""

from __future__ import annotations

from typing import Annotated

import typer

from softbot.cli.options import (
    Assignments,
    BusFaultFile,
    Channel,
    Gui,
    Interface,
    Json,
    Out,
    SceneFile,
    SlowMotion,
    Urgent,
)
from softbot.nodes.deciding_board import DecidingBoard

Board = Annotated[
    DecidingBoard,
    typer.Option(help="Which board decides: the one in Python, or the C reference, compiled here."),
]


def plant(
    scene: SceneFile,
    interface: Interface = "socketcan",
    channel: Channel = "vcan0",
    out: Out = None,
    assignments: Assignments = None,
    json: Json = False,
    gui: Gui = False,
    real_time: Urgent = False,
    board: Board = DecidingBoard.PYTHON,
    bus_faults: BusFaultFile = None,
    slow_motion: SlowMotion = 1.0,
) -> None:
    """Be the plant on a CAN bus.

    For the duration of the scene or until stopped; Ctrl-C vents the robot and closes the files. SIGUSR1 makes it say
    how it keeps time.
    """
    import contextlib
    import json as json_format
    from dataclasses import asdict

    from sim.scene import load_scene
    from softbot.cli.board_room import check_board_room
    from softbot.cli.perform import import_twin, kept, print_outcome
    from softbot.cli.run_folder import held, open_run_folder
    from softbot.cli.streams import nothing_printed, progress_bar, say

    checked = load_scene(scene, tuple(assignments or ()))
    check_board_room(checked, scene, tuple(assignments or ()))
    folder = open_run_folder(f"{checked.name}-plant", out)
    import_twin(checked)
    with held(folder), nothing_printed(quiet=False) if json or gui else contextlib.nullcontext():
        from softbot.interruption import stopped_by_signals
        from softbot.nodes.wall_clock import asked_by_signal, run_plant
        from softbot.report import write_report

        title = f"plant on {interface} {channel}"
        with (
            kept(folder),
            stopped_by_signals() as stop,
            asked_by_signal() as asked,
            progress_bar(title, checked.solver.duration_s) as show,
        ):
            run = run_plant(
                checked,
                interface,
                channel,
                folder,
                stop=stop,
                progress=show,
                gui=gui,
                urgent=real_time,
                asked=asked,
                tell=say,
                board=board,
                bus_faults=bus_faults or (),
                slow_motion=slow_motion,
            )
        (folder / "timing.json").write_text(json_format.dumps(asdict(run.timing), indent=2) + "\n", encoding="utf-8")
        write_report(folder)
    say(str(run.timing))
    print_outcome(folder, json=json)
