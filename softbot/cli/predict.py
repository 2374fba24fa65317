"""`softbot predict`: bend and length of a robot against pressure, with a band where it is made of a known silicone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from softbot.cli.options import Json

if TYPE_CHECKING:
    from softbot.prediction import Prediction


def predict(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="Robot file (TOML), or default.")],
    chamber: Annotated[
        list[int] | None, typer.Option(help="Chamber that is driven, 0 … 3; may be given many times. Default: 0.")
    ] = None,
    max_pressure_kpa: Annotated[
        float | None, typer.Option("--max-pressure-kPa", help="Largest pressure; else the robot's own.")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help='Override a key, as material="Ecoflex 00-30"; many times.'),
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Picture of the curve and its band (PNG, SVG or PDF).")] = None,
    json: Json = False,
) -> None:
    """Predict bend and length against pressure; of a robot with a `material`, with a 95 % band of its stiffness."""
    import json as json_format
    import math

    from softbot.errors import InputError
    from softbot.prediction import predict as predicted
    from softbot.robot import robot_from, robot_table
    from softbot.toml_file import override

    if max_pressure_kpa is not None and not (math.isfinite(max_pressure_kpa) and max_pressure_kpa > 0.0):
        raise InputError(f"--max-pressure-kPa {max_pressure_kpa:g}: give a pressure above zero")
    table, source = robot_table(robot, Path())
    one = robot_from(override(table, settings or []), source)
    largest_Pa = None if max_pressure_kpa is None else 1e3 * max_pressure_kpa
    chambers = tuple(chamber or (0,))
    found = predicted(one, chambers, largest_Pa)
    columns = {
        "pressure_kPa": found.pressure_Pa / 1e3,
        "bend_deg": found.bend_rad * 180.0 / math.pi,
        "length_mm": found.length_m * 1e3,
    }
    for name, array, factor in (
        ("bend_low_deg", found.bend_low_rad, 180.0 / math.pi),
        ("bend_high_deg", found.bend_high_rad, 180.0 / math.pi),
        ("length_low_mm", found.length_low_m, 1e3),
        ("length_high_mm", found.length_high_m, 1e3),
    ):
        if array is not None:
            columns[name] = array * factor
    basis = f"predicted from geometry and {one.material}" if one.material else "the robot file's own law; no band"
    if one.actuator_memory() is not None:
        basis += "; through its memory: loaded once from rest and held"
    closed_Pa = found.full_circle_Pa
    if plot is not None:
        _save(plot, found, f"{one.name}: {basis}", chambers)
    if json:
        listed = {name: [float(f"{value:.6g}") for value in values] for name, values in columns.items()}
        closed = None if closed_Pa is None else float(f"{closed_Pa / 1e3:.4g}")
        about = {"robot": one.name, "basis": basis, "chambers": list(chambers), "full_circle_kPa": closed}
        print(json_format.dumps(about | listed))
        return
    from rich.console import Console
    from rich.table import Table

    shown = Table(title=f"{one.name}: {basis}", title_justify="left")
    for name in columns:
        head, _, unit = name.rpartition("_")
        shown.add_column(f"{head.replace('_', ' ')} ({unit})", justify="right")
    for row in zip(*columns.values(), strict=True):
        shown.add_row(*(f"{value:.1f}" for value in row))
    Console().print(shown)
    if closed_Pa is not None:
        typer.echo(
            f"beyond {closed_Pa / 1e3:.3g} kPa the arc is more than a full circle: the robot's ends touch before, "
            "and it bends no further"
        )
    if plot is not None:
        typer.echo(f"plot: {plot}")


def _save(path: Path, found: Prediction, title: str, chambers: tuple[int, ...]) -> None:
    """Write the picture by the file's ending. Raises InputError where it cannot be written."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from softbot.errors import InputError

    if path.suffix.lower() not in (".png", ".svg", ".pdf"):
        raise InputError(f"{path}: a picture ends in .png, .svg or .pdf")
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    pressure = found.pressure_Pa / 1e3
    degrees = 57.29577951308232
    for axes, value, low, high, factor, label in zip(
        figure.subplots(1, 2),
        (found.bend_rad, found.length_m),
        (found.bend_low_rad, found.length_low_m),
        (found.bend_high_rad, found.length_high_m),
        (degrees, 1e3),
        ("bend (deg)", "length (mm)"),
        strict=True,
    ):
        if low is not None and high is not None:
            axes.fill_between(pressure, low * factor, high * factor, color="#0072b2", alpha=0.2, label="95 % band")
        axes.plot(pressure, value * factor, color="#0072b2", label="prediction")
        axes.set_xlabel(f"gauge pressure of chamber {', '.join(map(str, chambers))} (kPa)")
        axes.set_ylabel(label)
        axes.legend(fontsize=8)
    figure.suptitle(title, fontsize=10)
    try:
        figure.savefig(path, dpi=150)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}; choose another place") from None
