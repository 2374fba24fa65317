"""Which pressures to measure next: those that narrow the predicted bends most.

With covariance C of the coordinates, a new row whose weighted slopes are j (k × c) leaves C − C jᵀ(1 + j C jᵀ)⁻¹ j C.
The next row is the one that leaves the least mean variance of the bends over the workspace (I-optimality); then the
next with that row taken as measured, and so on. What the table does not see at all is taken as known to a factor of
e², so that seeing it counts.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from calib.bend_table import FloatArray
from calib.robust_fit import Fit, Observations
from softbot.errors import SimulationError

LEVELS = np.linspace(0.1, 1.0, 10)
"""Pressures that are weighed, over the largest of the table."""
_VAGUE_VARIANCE = 4.0  # of a logarithm


@dataclass(frozen=True)
class NextRow:
    """One row worth measuring."""

    pressure_Pa: FloatArray
    """Shape (4,)."""
    why: str
    """What it is good for, in words."""

    @property
    def words(self) -> str:
        """For people: which chambers at which pressure."""
        driven = np.flatnonzero(self.pressure_Pa > 0.0)
        parts = " and ".join(str(int(i)) for i in driven)
        plural = "s" if len(driven) > 1 else ""
        return f"chamber{plural} {parts} at {np.max(self.pressure_Pa) / 1e3:.3g} kPa ({self.why})"


def next_rows(fit: Fit, rows: Observations, count: int = 3) -> list[NextRow]:
    """The rows to measure next, the best first; none where the law does not hold over the workspace."""
    model, theta = fit.model, fit.theta
    chambers = [group[0] for group in model.groups]
    sets = [(i,) for i in chambers] + list(itertools.combinations(chambers, 2))
    candidates = np.zeros((len(sets) * len(LEVELS), rows.pressure_Pa.shape[1]))
    for n, (driven, level) in enumerate(itertools.product(sets, LEVELS)):
        members = [i for group in model.groups if group[0] in driven for i in group]
        candidates[n, members] = level * model.largest_pressure_Pa
    try:
        prediction = model.predict(theta, candidates)
    except SimulationError:
        return []
    bend: FloatArray = np.asarray(prediction.bend_by_coordinate / rows.bend_error_rad)
    slopes = np.asarray(bend)
    if np.any(np.isfinite(rows.length_m)):
        slopes = np.concatenate([slopes, prediction.length_by_coordinate[:, None, :] / rows.length_error_m], axis=1)
    prior = np.eye(len(theta)) / _VAGUE_VARIANCE
    covariance: FloatArray = np.asarray(np.linalg.inv(fit.information + prior), dtype=np.float64)
    before = _mean_variance(bend, covariance)
    found = []
    for _ in range(count):
        options = [_with(covariance, one) for one in slopes]
        left = [_mean_variance(bend, one) for one in options]
        best = int(np.argmin(left))
        covariance = options[best]
        share = 100.0 * np.sqrt(left[best] / before)
        found.append(NextRow(candidates[best], f"the band of the prediction narrows to {share:.0f} % of today's"))
    return found


def telling_row(fit: Fit, rival: Fit, rows: Observations) -> NextRow | None:
    """The pressure of one chamber at which two fits differ most; None where that is less than the measuring error."""
    largest_Pa = fit.model.largest_pressure_Pa
    best: tuple[float, FloatArray] | None = None
    for group, level in itertools.product(fit.model.groups, LEVELS):
        pressure_Pa = np.zeros((1, rows.pressure_Pa.shape[1]))
        pressure_Pa[0, list(group)] = level * largest_Pa
        try:
            bends = [one.model.predict(one.theta, pressure_Pa).bend_rad for one in (fit, rival)]
        except SimulationError:
            continue
        apart = float(np.hypot(*(bends[0] - bends[1])[0]))
        if best is None or apart > best[0]:
            best = apart, pressure_Pa[0]
    if best is None or best[0] < rows.bend_error_rad:
        return None
    names = f"{fit.model.material} and {rival.model.material}"
    return NextRow(best[1], f"there {names} differ by {np.degrees(best[0]):.1f}°")


def _mean_variance(slopes: FloatArray, covariance: FloatArray) -> float:
    return float(np.mean(np.einsum("nim,mk,nik->n", slopes, covariance, slopes)))


def _with(covariance: FloatArray, slopes: FloatArray) -> FloatArray:
    """Covariance after one more row with these slopes, shape (k, c)."""
    gain = covariance @ slopes.T
    inner = np.eye(len(slopes)) + slopes @ gain
    return np.asarray(covariance - gain @ np.linalg.solve(inner, gain.T))
