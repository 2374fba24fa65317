"""Tables as people really have them: each kind is fitted right, or refused in one message that names place and mend.

Every kind goes through the command itself, so that nothing between the file and the robot may fail silently. The truth
is a linear robot of 0.44°/kPa; "fitted right" is its bend at 45 kPa within 2 %.
"""

import datetime
import json
import math
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calib.table import read_table
from softbot.errors import InputError
from softbot.robot import load_robot

PRESSURE_KPA = np.arange(10.0, 81.0, 10.0)
BEND_DEG = 0.44 * PRESSURE_KPA
PSI_KPA = 6.894757293168
ROWS = list(zip(PRESSURE_KPA, BEND_DEG, strict=True))
HEAD = "pressure_kPa,bend_deg\n"


def csv(header: str = HEAD, rows: object = ROWS, row: str = "{0:g},{1:g}\n") -> str:
    return header + "".join(row.format(*cells) for cells in rows)


def comma(value: float) -> str:
    return f"{value:.2f}".replace(".", ",")


def book(*sheets: tuple[str, list[list[object]]], merge: str | None = None) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        workbook = openpyxl.Workbook()
        workbook.remove(workbook.active)
        for name, rows in sheets:
            sheet = workbook.create_sheet(name)
            for cells in rows:
                sheet.append(cells)
            if merge:
                sheet.merge_cells(merge)
        workbook.save(path)

    return write


SHEET: list[list[object]] = [["pressure_kPa", "bend_deg"], *([float(p), float(b)] for p, b in ROWS)]

RIGHT: dict[str, str | bytes | Callable[[Path], None]] = {
    "plain": csv(),
    "byte order mark": csv().encode("utf-8-sig"),
    "UTF-16 with mark": csv().encode("utf-16"),
    "UTF-16 without mark": csv().encode("utf-16-le"),
    "UTF-16 big-endian without mark": csv().encode("utf-16-be"),
    "old Mac line ends": csv().replace("\n", "\r"),
    "semicolons and decimal commas": csv(
        "Pressure [kPa];Bend [°]\n", [(comma(p), comma(b)) for p, b in ROWS], "{0};{1}\n"
    ),
    "three decimals after a comma": csv(
        HEAD.replace(",", ";"), [(f"{p:.3f}", f"{b:.3f}") for p, b in ROWS], "{0};{1}\n"
    ).replace(".", ","),
    "tabs": csv(HEAD.replace(",", "\t"), row="{0:g}\t{1:g}\n"),
    "aligned with spaces": csv("pressure_kPa   bend_deg\n", row="  {0:8.2f}   {1:8.3f}\n"),
    "Excel's sep line": "sep=;\n" + csv(HEAD.replace(",", ";"), row="{0:g};{1:g}\n"),
    "title lines above": "Bending test of arm 3\nKim, Lab 2,,\n\n" + csv(),
    "header behind a hash": "# written by numpy.savetxt\n# " + csv(),
    "two header lines": csv("pressure,bend\n(kPa),(deg)\n"),
    "merged header over chambers": csv("Pressure (kPa),,Bend (deg)\nchamber 0,chamber 2,\n", row="{0:g},0,{1:g}\n"),
    "merged header over numbers": csv("Pressure (kPa),,,,Bend (deg)\n0,1,2,3,\n", row="{0:g},0,0,0,{1:g}\n"),
    "header cell over two lines": csv('"Pressure\n(kPa)","Bend\n(deg)"\n'),
    "a unit for each chamber": csv("pressure_0_kPa,pressure_1_psi,pressure_2_bar,bend_deg\n", row="{0:g},0,0,{1:g}\n"),
    "psi": csv("pressure_psi,bend_deg\n", [(p / PSI_KPA, b) for p, b in ROWS], "{0:.9g},{1:g}\n"),
    "psia": csv("pressure_psia,bend_deg\n", [((p + 101.325) / PSI_KPA, b) for p, b in ROWS], "{0:.9g},{1:g}\n"),
    "bar absolute": csv("Pressure (bar abs),Angle in deg\n", [((p + 101.325) / 100, b) for p, b in ROWS], "{0},{1}\n"),
    "MPa and radians": csv("p_MPa,theta_rad\n", [(p / 1e3, math.radians(b)) for p, b in ROWS], "{0:g},{1:.9g}\n"),
    "curvature and lengths": csv(
        "pressure_kPa,curvature_1_m,length_mm\n", [(p, math.radians(b) / 0.15) for p, b in ROWS], "{0:g},{1:.9g},150\n"
    ),
    "negative angles": csv(rows=[(p, -b) for p, b in ROWS]),
    "both ways with signs": csv(
        "pressure_0_kPa,pressure_2_kPa,bend_deg\n",
        [(p, 0, b) for p, b in ROWS] + [(0, p, -b) for p, b in ROWS],
        "{0:g},{1:g},{2:g}\n",
    ),
    "minus signs of a typesetter": csv(rows=[(p, f"\u2212{b:g}") for p, b in ROWS], row="{0:g},{1}\n"),
    "repeated rows": csv() + csv("")[: -len("80,35.2\n")] * 3,
    "shuffled rows": csv(rows=[ROWS[i] for i in (5, 0, 7, 2, 1, 6, 3, 4)]),
    "one row far off": csv(rows=[*[(p, b + 0.02 * (-1) ** n) for n, (p, b) in enumerate(ROWS * 4)], (50, 44)]),
    "flagged rows": csv(
        "pressure_kPa,bend_deg,valid\n", [(p, b, 1) for p, b in ROWS] + [(40, 180, 0)], "{0},{1},{2}\n"
    ),
    "empty columns between": csv("pressure_kPa,,bend_deg,\n", row="{0:g},,{1:g},\n"),
    "cells left out at the end": csv("pressure_kPa,bend_deg,length_mm\n", row="{0:g},{1:g}\n"),
    "lengths missing here and there": csv(
        "pressure_kPa,bend_deg,length_mm\n",
        [(p, b, "n/a" if n % 2 else "150") for n, (p, b) in enumerate(ROWS)],
        "{0:g},{1:g},{2}\n",
    ),
    "workbook": book(("Data", SHEET)),
    "workbook with notes beside": book(("Notes", [["Bending test"], ["by Kim"]]), ("Data", SHEET)),
    "workbook with an offset table": book(
        ("Data", [[], ["Test of arm 3"], [], *([None, None, *row] for row in SHEET)])
    ),
    "workbook with a merged header": book(
        ("Data", [["Pressure (kPa)", None, "Bend (deg)"], ["ch 0", "ch 1", None], *([p, 0, b] for p, b in ROWS)]),
        merge="A1:B1",
    ),
    "workbook with numbers as text": book(("Data", [SHEET[0], *([f"{p:g}", f"{b:g}"] for p, b in ROWS)])),
    "workbook with formulas of constants": book(
        ("Data", [["pressure_kPa", "bend_deg", "remark"], *([p, b, None] for p, b in ROWS)])
    ),
}

