"""The valve board's loop: the volume it is designed for, and gains that are designed once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from controllers.pressure_loop import PressureLoopGains
from controllers.pressure_loop_design import PressureLoopDesign
from softbot.nodes import valve_loop
from softbot.nodes.valve_loop import ValveLoop, cache_folder, designed_gains, nominal_volumes_m3
from softbot.robot import Robot, load_robot
from softbot.sensing import Readings


@pytest.fixture
def robot() -> Robot:
    return load_robot("default")


@pytest.fixture
def designs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, gains: PressureLoopGains) -> list[Robot]:
    """The robots whose loop was designed, in a cache folder of their own, by a design that takes no time."""
    asked: list[Robot] = []

    def design(robot: Robot) -> PressureLoopDesign:
        asked.append(robot)
        return PressureLoopDesign(gains, ())

    monkeypatch.setattr(valve_loop, "design", design)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return asked


def test_nominal_volume_is_the_gas_a_chamber_takes_for_a_pascal(robot: Robot) -> None:
    """V + p dV/dp is the derivative of p V, taken here by differences."""
    law, half_Pa, step_Pa = robot.actuator_law(), 0.5 * robot.max_pressure_Pa, 10.0
    atmosphere = robot.pneumatics.atmospheric_pressure_absolute_Pa

    def content_J(chamber: int, pressure_Pa: float) -> float:
        pressure = np.zeros(4)
        pressure[chamber] = pressure_Pa
        rest = law.equilibrium(pressure)
        volume = law.chamber_volumes_m3(robot.length_m, rest.stretch, rest.curvature_1_m)[chamber]
        return float((pressure_Pa + atmosphere) * volume)

    for chamber, volume in enumerate(nominal_volumes_m3(robot)):
        slope = (content_J(chamber, half_Pa + step_Pa) - content_J(chamber, half_Pa - step_Pa)) / (2.0 * step_Pa)
        assert volume == pytest.approx(slope, rel=1e-6)


def test_gains_are_designed_once_and_kept(robot: Robot, designs: list[Robot]) -> None:
    first = designed_gains(robot)
    assert designed_gains(robot) == first
    assert len(designs) == 1
    assert len(list(cache_folder().iterdir())) == 1


def test_the_last_bits_of_a_design_do_not_reach_the_loop(
    robot: Robot, designs: list[Robot], gains: PressureLoopGains, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise the same scene would not give the same bytes on another machine."""
    other = replace(gains, proportional_1_s=gains.proportional_1_s * (1.0 + 1e-12))
    monkeypatch.setattr(valve_loop, "design", lambda robot: PressureLoopDesign(other, ()))
    assert designed_gains(robot) == gains


def test_another_pneumatics_is_designed_anew(robot: Robot, designs: list[Robot]) -> None:
    designed_gains(robot)
    slower = robot.model_dump(by_alias=True, exclude_none=True)
    slower["pneumatics"]["valve_lag_s"] = 0.02
    designed_gains(Robot.model_validate(slower))
    assert len(designs) == 2


@pytest.mark.parametrize("damage", ["", "{", "[]", '{"proportional_1_s": -1}', '{"speed": 1}'])
def test_a_damaged_cache_is_designed_over(robot: Robot, designs: list[Robot], damage: str) -> None:
    gains = designed_gains(robot)
    (kept,) = cache_folder().iterdir()
    kept.write_text(damage)
    assert designed_gains(robot) == gains
    assert len(designs) == 2
    assert designed_gains(robot) == gains
    assert len(designs) == 2


def test_a_cache_that_cannot_be_written_costs_only_time(
    robot: Robot, designs: list[Robot], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gains: PressureLoopGains
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert designed_gains(robot) == gains
    assert designed_gains(robot) == gains
    assert len(designs) == 2


def test_cache_folder_is_the_users_without_xdg(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for unset in ("", "relative/path"):  # the XDG specification: relative paths are to be ignored
        monkeypatch.setenv("XDG_CACHE_HOME", unset)
        assert cache_folder() == tmp_path / ".cache" / "softbot"


def test_the_design_keeps_its_margins_for_the_default_robot(robot: Robot) -> None:
    design = valve_loop.design(robot)
    assert design.stable
    assert design.phase_margin_deg >= 55.0
    assert design.gain_margin_dB >= 8.0


def test_a_chamber_below_its_setpoint_is_filled_and_one_above_is_vented(robot: Robot, gains: PressureLoopGains) -> None:
    loop = ValveLoop(robot, gains)
    measured = np.array([10e3, 60e3, 40e3, 0.0])
    loop.rest(measured)
    readings = Readings(0.0, measured, 250e3, np.zeros(3), np.zeros(3), np.zeros(4))
    for _ in range(5):
        opening = loop.openings(np.array([40e3, 40e3, 40e3, 0.0]), readings)
    assert opening[0] > 0.0 > opening[1]
    assert opening[2] == 0.0  # at its setpoint: shut
    assert opening[3] == -1.0  # empty and to be empty: open to the atmosphere
