"""Pressure loop of the four chambers: gauge pressures wanted in, valve openings out.

The plant's gain varies tenfold with the operating point (choked or subsonic, filling or venting), so the
law inverts it: the loop asks for a rate of pressure, and the ISO 6358 characteristic of the valve at the
measured pressures says which opening gives it (feedback linearisation). What is left is the same
everywhere: an integrator behind the valve's lag and the delays of sampling, dp/dt = rate asked for.

    rate = v + k_p e + k_i integral(e) dt,   e = r_m - p
    u    = rate V / (R T mdot(p_supply, p))       rate > 0: the valve fills
    u    = rate V / (R T mdot(p, p_atmosphere))   rate < 0: the valve vents

r is the wanted pressure, clamped to what the chamber may have and moved at a limited rate v (fed forward).
r_m is r as late as the valve's lag and the sampling make the pressure itself: the feed-forward is not
corrected for what it cannot help, which is what would overshoot. The integral stands still while the
opening is saturated in its direction (conditional anti-windup) and while both error and opening are within
their dead zones, where the valve is shut so that it does not chatter on sensor noise.

`controllers.pressure_loop_design` finds the gains.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softbot.errors import InputError
from softbot.faults import CHAMBER_COUNT
from softbot.kernel_compiler import kernel
from softbot.pneumatics import PneumaticsParameters, valve_mass_flow
from softbot.sensing import LEAST_READING_Pa

INVERSION_HEAD_Pa = 2e3
"""The characteristic is inverted as if at least this pressure drove the flow: the inverse grows without
bound at equal pressures, so below this head the loop is slower than designed instead of nervous."""

_MORE_Pa = 10.0  # less than any sensor or bus resolves: equal numbers must not be told apart by their last bits

DEFAULT_SETPOINT_RATE_Pa_s = 600e3


@dataclass(frozen=True, slots=True)
class PressureLoopGains:
    """Everything the law needs besides the pneumatics: gains and limits.

    Gains act on rates of pressure, so they do not depend on volume or valve: `proportional_1_s` turns an
    error [Pa] into a rate [Pa/s], `integral_1_s2` does so for its integral. `model_lag_s` is how far the
    pressure follows its setpoint behind (valve lag and two samples; `design_pressure_loop` fills it in).
    `feed_forward` is the share of the setpoint's own rate that is fed forward. `setpoint_rate_Pa_s` limits
    the setpoint's motion. Openings below `dead_zone_opening` shut the valve, and an error below
    `dead_zone_Pa` then is let be. A chamber that is asked for no more than `vent_below_Pa` and has come
    down to it is left open to the atmosphere.
    Raises InputError naming the field whose value is out of range.
    """

    proportional_1_s: float
    integral_1_s2: float
    sample_s: float
    model_lag_s: float = 0.0
    feed_forward: float = 1.0
    setpoint_rate_Pa_s: float = DEFAULT_SETPOINT_RATE_Pa_s
    dead_zone_opening: float = 0.01
    dead_zone_Pa: float = 200.0
    vent_below_Pa: float = 500.0

    def __post_init__(self) -> None:
        for name in ("proportional_1_s", "sample_s", "setpoint_rate_Pa_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"pressure_loop.{name} = {value!r}: must be finite and above zero")
        for name in (
            "integral_1_s2",
            "model_lag_s",
            "feed_forward",
            "dead_zone_opening",
            "dead_zone_Pa",
            "vent_below_Pa",
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise InputError(f"pressure_loop.{name} = {value!r}: must be finite and zero or more")
        if self.dead_zone_opening >= 1:
            raise InputError(
                f"pressure_loop.dead_zone_opening = {self.dead_zone_opening!r}: must be below 1 (fully open)"
            )


# Places in the packed law, float64: gains and limits, then what the inversion has to know of the pneumatics.
_PROPORTIONAL = 0
_INTEGRAL = 1
_SAMPLE = 2
_FEED_FORWARD = 3
_SETPOINT_RATE = 4
_DEAD_OPENING = 5
_DEAD_PRESSURE = 6
_VENT_BELOW = 7
_PRESSURE_LIMIT = 8
_CRITICAL_RATIO = 9
_TEMPERATURE = 10
_ATMOSPHERE = 11
_GAS = 12
_SUPPLY_CONDUCTANCE = 13
_EXHAUST_CONDUCTANCE = 17
_VOLUME = 21
_MODEL_LAG = 25


def pack_pressure_loop(
    gains: PressureLoopGains, parameters: PneumaticsParameters, chamber_volume_m3: ArrayLike
) -> NDArray[np.float64]:
    """The law's constants packed for `pressure_loop_step`: float64[26].

    `chamber_volume_m3`: the nominal volume of each chamber [4] or of all, dead volume not counted.
    Raises InputError for a volume that is not positive.
    """
    volume = nominal_volume(parameters, chamber_volume_m3)
    return np.array(
        [
            gains.proportional_1_s,
            gains.integral_1_s2,
            gains.sample_s,
            gains.feed_forward,
            gains.setpoint_rate_Pa_s,
            gains.dead_zone_opening,
            gains.dead_zone_Pa,
            gains.vent_below_Pa,
            parameters.max_chamber_pressure_Pa,
            parameters.critical_ratio,
            parameters.temperature_K,
            parameters.atmospheric_pressure_absolute_Pa,
            parameters.gas_constant_times_temperature_J_kg,
            *parameters.supply_valve_conductance_m3_s_Pa,
            *parameters.exhaust_valve_conductance_m3_s_Pa,
            *volume,
            gains.model_lag_s,
        ]
    )


def nominal_volume(parameters: PneumaticsParameters, chamber_volume_m3: ArrayLike) -> NDArray[np.float64]:
    """Volume of each chamber with its dead volume, shape (4,) [m³]. Raises InputError where it is not above zero."""
    try:
        volume = np.broadcast_to(np.asarray(chamber_volume_m3, dtype=np.float64), (CHAMBER_COUNT,))
    except ValueError:
        volume = np.full(CHAMBER_COUNT, np.nan)
    if not (np.all(np.isfinite(volume)) and np.all(volume > 0)):
        raise InputError(f"chamber_volume_m3 = {chamber_volume_m3!r}: must be one or four numbers above zero")
    return volume + np.array(parameters.dead_volume_m3)


@kernel()
def flow_to_invert(
    conductance_m3_s_Pa: float,
    b: float,
    upstream_absolute: float,
    downstream_absolute: float,
    temperature: float,
) -> float:
    """Mass flow of the fully open valve as the law sees it: never that of less than `INVERSION_HEAD_Pa`."""
    downstream = min(downstream_absolute, upstream_absolute - INVERSION_HEAD_Pa)
    return valve_mass_flow(conductance_m3_s_Pa, b, upstream_absolute, downstream, temperature)


@kernel()
def pressure_loop_step(
    reference_Pa: NDArray[np.float64],
    model_Pa: NDArray[np.float64],
    integral_Pa_s: NDArray[np.float64],
    opening: NDArray[np.float64],
    setpoint_Pa: NDArray[np.float64],
    measured_Pa: NDArray[np.float64],
    supply_Pa: float,
    packed: NDArray[np.float64],
) -> None:
    """One sample of the law over plain arrays, each [4]; the kernel behind `PressureLoop`.

    Moves `reference_Pa` (the rate-limited setpoint), `model_Pa` (the pressure to be expected of it) and
    `integral_Pa_s` (k_i times the integral of the error, a rate [Pa/s]) in place and writes `opening` in
    [-1, 1]. Gauge pressures. A chamber whose setpoint or reading is not finite, or any with a supply
    reading that is not, is vented; so is one whose reading is below `LEAST_READING_Pa`. A chamber that is to be empty,
    or reads more than it is asked for, is not filled, wherever the reference still is on its way down.
    """
    sample = packed[_SAMPLE]
    b = packed[_CRITICAL_RATIO]
    temperature = packed[_TEMPERATURE]
    atmosphere = packed[_ATMOSPHERE]
    for i in range(CHAMBER_COUNT):
        known = math.isfinite(setpoint_Pa[i]) and math.isfinite(measured_Pa[i]) and math.isfinite(supply_Pa)
        if not (known and measured_Pa[i] >= LEAST_READING_Pa):
            reference_Pa[i] = model_Pa[i] = integral_Pa_s[i] = 0.0
            opening[i] = -1.0
            continue
        wanted = min(max(setpoint_Pa[i], 0.0), packed[_PRESSURE_LIMIT])
        reach = packed[_SETPOINT_RATE] * sample
        move = min(max(wanted - reference_Pa[i], -reach), reach)
        reference_Pa[i] += move
        # Behind a ramp this discrete lag follows by exactly the model's lag.
        model_Pa[i] += (reference_Pa[i] - model_Pa[i]) * sample / (sample + packed[_MODEL_LAG])
        if wanted <= packed[_VENT_BELOW] and measured_Pa[i] <= packed[_VENT_BELOW] and reference_Pa[i] <= wanted:
            integral_Pa_s[i] = 0.0
            opening[i] = -1.0
            continue

        error = model_Pa[i] - measured_Pa[i]
        inside = max(measured_Pa[i] + atmosphere, INVERSION_HEAD_Pa)
        supply = max(supply_Pa + atmosphere, 2.0 * INVERSION_HEAD_Pa)
        integral = integral_Pa_s[i] + packed[_INTEGRAL] * sample * error
        rate = packed[_FEED_FORWARD] * move / sample + packed[_PROPORTIONAL] * error + integral
        if rate >= 0.0:
            flow = flow_to_invert(packed[_SUPPLY_CONDUCTANCE + i], b, supply, inside, temperature)
        else:
            outside = min(atmosphere, inside)
            flow = flow_to_invert(packed[_EXHAUST_CONDUCTANCE + i], b, inside, outside, temperature)
        u = rate * packed[_VOLUME + i] / (packed[_GAS] * flow)
        saturated = (u > 1.0 and error > 0.0) or (u < -1.0 and error < 0.0)
        resting = abs(u) <= packed[_DEAD_OPENING] and abs(error) <= packed[_DEAD_PRESSURE]
        if not (saturated or resting):
            integral_Pa_s[i] = integral
        if abs(u) <= packed[_DEAD_OPENING]:
            u = 0.0
        if wanted <= packed[_VENT_BELOW] or measured_Pa[i] > wanted + _MORE_Pa:
            u = min(u, 0.0)
        opening[i] = min(max(u, -1.0), 1.0)


class PressureLoop:
    """The law with its memory, four chambers at once. One `step` a sample.

    `reference_Pa` [4] is the rate-limited setpoint, `model_Pa` [4] the pressure to be expected of it in a
    healthy chamber with valves that are not saturated, `integral_Pa_s` [4] the integral part of the rate
    asked for, which in the steady state is what a leak costs in pressure rate: of use to a fault detector.
    """

    def __init__(
        self, gains: PressureLoopGains, parameters: PneumaticsParameters, chamber_volume_m3: ArrayLike
    ) -> None:
        self.gains = gains
        self._packed = pack_pressure_loop(gains, parameters, chamber_volume_m3)
        self.reference_Pa: NDArray[np.float64] = np.zeros(CHAMBER_COUNT)
        self.model_Pa: NDArray[np.float64] = np.zeros(CHAMBER_COUNT)
        self.integral_Pa_s: NDArray[np.float64] = np.zeros(CHAMBER_COUNT)

    def reset(self, measured_Pa: ArrayLike = (0.0, 0.0, 0.0, 0.0)) -> None:
        """Forget the past and start from the pressures measured now [4]."""
        self.reference_Pa[:] = measured_Pa
        self.model_Pa[:] = measured_Pa
        self.integral_Pa_s[:] = 0.0

    def step(self, setpoint_Pa: ArrayLike, measured_Pa: ArrayLike, supply_Pa: float) -> NDArray[np.float64]:
        """Valve openings [4] in [-1, 1] for gauge setpoints [4], readings [4] and the measured supply [Pa].

        Setpoints are clamped to 0...`max_chamber_pressure_Pa`. A reading that is not finite vents its
        chamber.
        Raises InputError for a wrong shape.
        """
        setpoint = np.asarray(setpoint_Pa, dtype=np.float64)
        measured = np.asarray(measured_Pa, dtype=np.float64)
        for name, array in (("setpoint_Pa", setpoint), ("measured_Pa", measured)):
            if array.shape != (CHAMBER_COUNT,):
                raise InputError(f"{name} has shape {array.shape}: must be four numbers, one a chamber")
        opening = np.empty(CHAMBER_COUNT)
        pressure_loop_step(
            self.reference_Pa,
            self.model_Pa,
            self.integral_Pa_s,
            opening,
            setpoint,
            measured,
            float(supply_Pa),
            self._packed,
        )
        return opening
