"""Cells of a table as numbers: decimal points and commas told apart, and one message for what is no number."""

from __future__ import annotations

import datetime
import math
import re

import numpy as np

from calib.bend_table import FloatArray
from calib.header import Grid
from calib.sheet import EXCEL_ERRORS
from softbot.errors import InputError

_LARGEST = 1e30  # in any unit
_POINT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2},\d{3}")
_NOTHING = ("", "nan", "na", "n/a", "none", "null", "-", "--")
_DATE = re.compile(r"\d{4}-\d\d-\d\d(T.*)?|\d\d:\d\d:\d\d.*|\d{1,2}[-. ][A-Za-z]{3,4}|[A-Za-z]{3,4}[-. ]\d{1,2}")


class NumberReader:
    """Reads the columns of one grid. A table has one decimal mark; `finish` refuses one with both."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._columns: list[tuple[int, str]] = []
        self._comma: str | None = None  # where a decimal comma stands
        self._thousands: str | None = None  # where a comma stands that may part thousands

    def column(self, index: int, header: str, optional: bool) -> FloatArray:
        """One column, shape (n,); cells without a value are NaN where `optional`, refused elsewhere."""
        cells = [row[index] for row in self._grid.cells]
        self._columns.append((index, header))
        try:
            values = np.array(list(map(float, cells)))
            if np.all(np.abs(values) < _LARGEST) and not any("_" in cell for cell in cells):
                return values
        except ValueError:
            pass
        return np.array([self._number(row, header, cell, optional) for row, cell in enumerate(cells)])

    def finish(self) -> None:
        """Raises InputError where commas were read that may mean something else."""
        if self._comma is None:
            if self._thousands is not None:
                raise InputError(
                    f"{self._thousands} may be a decimal comma or part thousands; write it with a point or without"
                )
            return
        for index, header in self._columns:
            for row, cells in enumerate(self._grid.cells):
                if "." in cells[index]:
                    raise InputError(
                        f"{self._grid.place(row, header)}: {cells[index]!r} has a decimal point, but {self._comma} has "
                        "a decimal comma; use one mark throughout, and nothing between thousands"
                    )

    def _number(self, row: int, header: str, cell: str, optional: bool) -> float:
        place = self._grid.place(row, header)
        if cell.lower() in _NOTHING and (optional or not cell):
            if not optional:
                raise InputError(f"{place}: the cell is empty; fill it in or remove the {self._grid.row_word}")
            return math.nan
        text = cell.replace("\u2212", "-").replace("\u2013", "-")
        if _COMMA.fullmatch(text):
            if _THOUSANDS.fullmatch(text) and self._grid.delimiter != ";":
                self._thousands = self._thousands or f"{place}: {cell!r}"
            else:
                self._comma = self._comma or f"{cell!r} ({self._grid.row_word} {self._grid.lines[row]}, {header!r})"
            text = text.replace(",", ".")
        if not _POINT.fullmatch(text):
            raise InputError(f"{place}: {_why(cell)}; {_mend(cell, optional, self._grid.row_word)}")
        value = float(text)
        if not abs(value) < _LARGEST:
            raise InputError(f"{place}: {cell!r} is too large for a number; mend the cell")
        return value


def _why(cell: str) -> str:
    if cell.upper().startswith(EXCEL_ERRORS):
        return f"{cell!r} is an error of the spreadsheet"
    if cell.startswith("="):
        return f"the formula {cell[:40]!r} was never computed"
    if _is_date(cell):
        return f"{cell!r} is no number but a date that the spreadsheet made of one"
    return f"{cell[:40]!r} is no number"


def _mend(cell: str, optional: bool, row_word: str) -> str:
    otherwise = "leave the cell empty" if optional else f"remove the {row_word}"
    if cell.startswith("="):
        return "open the workbook in a spreadsheet program and save it, or write the value"
    if _is_date(cell):
        return "format the cell as a number and type it again"
    return f"write a plain number in the column's unit, or {otherwise}"


def _is_date(cell: str) -> bool:
    if not _DATE.fullmatch(cell):
        return False
    if cell[:1].isdigit() and "-" in cell[4:8]:
        try:
            datetime.datetime.fromisoformat(cell)
        except ValueError:
            return False
    return True
