"""Supply, valves and the gas in four chambers.

A pressure regulator feeds a manifold; from it each chamber has one three-way proportional valve: a positive
opening joins the chamber to the manifold, a negative one to the atmosphere. Gas is ideal and isothermal at
`temperature_K`.

- Flow through every restriction: ISO 6358 (sonic conductance C, critical pressure ratio b, reference state
  100 kPa, 293.15 K, 1.185 kg/m3), choked and subsonic, made linear near equal pressures
  (`valve_mass_flow`).
- Valve: opening follows its command with a first-order lag, taken exactly over the step.
- Gas balance of a volume that moves: d(pV)/dt = R T x (net mass flow), for the four chambers and the
  manifold.

The five balances are taken by backward Euler with the volumes at the end of the step, so any step is
stable. For a given manifold pressure each chamber is one monotone scalar equation, and what they draw makes
the manifold one more: two nested Newton iterations safeguarded by bisection find the solution always. A
maximum principle holds at every step length: no pressure leaves the span of the pressures (of supply,
atmosphere and trapped gas) it is joined to.

Gauge pressure unless the name says `absolute`. Leaves out: heat exchange, the inertia of the gas in the
lines, the hysteresis of valves. `max_chamber_pressure_Pa` is a limit that controllers and valve boards
keep; the gas does not know it. The regulator does not relieve: nothing flows back through it.

This is a simulation module: it imports numba.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softbot.errors import InputError, SimulationError
from softbot.faults import (
    CHAMBER_COUNT,
    EXHAUST_FACTOR,
    FORCED_OPENING,
    INLET_FACTOR,
    LAG_FACTOR,
    LEAK_RATIO,
    SUPPLY_FACTOR,
    SUPPLY_PRESSURE_FACTOR,
    VOLUME_FACTOR,
    PneumaticConditions,
    WIDENING_1_Pa,
)
from softbot.kernel_compiler import kernel

GAS_CONSTANT_AIR_J_kg_K = 287.05
REFERENCE_DENSITY_kg_m3 = 1.185  # ISO 6358-1: air at 100 kPa, 293.15 K, 65 % relative humidity
REFERENCE_TEMPERATURE_K = 293.15
LAMINAR_PRESSURE_RATIO = 0.999
"""Above this ratio of downstream to upstream pressure the flow is linear in the pressure difference."""

# Places in the state, float64[9]: opening and gas mass of the four chambers, gas mass of the manifold.
OPENING = 0
GAS_MASS = 4
MANIFOLD_MASS = 8
STATE_SIZE = 9
# Places in the pressures, float64[5]: the four chambers, then the manifold (what a supply sensor reads).
MANIFOLD_PRESSURE = 4
PRESSURES_SIZE = 5

# Places in the packed parameters, float64[20].
_SUPPLY_ABSOLUTE = 0
_REGULATOR_CONDUCTANCE = 1
_MANIFOLD_VOLUME = 2
_CRITICAL_RATIO = 3
_VALVE_LAG = 4
_TEMPERATURE = 5
_ATMOSPHERE = 6
_MAX_PRESSURE = 7
_SUPPLY_CONDUCTANCE = 8
_EXHAUST_CONDUCTANCE = 12
_DEAD_VOLUME = 16
PARAMETERS_SIZE = 20

_MAX_ITERATIONS = 200  # a bracket of doubles is used up by bisection alone long before
_PRESSURE_TOLERANCE = 1e-13  # relative; Newton converges quadratically, so the error left is rounding


@dataclass(frozen=True, slots=True)
class PneumaticsParameters:
    """Everything the pneumatics are made of; conductances are sonic conductances of ISO 6358 [m3/(s Pa)].

    1 dm3/(s bar) = 1e-8 m3/(s Pa). Tuples hold one number for each chamber. The defaults are small
    proportional valves (0.09 dm3/(s bar)) that bring a chamber of 54 ml from 0 to 63 kPa in about 0.12 s
    and vent it from 100 kPa to 37 kPa in about 0.2 s, valve lag included.
    Raises InputError naming the field whose value is out of range.
    """

    __pydantic_config__: ClassVar[dict[str, object]] = {"extra": "forbid"}  # as a table of a file

    supply_pressure_Pa: float = 250e3
    regulator_conductance_m3_s_Pa: float = 1e-8
    manifold_volume_m3: float = 100e-6
    supply_valve_conductance_m3_s_Pa: tuple[float, float, float, float] = (9e-10,) * 4
    exhaust_valve_conductance_m3_s_Pa: tuple[float, float, float, float] = (1.3e-9,) * 4
    critical_ratio: float = 0.3
    valve_lag_s: float = 0.010
    dead_volume_m3: tuple[float, float, float, float] = (2e-6,) * 4
    temperature_K: float = 293.15
    atmospheric_pressure_absolute_Pa: float = 101325.0
    max_chamber_pressure_Pa: float = 150e3

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name.endswith(("valve_conductance_m3_s_Pa", "dead_volume_m3")):
                try:
                    numbers = tuple(float(number) for number in value)
                except (TypeError, ValueError):
                    numbers = ()
                if len(numbers) != CHAMBER_COUNT:
                    raise InputError(f"pneumatics.{item.name} = {value!r}: must be four numbers, one a chamber")
                object.__setattr__(self, item.name, numbers)
            else:
                try:
                    numbers = (float(value),)
                except (TypeError, ValueError):
                    raise InputError(f"pneumatics.{item.name} = {value!r}: must be a number") from None
                object.__setattr__(self, item.name, numbers[0])
            may_be_zero = item.name in ("dead_volume_m3", "valve_lag_s", "critical_ratio")
            for number in numbers:
                if not (math.isfinite(number) and (number > 0 or (may_be_zero and number == 0))):
                    least = "zero or more" if may_be_zero else "above zero"
                    raise InputError(f"pneumatics.{item.name} = {value!r}: must be finite and {least}")
        if self.critical_ratio > 0.9:
            raise InputError(
                f"pneumatics.critical_ratio = {self.critical_ratio!r}: must be at most 0.9 (valves have 0.2 to 0.5)"
            )
        if self.max_chamber_pressure_Pa > self.supply_pressure_Pa:
            raise InputError(
                f"pneumatics.max_chamber_pressure_Pa = {self.max_chamber_pressure_Pa!r}: must not be above "
                f"pneumatics.supply_pressure_Pa = {self.supply_pressure_Pa!r}"
            )

    @property
    def gas_constant_times_temperature_J_kg(self) -> float:
        """R T, so that p V = m R T."""
        return GAS_CONSTANT_AIR_J_kg_K * self.temperature_K

    @property
    def supply_pressure_absolute_Pa(self) -> float:
        """The pressure the regulator holds, absolute."""
        return self.supply_pressure_Pa + self.atmospheric_pressure_absolute_Pa

    def as_arrays(self) -> NDArray[np.float64]:
        """The parameters packed for the kernels: float64[20], laid out as the constants of this module
        say."""
        return np.array(
            [
                self.supply_pressure_absolute_Pa,
                self.regulator_conductance_m3_s_Pa,
                self.manifold_volume_m3,
                self.critical_ratio,
                self.valve_lag_s,
                self.temperature_K,
                self.atmospheric_pressure_absolute_Pa,
                self.max_chamber_pressure_Pa,
                *self.supply_valve_conductance_m3_s_Pa,
                *self.exhaust_valve_conductance_m3_s_Pa,
                *self.dead_volume_m3,
            ]
        )


@kernel()
def flow_and_slopes(
    coefficient: float, critical_ratio: float, first_absolute_Pa: float, second_absolute_Pa: float
) -> tuple[float, float, float]:
    """Mass flow from the first to the second side [kg/s], and its slopes with the two pressures [kg/(s Pa)].

    `coefficient` = C rho0 sqrt(T0/T). The first slope is never negative, the second never positive.
    """
    forwards = first_absolute_Pa >= second_absolute_Pa
    if forwards:
        upstream, downstream = first_absolute_Pa, second_absolute_Pa
    else:
        upstream, downstream = second_absolute_Pa, first_absolute_Pa
    b = critical_ratio
    ratio = downstream / upstream if upstream > 0.0 else 1.0
    if ratio <= b:  # choked
        flow, slope_up, slope_down = coefficient * upstream, coefficient, 0.0
    elif ratio < LAMINAR_PRESSURE_RATIO:  # subsonic
        x = (ratio - b) / (1.0 - b)
        factor = math.sqrt(1.0 - x * x)
        factor_slope = -x / (factor * (1.0 - b))
        flow = coefficient * upstream * factor
        slope_up = coefficient * (factor - ratio * factor_slope)
        slope_down = coefficient * factor_slope
    else:  # linear, joined to the subsonic branch
        x = (LAMINAR_PRESSURE_RATIO - b) / (1.0 - b)
        slope_up = coefficient * math.sqrt(1.0 - x * x) / (1.0 - LAMINAR_PRESSURE_RATIO)
        flow, slope_down = slope_up * (upstream - downstream), -slope_up
    if forwards:
        return flow, slope_up, slope_down
    return -flow, -slope_down, -slope_up


@kernel()
def flow_coefficient(conductance_m3_s_Pa: float, temperature_K: float) -> float:
    """Mass flow per upstream absolute pressure through a choked valve [kg/(s Pa)], ISO 6358."""
    return conductance_m3_s_Pa * REFERENCE_DENSITY_kg_m3 * math.sqrt(REFERENCE_TEMPERATURE_K / temperature_K)


@kernel()
def valve_mass_flow(
    conductance_m3_s_Pa: float,
    critical_ratio: float,
    upstream_absolute_Pa: float,
    downstream_absolute_Pa: float,
    temperature_K: float,
) -> float:
    """Mass flow through a restriction [kg/s], ISO 6358-1; a numba kernel over scalars.

    With p1 the higher pressure and r = p2/p1:

        r <= b          C rho0 p1 sqrt(T0/T)                                  choked
        b < r < 0.999   C rho0 p1 sqrt(T0/T) sqrt(1 - ((r - b)/(1 - b))^2)    subsonic
        r >= 0.999      linear in p1 - p2, joined continuously                a finite slope at equal pressures

    Odd under exchange of the two sides: negative when the pressure called downstream is the higher one.
    Pressures absolute [Pa], T of the gas upstream [K].
    """
    return flow_and_slopes(
        flow_coefficient(conductance_m3_s_Pa, temperature_K),
        critical_ratio,
        upstream_absolute_Pa,
        downstream_absolute_Pa,
    )[0]


@kernel()
def _held_gas(capacity: float, widening: float, p: float, atmosphere: float) -> tuple[float, float]:
    """Gas that a chamber holds at an absolute pressure [kg], and its slope with it. See `_solve_chamber`."""
    over = p - atmosphere
    if widening > 0.0 and over > 0.0:
        return (capacity + widening * over) * p, capacity + widening * (over + p)
    return capacity * p, capacity


@kernel()
def _trapped_pressure(held: float, capacity: float, widening: float, atmosphere: float) -> float:
    """The absolute pressure at which a chamber holds so much gas: `_held_gas` inverted."""
    p = held / capacity
    if widening > 0.0 and p > atmosphere:
        # widening p² + (capacity - widening atmosphere) p = held, in the form that does not cancel
        linear = capacity - widening * atmosphere
        root = math.sqrt(linear * linear + 4.0 * widening * held)
        return 2.0 * held / (linear + root) if linear > 0.0 else (root - linear) / (2.0 * widening)
    return p


@kernel()
def _solve_chamber(
    trapped: float,
    capacity: float,
    guess: float,
    manifold: float,
    atmosphere: float,
    inlet: float,
    outlet: float,
    b: float,
    dt_s: float,
    widening: float,
) -> tuple[float, float, float, int]:
    """One chamber's pressure at the end of the step for a given manifold pressure (all absolute).

    Solves m(p) - m(trapped) = dt [F_in(manifold, p) - F_out(p, atmosphere)], which rises strictly with p.
    m(p) = (capacity + widening max(p - atmosphere, 0)) p is the gas that the chamber holds at p, `trapped` the
    pressure if nothing flowed, `capacity` = V/(R T) while it has not widened; `inlet` and `outlet` are flow
    coefficients. Returns p, the flow in, the slope of that flow with the manifold pressure, and 0 if converged.
    """
    held, _unused = _held_gas(capacity, widening, trapped, atmosphere)
    low = high = trapped
    if inlet > 0.0:
        low, high = min(low, manifold), max(high, manifold)
    if outlet > 0.0:
        low, high = min(low, atmosphere), max(high, atmosphere)
    p = min(max(guess, low), high)
    status = 1
    flow_in = slope = 0.0
    last_move = high - low
    for _ in range(_MAX_ITERATIONS):
        flow_in, in_m, in_p = flow_and_slopes(inlet, b, manifold, p)
        flow_out, out_p, _unused = flow_and_slopes(outlet, b, p, atmosphere)
        holds, room = _held_gas(capacity, widening, p, atmosphere)
        residual = holds - held - dt_s * (flow_in - flow_out)
        stiffness = room + dt_s * (out_p - in_p)
        # dp/d(manifold) = dt in_m / stiffness, hence the total slope of the flow in:
        slope = in_m * (room + dt_s * out_p) / stiffness
        if residual > 0.0:
            high = p
        else:
            low = p
        new = p - residual / stiffness
        if abs(new - p) <= _PRESSURE_TOLERANCE * p or high - low <= _PRESSURE_TOLERANCE * p:
            status = 0
            break
        # Newton's method runs round in circles about equal pressures, where the flow looks like a square
        # root: bisect unless it stays in the bracket and more than halves its move.
        if not low < new < high or 2.0 * abs(new - p) > last_move:
            new = 0.5 * (low + high)
        last_move = abs(new - p)
        p = new
    return p, flow_in, slope, status


@kernel()
def step_in_place(
    state: NDArray[np.float64],
    pressure_Pa: NDArray[np.float64],
    command_opening: NDArray[np.float64],
    main_supply_open: bool,
    chamber_volume_m3: NDArray[np.float64],
    dt_s: float,
    conditions: NDArray[np.float64],
    parameters: NDArray[np.float64],
) -> int:
    """One step of the pneumatics over plain arrays; the kernel behind `step`, for hot loops.

    Writes `state` (float64[9]) and `pressure_Pa` (float64[5], gauge: four chambers, manifold). `conditions`
    is `PneumaticConditions.packed`, `parameters` is `PneumaticsParameters.as_arrays()`. Allocates nothing,
    checks only what a running simulation can spoil. Returns 0, or 1 when a number is not finite, a volume
    or a mass is not positive or the solution was not found; the arrays then mean nothing.
    """
    b = parameters[_CRITICAL_RATIO]
    temperature = parameters[_TEMPERATURE]
    atmosphere = parameters[_ATMOSPHERE]
    gas = GAS_CONSTANT_AIR_J_kg_K * temperature
    lag = parameters[_VALVE_LAG]
    follow = 1.0 - math.exp(-dt_s / lag) if lag > 0.0 else 1.0

    source = atmosphere + (parameters[_SUPPLY_ABSOLUTE] - atmosphere) * conditions[SUPPLY_PRESSURE_FACTOR]
    feed = 0.0
    if main_supply_open:
        feed = flow_coefficient(parameters[_REGULATOR_CONDUCTANCE] * conditions[SUPPLY_FACTOR], temperature)
    manifold_capacity = parameters[_MANIFOLD_VOLUME] / gas
    manifold_trapped = state[MANIFOLD_MASS] / manifold_capacity
    if not (manifold_trapped > 0.0 and math.isfinite(manifold_trapped) and dt_s > 0.0 and math.isfinite(dt_s)):
        return 1

    # The bracket of the manifold pressure: all that it is joined to, directly or through a chamber.
    low = high = manifold_trapped
    if feed > 0.0:
        low, high = min(low, source), max(high, source)
    for i in range(CHAMBER_COUNT):
        forced = conditions[FORCED_OPENING + i]
        if math.isnan(forced):
            wanted = min(max(command_opening[i], -1.0), 1.0)
            slow = conditions[LAG_FACTOR + i]
            share = follow if slow == 1.0 or lag <= 0.0 else 1.0 - math.exp(-dt_s / (lag * slow))
            opening = state[OPENING + i] + share * (wanted - state[OPENING + i])
        else:
            opening = forced
        state[OPENING + i] = opening
        soft = chamber_volume_m3[i] * conditions[VOLUME_FACTOR + i]
        volume, widening = soft + parameters[_DEAD_VOLUME + i], soft * conditions[WIDENING_1_Pa + i]
        trapped = math.nan
        if volume > 0.0:
            trapped = _trapped_pressure(state[GAS_MASS + i], volume / gas, widening / gas, atmosphere)
        if not (trapped > 0.0 and math.isfinite(trapped) and math.isfinite(opening)):
            return 1
        pressure_Pa[i] = trapped  # also the first guess; absolute until the end of this function
        if opening > 0.0:
            low, high = min(low, trapped), max(high, trapped)
            if conditions[LEAK_RATIO + i] > 0.0:
                low, high = min(low, atmosphere), max(high, atmosphere)

    manifold = manifold_trapped
    last_move = high - low
    status = 1
    for _ in range(_MAX_ITERATIONS):
        flow_feed, _unused, feed_slope = flow_and_slopes(feed, b, source, manifold)
        if flow_feed < 0.0:  # the regulator does not relieve
            flow_feed = feed_slope = 0.0
        drawn = drawn_slope = 0.0
        for i in range(CHAMBER_COUNT):
            opening = state[OPENING + i]
            supply = parameters[_SUPPLY_CONDUCTANCE + i]
            inlet = outlet = 0.0
            if opening > 0.0:
                inlet = flow_coefficient(opening * supply * conditions[INLET_FACTOR + i], temperature)
            else:
                outlet = -opening * parameters[_EXHAUST_CONDUCTANCE + i] * conditions[EXHAUST_FACTOR + i]
            outlet = flow_coefficient(outlet + supply * conditions[LEAK_RATIO + i], temperature)
            soft = chamber_volume_m3[i] * conditions[VOLUME_FACTOR + i]
            capacity = (soft + parameters[_DEAD_VOLUME + i]) / gas
            widening = soft * conditions[WIDENING_1_Pa + i] / gas
            p, flow_in, slope, failed = _solve_chamber(
                _trapped_pressure(state[GAS_MASS + i], capacity, widening, atmosphere),
                capacity,
                pressure_Pa[i],
                manifold,
                atmosphere,
                inlet,
                outlet,
                b,
                dt_s,
                widening,
            )
            if failed:
                return 1
            pressure_Pa[i] = p
            drawn += flow_in
            drawn_slope += slope
        residual = manifold_capacity * (manifold - manifold_trapped) - dt_s * (flow_feed - drawn)
        stiffness = manifold_capacity + dt_s * (drawn_slope - feed_slope)
        if residual > 0.0:
            high = manifold
        else:
            low = manifold
        new = manifold - residual / stiffness
        if abs(new - manifold) <= _PRESSURE_TOLERANCE * manifold or high - low <= _PRESSURE_TOLERANCE * manifold:
            status = 0
            break
        if not low < new < high or 2.0 * abs(new - manifold) > last_move:  # as for a chamber
            new = 0.5 * (low + high)
        last_move = abs(new - manifold)
        manifold = new

    # Masses follow from the pressures and not from the flows: with a tiny volume and a long step the flows
    # cancel to many digits, the pressures do not.
    state[MANIFOLD_MASS] = manifold_capacity * manifold
    pressure_Pa[MANIFOLD_PRESSURE] = manifold - atmosphere
    for i in range(CHAMBER_COUNT):
        soft = chamber_volume_m3[i] * conditions[VOLUME_FACTOR + i]
        capacity, widening = (soft + parameters[_DEAD_VOLUME + i]) / gas, soft * conditions[WIDENING_1_Pa + i] / gas
        state[GAS_MASS + i], _unused = _held_gas(capacity, widening, pressure_Pa[i], atmosphere)
        pressure_Pa[i] -= atmosphere
    return status


def _four(name: str, value: ArrayLike) -> NDArray[np.float64]:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (CHAMBER_COUNT,) or not np.all(np.isfinite(array)):
        raise InputError(f"{name} = {value!r}: must be four finite numbers, one a chamber")
    return array


def initial_state(
    parameters: PneumaticsParameters,
    chamber_volume_m3: ArrayLike,
    chamber_pressure_Pa: ArrayLike = (0.0, 0.0, 0.0, 0.0),
    manifold_pressure_Pa: float | None = None,
) -> NDArray[np.float64]:
    """The state float64[9] of a plant at rest with its valves shut.

    `chamber_volume_m3` [4] without the dead volume, `chamber_pressure_Pa` [4] gauge, manifold at the
    regulator's pressure unless told otherwise. Raises InputError for a volume or an absolute pressure that
    is not positive.
    """
    volume = _four("chamber_volume_m3", chamber_volume_m3) + np.array(parameters.dead_volume_m3)
    absolute = _four("chamber_pressure_Pa", chamber_pressure_Pa) + parameters.atmospheric_pressure_absolute_Pa
    gauge = parameters.supply_pressure_Pa if manifold_pressure_Pa is None else manifold_pressure_Pa
    manifold = gauge + parameters.atmospheric_pressure_absolute_Pa
    if not np.all(volume > 0):
        raise InputError(f"chamber_volume_m3 = {chamber_volume_m3!r}: must be above zero with the dead volume")
    if not np.all(absolute > 0):
        raise InputError(f"chamber_pressure_Pa = {chamber_pressure_Pa!r}: must be above vacuum")
    if not (math.isfinite(manifold) and manifold > 0):
        raise InputError(f"manifold_pressure_Pa = {manifold_pressure_Pa!r}: must be finite and above vacuum")
    gas = parameters.gas_constant_times_temperature_J_kg
    state = np.zeros(STATE_SIZE)
    state[GAS_MASS : GAS_MASS + CHAMBER_COUNT] = absolute * volume / gas
    state[MANIFOLD_MASS] = manifold * parameters.manifold_volume_m3 / gas
    return state


def pressures(
    state: NDArray[np.float64], chamber_volume_m3: ArrayLike, parameters: PneumaticsParameters
) -> NDArray[np.float64]:
    """Gauge pressures float64[5] (four chambers, manifold) of a state, p = m R T / V - p_atm."""
    gas = parameters.gas_constant_times_temperature_J_kg
    volume = np.empty(PRESSURES_SIZE)
    volume[:CHAMBER_COUNT] = _four("chamber_volume_m3", chamber_volume_m3) + np.array(parameters.dead_volume_m3)
    volume[MANIFOLD_PRESSURE] = parameters.manifold_volume_m3
    return state[GAS_MASS:] * gas / volume - parameters.atmospheric_pressure_absolute_Pa


def step(
    state: NDArray[np.float64],
    command_opening: ArrayLike,
    main_supply_open: bool,
    chamber_volume_m3: ArrayLike,
    dt_s: float,
    conditions: PneumaticConditions,
    parameters: PneumaticsParameters,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """One step of `dt_s` [s]: the new state float64[9] and the gauge pressures float64[5] at its end.

    `command_opening` [4] in [-1, 1] (clipped): + joins the chamber to the manifold, - to the atmosphere.
    `chamber_volume_m3` [4] are the volumes at the end of the step, dead volume not counted. The arguments
    are left as they are. Any `dt_s` is stable. In a hot loop call `step_in_place`.
    Raises InputError for a wrong shape, a step that is not positive, a volume that is not; SimulationError
    when the state is not finite or the balance has no solution.
    """
    opening = _four("command_opening", command_opening)
    volume = _four("chamber_volume_m3", chamber_volume_m3)
    if not (math.isfinite(dt_s) and dt_s > 0):
        raise InputError(f"dt_s = {dt_s!r}: must be finite and above zero")
    if not np.all(volume + np.array(parameters.dead_volume_m3) > 0):
        raise InputError(f"chamber_volume_m3 = {chamber_volume_m3!r}: must be above zero with the dead volume")
    if state.shape != (STATE_SIZE,):
        raise InputError(f"state has shape {state.shape}: must be ({STATE_SIZE},), as initial_state makes it")
    new_state = np.array(state, dtype=np.float64)
    pressure_Pa = np.empty(PRESSURES_SIZE)
    failed = step_in_place(
        new_state,
        pressure_Pa,
        opening,
        bool(main_supply_open),
        volume,
        float(dt_s),
        conditions.packed,
        parameters.as_arrays(),
    )
    if failed:
        raise SimulationError(f"the pneumatics have no solution: state {state!r}, conditions {conditions!r}")
    return new_state, pressure_Pa
