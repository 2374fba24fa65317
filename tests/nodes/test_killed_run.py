"""A run that was killed is finished from what it left: here, from a copy of its folder taken while it ran."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from controllers.pressure_loop import PressureLoopGains
from sim.scene import Scene
from sim.telemetry import read_telemetry
from softbot.errors import InputError
from softbot.nodes.killed_run import finish_killed_run, was_killed
from softbot.nodes.lockstep import run_lockstep
from softbot.report import write_report


@pytest.fixture
def leave(make_scene: Callable[..., Scene], scripted: Any, gains: PressureLoopGains, tmp_path: Path) -> Any:
    """The folder that a run leaves when it is killed at a time."""

    def go(killed_s: float) -> Path:
        fault = 'fault=[{t_s = 0.3, chamber = 1, kind = "rupture"}, {t_s = 5.0, chamber = 0, kind = "leak"}]'
        scene = make_scene(f"solver.duration_s={killed_s + 0.1}", fault)
        copy = tmp_path / "left"

        def snapshot(t_s: float) -> None:
            if t_s >= killed_s and not copy.exists():
                shutil.copytree(tmp_path / "run", copy)

        sequencer = scripted(script={0.42: (1, "rupture")})
        run_lockstep(scene, tmp_path / "run", sequencer=sequencer, gains=gains, progress=snapshot)
        return copy

    return go


def test_what_was_on_disk_becomes_a_whole_run_folder(leave: Any) -> None:
    left = leave(2.2)
    assert was_killed(left)
    summary = finish_killed_run(left)
    assert summary["outcome"] == "killed"
    assert read_telemetry(left).num_rows == 200  # whole blocks of rows of the 220
    assert summary["sim_time_s"] == pytest.approx(2.0)
    assert summary["steps"] == 400
    assert summary["real_time_factor"] is None
    assert [fault["chamber"] for fault in summary["faults"]] == [1]  # the leak at 5 s never came
    assert summary["detections"][0]["delay_s"] == pytest.approx(0.12, abs=0.011)
    assert json.loads((left / "summary.json").read_text())["detections"][0]["kind"] == "rupture"
    assert write_report(left).exists()


def test_finishing_again_does_no_harm(leave: Any) -> None:
    left = leave(1.2)
    made = ("summary.json", "telemetry.parquet", "shape.parquet")
    finish_killed_run(left)
    first = [(left / name).read_bytes() for name in made]
    assert was_killed(left)
    finish_killed_run(left)
    assert [(left / name).read_bytes() for name in made] == first


def test_a_finished_run_was_not_killed(leave: Any) -> None:
    left = leave(1.2)
    assert not was_killed(left.parent / "run")


def test_a_run_killed_before_anything_was_written_says_so(leave: Any) -> None:
    left = leave(0.2)
    with pytest.raises(InputError, match="run it again"):
        finish_killed_run(left)


def test_a_damaged_bus_log_costs_the_findings_only(leave: Any) -> None:
    left = leave(1.2)
    (left / "bus.log").write_text("not a log\n")
    summary = finish_killed_run(left)
    assert summary["detections"] == []
    assert summary["missed_faults"] == 1


@pytest.mark.parametrize("blocked", ["telemetry.parquet", "summary.json.partial"])
def test_a_folder_that_cannot_be_written_says_so(leave: Any, blocked: str) -> None:
    left = leave(1.2)
    (left / blocked).mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        finish_killed_run(left)
