"""The actuator law as a model with free coordinates: what a fit may turn, and what that does to bend and length.

A model is one candidate of a calibration: a wall material and a choice of what is free. Its coordinates are the
logarithms of positive parameters (so that all have the same scale, and no step leaves the region where the law
exists) and the dead band over the largest pressure. Gains are relative to their mean over the chambers that were
driven; chambers that always had the same pressure share one.

With the strains e = (ℓ, k1, k2) at rest under B p, K = ∂F/∂e (see `softbot.actuator`), length L and radius R:

    bend vector = L k,    length = L ℓ
    ∂e/∂ln E = −K⁻¹ B p     (stiffening in proportion)        ∂e/∂g_i, ∂e/∂dead band = K⁻¹ ∂(B p)
    ∂(ℓ, k)/∂ln R = (0, −k)  (proportions of the section kept)

The remaining ones (stiffening, limit of the stretch, centroid radius, misalignment) are differences.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.bend_table import FloatArray
from softbot.actuator import ActuatorLaw
from softbot.cross_section import (
    CHAMBERS,
    DEFAULT_CENTROID_RATIO,
    DEFAULT_CHAMBER_AREA_RATIO,
    CrossSection,
)
from softbot.material import MATERIALS

_DIFFERENCE = 1e-5  # of a logarithm: half the digits of a double

BOUNDS: dict[str, tuple[float, float]] = {
    "modulus": (math.log(1e2), math.log(1e10)),  # [Pa]
    "stiffening": (math.log(1e-4), math.log(1e2)),  # over the modulus
    "limit": (math.log(0.06), math.log(100.0)),  # of I₁ − 3
    "radius": (
        math.log(0.02),
        math.log(0.45),
    ),  # over the length at the start; a robot's is below half its length
    "centroid": (math.log(0.15), math.log(0.9)),  # over the radius
    "gain": (math.log(0.05), math.log(20.0)),  # over the first group's
    "turn": (-0.5, 0.5),  # [rad]
    "dead_band": (0.0, 0.9),  # over the largest pressure
    "length": (math.log(0.3), math.log(3.0)),  # over the length at the start
}


@dataclass(frozen=True)
class Prediction:
    """What a model says of n rows, with derivatives by its m coordinates."""

    bend_rad: FloatArray
    """Bend vector, shape (n, 2): towards the centre of curvature in the body frame."""
    length_m: FloatArray
    """Arc length, shape (n,)."""
    bend_by_coordinate: FloatArray
    """Shape (n, 2, m)."""
    length_by_coordinate: FloatArray
    """Shape (n, m)."""
    strain: FloatArray
    """Strains (ℓ, k1, k2), shape (n, 3): a start for the next prediction nearby."""


@dataclass(frozen=True)
class ActuatorModel:
    """One candidate: material, groups of chambers with a gain of their own, geometry, and what is free."""

    material: str
    groups: tuple[tuple[int, ...], ...]
    """Chambers that were driven, grouped where they always had the same pressure."""
    length_m: float
    """Length at rest: fixed, or the start of the fit."""
    radius_m: float
    """Outer radius: fixed, or the start of the fit."""
    largest_pressure_Pa: float
    free: frozenset[str]
    """Of "radius", "centroid", "turn", "dead_band", "length"; modulus, stiffening and gains follow from the rest."""

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates, in order; a key of BOUNDS each."""
        return (
            "modulus",
            *(["stiffening"] if MATERIALS[self.material].has_stiffening else []),
            *(["limit"] if self.material == "gent" else []),
            *(name for name in ("radius", "centroid") if name in self.free),
            *["gain"] * (len(self.groups) - 1),
            *["turn"] * (len(self.groups) if "turn" in self.free else 0),
            *(name for name in ("dead_band", "length") if name in self.free),
        )

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of the coordinates, shape (m,) each."""
        pairs = np.array([BOUNDS[name] for name in self.coordinates])
        shift = np.array([self._shift(name) for name in self.coordinates])
        return pairs[:, 0] + shift, pairs[:, 1] + shift

    def start(
        self, modulus_Pa: float, stiffening_ratio: float, dead_band_Pa: float, limit_invariant: float = 3.0
    ) -> FloatArray:
        """Coordinates to begin a fit from, shape (m,): given values, and the assumed ones for the others."""
        values = {
            "modulus": math.log(modulus_Pa),
            "stiffening": math.log(stiffening_ratio),
            "limit": math.log(limit_invariant),
            "radius": math.log(self.radius_m),
            "centroid": math.log(DEFAULT_CENTROID_RATIO),
            "gain": 0.0,
            "turn": 0.0,
            "dead_band": dead_band_Pa / self.largest_pressure_Pa,
            "length": math.log(self.length_m),
        }
        low, high = self.bounds()
        span = 1e-6 * (high - low)
        return np.clip(np.array([values[name] for name in self.coordinates]), low + span, high - span)

    def values(self, theta: FloatArray) -> dict[str, float]:
        """The parameters of a robot at coordinates `theta`, SI; only those that are free."""
        modulus_Pa = math.exp(theta[0])
        found = {"modulus_Pa": modulus_Pa}
        if MATERIALS[self.material].has_stiffening:
            found["stiffening_Pa"] = modulus_Pa * math.exp(self._at(theta, "stiffening"))
        if self.material == "gent":
            found["limit_invariant"] = math.exp(self._at(theta, "limit"))
        if "radius" in self.free:
            found["radius_m"] = math.exp(self._at(theta, "radius"))
        if "centroid" in self.free:
            found["chamber_centroid_radius_m"] = self.radius_m * math.exp(self._at(theta, "centroid"))
        if len(self.groups) > 1:
            gains = self._gains(theta)
            found |= {f"gain_{i}": gains[i] for group in self.groups for i in group}
        if "turn" in self.free:
            turns = self._turns(theta)
            found |= {f"misalignment_{i}_rad": turns[i] for group in self.groups for i in group}
        if "dead_band" in self.free:
            found["dead_band_Pa"] = self._dead_band_Pa(theta)
        if "length" in self.free:
            found["length_m"] = math.exp(self._at(theta, "length"))
        return found

    def geometry(self, theta: FloatArray) -> tuple[float, CrossSection]:
        """Length at rest [m] and section at coordinates `theta`."""
        length_m = math.exp(self._at(theta, "length")) if "length" in self.free else self.length_m
        radius_m = math.exp(self._at(theta, "radius")) if "radius" in self.free else self.radius_m
        ratio = math.exp(self._at(theta, "centroid")) if "centroid" in self.free else DEFAULT_CENTROID_RATIO
        return length_m, CrossSection(
            radius_m=radius_m,
            chamber_area_m2=DEFAULT_CHAMBER_AREA_RATIO * math.pi * radius_m**2,
            chamber_centroid_radius_m=ratio * radius_m,
            misalignment_rad=self._turns(theta),
        )

    def law(self, theta: FloatArray) -> ActuatorLaw:
        """The actuator law at coordinates `theta`."""
        modulus_Pa = math.exp(theta[0])
        more: dict[str, float] = {}
        if MATERIALS[self.material].has_stiffening:
            more["stiffening_Pa"] = modulus_Pa * math.exp(self._at(theta, "stiffening"))
        if self.material == "gent":
            more["limit_invariant"] = math.exp(self._at(theta, "limit"))
        return ActuatorLaw(
            section=self.geometry(theta)[1],
            material=self.material,
            modulus_Pa=modulus_Pa,
            **more,
            gains=self._gains(theta),
            dead_band_Pa=self._dead_band_Pa(theta),
        )

    def predict(self, theta: FloatArray, pressure_Pa: FloatArray, start: FloatArray | None = None) -> Prediction:
        """Bend and length at pressures of shape (n, 4) [Pa gauge], from strains `start` nearby where known.

        Raises SimulationError where the law has no equilibrium.
        """
        law = self.law(theta)
        length_m = self.geometry(theta)[0]
        strain, stiffness = law.equilibria(pressure_Pa, start)
        dead_band_Pa = law.dead_band_Pa
        effective_Pa = np.maximum(pressure_Pa - dead_band_Pa, 0.0) + np.minimum(pressure_Pa, 0.0)
        load = law.load_matrix
        names = self.coordinates
        by = np.zeros((len(pressure_Pa), 3, len(names)))
        right = np.zeros_like(by)
        right[:, :, 0] = -(effective_Pa @ load.T)
        gain_index = 0
        for n, name in enumerate(names):
            if name == "gain":
                gain_index += 1
                relative = self._gain_slopes(theta, gain_index) / np.array(law.gains)
                right[:, :, n] = (effective_Pa * relative) @ load.T
            elif name == "dead_band":
                active = (pressure_Pa > dead_band_Pa) * 1.0
                right[:, :, n] = -self.largest_pressure_Pa * (active @ load.T)
        by[:] = np.linalg.solve(stiffness, right)
        for n, name in enumerate(names):
            if name == "radius":
                by[:, 1:, n] = -strain[:, 1:]
            elif name in ("stiffening", "limit", "centroid", "turn"):
                moved = theta.copy()
                moved[n] += _DIFFERENCE
                by[:, :, n] = (self.law(moved).equilibria(pressure_Pa, strain)[0] - strain) / _DIFFERENCE
        by *= length_m
        bend, length = length_m * strain[:, 1:], length_m * strain[:, 0]
        if "length" in self.free:
            by[:, 1:, -1], by[:, 0, -1] = bend, length
        return Prediction(bend, length, by[:, 1:, :], by[:, 0, :], strain)

    def _at(self, theta: FloatArray, name: str) -> float:
        return float(theta[self.coordinates.index(name)])

    def _shift(self, name: str) -> float:
        return math.log(self.length_m) if name in ("radius", "length") else 0.0

    def _turns(self, theta: FloatArray) -> tuple[float, float, float, float]:
        """By how much each chamber lies off its nominal angle [rad]."""
        turns = [0.0] * CHAMBERS
        if "turn" in self.free:
            first = self.coordinates.index("turn")
            for n, group in enumerate(self.groups):
                for i in group:
                    turns[i] = float(theta[first + n])
        return (turns[0], turns[1], turns[2], turns[3])

    def _dead_band_Pa(self, theta: FloatArray) -> float:
        return self._at(theta, "dead_band") * self.largest_pressure_Pa if "dead_band" in self.free else 0.0

    def _shares(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Unscaled gain and share of the driven chambers of each group, shape (groups,)."""
        first = next((n for n, name in enumerate(self.coordinates) if name == "gain"), 0)
        free = np.exp(theta[first : first + len(self.groups) - 1])
        sizes = np.array([len(group) for group in self.groups], dtype=float)
        return np.concatenate([[1.0], free]), sizes / sizes.sum()

    def _gains(self, theta: FloatArray) -> tuple[float, float, float, float]:
        gains = np.ones(CHAMBERS)
        if len(self.groups) > 1:
            raw, share = self._shares(theta)
            for group, value in zip(self.groups, raw / (share @ raw), strict=True):
                gains[list(group)] = value
        return (float(gains[0]), float(gains[1]), float(gains[2]), float(gains[3]))

    def _gain_slopes(self, theta: FloatArray, index: int) -> FloatArray:
        """∂g/∂(coordinate of group `index`), shape (4,): the others give way so that the mean stays 1."""
        raw, share = self._shares(theta)
        scaled = raw / (share @ raw)
        slopes = np.zeros(CHAMBERS)
        for n, group in enumerate(self.groups):
            slopes[list(group)] = scaled[n] * ((n == index) - share[index] * scaled[index])
        return slopes
