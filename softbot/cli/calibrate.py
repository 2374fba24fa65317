"""`softbot calibrate`: from a bending-angle–pressure table to a robot file, with the evidence for it."""

from __future__ import annotations

import json as json_format
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.console import Console
    from rich.table import Table

    from calib.calibration import Calibration
    from calib.series_calibration import SeriesCalibration, Transfer


def calibrate(
    table: Annotated[
        Path | None, typer.Argument(help="CSV or .xlsx with pressures and bends: pressure_kPa,bend_deg …")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Robot file to write (TOML).")] = None,
    length_mm: Annotated[float | None, typer.Option(help="Length at rest; else from the table, or assumed.")] = None,
    radius_mm: Annotated[float | None, typer.Option(help="Outer radius; else fitted, or assumed.")] = None,
    mass_g: Annotated[float | None, typer.Option(help="Mass; else from the wall's volume and 1100 kg/m3.")] = None,
    columns: Annotated[
        str | None,
        typer.Option(help="What the header does not say: pressure=HEADER:kPa,bend=HEADER:deg (or column numbers)."),
    ] = None,
    sheet: Annotated[str | None, typer.Option(help="Sheet of a workbook that has several tables.")] = None,
    law: Annotated[
        str, typer.Option(help="Wall material: auto, linear, neo-hookean, mooney-rivlin, yeoh or gent.")
    ] = "auto",
    name: Annotated[str | None, typer.Option(help="Name of the robot; else the table's.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Picture of table, fit and band (PNG, SVG or PDF).")] = None,
    report: Annotated[
        Path | None,
        typer.Option(metavar="PAGE.html", help="Page to write: curves, residuals, what was chosen and why."),
    ] = None,
    transfer: Annotated[
        bool, typer.Option(help="Of a recording: fit each trial alone and judge it on the others of its chambers.")
    ] = False,
    static: Annotated[bool, typer.Option(help="Read a recording as a table of holds, without memory.")] = False,
    memory: Annotated[
        bool, typer.Option(help="Of a table of holds: write what stays after a release as [memory], too.")
    ] = False,
    self_test: Annotated[
        int | None,
        typer.Option(metavar="ROBOTS", min=1, max=10_000, help="No table: calibrate random robots that are known."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Fit the actuator law to a measured table or recording and write a robot file.

    The table has named columns: pressure_kPa (one chamber) or pressure_0_kPa … pressure_3_kPa, bend_deg and, where
    there is more, bend_direction_deg, length_mm, branch (loading or unloading), trial, setpoint. Other units by suffix.
    With t_s and rows that follow each other it is a recording (trial tells its runs apart, valid = 0 marks gaps): the
    robot then gets a [memory] too.
    """

    from softbot.errors import InputError

    if self_test is not None:
        if table is not None:
            raise InputError(f"{table}: --self-test makes its own tables; leave one of the two out")
        _self_test(self_test, json)
        return
    if table is None:
        raise InputError("no table: name a CSV or .xlsx file (or ask for --self-test 100)")
    files = {name: path for name, path in (("--out", out), ("--plot", plot), ("--report", report)) if path is not None}
    for option, path in files.items():
        if path.exists() and table.exists() and path.samefile(table):
            raise InputError(f"{option} {path}: is the table itself, which would be lost; name another file")
        if sum(path.resolve() == other.resolve() for other in files.values()) > 1:
            raise InputError(f"{option} {path}: is named for two things to write; name a file for each")
    if length_mm is not None and not 1.0 <= length_mm <= 1e5:
        raise InputError(f"--length-mm {length_mm:g}: a robot is 1 mm to 100 m long; give its length in millimetres")

    from rich.console import Console

    from softbot.cli.streams import messages

    with messages().status("fitting the actuator law …"):
        from calib.fit import calibrate_table
        from calib.model_choice import Geometry
        from calib.plausibility import checked
        from calib.recording import is_recording
        from calib.table import read_rows
        from softbot.robot import Robot
        from softbot.toml_file import check, write_toml

        geometry = Geometry(_scaled(length_mm), _scaled(radius_mm), _scaled(mass_g))
        rows = read_rows(table, columns=columns, length_m=geometry.length_m, sheet=sheet)
        recorded = is_recording(rows) and not static
        if transfer and not recorded:
            raise InputError(f"{table}: --transfer judges recordings; this is a table of holds: leave the option out")
        calibration: Calibration | SeriesCalibration
        robot_name = name or _robot_name(table)
        judged: list[Transfer] = []
        if recorded:
            from calib.series_calibration import calibrate_recording, transfers

            if transfer:
                judged = transfers(rows, geometry, law)
            recording = calibrate_recording(rows, geometry, law)
            calibration, robot = recording, recording.robot_table(robot_name)
        else:
            holds = calibrate_table(checked(rows), geometry, law)
            calibration, robot = holds, holds.robot_table(robot_name, memory=memory)
        check(Robot, robot, f"{table}: the calibrated robot")  # refuses what is no robot before anything is written
    if out is not None:
        write_toml(out, robot)
    if plot is not None:
        _save_plot(calibration, plot)
    if report is not None:
        from softbot.report.calibration_page import write_calibration_page

        write_calibration_page(calibration, report, judged)
    if json:
        found = calibration.report()
        found |= {
            what: str(path) if path else None for what, path in (("robot", out), ("plot", plot), ("page", report))
        }
        if judged:
            found["transfers"] = [asdict(one) for one in judged]
        print(json_format.dumps(found, allow_nan=False))
        return
    console = Console()
    _show(console, calibration)
    if judged:
        _show_transfers(console, judged)
    for label, written in (("robot", out), ("plot", plot), ("page", report)):
        if written is not None:
            typer.echo(f"{label}: {written}")


def _self_test(robots: int, json: bool) -> None:
    """Print how often known robots lie in the intervals that are found for them."""
    from rich.console import Console
    from rich.table import Table

    from softbot.cli.streams import messages

    with messages().status("compiling …") as status:
        from calib.self_test import holds_coverage, recordings_coverage

        def tell(what: str, of: int) -> Callable[[int], None]:
            return lambda done: status.update(f"{what}: {done} of {of} robots")

        found = {
            "tables of holds": holds_coverage(robots, told=tell("tables of holds", robots)),
            "recordings": recordings_coverage(robots, told=tell("recordings", robots)),
        }
    if json:
        print(json_format.dumps({"kind": "self-test", **{what: one.report() for what, one in found.items()}}))
        return
    for what, one in found.items():
        report = one.report()
        table = Table(
            title=f"{what}: {one.robots} robots, {report['share_percent']:.1f} % inside", title_justify="left"
        )
        table.add_column("true value inside its 95 % interval or band")
        for heading in ("inside", "of", "%"):
            table.add_column(heading, justify="right")
        for name, (inside, of) in (report["parameters"] | report["bands"]).items():
            table.add_row(name, str(inside), str(of), f"{100.0 * inside / of:.1f}")
        Console().print(table)


def _save_plot(calibration: Calibration | SeriesCalibration, plot: Path) -> None:
    from calib.calibration import Calibration

    if isinstance(calibration, Calibration):
        from calib.figure import save_figure

        save_figure(calibration, plot)
    else:
        from calib.series_figure import save_series_figure

        save_series_figure(calibration, plot)


def _scaled(milli: float | None) -> float | None:
    """Millimetres or grams in SI."""
    return None if milli is None else 1e-3 * milli


def _robot_name(table: Path) -> str:
    """The table's name, or its folder's where the table is called just that."""
    return table.resolve().parent.name if table.stem == "table" else table.stem


def _show(console: Console, calibration: Calibration | SeriesCalibration) -> None:
    from rich.table import Table

    report = calibration.report()
    recorded = report.get("kind") == "recording"
    title = f"{report['law']} wall, " + (
        f"memory: {', '.join(report['memory'])}" if recorded else f"{report['rows']} loading rows"
    )
    parameters = Table(title=title, title_justify="left")
    for heading in ("parameter", "value", "95 % interval", "unit"):
        parameters.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right")
    for key, one in calibration.parameters.items():
        interval = f"{one.low:.4g} … {one.high:.4g}" if one.identified else "not determined"
        parameters.add_row(key, f"{one.value:.4g}", interval, "" if one.unit == "1" else one.unit)
    console.print(parameters)
    console.print(_trials(report) if recorded else _errors(report))
    if not recorded and report["lack_of_fit_p"] is not None:
        verdict = "more than the repeats explain" if report["lack_of_fit_p"] < 0.05 else "no more than repeats differ"
        console.print(f"lack-of-fit test (F, bends and lengths together): p = {report['lack_of_fit_p']:.2g}, {verdict}")
    for text in report["assumptions"]:
        console.print(f"assumed: {text}", style="dim", markup=False, highlight=False)
    for text in report["warnings"]:
        console.print(f"warning: {text}", style="yellow", markup=False, highlight=False)
    for one in report.get("measure_next", ()):
        console.print(f"measure next: {one['words']}", markup=False, highlight=False)


def _errors(report: dict[str, Any]) -> Table:
    from rich.table import Table

    errors = Table(title="errors in % of full scale", title_justify="left")
    released = report["release_rms_bend_percent"] is not None
    kinds = {"rms": "fit (rms)", "loo": "leave one out", "repeat": "between repeats"}
    kinds |= {"release_rms": "releases"} if released else {}
    for heading in ("", "full scale", *kinds.values()):
        errors.add_column(heading, justify="right" if heading else "left")
    for kind, unit in (("bend", "deg"), ("length", "mm")):
        if f"rms_{kind}_percent" in report:
            shares = [report[f"{error}_{kind}_percent"] for error in kinds]
            full_scale = f"{report[f'full_scale_{kind}_{unit}']:.1f} {unit}"
            errors.add_row(kind, full_scale, *("–" if share is None else f"{share:.1f}" for share in shares))
    return errors


def _trials(report: dict[str, Any]) -> Table:
    from rich.table import Table

    trials = Table(title="errors in % of each trial's full scale (rms)", title_justify="left")
    for heading in ("trial", "chambers", "full scale", "fit, own scale", "scale", "left out", "… one gain refitted"):
        trials.add_column(heading, justify="left" if heading in ("trial", "chambers") else "right")
    for one in report["trials"]:
        shares = [one["rms_bend_percent"], one.get("left_out_percent"), one.get("left_out_with_gain_percent")]
        cells = ["–" if share is None else f"{share:.1f}" for share in shares]
        chambers = ", ".join(map(str, one["driven"]))
        full_scale = f"{one['full_scale_bend_deg']:.1f} deg"
        trials.add_row(one["name"], chambers, full_scale, cells[0], f"{one['scale']:.2f}", *cells[1:])
    return trials


def _show_transfers(console: Console, judged: list[Transfer]) -> None:
    from rich.table import Table

    table = Table(title="fitted on one trial, judged on another: rms in % of full scale", title_justify="left")
    for heading in (
        "fitted on",
        "rms",
        "judged on",
        "one gain refitted",
        "gain",
        "nothing refitted",
        "steady states differ",
    ):
        table.add_column(heading, justify="left" if heading.endswith(" on") else "right")
    for one in judged:
        shares = (one.rms_with_gain, one.rms_raw, one.steady_difference)
        gained, raw, apart = (f"{100.0 * share:.1f}" for share in shares)
        table.add_row(one.fitted, f"{100.0 * one.rms_fitted:.1f}", one.judged, gained, f"{one.gain:.2f}", raw, apart)
    console.print(table)