REFUSED: dict[str, tuple[str | bytes | Callable[[Path], None], str]] = {
    "empty file": ("", "the file has no rows; a table needs a header"),
    "blank lines only": ("\n\n;;\n", "the file has no rows"),
    "binary": (bytes(range(256)) * 4, "not a text file; save"),
    "compressed": (b"\x1f\x8b\x08" + bytes(30), r"compressed \(gzip\).*unpack"),
    "PDF": (b"%PDF-1.7 ...", "is a PDF, not a table; save"),
    "web page": ("<!DOCTYPE html><table></table>", "is a web page"),
    "JSON": ('[{"pressure_kPa": 1}]', "is JSON"),
    "old workbook": (b"\xd0\xcf\x11\xe0" + bytes(100), r"old or protected workbook.*\.xlsx"),
    "damaged workbook": (b"PK\x03\x04" + bytes(100), "damaged workbook"),
    "one point": (HEAD + "20,8.8\n", "one row is not enough; measure"),
    "constant pressure": (csv(rows=[(30, b) for _, b in ROWS]), "the pressure never changes"),
    "constant bend": (csv(rows=[(p, 20) for p, _ in ROWS]), "does not rise with the pressure"),
    "no header": (csv(""), "line 1: no header; write one"),
    "NaN": (csv() + "90,NaN\n", r"line 10, column 'bend_deg': 'NaN' is no number; write a plain number"),
    "infinity": (csv() + "inf,39\n", r"line 10, column 'pressure_kPa': 'inf' is no number"),
    "text in a cell": (csv() + "90,see photo\n", r"line 10, column 'bend_deg': 'see photo' is no number"),
    "error of a spreadsheet": (csv() + "90,#DIV/0!\n", r"line 10, column 'bend_deg': '#DIV/0!' is an error of the spr"),
    "error in the first cell": (csv() + "#N/A,39\n", r"line 10, column 'pressure_kPa': '#N/A' is an error"),
    "date for a number": (csv() + "90,3-May\n", r"line 10.*a date that the spreadsheet made of one; format"),
    "averages at the foot": (csv() + "mean,19.8\n", r"line 10, column 'pressure_kPa': 'mean' is no number"),
    "thousands with commas": (
        csv("pressure_Pa,bend_deg\n", [(f'"{p:.0f},000"', b) for p, b in ROWS], "{0},{1:g}\n"),
        r"line 2, column 'pressure_Pa': '10,000' may be a decimal comma or part thousands",
    ),
    "both decimal marks": (
        csv(HEAD.replace(",", ";"), row="{0:.1f};{1:g}\n") + "90,0;39,6\n",
        "use one mark throughout",
    ),
    "unquoted decimal commas": (HEAD + "20,0,8,8\n40,0,17,6\n", "line 2: 4 cells where the header has 2"),
    "no pressure column": (csv("force_N,bend_deg\n"), "no pressure column; name it"),
    "no bend column": (csv("pressure_kPa,height_mm\n"), "no bend column; name one"),
    "a column twice": (csv("pressure_kPa,bend_deg,bend_deg\n", row="{0},{1},{1}\n"), "bend stands in two columns"),
    "pressures in two units": (
        csv("pressure_kPa,pressure_psi,bend_deg\n", row="{0},{0},{1}\n"),
        "pressure stands in two columns",
    ),
    "rows in two units": (
        csv(rows=[*ROWS, *[(p / PSI_KPA, b) for p, b in ROWS[-3:]]], row="{0:.6g},{1:g}\n"),
        r"line 10: here the bend per pressure is 6\.89 times greater.*kPa to psi",
    ),
    "one row in radians": (
        csv(rows=[*ROWS[:-1], (80, math.radians(35.2))], row="{0:g},{1:.5g}\n"),
        r"line 9: .*degrees to radians",
    ),
    "absolute called gauge": (csv(rows=[(p + 91.3, b - 4.4) for p, b in ROWS]), "these look like absolute pressures"),
    "absolute that starts bent": (
        csv(rows=[(p + 101.3, b) for p, b in ROWS], row="{0:g},{1:g}\n"),
        "these look like absolute pressures",
    ),
    "psi called bar": (
        csv("pressure_bar,bend_deg\n", [(p * 14.5, b) for p, b in ROWS]),
        "below 10 MPa: check the unit",
    ),
    "swapped columns": (csv("bend_deg,pressure_MPa\n"), "below 10 MPa: check the unit"),
    "swapped chambers": (
        csv("pressure_2_kPa,bend_deg,bend_direction_deg\n", row="{0:g},{1:g},180\n"),
        "turned by -?180° against the chambers",
    ),
    "chambers counted from one": (
        csv("pressure_1_kPa,pressure_4_kPa,bend_deg\n", row="{0},0,{1}\n"),
        "pressure_0 … pressure_3, counted from 0; rename",
    ),
    "signs that follow nothing": (csv(rows=[(p, b * (-1) ** n) for n, (p, b) in enumerate(ROWS)]), "a negative bend"),
    "vacuum and pressure": (csv() + "-60,26\n", r"line 10: a pressure of -60 kPa"),
    "a sentinel for missing": (csv() + "90,-9999\n", r"line 10: a bend of .*9999°"),
    "extension called length": (
        csv("pressure_kPa,bend_deg,length_mm\n", [(p, b, n) for n, (p, b) in enumerate(ROWS)], "{0},{1},{2}\n"),
        r"line 2: a length of 0 m",
    ),
    "a flag that is no flag": (csv("pressure_kPa,bend_deg,valid\n", row="{0},{1},maybe\n"), "line 2, column 'valid'"),
    "two tables in a workbook": (book(("Monday", SHEET), ("Friday", SHEET)), "choose one with --sheet NAME"),
    "an empty workbook": (book(("Data", [])), "no visible sheet with cells"),
    "dates in a workbook": (
        book(("Data", [*SHEET, [datetime.datetime(2024, 5, 3), 39.6]])),
        r"sheet 'Data', row 10, column 'pressure_kPa': '2024-05-03.*a date that the spreadsheet made of one",
    ),
    "formulas never computed": (
        book(("Data", [*SHEET, [90, "=A10*0.44"]])),
        r"row 10, column 'bend_deg': the formula '=A10\*0.44' was never computed; open the workbook",
    ),
    "true and false in a workbook": (
        book(("Data", [*SHEET, [90, True]])),
        "row 10, column 'bend_deg': 'TRUE' is no num",
    ),
}


