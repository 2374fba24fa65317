"""Does a calibration find robots again whose parameters are known, and are its 95 % intervals what they say?

Robots are drawn at random, measured as the shipped arm was (noise, quantised and noisy pressures, holds that are
repeated, releases that keep a share of the load; recordings with line, hysteresis and creep) and calibrated. Counted
is how often the true value of a parameter lies in its interval, over all that the calibration calls determined; and
how often the true bend and length at pressures that were not measured lie in the confidence bands, and new
measurements in the prediction bands.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.bend_table import BendTable, FloatArray, joined_rows
from calib.calibration import Calibration, Estimate
from calib.fit import calibrate_table
from calib.model_choice import Geometry
from calib.recording import Trial, trials_of
from calib.series_calibration import covariance_of, estimates_of
from calib.series_choice import LADDER
from calib.series_fit import fit_series, starts_of
from calib.series_model import SeriesModel
from calib.series_prediction import SeriesPrediction
from softbot.actuator import ActuatorLaw
from softbot.cross_section import CHAMBERS, default_cross_section

QUANTUM_PA = 647.0
"""Step of the shipped arm's pressure readings."""
PRESSURE_NOISE_PA = 500.0
BEND_NOISE = 0.03
"""Of full scale, of a hold; with two repeats the pooled repeat error is this."""
LENGTH_NOISE = 0.03
RECORDING_NOISE = 0.006
"""Of full scale, of a row of a recording."""
SAMPLE_RATE_HZ = 60.0
_HOLDS_PA = np.array([15e3, 30e3, 50e3, 75e3, 105e3])
_LOADS_PA = np.vstack(
    [np.kron(np.eye(CHAMBERS), _HOLDS_PA[:, None]), np.outer([50e3, 105e3], np.ones(CHAMBERS))]
)  # each chamber alone, and all together
_REPEATS = 2
_NEW_ROWS = 8


@dataclass(frozen=True)
class Coverage:
    """How often true values lay in their intervals."""

    robots: int
    hits: dict[str, int]
    """By parameter."""
    tries: dict[str, int]
    open: dict[str, int]
    """How often the calibration said that the table does not determine it."""
    band_hits: dict[str, int]
    """By band."""
    band_tries: dict[str, int]

    @property
    def share(self) -> float:
        """Over all parameters that were called determined."""
        return sum(self.hits.values()) / max(sum(self.tries.values()), 1)

    def report(self) -> dict[str, Any]:
        """For `--json`: [inside, of] by parameter and by band; the share is over the parameters."""
        return {
            "robots": self.robots,
            "share_percent": 100.0 * self.share,
            "parameters": {name: [self.hits[name], of] for name, of in self.tries.items()},
            "not_determined": self.open,
            "bands": {name: [self.band_hits[name], of] for name, of in self.band_tries.items()},
        }


@dataclass(frozen=True)
class _Drawn:
    """One robot found again."""

    truth: dict[str, float]
    found: dict[str, Estimate]
    bands: dict[str, NDArray[np.bool_]]
    """Whether what each band should hold lay in it."""


def holds_coverage(robots: int = 100, seed: int = 0, told: Callable[[int], None] | None = None) -> Coverage:
    """Coverage over random robots with tables of holds and releases; `told` hears the number of each robot done."""
    rng = np.random.default_rng(seed)
    return _counted(robots, lambda: _one_table(rng), told)


def recordings_coverage(robots: int = 100, seed: int = 0, told: Callable[[int], None] | None = None) -> Coverage:
    """Coverage over random robots with memory and two recordings each."""
    rng = np.random.default_rng(seed)
    return _counted(robots, lambda: _one_recording(rng), told)


def _counted(robots: int, draw: Callable[[], _Drawn], told: Callable[[int], None] | None) -> Coverage:
    hits: dict[str, int] = {}
    tries: dict[str, int] = {}
    undetermined: dict[str, int] = {}
    band_hits: dict[str, int] = {}
    band_tries: dict[str, int] = {}
    for n in range(robots):
        drawn = draw()
        for name, one in drawn.found.items():
            if name not in drawn.truth:
                continue
            if not one.identified:
                undetermined[name] = undetermined.get(name, 0) + 1
                continue
            tries[name] = tries.get(name, 0) + 1
            hits[name] = hits.get(name, 0) + int(one.low <= drawn.truth[name] <= one.high)
        for band, inside in drawn.bands.items():
            band_tries[band] = band_tries.get(band, 0) + len(inside)
            band_hits[band] = band_hits.get(band, 0) + int(np.sum(inside))
        if told is not None:
            told(n + 1)
    return Coverage(robots, hits, tries, undetermined, band_hits, band_tries)


