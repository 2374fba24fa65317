"""A calibration from recordings: the law with its memory, what was chosen, how well it predicts, and the robot file.

**Intervals.** Residuals of a recording follow each other, so its rows count for less than their number: the covariance
(JᵀJ)⁻¹σ² is widened by the residuals' integrated autocorrelation time. Parameters are estimated in the logarithm.

**Bands.** A prediction of a trial that was not measured is off by as much as trials that were left out were: the 95 %
band is 1.96 times their error; `coverage` says how many rows of each lie in the band that the others' errors make.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from calib.assumptions import (
    gains_assumed,
    limit_assumed,
    mass_assumed,
    never_driven,
    one_gain_assumed,
    section_assumed,
)
from calib.bend_table import BendTable, FloatArray
from calib.calibration import (
    DAMPING_TIME_S,
    DENSITY_KG_M3,
    Estimate,
    largest_allowed_Pa,
    numbers_provenance,
    rounded,
)
from calib.identifiability import Direction, directions, sentences
from calib.model_choice import Geometry
from calib.recording import Trial, trials_of
from calib.series_choice import Choice, LeftOut, choose_series, scaled_error
from calib.series_fit import SeriesFit, relative_error, trial_weights
from calib.series_model import CRITICAL_RATIO, RECOVERY_TIME_S, SeriesModel
from softbot.cross_section import CHAMBERS
from softbot.errors import InputError
from softbot.robot import ROBOT_SCHEMA, Robot
from softbot.toml_file import check

MATERIALS_TRIED = ("gent", "yeoh", "neo-hookean", "linear")
_ASSUMED_LENGTH_M = 0.15
_ASSUMED_SLENDERNESS = 15.0
_NOISE_DRAWS = 12
_NEXT = 3  # directions that the advice is about
GRID_ERROR = 0.012
"""Of a logarithm: by so much parameters of robots that are recorded without noise come out wrong."""

PLAIN = {
    "filling_time": "the line's filling time",
    "venting_time": "the line's venting time",
    "growth": "the chamber's growth",
    "hysteresis_share": "the size of the hysteresis",
    "hysteresis_width": "the width of the hysteresis",
    "creep_share": "the size of the creep",
    "creep_time": "the creep's time",
    "residual_share": "the size of the residual strain",
    "residual_time": "the time of the residual strain",
    "modulus": "the modulus",
    "limit": "the limit of the stretch",
    "stiffening": "the stiffening of the wall",
    "gain": "the chambers' gains",
    "dead_band": "the dead band",
}
"""Coordinates in words; every key of `SCALES`."""
REMEDY = {
    "filling_time": "add steps up and down at full valve",
    "venting_time": "add steps up and down at full valve",
    "growth": "add steps between several pressures",
    "hysteresis_share": "add slow triangles (30 s and more) up to several pressures",
    "hysteresis_width": "add slow triangles (30 s and more) up to several pressures",
    "creep_share": "hold steps for ten times as long as the bend takes",
    "creep_time": "hold steps for ten times as long as the bend takes",
    "residual_share": "record a minute of rest after a release",
    "residual_time": "record a minute of rest after a release",
    "modulus": "add holds at intermediate pressures",
    "limit": "add a hold at a third of the largest pressure and one at two thirds",
    "stiffening": "add a hold at a third of the largest pressure and one at two thirds",
    "gain": "drive each chamber alone",
    "dead_band": "add slow ramps from zero",
}
"""What to measure where a coordinate is not determined; every key of `SCALES`."""


@dataclass(frozen=True)
class Transfer:
    """A fit to one trial judged on another; errors over the judged trial's full scale."""

    fitted: str
    judged: str
    rms_fitted: float
    rms_with_gain: float
    gain: float
    rms_raw: float
    """Nothing refitted."""
    steady_difference: float
    """Of the two trials' largest holds, over the judged one's."""


