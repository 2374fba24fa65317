"""The commands by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import typer

import softbot
from softbot.cli.bench import bench
from softbot.cli.calibrate import calibrate
from softbot.cli.campaign import campaign
from softbot.cli.demo import demo
from softbot.cli.exit_status import with_exit_status
from softbot.cli.figure import figure
from softbot.cli.hub import hub
from softbot.cli.inverse import inverse
from softbot.cli.materials import materials
from softbot.cli.monitor import monitor
from softbot.cli.parameters import parameters
from softbot.cli.plant import plant
from softbot.cli.predict import predict
from softbot.cli.pressure_loop import pressure_loop
from softbot.cli.replay import replay
from softbot.cli.report import report
from softbot.cli.run import run
from softbot.cli.sequence import sequence
from softbot.cli.shadow import shadow

app = typer.Typer(
    name="softbot",
    help="Digital twin and controller of a rolling four-chamber pneumatic soft robot.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # rich would cost half of the time that help takes
)

_COMMANDS: dict[str, Callable[..., None]] = {
    "demo": demo,
    "run": run,
    "report": report,
    "calibrate": calibrate,
    "materials": materials,
    "predict": predict,
    "inverse": inverse,
    "pressure-loop": pressure_loop,
    "plant": plant,
    "sequence": sequence,
    "hub": hub,
    "monitor": monitor,
    "parameters": parameters,
    "replay": replay,
    "shadow": shadow,
    "campaign": campaign,
    "bench": bench,
    "figure": figure,
}
for _name, _command in _COMMANDS.items():
    app.command(_name)(with_exit_status(_command))


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"softbot {softbot.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass
