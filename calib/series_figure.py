"""Picture of a calibration from recordings: each trial over time and as a loop over its pressure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calib.figure import write_figure
from calib.series_calibration import SeriesCalibration

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_TRIALS = 8
_MEASURED, _FITTED, _PRESSURE = "0.25", "#d55e00", "#56b4e9"


def save_series_figure(calibration: SeriesCalibration, path: Path) -> None:
    """Write the picture as PNG, SVG or PDF, by the file's ending. Raises InputError where it cannot be written."""
    write_figure(draw_trials(calibration), path)


def draw_trials(calibration: SeriesCalibration) -> Figure:
    """One row a trial: bend over time with the prediction, its residual, and the loop of bend over pressure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    trials = calibration.trials[:MOST_TRIALS]
    figure = Figure(figsize=(11.0, 2.6 * len(trials)), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(trials), 3, squeeze=False, width_ratios=(2.2, 1.4, 1.2))
    fit = calibration.fit
    for n, (trial, axes) in enumerate(zip(trials, grid, strict=True)):
        predicted_deg = np.degrees(fit.prediction.bend_rad(trial))
        measured_deg = np.degrees(trial.bend_rad)
        half_deg = np.degrees(calibration.band * trial.full_scale_rad)
        over_time, residual, loop = axes
        over_time.fill_between(
            trial.t_s, predicted_deg - half_deg, predicted_deg + half_deg, color=_FITTED, alpha=0.12, linewidth=0
        )
        over_time.plot(trial.t_s, measured_deg, ".", color=_MEASURED, markersize=2, label="measured")
        over_time.plot(trial.t_s, predicted_deg, color=_FITTED, linewidth=1.2, label="law with memory")
        over_time.plot(
            trial.t_s, fit.scale[n] * predicted_deg, ":", color=_FITTED, linewidth=1.2, label="… of this trial's size"
        )
        pressure = over_time.twinx()
        for i in trial.driven:
            pressure.plot(trial.grid_s, trial.pressure_Pa[:, i] / 1e3, color=_PRESSURE, linewidth=0.7)
        pressure.set_ylabel("kPa", color=_PRESSURE)
        over_time.set(ylabel="bend [°]", title=f"trial {trial.name}, chamber {', '.join(map(str, trial.driven))}")
        _residual(residual, trial.t_s, measured_deg - predicted_deg, measured_deg - fit.scale[n] * predicted_deg)
        driven_kPa = np.max(trial.pressure_Pa[:, list(trial.driven)], axis=1) / 1e3
        at_kPa = np.interp(trial.t_s, trial.grid_s, driven_kPa)
        loop.plot(at_kPa, measured_deg, ".", color=_MEASURED, markersize=2)
        loop.plot(at_kPa, fit.scale[n] * predicted_deg, color=_FITTED, linewidth=1.0)
        loop.set_ylabel("bend [°]")
    grid[0, 0].legend(fontsize=7, frameon=False, loc="lower center")
    grid[0, 2].set_title("loop over the sensor's pressure", fontsize=9)
    for axis, label in zip(grid[-1], ("t [s]", "t [s]", "pressure [kPa]"), strict=True):
        axis.set_xlabel(label)
    for axis in grid.ravel():
        axis.grid(alpha=0.25)
        axis.title.set_fontsize(9)
    return figure


def _residual(axis: Axes, t_s: np.ndarray, raw_deg: np.ndarray, scaled_deg: np.ndarray) -> None:
    axis.plot(t_s, raw_deg, color="0.6", linewidth=0.8)
    axis.plot(t_s, scaled_deg, color=_FITTED, linewidth=0.8)
    axis.axhline(0.0, color="0.3", linewidth=0.6)
    axis.set(ylabel="measured − law [°]", title="residual (grey: size as predicted)")
