"""The table's own repeat error: how far apart rows are that should be equal.

Rows are repeats of each other when they are the same experimental condition. That is the same branch and the same
`setpoint` label (in a table without labels: pressures that agree within 1 % of the largest one), and the same history:
an unloading row, and one without pressure, stays bent by what was released before it, so the loading hold before it in
its trial has to be the same condition, too. The pooled error is √(Σ |y − ȳ|² / (n − groups))
over the rows y of all groups ȳ of two and more, bends as vectors where the direction was measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.bend_table import BendTable, FloatArray

_TOLERANCE = 0.01  # of the largest pressure
_UNLOADED = 0.02  # of the largest pressure: less is none
_MOST_COMPARED = 5000  # rows that are compared one by one; in longer tables pressures are rounded instead


@dataclass(frozen=True)
class RepeatError:
    """Pooled spread of one quantity over repeats."""

    value: float
    """Pooled standard deviation, in the unit of the quantity."""
    degrees_of_freedom: int
    """Rows less groups, over the groups of two and more."""


def repeat_groups(table: BendTable) -> NDArray[np.int_]:
    """A number for each row, shape (n,), equal for rows that repeat each other."""
    same = _same_hold(table)
    before = _hold_before(table)
    alone = -2 - np.arange(len(table))
    trusted = table.loading | (table.setpoint != "")  # of an unloading row without a label the history has to be known
    return joined([same, np.where(before >= 0, same[before], np.where(trusted, -1, alone))])


def _hold_before(table: BendTable) -> NDArray[np.int_]:
    """The last loading row with pressure before each row of its trial whose bend remembers it, shape (n,); −1: none.

    Rows that were loaded to a pressure forget what was before.
    """
    highest_Pa = np.max(table.pressure_Pa, axis=1)
    driven = highest_Pa > _UNLOADED * float(np.max(highest_Pa))
    order = np.lexsort([table.line, table.trial])
    position = np.where((table.loading & driven)[order], np.arange(len(table)), -1)
    last = np.maximum.accumulate(position)
    before = np.empty(len(table), dtype=int)
    before[order] = np.where(last >= 0, order[last], -1)
    known = (before >= 0) & (table.trial[before] == table.trial) & ~(table.loading & driven)
    return np.where(known, before, -1)


def _same_hold(table: BendTable) -> NDArray[np.int_]:
    """A number for each row, shape (n,), equal for rows of one branch and one label or pressure."""
    if np.any(table.setpoint != ""):
        alone = np.where(table.setpoint == "", table.line, 0)
        keys = [table.setpoint, table.loading, alone]
        return joined([np.unique(key, return_inverse=True)[1] for key in keys])
    scaled = table.pressure_Pa / (_TOLERANCE * float(np.max(table.pressure_Pa)))
    if len(table) > _MOST_COMPARED:
        return joined([*np.round(scaled).astype(int).T, table.loading])
    order = np.lexsort([*scaled.T, table.loading])
    groups, count, first = np.empty(len(table), dtype=int), -1, -1
    for row in order:
        near = (
            first >= 0
            and table.loading[row] == table.loading[first]
            and np.all(np.abs(scaled[row] - scaled[first]) <= 1.0)
        )
        if not near:
            count, first = count + 1, row
        groups[row] = count
    return groups


def joined(keys: list[NDArray[Any]]) -> NDArray[np.int_]:
    """A number for each row, shape (n,), equal where all of the integer `keys`, shape (n,) each, are equal."""
    number = np.zeros(len(keys[0]), dtype=int)
    for key in keys:
        _, part = np.unique(key, return_inverse=True)
        _, number = np.unique(number * (int(part.max()) + 1) + part, return_inverse=True)
    return number


def repeat_error(values: FloatArray, groups: NDArray[np.int_]) -> RepeatError | None:
    """Pooled spread of `values`, shape (n,) or (n, k) and NaN where not measured; None without repeats."""
    columns = values.reshape(len(values), -1)
    measured = np.all(np.isfinite(columns), axis=1)
    if not np.any(measured):
        return None
    _, group, count = np.unique(groups[measured], return_inverse=True, return_counts=True)
    freedom = int(np.sum(count - 1))
    if freedom == 0:
        return None
    square = 0.0
    for column in columns[measured].T:
        mean = np.bincount(group, weights=column) / count
        square += float(np.sum((column - mean[group]) ** 2))
    return RepeatError(math.sqrt(square / freedom), freedom)
