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
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controllers.interface import Detection
from softbot.faults import CHAMBER_COUNT, KIND_CODES, KINDS, FaultKind, SENSOR_OFFSET_Pa
from softbot.pneumatics import PneumaticsParameters, valve_mass_flow
from softbot.sensing import READINGS, Readings, SensorParameters

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
_MODEL_KINDS = np.array([0 if row[0] is None else KIND_CODES[row[0]] for row in _BANK], dtype=np.int64)
_COUNT = len(_BANK)
_LONGEST_GAP_S = 0.05
_FASTEST_SWELLING_1_S = 2.0
_SENSOR_OFFSET, _SENSOR_STUCK = KIND_CODES[FaultKind.SENSOR_OFFSET], KIND_CODES[FaultKind.SENSOR_STUCK]
_BLOCKED_INLET, _STUCK_CLOSED = KIND_CODES[FaultKind.BLOCKED_INLET], KIND_CODES[FaultKind.STUCK_CLOSED]


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


class DetectorParts(NamedTuple):
    """What a detector is made of, as compiled code takes it."""

    models: FloatArray
    kinds: NDArray[np.int64]
    constants: FloatArray
    supply_conductance: FloatArray
    exhaust_conductance: FloatArray
    dead_volume_m3: FloatArray
    noise_Pa: float
    threshold: float
    margin: float
    jump_Pa: float
    repeats: int
    suspicious_repeats: int
    confirm_s: float
    patience_s: float
    settle_s: float


DETECTOR = np.dtype(
    [
        ("state_Pa", np.float64, (CHAMBER_COUNT, _COUNT)),
        ("score", np.float64, (CHAMBER_COUNT, _COUNT)),
        ("innovation_Pa", np.float64, (CHAMBER_COUNT, _COUNT)),
        ("lagged_opening", np.float64, CHAMBER_COUNT),
        ("swelling_1_s", np.float64, CHAMBER_COUNT),
        ("volume_m3", np.float64, CHAMBER_COUNT),
        ("last_volume_m3", np.float64, CHAMBER_COUNT),
        ("last_pressure_Pa", np.float64, CHAMBER_COUNT),
        ("last_supply_Pa", np.float64),
        ("last_t_s", np.float64),
        ("repeats", np.int64, CHAMBER_COUNT),
        ("owed_Pa", np.float64, CHAMBER_COUNT),
        ("suspect_since_s", np.float64, CHAMBER_COUNT),
        ("started_s", np.float64),
        ("named", np.int64, CHAMBER_COUNT),
        ("found", np.int64),
        ("found_chamber", np.int64, CHAMBER_COUNT),
        ("found_kind", np.int64, CHAMBER_COUNT),
        ("found_confidence", np.float64, CHAMBER_COUNT),
    ],
    align=True,
)
"""What a detector remembers, as a record. `named`: the kind by number, 0 none. `found`: verdicts of this cycle."""


def detector_memory() -> Any:
    """Memory of a detector that has seen nothing, shape (1,) of DETECTOR."""
    memory = np.zeros(1, DETECTOR).view(np.recarray)
    memory[0]["last_t_s"] = math.nan
    memory[0]["suspect_since_s"] = math.nan
    return memory


def detector_parts(
    parameters: PneumaticsParameters, sensors: SensorParameters, tuning: DetectorTuning | None = None
) -> DetectorParts:
    """The parts of a detector of a robot with these pneumatics and sensors."""
    own = tuning or DetectorTuning()
    constants = [
        parameters.critical_ratio,
        parameters.temperature_K,
        parameters.atmospheric_pressure_absolute_Pa,
        parameters.gas_constant_times_temperature_J_kg,
        parameters.valve_lag_s,
        own.observer_gain,
        own.rate_error,
        own.drift,
        own.swelling_error,
        own.evidence,
    ]
    return DetectorParts(
        _MODELS,
        _MODEL_KINDS,
        np.array(constants),
        np.array(parameters.supply_valve_conductance_m3_s_Pa),
        np.array(parameters.exhaust_valve_conductance_m3_s_Pa),
        np.array(parameters.dead_volume_m3),
        math.hypot(max(sensors.pressure_noise_Pa, own.floor_noise_Pa), 100.0),
        own.threshold,
        own.margin,
        own.jump_Pa,
        own.repeats,
        own.suspicious_repeats,
        own.confirm_s,
        own.patience_s,
        own.settle_s,
    )


