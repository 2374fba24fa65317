"""`softbot pressure-loop`: the margins of a robot's loop, for a person and for a program."""

from __future__ import annotations

import json
from typing import Any

import pytest

from controllers.pressure_loop import PressureLoopGains
from controllers.pressure_loop_design import PressureLoopDesign, analyse_pressure_loop
from softbot.nodes import valve_loop
from softbot.nodes.valve_loop import nominal_volumes_m3
from softbot.robot import Robot


@pytest.fixture
def quick(softbot: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The command with a design of given gains at three operating points, which takes no time."""
    gains = PressureLoopGains(proportional_1_s=18.0, integral_1_s2=16.0, sample_s=0.01, model_lag_s=0.03)

    def design(robot: Robot) -> PressureLoopDesign:
        volume = float(nominal_volumes_m3(robot).mean())
        return analyse_pressure_loop(robot.pneumatics, volume, gains, (60e3,), volume_ratios=(1.0,))

    monkeypatch.setattr(valve_loop, "design", design)
    return softbot


def test_margins_are_printed_with_the_worst_of_them(quick: Any) -> None:
    result = quick("pressure-loop", "default")
    assert result.exit_code == 0, result.stderr
    assert "k_p = 18.00 1/s" in result.stdout
    assert "setpoint at most 600 kPa/s" in result.stdout
    assert "worst: gain margin" in result.stdout
    assert "stable everywhere" in result.stdout


def test_json_has_the_same_numbers(quick: Any) -> None:
    answer = json.loads(quick("pressure-loop", "--json").stdout)
    assert answer["gains"]["proportional_1_s"] == 18.0
    assert answer["stable"] is True
    assert answer["phase_margin_deg"] == min(point["phase_margin_deg"] for point in answer["points"])


def test_a_robot_that_is_not_there_ends_with_2(quick: Any) -> None:
    result = quick("pressure-loop", "nowhere.toml")
    assert result.exit_code == 2
    assert "nowhere.toml: no such file" in result.stderr
