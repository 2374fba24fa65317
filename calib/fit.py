"""Calibration: from a table to a fitted actuator law, with model choice, intervals and plain words.

What is free follows from what the table holds:

- the modulus, always; a gain for each chamber that was driven, but for opposite chambers that only ever had the same
  pressure (they lengthen the tube, and cannot be told from its length and radius): those get the mean gain, 1;
- with lengths, the length at rest, unless given, and one more of the section: the radius with the default proportions
  (the ratio of bend to stretch fixes it), or, where the radius is given, the chambers' centroid radius;
- without lengths, the radius, unless given, may be free as far as softening shows it;
- a dead band, where at least four pressures were measured;
- the chambers' angles, where bends lie more than 3° off their directions.

Among wall materials, with and without dead band (and free radius), the simplest model is taken whose leave-one-out
error is within 10 % of the least: a residual always falls with more coordinates, a prediction does not.
Unloading rows do not move the law. Those that follow a hold of their trial give the share of a load that stays after
its release (`calib.release`); others are reported only. Both kinds of hold stand in the lack-of-fit test.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from calib.bend_table import BendTable, FloatArray, joined_rows
from calib.calibration import DENSITY_KG_M3, Calibration, Candidate, Errors, Estimate
from calib.design import NextRow, next_rows, telling_row
from calib.identifiability import directions, sentences
from calib.model import ActuatorModel
from calib.plausibility import ATMOSPHERE_PA, check_response, looks_absolute, off_angle_rad
from calib.release import Release, fit_release
from calib.repeats import RepeatError, joined, repeat_error, repeat_groups
from calib.robust_fit import Fit, LeaveOneOut, Observations, bend_vectors, fit_model, leave_one_out, observations
from softbot.cross_section import CHAMBERS, DEFAULT_CENTROID_RATIO, DEFAULT_CHAMBER_AREA_RATIO
from softbot.errors import InputError, SimulationError
from softbot.material import MATERIALS

AUTO = "auto"
_TRIED = ("linear", "neo-hookean", "yeoh", "gent")
_LAWS = (*_TRIED, "mooney-rivlin")  # a section bends with it as with neo-Hookean: tried once
_LIMITS = (0.5, 3.0)  # of I₁ − 3, starts of Gent's law
LEVELS_FOR_DEAD_BAND = 4
LACK_OF_FIT_PERCENT = 5.0
_ASSUMED_LENGTH_M = 0.15
_ASSUMED_SLENDERNESS = 15.0  # length over radius, of the design's rod
_ASSUMED_ERROR = 0.03  # of full scale, where the table has no repeats
_LEAST_ERROR = 0.005  # of full scale: what no measurement here beats
_RIVAL = 1.25  # a law that predicts this much worse is not yet ruled out
_IN_REACH = 1.6  # a model whose leverages promise this much more error is not looked at row by row
_WORTH = 1.1  # a simpler model may have this much more leave-one-out error
_MOST_ROWS = 150  # more are averaged where their pressures are close
_MOST_CHECKED = 5000  # rows that the residuals of a long table are computed on
_DEAD_BAND_SCALE = 0.15  # of the largest pressure: as much of a dead band as a factor of e of the others
_UNITS = {"Pa": "Pa", "m": "m", "rad": "rad"}
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


def calibrate_table(table: BendTable, geometry: Geometry | None = None, law: str = AUTO) -> Calibration:
    """Fit the actuator law to the loading rows of a table.

    `law` is "auto" or the name of a wall material. Raises InputError for a table whose bends no choice of parameters
    can explain at all, and for an unknown law.
    """
    geometry = geometry or Geometry()
    if law != AUTO and law not in _LAWS:
        raise InputError(f"law = {law!r}: choose one of {', '.join((AUTO, *_LAWS))}")
    loading = table.rows(table.loading)
    warnings = [*table.notes, *check_response(loading)]
    groups = repeat_groups(loading)
    bend_repeat = repeat_error(bend_vectors(loading), groups)
    length_repeat = repeat_error(loading.length_m, groups)
    rows = observations(
        _averaged(loading, warnings),
        _measuring_error(bend_repeat, float(np.max(loading.bend_rad))),
        _measuring_error(length_repeat, _length_range(loading)),
    )
    models = _models(loading, geometry, law, rows)
    tried = _tried(models, rows)
    if not tried:
        raise InputError(f"{table.source}: the actuator law has no equilibrium near these bends; check the units")
    fit, left_out = _choose(tried)
    _check_dead_band(loading, fit)
    release = fit_release(fit, table, rows)
    errors = _errors(table, loading, fit, left_out, rows, release, bend_repeat, length_repeat)
    quantile = _quantile(fit)
    equals = _equals(fit, tried)
    parameters = _widened(_parameters(fit, quantile), [_parameters(one, _quantile(one)) for one in equals])
    if release is not None:
        others = [fit_release(one, table, rows) for one in equals]
        parameters |= _widened(_released(release), [_released(one) for one in others if one is not None])
    warnings += _warnings(table, loading, fit, errors, parameters, rows, equals)
    ranked = sorted(tried, key=lambda one: (one[0] is not fit, one[1].score))
    return Calibration(
        table=table,
        fit=fit,
        parameters=parameters,
        errors=errors,
        candidates=tuple(
            Candidate(_name(one.model, loading.has_length), len(one.theta), left.score) for one, left in ranked
        ),
        assumptions=tuple(_assumptions(loading, fit.model, geometry)),
        warnings=tuple(dict.fromkeys(warnings)),
        mass_kg=geometry.mass_kg,
        t_quantile=quantile,
        release=release,
        measure_next=_measure_next(fit, tried, rows, warnings),
    )


def _measure_next(
    fit: Fit, tried: list[tuple[Fit, LeaveOneOut]], rows: Observations, warnings: list[str]
) -> tuple[NextRow, ...]:
    """What to measure next: first what tells the laws apart that predict alike so far, then what narrows the band."""
    if any(text.startswith("lack of fit") for text in warnings):
        return ()
    best = min(left_out.score for _, left_out in tried)
    rivals = [
        (one, left) for one, left in tried if one.model.material != fit.model.material and left.score <= _RIVAL * best
    ]
    found = next_rows(fit, rows)
    if rivals:
        rival = min(rivals, key=lambda one: one[1].score)[0]
        between = telling_row(fit, rival, rows)
        found = [between, *found] if between is not None else found
    return tuple(found)


def _check_dead_band(table: BendTable, fit: Fit) -> None:
    """A dead band of one atmosphere under pressures that never fall below it is no dead band."""
    dead_band_Pa = fit.model.law(fit.theta).dead_band_Pa
    driven = np.max(table.pressure_Pa, axis=0) > 0.2 * np.max(table.pressure_Pa)
    lowest_Pa = float(np.min(table.pressure_Pa[:, driven]))
    if not table.gauge_stated and lowest_Pa > 0.8 * ATMOSPHERE_PA and abs(dead_band_Pa / ATMOSPHERE_PA - 1.0) < 0.1:
        raise looks_absolute(table, f"the bend would begin at {dead_band_Pa / 1e3:.4g} kPa")


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


# --- what is tried ----------------------------------------------------------------------------------------


def _models(table: BendTable, geometry: Geometry, law: str, rows: Observations) -> list[ActuatorModel]:
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


def _tried(models: list[ActuatorModel], rows: Observations) -> list[tuple[Fit, LeaveOneOut]]:
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


def _choose(tried: list[tuple[Fit, LeaveOneOut]]) -> tuple[Fit, LeaveOneOut]:
    worthy = _worthy(tried)
    simplest = min(len(fit.theta) for fit, _ in worthy)
    return min((one for one in worthy if len(one[0].theta) == simplest), key=lambda one: one[1].score)


def _worthy(tried: list[tuple[Fit, LeaveOneOut]]) -> list[tuple[Fit, LeaveOneOut]]:
    """Those that predict about as well as the best."""
    best = min(left_out.score for _, left_out in tried)
    return [one for one in tried if one[1].score <= _WORTH * best]


def _averaged(table: BendTable, warnings: list[str]) -> BendTable:
    """A long table made short: rows whose pressures are close are averaged, and each average counts as one row."""
    if len(table) <= _MOST_ROWS:
        return table
    largest_Pa = float(np.max(table.pressure_Pa))
    measured = np.column_stack([np.isfinite(table.direction_rad), np.isfinite(table.length_m)])
    width = 0.01
    while True:
        bin_of = joined([*np.round(table.pressure_Pa / (width * largest_Pa)).astype(int).T, *measured.T])
        _, first, count = np.unique(bin_of, return_index=True, return_counts=True)
        if len(count) <= _MOST_ROWS or width > 0.03:
            break
        width *= 1.5

    def mean(values: FloatArray) -> FloatArray:
        return np.bincount(bin_of, weights=values, minlength=len(count)) / count

    vector = bend_vectors(table)
    means = np.column_stack([mean(vector[:, 0]), mean(vector[:, 1])])
    directed = np.isfinite(table.direction_rad[first])
    short = replace(
        table.rows(first),
        pressure_Pa=np.column_stack([mean(column) for column in table.pressure_Pa.T]),
        bend_rad=np.where(directed, np.hypot(*means.T), means[:, 0]),
        direction_rad=np.where(directed, np.arctan2(means[:, 1], means[:, 0]), np.nan),
        length_m=mean(table.length_m),
    )
    if len(short) > _MOST_ROWS:
        short = short.rows(np.linspace(0, len(short) - 1, _MOST_ROWS).astype(int))
    warnings.append(f"{len(table)} loading rows averaged to {len(short)} where their pressures are close")
    return short


# --- what was found ---------------------------------------------------------------------------------------


def _errors(
    table: BendTable,
    loading: BendTable,
    fit: Fit,
    left_out: LeaveOneOut,
    rows: Observations,
    release: Release | None,
    bend_repeat: RepeatError | None,
    length_repeat: RepeatError | None,
) -> Errors:
    bend, length = _residuals(fit, loading)
    rest_m = fit.model.geometry(fit.theta)[0]
    long = loading.has_length
    unloading = table.rows(~table.loading)
    unloaded = _residuals(fit, unloading)[0] if len(unloading) else None
    return Errors(
        rms_bend_rad=_rms(bend),
        loo_bend_rad=_rms(left_out.bend_rad),
        repeat_bend_rad=bend_repeat.value if bend_repeat else None,
        full_scale_bend_rad=float(np.max(loading.bend_rad)),
        rms_length_m=_rms(length) if long else None,
        loo_length_m=_rms(left_out.length_m) if long else None,
        repeat_length_m=length_repeat.value if length_repeat else None,
        full_scale_length_m=float(np.nanmax(np.abs(loading.length_m - rest_m))) if long else None,
        unloading_bend_rad=_rms(unloaded) if unloaded is not None else None,
        release_bend_rad=_rms(release.bend_residual_rad) if release is not None else None,
        release_length_m=_rms(release.length_residual_m)
        if release is not None and np.any(np.isfinite(release.length_residual_m))
        else None,
        lack_of_fit_p=_lack_of_fit(fit, rows, loading, bend, length, release),
    )


def _residuals(fit: Fit, table: BendTable) -> tuple[FloatArray, FloatArray]:
    """Measured less fitted: bends, shape (n, 2) [rad], (size, 0) without direction, and lengths, shape (n,) [m]."""
    if len(table) > _MOST_CHECKED:
        order = np.lexsort([table.length_m, table.bend_rad, *table.pressure_Pa.T])
        table = table.rows(order[np.linspace(0, len(table) - 1, _MOST_CHECKED).astype(int)])
    prediction = fit.model.predict(fit.theta, table.pressure_Pa)
    size = np.column_stack([np.hypot(*prediction.bend_rad.T), np.zeros(len(table))])
    directed = np.isfinite(table.direction_rad)[:, None]
    return bend_vectors(table) - np.where(directed, prediction.bend_rad, size), table.length_m - prediction.length_m


def _lack_of_fit(
    fit: Fit, rows: Observations, table: BendTable, bend: FloatArray, length: FloatArray, release: Release | None
) -> float | None:
    """The classical F test of the residual's excess over the repeats, bends and lengths in measuring errors.

    Loading and release holds together.
    """
    if len(bend) != len(table):
        return None
    coordinates = len(fit.theta)
    if release is not None:
        table = joined_rows(table, release.rows)
        bend = np.vstack([bend, release.bend_residual_rad])
        length = np.concatenate([length, release.length_residual_m])
        coordinates += 1
    groups = repeat_groups(table)
    square = float(np.sum(bend**2) / rows.bend_error_rad**2 + np.nansum(length**2) / rows.length_error_m**2)
    pure, pure_freedom, kinds = 0.0, 0, 0
    for values, unit in ((bend_vectors(table), rows.bend_error_rad), (table.length_m, rows.length_error_m)):
        if not np.any(np.isfinite(values)):
            continue
        measured = np.all(np.isfinite(values.reshape(len(values), -1)), axis=1)
        kinds += len(np.unique(groups[measured]))
        repeats = repeat_error(values / unit, groups)
        if repeats is not None:
            pure += repeats.value**2 * repeats.degrees_of_freedom
            pure_freedom += repeats.degrees_of_freedom
    lack_freedom = kinds - coordinates
    if pure_freedom < 2 or lack_freedom < 1 or pure <= 0.0:
        return None
    ratio = (max(square - pure, 0.0) / lack_freedom) / (pure / pure_freedom)
    return float(stats.f.sf(ratio, lack_freedom, pure_freedom))


def _parameters(fit: Fit, quantile: float) -> dict[str, Estimate]:
    """Each free parameter with its interval: in the logarithm for positive ones, straight for the dead band."""
    model, theta = fit.model, fit.theta
    value = model.values(theta)
    seen = np.isfinite(np.diag(fit.covariance))
    covariance = np.where(np.outer(seen, seen), fit.covariance, 0.0)
    low_bound, high_bound = model.bounds()
    at_low, at_high = model.values(low_bound), model.values(high_bound)
    slopes = []
    for n in range(len(theta)):
        step = np.zeros(len(theta))
        step[n] = 1e-6
        ahead, behind = model.values(theta + step), model.values(theta - step)
        slopes.append({name: (ahead[name] - behind[name]) / 2e-6 for name in value})
    estimates = {}
    for name, middle in value.items():
        slope = np.array([one[name] for one in slopes])
        blind = bool(np.any(~seen & (np.abs(slope) > 1e-9 * max(abs(middle), 1e-12))))
        half = quantile * math.sqrt(max(float(slope @ covariance @ slope), 0.0))
        if name == "dead_band_Pa":
            low, high = max(middle - half, at_low[name]), min(middle + half, at_high[name])
            identified = not blind and half < 0.5 * model.largest_pressure_Pa
        elif name.startswith("misalignment_"):
            identified = not blind and half < math.radians(20.0)
            low, high = middle - half, middle + half
        else:
            identified = not blind and half < math.log(10.0) * middle
            low, high = (middle * math.exp(s * half / middle) for s in (-1.0, 1.0)) if identified else (0.0, 0.0)
        if not identified:
            low, high = min(at_low[name], middle), max(at_high[name], middle)
            if name.startswith("gain_"):
                low, high = 0.0, float(CHAMBERS)
        estimates[name] = Estimate(middle, low, high, _UNITS.get(name.rpartition("_")[2], "1"), identified)
    return estimates


def _quantile(fit: Fit) -> float:
    return float(stats.t.ppf(0.975, max(fit.degrees_of_freedom, 1)))


def _released(release: Release) -> dict[str, Estimate]:
    return {"residual_share": Estimate(release.share, release.low, release.high, "1", True)}


def _equals(fit: Fit, tried: list[tuple[Fit, LeaveOneOut]]) -> list[Fit]:
    """Fits of the same wall that predict as well as the chosen one, with other things free."""
    same = [one for one, _ in _worthy(tried) if one is not fit and one.model.material == fit.model.material]
    return [one for one in same if one.degrees_of_freedom > 0]


def _widened(parameters: dict[str, Estimate], others: list[dict[str, Estimate]]) -> dict[str, Estimate]:
    """Intervals that hold those of other models too, which are as good.

    A parameter that was left out because the table does not ask for it still makes the others uncertain.
    """
    widened = dict(parameters)
    for name, one in ((name, one) for other in others for name, one in other.items()):
        own = widened.get(name)
        if own is not None and own.identified and one.identified:
            widened[name] = replace(own, low=min(own.low, one.low), high=max(own.high, one.high))
    return widened


# --- in words ---------------------------------------------------------------------------------------------


_REMEDY = {
    "modulus_Pa": "measure at more pressures",
    "stiffening_Pa": "add points at the highest pressure the robot may see",
    "limit_invariant": "add points at the highest pressure the robot may see",
    "radius_m": "add the lengths, or give the radius",
    "chamber_centroid_radius_m": "add rows with several chambers at once",
    "dead_band_Pa": "add points at low pressure, where the bend begins",
    "length_m": "add rows without pressure, or give the length",
}


_PLAIN = {
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
_COORDINATE_REMEDY = {
    "modulus": "measure at more pressures",
    "stiffening": "add points at the highest pressure the robot may see",
    "limit": "add points at the highest pressure the robot may see",
    "radius": "add the lengths, or give the radius",
    "centroid": "add rows with several chambers at once",
    "gain": "pressurise each chamber alone",
    "length": "add rows without pressure, or give the length",
}


def _lowest_driven_Pa(table: BendTable) -> float:
    """Lowest pressure of a driven chamber at which a bend was measured [Pa]."""
    largest_Pa = float(np.max(table.pressure_Pa))
    return float(np.min(np.where(table.pressure_Pa > 0.12 * largest_Pa, table.pressure_Pa, largest_Pa)))


def _warnings(
    table: BendTable,
    loading: BendTable,
    fit: Fit,
    errors: Errors,
    parameters: dict[str, Estimate],
    rows: Observations,
    equals: list[Fit],
) -> list[str]:
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
    still = [i for i in range(CHAMBERS) if np.max(loading.pressure_Pa[:, i]) <= 0.2 * np.max(loading.pressure_Pa)]
    if still:
        found.append(f"chamber{'s' if len(still) > 1 else ''} {_list(still)} never driven: gain 1 assumed")
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
    remedy = dict(_COORDINATE_REMEDY)
    remedy["dead_band"] = f"add points under {_lowest_driven_Pa(table) / 1e3:.3g} kPa"
    found: list[str] = []
    for fit in fits:
        names = fit.model.coordinates
        scale = np.array([_DEAD_BAND_SCALE if name == "dead_band" else 1.0 for name in names])
        found += sentences(directions(names, fit.information * np.outer(scale, scale)), _PLAIN, remedy)
    return list(dict.fromkeys(found))


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


def _assumptions(table: BendTable, model: ActuatorModel, geometry: Geometry) -> list[str]:
    found = []
    if model.material == "mooney-rivlin":
        found.append("the share of the second invariant is 0: under hoop fibres a section cannot feel it")
    found += [f"each chamber has {DEFAULT_CHAMBER_AREA_RATIO:g} of the section's area (no drawing of the section)"]
    if "centroid" not in model.free:
        found.append(f"the chambers' centroids lie at {DEFAULT_CENTROID_RATIO:g} of the radius")
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
    if geometry.mass_kg is not None:
        found.append(f"mass {geometry.mass_kg:g} kg: given")
    else:
        found.append(f"mass from a density of {DENSITY_KG_M3:g} kg/m3 and the wall's area")
    return found


# --- small things -----------------------------------------------------------------------------------------


def _name(model: ActuatorModel, has_length: bool) -> str:
    parts = ["dead band"] if "dead_band" in model.free else []
    parts += ["misalignment"] if "turn" in model.free else []
    if "radius" in model.free and not has_length:  # with lengths it is free in every model
        parts.append("free radius")
    return " + ".join([model.material, *parts])


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


def _length_range(table: BendTable) -> float:
    return float(np.nanmax(table.length_m) - np.nanmin(table.length_m)) if table.has_length else 1.0


def _measuring_error(repeat: RepeatError | None, full_scale: float) -> float:
    if repeat is None or repeat.degrees_of_freedom < 2:
        return max(_ASSUMED_ERROR * full_scale, 1e-9)
    return max(repeat.value, _LEAST_ERROR * full_scale, 1e-9)


def _never_apart(table: BendTable) -> str:
    """Opposite chambers that were driven, but only ever together."""
    largest_Pa = float(np.max(table.pressure_Pa))
    grouped = set(itertools.chain(*gain_groups(table)))
    driven = [i for i in range(CHAMBERS) if np.max(table.pressure_Pa[:, i]) > 0.2 * largest_Pa and i not in grouped]
    return _list(driven)


def _list(numbers: list[int]) -> str:
    return (
        " and ".join(map(str, numbers))
        if len(numbers) < 3
        else f"{', '.join(map(str, numbers[:-1]))} and {numbers[-1]}"
    )


def _rms(values: FloatArray) -> float:
    """Root of the mean square length of the rows, shape (n,) or (n, 2); NaN rows left out."""
    squares = np.sum(values.reshape(len(values), -1) ** 2, axis=1)
    return math.sqrt(float(np.nanmean(squares)))
