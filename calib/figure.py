"""Picture of a calibration: the table, the fitted law and its 95 % bands of confidence and of prediction.

Rows are put on curves by which chambers they drive: a curve starts where all chambers have the table's pressure at
rest and ends where the driven ones have the largest. Tables with more combinations of chambers than a picture can
hold are shown as fitted against measured.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.bend_table import BendTable, FloatArray
from calib.calibration import Calibration
from calib.robust_fit import bend_vectors
from softbot.cross_section import CHAMBERS
from softbot.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_CURVES = 6  # and rows at rest
_POINTS = 60
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # told apart by the colour-blind
_FORMATS = (".png", ".svg", ".pdf")


def save_figure(calibration: Calibration, path: Path) -> None:
    """Write the picture as PNG, SVG or PDF, by the file's ending. Raises InputError where it cannot be written."""
    write_figure(draw_table(calibration), path)


def write_figure(figure: Figure, path: Path) -> None:
    """Write a picture as PNG, SVG or PDF, by the file's ending. Raises InputError where it cannot be written."""
    if path.suffix.lower() not in _FORMATS:
        raise InputError(f"{path}: a picture ends in {', '.join(_FORMATS)}")
    try:
        figure.savefig(path, dpi=150)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}; choose another place") from None


def draw_table(calibration: Calibration) -> Figure:
    """Bend, and length where it was measured, over pressure: rows, law and 95 % bands."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    table = calibration.table
    panels = 2 if table.has_length else 1
    figure = Figure(figsize=(5.2 * panels, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, panels, squeeze=False)[0]
    combinations = _combinations(table)
    draw = _curves if len([one for one in combinations if one]) <= MOST_CURVES else _fitted_against_measured
    draw(calibration, combinations, axes)
    report = calibration.report()
    repeats = report["repeat_bend_percent"]
    subtitle = f"{calibration.law}; bend: rms {report['rms_bend_percent']:.1f} %, leave-one-out " + (
        f"{report['loo_bend_percent']:.1f} %" + (f", repeats {repeats:.1f} %" if repeats is not None else "")
    )
    name = Path(*Path(table.source).parts[-2:]).as_posix()  # with its folder, where one was given
    figure.suptitle(f"{name}\n{subtitle} of full scale", fontsize=10)
    return figure


def _combinations(table: BendTable) -> dict[tuple[int, ...], NDArray[np.int_]]:
    """Chambers at over half of a row's largest rise → loading rows that drive just these (none: nearly at rest)."""
    rise = table.pressure_Pa - _rest_Pa(table)
    found: dict[tuple[int, ...], list[int]] = {}
    for row, one in enumerate(rise):
        if table.loading[row]:
            driven = tuple(i for i in range(CHAMBERS) if one[i] > max(0.5 * np.max(one), 0.05 * np.max(rise)))
            found.setdefault(driven, []).append(row)
    return {chambers: np.array(rows) for chambers, rows in sorted(found.items())}


def _curves(
    calibration: Calibration, combinations: dict[tuple[int, ...], NDArray[np.int_]], axes: NDArray[Any]
) -> None:
    table = calibration.table
    low_Pa = _rest_Pa(table)
    colours = iter(_COLOURS)
    for chambers, rows in combinations.items():
        driven = list(chambers) or list(range(CHAMBERS))
        place_kPa = np.max(table.pressure_Pa[rows][:, driven], axis=1) / 1e3
        if not chambers:
            _points(axes, "0.2", place_kPa, table, rows)
            continue
        colour = next(colours)
        _points(axes, colour, place_kPa, table, rows)
        path_Pa = np.tile(low_Pa, (_POINTS, 1))
        top_Pa = np.max(table.pressure_Pa[rows][:, driven])
        path_Pa[:, driven] = np.linspace(low_Pa[driven], np.full(len(driven), top_Pa), _POINTS)
        name = _chambers(tuple(driven))
        curves, bands = calibration.bend_and_length(path_Pa), calibration.half_bands(path_Pa)
        wide = calibration.prediction_half_bands(path_Pa)
        bend_deg = np.degrees(np.hypot(*curves[0].T))
        across = np.mean(path_Pa[:, driven], axis=1) / 1e3
        _panel(axes[0], colour, name, across, bend_deg, np.degrees([bands[0], wide[0]]), 0.0)
        if len(axes) > 1:
            _panel(axes[1], colour, name, across, 1e3 * curves[1], 1e3 * np.array([bands[1], wide[1]]), -np.inf)
    released = np.flatnonzero(~table.loading)
    if released.size:
        _points(
            axes, "0.4", np.max(table.pressure_Pa[released], axis=1) / 1e3, table, released, "unloading (not fitted)"
        )
    for axis, label in zip(axes, ("bend [°]", "arc length [mm]"), strict=False):
        axis.set(xlabel="pressure of the driven chambers [kPa]", ylabel=label)
        axis.grid(alpha=0.25)
        axis.set_xlim(left=0.0)
    axes[0].set_ylim(bottom=0.0)
    axes[0].legend(fontsize=8, frameon=False)


def _panel(
    axis: Axes, colour: str, name: str, across: FloatArray, curve: FloatArray, bands: FloatArray, least: float
) -> None:
    """A curve with its bands, half widths of shape (2, n): of the law, and of one more measurement."""
    for band, alpha in zip(bands, (0.18, 0.07), strict=True):
        axis.fill_between(across, np.maximum(curve - band, least), curve + band, color=colour, alpha=alpha, linewidth=0)
    axis.plot(across, curve, color=colour, label=name)


