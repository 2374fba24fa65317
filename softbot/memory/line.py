"""Line between the pressure sensor and the chamber: the gas has to flow through it, so the chamber lags behind.

    d(p_c V)/dt = R T ṁ(p_s, p_c),   V = V₀ (1 + c max(p_c − p_atm, 0))

with the flow of ISO 6358 (`softbot.pneumatics.valve_mass_flow`), of one conductance while the chamber fills and of
another while it vents: lines with a kink, a silencer or a soft end are not alike both ways. The chamber grows with its
pressure (c), which slows it the more the fuller it is. Only the ratios of the conductances to V₀ matter.

Backward Euler on the gas balance, a monotone scalar equation, solved by Newton's method safeguarded by bisection: the
chamber's pressure never leaves the span from where it was to the sensor's, whatever the step.

The line's own volume, its inertia and the travel of sound along it are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import pydantic

from softbot.errors import InputError
from softbot.kernel_compiler import kernel
from softbot.pneumatics import REFERENCE_TEMPERATURE_K, GAS_CONSTANT_AIR_J_kg_K, flow_and_slopes, flow_coefficient

_MAX_ITERATIONS = 100
_TOLERANCE = 1e-12
_LEAST_ABSOLUTE_Pa = 100.0
CONDUCTANCE_BOUNDS_m3_s_Pa = (1e-16, 1e-3)


@dataclass(frozen=True)
class Line:
    """Sonic conductances [m³/(s Pa)] while the chamber fills and vents, and the chamber's growth [1/Pa].

    `critical_ratio` is that of ISO 6358 (long lines: 0 … 0.3). Raises InputError unless the conductances are 1e-16 …
    1e-3, the growth 0 … 1e-3 and the critical ratio 0 … 0.9.
    """

    __pydantic_config__: ClassVar[pydantic.ConfigDict] = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)

    filling_conductance_m3_s_Pa: float
    venting_conductance_m3_s_Pa: float
    growth_1_Pa: float = 0.0
    critical_ratio: float = 0.2

    def __post_init__(self) -> None:
        low, high = CONDUCTANCE_BOUNDS_m3_s_Pa
        for name in ("filling_conductance_m3_s_Pa", "venting_conductance_m3_s_Pa"):
            if not low <= getattr(self, name) <= high:
                raise InputError(f"memory.line.{name} = {getattr(self, name)!r}: give {low:g} to {high:g} m3/(s Pa)")
        for name, most in (("growth_1_Pa", 1e-3), ("critical_ratio", 0.9)):
            if not 0.0 <= getattr(self, name) <= most:
                raise InputError(f"memory.line.{name} = {getattr(self, name)!r}: give 0 to {most:g}")

    def rates(self, volume_m3: float) -> tuple[float, float]:
        """R T/V₀ times the flow coefficients [1/s] of filling and venting a chamber of volume V₀ > 0 at rest."""
        per_flow = GAS_CONSTANT_AIR_J_kg_K * REFERENCE_TEMPERATURE_K / volume_m3
        filling, venting = (
            per_flow * flow_coefficient(conductance, REFERENCE_TEMPERATURE_K)
            for conductance in (self.filling_conductance_m3_s_Pa, self.venting_conductance_m3_s_Pa)
        )
        return filling, venting


@kernel()
def line_step(
    filling_1_s: float,
    venting_1_s: float,
    growth_1_Pa: float,
    critical_ratio: float,
    atmosphere_Pa: float,
    chamber_Pa: float,
    sensor_Pa: float,
    dt_s: float,
) -> float:
    """The chamber's gauge pressure at the end of a step, from `chamber_Pa` before and the sensor's at the end."""
    outside = max(sensor_Pa + atmosphere_Pa, _LEAST_ABSOLUTE_Pa)
    before = max(chamber_Pa + atmosphere_Pa, _LEAST_ABSOLUTE_Pa)
    rate = filling_1_s if outside > before else venting_1_s
    content = before * (1.0 + growth_1_Pa * max(before - atmosphere_Pa, 0.0))
    low, high = min(before, outside), max(before, outside)
    p = before
    last_move = high - low
    for _ in range(_MAX_ITERATIONS):
        flow, _up, slope = flow_and_slopes(rate, critical_ratio, outside, p)
        above = max(p - atmosphere_Pa, 0.0)
        residual = p * (1.0 + growth_1_Pa * above) - content - dt_s * flow
        stiffness = 1.0 + growth_1_Pa * above + (growth_1_Pa * p if above > 0.0 else 0.0) - dt_s * slope
        if residual > 0.0:
            high = p
        else:
            low = p
        new = p - residual / stiffness
        if abs(new - p) <= _TOLERANCE * p or high - low <= _TOLERANCE * p:
            break
        if not low < new < high or 2.0 * abs(new - p) > last_move:
            new = 0.5 * (low + high)
        last_move = abs(new - p)
        p = new
    return p - atmosphere_Pa
