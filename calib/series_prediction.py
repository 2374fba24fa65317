"""What a robot with memory does in a recording, and how that changes with its coordinates.

The derivative of a bend by a parameter of the wall comes from the section's equilibrium (`calib.model`), by one of the
memory from a difference of what the chambers feel and the section's exact ∂(bend)/∂(felt pressure).

**Start of a trial.** A robot that starts bent has a chamber that still feels some of its last load: the chamber on
the outer side of the measured bend starts with that share of the state that a long load and 30 s of rest leave behind
(plays and residual; creep has died away), which gives the measured bend. Nothing is fitted for it.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from calib.bend_table import FloatArray
from calib.recording import Trial
from calib.series_model import SeriesModel
from softbot.actuator import ActuatorLaw
from softbot.cross_section import CHAMBER_ANGLES_RAD
from softbot.errors import SimulationError
from softbot.memory.chain import Memory

_REST_S = 30.0
_DIFFERENCE = 1e-4  # of a logarithm
_LEAST_START_RAD = math.radians(0.5)  # a start that is bent by less is straight


class SeriesPrediction:
    """A model at one set of coordinates, shape (c,), applied to trials."""

    def __init__(self, model: SeriesModel, theta: FloatArray) -> None:
        self.model = model
        self.theta = np.array(theta, dtype=float)
        self.law: ActuatorLaw = model.law(self.theta)
        self.memory: Memory = model.memory(self.theta)

    def felt_Pa(self, trial: Trial) -> FloatArray:
        """What the chambers feel along a trial's grid, shape (n, 4) [Pa]."""
        return self._felt_Pa(self.memory, trial, self._kept(self.law, trial))

    def bend_rad(self, trial: Trial) -> FloatArray:
        """Bends since the start along the trial's direction at its measured times, shape (m,) [rad].

        Raises SimulationError where the wall does not hold.
        """
        strain, _ = self.law.equilibria(self.felt_Pa(trial), along=True)
        return _followed(trial, self._bends_rad(strain, trial))

    def largest_bend_rad(self, trial: Trial) -> float:
        """Bend along the trial's direction at its largest pressures, held for ever [rad]: a quick guess."""
        at = int(np.argmax(np.sum(trial.pressure_Pa[:, list(trial.driven)], axis=1)))
        curvature = self.law.equilibrium(trial.pressure_Pa[at]).curvature_1_m
        return self.model.length_m * abs(float(curvature @ trial.direction))

    def bend_and_slopes(self, trial: Trial) -> tuple[FloatArray, FloatArray]:
        """`bend_rad` and its derivatives by the coordinates, shape (m, c)."""
        model, law = self.model, self.law
        kept = self._kept(law, trial)
        felt = self._felt_Pa(self.memory, trial, kept)
        strain, stiffness = law.equilibria(felt, along=True)
        path = self._bends_rad(strain, trial)
        # ∂(k·û L)/∂(felt pressures), shape (n, 4), by the tangent stiffness of the section
        lever = np.array([0.0, *(model.length_m * trial.direction)])
        arm = np.linalg.solve(stiffness, np.broadcast_to(lever, (len(felt), 3))[:, :, None])[:, :, 0]
        by_felt = (arm @ law.load_matrix) * ((felt >= law.dead_band_Pa) | (felt < 0.0))
        by_load = by_felt * (np.maximum(felt - law.dead_band_Pa, 0.0) + np.minimum(felt, 0.0))
        columns = np.empty((len(felt), len(model.coordinates)))
        for n, name in enumerate(model.coordinates):
            if n < model.inner:
                ahead = self._felt_Pa(self._memories[n], trial, kept)
                columns[:, n] = np.sum(by_felt * (ahead - felt), axis=1) / _DIFFERENCE
                continue
            other = self._laws[n]
            if name == "dead_band":
                columns[:, n] = -law.dead_band_Pa * np.sum(by_felt * (felt >= law.dead_band_Pa), axis=1)
            elif name == "gain":
                columns[:, n] = by_load @ (np.log(np.array(other.gains) / np.array(law.gains)) / _DIFFERENCE)
            elif name == "modulus":  # the wall's forces are in proportion to it
                columns[:, n] = -np.sum(by_load, axis=1)
            else:
                ahead, _ = other.equilibria(felt, strain)
                columns[:, n] = (self._bends_rad(ahead, trial) - path) / _DIFFERENCE
            if kept is not None or name == "gain":
                ahead = self._felt_Pa(self._memories[n], trial, self._kept(other, trial, kept))
                columns[:, n] += np.sum(by_felt * (ahead - felt), axis=1) / _DIFFERENCE
        return _followed(trial, path), np.column_stack([_followed(trial, column) for column in columns.T])

    @cached_property
    def _memories(self) -> list[Memory]:
        """For each coordinate the memory that is a difference away; the same where it does not know the coordinate."""
        return [
            self.model.memory(self._moved(n)) if n < self.model.inner or name == "gain" else self.memory
            for n, name in enumerate(self.model.coordinates)
        ]

    @cached_property
    def _laws(self) -> list[ActuatorLaw]:
        """For each coordinate the wall that is a difference away."""
        return [
            self.law if n < self.model.inner else self.model.law(self._moved(n))
            for n in range(len(self.model.coordinates))
        ]

    def _moved(self, n: int) -> FloatArray:
        moved = self.theta.copy()
        moved[n] += _DIFFERENCE
        return moved

    def _bends_rad(self, strain: FloatArray, trial: Trial) -> FloatArray:
        """Bends along the trial's direction on its grid, of strains (n, 3)."""
        return np.asarray(self.model.length_m * strain[:, 1:] @ trial.direction)

    def _felt_Pa(self, memory: Memory, trial: Trial, kept: tuple[int, float] | None) -> FloatArray:
        return memory.run(trial.grid_s, trial.pressure_Pa, self._started(memory, trial, kept))

    def _kept(self, law: ActuatorLaw, trial: Trial, near: tuple[int, float] | None = None) -> tuple[int, float] | None:
        """The chamber that starts with a load it still feels, and that load [Pa]; None where the start is straight.

        `near`: the answer of a law nearby.
        """
        bend = trial.start_bend_rad
        size = float(np.hypot(*bend))
        if size < _LEAST_START_RAD or not {"hysteresis", "residual"} & set(self.model.parts):
            return None
        angle = np.array(CHAMBER_ANGLES_RAD)
        outward = -(np.cos(angle) * bend[0] + np.sin(angle) * bend[1])
        chamber = int(np.argmax(outward))
        if chamber not in trial.driven:
            return None  # what another chamber has kept stays as it is: an offset, which the trial's bends do not see
        load_Pa = trial.pressure_Pa[0].copy()
        largest_Pa = self.model.largest_pressure_Pa
        low, high = law.dead_band_Pa, law.dead_band_Pa + 2.0 * largest_Pa
        at = near[1] if near is not None and low < near[1] < high else low + 0.1 * largest_Pa
        for _ in range(60):  # Newton's method kept between bounds; the bend rises with the load
            load_Pa[chamber] = at
            try:
                found = law.equilibrium(load_Pa)
            except SimulationError:  # beyond what the wall bears
                high, at = at, 0.5 * (low + at)
                continue
            reached = self.model.length_m * float(np.hypot(*found.curvature_1_m))
            low, high = (at, high) if reached < size else (low, at)
            slope = float(found.curvature_1_m @ found.jacobian[1:, chamber]) * self.model.length_m**2
            after = at + (size - reached) * max(reached, 1e-12) / max(slope, 1e-30)
            after = after if low < after < high else 0.5 * (low + high)
            if abs(after - at) < 1e-9 * largest_Pa:
                break
            at = after
        return chamber, at

    def _started(self, memory: Memory, trial: Trial, kept: tuple[int, float] | None) -> FloatArray:
        first_Pa = trial.pressure_Pa[0]
        state = memory.rest(first_Pa)
        if kept is None:
            return state
        chamber, felt_Pa = kept
        loaded_Pa = first_Pa.copy()
        loaded_Pa[chamber] = self.model.largest_pressure_Pa
        after, left_Pa = memory.step(memory.rest(loaded_Pa), first_Pa, _REST_S)
        _, fresh_Pa = memory.step(state, first_Pa, 0.0)
        room_Pa = left_Pa[chamber] - fresh_Pa[chamber]
        if room_Pa > 1.0:
            share = min(max((felt_Pa - fresh_Pa[chamber]) / room_Pa, 0.0), 2.0)
            state[chamber] += share * (after[chamber] - state[chamber])
        return state


def _followed(trial: Trial, path: FloatArray) -> FloatArray:
    return np.interp(trial.t_s, trial.grid_s, path) - path[0]
