"""What a calibration says in words: what its table cannot tell, what does not fit, what was assumed."""

from __future__ import annotations

import itertools
import math

import numpy as np

from calib.assumptions import gains_assumed, limit_assumed, listed, mass_assumed, never_driven, section_assumed
from calib.bend_table import BendTable
from calib.calibration import Errors, Estimate
from calib.identifiability import directions, sentences
from calib.model import ActuatorModel
from calib.model_choice import Geometry, gain_groups
from calib.robust_fit import Fit, Observations
from softbot.cross_section import CHAMBERS, DEFAULT_CHAMBER_AREA_RATIO

LACK_OF_FIT_PERCENT = 5.0
_DEAD_BAND_SCALE = 0.15  # of the largest pressure: as much of a dead band as a factor of e of the others
_REMEDY = {
    "modulus_Pa": "measure at more pressures",
    "stiffening_Pa": "add points at the highest pressure the robot may see",
    "limit_invariant": "add points at the highest pressure the robot may see",
    "radius_m": "add the lengths, or give the radius",
    "chamber_centroid_radius_m": "add rows with several chambers at once",
    "dead_band_Pa": "add points at low pressure, where the bend begins",
    "length_m": "add rows without pressure, or give the length",
}
PLAIN = {
    "modulus": "the modulus",
    "stiffening": "the stiffening",
    "limit": "the limit of the stretch",
    "radius": "the radius",
    "centroid": "the arm of the chambers",
    "gain": "the gains",
    "turn": "the chambers' angles",
    "dead_band": "the dead band",
    "length": "the length at rest",
}
"""Coordinates in words; every key of `calib.model.BOUNDS`."""
COORDINATE_REMEDY = {
    "modulus": "measure at more pressures",
    "stiffening": "add points at the highest pressure the robot may see",
    "limit": "add points at the highest pressure the robot may see",
    "radius": "add the lengths, or give the radius",
    "centroid": "add rows with several chambers at once",
    "gain": "pressurise each chamber alone",
    "turn": "add rows of each chamber alone, with the direction of their bend",
    "length": "add rows without pressure, or give the length",
}
"""What to measure where a coordinate is not determined; for the dead band, see `_vague`."""


def warnings_of(
    table: BendTable,
    loading: BendTable,
    fit: Fit,
    errors: Errors,
    parameters: dict[str, Estimate],
    rows: Observations,
    equals: list[Fit],
) -> list[str]:
    """What to know before using the calibration, with the mend of each; `equals`: fits that predict as well."""
    found = []
    if fit.degrees_of_freedom < 3:
        found.append(
            f"only {rows.measured} measured numbers for {len(fit.theta)} parameters: the intervals are wide or mean "
            "nothing; add rows"
        )
    blind = [name for name, one in parameters.items() if not one.identified]
    if blind:
        remedies = dict.fromkeys(_REMEDY.get(name, "pressurise each chamber alone") for name in blind)
        found.append(f"this table cannot tell {' from '.join(blind)}: {'; '.join(remedies)}")
    else:
        found += _vague(loading, [fit, *equals])
    ratio = parameters.get("chamber_centroid_radius_m")
    if ratio is not None:
        share = ratio.value / fit.model.radius_m
        chamber = math.sqrt(DEFAULT_CHAMBER_AREA_RATIO)  # radius of a round chamber over R
        if not math.sqrt(2.0) * chamber <= share <= 1.0 - chamber:
            found.append(
                f"the chambers' centroid radius comes out at {share:.2f} of the given radius, where four round "
                f"chambers have {math.sqrt(2.0) * chamber:.2f} to {1.0 - chamber:.2f}: read it as an effective "
                "arm, or leave the radius out to have it fitted"
            )
    found += _lack_of_fit_words(loading, errors)
    unloaded = np.max(loading.pressure_Pa, axis=1) < 0.02 * np.max(loading.pressure_Pa)
    if np.any(unloaded) and np.mean(loading.bend_rad[unloaded]) > 0.1 * errors.full_scale_bend_rad:
        found.append(
            f"the robot is bent by {math.degrees(float(np.mean(loading.bend_rad[unloaded]))):.1f}° without pressure, "
            "which no law here holds: measure bends from the straight robot, or take that bend off"
        )
    together = _never_apart(loading)
    if together:
        found.append(f"chambers {together} always had the same pressure: their gains are taken as the mean, 1")
    found += never_driven(_still(loading))
    if errors.unloading_bend_rad is not None:
        found.append(
            f"{int(np.sum(~table.loading))} unloading rows lie {math.degrees(errors.unloading_bend_rad):.1f}° (rms) "
            "from the loading curve"
            + (
                f", {math.degrees(errors.release_bend_rad):.1f}° where a share of the load stays after its release"
                if errors.release_bend_rad is not None
                else " and are not fitted: give each row the trial of the hold before it"
            )
        )
    return found


def _vague(table: BendTable, fits: list[Fit]) -> list[str]:
    """What the table leaves open, in words: of the chosen fit, and of those that predict as well with more free."""
    remedy = dict(COORDINATE_REMEDY)
    remedy["dead_band"] = f"add points under {_lowest_driven_Pa(table) / 1e3:.3g} kPa"
    found: list[str] = []
    for fit in fits:
        names = fit.model.coordinates
        scale = np.array([_DEAD_BAND_SCALE if name == "dead_band" else 1.0 for name in names])
        found += sentences(directions(names, fit.information * np.outer(scale, scale)), PLAIN, remedy)
    return list(dict.fromkeys(found))


