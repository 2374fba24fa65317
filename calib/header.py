"""Which rows of a sheet are its header, and what each column is then called.

Above the header there may be title lines. The header may be one row, a row of names and a row of units, or merged
cells over names below them (`Pressure (kPa)` over `chamber 0`, `chamber 1`, …); without one, columns are numbered.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from calib.sheet import EXAMPLE, Sheet, is_number
from calib.units import split_header, unit_name
from softbot.errors import InputError

_HIGHEST = 30  # rows that are searched for a header
_WORDS = ("pressure", "bend", "curvature", "angle", "druck", "p", "length", "chamber", "trial", "t", "time")


@dataclass(frozen=True)
class Grid:
    """The body of a table, with a name for each column."""

    source: str
    row_word: str
    comments: tuple[str, ...]
    notes: tuple[str, ...]
    """What was skipped or joined, in words."""
    header: list[str] | None
    cells: list[list[str]]
    lines: list[int]
    delimiter: str

    def place(self, row: int, header: str | None = None) -> str:
        """Where a cell or a row stands, for messages."""
        where = f"{self.source}, {self.row_word} {self.lines[row]}"
        return where if header is None else f"{where}, column {header!r}"


def grid_of(sheet: Sheet, mapped: bool) -> Grid:
    """A sheet parted in header and body. Without a header only when columns are `mapped` by number.

    Raises InputError where there is no header, naming the file and the line.
    """
    rows = sheet.rows
    if all(is_number(cell) for cell in rows[0] if cell):
        if len(sheet.comment_above) == len(rows[0]) and any(_known(cell) for cell in sheet.comment_above):
            return _grid(sheet, [], sheet.comment_above, 0)
        if not mapped:
            raise InputError(
                f"{sheet.source}, {sheet.row_word} {sheet.lines[0]}: no header; write one ({EXAMPLE}), or map columns "
                "by number: --columns pressure=1:kPa,bend=2:deg"
            )
        return _grid(sheet, [], None, 0)
    top = _top(rows)
    notes = [
        f"{sheet.row_word} {line} stands above the header and is not used: {' '.join(filter(None, row))!r}"
        for row, line in zip(rows[:top], sheet.lines[:top], strict=True)
    ]
    header, first = list(rows[top]), top + 1
    if first < len(rows) and _is_merged(header, rows[first]):
        header, first = _joined(header, rows[first]), first + 1
    if first < len(rows) and len(rows[first]) <= len(header) and any(rows[first]):
        units = [_unit(cell) for cell in rows[first]]
        if all(unit or not cell for unit, cell in zip(units, rows[first], strict=True)):
            units += [None] * (len(header) - len(units))
            header = [f"{name} [{unit}]" if unit else name for name, unit in zip(header, units, strict=True)]
            first += 1
    return _grid(sheet, notes, header, first)


def _grid(sheet: Sheet, notes: list[str], header: list[str] | None, first: int) -> Grid:
    return Grid(
        source=sheet.source,
        row_word=sheet.row_word,
        comments=sheet.comments,
        notes=tuple(notes),
        header=header,
        cells=sheet.rows[first:],
        lines=sheet.lines[first:],
        delimiter=sheet.delimiter,
    )


def _known(cell: str) -> bool:
    """Whether a cell reads like the name of a quantity."""
    name, unit = split_header(cell)
    return any(name == word or name.startswith(word + "_") for word in _WORDS) or (
        unit is not None and unit_name(unit) is not None and any(word in name for word in _WORDS[:4])
    )


def _top(rows: list[list[str]]) -> int:
    """The row of the header: the first that names two quantities, else the first with two cells of text."""
    for words in (2, 1):
        for index, row in enumerate(rows[:_HIGHEST]):
            texts = [cell for cell in row if cell and not is_number(cell)]
            if sum(map(_known, texts)) >= words and sum(map(bool, row)) >= 2:
                return index
    for index, row in enumerate(rows[:_HIGHEST]):
        if sum(bool(cell) and not is_number(cell) for cell in row) >= 2:
            return index
    return 0


def _unit(cell: str) -> str | None:
    return unit_name(cell.strip("[]()"))


def _is_merged(header: list[str], below: list[str]) -> bool:
    """Whether the row below names columns under the merged (hence empty) cells of the header."""
    gaps = [j for j, cell in enumerate(below) if j > 0 and (j >= len(header) or not header[j]) and cell]
    if not gaps or not any(header[: gaps[0]]):
        return False
    if any(cell and not is_number(cell) for cell in below):
        return True
    numbers = [cell for cell in below if cell]
    return len(numbers) < len(below) and all(re.fullmatch(r"[0-9]", cell) for cell in numbers)


def _joined(header: list[str], below: list[str]) -> list[str]:
    """Names of merged cells spread over their columns, each with the name below."""
    names, above = [], ""
    for j in range(max(len(header), len(below))):
        above = header[j] if j < len(header) and header[j] else above
        under = below[j] if j < len(below) else ""
        name, unit = split_header(above)
        chamber = re.fullmatch(r"(?:chamber|channel|ch|kammer|p)?[\s_.]*([0-9])", under.strip().lower())
        if not under:
            names.append(above if j < len(header) and header[j] else "")
        elif _unit(under):
            names.append(f"{name} [{_unit(under)}]")
        elif chamber and (unit or name.startswith("p")):
            names.append(f"{name}_{chamber.group(1)}" + (f" [{unit}]" if unit else ""))
        elif split_header(under)[1] or _known(under):
            names.append(under)
        else:
            names.append(f"{name}_{under}" + (f" [{unit}]" if unit else ""))
    return names
