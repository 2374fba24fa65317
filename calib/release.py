"""What the chambers keep of a load that was released: one share, fitted to the release holds of a table.

A hold after a release bends and lengthens the robot as if each chamber still felt a share s of what it lost,

    p_felt = p + s (p_before − p) ,      p_before > p the pressure of the hold before it in the same trial,

which is the residual strain of `softbot.memory.residual` some time after the release. The law of the loading rows is
left as it is; s alone is fitted (soft-L1, bends and lengths in measuring errors). Its interval has two parts: that of
the slope, and that of the law's own coordinates θ, by ∂s/∂θ = −(g·∂r/∂θ)/(g·g) with r the residuals and g = ∂r/∂s.
Rows whose hold before is not in the table cannot be used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.optimize import least_squares

from calib.bend_table import BendTable, FloatArray
from calib.model import Prediction
from calib.robust_fit import LOSS_SCALE, Fit, Observations, bend_vectors

LARGEST_SHARE = 0.9


@dataclass(frozen=True)
class Release:
    """The fitted share and the rows it was fitted to."""

    share: float
    low: float
    high: float
    """95 % interval."""
    rows: BendTable
    """Release rows whose hold before is known, n of them."""
    before_Pa: FloatArray
    """Pressures of that hold, shape (n, 4)."""
    bend_residual_rad: FloatArray
    """Measured less fitted, shape (n, 2); (size, 0) where the direction is unknown."""
    length_residual_m: FloatArray
    """Measured less fitted, shape (n,); NaN where not measured."""


def fit_release(fit: Fit, table: BendTable, errors: Observations) -> Release | None:
    """The share kept after a release, by a table's unloading rows; None without such rows.

    `errors` gives the measuring errors of bend and length.
    """
    rows, before_Pa = _released(table)
    if not len(rows):
        return None
    lost_Pa = np.maximum(before_Pa - rows.pressure_Pa, 0.0)

    def residuals(share: float) -> tuple[FloatArray, FloatArray]:
        prediction = fit.model.predict(fit.theta, rows.pressure_Pa + share * lost_Pa)
        size = np.column_stack([np.hypot(*prediction.bend_rad.T), np.zeros(len(rows))])
        directed = np.isfinite(rows.direction_rad)[:, None]
        bend = bend_vectors(rows) - np.where(directed, prediction.bend_rad, size)
        return bend, rows.length_m - prediction.length_m

    def weighted(at: FloatArray) -> FloatArray:
        bend, length = residuals(float(at[0]))
        measured = np.isfinite(length)
        return np.concatenate([bend.ravel() / errors.bend_error_rad, length[measured] / errors.length_error_m])

    found = least_squares(weighted, [0.1], bounds=([0.0], [LARGEST_SHARE]), loss="soft_l1", f_scale=LOSS_SCALE)
    share = float(found.x[0])
    bend, length = residuals(share)
    numbers = len(rows) + int(np.sum(np.isfinite(length)))
    slope = (
        weighted(np.array([min(share + 1e-4, LARGEST_SHARE)])) - weighted(np.array([max(share - 1e-4, 0.0)]))
    ) / 2e-4
    steepness = max(float(slope @ slope), 1e-12)
    spread = max(float(np.sum(weighted(found.x) ** 2)) / max(numbers - 1, 1), 1e-12)
    law = fit.model.predict(fit.theta, rows.pressure_Pa + share * lost_Pa)
    by_law = _by_coordinates(law, rows, errors)
    seen = np.isfinite(np.diag(fit.covariance))
    moved = -(slope @ by_law)[seen] / steepness
    variance = spread / steepness + float(moved @ fit.covariance[np.ix_(seen, seen)] @ moved)
    half = float(stats.t.ppf(0.975, max(numbers - 1, 1))) * math.sqrt(variance)
    return Release(share, max(share - half, 0.0), min(share + half, LARGEST_SHARE), rows, before_Pa, bend, length)


def _by_coordinates(prediction: Prediction, rows: BendTable, errors: Observations) -> FloatArray:
    """Slopes of the weighted residuals by the law's coordinates, shape (k, m)."""
    size = np.maximum(np.hypot(*prediction.bend_rad.T), 1e-12)
    along = np.einsum("ni,nim->nm", prediction.bend_rad / size[:, None], prediction.bend_by_coordinate)
    sized = np.stack([along, np.zeros_like(along)], axis=1)
    directed = np.isfinite(rows.direction_rad)[:, None, None]
    bend = np.where(directed, prediction.bend_by_coordinate, sized).reshape(-1, along.shape[1])
    measured = np.isfinite(rows.length_m)
    length = prediction.length_by_coordinate[measured]
    return -np.vstack([bend / errors.bend_error_rad, length / errors.length_error_m])


def _released(table: BendTable) -> tuple[BendTable, FloatArray]:
    """Unloading rows that follow a loading hold of their trial, and the pressures of that hold, shape (n, 4) [Pa]."""
    found, before = [], []
    for row in np.flatnonzero(~table.loading):
        own = np.flatnonzero(table.loading & (table.trial == table.trial[row]) & (table.line < table.line[row]))
        if table.trial[row] and own.size:
            hold = own[np.argmax(table.line[own])]
            if np.max(table.pressure_Pa[hold] - table.pressure_Pa[row]) > 0.3 * np.max(table.pressure_Pa):
                found.append(int(row))
                before.append(table.pressure_Pa[hold])
    return table.rows(np.array(found, dtype=int)), np.array(before).reshape(-1, table.pressure_Pa.shape[1])