def _lowest_driven_Pa(table: BendTable) -> float:
    """Lowest pressure of a driven chamber at which a bend was measured [Pa]."""
    largest_Pa = float(np.max(table.pressure_Pa))
    return float(np.min(np.where(table.pressure_Pa > 0.12 * largest_Pa, table.pressure_Pa, largest_Pa)))


def _lack_of_fit_words(table: BendTable, errors: Errors) -> list[str]:
    found = []
    percent = 100.0 * errors.rms_bend_rad / errors.full_scale_bend_rad
    repeat = errors.repeat_bend_rad or 0.0
    jump = _snap_through(table)
    if jump or (percent > LACK_OF_FIT_PERCENT and errors.rms_bend_rad > 1.5 * repeat):
        why = f": {jump}" if jump else ""
        found.append(
            f"lack of fit: no fibre-reinforced law here explains this table (rms {percent:.1f} % of full scale){why}; "
            "do not trust the robot file beyond a rough size"
        )
    if errors.lack_of_fit_p is not None and errors.lack_of_fit_p < 0.01:
        found.append(f"the residuals exceed the repeats (lack-of-fit test: p = {errors.lack_of_fit_p:.2g})")
    return found


def _snap_through(table: BendTable) -> str | None:
    """A place where the bend of one chamber runs away: a slope over four times the median before it, twice that after.

    A smooth law drawn through such a place may leave a small residual, and is wrong there all the same.
    """
    driven = np.max(table.pressure_Pa, axis=0) > 0.2 * np.max(table.pressure_Pa)
    if np.sum(driven) != 1:
        return None
    pressure = table.pressure_Pa[:, driven][:, 0]
    level, index = np.unique(np.round(pressure / (0.01 * np.max(pressure))), return_inverse=True)
    if len(level) < 5:
        return None
    count = np.bincount(index)
    mean_Pa, bend = np.bincount(index, pressure) / count, np.bincount(index, table.bend_rad) / count
    slope = np.diff(bend) / np.diff(mean_Pa)
    overall = (bend[-1] - bend[0]) / (mean_Pa[-1] - mean_Pa[0])
    steep = int(np.argmax(slope))
    before = float(np.median(slope[:steep])) if steep else math.inf
    after = float(np.median(slope[steep + 1 :])) if steep + 1 < len(slope) else math.inf
    if slope[steep] > 2.5 * overall and slope[steep] > max(4.0 * before, 2.0 * after):
        near = f"{mean_Pa[steep] / 1e3:.3g} kPa"
        jump = f"from {math.degrees(bend[steep]):.0f}° to {math.degrees(bend[steep + 1]):.0f}°"
        return (
            f"the bend runs away near {near}, {jump} (a snap-through: the pressure of a bubble without hoop fibres has "
            "a limit point, beyond which it grows under less pressure; with fibres the pressure rises throughout)"
        )
    return None


def assumptions_of(table: BendTable, model: ActuatorModel, geometry: Geometry) -> list[str]:
    """What was taken for granted, and from where."""
    found = []
    if model.material == "mooney-rivlin":
        found.append("the share of the second invariant is 0: under hoop fibres a section cannot feel it")
    found += section_assumed("centroid" in model.free)
    if geometry.length_m is not None:
        found.append(f"length at rest {geometry.length_m:g} m: given")
    elif "length" not in model.free:
        how = "the length at the lowest pressures" if table.has_length else "assumed: the table has no lengths"
        how = "the length of every row" if table.rest_length_m is not None else how
        found.append(f"length at rest {model.length_m:.4g} m: {how}")
    if "radius" in model.free:
        how = "the ratio of bend to stretch" if table.has_length else "the softening of the wall"
        found.append(f"the radius is an effective one, fitted: with the default proportions it gives {how}")
    elif geometry.radius_m is not None:
        found.append(f"radius {geometry.radius_m:g} m: given")
    else:
        found.append(f"radius {model.radius_m:.4g} m: assumed, and the modulus with it")
    found += gains_assumed(_still(table))
    together = _never_apart(table)
    if together:
        found.append(f"gain 1 of chambers {together}, the mean: they always had the same pressure")
    return [*found, limit_assumed(model.largest_pressure_Pa), mass_assumed(geometry.mass_kg)]


def _still(table: BendTable) -> list[int]:
    """Chambers that were never driven."""
    highest_Pa = np.max(table.pressure_Pa, axis=0)
    return [i for i in range(CHAMBERS) if highest_Pa[i] <= 0.2 * np.max(highest_Pa)]


def _never_apart(table: BendTable) -> str:
    """Opposite chambers that were driven, but only ever together."""
    largest_Pa = float(np.max(table.pressure_Pa))
    grouped = set(itertools.chain(*gain_groups(table)))
    driven = [i for i in range(CHAMBERS) if np.max(table.pressure_Pa[:, i]) > 0.2 * largest_Pa and i not in grouped]
    return listed(driven)
