"""Bounded robust least squares of one actuator model, its covariance and its leave-one-out error.

Residuals are in units of the measuring error (`Observations.bend_error_rad`, `length_error_m`): the bend vector where
its direction was measured, else its size, and the length where there is one. The loss is soft-L1 beyond
`LOSS_SCALE` of them (scipy `least_squares`, trust region reflective). A pull of 1/1000 of that towards the starting
values keeps the coordinates that the table does not see where they began; it has no part in the covariance.

Covariance of an M-estimate (Huber 1981, 7.6): ψ = ρ′(z²) r,

    C = (Σ ψ² / ν) / (mean ψ′)² (JᵀJ)⁻¹ ,    ν = measured numbers − coordinates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from calib.bend_table import BendTable, FloatArray
from calib.model import ActuatorModel, Prediction
from softbot.errors import SimulationError

LOSS_SCALE = 2.0
EXACT_LEAVE_ONE_OUT = 24  # trials (or rows) up to which each is left out by fitting again
_DRIVEN = 0.2  # of the table's highest pressure; what is below only holds a chamber in shape
_PULL = 1e-3
_LEAST_SCALE = 0.05  # of the measuring error, squared: information is never better than that
_LEFT_OUT_TOLERANCE = 1e-6
_AT_BOUND = 1e-4  # of the range of a coordinate
_STARTS = 2  # of all starts, the best ones are followed to the end


@dataclass(frozen=True)
class Observations:
    """Measured rows for a fit; n rows, NaN where not measured."""

    pressure_Pa: FloatArray
    """Shape (n, 4)."""
    bend_rad: FloatArray
    """Bend vector, shape (n, 2); where the direction is unknown (size, 0)."""
    directed: NDArray[np.bool_]
    """Whether the direction was measured, shape (n,)."""
    length_m: FloatArray
    """Shape (n,)."""
    bend_error_rad: float
    """Measuring error of a bend."""
    length_error_m: float
    """Measuring error of a length."""
    left_out_with: NDArray[np.int_]
    """Rows with the same number are left out together, shape (n,)."""

    def __len__(self) -> int:
        return len(self.directed)

    @property
    def measured(self) -> int:
        """How many numbers were measured: a bend a row, and the lengths."""
        return len(self) + int(np.sum(np.isfinite(self.length_m)))

    def without(self, rows: NDArray[np.int_]) -> Observations:
        """All rows but some."""
        keep = np.ones(len(self), dtype=bool)
        keep[rows] = False
        return replace(
            self,
            pressure_Pa=self.pressure_Pa[keep],
            bend_rad=self.bend_rad[keep],
            directed=self.directed[keep],
            length_m=self.length_m[keep],
            left_out_with=self.left_out_with[keep],
        )


@dataclass(frozen=True)
class Fit:
    """A fitted model."""

    model: ActuatorModel
    theta: FloatArray
    """Coordinates, shape (m,)."""
    covariance: FloatArray
    """Of the coordinates, shape (m, m); infinite on the diagonal for those that the rows do not determine.

    A coordinate that stopped at its bound is one of these, and the others' errors are given for its value.
    """
    bend_residual_rad: FloatArray
    """Measured less fitted, shape (n, 2); (size, 0) where the direction is unknown."""
    length_residual_m: FloatArray
    """Measured less fitted, shape (n,)."""
    degrees_of_freedom: int
    """Measured numbers less coordinates."""
    information: FloatArray
    """Fisher information of the coordinates, shape (m, m), in measuring errors as the residuals show them."""


@dataclass(frozen=True)
class LeaveOneOut:
    """Errors of rows predicted by a fit without them."""

    bend_rad: FloatArray
    """Shape (n, 2)."""
    length_m: FloatArray
    """Shape (n,)."""
    score: float
    """√ of the mean robust loss per row, in measuring errors: what models are chosen by."""


def observations(table: BendTable, bend_error_rad: float, length_error_m: float) -> Observations:
    """The rows of a table in an order that does not depend on that of the file."""
    order = np.lexsort([table.length_m, table.bend_rad, *table.pressure_Pa.T])
    ordered = table.rows(order)
    return Observations(
        ordered.pressure_Pa,
        bend_vectors(ordered),
        np.isfinite(ordered.direction_rad),
        ordered.length_m,
        bend_error_rad,
        length_error_m,
        _left_out_together(ordered),
    )


def _left_out_together(table: BendTable) -> NDArray[np.int_]:
    """A number for each row: that of its trial, where other trials drive the same chambers; else one of its own.

    Rows of one trial err together, so that a row is no test of a law that was fitted to the others. A chamber that only
    one trial drives has to stay: without it nothing would be known of it.
    """
    group = np.arange(len(table.trial))
    driven = table.pressure_Pa > _DRIVEN * np.max(table.pressure_Pa, initial=0.0)
    for name in np.unique(table.trial):
        own = table.trial == name
        if name and np.all(driven[~own].any(axis=0) | ~driven[own].any(axis=0)):
            group[own] = np.flatnonzero(own)[0]
    return group


def bend_vectors(table: BendTable) -> FloatArray:
    """Bend vectors of a table's rows, shape (n, 2) [rad]; (size, 0) where the direction is unknown."""
    direction = np.where(np.isfinite(table.direction_rad), table.direction_rad, 0.0)
    return table.bend_rad[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])