@dataclass(frozen=True)
class SeriesCalibration:
    """A fitted robot with memory."""

    table: BendTable
    trials: tuple[Trial, ...]
    choice: Choice
    parameters: dict[str, Estimate]
    assumptions: tuple[str, ...]
    warnings: tuple[str, ...]
    mass_kg: float | None
    measure_next: tuple[str, ...] = ()
    """What to record next, in words, the most telling first."""

    @property
    def fit(self) -> SeriesFit:
        """The chosen fit."""
        return self.choice.fit

    @property
    def law(self) -> str:
        """Name of the wall material."""
        return self.fit.model.material

    @property
    def band(self) -> float:
        """Half width of the 95 % prediction band, over full scale."""
        left_out = self.choice.left_out
        return _band(left_out) if left_out else 1.96 * float(self.fit.rms[0])

    @property
    def coverage(self) -> float | None:
        """Share of the left-out trials' rows inside the band that the other trials' errors make; None for one trial."""
        left_out = self.choice.left_out
        if len(left_out) < 2:
            return None
        inside = [np.abs(one.off) <= _band([other for other in left_out if other is not one]) for one in left_out]
        return float(np.mean(np.concatenate(inside)))

    def robot(self, name: str) -> Robot:
        """The calibrated robot. Raises InputError where the numbers are none."""
        return check(Robot, self.robot_table(name), f"{self.table.source}: the calibrated robot")

    def robot_table(self, name: str) -> dict[str, Any]:
        """The tables of its robot file, with the provenance of each number."""
        model, theta = self.fit.model, self.fit.theta
        law, section = model.law(theta), model.section
        actuator: dict[str, Any] = {"law": law.material, "modulus_Pa": rounded(law.modulus_Pa)}
        if law.material == "gent":
            actuator["limit_invariant"] = rounded(law.limit_invariant)
        if law.material == "yeoh":
            actuator["stiffening_Pa"] = rounded(law.stiffening_Pa)
        actuator |= {
            "chamber_area_m2": rounded(section.chamber_area_m2),
            "chamber_centroid_radius_m": rounded(section.chamber_centroid_radius_m),
            "gains": [rounded(gain) for gain in law.gains],
            "dead_band_Pa": rounded(law.dead_band_Pa),
            "max_pressure_Pa": largest_allowed_Pa(model.largest_pressure_Pa),
        }
        memory = {
            part: {key: _plain(value) for key, value in values.items()}
            for part, values in asdict(model.memory_parts(theta)).items()
            if values is not None
        }
        return {
            "schema": ROBOT_SCHEMA,
            "name": name,
            "length_m": rounded(model.length_m),
            "radius_m": rounded(model.radius_m),
            "mass_kg": rounded(self.mass_kg or DENSITY_KG_M3 * section.wall_area_m2 * model.length_m),
            "damping_time_s": DAMPING_TIME_S,
            "actuator": actuator,
            "memory": memory,
            "provenance": self._provenance(),
        }

    def report(self) -> dict[str, Any]:
        """The `--json` object: percentages are of each trial's full scale."""
        fit, full = self.fit, [trial.full_scale_rad for trial in self.trials]
        rms = math.sqrt(float(np.mean(fit.rms**2)))
        left = [one.rms_with_gain for one in self.choice.left_out]
        raw = [one.rms for one in self.choice.left_out]
        trials = []
        for n, trial in enumerate(self.trials):
            one: dict[str, Any] = {
                "name": trial.name,
                "driven": list(trial.driven),
                "rows": len(trial.t_s),
                "gaps": trial.gaps,
                "full_scale_bend_deg": math.degrees(trial.full_scale_rad),
                "rms_bend_percent": 100.0 * float(fit.rms[n]),
                "scale": float(fit.scale[n]),
            }
            if self.choice.left_out:
                out = self.choice.left_out[n]
                one |= {"left_out_percent": 100.0 * out.rms, "left_out_with_gain_percent": 100.0 * out.rms_with_gain}
            trials.append(one)
        return {
            "kind": "recording",
            "law": self.law,
            "memory": list(fit.model.parts),
            "parameters": {name: asdict(one) for name, one in self.parameters.items()},
            "rows": sum(len(trial.t_s) for trial in self.trials),
            "full_scale_bend_deg": math.degrees(max(full)),
            "rms_bend_deg": math.degrees(math.sqrt(float(np.mean((fit.rms * np.array(full)) ** 2)))),
            "rms_bend_percent": 100.0 * rms,
            "loo_bend_percent": 100.0 * math.sqrt(float(np.mean(np.square(left)))) if left else None,
            "loo_raw_bend_percent": 100.0 * math.sqrt(float(np.mean(np.square(raw)))) if raw else None,
            "band_percent": 100.0 * self.band,
            "band_coverage_percent": None if self.coverage is None else 100.0 * self.coverage,
            "trials": trials,
            "candidates": [
                {
                    "name": f"{one.material}: {' + '.join(one.parts)}",
                    "coordinates": one.coordinates,
                    "rms_percent": 100.0 * one.rms,
                    "loo_percent": None if math.isnan(one.score) else 100.0 * one.score,
                }
                for one in self.choice.tried
            ],
            "assumptions": list(self.assumptions),
            "warnings": list(self.warnings),
            "measure_next": [{"words": words} for words in self.measure_next],
        }

    def _provenance(self) -> dict[str, str]:
        report = self.report()
        found = {
            "made_by": "softbot calibrate",
            "table": f"{self.table.source}: {len(self.trials)} trials, {report['rows']} rows with a bend",
            "law": f"{report['candidates'][0]['name']}, "
            + (
                f"chosen among {len(self.choice.tried)} by predicting trials left out"
                if report["loo_bend_percent"] is not None
                else "the usual one: a single trial has nothing to choose by"
            ),
            "bend_error": f"rms {report['rms_bend_percent']:.1f} % of full scale"
            + (
                f", trials left out {report['loo_raw_bend_percent']:.1f} % "
                f"({report['loo_bend_percent']:.1f} % with one gain refitted)"
                if report["loo_bend_percent"] is not None
                else ""
            ),
        }
        return found | numbers_provenance(self.parameters, self.assumptions, self.table)