def make(path: Path, content: str | bytes | Callable[[Path], None]) -> Path:
    if callable(content):
        content(path.with_suffix(".xlsx"))
        return path.with_suffix(".xlsx")
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize("content", RIGHT.values(), ids=RIGHT.keys())
def test_kind_is_fitted_right(tmp_path: Path, softbot: Any, content: str | bytes | Callable[[Path], None]) -> None:
    path, out = make(tmp_path / "table.csv", content), tmp_path / "robot.toml"
    result = softbot("calibrate", path, "--out", out, "--length-mm", 150, "--law", "linear", "--json")
    assert result.exit_code == 0, result.stderr
    report = json.loads(result.stdout)
    assert report["rms_bend_percent"] < 20.0
    robot = load_robot(str(out))
    bent = robot.actuator_law().equilibrium([45e3, 0.0, 0.0, 0.0]).curvature_1_m
    assert math.degrees(robot.length_m * np.hypot(*bent)) == pytest.approx(0.44 * 45.0, rel=0.02)


@pytest.mark.parametrize(("content", "message"), REFUSED.values(), ids=REFUSED.keys())
def test_kind_is_refused_in_one_clear_message(
    tmp_path: Path,
    softbot: Any,
    content: str | bytes | Callable[[Path], None],
    message: str,
) -> None:
    path, out = make(tmp_path / "table.csv", content), tmp_path / "robot.toml"
    result = softbot("calibrate", path, "--out", out, "--length-mm", 150)
    words = " ".join(result.stderr.split())
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert re.search(message, words), words
    assert "Traceback" not in words
    assert path.name in words.replace(" ", "")
    assert not out.exists()


