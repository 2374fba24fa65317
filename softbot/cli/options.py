"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE.toml", help="Scene file.")]
Assignments = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="A.B=VALUE", help="Override a value of the scene; may be given many times."),
]
Out = Annotated[
    Path | None,
    typer.Option(
        help="Folder of the run; an earlier run in it is replaced. Default: a new folder under runs/.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
Gui = Annotated[bool, typer.Option("--gui", help="Show PyBullet's window (segment twin only).")]
WallClock = Annotated[bool, typer.Option("--wall-clock", help="Not faster than real time, for watching.")]
Interface = Annotated[str, typer.Option(help="python-can's name of the bus: socketcan, hub, slcan, pcan, …")]
Channel = Annotated[str, typer.Option(help="Channel of the bus, as python-can names it.")]
Urgent = Annotated[
    bool, typer.Option("--real-time", help="Ask for real-time priority and for memory that is not swapped out.")
]
SlowMotion = Annotated[
    float,
    typer.Option(
        "--slow-motion",
        metavar="TIMES",
        help="Seconds of the clock that a second of the robot lasts, the same for both ends: for machines too slow.",
    ),
]
BusFaultFile = Annotated[
    Path | None,
    typer.Option(
        "--bus-faults",
        metavar="FAULTS.toml",
        help="Faults of the bus at this end ([[bus_fault]] tables); the file may be edited in the run.",
    ),
]
