"""Bounded robust least squares of the actuator with its memory to recordings, from several starts.

Residuals are bends over the full scale of their trial, so that trials count alike whatever their size; rows of a
trial count √(M/m) with M the mean of all m, so that they count alike whatever their length. The loss is soft-L1
beyond `LOSS_SCALE` of full scale.

Trials of one robot differ by more than their noise (what it did before, what hangs on it): with several trials each
has a scale of its own, a factor near 1 that is fitted along with a prior of `TRIAL_SPREAD` standard deviation. The
robot's own parameters are those of scale 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from calib.bend_table import FloatArray
from calib.recording import Trial
from calib.series_model import SeriesModel
from calib.series_prediction import SeriesPrediction
from softbot.errors import SimulationError

LOSS_SCALE = 0.03
"""Of full scale: bends further off than this count less than their square."""
TRIAL_SPREAD = 0.1
"""Prior standard deviation of a trial's scale, of its logarithm."""
_PRIOR = 0.05 / TRIAL_SPREAD  # in residuals: what a few independent rows would say of a bend known to 1 %
_LEVEL = 100.0
_GAIN_PRIOR = 0.05 / 0.2  # chambers of one robot are alike within a fifth or so
_PULL = 0.05 / 5.0  # other coordinates stay where they began unless the rows say otherwise
_MOST_EVALUATIONS = 30
STARTS: tuple[dict[str, float], ...] = (
    {},
    {  # a slow line and a quick creep instead
        "filling_time": 1.5,
        "venting_time": 1.5,
        "growth": 0.1,
        "hysteresis_share": 0.2,
        "hysteresis_width": 0.4,
        "creep_share": 0.5,
        "creep_time": 0.5,
        "dead_band": 0.02,
    },
)


@dataclass(frozen=True)
class SeriesFit:
    """A fitted model."""

    model: SeriesModel
    theta: FloatArray
    """Coordinates, shape (c,)."""
    scale: FloatArray
    """Of each trial, shape (trials,); 1 where there is one trial."""
    rms: FloatArray
    """Root mean square error of each trial, scaled, over its full scale, shape (trials,)."""
    cost: float
    jacobian: FloatArray
    """Of the weighted residuals at `theta`, shape (rows, c)."""
    residual: FloatArray
    """Weighted residuals at `theta`, shape (rows,)."""

    @property
    def prediction(self) -> SeriesPrediction:
        """What it says of trials."""
        return SeriesPrediction(self.model, self.theta)


def fit_series(
    model: SeriesModel,
    trials: Sequence[Trial],
    starts: Sequence[FloatArray],
    most: int = _MOST_EVALUATIONS,
) -> SeriesFit:
    """The best fit from several starts. Raises SimulationError when the law holds at none of them."""
    best: tuple[float, FloatArray] | None = None
    problem = _Problem(model, trials)
    for start in starts:
        try:
            found = problem.solve(start, most)
        except SimulationError:
            continue
        if best is None or found[0] < best[0]:
            best = found
    if best is None:
        raise SimulationError("the actuator law has no equilibrium at any start of the fit")
    cost, full = best
    theta, scale = problem.parted(full)
    residual, jacobian = problem.evaluate(full)
    bends = SeriesPrediction(model, theta)
    rms = [relative_error(one * bends.bend_rad(trial), trial) for one, trial in zip(scale, trials, strict=True)]
    return SeriesFit(model, theta, scale, np.array(rms), cost, jacobian[:, : len(theta)], residual)


def starts_of(model: SeriesModel, trials: Sequence[Trial]) -> list[FloatArray]:
    """Starting coordinates: for each of STARTS the modulus at which the largest bends come out right."""
    found = []
    for values in STARTS:
        theta = model.start(**values)
        place = model.coordinates.index("modulus")
        low, high = math.log(1e3), math.log(1e8)
        for _ in range(14):
            theta[place] = 0.5 * (low + high)
            try:
                bends = SeriesPrediction(model, theta)
                ratio = float(np.mean([bends.largest_bend_rad(t) / t.full_scale_rad for t in trials]))
            except SimulationError:
                ratio = math.inf
            low, high = (theta[place], high) if ratio > 1.0 else (low, theta[place])
        theta[place] = high
        found.append(theta)
    return found


def trial_weights(trials: Sequence[Trial]) -> list[float]:
    """What a bend of each trial counts [1/rad]."""
    mean = np.mean([len(trial.t_s) for trial in trials])
    return [math.sqrt(mean / len(trial.t_s)) / trial.full_scale_rad for trial in trials]


def relative_error(bend_rad: FloatArray, trial: Trial) -> float:
    """Root mean square of model less measured over the trial's full scale."""
    return float(np.sqrt(np.mean((bend_rad - trial.bend_rad) ** 2))) / trial.full_scale_rad


