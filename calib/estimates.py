"""What a fit found: errors against the table and its repeats, a test for lack of fit, parameters in their intervals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy import stats

from calib.bend_table import BendTable, FloatArray, joined_rows
from calib.calibration import Errors, Estimate
from calib.release import Release
from calib.repeats import RepeatError, repeat_error, repeat_groups
from calib.robust_fit import Fit, LeaveOneOut, Observations, bend_vectors
from softbot.cross_section import CHAMBERS

_MOST_CHECKED = 5000  # rows that the residuals of a long table are computed on
_UNITS = {"Pa": "Pa", "m": "m", "rad": "rad"}


def errors_of(
    table: BendTable,
    loading: BendTable,
    fit: Fit,
    left_out: LeaveOneOut,
    rows: Observations,
    release: Release | None,
    bend_repeat: RepeatError | None,
    length_repeat: RepeatError | None,
) -> Errors:
    """Residuals on loading rows, unloading rows and releases, beside the differences between repeats [rad, m]."""
    bend, length = _residuals(fit, loading)
    rest_m = fit.model.geometry(fit.theta)[0]
    long = loading.has_length
    unloading = table.rows(~table.loading)
    unloaded = _residuals(fit, unloading)[0] if len(unloading) else None
    return Errors(
        rms_bend_rad=_rms(bend),
        loo_bend_rad=_rms(left_out.bend_rad),
        repeat_bend_rad=bend_repeat.value if bend_repeat else None,
        full_scale_bend_rad=float(np.max(loading.bend_rad)),
        rms_length_m=_rms(length) if long else None,
        loo_length_m=_rms(left_out.length_m) if long else None,
        repeat_length_m=length_repeat.value if length_repeat else None,
        full_scale_length_m=float(np.nanmax(np.abs(loading.length_m - rest_m))) if long else None,
        unloading_bend_rad=_rms(unloaded) if unloaded is not None else None,
        release_bend_rad=_rms(release.bend_residual_rad) if release is not None else None,
        release_length_m=_rms(release.length_residual_m)
        if release is not None and np.any(np.isfinite(release.length_residual_m))
        else None,
        lack_of_fit_p=_lack_of_fit(fit, rows, loading, bend, length, release),
    )


def _residuals(fit: Fit, table: BendTable) -> tuple[FloatArray, FloatArray]:
    """Measured less fitted: bends, shape (n, 2) [rad], (size, 0) without direction, and lengths, shape (n,) [m]."""
    if len(table) > _MOST_CHECKED:
        order = np.lexsort([table.length_m, table.bend_rad, *table.pressure_Pa.T])
        table = table.rows(order[np.linspace(0, len(table) - 1, _MOST_CHECKED).astype(int)])
    prediction = fit.model.predict(fit.theta, table.pressure_Pa)
    size = np.column_stack([np.hypot(*prediction.bend_rad.T), np.zeros(len(table))])
    directed = np.isfinite(table.direction_rad)[:, None]
    return bend_vectors(table) - np.where(directed, prediction.bend_rad, size), table.length_m - prediction.length_m


def _lack_of_fit(
    fit: Fit, rows: Observations, table: BendTable, bend: FloatArray, length: FloatArray, release: Release | None
) -> float | None:
    """The classical F test of the residual's excess over the repeats, bends and lengths in measuring errors.

    Loading and release holds together.
    """
    if len(bend) != len(table):
        return None
    coordinates = len(fit.theta)
    if release is not None:
        table = joined_rows(table, release.rows)
        bend = np.vstack([bend, release.bend_residual_rad])
        length = np.concatenate([length, release.length_residual_m])
        coordinates += 1
    groups = repeat_groups(table)
    square = float(np.sum(bend**2) / rows.bend_error_rad**2 + np.nansum(length**2) / rows.length_error_m**2)
    pure, pure_freedom, kinds = 0.0, 0, 0
    for values, unit in ((bend_vectors(table), rows.bend_error_rad), (table.length_m, rows.length_error_m)):
        if not np.any(np.isfinite(values)):
            continue
        measured = np.all(np.isfinite(values.reshape(len(values), -1)), axis=1)
        kinds += len(np.unique(groups[measured]))
        repeats = repeat_error(values / unit, groups)
        if repeats is not None:
            pure += repeats.value**2 * repeats.degrees_of_freedom
            pure_freedom += repeats.degrees_of_freedom
    lack_freedom = kinds - coordinates
    if pure_freedom < 2 or lack_freedom < 1 or pure <= 0.0:
        return None
    ratio = (max(square - pure, 0.0) / lack_freedom) / (pure / pure_freedom)
    return float(stats.f.sf(ratio, lack_freedom, pure_freedom))


def intervals(fit: Fit, quantile: float) -> dict[str, Estimate]:
    """Each free parameter with its interval: in the logarithm for positive ones, straight for the dead band."""
    model, theta = fit.model, fit.theta
    value = model.values(theta)
    seen = np.isfinite(np.diag(fit.covariance))
    covariance = np.where(np.outer(seen, seen), fit.covariance, 0.0)
    low_bound, high_bound = model.bounds()
    at_low, at_high = model.values(low_bound), model.values(high_bound)
    slopes = []
    for n in range(len(theta)):
        step = np.zeros(len(theta))
        step[n] = 1e-6
        ahead, behind = model.values(theta + step), model.values(theta - step)
        slopes.append({name: (ahead[name] - behind[name]) / 2e-6 for name in value})
    estimates = {}
    for name, middle in value.items():
        slope = np.array([one[name] for one in slopes])
        blind = bool(np.any(~seen & (np.abs(slope) > 1e-9 * max(abs(middle), 1e-12))))
        half = quantile * math.sqrt(max(float(slope @ covariance @ slope), 0.0))
        if name == "dead_band_Pa":
            low, high = max(middle - half, at_low[name]), min(middle + half, at_high[name])
            identified = not blind and half < 0.5 * model.largest_pressure_Pa
        elif name.startswith("misalignment_"):
            identified = not blind and half < math.radians(20.0)
            low, high = middle - half, middle + half
        else:
            identified = not blind and half < math.log(10.0) * middle
            low, high = (middle * math.exp(s * half / middle) for s in (-1.0, 1.0)) if identified else (0.0, 0.0)
        if not identified:
            low, high = min(at_low[name], middle), max(at_high[name], middle)
            if name.startswith("gain_"):
                low, high = 0.0, float(CHAMBERS)
        estimates[name] = Estimate(middle, low, high, _UNITS.get(name.rpartition("_")[2], "1"), identified)
    return estimates


def t_quantile(fit: Fit) -> float:
    """Half the width of a 95 % interval in standard deviations: Student's t at the fit's degrees of freedom."""
    return float(stats.t.ppf(0.975, max(fit.degrees_of_freedom, 1)))


def released(release: Release) -> dict[str, Estimate]:
    """The share of a load that stays after its release, with its interval."""
    return {"residual_share": Estimate(release.share, release.low, release.high, "1", True)}


def widened(parameters: dict[str, Estimate], others: list[dict[str, Estimate]]) -> dict[str, Estimate]:
    """Intervals that hold those of other models too, which are as good.

    A parameter that was left out because the table does not ask for it still makes the others uncertain.
    """
    widened = dict(parameters)
    for name, one in ((name, one) for other in others for name, one in other.items()):
        own = widened.get(name)
        if own is not None and own.identified and one.identified:
            widened[name] = replace(own, low=min(own.low, one.low), high=max(own.high, one.high))
    return widened


def _rms(values: FloatArray) -> float:
    """Root of the mean square length of the rows, shape (n,) or (n, 2); NaN rows left out."""
    squares = np.sum(values.reshape(len(values), -1) ** 2, axis=1)
    return math.sqrt(float(np.nanmean(squares)))
