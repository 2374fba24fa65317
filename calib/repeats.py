"""The table's own repeat error: how far apart rows are that should be equal.

Rows are repeats of each other when they have the same branch and the same `setpoint` label; in a table without
labels, when their pressures agree within 1 % of the largest one. The pooled error is √(Σ |y − ȳ|² / (n − groups))
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