def calibrate_recording(
    table: BendTable, geometry: Geometry | None = None, law: str = "auto", quick: bool = False
) -> SeriesCalibration:
    """Fit the law with its memory to the trials of a table with time.

    `law` is "auto" or the name of a wall material; `quick` tries the usual memory only. Raises InputError for
    recordings that are none, and unknown laws.
    """
    geometry = geometry or Geometry()
    trials, notes = trials_of(table)
    length_m, radius_m, assumptions = size_of(table, geometry)
    choice = choose_series(trials, length_m, radius_m, materials_of(law), quick)
    fit = choice.fit
    covariance, information = covariance_of(fit, trials)
    parameters = estimates_of(fit.model, fit.theta, covariance)
    found = directions(fit.model.coordinates, information)
    warnings = [*notes, *sentences(found, PLAIN, REMEDY, "this recording"), *_warnings(trials, choice)]
    still = [i for i in range(CHAMBERS) if not any(i in trial.driven for trial in trials)]
    warnings += never_driven(still)
    assumptions += [*_memory_assumed(fit.model), *section_assumed(centroid_fitted=False), *gains_assumed(still)]
    assumptions += one_gain_assumed(fit.model.groups)
    assumptions += [limit_assumed(fit.model.largest_pressure_Pa), mass_assumed(geometry.mass_kg)]
    return SeriesCalibration(
        table, tuple(trials), choice, parameters, tuple(assumptions), tuple(warnings), geometry.mass_kg, _next(found)
    )


def _memory_assumed(model: SeriesModel) -> list[str]:
    """What the memory has that is not fitted."""
    found = []
    if "line" in model.parts:
        found.append(f"the line's critical pressure ratio is {CRITICAL_RATIO:g}")
    if "hysteresis" in model.parts:
        found.append("the hysteresis is the same up and down, its plays equal and evenly spaced")
    if "residual" in model.parts:
        found.append(f"residual strain recovers within {RECOVERY_TIME_S:g} s: assumed")
    return [*found, "a robot that starts bent towards a driven chamber's inner side still feels its last load"]


def transfers(table: BendTable, geometry: Geometry | None = None, law: str = "auto") -> list[Transfer]:
    """Each trial's fit judged on every other trial that drives the same chambers. Raises InputError without a pair."""
    geometry = geometry or Geometry()
    trials, _ = trials_of(table)
    length_m, radius_m, _ = size_of(table, geometry)
    found = []
    for one in trials:
        others = [other for other in trials if other is not one and other.driven == one.driven]
        if not others:
            continue
        fit = choose_series([one], length_m, radius_m, materials_of(law)[:1]).fit
        for other in others:
            bend = fit.prediction.bend_rad(other)
            error, gain = scaled_error(bend, other)
            raw = relative_error(bend, other)
            apart = abs(_steady_rad(one) - _steady_rad(other)) / _steady_rad(other)
            found.append(Transfer(one.name, other.name, float(fit.rms[0]), error, gain, raw, apart))
    if not found:
        raise InputError(f"{table.source}: no two trials drive the same chambers; there is nothing to judge a fit on")
    return found


