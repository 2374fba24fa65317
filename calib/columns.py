"""Which column of a table is which quantity, in which unit: by its header, or by an explicit mapping."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from calib.header import Grid
from calib.units import (
    ANGLE_RAD,
    CURVATURE_1_M,
    LENGTH_M,
    PRESSURE_PA,
    TIME_S,
    split_header,
    unit_and_reference,
)
from softbot.cross_section import CHAMBERS
from softbot.errors import InputError

_NAMES = {
    "p": "pressure",
    "gauge_pressure": "pressure",
    "pressure_gauge": "pressure",
    "absolute_pressure": "pressure_absolute",
    "pressure_abs": "pressure_absolute",
    "bending": "bend",
    "bend_angle": "bend",
    "bending_angle": "bend",
    "angle": "bend",
    "theta": "bend",
    "bend_direction_angle": "bend_direction",
    "ok": "valid",
    "direction": "bend_direction",
    "arc_length": "length",
    "time": "t",
    **{f"p{i}": f"pressure_{i}" for i in range(CHAMBERS)},
    **{f"p_{i}": f"pressure_{i}" for i in range(CHAMBERS)},
    **{f"pressure_gauge_{i}": f"pressure_{i}" for i in range(CHAMBERS)},
    **{f"pressure_{i}_gauge": f"pressure_{i}" for i in range(CHAMBERS)},
    **{f"pressure_{i}_absolute": f"pressure_absolute_{i}" for i in range(CHAMBERS)},
    **{f"pressure_{i}_abs": f"pressure_absolute_{i}" for i in range(CHAMBERS)},
}
GAUGE = ("pressure", *(f"pressure_{i}" for i in range(CHAMBERS)))
ABSOLUTE = ("pressure_absolute", *(f"pressure_absolute_{i}" for i in range(CHAMBERS)))
_UNITS: dict[str, Mapping[str, float]] = {
    **dict.fromkeys((*GAUGE, *ABSOLUTE), PRESSURE_PA),
    "bend": ANGLE_RAD,
    "bend_direction": ANGLE_RAD,
    "curvature": CURVATURE_1_M,
    "length": LENGTH_M,
    "t": TIME_S,
}
_LABELS = ("chamber", "branch", "trial", "setpoint", "valid")


@dataclass(frozen=True)
class Column:
    """One column of a table that was understood."""

    index: int
    header: str
    quantity: str
    scale: float  # SI units per unit of the column; 1 for labels


def parse_columns(text: str) -> dict[str, tuple[str, str | None]]:
    """The `--columns` option: quantity → (header, unit). Raises InputError for what is no such mapping."""
    known = [*_UNITS, *_LABELS]
    mapping: dict[str, tuple[str, str | None]] = {}
    for part in re.split(r",(?=[^,]*=)", text):
        quantity, sign, rest = part.partition("=")
        quantity = quantity.strip()
        quantity = _NAMES.get(quantity, quantity)
        header, colon, unit = rest.rpartition(":")
        if not colon:
            header, unit = rest, ""
        if not sign or not header.strip():
            raise InputError(f"--columns {part.strip()!r}: write quantity=HEADER:UNIT, as in pressure=Druck:kPa")
        if quantity not in known:
            raise InputError(f"--columns {part.strip()!r}: unknown quantity {quantity!r}; known: {', '.join(known)}")
        if quantity in mapping:
            raise InputError(f"--columns: {quantity} is mapped twice; give it once")
        mapping[quantity] = (header.strip(), unit.strip() or None)
    return mapping


def choose_columns(grid: Grid, mapping: Mapping[str, tuple[str, str | None]]) -> tuple[dict[str, Column], list[str]]:
    """The column of each quantity, and notes on what is not used.

    Raises InputError for a missing, doubled or unitless column.
    """
    width = len(grid.header) if grid.header is not None else max(len(row) for row in grid.cells)
    headers = grid.header if grid.header is not None else [f"column {i + 1}" for i in range(width)]
    chosen: dict[str, Column] = {}
    for quantity, (header, unit) in mapping.items():
        index = _find(grid.source, headers, header)
        read = split_header(headers[index])[1] if unit is None else unit
        quantity = _referred(quantity, read)
        chosen[quantity] = Column(index, headers[index], quantity, _scale(grid.source, headers[index], quantity, read))
    taken = {column.index for column in chosen.values()}
    ignored, unnamed = [], []
    for index, header in enumerate(headers if grid.header is not None else []):
        if index in taken:
            continue
        if not header:
            if any(index < len(row) and row[index] for row in grid.cells):
                unnamed.append(index + 1)
            continue
        name, unit = split_header(header)
        quantity = _referred(_NAMES.get(name, name), unit)
        if quantity in mapping:
            continue
        if quantity in _LABELS or quantity in _UNITS:
            if quantity in chosen:
                raise InputError(
                    f"{grid.source}: {quantity} stands in two columns, {chosen[quantity].header!r} and "
                    f"{header!r}; keep one"
                )
            chosen[quantity] = Column(index, header, quantity, _scale(grid.source, header, quantity, unit))
            continue
        base = next((known for known in ("pressure", "curvature", "bend", "length") if name.startswith(known)), None)
        if base is not None and unit is None:
            last = name.rpartition("_")[2]
            raise InputError(
                f"{grid.source}: column {header!r}: unknown unit {last!r}; use one of "
                f"{', '.join(_UNITS[base])}, or --columns {base}={header}:UNIT"
            )
        if base == "pressure":
            raise InputError(
                f"{grid.source}: column {header!r}: chambers are pressure_0 … pressure_{CHAMBERS - 1}, counted from 0; "
                "rename the column"
            )
        ignored.append(header)
    _require(grid.source, headers, chosen)
    notes = [f"column {header!r} is not used" for header in ignored]
    return chosen, notes + [f"column {number} has no name and is not used" for number in unnamed]


def _referred(quantity: str, unit: str | None) -> str:
    """The quantity with what its unit says of gauge or absolute (`psia`)."""
    if quantity in GAUGE and unit is not None and unit_and_reference(unit)[1]:
        return ABSOLUTE[GAUGE.index(quantity)]
    return quantity


def _find(source: str, headers: Sequence[str], wanted: str) -> int:
    if wanted in headers:
        return list(headers).index(wanted)
    folded = [header.lower() for header in headers]
    if wanted.lower() in folded:
        return folded.index(wanted.lower())
    if wanted.isdigit() and 1 <= int(wanted) <= len(headers):
        return int(wanted) - 1
    raise InputError(f"{source}: --columns: no column {wanted!r}; the table has {', '.join(map(repr, headers))}")


def _scale(source: str, header: str, quantity: str, unit: str | None) -> float:
    if quantity in _LABELS:
        return 1.0
    allowed = _UNITS[quantity]
    if unit is None:
        example = next(iter(allowed)) if quantity not in (*GAUGE, *ABSOLUTE) else "kPa"
        raise InputError(
            f"{source}: column {header!r}: the unit is missing; name it {quantity}_{example}, or give "
            f"--columns {quantity}={header}:{example}"
        )
    name, absolute = unit_and_reference(unit)
    if quantity in ABSOLUTE and absolute is False:
        raise InputError(f"{source}: column {header!r} says both absolute and gauge; name it for what it is")
    if name is None or name not in allowed:
        raise InputError(
            f"{source}: column {header!r}: {unit!r} is no unit of {quantity}; use one of {', '.join(allowed)}"
        )
    return allowed[name]


def _require(source: str, headers: Sequence[str], chosen: Mapping[str, Column]) -> None:
    found = f"found: {', '.join(map(repr, headers))}"
    pressures = [name for name in (*GAUGE, *ABSOLUTE) if name in chosen]
    if not pressures:
        raise InputError(
            f"{source}: no pressure column; name it pressure_kPa or pressure_0_kPa … pressure_3_kPa, or "
            f"give --columns pressure=HEADER:UNIT ({found})"
        )
    single = [name for name in pressures if name in ("pressure", "pressure_absolute")]
    if single and len(pressures) > 1:
        raise InputError(
            f"{source}: {' and '.join(pressures)} stand side by side; give one column for one chamber, or "
            f"pressure_0 … pressure_{CHAMBERS - 1}, gauge or absolute"
        )
    if "chamber" in chosen and not single:
        raise InputError(f"{source}: a chamber column goes with one pressure column; with {pressures[0]} … remove it")
    if ("bend" in chosen) == ("curvature" in chosen):
        raise InputError(
            f"{source}: {'both a bend and a curvature' if 'bend' in chosen else 'no bend'} column; name one "
            f"bend_deg (or curvature_1_m), or give --columns bend=HEADER:UNIT ({found})"
        )
    gauge = {name[-1] for name in pressures if name in GAUGE}
    absolute = {name[-1] for name in pressures if name in ABSOLUTE}
    if gauge & absolute:
        raise InputError(f"{source}: a chamber has both a gauge and an absolute pressure; keep one")
