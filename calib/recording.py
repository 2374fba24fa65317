"""Trials of a table with time: measured pressures and bends as a fit wants them.

A trial is one run of the clock. Its bend is followed along one direction, that of its largest change: y = (b − b₀)·û,
b₀ being the bend over the first rows, before the pressures move. Rows flagged as not valid, or without a bend, are
gaps: their pressures count, their bends do not.

Pressures are resampled to a grid that is fine while something moves and for a while after, and coarse in long holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calib.bend_table import BendTable, FloatArray
from calib.robust_fit import bend_vectors
from softbot.cross_section import CHAMBER_ANGLES_RAD, CHAMBERS
from softbot.errors import InputError

LEAST_ROWS = 30  # of a table with time for it to be a recording
_FINE_S = 0.025
_COARSE_S = 0.5
_COARSENING = 0.1  # step of the grid over the time since the last change of pressure
_CHANGE = 0.05  # of the largest pressure within the coarse step: what counts as a change
_START_S = 0.15  # over which the bend at the start is averaged, at least three rows
_DRIVEN = 0.2  # of the largest pressure
_ROUGH, _ROUGH_SHARE = 0.9, 0.623  # of squares of noise the smallest nine tenths, and their mean over that of all


@dataclass(frozen=True)
class Trial:
    """One trial; m rows with a measured bend, n rows of the grid."""

    name: str
    t_s: FloatArray
    """Times of the measured bends from the trial's start, shape (m,) [s]."""
    bend_rad: FloatArray
    """Bends along `direction` since the start, shape (m,) [rad]."""
    direction: FloatArray
    """Unit vector û in the body frame, shape (2,)."""
    start_bend_rad: FloatArray
    """Bend vector b₀ at the start, shape (2,) [rad]; zero where directions were not measured."""
    grid_s: FloatArray
    """Shape (n,) [s], from 0."""
    pressure_Pa: FloatArray
    """At the sensors, shape (n, 4) [Pa gauge]."""
    noise_Pa: FloatArray
    """Standard deviation of the driven chambers' pressures on the grid, by how rough they are, shape (n,)."""
    driven: tuple[int, ...]
    """Chambers at over a fifth of the largest pressure at some time."""
    gaps: int
    """Rows whose bend is missing or flagged."""

    @property
    def full_scale_rad(self) -> float:
        """Largest bend since the start."""
        return float(np.max(np.abs(self.bend_rad)))


def is_recording(table: BendTable) -> bool:
    """Whether a table's rows follow each other in time: enough rows, most with the clock forward in small steps."""
    t = table.t_s
    if len(table) < LEAST_ROWS or not np.all(np.isfinite(t)):
        return False
    step = np.diff(t)
    forward = step[step > 0.0]
    return forward.size > 0.8 * step.size and float(np.median(forward)) <= 2.0


def trials_of(table: BendTable) -> tuple[list[Trial], list[str]]:
    """The trials of a recording, in the order of the file, and notes on it.

    Raises InputError for a clock that jumps about, and trials without motion.
    """
    notes = [*table.notes]
    found: list[Trial] = []
    for name, rows in _runs(table, notes):
        one = table.rows(rows)
        trial = _trial(name, one, notes)
        if trial is not None:
            found.append(trial)
    if not found:
        raise InputError(f"{table.source}: no trial moves by a degree or more; check the units and the columns")
    return found, list(dict.fromkeys(notes))


def _runs(table: BendTable, notes: list[str]) -> list[tuple[str, np.ndarray]]:
    """Rows of each trial: by its label, or from one restart of the clock to the next."""
    labels = list(dict.fromkeys(table.trial.tolist()))
    runs: list[tuple[str, np.ndarray]] = []
    for label in labels:
        rows = np.flatnonzero(table.trial == label)
        back = np.flatnonzero(np.diff(table.t_s[rows]) < 0.0) + 1
        parts = np.split(rows, back)
        if len(parts) > 1 and np.median([len(part) for part in parts]) < LEAST_ROWS / 3:
            row = int(rows[back[0]])
            raise InputError(
                f"{table.place(row)}: the time goes backwards, {len(back)} times in all; sort the rows by time, and "
                "give each trial a label in a column trial"
            )
        for n, part in enumerate(parts, 1):
            if len(part) < 5:
                continue
            name = label or str(len(runs) + 1) if len(parts) == 1 else f"{label or 'part'} {n}".strip()
            runs.append((name, part))
    if len(runs) > len(labels):
        notes.append(f"the clock restarts: {len(runs)} trials")
    return runs


