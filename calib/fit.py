"""Calibration: from a table to a fitted actuator law, with model choice, intervals and plain words.

Unloading rows do not move the law. Those that follow a hold of their trial give the share of a load that stays after
its release (`calib.release`); others are reported only. Both kinds of hold stand in the lack-of-fit test.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.advice import assumptions_of, warnings_of
from calib.bend_table import BendTable, FloatArray
from calib.calibration import Calibration, Candidate
from calib.design import NextRow, next_rows, telling_row
from calib.estimates import errors_of, intervals, released, t_quantile, widened
from calib.model_choice import AUTO, LAWS, Geometry, chosen, equals_of, model_name, models_of, tried_models
from calib.plausibility import ATMOSPHERE_PA, check_response, looks_absolute
from calib.release import fit_release
from calib.repeats import RepeatError, joined, repeat_error, repeat_groups
from calib.robust_fit import Fit, LeaveOneOut, Observations, bend_vectors, observations
from softbot.errors import InputError

_ASSUMED_ERROR = 0.03  # of full scale, where the table has no repeats
_LEAST_ERROR = 0.005  # of full scale: what no measurement here beats
_RIVAL = 1.25  # a law that predicts this much worse is not yet ruled out
_MOST_ROWS = 150  # more are averaged where their pressures are close


def calibrate_table(table: BendTable, geometry: Geometry | None = None, law: str = AUTO) -> Calibration:
    """Fit the actuator law to the loading rows of a table.

    `law` is "auto" or the name of a wall material. Raises InputError for a table whose bends no choice of parameters
    can explain at all, and for an unknown law.
    """
    geometry = geometry or Geometry()
    if law != AUTO and law not in LAWS:
        raise InputError(f"law = {law!r}: choose one of {', '.join((AUTO, *LAWS))}")
    loading = table.rows(table.loading)
    warnings = [*table.notes, *check_response(loading)]
    groups = repeat_groups(loading)
    bend_repeat = repeat_error(bend_vectors(loading), groups)
    length_repeat = repeat_error(loading.length_m, groups)
    rows = observations(
        _averaged(loading, warnings),
        _measuring_error(bend_repeat, float(np.max(loading.bend_rad))),
        _measuring_error(length_repeat, _length_range(loading)),
    )
    models = models_of(loading, geometry, law, rows)
    tried = tried_models(models, rows)
    if not tried:
        raise InputError(f"{table.source}: the actuator law has no equilibrium near these bends; check the units")
    fit, left_out = chosen(tried)
    _check_dead_band(loading, fit)
    release = fit_release(fit, table, rows)
    errors = errors_of(table, loading, fit, left_out, rows, release, bend_repeat, length_repeat)
    quantile = t_quantile(fit)
    equals = equals_of(fit, tried)
    parameters = widened(intervals(fit, quantile), [intervals(one, t_quantile(one)) for one in equals])
    if release is not None:
        others = [fit_release(one, table, rows) for one in equals]
        parameters |= widened(released(release), [released(one) for one in others if one is not None])
    warnings += warnings_of(table, loading, fit, errors, parameters, rows, equals)
    ranked = sorted(tried, key=lambda one: (one[0] is not fit, one[1].score))
    return Calibration(
        table=table,
        fit=fit,
        parameters=parameters,
        errors=errors,
        candidates=tuple(
            Candidate(model_name(one.model, loading.has_length), len(one.theta), left.score) for one, left in ranked
        ),
        assumptions=tuple(assumptions_of(loading, fit.model, geometry)),
        warnings=tuple(dict.fromkeys(warnings)),
        mass_kg=geometry.mass_kg,
        t_quantile=quantile,
        release=release,
        measure_next=_measure_next(fit, tried, rows, warnings),
    )


def _measure_next(
    fit: Fit, tried: list[tuple[Fit, LeaveOneOut]], rows: Observations, warnings: list[str]
) -> tuple[NextRow, ...]:
    """What to measure next: first what tells the laws apart that predict alike so far, then what narrows the band."""
    if any(text.startswith("lack of fit") for text in warnings):
        return ()
    best = min(left_out.score for _, left_out in tried)
    rivals = [
        (one, left) for one, left in tried if one.model.material != fit.model.material and left.score <= _RIVAL * best
    ]
    found = next_rows(fit, rows)
    if rivals:
        rival = min(rivals, key=lambda one: one[1].score)[0]
        between = telling_row(fit, rival, rows)
        found = [between, *found] if between is not None else found
    return tuple(found)


def _check_dead_band(table: BendTable, fit: Fit) -> None:
    """A dead band of one atmosphere under pressures that never fall below it is no dead band."""
    dead_band_Pa = fit.model.law(fit.theta).dead_band_Pa
    driven = np.max(table.pressure_Pa, axis=0) > 0.2 * np.max(table.pressure_Pa)
    lowest_Pa = float(np.min(table.pressure_Pa[:, driven]))
    if not table.gauge_stated and lowest_Pa > 0.8 * ATMOSPHERE_PA and abs(dead_band_Pa / ATMOSPHERE_PA - 1.0) < 0.1:
        raise looks_absolute(table, f"the bend would begin at {dead_band_Pa / 1e3:.4g} kPa")


def _averaged(table: BendTable, warnings: list[str]) -> BendTable:
    """A long table made short: rows whose pressures are close are averaged, and each average counts as one row."""
    if len(table) <= _MOST_ROWS:
        return table
    largest_Pa = float(np.max(table.pressure_Pa))
    measured = np.column_stack([np.isfinite(table.direction_rad), np.isfinite(table.length_m)])
    width = 0.01
    while True:
        bin_of = joined([*np.round(table.pressure_Pa / (width * largest_Pa)).astype(int).T, *measured.T])
        _, first, count = np.unique(bin_of, return_index=True, return_counts=True)
        if len(count) <= _MOST_ROWS or width > 0.03:
            break
        width *= 1.5

    def mean(values: FloatArray) -> FloatArray:
        return np.bincount(bin_of, weights=values, minlength=len(count)) / count

    vector = bend_vectors(table)
    means = np.column_stack([mean(vector[:, 0]), mean(vector[:, 1])])
    directed = np.isfinite(table.direction_rad[first])
    short = replace(
        table.rows(first),
        pressure_Pa=np.column_stack([mean(column) for column in table.pressure_Pa.T]),
        bend_rad=np.where(directed, np.hypot(*means.T), means[:, 0]),
        direction_rad=np.where(directed, np.arctan2(means[:, 1], means[:, 0]), np.nan),
        length_m=mean(table.length_m),
    )
    if len(short) > _MOST_ROWS:
        short = short.rows(np.linspace(0, len(short) - 1, _MOST_ROWS).astype(int))
    warnings.append(f"{len(table)} loading rows averaged to {len(short)} where their pressures are close")
    return short


def _length_range(table: BendTable) -> float:
    return float(np.nanmax(table.length_m) - np.nanmin(table.length_m)) if table.has_length else 1.0


def _measuring_error(repeat: RepeatError | None, full_scale: float) -> float:
    if repeat is None or repeat.degrees_of_freedom < 2:
        return max(_ASSUMED_ERROR * full_scale, 1e-9)
    return max(repeat.value, _LEAST_ERROR * full_scale, 1e-9)
