"""The actuator with its memory as a model with free coordinates, for recordings.

    sensor → line → hysteresis → creep → residual → dead band → wall law          (`softbot.memory`, `softbot.actuator`)

Coordinates are logarithms of scaled parameters. `calib.series_prediction` says what bends follow from them.
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
from softbot.memory.chain import Memory, MemoryParts
from softbot.memory.hysteresis import Hysteresis
from softbot.memory.line import Line
from softbot.memory.prony import PronySeries
from softbot.memory.residual import Residual

PLAYS = 6
RECOVERY_TIME_S = 300.0
"""Of the residual strain: assumed, recordings of half a minute say nothing of it."""
_REFERENCE_PRESSURE_PA = 1e5  # of ISO 6358: turns a conductance over a volume into a rate
CRITICAL_RATIO = 0.2

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

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates, in order; keys of SCALES."""
        return (*(name for part in self.parts for name in PARTS[part]), *self._wall_names)

    @property
    def _wall_names(self) -> tuple[str, ...]:
        wall = {"gent": ("limit",), "yeoh": ("stiffening",)}.get(self.material, ())
        return ("modulus", *wall, *["gain"] * (len(self.groups) - 1), "dead_band")

    @cached_property
    def inner(self) -> int:
        """How many coordinates are the memory's; they come first."""
        return sum(len(PARTS[part]) for part in self.parts)

    @cached_property
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
                CRITICAL_RATIO,
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

    def law(self, theta: FloatArray) -> ActuatorLaw:
        """The wall's law at coordinates `theta`."""
        modulus_Pa = self.value(theta, "modulus")
        values = {}
        if self.material == "gent":
            values["limit_invariant"] = self.value(theta, "limit")
        elif self.material == "yeoh":
            values["stiffening_Pa"] = modulus_Pa * self.value(theta, "stiffening")
        return ActuatorLaw(
            section=self.section,
            material=self.material,
            modulus_Pa=modulus_Pa,
            gains=self.gains(theta),
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