def fit_model(model: ActuatorModel, rows: Observations, starts: list[FloatArray]) -> Fit:
    """The best fit from several starts. Raises SimulationError when the law holds at none of them."""
    problems = [_Problem(model, rows, start) for start in starts]
    costs = [problem.cost(problem.start) for problem in problems]
    if not np.any(np.isfinite(costs)):
        raise SimulationError("the actuator law has no equilibrium at any start of the fit")
    best, theta = math.inf, starts[0]
    for n in np.argsort(costs)[:_STARTS]:
        if math.isfinite(costs[n]):
            found, cost = problems[n].solve(problems[n].start)
            if cost < best * (1.0 - 1e-9):
                best, theta = cost, found
    return _finished(model, rows, theta)


def leave_one_out(fit: Fit, rows: Observations, anchor: FloatArray, exact: bool = True) -> LeaveOneOut:
    """Each row predicted without it and what is left out with it (`Observations.left_out_with`).

    By fitting again for few trials or rows, else (or unless `exact`) by the fit's leverages. `anchor` are the
    coordinates that an undetermined one falls back to, shape (m,).
    """
    bend, length = np.empty((len(rows), 2)), np.full(len(rows), np.nan)
    groups = [np.flatnonzero(rows.left_out_with == number) for number in np.unique(rows.left_out_with)]
    if exact and len(groups) <= EXACT_LEAVE_ONE_OUT:
        for own in groups:
            problem = _Problem(fit.model, rows.without(own), anchor)
            theta, _ = problem.solve(fit.theta, _LEFT_OUT_TOLERANCE)
            prediction = fit.model.predict(theta, rows.pressure_Pa[own])
            bend[own] = _bend_residual(prediction, rows.bend_rad[own], rows.directed[own])
            length[own] = rows.length_m[own] - prediction.length_m
    else:
        bend, length = _by_leverage(fit, rows)
    square = np.sum(bend**2, axis=1) / rows.bend_error_rad**2
    square += np.nan_to_num(length**2 / rows.length_error_m**2)
    return LeaveOneOut(bend, length, math.sqrt(float(np.mean(_loss(square)))))


def _finished(model: ActuatorModel, rows: Observations, theta: FloatArray) -> Fit:
    prediction = model.predict(theta, rows.pressure_Pa)
    residual, slope, _ = _residuals(prediction, rows)
    freedom = rows.measured - len(theta)
    square = (residual / LOSS_SCALE) ** 2
    psi = residual / np.sqrt(1.0 + square)
    psi_slope = (1.0 + square) ** -1.5
    low, high = model.bounds()
    free = (theta > low + _AT_BOUND * (high - low)) & (theta < high - _AT_BOUND * (high - low))
    scale = max(float(np.sum(psi**2)) / max(freedom, 1) / float(np.mean(psi_slope)) ** 2, 1e-20)
    return Fit(
        model,
        theta,
        _inverse(slope.T @ slope / scale, free) if freedom > 0 else np.diag(np.full(len(theta), np.inf)),
        _bend_residual(prediction, rows.bend_rad, rows.directed),
        rows.length_m - prediction.length_m,
        freedom,
        slope.T @ slope / max(scale, _LEAST_SCALE),
    )


class _Problem:
    """One least-squares problem; remembers the last evaluation, which scipy asks for twice."""

    def __init__(self, model: ActuatorModel, rows: Observations, anchor: FloatArray) -> None:
        self.model, self.rows, self.start = model, rows, anchor
        self._theta: FloatArray | None = None
        self._strain: FloatArray | None = None
        count = int(np.sum(rows.directed)) + rows.measured
        self._failed = (np.full(count + len(anchor), 1e3), np.zeros((count + len(anchor), len(anchor))))
        self._value = self._failed

    def cost(self, theta: FloatArray) -> float:
        """Half the sum of losses; infinite where the law has no equilibrium."""
        residual = self.residual(theta)
        return math.inf if self._value is self._failed else 0.5 * float(np.sum(_loss(residual**2)))

    def solve(self, theta: FloatArray, tolerance: float = 1e-8) -> tuple[FloatArray, float]:
        """Coordinates and cost at the optimum near `theta`."""
        found = least_squares(
            self.residual,
            theta,
            jac=self.jacobian,
            bounds=self.model.bounds(),
            loss="soft_l1",
            f_scale=LOSS_SCALE,
            xtol=tolerance,
            ftol=tolerance,
            gtol=tolerance,
            max_nfev=60,
        )
        return found.x, float(found.cost)

    def residual(self, theta: FloatArray) -> FloatArray:
        self._evaluate(theta)
        return self._value[0]

    def jacobian(self, theta: FloatArray) -> FloatArray:
        self._evaluate(theta)
        return self._value[1]

    def _evaluate(self, theta: FloatArray) -> None:
        if self._theta is not None and np.array_equal(theta, self._theta):
            return
        self._theta = theta.copy()
        try:
            prediction = self.model.predict(theta, self.rows.pressure_Pa, self._strain)
        except (SimulationError, np.linalg.LinAlgError):
            self._value = self._failed
            return
        self._strain = prediction.strain
        residual, slope, _ = _residuals(prediction, self.rows)
        pull = _PULL * (theta - self.start)
        self._value = (np.concatenate([residual, pull]), np.vstack([slope, _PULL * np.eye(len(theta))]))


