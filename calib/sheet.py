"""A file opened as rows of text cells, whatever it was: CSV in any encoding and delimiter, or an Excel workbook.

Nothing is interpreted here but the file's form. `calib.header` finds out what the columns are called and
`calib.cells` turns cells into numbers.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from softbot.errors import InputError

EXAMPLE = "pressure_kPa,bend_deg"
EXCEL_ERRORS = ("#N/A", "#DIV/0!", "#REF!", "#VALUE!", "#NAME?", "#NUM!", "#NULL!")
_DELIMITERS = (";", "\t", ",", " ")
_SAMPLE = 50  # lines that the delimiter is told by
_FOREIGN = (  # first bytes, what they are, the mend
    (b"\xd0\xcf\x11\xe0", "an old or protected workbook", "save it as .xlsx without a password, or as CSV"),
    (b"\x1f\x8b", "compressed (gzip)", "unpack it first"),
    (b"%PDF", "a PDF", "save the table as CSV"),
    (b"PAR1", "a Parquet file", "save the table as CSV"),
    (b"\x89HDF", "an HDF5 file", "save the table as CSV"),
    (b"MATLAB", "a MATLAB file", "save the table as CSV (writetable)"),
)


@dataclass(frozen=True)
class Sheet:
    """Rows of one table of a file; blank rows left out."""

    source: str
    """The file, and the sheet where there are several, for messages."""
    row_word: str
    """What a row of this file is called: "line" of a text, "row" of a workbook."""
    comments: tuple[str, ...]
    """Comment lines without their marks."""
    rows: list[list[str]]
    lines: list[int]
    """Number of each row in the file, counted from 1."""
    delimiter: str
    """What parts the cells of a text; "" in a workbook."""
    comment_above: list[str]
    """Cells of the comment right above the first row, which may be the header; else empty."""


def read_bytes(path: Path) -> bytes:
    """The file's bytes. Raises InputError that names the file and the mend."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check the path") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; name a CSV file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; check the path and its permissions") from None


def text_sheet(path: Path, data: bytes) -> Sheet:
    """The rows of a text file. Raises InputError for what is no table in text, naming file, line and mend."""
    source, text = str(path), _text(path, data)
    comments: list[str] = []
    body: list[str] = []
    numbers: list[int] = []
    given: str | None = None
    above = ""
    for number, line in enumerate(text.splitlines(), 1):
        bare = line.lstrip()
        if bare.startswith(("#", "%")) and not bare.upper().startswith(EXCEL_ERRORS):
            comments.append(bare.lstrip("#%").strip())
            above = above if body else comments[-1]
        elif not body and re.fullmatch(r"sep=.", bare.rstrip(), re.IGNORECASE):
            given = bare.rstrip()[-1]  # what Excel writes for itself
        elif line.strip(' \t,;"'):
            body.append(line)
            numbers.append(number)
    if not body:
        raise InputError(f"{source}: the file has no rows; a table needs a header ({EXAMPLE}) and measured rows")
    delimiter = given or _delimiter(body)
    rows, lines = [], []
    for index, row in _split(source, body, delimiter):
        rows.append(row)
        lines.append(numbers[index])
    above_cells = next((row for _, row in _split(source, [above], delimiter)), []) if above else []
    return Sheet(source, "line", tuple(comments), rows, lines, delimiter, above_cells)


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with a decimal point or comma."""
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _text(path: Path, data: bytes) -> str:
    for mark, what, mend in _FOREIGN:
        if data.startswith(mark):
            raise InputError(f"{path}: is {what}, not a table; {mend}")
    if data[:4] in (b"\xff\xfe\0\0", b"\0\0\xfe\xff"):
        encodings: tuple[str, ...] = ("utf-32",)
    elif data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encodings = ("utf-16",)
    elif len(data) > 8 and data[1:400:2].count(0) > 0.8 * len(data[1:400:2]):
        encodings = ("utf-16-le",)
    elif len(data) > 8 and data[0:400:2].count(0) > 0.8 * len(data[0:400:2]):
        encodings = ("utf-16-be",)
    else:
        encodings = ("utf-8-sig", "cp1252")
    for encoding in encodings:
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        start = text[:4000]
        if "\0" in text or sum(ord(c) < 32 and c not in "\t\r\n\x0b\x0c" for c in start) > 0.01 * len(start):
            break
        if re.match(r"\s*<(!doctype|html|table|\?xml)", start, re.IGNORECASE):
            raise InputError(f"{path}: is a web page or XML, not a table; save the table as CSV or .xlsx")
        if re.match(r"\s*[\[{]\s*[\"\[{]", start):
            raise InputError(f"{path}: is JSON, not a table; save the table as CSV with a header ({EXAMPLE})")
        return text
    raise InputError(f"{path}: not a text file; save the table as CSV in UTF-8, or as .xlsx")


def _delimiter(body: list[str]) -> str:
    """The mark whose number is the same on most lines; of equals the first of `_DELIMITERS`."""
    lines = [re.sub(r'"[^"]*"', "", line).strip(" ") for line in body[:_SAMPLE]]
    best, most = ",", 0
    for mark in _DELIMITERS:
        counts = Counter(len(line.split()) - 1 if mark == " " else line.count(mark) for line in lines)
        counts.pop(0, None)
        alike = max(counts.values(), default=0)
        if alike > most:
            best, most = mark, alike
    return best


def _split(source: str, body: list[str], delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Index in `body` and cells of each row; a quoted cell may run over lines (as headers of spreadsheets do)."""
    spaces = delimiter == " "
    texts = (re.sub(r"\s+", " ", line.strip()) + "\n" if spaces else line + "\n" for line in body)
    reader = csv.reader(texts, delimiter=delimiter)
    before = 0
    try:
        for row in reader:
            span = reader.line_num - before
            if span > 3 or (span > 1 and any(is_number(cell) for cell in row)):
                raise InputError(
                    f"{source}: in row {before + 1} of the table a quoted cell runs over several lines; "
                    "close its quotation marks"
                )
            yield before, [cell.strip() for cell in row]
            before = reader.line_num
    except csv.Error as error:
        raise InputError(f"{source}: not valid CSV: {error}; save it as CSV again") from None
