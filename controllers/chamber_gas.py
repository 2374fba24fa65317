"""The gas of one chamber as its watcher models it: from valve opening, supply pressure and volume to the next pressure.

    dP/dt = (RT/V) (a F_s(P) − b F_e(P) − l F_h(P)) − P V̇/V         (P absolute)

F_s and F_e are the ISO 6358 flows of the supply and the exhaust path at the valve's lagged opening, F_h that of a hole
as large as the open supply valve; a and b are the conductances of this chamber's paths over the nominal ones, l that of
its hole. One linearly implicit step a control period: stable however large the hole.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softbot.kernel_compiler import kernel, part
from softbot.pneumatics import PneumaticsParameters, flow_and_slopes, flow_coefficient

FloatArray = NDArray[np.float64]


class Gas(NamedTuple):
    """Constants of the gas and the valves, nominal."""

    critical_ratio: float
    atmosphere_Pa: float
    specific_J_kg: float
    """Gas constant times temperature."""
    lag_s: float
    supply: FloatArray
    """Flow coefficients of the open supply valves, shape (4,)."""
    exhaust: FloatArray
    dead_volume_m3: FloatArray
    regulated_Pa: float
    """Gauge pressure of the supply when nothing is wrong."""
    regulator: float
    """Flow coefficient of the supply's regulator."""
    manifold_m3: float


def gas_of(parameters: PneumaticsParameters) -> Gas:
    """The constants of a robot's pneumatics."""
    supply, exhaust = (
        np.array([flow_coefficient(one, parameters.temperature_K) for one in four])
        for four in (parameters.supply_valve_conductance_m3_s_Pa, parameters.exhaust_valve_conductance_m3_s_Pa)
    )
    return Gas(
        parameters.critical_ratio,
        parameters.atmospheric_pressure_absolute_Pa,
        parameters.gas_constant_times_temperature_J_kg,
        parameters.valve_lag_s,
        supply,
        exhaust,
        np.array(parameters.dead_volume_m3),
        parameters.supply_pressure_Pa,
        flow_coefficient(parameters.regulator_conductance_m3_s_Pa, parameters.temperature_K),
        parameters.manifold_volume_m3,
    )


@part()
def lagged_opening(lag_s: float, step_s: float, before: float, commanded: float) -> tuple[float, float]:
    """Opening of a valve with a first-order lag after a step, and its mean over the step."""
    if lag_s <= 0.0:
        return commanded, commanded
    kept = math.exp(-step_s / lag_s)
    return commanded + (before - commanded) * kept, commanded + (before - commanded) * (lag_s / step_s) * (1.0 - kept)


@kernel(cache=False)
def next_pressure(
    gas: Gas,
    chamber: int,
    pressure: float,
    supply: float,
    opening: float,
    volume_m3: float,
    swelling: float,
    inlet: float,
    outlet: float,
    hole: float,
    step_s: float,
) -> tuple[float, float, float, float, float, float]:
    """The absolute pressure one step later, and how it depends on what it was made of.

    pressure, supply: absolute; opening: mean over the step; volume_m3: at its end, dead volume included; swelling: its
    relative growth over the step; inlet, outlet, hole: a, b, l. Returns the pressure and its slopes with the pressure
    before, a, b and l, and the pressure that flowed in or out [Pa].
    """
    own, b, out = gas.supply[chamber], gas.critical_ratio, gas.atmosphere_Pa
    per_flow = gas.specific_J_kg / volume_m3
    rate = slope = by_inlet = by_outlet = by_hole = 0.0
    if opening > 0.0:
        flow, _unused, along = flow_and_slopes(opening * own, b, supply, pressure)
        by_inlet = per_flow * flow
        rate += inlet * by_inlet
        slope += inlet * per_flow * along
    elif opening < 0.0:
        flow, along, _unused = flow_and_slopes(-opening * gas.exhaust[chamber], b, pressure, out)
        by_outlet = -per_flow * flow
        rate += outlet * by_outlet
        slope -= outlet * per_flow * along
    flow, along, _unused = flow_and_slopes(own, b, pressure, out)
    by_hole = -per_flow * flow
    rate += hole * by_hole
    slope -= hole * per_flow * along
    share = step_s / (1.0 - step_s * min(slope, 0.0))
    flowed = share * rate
    squeezed = pressure / (1.0 + swelling)
    # what flows cannot overshoot the pressures it flows between
    after = squeezed + flowed
    if flowed > 0.0:
        after = min(after, max(supply, squeezed))
    else:
        after = max(after, min(out, squeezed))
    kept = max(1.0 + share * slope, 0.0) / (1.0 + swelling)
    return after, kept, share * by_inlet, share * by_outlet, share * by_hole, flowed
