"""`softbot run`: what it writes, what it prints, and how it ends."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

from softbot.errors import SimulationError


def test_a_run_is_reported_in_words_and_files(softbot: Any, scene_file: Path) -> None:
    result = softbot("run", scene_file, "--out", "here")
    assert result.exit_code == 0, result.stderr
    for name in ("summary.json", "telemetry.parquet", "shape.parquet", "scene.toml", "bus.log", "report.html"):
        assert (Path("here") / name).exists(), name
        if name in ("telemetry.parquet", "bus.log", "report.html"):
            assert f"here/{name}" in result.stdout
    assert "chamber 2" in result.stdout
    assert "got a leak" in " ".join(result.stdout.split())


def test_json_is_the_summary_and_nothing_else(softbot: Any, scene_file: Path) -> None:
    result = softbot("run", scene_file, "--out", "here", "--json", "--set", "sequencer.recovery=false")
    assert result.exit_code == 0, result.stderr
    assert json.loads(result.stdout) == json.loads(Path("here/summary.json").read_text())
    assert "recovery = false" in Path("here/scene.toml").read_text()


def test_without_out_no_run_is_overwritten(softbot: Any, scene_file: Path) -> None:
    for _ in range(2):
        assert softbot("run", scene_file, "--set", "solver.duration_s=0.3").exit_code == 0
    assert sorted(path.name for path in Path("runs").iterdir()) == ["short", "short-2"]


@pytest.mark.parametrize(
    ("assignment", "words"),
    [
        ("sequencer.sped_rev_s=1", ["short.toml", "sequencer.sped_rev_s", "did you mean speed_rev_s"]),
        ("world.friction=-1", ["short.toml", "world.friction"]),
        ("solver.step_s=0.003", ["solver.step_s", "divide the control period"]),
        (
            "robot.pneumatics.max_chamber_pressure_Pa=1e5",
            ["short.toml: robot.pneumatics.max_chamber_pressure_Pa", "raise the one"],
        ),
    ],
)
def test_bad_input_is_named_and_ends_with_2(softbot: Any, scene_file: Path, assignment: str, words: list[str]) -> None:
    result = softbot("run", scene_file, "--json", "--set", assignment)
    assert result.exit_code == 2
    assert result.stdout == ""
    for word in words:
        assert word in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize("command", ["run", "plant"])
def test_limits_without_room_are_named_by_the_robots_own_file(softbot: Any, scene_file: Path, command: str) -> None:
    robot = (files("softbot") / "data" / "default_robot.toml").read_text("utf-8")
    Path("tight.toml").write_text(robot + "\n[pneumatics]\nmax_chamber_pressure_Pa = 50e3\n", "utf-8")
    result = softbot(command, scene_file, "--set", "robot=tight.toml")
    assert result.exit_code == 2
    assert "tight.toml: pneumatics.max_chamber_pressure_Pa = 50000" in result.stderr
    assert "Pa (actuator.max_pressure_Pa)" in result.stderr
    assert not Path("runs").exists()


def test_a_scene_that_is_not_there_ends_with_2(softbot: Any) -> None:
    result = softbot("run", "nowhere.toml")
    assert result.exit_code == 2
    assert "nowhere.toml: no such file" in result.stderr


def test_a_failed_simulation_ends_with_3_and_keeps_the_recording(
    softbot: Any, scene_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any) -> None:
        raise SimulationError("the tube left the room")

    monkeypatch.setattr("sim.plant.Plant.read_sensors", fail)
    monkeypatch.setattr("softbot.nodes.warm_up.warm_up", lambda scene: None)
    monkeypatch.setattr("softbot.nodes.run.warm_up", lambda scene: None)
    result = softbot("run", scene_file, "--out", "here", "--json")
    assert result.exit_code == 3
    assert result.stdout == ""
    assert "the tube left the room" in result.stderr
    assert "what was recorded is kept in here" in result.stderr
    assert "failed: the tube left the room" in Path("here/summary.json").read_text()


def test_an_interrupted_run_ends_with_130(softbot: Any, scene_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("softbot.nodes.run.run_scene", interrupt)
    result = softbot("run", scene_file, "--out", "here")
    assert result.exit_code == 130
    assert "softbot: interrupted" in result.stderr
    assert "kept" not in result.stderr  # nothing was


def test_wall_clock_holds_the_run_back(softbot: Any, scene_file: Path) -> None:
    assert softbot("run", scene_file, "--out", "here", "--wall-clock").exit_code == 0
    assert json.loads(Path("here/summary.json").read_text())["sim_time_s"] == pytest.approx(0.5)


def test_a_window_is_for_the_segment_twin_only(softbot: Any, scene_file: Path) -> None:
    result = softbot("run", scene_file, "--gui", "--set", "drive.kind=curvature", "--set", 'solver.twin="rod"')
    assert result.exit_code == 2


def test_a_start_that_fails_leaves_the_earlier_run_alone(softbot: Any, scene_file: Path) -> None:
    assert softbot("run", scene_file, "--out", "kept").exit_code == 0
    before = {path.name: path.read_bytes() for path in Path("kept").iterdir()}
    for assignment in ("sequencer.co_contraction_Pa=1e6", "robot.pneumatics.max_chamber_pressure_Pa=1e5"):
        result = softbot("run", scene_file, "--out", "kept", "--set", assignment)
        assert result.exit_code == 2
        assert assignment.split("=")[0].split(".")[-1] in result.stderr
    assert softbot("plant", scene_file, "--interface", "nope", "--out", "kept").exit_code == 2
    assert {path.name: path.read_bytes() for path in Path("kept").iterdir()} == before


def test_a_path_that_no_file_system_takes_ends_with_2(softbot: Any, scene_file: Path) -> None:
    result = softbot("run", scene_file, "--out", "x" * 300)
    assert result.exit_code == 2
    assert "too long" in result.stderr


def test_a_sequencer_needs_a_time_that_is_one(softbot: Any, scene_file: Path) -> None:
    for wrong in ("nan", "-1", "0", "inf"):
        result = softbot("sequence", scene_file, "--interface", "virtual", f"--duration-s={wrong}")
        assert result.exit_code == 2
        assert "--duration-s" in result.stderr
