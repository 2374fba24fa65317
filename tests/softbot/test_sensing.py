"""Sensor parameters: a table of a robot file that holds only what a sensor can have."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import pydantic
import pytest

from softbot.sensing import SensorParameters

NAMES = [item.name for item in fields(SensorParameters)]
adapter = pydantic.TypeAdapter(SensorParameters)


@pytest.mark.parametrize("name", NAMES)
def test_every_parameter_may_be_zero_and_none_negative_or_nan(name: str) -> None:
    assert getattr(SensorParameters(**{name: 0.0}), name) == 0.0
    for wrong in (-1e-9, math.nan):
        with pytest.raises(ValueError, match=f"{name} must be zero or positive"):
            SensorParameters(**{name: wrong})


@pytest.mark.parametrize(
    "table", [{"gyro_noise_deg_s": 1.0}, {"pressure_noise_Pa": math.inf}, {"gyro_bias_rad_s": "x"}]
)
def test_table_of_a_file_with_anything_else_is_refused(table: dict[str, Any]) -> None:
    with pytest.raises(pydantic.ValidationError):
        adapter.validate_python(table)


def test_table_and_parameters_go_both_ways() -> None:
    own = SensorParameters(pressure_noise_Pa=12.5, gyro_bias_rad_s=0.0)
    assert adapter.validate_python(adapter.dump_python(own)) == own