class _Problem:
    """One least-squares problem in the coordinates and, with several trials, the logarithms of their scales."""

    def __init__(self, model: SeriesModel, trials: Sequence[Trial]) -> None:
        self.model, self.trials = model, trials
        self._free_scales = len(trials) if len(trials) > 1 else 0
        self._weights = trial_weights(trials)
        self._at: FloatArray | None = None
        self._value: tuple[FloatArray, FloatArray] = (np.empty(0), np.empty((0, 0)))

    def parted(self, full: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Coordinates of the model and scales of the trials."""
        count = len(self.model.coordinates)
        return full[:count], np.exp(full[count:]) if self._free_scales else np.ones(len(self.trials))

    def evaluate(self, full: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weighted residuals of the rows, shape (rows,), and their Jacobian, shape (rows, c + scales)."""
        theta, scale = self.parted(full)
        residuals, slopes = [], []
        bends = SeriesPrediction(self.model, theta)
        for n, trial in enumerate(self.trials):
            bend, slope = bends.bend_and_slopes(trial)
            weight = self._weights[n]
            residuals.append(weight * (scale[n] * bend - trial.bend_rad))
            own = np.zeros((len(bend), self._free_scales))
            if self._free_scales:
                own[:, n] = scale[n] * bend
            slopes.append(weight * np.column_stack([scale[n] * slope, own]))
        return np.concatenate(residuals), np.vstack(slopes)

    def _levels(self, count: int) -> FloatArray:
        """Rows that hold the scales of the trials of the same chambers to a mean of 1: gains are for the chambers."""
        if not self._free_scales:
            return np.zeros((0, count))
        sets = sorted({trial.driven for trial in self.trials})
        rows = np.zeros((len(sets), count + self._free_scales))
        for row, driven in zip(rows, sets, strict=True):
            own = [n for n, trial in enumerate(self.trials) if trial.driven == driven]
            row[[count + n for n in own]] = _LEVEL / len(own)
        return rows

    def solve(self, start: FloatArray, most: int) -> tuple[float, FloatArray]:
        """Cost and coordinates with scales at the optimum near `start`, the coordinates to begin from."""
        low, high = self.model.bounds()
        begin = np.concatenate([np.clip(start, low + 1e-6, high - 1e-6), np.zeros(self._free_scales)])
        low, high = (
            np.concatenate([ends, np.full(self._free_scales, end)]) for ends, end in ((low, -1.0), (high, 1.0))
        )
        pull = np.array([_GAIN_PRIOR if name == "gain" else _PULL for name in self.model.coordinates])
        pull = np.vstack(
            [np.diag(np.concatenate([pull, np.full(self._free_scales, _PRIOR)])), self._levels(len(start))]
        )
        self._at = None

        def both(full: FloatArray) -> tuple[FloatArray, FloatArray]:
            if self._at is None or not np.array_equal(full, self._at):
                self._at = full.copy()
                try:
                    residual, slope = _robust(*self.evaluate(full))
                    self._value = _compressed(
                        np.concatenate([residual, pull @ (full - begin)]), np.vstack([slope, pull])
                    )
                except (SimulationError, np.linalg.LinAlgError):
                    if self._value[0].size == 0:
                        raise SimulationError("no equilibrium at the start") from None
                    self._value = (np.full_like(self._value[0], 1e3), np.zeros_like(self._value[1]))
            return self._value

        found = least_squares(
            lambda full: both(full)[0],
            begin,
            jac=lambda full: both(full)[1],
            bounds=(low, high),
            ftol=3e-5,
            xtol=3e-5,
            gtol=1e-8,
            max_nfev=most,
        )
        return float(found.cost), found.x


def _robust(residual: FloatArray, slope: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residuals (k,) whose squares are the soft-L1 loss 2s²(√(1 + r²/s²) − 1) of r, and their slopes (k, c)."""
    root = np.sqrt(1.0 + (residual / LOSS_SCALE) ** 2)
    shrink = np.sqrt(2.0 / (1.0 + root))  # √ρ = |r| shrink
    return residual * shrink, slope * (1.0 / (root * shrink))[:, None]


def _compressed(residual: FloatArray, slope: FloatArray) -> tuple[FloatArray, FloatArray]:
    """c + 1 residuals and slopes (c + 1, c) of the same sum of squares, gradient and normal matrix as (k,) and (k, c).

    A solver by least squares goes the same way with them, without factoring thousands of rows each step.
    """
    whole = np.column_stack([slope, residual])
    value, vector = np.linalg.eigh(np.einsum("ki,kj->ij", whole, whole))
    root = np.sqrt(np.maximum(value, 0.0))[:, None] * vector.T
    return root[:, -1], root[:, :-1]
