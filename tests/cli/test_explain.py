"""`softbot run --explain`: how a scene would be solved, without solving it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

ROLL = """
[robot]
length_m = 0.15
radius_m = 0.01
mass_kg = 0.0518
bending_stiffness_N_m2 = 3.93e-3
[drive]
kind = "curvature"
curvature_1_m = 12.0
"""


@pytest.fixture
def roll(tmp_path: Path) -> Path:
    """The design's slow roll."""
    path = tmp_path / "roll.toml"
    path.write_text(ROLL)
    return path


def test_the_plan_is_printed_and_nothing_is_run(softbot: Any, roll: Path) -> None:
    result = softbot("run", roll, "--explain")
    assert result.exit_code == 0, result.stderr
    words = " ".join(result.stdout.split())
    assert "rod twin, accuracy standard: errors up to 0.5 %" in words
    for expected in ("modes", "points", "step", "mirror", "pneumatics"):
        assert expected in words
    assert not Path("runs").exists()


def test_json_is_one_object_with_a_reason_for_every_rule(softbot: Any, roll: Path) -> None:
    result = softbot("run", roll, "--explain", "--json", "--set", 'solver.accuracy="reference"')
    found = json.loads(result.stdout)
    assert found["accuracy"] == "reference"
    assert found["resolution"]["target"] == 0.0005
    assert found["resolution"]["modes"]["given"] is False
    assert all(rule["reason"] and isinstance(rule["left_out"], bool) for rule in found["rules"])


def test_what_the_scene_states_is_called_given(softbot: Any, roll: Path) -> None:
    result = softbot("run", roll, "--explain", "--set", "solver.modes=4")
    assert "given in the scene" in " ".join(result.stdout.split())


def test_a_target_that_is_not_reached_is_not_promised(softbot: Any, roll: Path) -> None:
    result = softbot("run", roll, "--explain", "--set", "solver.modes=1", "--set", 'solver.accuracy="reference"')
    words = " ".join(result.stdout.split())
    assert "errors up to 0.05 % asked for, " in words
    assert "estimated with what the scene states" in words


def test_the_segment_twin_leaves_nothing_out(softbot: Any, roll: Path) -> None:
    result = softbot("run", roll, "--explain", "--set", 'solver.twin="bullet"')
    assert result.exit_code == 0
    assert "segment twin, 10 segments" in result.stdout
    result = softbot("run", roll, "--explain", "--json", "--set", 'solver.twin="bullet"')
    assert json.loads(result.stdout)["rules"] == []


def test_bad_input_is_refused_as_in_a_run(softbot: Any, roll: Path) -> None:
    result = softbot("run", roll, "--explain", "--set", "drive.period_s=0.005", "--set", "solver.step_s=0.001")
    assert result.exit_code == 2
    assert "fewer than 10 steps" in result.stderr


def test_a_rest_is_told_in_words(softbot: Any, roll: Path) -> None:
    result = softbot("run", roll, "--out", "here", "--set", "solver.question=equilibrium")
    assert result.exit_code == 0, result.stderr
    words = " ".join(result.stdout.split())
    assert "Comes to rest bent by 99." in words
    assert "of the radius a step" in words
    assert json.loads(Path("here/summary.json").read_text())["equilibrium"]["iterations"] > 3
