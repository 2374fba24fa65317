"""`softbot replay`: what the sequencer makes of a recorded bus."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from softbot.cli.options import Assignments, Json
from softbot.spoken_fault import spoken_where

if TYPE_CHECKING:
    from softbot.nodes.replay import Replay


def replay(
    trace: Annotated[
        Path, typer.Argument(metavar="TRACE", help="Recording of a bus: .log (candump -L), .asc or .blf.")
    ],
    scene: Annotated[Path, typer.Option("--scene", metavar="SCENE.toml", help="Scene with robot and orders.")],
    assignments: Assignments = None,
    json: Json = False,
) -> None:
    """Run the sequencer's estimation and fault detection over a recorded bus.

    Says what it finds beside what the sequencer of the recording said.
    """
    import json as json_format

    from sim.scene import load_scene
    from softbot.nodes.replay import replay_trace
    from softbot.nodes.wall_clock import check_drive

    checked = load_scene(scene, tuple(assignments or ()))
    check_drive(checked, "replay")
    found = replay_trace(trace, checked.robot)
    typer.echo(json_format.dumps(found.report()) if json else in_words(found))


def in_words(found: Replay) -> str:
    """A replay in some lines."""
    lines = [
        f"{found.duration_s:.2f} s, armed for {found.armed_s:.2f} s: {found.samplings} samplings in {found.accepted} "
        f"frames of the board; {found.refused} refused"
    ]
    for one in found.detections:
        kind = str(one.kind).replace("_", " ")
        lines.append(f"found     {one.t_s:.2f} s: {spoken_where(one.chamber)}, {kind} ({100.0 * one.confidence:.0f} %)")
    if not found.detections:
        lines.append("found     nothing")
    for told in found.recorded:
        kind = str(told["kind"]).replace("_", " ")
        lines.append(f"recorded  {told['t_s']:.2f} s: {spoken_where(told['chamber'])}, {kind}")
    return "\n".join(lines)
