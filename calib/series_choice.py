"""Which memory and which wall a recording asks for: chosen by predicting trials that were left out.

Candidates grow by one part of memory at a time. Each is fitted to all trials; then every trial (or every one of
`MOST_FOLDS` groups) is predicted from a fit to the others, which starts from the joint fit and needs a few steps only.
The simplest candidate whose error is within 5 % of the least is taken. A single trial has nothing to be left out: its
candidate is `USUAL`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.bend_table import FloatArray
from calib.recording import Trial
from calib.series_fit import SeriesFit, fit_series, relative_error, starts_of
from calib.series_model import MEMORY_COORDINATES, SeriesModel
from softbot.errors import InputError, SimulationError

LADDER: tuple[tuple[str, ...], ...] = (
    ("line", "hysteresis", "creep"),
    ("line", "growth", "hysteresis", "creep"),
    ("line", "growth", "hysteresis", "creep", "residual"),
)
USUAL = 1
"""Place in LADDER of what a robot of silicone and lines has."""
MOST_FOLDS = 4
WORTH = 1.05
_REFIT = 6  # evaluations of a fit that starts from the joint one
_FIRST, _NEXT = 40, 20  # evaluations of the first candidate's fits, and of the others', which start from it


@dataclass(frozen=True)
class LeftOut:
    """One trial predicted from the others."""

    name: str
    rms: float
    """Over its full scale, nothing refitted."""
    rms_with_gain: float
    """The same after its bends are scaled by one number."""
    gain: float
    """That number."""
    off: FloatArray
    """Predicted less measured over its full scale, row by row, nothing refitted."""


@dataclass(frozen=True)
class Tried:
    """One candidate."""

    material: str
    parts: tuple[str, ...]
    coordinates: int
    rms: float
    """Of the fit, over all trials (root mean square)."""
    score: float
    """Of trials left out; NaN where there was one trial only."""


@dataclass(frozen=True)
class Choice:
    """The chosen fit and how it was chosen."""

    fit: SeriesFit
    tried: tuple[Tried, ...]
    """All candidates, the chosen one first."""
    left_out: tuple[LeftOut, ...]


def choose_series(
    trials: Sequence[Trial], length_m: float, radius_m: float, materials: Sequence[str], quick: bool = False
) -> Choice:
    """Fit the candidates and take one. `quick` tries the usual memory only.

    Raises InputError where no candidate holds.
    """
    largest_Pa = max(float(np.max(trial.pressure_Pa)) for trial in trials)
    groups = _groups(trials)

    def model(material: str, parts: tuple[str, ...]) -> SeriesModel:
        return SeriesModel(material, parts, groups, length_m, radius_m, largest_Pa)

    alone = len(trials) < 2
    found: list[tuple[SeriesFit, tuple[LeftOut, ...], Tried]] = []
    ladder = [LADDER[USUAL]] if alone or quick else [LADDER[USUAL], *LADDER[:USUAL], *LADDER[USUAL + 1 :]]
    for parts in ladder:
        _try(model(materials[0], parts), trials, found)
    if not found:
        raise InputError("the actuator law has no equilibrium near these bends; check units, length and radius")
    best = _best(found)
    for material in materials[1:]:
        _try(model(material, best[2].parts), trials, found)
    fit, left_out, chosen = _best(found)
    others = sorted((one for *_, one in found if one is not chosen), key=lambda one: (one.score, one.coordinates))
    return Choice(fit, (chosen, *others), left_out)


def scaled_error(bend_rad: FloatArray, trial: Trial) -> tuple[float, float]:
    """Relative error after the bends are scaled by one number, and that number."""
    square = float(bend_rad @ bend_rad)
    gain = float(bend_rad @ trial.bend_rad) / square if square > 0.0 else 1.0
    return relative_error(gain * bend_rad, trial), gain


def _groups(trials: Sequence[Trial]) -> tuple[tuple[int, ...], ...]:
    """Chambers with a gain of their own: each that is driven, together where they always are."""
    members = sorted({i for trial in trials for i in trial.driven})
    groups: list[list[int]] = []
    for i in members:
        for group in groups:
            same = all(
                np.max(np.abs(trial.pressure_Pa[:, i] - trial.pressure_Pa[:, group[0]]))
                <= 0.02 * np.max(trial.pressure_Pa)
                for trial in trials
            )
            if same:
                group.append(i)
                break
        else:
            groups.append([i])
    return tuple(tuple(group) for group in groups)


def _try(
    model: SeriesModel, trials: Sequence[Trial], found: list[tuple[SeriesFit, tuple[LeftOut, ...], Tried]]
) -> None:
    starts = starts_of(model, trials)
    if found:  # what another candidate has found already
        before = dict(zip(found[0][0].model.coordinates, found[0][0].theta, strict=True))
        if found[0][0].model.material != model.material:
            before = {name: value for name, value in before.items() if name in MEMORY_COORDINATES}
        starts = [np.array([before.get(name, one) for name, one in zip(model.coordinates, starts[0], strict=True)])]
    try:
        fit = fit_series(model, trials, starts, _NEXT if found else _FIRST)
        left_out = _left_out(fit, trials)
    except SimulationError:
        return
    score = math.sqrt(float(np.mean([one.rms_with_gain**2 for one in left_out]))) if left_out else math.nan
    rms = math.sqrt(float(np.mean(fit.rms**2)))
    found.append((fit, left_out, Tried(model.material, model.parts, len(fit.theta), rms, score)))


def _best(found: list[tuple[SeriesFit, tuple[LeftOut, ...], Tried]]) -> tuple[SeriesFit, tuple[LeftOut, ...], Tried]:
    if math.isnan(found[0][2].score):
        return min(found, key=lambda one: one[0].cost)
    least = min(one[2].score for one in found)
    worthy = [one for one in found if one[2].score <= WORTH * least]
    return min(worthy, key=lambda one: (one[2].coordinates, one[2].score))


def _left_out(fit: SeriesFit, trials: Sequence[Trial]) -> tuple[LeftOut, ...]:
    if len(trials) < 2:
        return ()
    folds = np.arange(len(trials)) % min(len(trials), MOST_FOLDS)
    found: dict[int, LeftOut] = {}
    for fold in np.unique(folds):
        kept = [trial for trial, its in zip(trials, folds, strict=True) if its != fold]
        again = fit_series(fit.model, kept, [fit.theta], most=_REFIT)
        for n in np.flatnonzero(folds == fold).tolist():
            bend = again.prediction.bend_rad(trials[n])
            error, gain = scaled_error(bend, trials[n])
            off = (bend - trials[n].bend_rad) / trials[n].full_scale_rad
            found[n] = LeftOut(trials[n].name, relative_error(bend, trials[n]), error, gain, off)
    return tuple(found[n] for n in range(len(trials)))
