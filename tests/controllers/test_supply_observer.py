"""Two explanations of a low supply: which is the likelier one, and how severe."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.chamber_gas import gas_of
from controllers.supply_observer import SUPPLY, begin_supply, observe_supply, weigh_supply
from softbot.pneumatics import PneumaticsParameters, flow_and_slopes

NOMINAL = PneumaticsParameters()
GAS = gas_of(NOMINAL)
NOISE_Pa = 1e3


def followed(seed: int, *, regulated: float = 1.0, conductance: float = 1.0, seconds: float = 4.0):
    """A manifold drawn upon now and then, in small steps, and what the bank makes of its readings."""
    random = np.random.default_rng(seed)
    supply = np.zeros(1, SUPPLY).view(np.recarray)[0]
    pressure = GAS.regulated_Pa + GAS.atmosphere_Pa
    source = regulated * GAS.regulated_Pa + GAS.atmosphere_Pa
    for cycle in range(round(100 * seconds)):
        drawn = 0.5 * GAS.supply[0] * pressure if cycle % 40 < 25 else 0.0
        for _ in range(100):
            feed = max(flow_and_slopes(conductance * GAS.regulator, GAS.critical_ratio, source, pressure)[0], 0.0)
            pressure += 1e-4 * GAS.specific_J_kg / GAS.manifold_m3 * (feed - drawn)
            pressure = max(pressure, GAS.atmosphere_Pa)
        reading_Pa = pressure - GAS.atmosphere_Pa + NOISE_Pa * random.standard_normal()
        if supply.begun:
            observe_supply(supply, GAS, reading_Pa, NOISE_Pa, drawn, 0.01)
        elif reading_Pa < 0.9 * GAS.regulated_Pa:
            begin_supply(supply, GAS, reading_Pa, NOISE_Pa)
    assert supply.begun
    return weigh_supply(supply)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.2, 0.75))
def test_a_regulator_set_lower_is_a_sag_of_that_severity(seed, severity):
    evidence, sag, _ = followed(seed, regulated=1.0 - severity)
    assert evidence < -10.0
    assert sag == pytest.approx(severity, abs=0.03)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.0, 0.02))
def test_a_regulator_that_passes_little_is_a_loss_of_that_severity(seed, conductance):
    evidence, _, loss = followed(seed, conductance=conductance, seconds=8.0)
    assert evidence > 10.0
    assert 1.0 - loss == pytest.approx(conductance, abs=0.01)