def _one_table(rng: np.random.Generator) -> _Drawn:
    length_m = float(rng.uniform(0.1, 0.25))
    radius_m = length_m / float(rng.uniform(5.0, 12.0))
    gains = np.exp(rng.normal(0.0, 0.08, CHAMBERS))
    gains /= gains.mean()
    truth = {
        "length_m": length_m,
        "radius_m": radius_m,
        "modulus_Pa": float(np.exp(rng.uniform(math.log(5e4), math.log(2e5)))),
        "dead_band_Pa": float(rng.uniform(3e3, 12e3)),
        "residual_share": float(rng.uniform(0.12, 0.3)),
        **{f"gain_{i}": float(gain) for i, gain in enumerate(gains)},
    }
    law = ActuatorLaw(
        default_cross_section(radius_m),
        "neo-hookean",
        truth["modulus_Pa"],
        gains=(float(gains[0]), float(gains[1]), float(gains[2]), float(gains[3])),
        dead_band_Pa=truth["dead_band_Pa"],
    )
    found = calibrate_table(_measured(rng, law, length_m, truth["residual_share"]), Geometry(), law="neo-hookean")
    return _Drawn(truth, found.parameters, _in_bands(rng, law, length_m, found))


def _in_bands(
    rng: np.random.Generator, law: ActuatorLaw, length_m: float, found: Calibration
) -> dict[str, NDArray[np.bool_]]:
    """Do true and newly measured bends and lengths of one chamber, or two neighbours, lie in their bands?"""
    pressure_Pa = np.zeros((_NEW_ROWS, CHAMBERS))
    for row in pressure_Pa:
        i = int(rng.integers(CHAMBERS))
        row[[i, (i + 1) % CHAMBERS]] = rng.uniform(20e3, 100e3, 2) * (1.0, float(rng.integers(2)))
    bend, length = _true_bend_and_length(law, length_m, pressure_Pa)
    noisy_bend, noisy_length = _noisy(rng, law, length_m, pressure_Pa)
    said_bend, said_length = found.bend_and_length(pressure_Pa)
    read_bend, read_length = found.bend_and_length(_read(rng, pressure_Pa))
    sure, wide = found.half_bands(pressure_Pa), found.prediction_half_bands(pressure_Pa)

    def off(one: FloatArray, other: FloatArray) -> FloatArray:
        return np.asarray(np.abs(np.hypot(*one.T) - np.hypot(*other.T)))

    return {
        "bend, confidence": off(bend, said_bend) <= sure[0],
        "bend, prediction": off(noisy_bend, read_bend) <= wide[0],
        "length, confidence": np.abs(length - said_length) <= sure[1],
        "length, prediction": np.abs(noisy_length - read_length) <= wide[1],
    }


def _true_bend_and_length(law: ActuatorLaw, length_m: float, pressure_Pa: FloatArray) -> tuple[FloatArray, FloatArray]:
    strain, _ = law.equilibria(pressure_Pa)
    return length_m * strain[:, 1:], length_m * strain[:, 0]