class FaultDetector:
    """Watches the four chambers. One `update` a cycle; each chamber is named once, until `forget`."""

    def __init__(
        self,
        parameters: PneumaticsParameters,
        sensors: SensorParameters,
        tuning: DetectorTuning | None = None,
    ) -> None:
        self.parts = detector_parts(parameters, sensors, tuning)
        self.memory = detector_memory()
        self._reading = np.zeros(1, READINGS).view(np.recarray)

    @property
    def named(self) -> dict[int, FaultKind]:
        """What each named chamber was found to have."""
        return {chamber: KINDS[code - 1] for chamber, code in enumerate(self.memory[0]["named"].tolist()) if code}

    def update(self, readings: Readings, chamber_volume_m3: FloatArray) -> tuple[Detection, ...]:
        """Faults that these readings decide. `chamber_volume_m3` (4,): by the law, dead volume not counted.

        A gap in the readings (over five cycles' worth) restarts the models without a verdict.
        """
        readings.write(self._reading[0])
        detect(self.parts, self.memory, self._reading, np.ascontiguousarray(chamber_volume_m3))
        return detections_of(self.memory[0], readings.t_s)

    def forget(self, chamber: int) -> None:
        """Take a chamber's verdict back, after a repair."""
        own = self.memory[0]
        own["named"][chamber] = 0
        own["score"][chamber] = 0.0


def detections_of(own: Any, t_s: float) -> tuple[Detection, ...]:
    """The verdicts of a cycle at t_s that stand in a detector's record."""
    return tuple(
        Detection(
            float(t_s),
            int(own["found_chamber"][n]),
            str(KINDS[int(own["found_kind"][n]) - 1]),
            float(own["found_confidence"][n]),
        )
        for n in range(int(own["found"]))
    )


@njit(cache=True)
def detect(parts: DetectorParts, memory: Any, reading_memory: Any, chamber_volume_m3: FloatArray) -> None:
    """One cycle of the detector; its verdicts stand in memory[0] until the next. reading_memory: (1,) of READINGS."""
    own, reading = memory[0], reading_memory[0]
    own.found = 0
    whole = math.isfinite(reading.supply_Pa)
    for c in range(CHAMBER_COUNT):
        whole = whole and math.isfinite(reading.pressure_Pa[c])
        own.last_volume_m3[c] = own.volume_m3[c]
        own.volume_m3[c] = chamber_volume_m3[c] + parts.dead_volume_m3[c]
    if not whole:
        return
    step_s = reading.t_s - own.last_t_s
    if not 0.0 < step_s < _LONGEST_GAP_S:
        _restart(own, reading)
    else:
        for c in range(CHAMBER_COUNT):
            swelling = (own.volume_m3[c] - own.last_volume_m3[c]) / step_s / own.volume_m3[c]
            own.swelling_1_s[c] = min(max(swelling, -_FASTEST_SWELLING_1_S), _FASTEST_SWELLING_1_S)
        _follow(
            step_s,
            reading.pressure_Pa,
            own.last_supply_Pa,
            reading.opening,
            own.volume_m3,
            own.swelling_1_s,
            parts.noise_Pa,
            parts.supply_conductance,
            parts.exhaust_conductance,
            parts.constants,
            parts.models,
            own.state_Pa,
            own.lagged_opening,
            own.innovation_Pa,
            own.score,
        )
        settling = reading.t_s - own.started_s < parts.settle_s
        for c in range(CHAMBER_COUNT):
            if settling:
                for m in range(_COUNT):
                    own.score[c, m] = 0.0
            elif own.named[c] == 0:
                kind, confidence = _sensor_fault(parts, own, reading, c, step_s)
                if kind == 0:
                    kind, confidence = _gas_fault(parts, own, c, reading.t_s)
                if kind != 0:
                    own.named[c] = kind
                    n = own.found
                    own.found_chamber[n], own.found_kind[n], own.found_confidence[n] = c, kind, confidence
                    own.found = n + 1
    for c in range(CHAMBER_COUNT):
        own.last_pressure_Pa[c] = reading.pressure_Pa[c]
    own.last_supply_Pa, own.last_t_s = reading.supply_Pa, reading.t_s


