"""Excel workbooks (.xlsx, .xlsm) as sheets of text cells.

Numbers keep all their digits. What a spreadsheet does to numbers behind its user's back stays visible: a cell that was
turned into a date comes out as that date and a formula that was never computed as its text, so that `calib.cells` can
refuse it by name.
"""

from __future__ import annotations

import datetime
import io
import warnings
import zipfile
from pathlib import Path
from typing import Any

from calib.sheet import Sheet
from softbot.errors import InputError


def workbook_sheets(path: Path, data: bytes) -> dict[str, Sheet]:
    """The visible sheets that hold anything, by name. Raises InputError for what is no Excel workbook."""
    try:
        members = zipfile.ZipFile(io.BytesIO(data)).namelist()
    except (zipfile.BadZipFile, OSError):
        raise InputError(f"{path}: a damaged workbook or archive; open it, and save it again as .xlsx or CSV") from None
    if "xl/workbook.xml" not in members:
        what = "an OpenDocument file" if "mimetype" in members else "an archive, not a workbook"
        raise InputError(f"{path}: is {what}; save the table as .xlsx or CSV")
    import openpyxl

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # openpyxl warns of styles it does not know; the cells are what counts
            book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
            found = {
                sheet.title: [list(row) for row in sheet.iter_rows(values_only=True)]
                for sheet in book.worksheets
                if sheet.sheet_state == "visible"
            }
            formulas = _formulas(openpyxl, data, found) if any(_hollow(rows) for rows in found.values()) else {}
    except InputError:
        raise
    except Exception as error:  # openpyxl raises whatever its XML parser met
        raise InputError(
            f"{path}: the workbook cannot be read ({type(error).__name__}: {error}); save it again as .xlsx or CSV"
        ) from None
    sheets = {name: _sheet(path, name, rows, formulas.get(name, {})) for name, rows in found.items()}
    sheets = {name: sheet for name, sheet in sheets.items() if sheet.rows}
    if not sheets:
        raise InputError(f"{path}: the workbook has no visible sheet with cells; put the table on one")
    return sheets


def _hollow(rows: list[list[Any]]) -> bool:
    """Whether a row with numbers also has an empty cell, which may be a formula that was never computed."""
    return any(None in row and any(cell is not None for cell in row) for row in rows) or not any(
        cell is not None for row in rows for cell in row
    )


def _formulas(openpyxl: Any, data: bytes, found: dict[str, list[list[Any]]]) -> dict[str, dict[tuple[int, int], str]]:
    """Texts of formulas whose cells are empty, by sheet, row and column."""
    book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=False)
    formulas: dict[str, dict[tuple[int, int], str]] = {}
    for name in found:
        for i, row in enumerate(book[name].iter_rows(values_only=True)):
            for j, cell in enumerate(row):
                if isinstance(cell, str) and cell.startswith("=") and found[name][i][j] is None:
                    formulas.setdefault(name, {})[i, j] = cell
    return formulas


def _sheet(path: Path, name: str, rows: list[list[Any]], formulas: dict[tuple[int, int], str]) -> Sheet:
    for (i, j), formula in formulas.items():
        rows[i][j] = formula
    cells, lines, comments = [], [], []
    for number, row in enumerate(rows, 1):
        texts = [_text(cell) for cell in row]
        while texts and not texts[-1]:
            texts.pop()
        if texts and texts[0].startswith("#") and not any(texts[1:]):
            comments.append(texts[0].lstrip("#").strip())
        elif texts:
            cells.append(texts)
            lines.append(number)
    left = min((next(j for j, text in enumerate(row) if text) for row in cells), default=0)
    width = max((len(row) for row in cells), default=0)
    cells = [row[left:] + [""] * (width - len(row)) for row in cells]
    return Sheet(f"{path}, sheet {name!r}", "row", tuple(comments), cells, lines, "", [])


def _text(cell: Any) -> str:
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return str(cell).upper()
    if isinstance(cell, int | float):
        return repr(cell)
    if isinstance(cell, datetime.datetime | datetime.date | datetime.time):
        return cell.isoformat()
    return str(cell).strip()