def test_there_are_more_than_forty_kinds() -> None:
    assert len(RIGHT) + len(REFUSED) >= 80


def test_sheet_is_chosen_by_name(tmp_path: Path, softbot: Any) -> None:
    other = [SHEET[0], *([p, 2 * b] for p, b in ROWS)]
    path = make(tmp_path / "table", book(("Monday", SHEET), ("Friday", other)))
    friday = softbot("calibrate", path, "--sheet", "Friday", "--law", "linear", "--json")
    assert json.loads(friday.stdout)["full_scale_bend_deg"] == pytest.approx(70.4)
    sunday = softbot("calibrate", path, "--sheet", "Sunday")
    assert sunday.exit_code == 2
    assert "no visible sheet 'Sunday'" in sunday.stderr


CELLS = st.sampled_from(
    [
        "",
        "0",
        "10",
        "-5",
        "20,5",
        "1e3",
        "1e400",
        "nan",
        "#N/A",
        "°",
        '"',
        "x" * 50,
        "\u2212 3",
        "1/2",
        "=A1",
        "loading",
        "\0",
    ]
)
HEADERS = st.sampled_from(
    [
        "pressure_kPa",
        "pressure_1_kPa",
        "p_psia",
        "bend_deg",
        "curvature_1_m",
        "length_mm",
        "t_s",
        "trial",
        "chamber",
        "bend_direction_deg",
        "valid",
        "branch",
        "pressure",
        "kPa",
        "setpoint",
        "-",
    ]
)


@given(
    header=st.lists(HEADERS, min_size=1, max_size=5),
    body=st.lists(st.lists(CELLS, min_size=1, max_size=5), max_size=6),
    mark=st.sampled_from([",", ";", "\t", " "]),
)
@settings(deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_nothing_a_table_holds_ends_in_a_traceback(
    tmp_path: Path, header: list[str], body: list[list[str]], mark: str
) -> None:
    path = tmp_path / "table.csv"
    path.write_text("\n".join(mark.join(cells) for cells in [header, *body]), encoding="utf-8")
    try:
        table = read_table(path)
    except InputError as error:
        assert "table.csv" in str(error)  # noqa: PT017
        assert "\n" not in str(error)  # noqa: PT017
    else:
        assert np.all(np.isfinite(table.pressure_Pa))
        assert np.all(table.bend_rad >= 0.0) or np.max(np.abs(table.bend_rad)) > 0.0


@pytest.mark.slow
def test_a_million_rows_are_read_and_fitted_in_sensible_time(tmp_path: Path, softbot: Any) -> None:
    rng = np.random.default_rng(0)
    pressure = rng.uniform(5.0, 90.0, 1_000_000)
    bend = np.abs(0.44 * pressure + rng.normal(0.0, 1.0, len(pressure)))
    lines = "\n".join(f"{p:.3f},{b:.3f}" for p, b in zip(pressure.tolist(), bend.tolist(), strict=True))
    path = tmp_path / "long.csv"
    path.write_text(HEAD + lines, encoding="utf-8")
    started = time.perf_counter()
    result = softbot("calibrate", path, "--law", "linear", "--length-mm", 150, "--json")
    assert time.perf_counter() - started < 60.0
    report = json.loads(result.stdout)
    assert report["rms_bend_deg"] == pytest.approx(1.0, rel=0.1)