@njit(cache=True)
def _restart(own: Any, reading: Any) -> None:
    for c in range(CHAMBER_COUNT):
        for m in range(_COUNT):
            own.state_Pa[c, m] = reading.pressure_Pa[c]
            own.score[c, m] = 0.0
        own.lagged_opening[c] = reading.opening[c]
        own.suspect_since_s[c] = math.nan
        own.repeats[c] = 0
        own.owed_Pa[c] = 0.0
    own.started_s = reading.t_s


@njit(cache=True)
def _gas_fault(parts: DetectorParts, own: Any, chamber: int, t_s: float) -> tuple[int, float]:
    score = own.score[chamber]
    best = 0
    for m in range(1, _COUNT):
        if score[m] > score[best]:
            best = m
    kind = parts.kinds[best]
    if kind == 0 or score[best] < parts.threshold:
        own.suspect_since_s[chamber] = math.nan
        return 0, 0.0
    if math.isnan(own.suspect_since_s[chamber]):
        own.suspect_since_s[chamber] = t_s
    waited_s = t_s - own.suspect_since_s[chamber]
    if waited_s < parts.confirm_s or 0 < parts.suspicious_repeats <= own.repeats[chamber]:
        return 0, 0.0
    lead, rival = math.inf, 0
    for m in range(1, _COUNT):
        if parts.kinds[m] != kind and score[best] - score[m] < lead:
            lead, rival = score[best] - score[m], parts.kinds[m]
    if lead < parts.margin:
        if waited_s < parts.patience_s:
            return 0, 0.0
        if (kind == _BLOCKED_INLET and rival == _STUCK_CLOSED) or (kind == _STUCK_CLOSED and rival == _BLOCKED_INLET):
            kind = _BLOCKED_INLET  # an empty chamber cannot tell them apart: it has nothing to vent
    return kind, 1.0 / (1.0 + math.exp(-max(lead, 0.0)))


@njit(cache=True)
def _sensor_fault(parts: DetectorParts, own: Any, reading: Any, chamber: int, step_s: float) -> tuple[int, float]:
    shown, before = reading.pressure_Pa[chamber], own.last_pressure_Pa[chamber]
    innovation = own.innovation_Pa[chamber, 0]
    fastest_Pa = 2.0 * step_s * _fill_rate_Pa_s(parts, own, chamber, reading.supply_Pa)
    if shown - before > max(parts.jump_Pa, fastest_Pa) and innovation > parts.jump_Pa:
        return _SENSOR_OFFSET, min(1.0, (shown - before) / SENSOR_OFFSET_Pa + 0.5)
    if shown != before:
        own.repeats[chamber] = 0
        own.owed_Pa[chamber] = 0.0
        return 0, 0.0
    own.repeats[chamber] += 1
    own.owed_Pa[chamber] = max(own.owed_Pa[chamber], abs(innovation))
    if own.repeats[chamber] >= parts.repeats and own.owed_Pa[chamber] > parts.noise_Pa:
        return _SENSOR_STUCK, 1.0
    return 0, 0.0


@njit(cache=True)
def _fill_rate_Pa_s(parts: DetectorParts, own: Any, chamber: int, supply_Pa: float) -> float:
    b, temperature, atmosphere, gas = parts.constants[0], parts.constants[1], parts.constants[2], parts.constants[3]
    flow = valve_mass_flow(parts.supply_conductance[chamber], b, supply_Pa + atmosphere, atmosphere, temperature)
    return flow * gas / own.volume_m3[chamber]


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
