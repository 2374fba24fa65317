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

`design_pressure_loop` picks k_p and k_i with python-control so that the worst of many operating points
keeps the wanted margins. Its plant is the linearised law, not the ideal integrator: an inversion that is
late (lag, delay) or of the wrong volume cancels badly, and that is in the margins. It leaves out sensor
dynamics and the sag of the manifold, which is measured and so compensated.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from itertools import product
from typing import Any

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

OPERATING_OPENINGS = (-0.5, 0.0, 0.5)
"""Valve openings of the operating points: venting, holding, filling. Fully open the loop is saturated, not
linear."""
OPERATING_VOLUME_RATIOS = (0.8, 1.0, 1.6)
"""Actual over nominal volume of the operating points."""


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
    setpoint_rate_Pa_s: float = 600e3
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


@dataclass(frozen=True, slots=True)
class OperatingPoint:
    """One linearisation and its margins.

    `pressure_Pa` of the chamber (gauge), `opening` at which the valve stands (negative: venting, 0: holding,
    positive: filling, as while a setpoint ramps or a leak is fed), `volume_ratio` = actual over nominal
    volume. `bandwidth_rad_s` is where the closed loop has fallen by 3 dB (inf where it never does).
    """

    pressure_Pa: float
    opening: float
    volume_ratio: float
    gain_margin_dB: float
    phase_margin_deg: float
    crossover_rad_s: float
    bandwidth_rad_s: float
    stable: bool


@dataclass(frozen=True, slots=True)
class PressureLoopDesign:
    """Gains, and the margins they have; the design's margins are the worst of all its operating points."""

    gains: PressureLoopGains
    points: tuple[OperatingPoint, ...]

    @property
    def gain_margin_dB(self) -> float:
        """The smallest gain margin [dB]."""
        return min(point.gain_margin_dB for point in self.points)

    @property
    def phase_margin_deg(self) -> float:
        """The smallest phase margin [deg]."""
        return min(point.phase_margin_deg for point in self.points)

    @property
    def worst(self) -> OperatingPoint:
        """The operating point with the smallest phase margin."""
        return min(self.points, key=lambda point: point.phase_margin_deg)

    @property
    def bandwidth_rad_s(self) -> float:
        """The smallest closed-loop bandwidth of the points that hold a pressure (opening 0) [rad/s]."""
        return min(point.bandwidth_rad_s for point in self.points if point.opening == 0)

    @property
    def stable(self) -> bool:
        """Whether the loop is stable at every operating point."""
        return all(point.stable for point in self.points)

    def table(self) -> str:
        """The operating points and their margins as lines of text, the worst phase margin marked."""
        lines = [
            f"k_p = {self.gains.proportional_1_s:.2f} 1/s, k_i = {self.gains.integral_1_s2:.2f} 1/s2, "
            f"sample {self.gains.sample_s * 1e3:g} ms",
            "pressure [kPa]  opening  volume  gain margin [dB]  phase margin [deg]  crossover [rad/s]",
        ]
        lines += [
            f"{point.pressure_Pa / 1e3:14.1f}  {point.opening:+7.2f}  {point.volume_ratio:6.2f}  "
            f"{point.gain_margin_dB:16.1f}  {point.phase_margin_deg:18.1f}  {point.crossover_rad_s:17.1f}"
            + ("  worst" if point is self.worst else "")
            for point in self.points
        ]
        return "\n".join(lines)


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
    volume = _nominal_volume(parameters, chamber_volume_m3)
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


def _nominal_volume(parameters: PneumaticsParameters, chamber_volume_m3: ArrayLike) -> NDArray[np.float64]:
    try:
        volume = np.broadcast_to(np.asarray(chamber_volume_m3, dtype=np.float64), (CHAMBER_COUNT,))
    except ValueError:
        volume = np.full(CHAMBER_COUNT, np.nan)
    if not (np.all(np.isfinite(volume)) and np.all(volume > 0)):
        raise InputError(f"chamber_volume_m3 = {chamber_volume_m3!r}: must be one or four numbers above zero")
    return volume + np.array(parameters.dead_volume_m3)


