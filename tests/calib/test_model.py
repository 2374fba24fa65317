"""The actuator law with free coordinates: slopes against differences, predictions against the law itself."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.model import ActuatorModel
from softbot.errors import InputError, SimulationError

PRESSURE_PA = np.array(
    [[8e4, 1e4, 0.0, 0.0], [3e4, 6e4, 2e4, 0.0], [0.0, 0.0, 5e4, 7e4], [9e4, 9e4, 9e4, 9e4], [0.0, 5e3, 0.0, 0.0]]
)
EVERYTHING = {
    "linear": {"radius", "dead_band", "length"},
    "neo-hookean": {"centroid", "dead_band", "length"},
    "yeoh": {"radius", "length"},
    "gent": {"radius", "dead_band"},
    "mooney-rivlin": {"radius", "turn", "length"},
}


def model(material: str, free: set[str]) -> ActuatorModel:
    return ActuatorModel(material, ((0,), (1, 3), (2,)), 0.15, 0.02, 9e4, frozenset(free))


def somewhere(one: ActuatorModel, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    theta = one.start(8e5 if one.material == "linear" else 2e5, 0.2, 3e3)
    return theta + rng.uniform(-0.02, 0.02, len(theta)) * (1.0 - (np.array(one.coordinates) == "dead_band"))


@pytest.mark.parametrize("material", EVERYTHING)
@given(seed=st.integers(0, 1000))
@settings(deadline=None, max_examples=10)
def test_slopes_are_those_of_the_predictions(material: str, seed: int) -> None:
    one = model(material, EVERYTHING[material])
    theta = somewhere(one, seed)
    found = one.predict(theta, PRESSURE_PA)
    for n in range(len(theta)):
        step = np.zeros(len(theta))
        step[n] = 1e-5
        ahead, behind = one.predict(theta + step, PRESSURE_PA), one.predict(theta - step, PRESSURE_PA)
        bend_slope = (ahead.bend_rad - behind.bend_rad) / 2e-5
        length_slope = (ahead.length_m - behind.length_m) / 2e-5
        np.testing.assert_allclose(found.bend_by_coordinate[:, :, n], bend_slope, atol=1e-4, rtol=1e-4)
        np.testing.assert_allclose(found.length_by_coordinate[:, n], length_slope, atol=1e-5, rtol=1e-4)


def test_prediction_is_the_law_times_the_length() -> None:
    one = model("neo-hookean", {"radius", "length"})
    theta = somewhere(one, 3)
    found, law = one.predict(theta, PRESSURE_PA), one.law(theta)
    length_m, section = one.geometry(theta)
    assert section.radius_m == pytest.approx(math.exp(theta[1]))
    for row, pressure in enumerate(PRESSURE_PA):
        rest = law.equilibrium(pressure)
        np.testing.assert_allclose(found.bend_rad[row], length_m * rest.curvature_1_m, rtol=1e-9, atol=1e-12)
        assert found.length_m[row] == pytest.approx(length_m * rest.stretch)


def test_gains_keep_their_mean_over_driven_chambers() -> None:
    one = model("linear", set())
    theta = one.start(1e6, 1.0, 0.0)
    theta[one.coordinates.index("gain") :] = [0.3, -0.2]
    values = one.values(theta)
    assert np.mean([values[f"gain_{i}"] for i in range(4)]) == pytest.approx(1.0)
    assert values["gain_1"] == values["gain_3"] != values["gain_0"]
    assert values["gain_1"] / values["gain_0"] == pytest.approx(math.exp(0.3))


def test_many_equilibria_refuse_what_one_refuses() -> None:
    law = model("linear", set()).law(np.array([math.log(1e3), 0.0, 0.0]))
    with pytest.raises(SimulationError, match="no equilibrium"):
        law.equilibria(np.array([[0.0, 0.0, 0.0, 0.0], [9e6, 0.0, 0.0, 0.0]]))
    with pytest.raises(InputError, match="rows of 4"):
        law.equilibria(np.zeros(4))