def _points(
    axes: NDArray[Any],
    colour: str,
    place_kPa: FloatArray,
    table: BendTable,
    rows: NDArray[np.int_],
    hollow: str | None = None,
) -> None:
    """Measured rows in every panel, shape (k,) each; hollow, with that label, where they are not fitted."""
    face = "none" if hollow else colour
    for axis, value in zip(axes, (np.degrees(table.bend_rad), 1e3 * table.length_m), strict=False):
        axis.plot(place_kPa, value[rows], "o", mfc=face, mec=colour, markersize=5, label=hollow)


def _rest_Pa(table: BendTable) -> FloatArray:
    """Pressure of each chamber at rest, shape (4,): the table's lowest where that is low, else nothing."""
    low_Pa = np.min(table.pressure_Pa, axis=0)
    return np.where(low_Pa < 0.2 * np.max(table.pressure_Pa), np.maximum(low_Pa, 0.0), 0.0)


def _fitted_against_measured(
    calibration: Calibration, combinations: dict[tuple[int, ...], NDArray[np.int_]], axes: NDArray[Any]
) -> None:
    table = calibration.table
    bend, length = calibration.bend_and_length(table.pressure_Pa)
    pairs = (
        ("bend [°]", np.degrees(table.bend_rad), np.degrees(np.hypot(*bend.T))),
        ("arc length [mm]", 1e3 * table.length_m, 1e3 * length),
    )
    for axis, (name, measured, fitted) in zip(axes, pairs, strict=False):
        for loading, face, label in ((True, _COLOURS[0], "loading"), (False, "none", "unloading (not fitted)")):
            rows = table.loading == loading
            if np.any(rows):
                axis.plot(measured[rows], fitted[rows], "o", mfc=face, mec=_COLOURS[0], markersize=4, label=label)
        ends = [np.nanmin(measured), np.nanmax(measured)]
        axis.plot(ends, ends, color="0.5", linewidth=1)
        axis.set(xlabel=f"measured {name}", ylabel=f"fitted {name}")
        axis.grid(alpha=0.25)
    axes[0].set_title(f"{len(combinations)} combinations of chambers", fontsize=9)
    axes[0].legend(fontsize=8, frameon=False)


def draw_residuals(calibration: Calibration) -> Figure:
    """Measured less fitted of every loading and release hold: bend, and length where it was measured.

    By trial where the table has trials, else by pressure.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    table = calibration.table
    held = table.rows(table.loading)
    bend, length = calibration.bend_and_length(held.pressure_Pa)
    parts = [
        (held, held.pressure_Pa, _size_residual_deg(held, bend), 1e3 * (held.length_m - length), "o"),
    ]
    release = calibration.release
    if release is not None:
        fitted = bend_vectors(release.rows) - release.bend_residual_rad
        sizes = _size_residual_deg(release.rows, fitted)
        parts.append((release.rows, release.before_Pa, sizes, 1e3 * release.length_residual_m, "v"))
    panels = 2 if table.has_length else 1
    figure = Figure(figsize=(5.2 * panels, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, panels, squeeze=False)[0]
    trials = list(dict.fromkeys(name for part, *_ in parts for name in part.trial.tolist()))
    colours: dict[tuple[int, ...], str] = {}
    for part, loads_Pa, bend_deg, length_mm, mark in parts:
        for row in range(len(part)):
            driven = _driven(loads_Pa[row], float(np.max(table.pressure_Pa)))
            colour = colours.setdefault(driven, _COLOURS[len(colours) % len(_COLOURS)])
            place = trials.index(part.trial[row]) if len(trials) > 1 else np.max(loads_Pa[row]) / 1e3
            for axis, value in zip(axes, (bend_deg, length_mm), strict=False):
                axis.plot(place, value[row], mark, color=colour, markersize=6)
    for axis, label in zip(axes, ("bend, measured − fitted [°]", "length, measured − fitted [mm]"), strict=False):
        axis.axhline(0.0, color="0.4", linewidth=0.8)
        axis.set_ylabel(label)
        if len(trials) > 1:
            every = -(-len(trials) // 12)
            names = [name or "no label" for name in trials[::every]]
            axis.set_xticks(range(0, len(trials), every), names, fontsize=8, rotation=20)
        else:
            axis.set_xlabel("pressure of the driven chambers [kPa]")
        axis.grid(alpha=0.25)
    for driven, colour in list(colours.items())[:MOST_CURVES]:
        axes[0].plot([], [], "o", color=colour, label=_chambers(driven) if driven else "at rest")
    if release is not None:
        axes[0].plot([], [], "v", color="0.4", label="after its release")
    axes[0].legend(fontsize=7, frameon=False)
    return figure


def _size_residual_deg(table: BendTable, bend_rad: FloatArray) -> FloatArray:
    return np.degrees(table.bend_rad - np.hypot(*bend_rad.T))


def _driven(pressure_Pa: FloatArray, largest_Pa: float) -> tuple[int, ...]:
    """Chambers at over half of a row's largest pressure, none where the row is nearly at rest."""
    if np.max(pressure_Pa) < 0.2 * largest_Pa:
        return ()
    return tuple(i for i in range(CHAMBERS) if pressure_Pa[i] > 0.5 * np.max(pressure_Pa))


def _chambers(driven: tuple[int, ...]) -> str:
    return f"chamber{'s' if len(driven) > 1 else ''} {', '.join(map(str, driven))}"
