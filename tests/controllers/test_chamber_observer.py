"""The filter of a chamber: it learns what a robot differs from its file by, and says how far it may be off."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numba import njit

from controllers.chamber_gas import Gas, gas_of, lagged_opening, next_pressure
from controllers.chamber_observer import (
    INLET,
    OBSERVER,
    OFFSET,
    OUTLET,
    begin_observing,
    observe,
    resume_observing,
)
from softbot.faults import PneumaticConditions
from softbot.pneumatics import PneumaticsParameters, initial_state, pressures, step

STEP_S, VOLUME_m3, NOISE_Pa = 0.01, 50e-6, 510.0


@njit
def _watch(own: Any, gas: Gas, reading_Pa: Any, opening: Any, supply_Pa: Any, volume_m3: float, ratio: Any) -> None:
    lagged = opening[0]
    begin_observing(own[0], gas, reading_Pa[0], NOISE_Pa)
    for k in range(1, reading_Pa.size):
        lagged, mean = lagged_opening(gas.lag_s, STEP_S, lagged, opening[k])
        supply = supply_Pa[k - 1] + gas.atmosphere_Pa
        observe(own[0], gas, 0, reading_Pa[k], NOISE_Pa, supply, mean, lagged, volume_m3, 0.0, STEP_S, 0.0, True)
        ratio[k] = own[0].innovation_Pa / own[0].deviation_Pa


def watched(share_in: float, share_out: float, offset_Pa: float, cycles: int = 1500) -> tuple[Any, Any]:
    """A chamber filled and vented again and again, its valves and its sensor other than in the file."""
    nominal = PneumaticsParameters()
    real = PneumaticsParameters(
        supply_valve_conductance_m3_s_Pa=tuple(share_in * c for c in nominal.supply_valve_conductance_m3_s_Pa),
        exhaust_valve_conductance_m3_s_Pa=tuple(share_out * c for c in nominal.exhaust_valve_conductance_m3_s_Pa),
    )
    volumes, noise = np.full(4, VOLUME_m3), np.random.default_rng(3)
    state = initial_state(real, volumes)
    opening, reading_Pa, supply_Pa = np.zeros(cycles), np.zeros(cycles), np.zeros(cycles)
    for k in range(cycles):
        phase = k % 100
        opening[k] = 0.6 if phase < 15 else (0.0 if phase < 40 else -0.7)
        for _ in range(4):
            state, pressure_Pa = step(
                state, np.full(4, opening[k]), True, volumes, STEP_S / 4, PneumaticConditions(), real
            )
        reading_Pa[k] = pressure_Pa[0] + offset_Pa + 500.0 * noise.standard_normal()
        supply_Pa[k] = pressures(state, volumes, real)[4]
    own, ratio = np.zeros(1, OBSERVER).view(np.recarray), np.zeros(cycles)
    _watch(own, gas_of(nominal), reading_Pa, opening, supply_Pa, VOLUME_m3 + nominal.dead_volume_m3[0], ratio)
    return own[0], ratio


@pytest.mark.parametrize(("share_in", "share_out", "offset_Pa"), [(0.8, 1.2, 600.0), (1.2, 0.8, -600.0)])
def test_it_learns_the_valves_and_the_sensor_of_this_very_robot(share_in, share_out, offset_Pa):
    own, ratio = watched(share_in, share_out, offset_Pa)
    assert own["x"][INLET] == pytest.approx(share_in, abs=0.06)
    assert own["x"][OUTLET] == pytest.approx(share_out, abs=0.06)
    assert own["x"][OFFSET] == pytest.approx(offset_Pa, abs=250.0)
    assert np.sqrt(np.mean(ratio[500:] ** 2)) < 1.3  # what it says of its own error is so


def test_after_a_lost_sampling_it_takes_the_reading_and_keeps_what_it_learnt():
    own, _ = watched(0.8, 1.2, 0.0)
    learnt = own["x"].copy()
    memory = np.zeros(1, OBSERVER).view(np.recarray)
    memory[0] = own
    gas = gas_of(PneumaticsParameters())
    resume_observing(memory[0], gas, 42e3, NOISE_Pa)
    assert memory[0]["x"][0] == pytest.approx(42e3 + gas.atmosphere_Pa - learnt[OFFSET])
    np.testing.assert_array_equal(memory[0]["x"][1:], learnt[1:])


@pytest.mark.parametrize("hole", [0.0, 1.0, 10.0, 1e6])
def test_the_gas_never_leaves_the_pressures_that_it_flows_between(hole):
    gas = gas_of(PneumaticsParameters())
    pressure, supply = 180e3, 350e3
    for opening in (1.0, -1.0, 0.0):
        after = next_pressure(gas, 0, pressure, supply, opening, 50e-6, 0.0, 1.0, 1.0, hole, STEP_S)[0]
        assert gas.atmosphere_Pa - 1e-6 <= after <= supply + 1e-6