def _noisy(
    rng: np.random.Generator, law: ActuatorLaw, length_m: float, pressure_Pa: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Bends, shape (n, 2), and lengths as they are measured, with the noise of the whole table."""
    full_bend, full_length = _true_bend_and_length(law, length_m, _LOADS_PA)
    bend, length = _true_bend_and_length(law, length_m, pressure_Pa)
    scale = float(np.max(np.hypot(*full_bend.T)))
    return (
        bend + BEND_NOISE * scale / math.sqrt(2.0) * rng.standard_normal(bend.shape),
        length + LENGTH_NOISE * float(np.ptp(full_length)) * rng.standard_normal(len(length)),
    )


def _measured(rng: np.random.Generator, law: ActuatorLaw, length_m: float, share: float) -> BendTable:
    """Holds of each chamber alone, each with its release, twice; and of all chambers together."""
    true_Pa, felt_Pa, loading, trial, setpoint = [], [], [], [], []
    for repeat in range(_REPEATS):
        for n, load in enumerate(_LOADS_PA):
            name = "-".join(f"{value / 1e3:g}" for value in load)
            for released in (False, True):
                true_Pa.append(np.zeros(CHAMBERS) if released else load)
                felt_Pa.append(share * load if released else load)
                loading.append(not released)
                trial.append(f"{repeat}.{n}")
                setpoint.append(f"after {name}" if released else name)
    bend, length = _noisy(rng, law, length_m, np.array(felt_Pa))
    return _table(
        pressure_Pa=_read(rng, np.array(true_Pa)),
        bend_rad=np.hypot(*bend.T),
        direction_rad=np.arctan2(bend[:, 1], bend[:, 0]),
        length_m=length,
        loading=np.array(loading),
        trial=np.array(trial),
        setpoint=np.array(setpoint),
    )


def _one_recording(rng: np.random.Generator) -> _Drawn:
    length_m, radius_m = 0.134, 0.029
    model = SeriesModel("gent", LADDER[0], ((0,),), length_m, radius_m, 105e3)
    drawn = {
        "filling_time": rng.uniform(0.3, 1.0),
        "venting_time": rng.uniform(0.5, 2.0),
        "hysteresis_share": rng.uniform(0.2, 0.6),
        "hysteresis_width": rng.uniform(0.3, 0.7),
        "creep_share": rng.uniform(0.15, 0.4),
        "creep_time": rng.uniform(1.5, 4.0),
        "modulus": rng.uniform(3e4, 8e4),
        "limit": rng.uniform(0.3, 1.0),
        "dead_band": rng.uniform(0.04, 0.12),
    }
    theta = model.start(**drawn)
    prediction = SeriesPrediction(model, theta)
    parts = [_recorded(rng, prediction, name, corners) for name, corners in (("steps", _STEPS), ("ramps", _RAMPS))]
    trials, _ = trials_of(joined_rows(*parts))
    fit = fit_series(model, trials, starts_of(model, trials), most=60)
    covariance, _ = covariance_of(fit, trials)
    truth = {name: one.value for name, one in estimates_of(model, theta, covariance).items()}
    return _Drawn(truth, estimates_of(model, fit.theta, covariance), {})


_STEPS: tuple[tuple[float, float], ...] = (
    (0.0, 0.0),
    (1.0, 0.0),
    (1.2, 40e3),
    (9.0, 40e3),
    (9.2, 100e3),
    (20.0, 100e3),
    (20.5, 60e3),
    (30.0, 60e3),
)
_STEPS += ((30.5, 0.0), (40.0, 0.0))
_RAMPS = ((0.0, 0.0), (1.0, 0.0), (15.0, 50e3), (28.0, 10e3), (45.0, 100e3), (60.0, 5e3), (66.0, 5e3))


def _recorded(
    rng: np.random.Generator, prediction: SeriesPrediction, name: str, corners: tuple[tuple[float, float], ...]
) -> BendTable:
    """A recording of a pressure of chamber 0 that runs straight between corners (time, pressure)."""
    at_s, at_Pa = np.array(corners).T
    t = np.arange(0.0, at_s[-1], 1.0 / SAMPLE_RATE_HZ)
    pressure = np.zeros((len(t), CHAMBERS))
    pressure[:, 0] = np.interp(t, at_s, at_Pa)
    away = np.array([-1.0, 0.0])
    clean = Trial(name, t, np.zeros(len(t)), away, np.zeros(2), t, pressure, np.zeros(len(t)), (0,), 0)
    bend = prediction.bend_rad(clean)
    noisy = bend + RECORDING_NOISE * float(np.max(bend)) * rng.standard_normal(len(t))
    return _table(
        pressure_Pa=_read(rng, pressure),
        bend_rad=noisy,
        direction_rad=np.full(len(t), math.pi),
        trial=np.full(len(t), name),
        t_s=t,
    )


def _table(pressure_Pa: FloatArray, bend_rad: FloatArray, direction_rad: FloatArray, **given: Any) -> BendTable:
    """Rows as they would be read from a file."""
    rows = len(pressure_Pa)
    columns: dict[str, Any] = {
        "length_m": np.full(rows, np.nan),
        "loading": np.ones(rows, dtype=bool),
        "trial": np.full(rows, ""),
        "setpoint": np.full(rows, ""),
        "line": np.arange(2, rows + 2),
        "t_s": np.full(rows, np.nan),
        "valid": np.ones(rows, dtype=bool),
    }
    return BendTable(
        source="self-test",
        comments=(),
        notes=(),
        pressure_Pa=pressure_Pa,
        bend_rad=bend_rad,
        direction_rad=direction_rad,
        **(columns | given),
    )


def _read(rng: np.random.Generator, pressure_Pa: FloatArray) -> FloatArray:
    """Pressures as the sensors give them: with noise, in steps."""
    noisy = pressure_Pa + PRESSURE_NOISE_PA * rng.standard_normal(pressure_Pa.shape)
    return np.asarray(QUANTUM_PA * np.round(noisy / QUANTUM_PA))
