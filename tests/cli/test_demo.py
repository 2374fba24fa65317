"""`softbot demo`: the shipped scene with the robot calibrated from the shipped table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from calib.calibration import Calibration
from softbot.cli.demo import ROBOT_NAME, calibrate_shipped_table, demo_scene
from softbot.robot import load_robot


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return calibrate_shipped_table()


def test_the_demo_calibrates_the_default_robot(calibration: Calibration) -> None:
    assert calibration.robot(ROBOT_NAME) == load_robot("default")


def test_the_scene_is_the_papers_experiment(calibration: Calibration) -> None:
    scene = demo_scene(calibration)
    assert scene.drive.kind == "sequencer"
    assert scene.sequencer.recovery
    assert [(fault.kind, fault.chamber) for fault in scene.fault] == [("rupture", 2)]
    assert scene.sequencer.start_s + 5.0 < scene.fault[0].t_s < scene.solver.duration_s - 10.0
    assert not demo_scene(calibration, ("sequencer.recovery=false",)).sequencer.recovery
    assert demo_scene(calibration, ("fault.0.chamber=3",)).fault[0].chamber == 3


def test_a_demo_writes_a_run_folder_with_the_calibration_in_it(softbot: Any) -> None:
    short = [
        part
        for assignment in ("solver.duration_s=0.3", "solver.segments=4", "metrics.steady_after_s=0.1")
        for part in ("--set", assignment)
    ]
    result = softbot("demo", "--out", "here", *short)
    assert result.exit_code == 0, result.stderr
    assert "Calibrated asu_four_chamber_arm on 6 loading rows" in result.stdout
    for name in ("robot.toml", "calibration.png", "summary.json", "report.html", "bus.log"):
        assert (Path("here") / name).exists(), name
    assert load_robot("here/robot.toml") == load_robot("default")
    again = softbot("demo", "--out", "here", "--json", *short)
    assert again.exit_code == 0, again.stderr
    assert json.loads(again.stdout)["scene"] == "demo"


def test_limits_without_room_are_refused_before_a_folder_is_made(softbot: Any) -> None:
    result = softbot("demo", "--set", "robot.pneumatics.max_chamber_pressure_Pa=1e5", "--out", "here")
    assert result.exit_code == 2
    assert "robot.pneumatics.max_chamber_pressure_Pa = 100000" in result.stderr
    assert not Path("here").exists()


def test_a_wrong_key_ends_with_2(softbot: Any) -> None:
    result = softbot("demo", "--set", "sequencer.sped=1")
    assert result.exit_code == 2
    assert "sequencer.sped" in result.stderr
    assert not Path("runs").exists()
