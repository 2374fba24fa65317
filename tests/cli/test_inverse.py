"""`softbot inverse`: answers, evidence, and what it refuses."""

from __future__ import annotations

import json
from typing import Any

import pytest

HYSTERESIS = "memory.hysteresis={thresholds_Pa = [5e3, 2e4], weights = [0.2, 0.2], unloading_slope = 1.2}"


def test_pressures_for_a_bend_and_a_length(softbot: Any) -> None:
    result = softbot("inverse", "default", "--bend-deg", 20, "--direction-deg", 30, "--length-mm", 150, "--json")
    assert result.exit_code == 0, result.stderr
    answer = json.loads(result.stdout)
    assert answer["bend_reached"] is answer["length_reached"] is True
    assert answer["bend_deg"] == pytest.approx(20.0, abs=0.01)
    assert answer["direction_deg"] == pytest.approx(30.0, abs=0.1)
    assert answer["length_mm"] == pytest.approx(150.0, abs=0.01)
    shown = softbot("inverse", "default", "--bend-deg", 20, "--direction-deg", 180, "--dead", 0, "--set", HYSTERESIS)
    assert "bend_reached: False" in shown.stdout  # chamber 0 alone bends that way
    assert "pressure_kPa: 0.00, 0.00, 0.00, 0.00" in shown.stdout


@pytest.mark.parametrize("chamber", range(4))
def test_a_bend_along_an_axis_takes_one_chamber(softbot: Any, chamber: int) -> None:
    towards = ("--bend-deg", 30, "--direction-deg", 90 * chamber - 180, "--set", "actuator.dead_band_Pa=3000")
    answer = json.loads(softbot("inverse", "default", *towards, "--json").stdout)
    assert answer["bend_deg"] == pytest.approx(30.0, abs=0.01)
    assert [n for n, one in enumerate(answer["pressure_kPa"]) if one != 0.0] == [chamber]
    assert answer["direction_deg"] == pytest.approx((180.0, -90.0, 0.0, 90.0)[chamber], abs=1e-6)
    assert answer["length_reached"] is None
    shown = softbot("inverse", "default", *towards).stdout
    assert "length_mm: " in shown
    assert "length_reached" not in shown  # no length was asked for
    assert "-0.00" not in shown


def test_check_prints_errors_within_the_bounds_that_are_promised(softbot: Any) -> None:
    answer = json.loads(softbot("inverse", "default", "--check", "--json").stdout)
    assert {tuple(one["dead"]) for one in answer["workspace"]} >= {(), (0,), (1,), (2,), (3,), (0, 2)}
    for one in answer["workspace"]:
        assert one["samples"] > 200
        assert max(one["bend_percent"], one["bend_with_stretch_percent"], one["stretch_percent"]) <= 1.0
    assert answer["compensation"]["ratio"] <= 1.0 / 3.0
    assert answer["compensation"]["with_percent"] < 0.01
    assert answer["compensation"]["without_percent"] > 2.0
    assert "made up" in answer["hysteresis"]
    own = softbot("inverse", "default", "--check", "--set", HYSTERESIS)
    assert own.exit_code == 0, own.stderr
    assert "the robot's own" in own.stdout


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--dead", 4), "name chambers of 0 to 3"),
        (("--bend-deg", "nan"), "--bend-deg nan: give a finite number"),
        (("--bend-deg", 360), "--bend-deg 360: at 360 the arc is a full circle"),
        (("--bend-deg", -400), "--bend-deg -400: at 360 the arc is a full circle"),
        (("--direction-deg", "inf"), "--direction-deg inf: give a finite number"),
        (("--length-mm", 0), "stretch = 0"),
        (("--set", "actuator.gains=[1, 1]"), "actuator.gains"),
    ],
)
def test_wrong_questions_are_refused(softbot: Any, arguments: tuple[Any, ...], says: str) -> None:
    result = softbot("inverse", "default", *arguments)
    assert result.exit_code == 2
    assert says in result.stderr
