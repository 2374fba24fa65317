"""Fault detection: what is wrong with a chamber, named by the model that explains its pressure best.

For each chamber a bank of small models runs beside the plant, one for each thing that can be wrong with it: healthy,
holes of several sizes, a blocked inlet, a valve stuck shut or open. All get what the real chamber gets (commanded
opening, measured supply pressure, chamber volume) and follow the measured pressure with the same slow observer gain, so
that a model's innovation stays large only while it is wrong. For each faulty model a cumulative sum (CUSUM) of the
log-likelihood ratio against the healthy one grows when it explains the readings better; it decides at a threshold, when
it also leads the other kinds by a margin. Two faults of the sensor are told by what no gas can do: a jump upwards
faster than the open valve can fill, and readings that repeat to the last bit while the chamber must be changing.

Sizes of holes are relative to the supply valve's conductance, as in `softbot.faults`; from `RUPTURE_FROM` on a hole is
called a rupture. Left out: faults of the supply and of the inertial unit, and two faults of one chamber at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controllers.interface import Detection
from softbot.faults import CHAMBER_COUNT, FaultKind, SENSOR_OFFSET_Pa
from softbot.pneumatics import PneumaticsParameters, valve_mass_flow
from softbot.sensing import Readings, SensorParameters

FloatArray = NDArray[np.float64]

RUPTURE_FROM = 2.0
"""Hole over supply valve conductance from which a leak is called a rupture: the chamber holds no useful pressure."""

# kind, hole ratio, inlet factor, forced opening (nan: free)
_BANK: tuple[tuple[FaultKind | None, float, float, float], ...] = (
    (None, 0.0, 1.0, math.nan),
    (FaultKind.LEAK, 0.3, 1.0, math.nan),
    (FaultKind.LEAK, 0.9, 1.0, math.nan),
    (FaultKind.RUPTURE, 3.5, 1.0, math.nan),
    (FaultKind.RUPTURE, 10.0, 1.0, math.nan),
    (FaultKind.BLOCKED_INLET, 0.0, 0.0, math.nan),
    (FaultKind.BLOCKED_INLET, 0.0, 0.4, math.nan),
    (FaultKind.STUCK_CLOSED, 0.0, 1.0, 0.0),
    (FaultKind.STUCK_OPEN, 0.0, 1.0, 1.0),
    (FaultKind.STUCK_OPEN, 0.0, 1.0, 0.4),
)
_HOLE, _INLET, _FORCED = 0, 1, 2
_SUBSTEPS = 3
_SLOPE_STEP_Pa = 500.0
_WORST = 50.0  # squared innovation over variance: one reading, however wild, is no proof
_MODELS = np.array([row[1:] for row in _BANK])


@dataclass(frozen=True)
class DetectorTuning:
    """Thresholds of the decision.

    `threshold` and `margin` are log-likelihood ratios: e^threshold to one. `evidence` is what one reading counts:
    innovations are correlated over a few cycles, so it is well below 1. `rate_error` is the part of a modelled pressure
    change that may be wrong (volume, conductance, supply), `swelling_error` that of the volume's own change.
    `observer_gain` is the share of an innovation that each model takes over in a cycle. A verdict waits `confirm_s`
    after the threshold, and up to `patience_s` for one kind to lead the others.
    """

    threshold: float = 12.0
    margin: float = 3.0
    evidence: float = 0.5
    rate_error: float = 0.35
    swelling_error: float = 1.0
    observer_gain: float = 0.1
    drift: float = 0.05
    floor_noise_Pa: float = 700.0
    jump_Pa: float = 8e3
    repeats: int = 12
    suspicious_repeats: int = 5
    confirm_s: float = 0.08
    patience_s: float = 0.4
    settle_s: float = 0.2
    """After the start, while the observers find the pressures."""


class FaultDetector:
    """Watches the four chambers. One `update` a cycle; each chamber is named once, until `forget`."""

    def __init__(
        self,
        parameters: PneumaticsParameters,
        sensors: SensorParameters,
        tuning: DetectorTuning | None = None,
    ) -> None:
        self._tuning = tuning or DetectorTuning()
        self._parameters = parameters
        self._dead_volume_m3 = np.array(parameters.dead_volume_m3)
        self._noise_Pa = math.hypot(max(sensors.pressure_noise_Pa, self._tuning.floor_noise_Pa), 100.0)
        self._constants = np.array(
            [
                parameters.critical_ratio,
                parameters.temperature_K,
                parameters.atmospheric_pressure_absolute_Pa,
                parameters.gas_constant_times_temperature_J_kg,
                parameters.valve_lag_s,
                self._tuning.observer_gain,
                self._tuning.rate_error,
                self._tuning.drift,
                self._tuning.swelling_error,
                self._tuning.evidence,
            ]
        )
        self._supply_conductance = np.array(parameters.supply_valve_conductance_m3_s_Pa)
        self._exhaust_conductance = np.array(parameters.exhaust_valve_conductance_m3_s_Pa)
        models = len(_BANK)
        self._state_Pa = np.zeros((CHAMBER_COUNT, models))
        self._score = np.zeros((CHAMBER_COUNT, models))
        self._lagged_opening = np.zeros(CHAMBER_COUNT)
        self._innovation_Pa = np.zeros((CHAMBER_COUNT, models))
        self._last: Readings | None = None
        self._last_volume_m3: FloatArray | None = None
        self._repeats = np.zeros(CHAMBER_COUNT, dtype=np.int64)
        self._owed_Pa = np.zeros(CHAMBER_COUNT)
        self._suspect_since_s = np.full(CHAMBER_COUNT, math.nan)
        self._started_s = 0.0
        self.named: dict[int, FaultKind] = {}

    def update(self, readings: Readings, chamber_volume_m3: FloatArray) -> tuple[Detection, ...]:
        """Faults that these readings decide. `chamber_volume_m3` (4,): by the law, dead volume not counted.

        A gap in the readings (over five cycles' worth) restarts the models without a verdict.
        """
        volume = chamber_volume_m3 + self._dead_volume_m3
        last, self._last = self._last, readings
        last_volume, self._last_volume_m3 = self._last_volume_m3, volume
        if not (np.isfinite(readings.pressure_Pa).all() and math.isfinite(readings.supply_Pa)):
            self._last = last
            return ()
        if last is None or last_volume is None or not 0.0 < readings.t_s - last.t_s < 0.05:
            self._restart(readings)
            return ()
        step_s = readings.t_s - last.t_s
        swelling = (volume - last_volume) / step_s / volume
        _follow(
            step_s,
            readings.pressure_Pa,
            last.supply_Pa,
            readings.opening,
            volume,
            np.clip(swelling, -2.0, 2.0),
            self._noise_Pa,
            self._supply_conductance,
            self._exhaust_conductance,
            self._constants,
            _MODELS,
            self._state_Pa,
            self._lagged_opening,
            self._innovation_Pa,
            self._score,
        )
        if readings.t_s - self._started_s < self._tuning.settle_s:
            self._score[:] = 0.0
            return ()
        found = []
        for chamber in range(CHAMBER_COUNT):
            if chamber in self.named:
                continue
            named = self._sensor_fault(chamber, readings, last, step_s) or self._gas_fault(chamber, readings.t_s)
            if named is not None:
                kind, confidence = named
                self.named[chamber] = kind
                found.append(Detection(readings.t_s, chamber, str(kind), confidence))
        return tuple(found)

    def forget(self, chamber: int) -> None:
        """Take a chamber's verdict back, after a repair."""
        self.named.pop(chamber, None)
        self._score[chamber] = 0.0

    def _restart(self, readings: Readings) -> None:
        self._state_Pa[:] = readings.pressure_Pa[:, None]
        self._lagged_opening[:] = readings.opening
        self._score[:] = 0.0
        self._suspect_since_s[:] = math.nan
        self._repeats[:] = 0
        self._owed_Pa[:] = 0.0
        self._started_s = readings.t_s

    def _gas_fault(self, chamber: int, t_s: float) -> tuple[FaultKind, float] | None:
        score, tuning = self._score[chamber], self._tuning
        best = int(np.argmax(score))
        kind = _BANK[best][0]
        if kind is None or score[best] < tuning.threshold:
            self._suspect_since_s[chamber] = math.nan
            return None
        if math.isnan(self._suspect_since_s[chamber]):
            self._suspect_since_s[chamber] = t_s
        waited_s = t_s - self._suspect_since_s[chamber]
        if waited_s < tuning.confirm_s or 0 < tuning.suspicious_repeats <= self._repeats[chamber]:
            return None
        lead, rival = min((float(score[best] - score[m]), m) for m in range(1, len(_BANK)) if _BANK[m][0] != kind)
        if lead < tuning.margin and waited_s < tuning.patience_s:
            return None
        if lead < tuning.margin and {kind, _BANK[rival][0]} == {FaultKind.BLOCKED_INLET, FaultKind.STUCK_CLOSED}:
            kind = FaultKind.BLOCKED_INLET  # an empty chamber cannot tell them apart: it has nothing to vent
        return kind, 1.0 / (1.0 + math.exp(-max(lead, 0.0)))

    def _sensor_fault(
        self, chamber: int, readings: Readings, last: Readings, step_s: float
    ) -> tuple[FaultKind, float] | None:
        reading, before = float(readings.pressure_Pa[chamber]), float(last.pressure_Pa[chamber])
        innovation = float(self._innovation_Pa[chamber, 0])
        fastest_Pa = 2.0 * step_s * self._fill_rate_Pa_s(chamber, readings.supply_Pa)
        if reading - before > max(self._tuning.jump_Pa, fastest_Pa) and innovation > self._tuning.jump_Pa:
            return FaultKind.SENSOR_OFFSET, min(1.0, (reading - before) / SENSOR_OFFSET_Pa + 0.5)
        if reading != before:
            self._repeats[chamber] = 0
            self._owed_Pa[chamber] = 0.0
            return None
        self._repeats[chamber] += 1
        self._owed_Pa[chamber] = max(self._owed_Pa[chamber], abs(innovation))
        if self._repeats[chamber] >= self._tuning.repeats and self._owed_Pa[chamber] > self._noise_Pa:
            return FaultKind.SENSOR_STUCK, 1.0
        return None

    def _fill_rate_Pa_s(self, chamber: int, supply_Pa: float) -> float:
        own = self._parameters
        assert self._last_volume_m3 is not None
        atmosphere = own.atmospheric_pressure_absolute_Pa
        flow = valve_mass_flow(
            self._supply_conductance[chamber], own.critical_ratio, supply_Pa + atmosphere, atmosphere, own.temperature_K
        )
        return float(flow * own.gas_constant_times_temperature_J_kg / self._last_volume_m3[chamber])


@njit(cache=True)
def _follow(
    step_s: float,
    reading_Pa: FloatArray,
    supply_Pa: float,
    opening: FloatArray,
    volume_m3: FloatArray,
    swelling_1_s: FloatArray,
    noise_Pa: float,
    supply_conductance: FloatArray,
    exhaust_conductance: FloatArray,
    constants: FloatArray,
    models: FloatArray,
    state_Pa: FloatArray,
    lagged_opening: FloatArray,
    innovation_Pa: FloatArray,
    score: FloatArray,
) -> None:
    """One cycle of all models of all chambers: predict, compare, correct, accumulate. Arrays are moved in place."""
    b, temperature, atmosphere, gas = constants[0], constants[1], constants[2], constants[3]
    lag, gain, rate_error, drift = constants[4], constants[5], constants[6], constants[7]
    swelling_error, evidence = constants[8], constants[9]
    follow = 1.0 - math.exp(-step_s / lag) if lag > 0.0 else 1.0
    for c in range(reading_Pa.size):
        before = lagged_opening[c]
        lagged_opening[c] += follow * (opening[c] - lagged_opening[c])
        healthy = 0.0
        for m in range(models.shape[0]):
            u = 0.5 * (before + lagged_opening[c]) if math.isnan(models[m, _FORCED]) else models[m, _FORCED]
            inlet = max(u, 0.0) * supply_conductance[c] * models[m, _INLET]
            outlet = max(-u, 0.0) * exhaust_conductance[c]
            hole = models[m, _HOLE] * supply_conductance[c]
            start = p = state_Pa[c, m]
            for _ in range(_SUBSTEPS):  # Rosenbrock–Euler: stable however big the hole
                rate = 0.0
                slope = 0.0
                for side in range(2):
                    inside = p + side * _SLOPE_STEP_Pa + atmosphere
                    flow = (
                        valve_mass_flow(inlet, b, supply_Pa + atmosphere, inside, temperature)
                        - valve_mass_flow(outlet, b, inside, atmosphere, temperature)
                        - valve_mass_flow(hole, b, inside, atmosphere, temperature)
                    )
                    here = gas * flow / volume_m3[c] - inside * swelling_1_s[c]
                    if side == 0:
                        rate = here
                    slope = (here - rate) / _SLOPE_STEP_Pa
                dt_s = step_s / _SUBSTEPS
                p += dt_s * rate / (1.0 - dt_s * min(slope, 0.0))
            p = min(max(p, min(start, 0.0)), max(start, supply_Pa))
            error = reading_Pa[c] - p
            innovation_Pa[c, m] = error
            variance = noise_Pa * noise_Pa + (rate_error * (p - start)) ** 2
            variance += (swelling_error * step_s * swelling_1_s[c] * (p + atmosphere)) ** 2
            state_Pa[c, m] = p + gain * error
            likelihood = evidence * (-0.5 * min(error * error / variance, _WORST) - 0.5 * math.log(variance))
            if m == 0:
                healthy = likelihood
            else:
                score[c, m] = max(0.0, score[c, m] + likelihood - healthy - drift)