@kernel()
def _flow_to_invert(
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
            flow = _flow_to_invert(packed[_SUPPLY_CONDUCTANCE + i], b, supply, inside, temperature)
        else:
            outside = min(atmosphere, inside)
            flow = _flow_to_invert(packed[_EXHAUST_CONDUCTANCE + i], b, inside, outside, temperature)
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


@dataclass(frozen=True, slots=True)
class _LinearPlant:
    """The discrete plant at an operating point, from the rate asked for to the pressure.

    `inversion_1_s`: the feedback that the law's own inversion of the flow adds there.
    """

    pressure_Pa: float
    opening: float
    volume_ratio: float
    plant: Any
    inversion_1_s: float


def _linearise(
    parameters: PneumaticsParameters,
    chamber: int,
    volume_m3: float,
    volume_ratio: float,
    pressure_Pa: float,
    opening: float,
    filling: bool,
) -> tuple[float, float, float]:
    """(plant pole [1/s], loop gain ratio, feedback of the inversion [1/s]) at an operating point.

    With u the opening, w the rate asked for and F_m the characteristic that is inverted:

        plant  d(dp)/dt = (R T/V)(F du + u0 F' dp)
        law    du = (V_n/(R T F_m)) w - u0 (F_m'/F_m) dp

    In units of w that is a plant ratio/(s - pole), with the law's own feedback -inversion dp added to w.
    """
    gas = parameters.gas_constant_times_temperature_J_kg
    atmosphere = parameters.atmospheric_pressure_absolute_Pa
    b, temperature = parameters.critical_ratio, parameters.temperature_K
    supply = parameters.supply_pressure_absolute_Pa
    if filling:
        conductance = parameters.supply_valve_conductance_m3_s_Pa[chamber]
    else:
        conductance = parameters.exhaust_valve_conductance_m3_s_Pa[chamber]

    def both(p: float) -> NDArray[np.float64]:
        ends = (supply, p) if filling else (p, atmosphere)
        return np.array(
            [
                valve_mass_flow(conductance, b, *ends, temperature),
                _flow_to_invert(conductance, b, *ends, temperature),
            ]
        )

    p = pressure_Pa + atmosphere
    half_step_Pa = 1.0
    flow, inverted = both(p)
    slope, inverted_slope = (both(p + half_step_Pa) - both(p - half_step_Pa)) / (2 * half_step_Pa)
    pole = gas / (volume_ratio * volume_m3) * opening * slope
    return (
        float(pole),
        float(flow / inverted / volume_ratio),
        float(opening * inverted_slope * gas / volume_m3),
    )


def _linear_plants(
    control: Any,
    parameters: PneumaticsParameters,
    chamber_volume_m3: ArrayLike,
    sample_s: float,
    pressures_Pa: tuple[float, ...] | None,
    openings: tuple[float, ...],
    volume_ratios: tuple[float, ...],
) -> list[_LinearPlant]:
    """The plants of all combinations and all chambers that differ: zero-order hold, one sample of delay."""
    volume = _nominal_volume(parameters, chamber_volume_m3)
    limit = parameters.max_chamber_pressure_Pa
    if pressures_Pa is None:
        pressures_Pa = (0.05 * limit, 0.35 * limit, 0.7 * limit, 0.98 * limit)
    for pressure_Pa in pressures_Pa:
        if not 0 < pressure_Pa < parameters.supply_pressure_Pa:
            raise InputError(f"operating pressure {pressure_Pa!r} Pa: must be between zero and the supply's")
    delay = control.tf([1], [1, 0], sample_s)
    lag = control.tf([1], [parameters.valve_lag_s, 1])
    plants: dict[tuple[float, ...], _LinearPlant] = {}
    for chamber, pressure_Pa, opening, ratio in product(range(CHAMBER_COUNT), pressures_Pa, openings, volume_ratios):
        # A valve at rest may move to either side.
        for filling in (opening > 0,) if opening else (True, False):
            pole, gain, inversion = _linearise(
                parameters, chamber, float(volume[chamber]), ratio, pressure_Pa, opening, filling
            )
            key = (pressure_Pa, opening, ratio, pole, gain, inversion)
            if key not in plants:
                gas = control.tf([gain], [1, -pole])
                plant = control.sample_system(lag * gas, sample_s, method="zoh") * delay
                plants[key] = _LinearPlant(pressure_Pa, opening, ratio, plant, inversion)
    return list(plants.values())


def _margins(control: Any, loop: Any) -> tuple[float, float, float]:
    """(gain margin [dB], phase margin [deg], crossover [rad/s]), the worst of all crossings.

    A gain margin downwards (a loop that falls unstable when its gain drops) counts as much as one upwards.
    The polynomial method is asked for by name: python-control distrusts it for poles this close to z = 1
    and would fall back to interpolation, fifty times slower, though it is right to 0.1 dB and 0.1 deg for
    these short loops.
    """
    with warnings.catch_warnings():
        # The integrators' z = 1 may be taken for a crossing: an infinite gain there, hence a margin of 0,
        # left out.
        warnings.simplefilter("ignore", RuntimeWarning)
        gain, phase, _distance, _phase_crossing, gain_crossing, _w = control.stability_margins(
            loop, returnall=True, method="poly"
        )
    gain_margin = min((abs(20 * math.log10(g)) for g in gain if g > 0), default=math.inf)
    phases = [(abs(float(p)), float(w)) for p, w in zip(phase, gain_crossing, strict=True)]
    phase_margin, crossover = min(phases, default=(math.inf, 0.0))
    return gain_margin, phase_margin, crossover


def _bandwidth_rad_s(closed: Any) -> float:
    """First frequency at which the closed loop has fallen 3 dB below its gain at rest, on a grid of 1.2 %.

    python-control 0.10's own `bandwidth` evaluates a discrete system as if it were continuous.
    """
    omega = np.geomspace(1e-3, 1.0, 600) * math.pi / closed.dt
    magnitude = np.abs(closed(np.exp(1j * omega * closed.dt)))
    below = np.nonzero(magnitude < math.sqrt(0.5) * abs(closed.dcgain()))[0]
    return float(omega[below[0]]) if below.size else math.inf


def _operating_point(control: Any, gains: PressureLoopGains, linear: _LinearPlant) -> OperatingPoint:
    proportional, sample = gains.proportional_1_s, gains.sample_s
    if gains.integral_1_s2 > 0:
        law = control.tf([proportional + gains.integral_1_s2 * sample, -proportional], [1, -1], sample)
    else:
        law = control.tf([proportional], [1], sample)
    loop = (law + linear.inversion_1_s) * linear.plant
    closed = control.feedback(loop)
    gain_margin, phase_margin, crossover = _margins(control, loop)
    return OperatingPoint(
        pressure_Pa=linear.pressure_Pa,
        opening=linear.opening,
        volume_ratio=linear.volume_ratio,
        gain_margin_dB=gain_margin,
        phase_margin_deg=phase_margin,
        crossover_rad_s=crossover,
        bandwidth_rad_s=_bandwidth_rad_s(closed),
        stable=bool(np.all(np.abs(closed.poles()) < 1)),
    )


def analyse_pressure_loop(
    parameters: PneumaticsParameters,
    chamber_volume_m3: ArrayLike,
    gains: PressureLoopGains,
    pressures_Pa: tuple[float, ...] | None = None,
    openings: tuple[float, ...] = OPERATING_OPENINGS,
    volume_ratios: tuple[float, ...] = OPERATING_VOLUME_RATIOS,
) -> PressureLoopDesign:
    """Margins of given gains at every combination of pressure, opening and volume ratio; with python-control.

    Discrete loop, broken at the valve: zero-order hold, valve lag, the linearised gas and one sample of
    computation delay. `pressures_Pa` default to 5, 35, 70 and 98 % of the chamber's limit. A chamber that
    grows with its pressure behaves like one of the volume V + p_absolute dV/dp: that is why the volume
    ratio reaches above one. `chamber_volume_m3`: one number or four; each distinct chamber is analysed.
    Raises InputError for an operating pressure outside the supply's span.
    """
    import control

    plants = _linear_plants(
        control, parameters, chamber_volume_m3, gains.sample_s, pressures_Pa, openings, volume_ratios
    )
    return PressureLoopDesign(gains, tuple(_operating_point(control, gains, linear) for linear in plants))


def design_pressure_loop(
    parameters: PneumaticsParameters,
    chamber_volume_m3: ArrayLike,
    sample_s: float,
    phase_margin_deg: float = 55.0,
    gain_margin_dB: float = 8.0,
    integral_ratio: float = 0.05,
    **limits: float,
) -> PressureLoopDesign:
    """The fastest PI law whose worst operating point keeps the wanted margins.

    k_i = `integral_ratio` k_p^2 (0.25 would make the ideal closed loop critically damped); k_p by bisection
    over the loops of `analyse_pressure_loop`. `limits` are further fields of `PressureLoopGains`.
    Raises InputError when a margin, the ratio or the sample time makes no sense, or when no gain keeps the
    margins.
    """
    import control

    if not (math.isfinite(sample_s) and sample_s > 0):
        raise InputError(f"sample_s = {sample_s!r}: must be finite and above zero")
    if not (0 < phase_margin_deg < 90 and 0 < gain_margin_dB < 60):
        raise InputError(
            f"phase_margin_deg = {phase_margin_deg!r}, gain_margin_dB = {gain_margin_dB!r}: "
            "must be within 0...90 deg and 0...60 dB"
        )
    if not 0 <= integral_ratio <= 0.25:
        raise InputError(f"integral_ratio = {integral_ratio!r}: must be from 0 to 0.25")

    plants = _linear_plants(
        control, parameters, chamber_volume_m3, sample_s, None, OPERATING_OPENINGS, OPERATING_VOLUME_RATIOS
    )
    delays_s = parameters.valve_lag_s + 1.5 * sample_s
    model_lag_s = parameters.valve_lag_s + 2.0 * sample_s

    def gains_of(proportional: float) -> PressureLoopGains:
        return PressureLoopGains(
            proportional,
            integral_ratio * proportional**2,
            sample_s,
            **{"model_lag_s": model_lag_s, **limits},
        )

    def keeps(point: OperatingPoint) -> bool:
        return point.stable and point.phase_margin_deg >= phase_margin_deg and point.gain_margin_dB >= gain_margin_dB

    def all_keep(proportional: float, tried: list[_LinearPlant]) -> bool:
        return all(keeps(_operating_point(control, gains_of(proportional), linear)) for linear in tried)

    # From gains that the delays cannot bear downwards, to the first that keeps the margins: these are
    # bounded below too, since a slow loop does not hold against the inversion of a flow that is itself
    # steep in the pressure. Few plants decide: search with those that have failed so far, then ask them
    # all.
    low, slowest, factor = 2.0 / delays_s, 0.02 / delays_s, 1.25
    deciding = plants[:1]
    while True:
        high = low
        while not all_keep(low, deciding):
            high, low = low, low / factor
            if low < slowest:
                raise InputError(
                    f"no pressure loop keeps {phase_margin_deg:g} deg and {gain_margin_dB:g} dB "
                    f"at every operating point with sample_s = {sample_s!r}: "
                    "ask for smaller margins, or sample faster"
                )
        while high / low > 1.01:
            middle = math.sqrt(low * high)
            if all_keep(middle, deciding):
                low = middle
            else:
                high = middle
        points = [_operating_point(control, gains_of(low), linear) for linear in plants]
        failing = [(point, linear) for point, linear in zip(points, plants, strict=True) if not keeps(point)]
        if not failing:
            return PressureLoopDesign(gains_of(low), tuple(points))
        deciding.append(min(failing, key=lambda pair: pair[0].phase_margin_deg)[1])
