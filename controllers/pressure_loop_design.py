"""The gains of the pressure loop (`controllers.pressure_loop`), and the margins that they have.

`design_pressure_loop` picks k_p and k_i with python-control so that the worst of many operating points
keeps the wanted margins. Its plant is the linearised law, not the ideal integrator: an inversion that is
late (lag, delay) or of the wrong volume cancels badly, and that is in the margins. It leaves out sensor
dynamics and the sag of the manifold, which is measured and so compensated.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.pressure_loop import (
    DEFAULT_SETPOINT_RATE_Pa_s,
    PressureLoopGains,
    flow_to_invert,
    nominal_volume,
)
from softbot.errors import InputError
from softbot.faults import CHAMBER_COUNT
from softbot.pneumatics import PneumaticsParameters, valve_mass_flow

OPERATING_OPENINGS = (-0.5, 0.0, 0.5)
"""Valve openings of the operating points: venting, holding, filling. Fully open the loop is saturated, not
linear."""
OPERATING_VOLUME_RATIOS = (0.8, 1.0, 1.6)
"""Actual over nominal volume of the operating points."""

_SLOWER = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
"""By how much the setpoint's rate is cut, in turn, where valves are too slow or too large for their chambers. The
first design asks nothing of the rate: valves may stand at any of the operating openings."""


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
            f"sample {self.gains.sample_s * 1e3:g} ms, setpoint at most {self.gains.setpoint_rate_Pa_s / 1e3:g} kPa/s",
            "pressure [kPa]  opening  volume  gain margin [dB]  phase margin [deg]  crossover [rad/s]",
        ]
        lines += [
            f"{point.pressure_Pa / 1e3:14.1f}  {point.opening:+7.2f}  {point.volume_ratio:6.2f}  "
            f"{point.gain_margin_dB:16.1f}  {point.phase_margin_deg:18.1f}  {point.crossover_rad_s:17.1f}"
            + ("  worst" if point is self.worst else "")
            for point in self.points
        ]
        return "\n".join(lines)


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
    rate_Pa_s: float,
) -> tuple[float, float, float, float]:
    """(opening, plant pole [1/s], loop gain ratio, feedback of the inversion [1/s]) at an operating point.

    The valve stands at `opening`, or where it moves the pressure by `rate_Pa_s`, if that is less far open.

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
                flow_to_invert(conductance, b, *ends, temperature),
            ]
        )

    p = pressure_Pa + atmosphere
    half_step_Pa = 1.0
    flow, inverted = both(p)
    slope, inverted_slope = (both(p + half_step_Pa) - both(p - half_step_Pa)) / (2 * half_step_Pa)
    if math.isfinite(rate_Pa_s):
        enough = rate_Pa_s * volume_ratio * volume_m3 / (gas * flow)
        opening = min(max(opening, -enough), enough)
    pole = gas / (volume_ratio * volume_m3) * opening * slope
    return (
        float(opening),
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
    rate_Pa_s: float = math.inf,
) -> list[_LinearPlant]:
    """The plants of all combinations and all chambers that differ: zero-order hold, one sample of delay.

    Valves stand no further open than `rate_Pa_s` takes them.
    """
    volume = nominal_volume(parameters, chamber_volume_m3)
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
            at, pole, gain, inversion = _linearise(
                parameters, chamber, float(volume[chamber]), ratio, pressure_Pa, opening, filling, rate_Pa_s
            )
            key = (pressure_Pa, at, ratio, pole, gain, inversion)
            if key not in plants:
                gas = control.tf([gain], [1, -pole])
                plant = control.sample_system(lag * gas, sample_s, method="zoh") * delay
                plants[key] = _LinearPlant(pressure_Pa, at, ratio, plant, inversion)
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

    Where no gain keeps them with valves half open, the setpoint's rate is halved until one does with valves no
    further open than that rate takes them: slow valves, or large ones on small chambers, are moved slowly. Further
    open, as a large leak holds them, such a loop is stable, with smaller margins than it says
    (`analyse_pressure_loop` tells them).

    k_i = `integral_ratio` k_p^2 (0.25 would make the ideal closed loop critically damped); k_p by bisection over the
    loops of `analyse_pressure_loop`. `limits` are further fields of `PressureLoopGains`.
    Raises InputError when a margin, the ratio or the sample time makes no sense, or when no gain keeps the margins.
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

    delays_s = parameters.valve_lag_s + 1.5 * sample_s
    rate_Pa_s = limits.pop("setpoint_rate_Pa_s", DEFAULT_SETPOINT_RATE_Pa_s)
    limits.setdefault("model_lag_s", parameters.valve_lag_s + 2.0 * sample_s)

    def keeps(point: OperatingPoint) -> bool:
        return point.stable and point.phase_margin_deg >= phase_margin_deg and point.gain_margin_dB >= gain_margin_dB

    for slower in _SLOWER:
        gains = PressureLoopGains(1.0 / delays_s, 0.0, sample_s, setpoint_rate_Pa_s=rate_Pa_s / slower, **limits)
        plants = _linear_plants(
            control,
            parameters,
            chamber_volume_m3,
            sample_s,
            None,
            OPERATING_OPENINGS,
            OPERATING_VOLUME_RATIOS,
            math.inf if slower == 1.0 else gains.setpoint_rate_Pa_s,
        )
        design = _fastest_design(control, gains, integral_ratio, plants, keeps)
        if design is None:
            continue
        # valves that a leak or a step holds further open than the setpoint's rate does must not make it swing
        if slower == 1.0 or analyse_pressure_loop(parameters, chamber_volume_m3, design.gains).stable:
            return design
    raise InputError(
        f"no pressure loop keeps {phase_margin_deg:g} deg and {gain_margin_dB:g} dB at every operating point, however "
        f"slowly pressures are asked for: pneumatics.valve_lag_s = {parameters.valve_lag_s:g} with chambers of "
        f"{np.mean(nominal_volume(parameters, chamber_volume_m3)) * 1e6:.3g} ml needs quicker valves, or smaller ones "
        "(pneumatics.supply_valve_conductance_m3_s_Pa, pneumatics.exhaust_valve_conductance_m3_s_Pa)"
    )


def _fastest_design(
    control: Any,
    gains: PressureLoopGains,
    integral_ratio: float,
    plants: list[_LinearPlant],
    keeps: Callable[[OperatingPoint], bool],
) -> PressureLoopDesign | None:
    """The largest gains that keep the margins at all these points; None where there are none.

    gains: with the k_p [1/s] of the whole delay, from twice which the search goes down.
    """

    def gains_of(proportional: float) -> PressureLoopGains:
        return replace(gains, proportional_1_s=proportional, integral_1_s2=integral_ratio * proportional**2)

    def all_keep(proportional: float, tried: list[_LinearPlant]) -> bool:
        return all(keeps(_operating_point(control, gains_of(proportional), linear)) for linear in tried)

    # From gains that the delays cannot bear downwards, to the first that keeps the margins: these are
    # bounded below too, since a slow loop does not hold against the inversion of a flow that is itself
    # steep in the pressure. Few plants decide: search with those that have failed so far, then ask them
    # all.
    low, slowest, factor = 2.0 * gains.proportional_1_s, 0.02 * gains.proportional_1_s, 1.25
    deciding = plants[:1]
    while True:
        high = low
        while not all_keep(low, deciding):
            high, low = low, low / factor
            if low < slowest:
                return None
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
