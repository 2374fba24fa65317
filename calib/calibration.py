"""What a calibration found: parameters with 95 % intervals, errors, warnings; and the robot made of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.bend_table import BendTable, FloatArray
from calib.design import NextRow
from calib.release import Release
from calib.robust_fit import Fit
from softbot.robot import ROBOT_SCHEMA, Robot
from softbot.toml_file import check

DENSITY_KG_M3 = 1100.0
DAMPING_TIME_S = 0.02
ASSUMED_GROWTH_TIME_S = 5.0
"""Of a residual strain that release holds show: they last long against it."""
ASSUMED_RECOVERY_TIME_S = 300.0
"""Of the same: release holds are short against it."""
PRESSURE_RESERVE = 1.1
"""Of the largest pressure in the table: how far the law is trusted beyond it."""


@dataclass(frozen=True)
class Estimate:
    """One fitted parameter with its 95 % confidence interval."""

    value: float
    low: float
    high: float
    unit: str
    identified: bool
    """Whether the table determines it; if not, low and high are the bounds of the search."""


@dataclass(frozen=True)
class Errors:
    """Root mean squares over the loading rows: of the fit, of rows left out, and between the table's repeats."""

    rms_bend_rad: float
    loo_bend_rad: float
    repeat_bend_rad: float | None
    full_scale_bend_rad: float
    """Largest bend of the loading rows."""
    rms_length_m: float | None
    loo_length_m: float | None
    repeat_length_m: float | None
    full_scale_length_m: float | None
    """Largest change of length against the length at rest."""
    unloading_bend_rad: float | None
    """Of the unloading rows, which the law is not fitted to, without anything kept."""
    release_bend_rad: float | None
    """Of the release holds, with the share of the load that they keep; None without such holds."""
    release_length_m: float | None
    lack_of_fit_p: float | None
    """Probability of residuals this large against the repeats, were the law true; None without enough repeats."""


@dataclass(frozen=True)
class Candidate:
    """One model that was tried."""

    name: str
    coordinates: int
    score: float
    """Leave-one-out error in measuring errors, robust."""


@dataclass(frozen=True)
class Calibration:
    """A fitted robot. `table` is the whole table, `fit` the chosen model, fitted to its loading rows."""

    table: BendTable
    fit: Fit
    parameters: dict[str, Estimate]
    errors: Errors
    candidates: tuple[Candidate, ...]
    """All that were tried, the chosen one first."""
    assumptions: tuple[str, ...]
    warnings: tuple[str, ...]
    mass_kg: float | None
    """Given mass; None: from density and wall."""
    t_quantile: float
    """97.5 % quantile of Student's t at the fit's degrees of freedom."""
    release: Release | None = None
    """What stays of a load after its release, where the table tells."""
    measure_next: tuple[NextRow, ...] = ()
    """Rows worth measuring next, the best first."""

    @property
    def law(self) -> str:
        """Name of the wall material chosen."""
        return self.fit.model.material

    def bend_and_length(self, pressure_Pa: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Bend vectors, shape (n, 2) [rad], and lengths, shape (n,) [m], at pressures of shape (n, 4) [Pa]."""
        prediction = self.fit.model.predict(self.fit.theta, pressure_Pa)
        return prediction.bend_rad, prediction.length_m

    def half_bands(self, pressure_Pa: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Half widths of the 95 % confidence bands of bend size [rad] and length [m], shape (n,) each.

        By the delta method; what the table does not determine has no part in them.
        """
        prediction = self.fit.model.predict(self.fit.theta, pressure_Pa)
        seen = np.isfinite(np.diag(self.fit.covariance))
        covariance = self.fit.covariance[np.ix_(seen, seen)]
        size = np.maximum(np.hypot(*prediction.bend_rad.T), 1e-12)
        unit = prediction.bend_rad / size[:, None]
        bend_slope = np.einsum("ni,nim->nm", unit, prediction.bend_by_coordinate)[:, seen]
        length_slope = prediction.length_by_coordinate[:, seen]
        spread = (np.sqrt(np.einsum("nm,mk,nk->n", s, covariance, s)) for s in (bend_slope, length_slope))
        bend, length = (self.t_quantile * one for one in spread)
        return bend, length

    def prediction_half_bands(self, pressure_Pa: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Half widths of the 95 % bands in which one more measured bend [rad] or length [m] lies, shape (n,) each.

        Those of `half_bands` and the spread of the loading rows about the law, along their bend.
        """
        loading = self.table.rows(self.table.loading)
        bend, length = self.bend_and_length(loading.pressure_Pa)
        share = self.fit.degrees_of_freedom / max(self.fit.degrees_of_freedom + len(self.fit.theta), 1)
        sure = self.half_bands(pressure_Pa)
        bands = []
        for band, off in zip(sure, (loading.bend_rad - np.hypot(*bend.T), loading.length_m - length), strict=True):
            measured = off[np.isfinite(off)]
            spread = float(np.mean(measured**2)) / max(share, 0.1) if len(measured) else math.nan
            bands.append(np.sqrt(band**2 + self.t_quantile**2 * spread))
        return bands[0], bands[1]

    def robot(self, name: str) -> Robot:
        """The calibrated robot."""
        return check(Robot, self.robot_table(name), f"{self.table.source}: the calibrated robot")

    def robot_table(self, name: str, *, memory: bool = False) -> dict[str, Any]:
        """The tables of its robot file: what was calibrated, given or assumed here, with its provenance.

        `memory` writes what stays after a release as a residual strain, whose times the holds do not tell.

        What the table says nothing of (pneumatics, sensors) is left to the program's defaults.
        """
        model, theta = self.fit.model, self.fit.theta
        law = model.law(theta)
        length_m, section = model.geometry(theta)
        mass_kg = self.mass_kg or DENSITY_KG_M3 * section.wall_area_m2 * length_m
        turned = any(section.misalignment_rad)
        actuator = {
            "law": law.material,
            "modulus_Pa": rounded(law.modulus_Pa),
            **({"limit_invariant": rounded(law.limit_invariant)} if law.material == "gent" else {}),
            **({} if law.material == "gent" else {"stiffening_Pa": rounded(law.stiffening_Pa)}),
            "chamber_area_m2": rounded(section.chamber_area_m2),
            "chamber_centroid_radius_m": rounded(section.chamber_centroid_radius_m),
            "gains": [rounded(gain) for gain in law.gains],
            **({"misalignment_rad": [rounded(angle) for angle in section.misalignment_rad]} if turned else {}),
            "dead_band_Pa": rounded(law.dead_band_Pa),
            "max_pressure_Pa": largest_allowed_Pa(model.largest_pressure_Pa),
        }
        return {
            "schema": ROBOT_SCHEMA,
            "name": name,
            "length_m": rounded(length_m),
            "radius_m": rounded(section.radius_m),
            "mass_kg": rounded(mass_kg),
            "damping_time_s": DAMPING_TIME_S,
            "actuator": actuator,
            **({"memory": {"residual": residual}} if (residual := self._residual()) and memory else {}),
            "provenance": self._provenance(),
        }

    def _residual(self) -> dict[str, float] | None:
        if self.release is None or self.release.share <= 0.0:
            return None
        return {
            "share": rounded(self.release.share),
            "growth_time_s": ASSUMED_GROWTH_TIME_S,
            "recovery_time_s": ASSUMED_RECOVERY_TIME_S,
        }

    def report(self) -> dict[str, Any]:
        """The `--json` object: percentages are of full scale, everything else has its unit in its name."""
        errors, scale = self.errors, self.errors.full_scale_bend_rad
        result: dict[str, Any] = {
            "law": self.law,
            "parameters": {
                name: {
                    "value": one.value,
                    "low": one.low,
                    "high": one.high,
                    "unit": one.unit,
                    "identified": one.identified,
                }
                for name, one in self.parameters.items()
            },
            "rows": int(np.sum(self.table.loading)),
            "unloading_rows": int(np.sum(~self.table.loading)),
            "degrees_of_freedom": self.fit.degrees_of_freedom,
            "full_scale_bend_deg": math.degrees(scale),
            "rms_bend_deg": math.degrees(errors.rms_bend_rad),
            "rms_bend_percent": 100.0 * errors.rms_bend_rad / scale,
            "loo_bend_percent": 100.0 * errors.loo_bend_rad / scale,
            "repeat_bend_percent": _percent(errors.repeat_bend_rad, scale),
            "unloading_rms_bend_percent": _percent(errors.unloading_bend_rad, scale),
            "release_rms_bend_percent": _percent(errors.release_bend_rad, scale),
            "lack_of_fit_p": errors.lack_of_fit_p,
        }
        if errors.rms_length_m is not None and errors.full_scale_length_m:
            result |= {
                "full_scale_length_mm": 1e3 * errors.full_scale_length_m,
                "rms_length_percent": _percent(errors.rms_length_m, errors.full_scale_length_m),
                "loo_length_percent": _percent(errors.loo_length_m, errors.full_scale_length_m),
                "repeat_length_percent": _percent(errors.repeat_length_m, errors.full_scale_length_m),
                "release_rms_length_percent": _percent(errors.release_length_m, errors.full_scale_length_m),
            }
        return result | {
            "candidates": [
                {"name": one.name, "coordinates": one.coordinates, "loo_score": one.score} for one in self.candidates
            ],
            "assumptions": list(self.assumptions),
            "warnings": list(self.warnings),
            "measure_next": [
                {"pressure_kPa": [float(p) / 1e3 for p in one.pressure_Pa], "words": one.words}
                for one in self.measure_next
            ],
        }

    def _provenance(self) -> dict[str, str]:
        report = self.report()
        found = {
            "made_by": "softbot calibrate",
            "table": f"{self.table.source}: {report['rows']} loading rows",
            "law": f"{self.candidates[0].name}, chosen by leave-one-out among {len(self.candidates)} models",
            "bend_error": f"rms {report['rms_bend_percent']:.1f} %, leave-one-out {report['loo_bend_percent']:.1f} %"
            f"{_repeats(report['repeat_bend_percent'])} of {report['full_scale_bend_deg']:.1f} deg",
        }
        if "rms_length_percent" in report:
            found["length_error"] = (
                f"rms {report['rms_length_percent']:.1f} %, leave-one-out {report['loo_length_percent']:.1f} %"
                f"{_repeats(report['repeat_length_percent'])} of {report['full_scale_length_mm']:.1f} mm"
            )
        return found | numbers_provenance(self.parameters, self.assumptions, self.table)


def numbers_provenance(
    parameters: Mapping[str, Estimate], assumptions: Sequence[str], table: BendTable
) -> dict[str, str]:
    """Where each number of a fitted robot comes from: its interval, what was assumed, what the table says of itself."""
    found = {name: _interval(one) for name, one in parameters.items()}
    found["damping_time_s"] = "assumed: a loss tangent of about 0.1 at 1 Hz"
    found |= {f"assumption_{n}": text for n, text in enumerate(assumptions, 1)}
    return found | {f"source_{n}": text for n, text in enumerate(table.comments, 1) if text}


def _interval(one: Estimate) -> str:
    if not one.identified:
        return "not determined by what was measured"
    unit = "" if one.unit == "1" else f" {one.unit}"
    return f"95 % interval {one.low:.4g} ... {one.high:.4g}{unit}"


def _repeats(percent: float | None) -> str:
    return "" if percent is None else f", between repeats {percent:.1f} %"


def _percent(value: float | None, full_scale: float) -> float | None:
    return None if value is None else 100.0 * value / full_scale


def rounded(value: float) -> float:
    """Five significant digits: more than any table determines, and the same on every machine."""
    return float(f"{value:.5g}")


def rounded_up(value: float) -> float:
    """Two significant digits, upwards."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / step - 1e-9) * step:.6g}")


def largest_allowed_Pa(measured_Pa: float) -> float:
    """The robot's largest pressure from the table's [Pa]."""
    return rounded_up(PRESSURE_RESERVE * measured_Pa)