def _loss(square: FloatArray) -> FloatArray:
    """Soft L1: 2c²(√(1 + r²/c²) − 1) of r² [measuring errors²]."""
    return 2.0 * LOSS_SCALE**2 * (np.sqrt(1.0 + square / LOSS_SCALE**2) - 1.0)


def _bend_residual(prediction: Prediction, bend_rad: FloatArray, directed: NDArray[np.bool_]) -> FloatArray:
    size = np.hypot(prediction.bend_rad[:, 0], prediction.bend_rad[:, 1])
    fitted = np.where(directed[:, None], prediction.bend_rad, np.column_stack([size, np.zeros_like(size)]))
    return bend_rad - fitted


def _residuals(prediction: Prediction, rows: Observations) -> tuple[FloatArray, FloatArray, NDArray[np.int_]]:
    """Fitted less measured in measuring errors, shape (k,), its slopes, shape (k, m), and the row of each."""
    directed, sized = rows.directed, ~rows.directed
    difference = -_bend_residual(prediction, rows.bend_rad, directed) / rows.bend_error_rad
    slope = prediction.bend_by_coordinate / rows.bend_error_rad
    size = np.hypot(prediction.bend_rad[:, 0], prediction.bend_rad[:, 1])
    unit = prediction.bend_rad / np.maximum(size, 1e-12)[:, None]
    long = np.isfinite(rows.length_m)
    index = np.arange(len(rows))
    residual = np.concatenate(
        [
            difference[directed].ravel(),
            difference[sized, 0],
            (prediction.length_m - rows.length_m)[long] / rows.length_error_m,
        ]
    )
    slopes = np.vstack(
        [
            slope[directed].reshape(-1, slope.shape[2]),
            np.einsum("ni,nim->nm", unit, slope)[sized],
            prediction.length_by_coordinate[long] / rows.length_error_m,
        ]
    )
    return residual, slopes, np.concatenate([np.repeat(index[directed], 2), index[sized], index[long]])


def _by_leverage(fit: Fit, rows: Observations) -> tuple[FloatArray, FloatArray]:
    """Left-out residuals r_i → (1 − H_ii)⁻¹ r_i of the fit made linear at its optimum; i: what is left out at once."""
    residual, slope, row_of = _residuals(fit.model.predict(fit.theta, rows.pressure_Pa), rows)
    weight = (1.0 + (residual / LOSS_SCALE) ** 2) ** -0.25  # root of ρ′
    weighted = weight[:, None] * slope
    inverse = np.linalg.inv(weighted.T @ weighted + _PULL**2 * np.eye(slope.shape[1]))
    bend, length = np.zeros((len(rows), 2)), np.full(len(rows), np.nan)
    change = np.empty(len(residual))
    for number in np.unique(rows.left_out_with):
        own = np.flatnonzero(rows.left_out_with[row_of] == number)
        hat = weighted[own] @ inverse @ weighted[own].T
        change[own] = np.linalg.solve(np.eye(len(own)) - hat, weight[own] * residual[own]) / weight[own]
    for row in range(len(rows)):
        own = np.flatnonzero(row_of == row)
        bends = own.size - int(np.isfinite(rows.length_m[row]))
        bend[row, :bends] = -rows.bend_error_rad * change[own[:bends]]
        if bends < own.size:
            length[row] = -rows.length_error_m * change[own[-1]]
    return bend, length


def _inverse(matrix: FloatArray, free: NDArray[np.bool_]) -> FloatArray:
    """Inverse over the free coordinates; infinite variance for the others and for those in the null space."""
    inverse = np.diag(np.where(free, 0.0, np.inf))
    if not np.any(free):
        return inverse
    value, vector = np.linalg.eigh(matrix[np.ix_(free, free)])
    blind = value < 1e-10 * value[-1]
    part = (vector[:, ~blind] / value[~blind]) @ vector[:, ~blind].T
    unseen = np.any(np.abs(vector[:, blind]) > 1e-3, axis=1)
    part[unseen, unseen] = np.inf
    inverse[np.ix_(free, free)] = part
    return inverse
