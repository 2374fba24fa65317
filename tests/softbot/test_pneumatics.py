"""The valve law against ISO 6358, the gas balance against closed forms, and stability at any step."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softbot import pneumatics
from softbot.errors import InputError, SimulationError
from softbot.faults import Fault, PneumaticConditions
from softbot.plant_conditions import PlantConditions
from softbot.pneumatics import PneumaticsParameters, initial_state, pressures, step, valve_mass_flow

C = 1e-9
VOLUME_m3 = 4e-4 * 0.134
VOLUMES_m3 = np.full(4, VOLUME_m3)
HEALTHY = PneumaticConditions()
DEFAULT = PneumaticsParameters()
ATMOSPHERE_Pa = 101325.0
absolute_pressure = st.floats(2e4, 2e6)


def stiff_supply(**changes):
    """A manifold that holds its pressure, valves without lag or dead volume: what the closed forms assume."""
    return dataclasses.replace(
        PneumaticsParameters(
            supply_pressure_Pa=700e3,
            regulator_conductance_m3_s_Pa=1e-3,
            manifold_volume_m3=1.0,
            valve_lag_s=0.0,
            dead_volume_m3=(0.0,) * 4,
        ),
        **changes,
    )


# ---------------------------------------------------------------------------------------------- the valve


def test_choked_flow_is_sonic_conductance_times_reference_density_times_upstream_pressure():
    for downstream in (0.0, 1e5, 0.3 * 7e5):
        assert valve_mass_flow(C, 0.3, 7e5, downstream, 293.15) == pytest.approx(C * 1.185 * 7e5, rel=1e-14)


def test_hot_gas_flows_less_with_the_square_root_of_temperature():
    cold, hot = (valve_mass_flow(C, 0.3, 7e5, 1e5, T) for T in (293.15, 4 * 293.15))
    assert cold / hot == pytest.approx(2.0, rel=1e-14)


@pytest.mark.parametrize("b", [0.0, 0.2, 0.35, 0.5])
@pytest.mark.parametrize("ratio", [0.6, 0.8, 0.95])
def test_subsonic_flow_follows_the_quarter_ellipse(b, ratio):
    flow = valve_mass_flow(C, b, 4e5, ratio * 4e5, 293.15)
    on_the_axes = (flow / (C * 1.185 * 4e5)) ** 2 + ((ratio - b) / (1 - b)) ** 2
    assert on_the_axes == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("joint", [0.3, pneumatics.LAMINAR_PRESSURE_RATIO])
def test_flow_is_continuous_where_its_branches_meet(joint):
    below, above = (valve_mass_flow(C, 0.3, 4e5, 4e5 * joint * (1 + d), 293.15) for d in (-1e-10, 1e-10))
    assert below == pytest.approx(above, rel=1e-6)


def test_flow_is_linear_with_one_finite_slope_about_equal_pressures():
    differences = np.array([-300.0, -10.0, -1e-3, 1e-3, 10.0, 300.0])
    slopes = [valve_mass_flow(C, 0.3, 4e5, 4e5 - d, 293.15) / d for d in differences]
    assert 0 < slopes[0] < 1e-7
    np.testing.assert_allclose(slopes, slopes[0], rtol=2e-3)
    assert valve_mass_flow(C, 0.3, 4e5, 4e5, 293.15) == 0.0
    assert valve_mass_flow(C, 0.3, 0.0, 0.0, 293.15) == 0.0


@settings(deadline=None, max_examples=200)
@given(absolute_pressure, absolute_pressure, st.floats(0, 0.6), st.floats(200, 400))
def test_flow_is_odd_under_exchange_of_its_sides_and_goes_downhill(p, q, b, temperature):
    flow = valve_mass_flow(C, b, p, q, temperature)
    assert flow == -valve_mass_flow(C, b, q, p, temperature)
    assert flow * (p - q) >= 0


@settings(deadline=None, max_examples=200)
@given(absolute_pressure, absolute_pressure, st.floats(0, 0.6))
def test_slopes_of_the_flow_are_its_derivatives(p, q, b):
    _flow, slope_p, slope_q = pneumatics.flow_and_slopes(C, b, p, q)
    assert slope_p >= 0 >= slope_q
    ratio = min(p, q) / max(p, q)
    if min(abs(ratio - b), abs(ratio - pneumatics.LAMINAR_PRESSURE_RATIO), 1 - ratio) < 1e-4:
        return  # a corner lies within the difference
    d = 1e-6 * max(p, q)
    numeric_p = (pneumatics.flow_and_slopes(C, b, p + d, q)[0] - pneumatics.flow_and_slopes(C, b, p - d, q)[0]) / (
        2 * d
    )
    numeric_q = (pneumatics.flow_and_slopes(C, b, p, q + d)[0] - pneumatics.flow_and_slopes(C, b, p, q - d)[0]) / (
        2 * d
    )
    scale = abs(slope_p) + abs(slope_q)
    assert numeric_p == pytest.approx(slope_p, abs=1e-3 * scale)
    assert numeric_q == pytest.approx(slope_q, abs=1e-3 * scale)


# ---------------------------------------------------------------------------------------------- the paramet


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"supply_pressure_Pa": -1.0}, r"pneumatics\.supply_pressure_Pa = -1\.0"),
        ({"manifold_volume_m3": 0.0}, r"pneumatics\.manifold_volume_m3 = 0\.0.*above zero"),
        ({"temperature_K": math.nan}, r"pneumatics\.temperature_K = nan"),
        ({"valve_lag_s": -0.1}, r"pneumatics\.valve_lag_s = -0\.1.*zero or more"),
        ({"valve_lag_s": "fast"}, r"pneumatics\.valve_lag_s = 'fast'.*a number"),
        ({"critical_ratio": 0.95}, r"pneumatics\.critical_ratio = 0\.95"),
        ({"dead_volume_m3": (1e-6, 1e-6)}, r"pneumatics\.dead_volume_m3 = .*four numbers"),
        ({"dead_volume_m3": 1e-6}, r"pneumatics\.dead_volume_m3 = 1e-06.*four numbers"),
        (
            {"supply_valve_conductance_m3_s_Pa": (1e-9, 1e-9, 0.0, 1e-9)},
            r"pneumatics\.supply_valve_conductance_m3_s_Pa",
        ),
        ({"max_chamber_pressure_Pa": 300e3}, r"pneumatics\.max_chamber_pressure_Pa = 300000\.0.*supply"),
    ],
)
def test_parameter_out_of_range_is_refused_by_name(change, message):
    with pytest.raises(InputError, match=message):
        PneumaticsParameters(**change)


def test_parameters_take_lists_and_whole_numbers_as_a_file_gives_them():
    parameters = PneumaticsParameters(dead_volume_m3=[1e-6, 2e-6, 3e-6, 4e-6], supply_pressure_Pa=200000)
    assert parameters.dead_volume_m3 == (1e-6, 2e-6, 3e-6, 4e-6)
    packed = parameters.as_arrays()
    assert packed.shape == (pneumatics.PARAMETERS_SIZE,)
    assert packed[0] == 200e3 + ATMOSPHERE_Pa
    np.testing.assert_array_equal(packed[-4:], parameters.dead_volume_m3)


def test_default_valves_fill_and_vent_a_chamber_in_the_times_they_state():
    state = initial_state(DEFAULT, VOLUMES_m3)
    times = {}
    for opening, target_Pa, name in ((1.0, 63e3, "fill"), (1.0, 100e3, "reach"), (-1.0, 37e3, "vent")):
        t_s = 0.0
        pressure_Pa = pressures(state, VOLUMES_m3, DEFAULT)
        if name == "vent":
            state[0] = 0.0  # a shut valve, as at rest
        while (pressure_Pa[0] - target_Pa) * opening < 0:
            state, pressure_Pa = step(state, [opening, 0, 0, 0], True, VOLUMES_m3, 5e-4, HEALTHY, DEFAULT)
            t_s += 5e-4
        times[name] = t_s
    assert 0.10 < times["fill"] < 0.15
    assert 0.15 < times["vent"] < 0.25


# ---------------------------------------------------------------------------------------------- the gas bal


def test_choked_filling_raises_the_pressure_at_a_constant_rate():
    parameters = stiff_supply()
    state = initial_state(parameters, VOLUMES_m3)
    for _ in range(10):
        state, pressure_Pa = step(state, [1, 0, 0, 0], True, VOLUMES_m3, 1e-3, HEALTHY, parameters)
    assert (pressure_Pa[0] + ATMOSPHERE_Pa) / (700e3 + ATMOSPHERE_Pa) < 0.3  # still choked
    conductance = parameters.supply_valve_conductance_m3_s_Pa[0]
    rate_Pa_s = conductance * 1.185 * 287.05 * 293.15 * (700e3 + ATMOSPHERE_Pa) / VOLUME_m3
    assert pressure_Pa[0] == pytest.approx(rate_Pa_s * 10e-3, rel=1e-4)
    np.testing.assert_allclose(pressure_Pa[1:4], 0.0, atol=1e-6)


def test_choked_venting_decays_exponentially_and_converges_with_first_order():
    parameters = stiff_supply()
    start_Pa = 700e3
    rate_1_s = parameters.exhaust_valve_conductance_m3_s_Pa[0] * 1.185 * 287.05 * 293.15 / VOLUME_m3
    exact_Pa = (start_Pa + ATMOSPHERE_Pa) * math.exp(-rate_1_s * 0.2)
    assert ATMOSPHERE_Pa / exact_Pa < 0.3  # still choked
    errors = []
    for steps in (50, 100, 200):
        state = initial_state(parameters, VOLUMES_m3, (start_Pa, 0, 0, 0))
        for _ in range(steps):
            state, pressure_Pa = step(state, [-1, 0, 0, 0], True, VOLUMES_m3, 0.2 / steps, HEALTHY, parameters)
        errors.append(abs(pressure_Pa[0] + ATMOSPHERE_Pa - exact_Pa))
    assert errors[-1] < 1e-3 * exact_Pa
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 1.0, atol=0.02)


def test_shut_chamber_that_moves_keeps_its_gas():
    parameters = stiff_supply(dead_volume_m3=(2e-6,) * 4)
    state = initial_state(parameters, VOLUMES_m3, (50e3,) * 4)
    squeezed = VOLUMES_m3 * np.array([0.5, 0.9, 1.1, 2.0])
    after, pressure_Pa = step(state, np.zeros(4), True, squeezed, 1e-3, HEALTHY, parameters)
    np.testing.assert_allclose(after[4:8], state[4:8], rtol=1e-12)
    expected = (50e3 + ATMOSPHERE_Pa) * (VOLUMES_m3 + 2e-6) / (squeezed + 2e-6) - ATMOSPHERE_Pa
    np.testing.assert_allclose(pressure_Pa[:4], expected, rtol=1e-9)


def test_valve_lag_is_exact_at_any_step():
    parameters = dataclasses.replace(DEFAULT, valve_lag_s=0.01)
    for steps in (1, 10, 100):
        state = initial_state(parameters, VOLUMES_m3)
        for _ in range(steps):
            state, _ = step(state, [1.0, -0.5, 3.0, 0.0], True, VOLUMES_m3, 0.02 / steps, HEALTHY, parameters)
        np.testing.assert_allclose(state[:4], np.array([1.0, -0.5, 1.0, 0.0]) * (1 - math.exp(-2)), rtol=1e-12)


def test_closed_main_supply_feeds_the_chambers_from_the_manifold_only():
    state = initial_state(DEFAULT, VOLUMES_m3)
    gas_kg = state[4:].sum()
    for _ in range(400):
        state, pressure_Pa = step(state, np.ones(4), False, VOLUMES_m3, 1e-2, HEALTHY, DEFAULT)
    assert state[4:].sum() == pytest.approx(gas_kg, rel=1e-12)
    np.testing.assert_allclose(pressure_Pa, pressure_Pa[4], rtol=1e-6)
    assert 0 < pressure_Pa[4] < DEFAULT.supply_pressure_Pa


def test_chambers_filling_together_share_the_manifold():
    sag_Pa = []
    for openings in ([1, 0, 0, 0], [1, 1, 1, 1]):
        state = initial_state(DEFAULT, VOLUMES_m3)
        for _ in range(50):
            state, pressure_Pa = step(state, openings, True, VOLUMES_m3, 1e-3, HEALTHY, DEFAULT)
        sag_Pa.append(DEFAULT.supply_pressure_Pa - pressure_Pa[4])
    assert 0 < 4 * sag_Pa[0] < sag_Pa[1]


def test_regulator_does_not_relieve():
    state = initial_state(DEFAULT, VOLUMES_m3, manifold_pressure_Pa=400e3)
    after, pressure_Pa = step(state, np.zeros(4), True, VOLUMES_m3, 1.0, HEALTHY, DEFAULT)
    assert pressure_Pa[4] == pytest.approx(400e3)
    assert after[8] == pytest.approx(state[8], rel=1e-12)


@settings(deadline=None, max_examples=300)
@given(
    dt_s=st.floats(-5, 0).map(lambda x: 10**x),
    volumes=st.tuples(*[st.floats(-9, -3).map(lambda x: 10**x)] * 4),
    manifold=st.floats(-8, -3).map(lambda x: 10**x),
    openings=st.tuples(*[st.floats(-1, 1)] * 4),
    start=st.tuples(*[st.floats(-50e3, 400e3)] * 4),
    manifold_start=st.floats(-50e3, 400e3),
    leaks=st.tuples(*[st.sampled_from([0.0, 0.01, 1.0, 100.0])] * 4),
    is_open=st.booleans(),
)
def test_any_step_keeps_pressures_between_those_joined_and_loses_no_gas(
    dt_s, volumes, manifold, openings, start, manifold_start, leaks, is_open
):
    parameters = dataclasses.replace(DEFAULT, manifold_volume_m3=manifold, dead_volume_m3=(0.0,) * 4, valve_lag_s=0.0)
    conditions = PneumaticConditions()
    conditions.leak_ratio[:] = leaks
    state = initial_state(parameters, volumes, start, manifold_start)
    for _ in range(3):
        before = pressures(state, volumes, parameters)
        after, pressure_Pa = step(state, openings, is_open, volumes, dt_s, conditions, parameters)
        low, high = min(before.min(), 0.0), max(before.max(), parameters.supply_pressure_Pa)
        assert np.all(pressure_Pa >= low - 1e-6)
        assert np.all(pressure_Pa <= high + 1e-6)
        assert np.all(after[4:] > 0)

        # The gas gained is what came in through the regulator less what went out, at the pressures of the
        # end.
        absolute = pressure_Pa + ATMOSPHERE_Pa
        b, T = parameters.critical_ratio, parameters.temperature_K
        fed = 0.0
        if is_open:
            fed = max(
                0.0,
                valve_mass_flow(
                    parameters.regulator_conductance_m3_s_Pa,
                    b,
                    parameters.supply_pressure_absolute_Pa,
                    absolute[4],
                    T,
                ),
            )
        lost = throughput = 0.0
        for i in range(4):
            conductance = parameters.supply_valve_conductance_m3_s_Pa[i] * leaks[i]
            conductance += parameters.exhaust_valve_conductance_m3_s_Pa[i] * max(-openings[i], 0.0)
            out = valve_mass_flow(conductance, b, absolute[i], ATMOSPHERE_Pa, T)
            lost += out
            # The scale of rounding: the full flow of each orifice, which cancels when pressures are equal.
            throughput += (conductance + parameters.supply_valve_conductance_m3_s_Pa[i] * abs(openings[i])) * 1.2 * 7e5
        throughput += parameters.regulator_conductance_m3_s_Pa * 1.2 * 7e5
        gained = after[4:].sum() - state[4:].sum()
        assert gained == pytest.approx(dt_s * (fed - lost), abs=1e-11 * (dt_s * throughput + state[4:].sum()))
        state = after


@pytest.mark.parametrize("dt_s", [1e-5, 1e-3, 1.0])
def test_filling_and_venting_approach_their_ends_without_overshoot(dt_s):
    tiny = np.array([1e-9, 1e-8, 1e-7, 1e-6])
    # A stiff manifold: a full chamber would follow the sag that the others cause, rightly.
    parameters = stiff_supply(supply_pressure_Pa=250e3, valve_lag_s=0.01)
    state = initial_state(parameters, tiny)
    last = np.zeros(4)
    for _ in range(300):
        state, pressure_Pa = step(state, np.ones(4), True, tiny, dt_s, HEALTHY, parameters)
        assert np.all(pressure_Pa[:4] >= last - 1e-3)
        assert np.all(pressure_Pa <= parameters.supply_pressure_Pa + 1e-6)
        last = pressure_Pa[:4]
    assert pressure_Pa[0] == pytest.approx(pressure_Pa[4], rel=0.05)
    state[:4] = 0.0
    for _ in range(300):
        state, pressure_Pa = step(state, -np.ones(4), True, tiny, dt_s, HEALTHY, parameters)
        assert np.all(pressure_Pa[:4] <= last + 1e-3)
        assert np.all(pressure_Pa[:4] >= -1e-6)
        last = pressure_Pa[:4]
    assert pressure_Pa[0] < 0.05 * parameters.supply_pressure_Pa


# ---------------------------------------------------------------------------------------------- broken plants


def settle(fault, opening, start_Pa=0.0, duration_s=3.0):
    conditions = PlantConditions([fault])
    conditions.advance(fault.t_s)
    state = initial_state(DEFAULT, VOLUMES_m3, (start_Pa,) * 4)
    for _ in range(int(duration_s / 0.01)):
        state, pressure_Pa = step(state, np.full(4, opening), True, VOLUMES_m3, 0.01, conditions.pneumatic, DEFAULT)
    return state, pressure_Pa


def test_ruptured_chamber_cannot_hold_a_twentieth_of_the_supply():
    _, pressure_Pa = settle(Fault(0, 2, "rupture", 1.0), opening=1.0)
    assert 0 < pressure_Pa[2] < 0.05 * DEFAULT.supply_pressure_Pa
    assert np.all(np.delete(pressure_Pa[:4], 2) > 0.9 * DEFAULT.supply_pressure_Pa)


def test_rupture_of_less_severity_holds_more():
    held = [settle(Fault(0, 0, "rupture", s), opening=1.0)[1][0] for s in (0.1, 0.3, 1.0)]
    assert held[0] > held[1] > held[2]


def test_leaking_chamber_empties_behind_a_shut_valve_and_still_fills_through_an_open_one():
    leak = Fault(0, 1, "leak", 1.0)
    assert settle(leak, opening=0.0, start_Pa=100e3)[1][1] < 1e3
    assert settle(leak, opening=1.0)[1][1] > 100e3


def test_blocked_inlet_vents_but_does_not_fill():
    blocked = Fault(0, 3, "blocked_inlet", 1.0)
    assert abs(settle(blocked, opening=1.0)[1][3]) < 1e-6
    assert settle(blocked, opening=-1.0, start_Pa=100e3)[1][3] < 1.0


def test_valve_stuck_open_fills_and_valve_stuck_closed_holds_whatever_is_commanded():
    state, pressure_Pa = settle(Fault(0, 0, "stuck_open", 1.0), opening=-1.0)
    assert state[0] == 1.0
    assert pressure_Pa[0] > 0.95 * DEFAULT.supply_pressure_Pa
    for opening in (-1.0, 1.0):
        state, pressure_Pa = settle(Fault(0, 0, "stuck_closed"), opening=opening, start_Pa=80e3)
        assert state[0] == 0.0
        assert pressure_Pa[0] == pytest.approx(80e3, rel=1e-9)


def test_blocked_exhaust_and_dead_supply_are_conditions_too():
    conditions = PneumaticConditions()
    conditions.exhaust_factor[0] = 0.0
    conditions.set_supply_factor(0.0)
    state = initial_state(DEFAULT, VOLUMES_m3, (80e3,) * 4)
    gas_kg = state[8]
    for _ in range(200):
        state, pressure_Pa = step(state, [-1, -1, -1, 1], True, VOLUMES_m3, 0.01, conditions, DEFAULT)
    assert pressure_Pa[0] == pytest.approx(80e3, rel=1e-9)
    assert pressure_Pa[1] < 1.0
    assert state[8] < gas_kg


# ---------------------------------------------------------------------------------------------- the two ent


def test_step_leaves_its_arguments_and_agrees_with_the_pressures_of_its_state():
    state = initial_state(DEFAULT, VOLUMES_m3)
    kept = state.copy()
    after, pressure_Pa = step(state, [1, -1, 0.5, 0], True, VOLUMES_m3, 1e-3, HEALTHY, DEFAULT)
    np.testing.assert_array_equal(state, kept)
    assert not np.array_equal(after, state)
    np.testing.assert_allclose(pressures(after, VOLUMES_m3, DEFAULT), pressure_Pa, atol=1e-6)


def test_compiled_kernels_do_what_their_source_says():
    conditions = PneumaticConditions()
    conditions.leak_ratio[1] = 0.5
    conditions.forced_opening[2] = -0.3
    conditions.widening_1_Pa[:3] = 1e-5
    state = initial_state(DEFAULT, VOLUMES_m3, (10e3, 60e3, 90e3, 0.0))
    arguments = (
        np.array([1.0, 0.4, 0.0, -1.0]),
        True,
        VOLUMES_m3,
        4e-3,
        conditions.packed,
        DEFAULT.as_arrays(),
    )
    compiled, source = state.copy(), state.copy()
    out_compiled, out_source = np.empty(5), np.empty(5)
    for _ in range(5):
        assert pneumatics.step_in_place(compiled, out_compiled, *arguments) == 0
        assert pneumatics.step_in_place.py_func(source, out_source, *arguments) == 0
    np.testing.assert_allclose(compiled, source, rtol=1e-12)
    np.testing.assert_allclose(out_compiled, out_source, atol=1e-6)

    chamber = (1.5e5, 5e-10, 1.5e5, 3.5e5, ATMOSPHERE_Pa, 1e-9, 4e-10, 0.3, 0.1, 2e-15)
    np.testing.assert_allclose(
        pneumatics._solve_chamber(*chamber), pneumatics._solve_chamber.py_func(*chamber), rtol=1e-12
    )
    for q in (0.1e5, 2e5, 3.9999e5, 4.5e5):
        np.testing.assert_allclose(
            pneumatics.flow_and_slopes(C, 0.3, 4e5, q), pneumatics.flow_and_slopes.py_func(C, 0.3, 4e5, q)
        )
        assert valve_mass_flow.py_func(C, 0.3, 4e5, q, 300.0) == valve_mass_flow(C, 0.3, 4e5, q, 300.0)
    assert pneumatics.flow_coefficient.py_func(C, 293.15) == pytest.approx(C * 1.185)


@pytest.mark.parametrize("dt_s", [1e-4, 1e-3, 1e-2])
def test_chamber_that_widens_with_its_pressure_keeps_its_gas_and_does_not_ring(dt_s):
    conditions, shut = PneumaticConditions(), np.zeros(4)
    state = initial_state(DEFAULT, VOLUMES_m3, (80e3, 80e3, 80e3, 80e3))
    conditions.widening_1_Pa[0] = 1.0 / 100e3  # at 80 kPa an explicit step of this would ring for ever
    seen_Pa = []
    for _ in range(20):
        state, pressure_Pa = step(state, shut, True, VOLUMES_m3, dt_s, conditions, DEFAULT)
        seen_Pa.append(pressure_Pa)
    after_Pa = np.array(seen_Pa)
    np.testing.assert_allclose(after_Pa, np.broadcast_to(after_Pa[0], after_Pa.shape), atol=1e-3)
    dead_m3 = DEFAULT.dead_volume_m3[0]
    before = (80e3 + ATMOSPHERE_Pa) * (VOLUMES_m3[0] + dead_m3)
    after = (after_Pa[-1, 0] + ATMOSPHERE_Pa) * (VOLUMES_m3[0] * (1.0 + after_Pa[-1, 0] / 100e3) + dead_m3)
    assert after == pytest.approx(before, rel=1e-9)
    np.testing.assert_allclose(after_Pa[-1, 1:4], 80e3, atol=1e-3)


@pytest.mark.parametrize("place", [4, 8])
@pytest.mark.parametrize("value", [math.nan, -1.0, math.inf])
def test_spoiled_state_ends_the_simulation_with_a_message(place, value):
    state = initial_state(DEFAULT, VOLUMES_m3)
    state[place] = value
    with pytest.raises(SimulationError, match="no solution"):
        step(state, np.zeros(4), True, VOLUMES_m3, 1e-3, HEALTHY, DEFAULT)
    assert (
        pneumatics.step_in_place.py_func(
            state, np.empty(5), np.zeros(4), True, VOLUMES_m3, 1e-3, HEALTHY.packed, DEFAULT.as_arrays()
        )
        == 1
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"command_opening": [0, 0, 0]}, "command_opening"),
        ({"command_opening": [0, 0, 0, math.nan]}, "command_opening"),
        ({"chamber_volume_m3": [1e-5, 1e-5, 1e-5, -1e-5]}, "chamber_volume_m3"),
        ({"dt_s": 0.0}, r"dt_s = 0\.0"),
        ({"dt_s": math.inf}, "dt_s = inf"),
        ({"state": np.zeros(4)}, "state has shape"),
    ],
)
def test_wrong_argument_of_a_step_is_refused_by_name(change, message):
    arguments = {
        "state": initial_state(DEFAULT, VOLUMES_m3),
        "command_opening": np.zeros(4),
        "main_supply_open": True,
        "chamber_volume_m3": VOLUMES_m3,
        "dt_s": 1e-3,
        "conditions": HEALTHY,
        "parameters": DEFAULT,
    }
    with pytest.raises(InputError, match=message):
        step(**arguments | change)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"chamber_volume_m3": -VOLUMES_m3}, "chamber_volume_m3"),
        ({"chamber_pressure_Pa": (-2e5, 0, 0, 0)}, "chamber_pressure_Pa"),
        ({"manifold_pressure_Pa": -2e5}, "manifold_pressure_Pa"),
    ],
)
def test_impossible_initial_state_is_refused_by_name(arguments, message):
    with pytest.raises(InputError, match=message):
        initial_state(DEFAULT, **{"chamber_volume_m3": VOLUMES_m3} | arguments)