def size_of(table: BendTable, geometry: Geometry) -> tuple[float, float, list[str]]:
    """Length and radius [m] and where they come from."""
    assumptions = []
    if geometry.length_m is not None:
        length_m = geometry.length_m
        assumptions.append(f"length at rest {length_m:g} m: given")
    elif table.has_length:
        length_m = (
            float(np.nanmedian(table.length_m[:5]))
            if np.any(np.isfinite(table.length_m[:5]))
            else float(np.nanmin(table.length_m))
        )
        assumptions.append(f"length at rest {length_m:.4g} m: of the first rows")
    else:
        length_m = _ASSUMED_LENGTH_M
        assumptions.append(f"length at rest {length_m:.4g} m: assumed: the table has no lengths")
    if geometry.radius_m is not None:
        assumptions.append(f"radius {geometry.radius_m:g} m: given")
        return length_m, geometry.radius_m, assumptions
    radius_m = length_m / _ASSUMED_SLENDERNESS
    assumptions.append(f"radius {radius_m:.4g} m: assumed, and the modulus with it")
    return length_m, radius_m, assumptions


def materials_of(law: str) -> tuple[str, ...]:
    """Wall materials to try. Raises InputError for a law that recordings are not fitted with."""
    if law == "auto":
        return MATERIALS_TRIED
    laws = (*MATERIALS_TRIED, "mooney-rivlin")  # a section bends with the last as with neo-Hookean: tried once
    if law not in laws:
        raise InputError(f"law = {law!r}: choose one of auto, {', '.join(laws)}")
    return (law,)


def covariance_of(fit: SeriesFit, trials: Sequence[Trial]) -> tuple[FloatArray, FloatArray]:
    """Covariance and information of the coordinates, shape (c, c), widened for residuals that follow each other.

    The covariance has the noise of the pressures besides: plays follow its crests, which bends the fit to one side, so
    what more of the same noise would do to the coordinates is added (the first step of SIMEX; Cook, Stefanski 1994);
    and `GRID_ERROR`, which the calibration's own steps in time make.
    """
    residual, jacobian = fit.residual, fit.jacobian
    counts = np.cumsum([len(trial.t_s) for trial in trials])[:-1]
    times = [autocorrelation_time(part) for part in np.split(residual, counts)]
    freedom = max(len(residual) - jacobian.shape[1], 1)
    variance = max(float(residual @ residual) / freedom, 1e-12) * float(np.mean(times))
    normal = jacobian.T @ jacobian
    inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
    moved = [inverse @ (jacobian.T @ change) for change in _by_noise(fit, trials)]
    covariance = variance * inverse + sum(np.outer(one, one) for one in moved) / len(moved)
    return covariance + GRID_ERROR**2 * np.eye(len(normal)), normal / variance


def _by_noise(fit: SeriesFit, trials: Sequence[Trial]) -> list[FloatArray]:
    """How the weighted residuals move, shape (rows,), with as much noise again on the pressures; several draws."""
    rng = np.random.default_rng(0)
    prediction, weights = fit.prediction, trial_weights(trials)
    before = [prediction.bend_rad(trial) for trial in trials]
    moved = []
    for _ in range(_NOISE_DRAWS):
        parts = []
        for n, trial in enumerate(trials):
            pressure_Pa = trial.pressure_Pa.copy()
            draw = rng.standard_normal((len(trial.grid_s), len(trial.driven)))
            pressure_Pa[:, list(trial.driven)] += trial.noise_Pa[:, None] * draw
            after = prediction.bend_rad(replace(trial, pressure_Pa=pressure_Pa))
            parts.append(weights[n] * fit.scale[n] * (after - before[n]))
        moved.append(np.concatenate(parts))
    return moved


def autocorrelation_time(residual: FloatArray) -> float:
    """1 + 2 Σ ρ up to the first lag whose autocorrelation is not positive: rows that count as one."""
    centred = residual - residual.mean()
    n = len(centred)
    spectrum = np.fft.rfft(centred, 2 * n)
    correlation = np.fft.irfft(spectrum * np.conj(spectrum))[:n]
    if correlation[0] <= 0.0:
        return 1.0
    correlation /= correlation[0]
    negative = np.flatnonzero(correlation <= 0.0)
    last = int(negative[0]) if negative.size else n
    return float(min(max(1.0 + 2.0 * np.sum(correlation[1:last]), 1.0), n / 4.0))


