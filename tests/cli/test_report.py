"""`softbot report`: pages made again, killed runs finished."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from sim.run import RunResult
from softbot.nodes.run import run_scene


def test_a_report_is_made_again(softbot: Any, scene_file: Path) -> None:
    softbot("run", scene_file, "--out", "here")
    Path("here/report.html").unlink()
    result = softbot("report", "here")
    assert result.exit_code == 0, result.stderr
    assert "<html" in Path("here/report.html").read_text()
    assert "here/report.html" in result.stdout


def test_the_roll_is_drawn_as_one_picture(softbot: Any, scene_file: Path) -> None:
    softbot("run", scene_file, "--out", "here")
    result = softbot("report", "here", "--still", "roll.png")
    assert result.exit_code == 0, result.stderr
    assert Path("roll.png").read_bytes().startswith(b"\x89PNG")
    refused = softbot("report", "here", "--still", "roll.gif")
    assert refused.exit_code == 2
    assert "--still roll.gif: the name ends in .png" in refused.stderr


def test_a_summary_that_lacks_a_number_ends_with_2(softbot: Any, scene_file: Path) -> None:
    softbot("run", scene_file, "--out", "here")
    Path("here/summary.json").write_text("{}")
    result = softbot("report", "here")
    assert result.exit_code == 2
    assert "here/summary.json: displacement_m: missing; run the scene again" in result.stderr


def test_a_killed_run_is_finished(softbot: Any, scene_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(*args: Any, **options: Any) -> RunResult:
        show = options["progress"]

        def snapshot(t_s: float) -> None:
            show(t_s)
            if t_s > 2.15 and not Path("killed").exists():
                shutil.copytree("here", "killed")

        return run_scene(*args, **options | {"progress": snapshot})

    monkeypatch.setattr("softbot.nodes.run.run_scene", killed)
    assert softbot("run", scene_file, "--out", "here", "--set", "solver.duration_s=2.3").exit_code == 0
    result = softbot("report", "killed", "--json")
    assert result.exit_code == 0, result.stderr
    assert json.loads(result.stdout)["outcome"] == "killed"
    assert Path("killed/report.html").exists()


def test_a_folder_that_is_no_run_ends_with_2(softbot: Any, tmp_path: Path) -> None:
    result = softbot("report", tmp_path)
    assert result.exit_code == 2
    assert "softbot:" in result.stderr
