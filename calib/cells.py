"""The text of a CSV file as a grid of cells: encoding, delimiter, comments, header lines, numbers."""

from __future__ import annotations

import csv
import io
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.bend_table import FloatArray
from calib.units import unit_name
from softbot.errors import InputError

_EXAMPLE = "pressure_kPa,bend_deg"


@dataclass(frozen=True)
class Grid:
    source: str
    comments: tuple[str, ...]
    header: list[str] | None
    cells: list[list[str]]
    lines: list[int]


def _text(path: Path) -> str:
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check the path") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; name a CSV file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if data[:4] == b"PK\x03\x04" or data[:4] == b"\xd0\xcf\x11\xe0":
        raise InputError(f"{path}: is a spreadsheet, not text; save it as CSV")
    encodings = ("utf-16",) if data[:2] in (b"\xff\xfe", b"\xfe\xff") else ("utf-8-sig", "cp1252")
    for encoding in encodings:
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    raise InputError(f"{path}: not a text file; save the table as CSV in UTF-8")


def read_grid(path: Path, mapped: bool) -> Grid:
    """The cells of a CSV file; without a header only when columns are `mapped` by number.

    Raises InputError for what is no text table, naming the file and the line.
    """
    text, source = _text(path), str(path)
    comments, body, numbers = [], [], []
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("#"):
            comments.append(line.lstrip().lstrip("#").strip())
        elif line.strip(' \t,;"'):
            body.append(line)
            numbers.append(number)
    if not body:
        raise InputError(f"{source}: the file has no rows; a table needs a header ({_EXAMPLE}) and measured rows")
    delimiter = max(";\t,", key=lambda mark: _outside_quotes(body[0]).count(mark))
    try:
        cells = [
            [cell.strip() for cell in row] for row in csv.reader(io.StringIO("\n".join(body)), delimiter=delimiter)
        ]
    except csv.Error as error:
        raise InputError(f"{source}: not valid CSV: {error}") from None
    if len(cells) != len(body):
        raise InputError(f"{source}: a quoted cell runs over several lines; close its quotation marks")
    if all(_is_number(cell) for cell in cells[0] if cell):
        if not mapped:
            raise InputError(
                f"{source}, line {numbers[0]}: no header; write one ({_EXAMPLE}), or map columns by "
                "number: --columns pressure=1:kPa,bend=2:deg"
            )
        return Grid(source, tuple(comments), None, cells, numbers)
    header, first = cells[0], 1
    if len(cells) > 1 and len(cells[1]) <= len(header) and any(cells[1]):
        units = [unit_name(cell.strip("[]()")) for cell in cells[1]]
        if all(unit or not cell for unit, cell in zip(units, cells[1], strict=True)):  # a second header row of units
            header = [
                f"{name}_{unit}" if unit else name
                for name, unit in zip(header, [*units, *[None] * (len(header) - len(units))], strict=True)
            ]
            first = 2
    return Grid(source, tuple(comments), header, cells[first:], numbers[first:])


def _outside_quotes(line: str) -> str:
    return re.sub(r'"[^"]*"', "", line)


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def numbers_of(source: str, header: str, cells: list[str], lines: list[int], optional: bool) -> FloatArray:
    """Cells as numbers; empty ones NaN where `optional`. The fast way first, cell by cell where it fails."""
    try:
        values = np.array(list(map(float, cells)))
        if np.all(np.isfinite(values)) and not any("_" in cell for cell in cells):
            return values
    except ValueError:
        pass
    values = np.empty(len(cells))
    for i, cell in enumerate(cells):
        place = f"{source}, line {lines[i]}, column {header!r}"
        if not cell:
            if not optional:
                raise InputError(f"{place}: the cell is empty; fill it in or remove the line")
            values[i] = math.nan
            continue
        text = cell.replace(",", ".") if re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", cell) else cell
        if not re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", text):
            mend = "leave the cell empty" if optional else "remove the line"
            raise InputError(f"{place}: {cell!r} is no number; write a plain number in the column's unit, or {mend}")
        values[i] = float(text)
        if not math.isfinite(values[i]):
            raise InputError(f"{place}: {cell!r} is too large for a number; mend the cell")
    return values