def _next(found: Sequence[Direction]) -> tuple[str, ...]:
    """What to record for the directions that are known worst."""
    words: dict[str, list[str]] = {}
    for one in sorted(found, key=lambda direction: -direction.standard_deviation)[:_NEXT]:
        name = one.names[0]
        told = words.setdefault(REMEDY[name], [])
        if PLAIN[name] not in told:
            told.append(PLAIN[name])
    return tuple(f"{remedy} (for {' and '.join(told)})" for remedy, told in words.items())


def _band(left_out: Sequence[LeftOut]) -> float:
    return 1.96 * math.sqrt(float(np.mean([one.rms**2 for one in left_out])))


def estimates_of(model: SeriesModel, theta: FloatArray, covariance: FloatArray) -> dict[str, Estimate]:
    """Each parameter of the robot with its 95 % interval, SI, from coordinates (c,) and their covariance (c, c)."""
    low_bound, high_bound = model.bounds()
    largest_Pa = model.largest_pressure_Pa
    units = {
        "filling_time": ("line_filling_time_s", 1.0, "s"),
        "venting_time": ("line_venting_time_s", 1.0, "s"),
        "growth": ("line_growth_1_Pa", 1.0 / largest_Pa, "1/Pa"),
        "hysteresis_width": ("hysteresis_width_Pa", largest_Pa, "Pa"),
        "creep_time": ("creep_time_s", 1.0, "s"),
        "residual_time": ("residual_growth_time_s", 1.0, "s"),
        "modulus": ("modulus_Pa", 1.0, "Pa"),
        "limit": ("limit_invariant", 1.0, "1"),
        "stiffening": ("stiffening_over_modulus", 1.0, "1"),
        "dead_band": ("dead_band_Pa", largest_Pa, "Pa"),
    }
    found: dict[str, Estimate] = {}
    for n, name in enumerate(model.coordinates):
        if name == "gain":
            continue
        key, scale, unit = units.get(name, (name, 1.0, "1"))
        found[key] = _estimate(theta[n], covariance[n, n], low_bound[n], high_bound[n], scale, unit)
    if "gain" in model.coordinates:
        gains = model.gains(theta)
        for group in model.groups:
            slope = np.zeros(len(theta))
            for n, name in enumerate(model.coordinates):
                if name == "gain":
                    moved = theta.copy()
                    moved[n] += 1e-6
                    slope[n] = (math.log(model.gains(moved)[group[0]]) - math.log(gains[group[0]])) / 1e-6
            variance = float(slope @ covariance @ slope)
            for i in group:
                found[f"gain_{i}"] = _estimate(math.log(gains[i]), variance, math.log(0.05), math.log(20.0), 1.0, "1")
    return found


def _estimate(theta: float, variance: float, low: float, high: float, scale: float, unit: str) -> Estimate:
    half = 1.96 * math.sqrt(max(variance, 0.0))
    at_bound = min(theta - low, high - theta) < 1e-3 * (high - low)
    value = scale * math.exp(theta)
    if at_bound or not half < math.log(10.0):
        return Estimate(value, scale * math.exp(min(low, theta)), scale * math.exp(max(high, theta)), unit, False)
    least, most = max(theta - half, low), min(theta + half, high)
    return Estimate(value, scale * math.exp(least), scale * math.exp(most), unit, True)


def _warnings(trials: Sequence[Trial], choice: Choice) -> list[str]:
    found = []
    for trial, rms in zip(trials, choice.fit.rms, strict=True):
        if rms > 0.05:
            found.append(
                f"trial {trial.name}: the law misses it by {100.0 * rms:.1f} % of full scale (rms): look at it in the "
                "report; is it of the same robot, are all its pressures in the table?"
            )
    if len(trials) > 1:
        spread = float(np.std(np.log(choice.fit.scale)))
        if spread > 0.03:
            found.append(
                f"trials differ from each other by {100.0 * spread:.0f} % in size (standard deviation) with the same "
                "pressures: no law of pressures alone can be better than that"
            )
    else:
        found.append("one trial only: nothing tells how well the law predicts another; record each kind of run twice")
    return found


def _steady_rad(trial: Trial) -> float:
    """Mean bend over the rows at 90 % and more of the largest pressure, the first half of them left out."""
    driven = np.max(trial.pressure_Pa[:, list(trial.driven)], axis=1)
    at = np.interp(trial.t_s, trial.grid_s, driven) >= 0.9 * np.max(driven)
    rows = np.flatnonzero(at)
    return float(np.mean(trial.bend_rad[rows[len(rows) // 2 :]]))


def _plain(value: Any) -> Any:
    return [rounded(one) for one in value] if isinstance(value, tuple) else rounded(value)
