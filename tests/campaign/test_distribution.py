"""Distributions draw what they say, and refuse what they are not."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pydantic
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softbot.campaign.distribution import Drawn, drawn

ADAPTER: Any = pydantic.TypeAdapter(Drawn)


def many(value: Any, count: int = 2000, seed: int = 1) -> list[Any]:
    checked, random = ADAPTER.validate_python(value), np.random.default_rng(seed)
    return [drawn(checked, random) for _ in range(count)]


@pytest.mark.parametrize("value", [5, 2.5, "left", True])
def test_a_plain_value_stays_what_it_is(value: Any) -> None:
    assert many(value, 3) == [value] * 3
    assert type(many(value, 1)[0]) is type(value)


@given(st.floats(-1e6, 1e6), st.floats(0.0, 1e6))
def test_a_span_keeps_to_its_bounds(low: float, width: float) -> None:
    values = many({"low": low, "high": low + width}, 20)
    assert low <= min(values) <= max(values) <= low + width


def test_a_logarithmic_span_has_as_much_in_every_decade() -> None:
    exponents = np.log10(many({"low": 1e-2, "high": 1e2, "scale": "log"}, 20000))
    counts, _ = np.histogram(exponents, bins=[-2, -1, 0, 1, 2])
    np.testing.assert_allclose(counts, 5000, rtol=0.06)


def test_a_choice_keeps_its_weights() -> None:
    values = many({"choose": ["a", "b"], "weights": [1.0, 3.0]}, 20000)
    assert values.count("b") / len(values) == pytest.approx(0.75, abs=0.015)


def test_a_normal_distribution_has_its_mean_and_deviation() -> None:
    values = np.array(many({"mean": 2.0, "deviation": 0.5}, 20000))
    assert values.mean() == pytest.approx(2.0, abs=0.02)
    assert values.std() == pytest.approx(0.5, rel=0.03)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"low": 2.0, "high": 1.0}, "exchange them"),
        ({"low": 0.0, "high": 1.0, "scale": "log"}, "above zero"),
        ({"choose": []}, "at least 1"),
        ({"choose": [1, 2], "weights": [1.0]}, "1 weights for 2 values"),
        ({"choose": [1, 2], "weights": [0.0, 0.0]}, "nor all zero"),
        ({"mean": 0.0, "deviation": -1.0}, "greater than or equal to 0"),
        ({"low": math.inf, "high": math.inf}, "finite"),
        ({"lo": 1.0, "high": 2.0}, "lo"),
    ],
)
def test_what_is_no_distribution_is_refused(value: Any, message: str) -> None:
    with pytest.raises(pydantic.ValidationError, match=message):
        ADAPTER.validate_python(value)
