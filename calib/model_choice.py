"""Which actuator models a table may have, and which it has: the simplest that predicts about as well as the best.

What is free follows from what the table holds:

- the modulus, always; a gain for each chamber that was driven, but for opposite chambers that only ever had the same
  pressure (they lengthen the tube, and cannot be told from its length and radius): those get the mean gain, 1;
- with lengths, the length at rest, unless given, and one more of the section: the radius with the default proportions
  (the ratio of bend to stretch fixes it), or, where the radius is given, the chambers' centroid radius;
- without lengths, the radius, unless given, may be free as far as softening shows it;
- a dead band, where at least four pressures were measured;
- the chambers' angles, where bends lie more than 3° off their directions.

Among wall materials, with and without dead band (and free radius), the simplest model is taken whose error on what was
left out of the fit is within 10 % of the least: a residual always falls with more coordinates, a prediction does not.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from calib.bend_table import BendTable, FloatArray
from calib.model import ActuatorModel
from calib.plausibility import off_angle_rad
from calib.robust_fit import Fit, LeaveOneOut, Observations, fit_model, leave_one_out
from softbot.cross_section import CHAMBERS
from softbot.errors import InputError, SimulationError
from softbot.material import MATERIALS

AUTO = "auto"
_TRIED = ("linear", "neo-hookean", "yeoh", "gent")
LAWS = (*_TRIED, "mooney-rivlin")  # a section bends with it as with neo-Hookean: tried once
_LIMITS = (0.5, 3.0)  # of I₁ − 3, starts of Gent's law
LEVELS_FOR_DEAD_BAND = 4
_ASSUMED_LENGTH_M = 0.15
_ASSUMED_SLENDERNESS = 15.0  # length over radius, of the design's rod
_IN_REACH = 1.6  # a model whose leverages promise this much more error is not looked at row by row
_WORTH = 1.1  # a simpler model may have this much more leave-one-out error
_OFF_ANGLE_RAD = math.radians(3.0)  # of a chamber's bends from where they belong: more is worth a parameter


@dataclass(frozen=True)
class Geometry:
    """What is known of the robot besides the table; None: fitted or assumed."""

    length_m: float | None = None
    radius_m: float | None = None
    mass_kg: float | None = None

    def __post_init__(self) -> None:
        for name in ("length_m", "radius_m", "mass_kg"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name} = {value!r}: give a positive, finite number")
        if self.length_m is not None and self.radius_m is not None and 2.0 * self.radius_m > self.length_m:
            raise InputError(
                f"radius_m = {self.radius_m:g} is over half of length_m = {self.length_m:g}: this is no slender tube"
            )


def gain_groups(table: BendTable) -> tuple[tuple[int, ...], ...]:
    """Chambers with a gain of their own, grouped where they always had the same pressure."""
    pressure = table.pressure_Pa
    largest_Pa = float(np.max(pressure))
    driven = [
        i
        for i in range(CHAMBERS)
        if np.max(pressure[:, i]) > 0.2 * largest_Pa and np.ptp(pressure[:, i]) > 0.1 * largest_Pa
    ] or [int(np.argmax(np.max(pressure, axis=0)))]
    groups: list[list[int]] = []
    for i in driven:
        for group in groups:
            if np.max(np.abs(pressure[:, i] - pressure[:, group[0]])) <= 0.02 * largest_Pa:
                group.append(i)
                break
        else:
            groups.append([i])
    bending = [tuple(group) for group in groups if not any((i + 2) % CHAMBERS in group for i in group)]
    return tuple(bending or [tuple(group) for group in groups])


def models_of(table: BendTable, geometry: Geometry, law: str, rows: Observations) -> list[ActuatorModel]:
    """The models that the table may be tried with; at least one, whatever little was measured."""
    largest_Pa = float(np.max(table.pressure_Pa))
    length_m = geometry.length_m or table.rest_length_m or _length_at_rest(table)
    free = set()
    if table.has_length:
        free.add("radius" if geometry.radius_m is None else "centroid")
        if geometry.length_m is None:
            free.add("length")
    groups = gain_groups(table)
    needed = 1 + len(groups) - 1 + len(free)
    for name in ("length", "radius", "centroid"):  # given up first to last where there are too few numbers
        if needed >= rows.measured and name in free:
            free.discard(name)
            needed -= 1
    options: list[tuple[str, ...]] = [("dead_band",)] if _levels(table) >= LEVELS_FOR_DEAD_BAND else []
    if off_angle_rad(table) > _OFF_ANGLE_RAD:
        options.append(("turn",))
    if not table.has_length and geometry.radius_m is None:
        options.append(("radius",))
    models = []
    for material in _TRIED if law == AUTO else (law,):
        for count in range(len(options) + 1):
            for chosen in itertools.combinations(options, count):
                extra = set(itertools.chain(*chosen))
                if "radius" in extra and material == "linear":
                    continue  # a linear wall shows no softening, so its radius hides in the modulus
                models.append(
                    ActuatorModel(
                        material,
                        groups,
                        length_m,
                        geometry.radius_m or length_m / _ASSUMED_SLENDERNESS,
                        largest_Pa,
                        frozenset(free | extra),
                    )
                )
    least = min(len(model.coordinates) for model in models)
    return [m for m in models if len(m.coordinates) < rows.measured or len(m.coordinates) == least]


def tried_models(models: list[ActuatorModel], rows: Observations) -> list[tuple[Fit, LeaveOneOut]]:
    """Fits with their leave-one-out errors: by leverages first, then exactly for those in reach of the best."""
    fits: list[tuple[Fit, LeaveOneOut, FloatArray]] = []
    for model in models:
        starts = _starts(model, rows)
        try:
            fit = fit_model(model, rows, starts)
            fits.append((fit, leave_one_out(fit, rows, starts[0], exact=False), starts[0]))
        except (SimulationError, np.linalg.LinAlgError):
            continue
    best = min((left_out.score for _, left_out, _ in fits), default=math.inf)
    found = []
    for fit, quick, anchor in fits:
        if not quick.score > _IN_REACH * best:
            try:
                quick = leave_one_out(fit, rows, anchor)
            except SimulationError:
                continue
        found.append((fit, quick))
    return found


def chosen(tried: list[tuple[Fit, LeaveOneOut]]) -> tuple[Fit, LeaveOneOut]:
    """The simplest model that predicts about as well as the best, and its errors on what was left out."""
    enough = _worthy(tried)
    simplest = min(len(fit.theta) for fit, _ in enough)
    return min((one for one in enough if len(one[0].theta) == simplest), key=lambda one: one[1].score)


def _worthy(tried: list[tuple[Fit, LeaveOneOut]]) -> list[tuple[Fit, LeaveOneOut]]:
    """Those that predict about as well as the best."""
    best = min(left_out.score for _, left_out in tried)
    return [one for one in tried if one[1].score <= _WORTH * best]


def equals_of(fit: Fit, tried: list[tuple[Fit, LeaveOneOut]]) -> list[Fit]:
    """Fits of the same wall that predict as well as the chosen one, with other things free."""
    same = [one for one, _ in _worthy(tried) if one is not fit and one.model.material == fit.model.material]
    return [one for one in same if one.degrees_of_freedom > 0]


def model_name(model: ActuatorModel, has_length: bool) -> str:
    """A model by its wall and what is free beyond the usual."""
    parts = ["dead band"] if "dead_band" in model.free else []
    parts += ["misalignment"] if "turn" in model.free else []
    if "radius" in model.free and not has_length:  # with lengths it is free in every model
        parts.append("free radius")
    return " + ".join([model.material, *parts])


def _starts(model: ActuatorModel, rows: Observations) -> list[FloatArray]:
    """Starting coordinates, each with the modulus that gives the measured bends in the small."""
    sizes = np.hypot(*rows.bend_rad.T)
    starts = []
    slenderness = (_ASSUMED_SLENDERNESS, 5.0) if "radius" in model.free else (None,)
    dead_bands = (0.0, 0.2) if "dead_band" in model.free else (0.0,)
    stiffenings = (0.03, 1.0) if MATERIALS[model.material].has_stiffening else (1.0,)
    limits = _LIMITS if model.material == "gent" else (1.0,)
    for slender, dead_band, stiffening, limit in itertools.product(slenderness, dead_bands, stiffenings, limits):
        begun = model if slender is None else replace(model, radius_m=model.length_m / slender)
        linear = replace(begun, material="linear")
        dead_band_Pa = dead_band * model.largest_pressure_Pa
        trial_Pa = 1e9
        probe = linear.predict(linear.start(trial_Pa, 1.0, dead_band_Pa), rows.pressure_Pa)
        small = np.hypot(*probe.bend_rad.T)
        ratio = float(small @ small / max(small @ sizes, 1e-300))
        modulus_Pa = trial_Pa * ratio / MATERIALS[model.material].modulus_ratio
        starts.append(begun.start(min(max(modulus_Pa, 1e3), 1e9), stiffening, dead_band_Pa, limit))
    return starts


def _levels(table: BendTable) -> int:
    """Most pressures of one chamber that lie apart by 5 % of the largest and more."""
    apart_Pa = 0.05 * float(np.max(table.pressure_Pa))
    most = 0
    for column in table.pressure_Pa.T:
        count, last_Pa = 0, -math.inf
        for pressure_Pa in np.unique(column):
            if pressure_Pa - last_Pa >= apart_Pa:
                count, last_Pa = count + 1, pressure_Pa
        most = max(most, count)
    return most


def _length_at_rest(table: BendTable) -> float:
    if not table.has_length:
        return _ASSUMED_LENGTH_M
    total = np.where(np.isfinite(table.length_m), np.sum(table.pressure_Pa, axis=1), np.inf)
    return float(np.mean(table.length_m[total <= np.min(total) + 0.02 * np.max(table.pressure_Pa)]))
