"""`softbot figure`: a figure of the theory and the twins, made again from nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from softbot.cli.options import Json

PACKAGES = ("sim.figures", "softbot.nodes.figures")
"""Where there are figures: of theory and twins, and of a robot under its sequencer."""


def figure(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="Figure; without it they are listed.")] = None,
    out: Annotated[Path | None, typer.Option(help="Picture (PNG, SVG or PDF). Default: NAME.png here.")] = None,
    options: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Set an option of the figure; may be given many times."),
    ] = None,
    json: Json = False,
) -> None:
    """Draw a figure: the paper's curvature, moments and recovery, maps and margins of the twins."""
    import json as json_format

    from sim.figures import draw, figures
    from softbot.cli.streams import messages, nothing_printed
    from softbot.cli.written_file import PICTURES, can_be_written
    from softbot.toml_file import override

    if name is None:
        listed = figures(PACKAGES)
        text = "\n".join(f"{one:24} {line}" for one, line in listed.items())
        typer.echo(json_format.dumps({"figures": listed}) if json else text)
        return
    path = out or Path(f"{name}.png")
    if out is not None:
        can_be_written("--out", out, PICTURES)
    with messages().status(f"drawing {name} (the first time the twins are compiled) …"), nothing_printed(quiet=json):
        drawn = draw(name, path, override({}, options or []), PACKAGES)
    if json:
        typer.echo(json_format.dumps({"figure": name, "path": str(path), **drawn}, allow_nan=False))
        return
    for key, value in drawn.items():
        if isinstance(value, int | float | str):
            typer.echo(f"{key}: {value:.4g}" if isinstance(value, float) else f"{key}: {value}")
    typer.echo(f"figure: {path}")
