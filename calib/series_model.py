"""The actuator with its memory as a model with free coordinates, for recordings.

    sensor → line → hysteresis → creep → residual → dead band → wall law          (`softbot.memory`, `softbot.actuator`)

Coordinates are logarithms of scaled parameters. The derivative of a bend by a parameter of the wall comes from the
section's equilibrium (`calib.model`), by one of the memory from a difference of what the chambers feel and the
section's exact ∂(bend)/∂(felt pressure).

**Start of a trial.** A robot that starts bent has a chamber that still feels some of its last load: the chamber on
the outer side of the measured bend starts with that share of the state that a long load and 30 s of rest leave behind
(plays and residual; creep has died away), which gives the measured bend. Nothing is fitted for it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from calib.bend_table import FloatArray
from calib.recording import Trial
from softbot.actuator import ActuatorLaw
from softbot.cross_section import (
    CHAMBER_ANGLES_RAD,
    CHAMBERS,
    DEFAULT_CENTROID_RATIO,
    DEFAULT_CHAMBER_AREA_RATIO,
    CrossSection,
)
from softbot.errors import SimulationError
from softbot.memory.chain import Memory, MemoryParts
from softbot.memory.hysteresis import Hysteresis
from softbot.memory.line import Line
from softbot.memory.prony import PronySeries
from softbot.memory.residual import Residual

PLAYS = 6
RECOVERY_TIME_S = 300.0
"""Of the residual strain: assumed, recordings of half a minute say nothing of it."""
_REFERENCE_PRESSURE_PA = 1e5  # of ISO 6358: turns a conductance over a volume into a rate
_REST_S = 30.0
_DIFFERENCE = 1e-4  # of a logarithm
_CRITICAL_RATIO = 0.2

# name: (lowest, highest, start); times in s, pressures over the largest, the others are shares or ratios
SCALES: dict[str, tuple[float, float, float]] = {
    "filling_time": (0.01, 20.0, 0.4),
    "venting_time": (0.01, 40.0, 0.8),
    "growth": (0.02, 20.0, 1.0),
    "hysteresis_share": (0.02, 0.9, 0.35),
    "hysteresis_width": (0.05, 1.2, 0.6),
    "creep_share": (0.01, 0.7, 0.2),
    "creep_time": (0.1, 20.0, 1.5),
    "residual_share": (0.005, 0.7, 0.08),
    "residual_time": (0.2, 60.0, 3.0),
    "modulus": (1e2, 1e10, 5e4),
    "limit": (0.06, 100.0, 0.4),
    "stiffening": (1e-4, 1e3, 1.0),
    "gain": (0.05, 20.0, 1.0),
    "dead_band": (0.005, 0.8, 0.08),
}
PARTS: dict[str, tuple[str, ...]] = {
    "line": ("filling_time", "venting_time"),
    "growth": ("growth",),
    "hysteresis": ("hysteresis_share", "hysteresis_width"),
    "creep": ("creep_share", "creep_time"),
    "residual": ("residual_share", "residual_time"),
}
MEMORY_COORDINATES = frozenset(name for names in PARTS.values() for name in names)


@dataclass(frozen=True)
class SeriesModel:
    """One candidate: wall material, which parts of memory it has, and what is known of the robot."""

    material: str
    parts: tuple[str, ...]
    """Keys of PARTS, in their order."""
    groups: tuple[tuple[int, ...], ...]
    """Chambers with a gain of their own."""
    length_m: float
    radius_m: float
    largest_pressure_Pa: float
    _strains: dict[int, FloatArray] = field(default_factory=dict, repr=False, compare=False)
    """Last strains of each trial by its place in memory: starts for the next equilibrium."""

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates, in order; keys of SCALES."""
        return (*(name for part in self.parts for name in PARTS[part]), *self._wall_names)

    @property
    def _wall_names(self) -> tuple[str, ...]:
        wall = {"gent": ("limit",), "yeoh": ("stiffening",)}.get(self.material, ())
        return ("modulus", *wall, *["gain"] * (len(self.groups) - 1), "dead_band")

    @property
    def section(self) -> CrossSection:
        """The default section of this radius."""
        return CrossSection(
            radius_m=self.radius_m,
            chamber_area_m2=DEFAULT_CHAMBER_AREA_RATIO * math.pi * self.radius_m**2,
            chamber_centroid_radius_m=DEFAULT_CENTROID_RATIO * self.radius_m,
        )

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of the coordinates, shape (c,) each."""
        pairs = np.log([SCALES[name][:2] for name in self.coordinates])
        return pairs[:, 0], pairs[:, 1]

    def start(self, **values: float) -> FloatArray:
        """Coordinates to begin from: the usual values, or those given by name."""
        return np.log([values.get(name, SCALES[name][2]) for name in self.coordinates])

    def value(self, theta: FloatArray, name: str) -> float:
        """One scaled parameter."""
        return float(np.exp(theta[self.coordinates.index(name)]))

    def memory_parts(self, theta: FloatArray) -> MemoryParts:
        """Memory of the robot at coordinates `theta`."""
        largest_Pa = self.largest_pressure_Pa

        def of(name: str) -> float:
            return self.value(theta, name)

        line = hysteresis = creep = residual = None
        if "line" in self.parts:
            per_time = self._volume_m3 / _REFERENCE_PRESSURE_PA
            line = Line(
                per_time / of("filling_time"),
                per_time / of("venting_time"),
                of("growth") / largest_Pa if "growth" in self.parts else 0.0,
                _CRITICAL_RATIO,
            )
        if "hysteresis" in self.parts:
            widest_Pa = of("hysteresis_width") * largest_Pa
            hysteresis = Hysteresis(
                tuple(widest_Pa * (j + 0.5) / PLAYS for j in range(PLAYS)),
                tuple([of("hysteresis_share") / PLAYS] * PLAYS),
            )
        if "creep" in self.parts:
            creep = PronySeries((of("creep_share"),), (of("creep_time"),))
        if "residual" in self.parts:
            residual = Residual(of("residual_share"), of("residual_time"), RECOVERY_TIME_S)
        return MemoryParts(line, hysteresis, creep, residual)

    def memory(self, theta: FloatArray) -> Memory:
        """The same, ready to run."""
        return Memory(self.memory_parts(theta), self._volume_m3 * np.array(self.gains(theta)))

    @property
    def _volume_m3(self) -> float:
        return self.section.chamber_area_m2 * self.length_m

    def law(self, theta: FloatArray, gain: float = 1.0) -> ActuatorLaw:
        """The wall's law at coordinates `theta`; loads scaled by `gain`."""
        modulus_Pa = self.value(theta, "modulus")
        values = {}
        if self.material == "gent":
            values["limit_invariant"] = self.value(theta, "limit")
        elif self.material == "yeoh":
            values["stiffening_Pa"] = modulus_Pa * self.value(theta, "stiffening")
        gains = self.gains(theta)
        return ActuatorLaw(
            section=self.section,
            material=self.material,
            modulus_Pa=modulus_Pa,
            gains=(gain * gains[0], gain * gains[1], gain * gains[2], gain * gains[3]),
            dead_band_Pa=self.value(theta, "dead_band") * self.largest_pressure_Pa,
            **values,
        )

    def gains(self, theta: FloatArray) -> tuple[float, float, float, float]:
        """Gains of the chambers; their mean over the driven ones is 1."""
        gains = np.ones(CHAMBERS)
        if len(self.groups) > 1:
            first = self.coordinates.index("gain")
            raw = np.concatenate([[1.0], np.exp(theta[first : first + len(self.groups) - 1])])
            share = np.array([len(group) for group in self.groups], dtype=float)
            for group, one in zip(self.groups, raw / (share @ raw / share.sum()), strict=True):
                gains[list(group)] = one
        return (float(gains[0]), float(gains[1]), float(gains[2]), float(gains[3]))

    def felt_Pa(self, theta: FloatArray, trial: Trial, law: ActuatorLaw | None = None) -> FloatArray:
        """What the chambers feel along a trial's grid, shape (n, 4) [Pa]."""
        memory = self.memory(theta)
        law = law or self.law(theta)
        return memory.run(trial.grid_s, trial.pressure_Pa, self._start_state(memory, law, trial))

    def bend_rad(self, theta: FloatArray, trial: Trial) -> FloatArray:
        """Bends since the start along the trial's direction at its measured times, shape (m,) [rad]."""
        return self._followed(trial, self._path(theta, trial)[0])

    def largest_bend_rad(self, theta: FloatArray, trial: Trial) -> float:
        """Bend along the trial's direction at its largest pressures, held for ever [rad]: a quick guess."""
        at = int(np.argmax(np.sum(trial.pressure_Pa[:, list(trial.driven)], axis=1)))
        curvature = self.law(theta).equilibrium(trial.pressure_Pa[at]).curvature_1_m
        return self.length_m * abs(float(curvature @ trial.direction))

    def bend_and_slopes(self, theta: FloatArray, trial: Trial) -> tuple[FloatArray, FloatArray]:
        """The same, and its derivatives by the coordinates, shape (m, c)."""
        law = self.law(theta)
        path, felt, stiffness = self._path(theta, trial, law)
        columns = np.empty((len(trial.grid_s), len(self.coordinates)))
        active = (felt >= law.dead_band_Pa) | (felt < 0.0)
        # ∂(k·û L)/∂(felt pressures), shape (n, 4), by the tangent stiffness of the section
        lever = np.array([0.0, *(self.length_m * trial.direction)])
        arm = np.linalg.solve(np.swapaxes(stiffness, 1, 2), np.broadcast_to(lever, (len(felt), 3))[:, :, None])[:, :, 0]
        by_felt = (arm @ law.load_matrix) * active
        inner = sum(len(PARTS[part]) for part in self.parts)
        wanted = self._wanted(law, trial)
        effective = np.maximum(felt - law.dead_band_Pa, 0.0) + np.minimum(felt, 0.0)
        for n, name in enumerate(self.coordinates):
            moved = theta.copy()
            moved[n] += _DIFFERENCE
            if n < inner:
                memory = self.memory(moved)
                ahead = memory.run(trial.grid_s, trial.pressure_Pa, self._started(memory, trial, wanted))
                columns[:, n] = np.sum(by_felt * (ahead - felt), axis=1) / _DIFFERENCE
                continue
            other = self.law(moved)
            if name == "dead_band":
                columns[:, n] = -law.dead_band_Pa * np.sum(by_felt * (felt >= law.dead_band_Pa), axis=1)
            elif name == "gain":
                change = np.log(np.array(other.gains) / np.array(law.gains)) / _DIFFERENCE
                columns[:, n] = np.sum(by_felt * effective * change, axis=1)
            elif name == "modulus":  # the wall's forces are in proportion to it
                columns[:, n] = -np.sum(by_felt * effective, axis=1)
            else:
                strain, _ = other.equilibria(felt, self._strains[id(trial)])
                columns[:, n] = (self.length_m * strain[:, 1:] @ trial.direction - path) / _DIFFERENCE
            if wanted is not None or name == "gain":
                ahead = self.felt_Pa(moved, trial, other)
                columns[:, n] += np.sum(by_felt * (ahead - felt), axis=1) / _DIFFERENCE
        slopes = np.column_stack([self._followed(trial, column) for column in columns.T])
        return self._followed(trial, path), slopes

    def _path(
        self, theta: FloatArray, trial: Trial, law: ActuatorLaw | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Bend along the direction [rad], felt pressures and stiffnesses on the grid: (n,), (n, 4), (n, 3, 3)."""
        law = law or self.law(theta)
        felt = self.felt_Pa(theta, trial, law)
        before = self._strains.get(id(trial))
        strain, stiffness = law.equilibria(felt, before)
        self._strains[id(trial)] = strain
        return self.length_m * strain[:, 1:] @ trial.direction, felt, stiffness

    @staticmethod
    def _followed(trial: Trial, path: FloatArray) -> FloatArray:
        return np.interp(trial.t_s, trial.grid_s, path) - path[0]

    def _start_state(self, memory: Memory, law: ActuatorLaw, trial: Trial) -> FloatArray:
        return self._started(memory, trial, self._wanted(law, trial))

    def _wanted(self, law: ActuatorLaw, trial: Trial) -> tuple[int, float] | None:
        """The chamber that starts with a load it still feels, and that load [Pa]; None where the start is straight."""
        bend = trial.start_bend_rad
        size = float(np.hypot(*bend))
        if size < math.radians(0.5) or not {"hysteresis", "residual"} & set(self.parts):
            return None
        angle = np.array(CHAMBER_ANGLES_RAD)
        outward = -(np.cos(angle) * bend[0] + np.sin(angle) * bend[1])
        chamber = int(np.argmax(outward))
        if chamber not in trial.driven:
            return None  # what another chamber has kept stays as it is: an offset, which the trial's bends do not see
        load_Pa = trial.pressure_Pa[0].copy()
        low, high = law.dead_band_Pa, law.dead_band_Pa + 2.0 * self.largest_pressure_Pa
        at = low + 0.1 * self.largest_pressure_Pa
        for _ in range(60):  # Newton's method kept between bounds; the bend rises with the load
            load_Pa[chamber] = at
            try:
                found = law.equilibrium(load_Pa)
            except SimulationError:  # beyond what the wall bears
                high, at = at, 0.5 * (low + at)
                continue
            reached = self.length_m * float(np.hypot(*found.curvature_1_m))
            low, high = (at, high) if reached < size else (low, at)
            slope = self.length_m**2 * float(found.curvature_1_m @ found.jacobian[1:, chamber]) / max(reached, 1e-12)
            after = at + (size - reached) / max(slope, 1e-30)
            after = after if low < after < high else 0.5 * (low + high)
            if abs(after - at) < 1e-9 * self.largest_pressure_Pa:
                break
            at = after
        return chamber, at

    def _started(self, memory: Memory, trial: Trial, wanted: tuple[int, float] | None) -> FloatArray:
        first_Pa = trial.pressure_Pa[0]
        state = memory.rest(first_Pa)
        if wanted is None:
            return state
        chamber, felt_Pa = wanted
        loaded_Pa = first_Pa.copy()
        loaded_Pa[chamber] = self.largest_pressure_Pa
        after, left_Pa = memory.step(memory.rest(loaded_Pa), first_Pa, _REST_S)
        _, fresh_Pa = memory.step(state, first_Pa, 0.0)
        room_Pa = left_Pa[chamber] - fresh_Pa[chamber]
        if room_Pa > 1.0:
            share = min(max((felt_Pa - fresh_Pa[chamber]) / room_Pa, 0.0), 2.0)
            state[chamber] += share * (after[chamber] - state[chamber])
        return state
