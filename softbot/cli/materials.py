"""`softbot materials`: the library of silicones, their laws, and pictures of the tests behind them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from softbot.cli.options import Json


def materials(
    plot: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for a picture of each test and fit.")] = None,
    json: Json = False,
) -> None:
    """List the silicones that a robot may be predicted from (`material = "Dragon Skin 30"` in its file).

    Moduli are slopes between 3 and 20 % strain; the last column is what the stiffness may be off by, with 95 %. The
    laws' parameters are in what --json prints.
    """
    import json as json_format
    import math

    from softbot.silicone import silicones

    listed = silicones()
    pictures: list[Path] = []
    if plot is not None:
        from calib.tensile_figure import save_figures
        from softbot.cli.streams import messages

        with messages().status("fitting the laws to the tests …"):
            pictures = save_figures(plot)
    if json:
        tables = [one.model_dump(exclude_none=True) for one in listed.values()]
        print(json_format.dumps({"silicones": tables, "pictures": [str(path) for path in pictures]}, allow_nan=False))
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(title="silicones", title_justify="left")
    for heading in ("silicone", "law"):
        table.add_column(heading, no_wrap=True)
    for heading in ("modulus (kPa)", "of the test", "rms (%)", "95 %"):
        table.add_column(heading, justify="right")
    for one in listed.values():
        table.add_row(
            one.name,
            one.law,
            f"{one.small_strain_modulus_Pa / 1e3:.1f}",
            f"{one.measured_small_strain_modulus_Pa / 1e3:.1f}",
            f"{one.rms_percent:.1f}",
            f"×/÷ {math.exp(1.96 * one.stiffness_log_sd):.2f}",
        )
    Console().print(table)
    for path in pictures:
        typer.echo(f"picture: {path}")
