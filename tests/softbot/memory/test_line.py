"""The line's flow: against an ODE solver, its asymmetry, its growing chamber, and stability at any step."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from softbot.errors import InputError
from softbot.memory.line import Line, line_step
from softbot.pneumatics import valve_mass_flow

ATMOSPHERE_Pa, VOLUME_m3 = 101325.0, 4e-5
LINE = Line(2e-10, 1e-10, growth_1_Pa=4e-6, critical_ratio=0.25)
pressures = st.floats(-5e4, 2e5)


def step(line: Line, chamber_Pa: float, sensor_Pa: float, dt_s: float) -> float:
    rates = line.rates(VOLUME_m3)
    return line_step(*rates, line.growth_1_Pa, line.critical_ratio, ATMOSPHERE_Pa, chamber_Pa, sensor_Pa, dt_s)


def run(line: Line, chamber_Pa: float, sensor_Pa: float, end_s: float, steps: int) -> float:
    for _ in range(steps):
        chamber_Pa = step(line, chamber_Pa, sensor_Pa, end_s / steps)
    return chamber_Pa


def reference(line: Line, chamber_Pa: float, sensor_Pa: float, end_s: float) -> float:
    """d(pV)/dt = R T ṁ at 293.15 K with the flow of `valve_mass_flow`, in the unknown p V."""
    gas = 287.05 * 293.15

    def pressure(content: float) -> float:  # of p V₀ (1 + c (p − p_atm)) = content, above the atmosphere
        b, c = 1.0 - line.growth_1_Pa * ATMOSPHERE_Pa, line.growth_1_Pa
        return (-b + math.sqrt(b * b + 4.0 * c * content / VOLUME_m3)) / (2.0 * c)

    def rate(_: float, content: list[float]) -> list[float]:
        p, source = pressure(content[0]), sensor_Pa + ATMOSPHERE_Pa
        filling = source > p
        conductance = line.filling_conductance_m3_s_Pa if filling else line.venting_conductance_m3_s_Pa
        return [gas * valve_mass_flow(conductance, line.critical_ratio, source, p, 293.15)]

    start = (chamber_Pa + ATMOSPHERE_Pa) * VOLUME_m3 * (1.0 + line.growth_1_Pa * chamber_Pa)
    end = solve_ivp(rate, (0.0, end_s), [start], rtol=1e-9, atol=1e-12, method="LSODA").y[0, -1]
    return pressure(end) - ATMOSPHERE_Pa


@pytest.mark.parametrize(("start_Pa", "sensor_Pa"), [(0.0, 1e5), (1e5, 0.0), (2e4, 1.5e5)])
def test_pressure_converges_on_the_gas_balance_with_order_one(start_Pa: float, sensor_Pa: float) -> None:
    end_s = 0.2 * VOLUME_m3 / (2e-10 * 287.05 * 293.15 * 1.185)
    exact = reference(LINE, start_Pa, sensor_Pa, end_s)
    errors = [abs(run(LINE, start_Pa, sensor_Pa, end_s, steps) - exact) for steps in (50, 100, 200)]
    assert errors[2] < 2e-3 * abs(sensor_Pa - start_Pa)
    orders = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert orders == pytest.approx([1.0, 1.0], abs=0.15)


@given(chamber=pressures, sensor=pressures, dt=st.floats(0.0, 1e9))
def test_no_step_however_long_passes_the_sensors_pressure(chamber: float, sensor: float, dt: float) -> None:
    low, high = sorted([chamber, sensor])
    assert low - 1e-6 <= step(LINE, chamber, sensor, dt) <= high + 1e-6


@given(chamber=pressures, sensor=pressures)
def test_chamber_reaches_the_sensors_pressure_in_the_end(chamber: float, sensor: float) -> None:
    assert step(LINE, chamber, sensor, 1e9) == pytest.approx(sensor, abs=1.0)
    assert step(LINE, chamber, sensor, 0.0) == pytest.approx(chamber, abs=1e-6)


def test_venting_is_slower_by_its_conductance_and_filling_by_the_growth_of_the_chamber() -> None:
    def t63(line: Line, start_Pa: float, sensor_Pa: float) -> float:
        t, p, dt = 0.0, start_Pa, 1e-3
        while abs(p - start_Pa) < (1.0 - math.exp(-1.0)) * abs(sensor_Pa - start_Pa):
            p, t = step(line, p, sensor_Pa, dt), t + dt
        return t

    stiff = Line(2e-10, 2e-10, growth_1_Pa=0.0)
    assert t63(LINE, 1e5, 0.0) > 1.9 * t63(Line(2e-10, 2e-10, 4e-6, 0.25), 1e5, 0.0)
    assert t63(Line(2e-10, 2e-10, growth_1_Pa=4e-6), 0.0, 1e5) > 1.3 * t63(stiff, 0.0, 1e5)
    assert t63(stiff, 1e5, 0.0) > t63(stiff, 0.0, 1e5)  # the same conductance: less gas flows at lower pressures


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ((0.0, 1e-10), "filling_conductance_m3_s_Pa = 0.0: give 1e-16 to 0.001"),
        ((1e-10, math.nan), "venting_conductance_m3_s_Pa = nan"),
        ((1e-10, 1e-10, -1.0), "growth_1_Pa = -1.0"),
        ((1e-10, 1e-10, 0.0, 1.0), "critical_ratio = 1.0: give 0 to 0.9"),
    ],
)
def test_what_is_no_line_is_refused(values: tuple[float, ...], says: str) -> None:
    with pytest.raises(InputError, match=says):
        Line(*values)
