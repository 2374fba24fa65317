"""`softbot calibrate`: from a bending-angle–pressure table to a robot file, with the evidence for it."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from calib.calibration import Calibration


def calibrate(
    table: Annotated[Path, typer.Argument(help="CSV or .xlsx with pressures and bends: pressure_kPa,bend_deg …")],
    out: Annotated[Path | None, typer.Option(help="Robot file to write (TOML).")] = None,
    length_mm: Annotated[float | None, typer.Option(help="Length at rest; else from the table, or assumed.")] = None,
    radius_mm: Annotated[float | None, typer.Option(help="Outer radius; else fitted, or assumed.")] = None,
    mass_g: Annotated[float | None, typer.Option(help="Mass; else from the wall's volume and 1100 kg/m3.")] = None,
    columns: Annotated[
        str | None,
        typer.Option(help="What the header does not say: pressure=HEADER:kPa,bend=HEADER:deg (or column numbers)."),
    ] = None,
    sheet: Annotated[str | None, typer.Option(help="Sheet of a workbook that has several tables.")] = None,
    law: Annotated[str, typer.Option(help="Wall material: auto, linear, neo-hookean or yeoh.")] = "auto",
    name: Annotated[str | None, typer.Option(help="Name of the robot; else the table's.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Picture of table, fit and band (PNG, SVG or PDF).")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Fit the actuator law to a measured table and write a robot file.

    The table has named columns: pressure_kPa (one chamber) or pressure_0_kPa … pressure_3_kPa, bend_deg and, where
    there is more, bend_direction_deg, length_mm, branch (loading or unloading), trial, setpoint. Other units by suffix.
    """
    import sys

    from softbot.errors import InputError

    for option, path in (("--out", out), ("--plot", plot)):
        if path is not None and path.exists() and table.exists() and path.samefile(table):
            raise InputError(f"{option} {path}: is the table itself, which would be lost; name another file")
    if length_mm is not None and not 1.0 <= length_mm <= 1e5:
        raise InputError(f"--length-mm {length_mm:g}: a robot is 1 mm to 100 m long; give its length in millimetres")

    from rich.console import Console

    messages = Console(stderr=True, quiet=json or not sys.stderr.isatty())
    with messages.status("fitting the actuator law …"):
        from calib.fit import Geometry, calibrate_table
        from calib.table import read_table
        from softbot.toml_file import write_toml

        geometry = Geometry(_scaled(length_mm), _scaled(radius_mm), _scaled(mass_g))
        rows = read_table(table, columns=columns, length_m=geometry.length_m, sheet=sheet)
        calibration = calibrate_table(rows, geometry, law)
        robot_name = name or _robot_name(table)
        calibration.robot(robot_name)  # refuses what is no robot before anything is written
    if out is not None:
        write_toml(out, calibration.robot_table(robot_name))
    if plot is not None:
        from calib.figure import save_figure

        save_figure(calibration, plot)
    if json:
        report = calibration.report() | {"robot": str(out) if out else None, "plot": str(plot) if plot else None}
        print(json_format.dumps(report, allow_nan=False))
        return
    _show(Console(), calibration)
    for label, path in (("robot", out), ("plot", plot)):
        if path is not None:
            typer.echo(f"{label}: {path}")


def _scaled(milli: float | None) -> float | None:
    """Millimetres or grams in SI."""
    return None if milli is None else 1e-3 * milli


def _robot_name(table: Path) -> str:
    """The table's name, or its folder's where the table is called just that."""
    return table.resolve().parent.name if table.stem == "table" else table.stem


def _show(console: Console, calibration: Calibration) -> None:
    from rich.table import Table

    report = calibration.report()
    parameters = Table(title=f"{report['law']} wall, {report['rows']} loading rows", title_justify="left")
    for heading in ("parameter", "value", "95 % interval", "unit"):
        parameters.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right")
    for key, one in calibration.parameters.items():
        interval = f"{one.low:.4g} … {one.high:.4g}" if one.identified else "not determined"
        parameters.add_row(key, f"{one.value:.4g}", interval, "" if one.unit == "1" else one.unit)
    console.print(parameters)
    errors = Table(title="errors in % of full scale", title_justify="left")
    for heading in ("", "full scale", "fit (rms)", "leave one out", "between repeats"):
        errors.add_column(heading, justify="right" if heading else "left")
    for kind, unit in (("bend", "deg"), ("length", "mm")):
        if f"rms_{kind}_percent" in report:
            shares = [report[f"{error}_{kind}_percent"] for error in ("rms", "loo", "repeat")]
            full_scale = f"{report[f'full_scale_{kind}_{unit}']:.1f} {unit}"
            errors.add_row(kind, full_scale, *("–" if share is None else f"{share:.1f}" for share in shares))
    console.print(errors)
    for text in report["assumptions"]:
        console.print(f"assumed: {text}", style="dim", markup=False, highlight=False)
    for text in report["warnings"]:
        console.print(f"warning: {text}", style="yellow", markup=False, highlight=False)
