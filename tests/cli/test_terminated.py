"""SIGTERM ends a run as Ctrl-C does: safe, with its summary and its report."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

SOFTBOT = "import sys; from softbot.cli import main; sys.argv = ['softbot', *sys.argv[1:]]; main()"

LONG = ("--set", "solver.duration_s=3600")


@pytest.mark.slow  # a process of its own designs the pressure loop anew
@pytest.mark.parametrize(
    ("command", "status"),
    [(["run"], 143), (["plant", "--interface", "virtual", "--channel", "terminated"], 0)],
)
def test_a_run_that_is_terminated_is_finished(
    scene_file: Path, tmp_path: Path, command: list[str], status: int
) -> None:
    folder = tmp_path / "here"
    process = subprocess.Popen(
        [
            sys.executable,
            "-c",
            SOFTBOT,
            *command,
            str(scene_file),
            "--set",
            "solver.duration_s=3600",
            "--out",
            str(folder),
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")},
    )
    deadline_s = time.monotonic() + 120.0
    stream = folder / "telemetry.arrow"
    while not (stream.exists() and stream.stat().st_size > 40_000):  # some seconds of it
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=60.0)
    assert process.returncode == status, said
    assert json.loads((folder / "summary.json").read_text())["outcome"] == "interrupted"
    assert (folder / "report.html").exists()
    assert "Traceback" not in said