def _trial(name: str, table: BendTable, notes: list[str]) -> Trial | None:
    t = table.t_s - table.t_s[0]
    rising = np.concatenate([[True], np.diff(t) > 0.0])
    if not np.all(rising):
        notes.append(f"trial {name}: {int(np.sum(~rising))} rows of the same time left out")
        table, t = table.rows(rising), t[rising]
    largest_Pa = float(np.max(table.pressure_Pa))
    measured = table.valid & np.isfinite(table.bend_rad)
    if np.sum(measured) < 10 or np.max(np.ptp(table.pressure_Pa, axis=0)) < max(500.0, 0.05 * largest_Pa):
        notes.append(f"trial {name} left out: fewer than ten rows with a bend, or a pressure that never moves")
        return None
    driven = tuple(
        i
        for i in range(CHAMBERS)
        if np.ptp(table.pressure_Pa[:, i]) > _DRIVEN * np.max(np.ptp(table.pressure_Pa, axis=0))
    )
    good = table.rows(measured)
    vector, start = _vectors(name, good, t[measured], driven)
    change = vector - start
    size = np.hypot(*change.T)
    if np.max(size) < math.radians(1.0):
        notes.append(f"trial {name} left out: the bend moves by less than 1°")
        return None
    far = change[size > 0.8 * np.max(size)].mean(axis=0)
    direction = far / np.hypot(*far)
    known = bool(np.any(np.isfinite(good.direction_rad)))
    grid_s = _grid(t, table.pressure_Pa, driven, largest_Pa)
    pressure_Pa, rows = _resampled(grid_s, t, table.pressure_Pa)
    idle = [i for i in range(CHAMBERS) if i not in driven]
    pressure_Pa[:, idle] = np.median(table.pressure_Pa[:, idle], axis=0)  # their noise moves nothing
    steps = np.diff(t)
    if np.max(steps) > max(1.0, 20.0 * float(np.median(steps))):
        where = int(np.argmax(steps))
        notes.append(f"trial {name}: {steps[where]:.1f} s without rows at {t[where]:.1f} s, bridged by a straight line")
    return Trial(
        name=name,
        t_s=t[measured],
        bend_rad=change @ direction,
        direction=direction,
        start_bend_rad=start if known else np.zeros(2),
        grid_s=grid_s,
        pressure_Pa=pressure_Pa,
        noise_Pa=_roughness_Pa(table.pressure_Pa[:, list(driven)]) / np.sqrt(rows),
        driven=driven,
        gaps=int(np.sum(~measured)),
    )


def _vectors(name: str, table: BendTable, t: FloatArray, driven: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """Bend vectors, shape (m, 2), and the one at the start, shape (2,)."""
    if np.any(np.isfinite(table.direction_rad)):
        vector = bend_vectors(table)
    else:
        angle = np.array(CHAMBER_ANGLES_RAD)
        axes = np.column_stack([np.cos(angle), np.sin(angle)])
        net = -(table.pressure_Pa - table.pressure_Pa[0]) @ axes
        strongest = net[np.argmax(np.hypot(*net.T))]
        if np.hypot(*strongest) < 0.1 * np.max(table.pressure_Pa):
            raise InputError(
                f"{table.source}, trial {name}: opposite chambers {driven} together bend the robot either way; add "
                "bend_direction_deg"
            )
        vector = table.bend_rad[:, None] * strongest / np.hypot(*strongest)
    first = max(3, int(np.sum(t <= _START_S)))
    return vector, np.median(vector[:first], axis=0)


def _grid(t: FloatArray, pressure_Pa: FloatArray, driven: tuple[int, ...], largest_Pa: float) -> FloatArray:
    """Times from 0 to the end: fine while a driven chamber's pressure jumps, then the coarser the longer it rests."""
    fine = np.append(np.arange(0.0, t[-1], _FINE_S), t[-1])
    there = np.column_stack([np.interp(fine, t, pressure_Pa[:, i]) for i in driven])
    back = round(_COARSE_S / _FINE_S)
    change = np.abs(there[back:] - there[:-back]) > _CHANGE * largest_Pa
    moving = np.zeros(len(fine), dtype=bool)
    for start in np.flatnonzero(np.any(change, axis=1)):
        moving[start : start + back + 1] = True
    kept, last_move = [0], 0.0 if np.any(moving[:1]) else -math.inf
    for i in range(1, len(fine)):
        if moving[i]:
            last_move = fine[i]
        step = min(max(_COARSENING * (fine[i] - last_move), _FINE_S), _COARSE_S)
        if fine[i] - fine[kept[-1]] >= step - 1e-9 or i == len(fine) - 1:
            kept.append(i)
    return fine[kept]


def _resampled(grid_s: FloatArray, t: FloatArray, pressure_Pa: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pressures on the grid: the mean halfway to the neighbours, straight between rows; and of how many rows."""
    middle = 0.5 * (grid_s[1:] + grid_s[:-1])
    low, high = np.append(t[0], middle), np.append(middle, t[-1])
    wide = high - low
    columns = []
    for column in pressure_Pa.T:
        area = np.concatenate([[0.0], np.cumsum(0.5 * (column[1:] + column[:-1]) * np.diff(t))])
        mean = (_area_at(high, t, column, area) - _area_at(low, t, column, area)) / np.maximum(wide, 1e-9)
        columns.append(np.where(wide > 1e-6, mean, np.interp(grid_s, t, column)))
    return np.ascontiguousarray(np.column_stack(columns)), np.maximum(wide / float(np.median(np.diff(t))), 1.0)


def _area_at(at_s: FloatArray, t: FloatArray, column: FloatArray, area: FloatArray) -> FloatArray:
    """Integral of a column that runs straight between rows, up to the times `at_s`; `area` is it at the rows."""
    row = np.clip(np.searchsorted(t, at_s, side="right") - 1, 0, len(t) - 2)
    past = at_s - t[row]
    slope = (column[row + 1] - column[row]) / (t[row + 1] - t[row])
    return np.asarray(area[row] + past * (column[row] + 0.5 * slope * past))


def _roughness_Pa(pressure_Pa: FloatArray) -> float:
    """Noise of one row by second differences, shape (m, k), those of steps left out [Pa]."""
    square = np.sort((pressure_Pa[2:] - 2.0 * pressure_Pa[1:-1] + pressure_Pa[:-2]).ravel() ** 2) / 6.0
    if not len(square):
        return 0.0
    return math.sqrt(float(np.mean(square[: max(round(_ROUGH * len(square)), 1)])) / _ROUGH_SHARE)
