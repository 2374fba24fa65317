"""A bending-angle–pressure table: CSV or Excel in, SI arrays out, and one clear message for what is no such table.

Columns are found by name and unit (see `calib.units`), or by an explicit mapping. Known columns:

    pressure, pressure_0 … pressure_3     gauge; `pressure_absolute…` has the atmosphere taken off
    chamber                               0 … 3, for tables with one `pressure` column (default 0)
    bend | curvature                      bend angle over the length, or 1/m with a length; signed where two
                                          opposite chambers bend it both ways
    bend_direction                        towards the centre of curvature, from chamber 0 to chamber 1
    length                                arc length of the bent, stretched tube
    branch, trial, setpoint, t            "loading" | "unloading", and what tells rows apart
    valid                                 1 | 0: whether the bend of the row was measured well

Rows with the same `setpoint` (a label of the commanded pressures) and branch are repeats of one measurement.
Nothing here depends on the order of the rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.bend_table import BendTable, FloatArray
from calib.cells import NumberReader
from calib.columns import ABSOLUTE, GAUGE, Column, choose_columns, parse_columns
from calib.header import Grid, grid_of
from calib.plausibility import ATMOSPHERE_PA, checked
from calib.sheet import Sheet, read_bytes, text_sheet
from calib.units import says_gauge
from calib.workbook import workbook_sheets
from softbot.cross_section import CHAMBERS
from softbot.errors import InputError

_BRANCHES = {
    "loading": True,
    "load": True,
    "up": True,
    "inflation": True,
    "unloading": False,
    "unload": False,
    "down": False,
    "deflation": False,
    "release": False,
}
_VALID = {"1": True, "1.0": True, "true": True, "yes": True, "": True}
_VALID |= {"0": False, "0.0": False, "false": False, "no": False}


def read_table(
    path: Path | str, *, columns: str | None = None, length_m: float | None = None, sheet: str | None = None
) -> BendTable:
    """The table of a CSV file or a workbook, checked. Raises InputError that names file, line, column and mend.

    `columns` maps what the header does not say, "pressure=HEADER:UNIT,bend=HEADER:UNIT" (HEADER may be the
    number of the column, counted from 1). `length_m` turns a curvature into a bend where the table has no
    length. `sheet` names the sheet of a workbook that has several tables.
    """
    return checked(read_rows(path, columns=columns, length_m=length_m, sheet=sheet))


def read_rows(
    path: Path | str, *, columns: str | None = None, length_m: float | None = None, sheet: str | None = None
) -> BendTable:
    """As `read_table`, but as the file says it: nothing is left out or refused for what it means.

    Bends may be missing (NaN) in rows of a table with time.
    """
    path = Path(path)
    mapping = parse_columns(columns) if columns is not None else {}
    data = read_bytes(path)
    if data[:4] == b"PK\x03\x04":
        grid, chosen, notes = _choose_sheet(path, workbook_sheets(path, data), mapping, sheet)
    else:
        if sheet is not None:
            raise InputError(f"{path}: --sheet {sheet!r}: a text file has no sheets; leave the option out")
        grid, chosen, notes = _understood(text_sheet(path, data), mapping)
    return _arrays(grid, chosen, [*grid.notes, *notes], length_m)


def _understood(
    sheet: Sheet, mapping: Mapping[str, tuple[str, str | None]]
) -> tuple[Grid, dict[str, Column], list[str]]:
    grid = grid_of(sheet, mapped=bool(mapping))
    return grid, *choose_columns(grid, mapping)


def _choose_sheet(
    path: Path, sheets: dict[str, Sheet], mapping: Mapping[str, tuple[str, str | None]], wanted: str | None
) -> tuple[Grid, dict[str, Column], list[str]]:
    """The wanted sheet, or the one that is a table."""
    names = ", ".join(map(repr, sheets))
    if wanted is not None:
        if wanted not in sheets:
            raise InputError(f"{path}: --sheet: no visible sheet {wanted!r} with cells; the workbook has {names}")
        return _understood(sheets[wanted], mapping)
    found, failure = {}, None
    for name, one in sheets.items():
        try:
            found[name] = _understood(one, mapping)
        except InputError as error:
            failure = failure or error
    if len(found) > 1:
        raise InputError(f"{path}: {len(found)} sheets are tables: {names}; choose one with --sheet NAME")
    if not found:
        assert failure is not None
        raise failure
    grid, chosen, notes = next(iter(found.values()))
    if len(sheets) > 1:
        notes = [*notes, f"sheet {next(iter(found))!r} is read, the only table of {len(sheets)} sheets"]
    return grid, chosen, notes


def _arrays(grid: Grid, chosen: Mapping[str, Column], notes: list[str], length_m: float | None) -> BendTable:
    rows, n = grid.cells, len(grid.cells)
    if n == 0:
        raise InputError(f"{grid.source}: the table has a header but no rows; add measured rows under it")
    width = len(grid.header) if grid.header is not None else max(map(len, rows))
    needed = 1 + max(chosen[name].index for name in (*GAUGE, *ABSOLUTE, "bend", "curvature") if name in chosen)
    for row, cells in enumerate(rows):
        if len(cells) == width:
            continue
        while len(cells) > width and not cells[-1]:
            cells.pop()
        if needed <= len(cells) < width:
            cells.extend([""] * (width - len(cells)))  # what a spreadsheet leaves out at the end
        if len(cells) != width:
            raise InputError(
                f"{grid.place(row)}: {len(cells)} cells where the header has {width}; mend the {grid.row_word} "
                "(decimal commas need semicolons between the cells)"
            )
    reader = NumberReader(grid)

    def numbers(name: str, optional: bool = False) -> FloatArray:
        column = chosen[name]
        return column.scale * reader.column(column.index, column.header, optional)

    def labels(name: str) -> NDArray[np.str_]:
        return np.array([row[chosen[name].index] for row in rows]) if name in chosen else np.full(n, "")

    pressure = np.zeros((n, CHAMBERS))
    for name in (*GAUGE, *ABSOLUTE):
        if name not in chosen:
            continue
        values = numbers(name)
        if name in ABSOLUTE:
            values = values - ATMOSPHERE_PA
            notes.append(f"column {chosen[name].header!r} is absolute: {ATMOSPHERE_PA / 1e3:g} kPa taken off")
        if name in ("pressure", "pressure_absolute"):
            pressure[np.arange(n), _chambers(grid, chosen.get("chamber"))] = values
        else:
            pressure[:, int(name[-1])] = values
    t_s = numbers("t", optional=True) if "t" in chosen else np.full(n, np.nan)
    timed = bool(np.any(np.isfinite(t_s)))
    length = numbers("length", optional=True) if "length" in chosen else np.full(n, np.nan)
    if "bend" in chosen:
        bend = numbers("bend", optional=timed)
    else:
        arc = length if length_m is None else np.where(np.isfinite(length), length, length_m)
        if not np.all(np.isfinite(arc)):
            raise InputError(
                f"{grid.source}: a curvature needs a length to become a bend; add length_mm, or give the "
                "length of the tube (--length-mm)"
            )
        bend = numbers("curvature", optional=timed) * arc
        notes.append("bend = curvature × length" + ("" if np.all(np.isfinite(length)) else " at rest"))
    direction = numbers("bend_direction", optional=True) if "bend_direction" in chosen else np.full(n, np.nan)
    reader.finish()
    return BendTable(
        source=grid.source,
        comments=grid.comments,
        notes=tuple(notes),
        pressure_Pa=pressure,
        bend_rad=bend,
        direction_rad=direction,
        length_m=length,
        loading=_words(grid, chosen.get("branch"), _BRANCHES, "no branch; write loading or unloading"),
        trial=labels("trial"),
        setpoint=labels("setpoint"),
        line=np.array(grid.lines),
        t_s=t_s,
        valid=_words(grid, chosen.get("valid"), _VALID, "neither 1 (measured well) nor 0; write one of them"),
        row_word=grid.row_word,
        gauge_stated=all(says_gauge(column.header) for name, column in chosen.items() if name in GAUGE),
    )


def _chambers(grid: Grid, column: Column | None) -> NDArray[np.int_]:
    if column is None:
        return np.zeros(len(grid.cells), dtype=int)
    names = {f"{i}{end}": i for i in range(CHAMBERS) for end in ("", ".0")}
    chambers = np.empty(len(grid.cells), dtype=int)
    for i, row in enumerate(grid.cells):
        cell = row[column.index]
        if cell not in names:
            raise InputError(
                f"{grid.place(i, column.header)}: {cell!r} is no chamber; they are numbered 0 … {CHAMBERS - 1}"
            )
        chambers[i] = names[cell]
    return chambers


def _words(grid: Grid, column: Column | None, meaning: Mapping[str, bool], otherwise: str) -> NDArray[np.bool_]:
    """A column of words that say yes or no, shape (n,); True where it is empty or missing."""
    said = np.ones(len(grid.cells), dtype=bool)
    if column is None:
        return said
    for i, row in enumerate(grid.cells):
        cell = row[column.index].lower()
        if cell and cell not in meaning:
            raise InputError(f"{grid.place(i, column.header)}: {cell!r} is {otherwise}")
        said[i] = meaning.get(cell, True)
    return said
