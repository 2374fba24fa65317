"""A bending-angle–pressure table: CSV in, SI arrays out, and one clear message for what is no such table.

Columns are found by name and unit (see `calib.units`), or by an explicit mapping. Known columns:

    pressure, pressure_0 … pressure_3     gauge; `pressure_absolute…` has the atmosphere taken off
    chamber                               0 … 3, for tables with one `pressure` column (default 0)
    bend | curvature                      bend angle over the length, or 1/m with a length
    bend_direction                        towards the centre of curvature, from chamber 0 to chamber 1
    length                                arc length of the bent, stretched tube
    branch, trial, setpoint, t            "loading" | "unloading", and what tells rows apart

Rows with the same `setpoint` (a label of the commanded pressures) and branch are repeats of one measurement.
Nothing here depends on the order of the rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.bend_table import BendTable, FloatArray
from calib.cells import Grid, numbers_of, read_grid
from calib.columns import ABSOLUTE, GAUGE, Column, choose_columns, parse_columns
from calib.plausibility import ATMOSPHERE_PA, checked
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


def read_table(path: Path | str, *, columns: str | None = None, length_m: float | None = None) -> BendTable:
    """The table of a CSV file. Raises InputError that names file, line, column and mend.

    `columns` maps what the header does not say, "pressure=HEADER:UNIT,bend=HEADER:UNIT" (HEADER may be the
    number of the column, counted from 1). `length_m` turns a curvature into a bend where the table has no
    length.
    """
    path = Path(path)
    grid = read_grid(path, mapped=columns is not None)
    mapping = parse_columns(columns) if columns is not None else {}
    chosen, notes = choose_columns(grid, mapping)
    table = _arrays(grid, chosen, notes, length_m)
    return checked(table)


def _arrays(grid: Grid, chosen: Mapping[str, Column], notes: list[str], length_m: float | None) -> BendTable:
    rows, lines, n = grid.cells, grid.lines, len(grid.cells)
    if n == 0:
        raise InputError(f"{grid.source}: the table has a header but no rows; add measured rows under it")
    width = len(grid.header) if grid.header is not None else max(len(row) for row in rows)
    for row, line in zip(rows, lines, strict=True):
        while len(row) > width and not row[-1]:
            row.pop()
        if len(row) != width:
            raise InputError(
                f"{grid.source}, line {line}: {len(row)} cells where the header has {width}; mend the line "
                "(decimal commas need semicolons between the cells)"
            )

    def numbers(name: str, optional: bool = False) -> FloatArray:
        column = chosen[name]
        cells = [row[column.index] for row in rows]
        return column.scale * numbers_of(grid.source, column.header, cells, lines, optional)

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
            pressure[np.arange(n), _chambers(grid.source, chosen.get("chamber"), rows, lines)] = values
        else:
            pressure[:, int(name[-1])] = values
    length = numbers("length", optional=True) if "length" in chosen else np.full(n, np.nan)
    if "bend" in chosen:
        bend = numbers("bend")
    else:
        arc = length if length_m is None else np.where(np.isfinite(length), length, length_m)
        if not np.all(np.isfinite(arc)):
            raise InputError(
                f"{grid.source}: a curvature needs a length to become a bend; add length_mm, or give the "
                "length of the tube"
            )
        bend = numbers("curvature") * arc
        notes.append("bend = curvature × length" + ("" if np.all(np.isfinite(length)) else " at rest"))
    direction = numbers("bend_direction", optional=True) if "bend_direction" in chosen else np.full(n, np.nan)
    if "t" in chosen:
        numbers("t", optional=True)  # a text in it is a mistake worth telling, though a static fit has no use for time
    return BendTable(
        source=grid.source,
        comments=grid.comments,
        notes=tuple(notes),
        pressure_Pa=pressure,
        bend_rad=bend,
        direction_rad=direction,
        length_m=length,
        loading=_branches(grid.source, chosen.get("branch"), rows, lines),
        trial=labels("trial"),
        setpoint=labels("setpoint"),
        line=np.array(lines),
    )


def _chambers(source: str, column: Column | None, rows: list[list[str]], lines: list[int]) -> NDArray[np.int_]:
    if column is None:
        return np.zeros(len(rows), dtype=int)
    chambers = np.empty(len(rows), dtype=int)
    for i, row in enumerate(rows):
        cell = row[column.index]
        if cell not in tuple(map(str, range(CHAMBERS))):
            raise InputError(
                f"{source}, line {lines[i]}, column {column.header!r}: {cell!r} is no chamber; they are "
                f"numbered 0 … {CHAMBERS - 1}"
            )
        chambers[i] = int(cell)
    return chambers


def _branches(source: str, column: Column | None, rows: list[list[str]], lines: list[int]) -> NDArray[np.bool_]:
    loading = np.ones(len(rows), dtype=bool)
    if column is None:
        return loading
    for i, row in enumerate(rows):
        cell = row[column.index].lower()
        if cell and cell not in _BRANCHES:
            raise InputError(
                f"{source}, line {lines[i]}, column {column.header!r}: {cell!r} is no branch; write "
                "loading or unloading"
            )
        loading[i] = _BRANCHES.get(cell, True)
    return loading
