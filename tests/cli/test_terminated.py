"""SIGTERM, or the loss of the terminal, ends a run as Ctrl-C does: safe, with its summary and its report."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

SOFTBOT = "import sys; from softbot.cli import main; sys.argv = ['softbot', *sys.argv[1:]]; main()"
PLANT = ("plant", "--interface", "virtual", "--channel", "terminated")


def begun(command: list[str], folder: Path) -> list[str]:
    """Arguments of a run of an hour, or of what else a command does with a scene."""
    return [sys.executable, "-c", SOFTBOT, *command, "--set", "solver.duration_s=3600", "--out", str(folder)]


def wait_until_under_way(folder: Path, alive: Callable[[], bool]) -> None:
    """Until some seconds of it are on disk."""
    deadline_s = time.monotonic() + 120.0
    stream = folder / "telemetry.arrow"
    while not (stream.exists() and stream.stat().st_size > 40_000):
        assert alive()
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


def check_finished(folder: Path) -> None:
    """Broken off, but complete."""
    assert json.loads((folder / "summary.json").read_text())["outcome"] == "interrupted"
    assert (folder / "report.html").exists()


@pytest.mark.slow  # a process of its own designs the pressure loop anew
@pytest.mark.parametrize(("command", "status"), [(["run"], 143), (PLANT, 0)])
def test_a_run_that_is_terminated_is_finished(
    scene_file: Path, tmp_path: Path, command: Sequence[str], status: int
) -> None:
    folder = tmp_path / "here"
    process = subprocess.Popen(
        begun([*command, str(scene_file)], folder),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")},
    )
    wait_until_under_way(folder, lambda: process.poll() is None)
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=60.0)
    assert process.returncode == status, said
    check_finished(folder)
    assert "Traceback" not in said


@pytest.mark.slow  # as above
@pytest.mark.parametrize(("command", "status"), [(["run"], 129), (PLANT, 0)])
def test_a_run_whose_terminal_is_gone_is_finished(
    scene_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Sequence[str], status: int
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / "here"
    terminal, its_end = pty.openpty()
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored where the tests go on without a terminal
    process = subprocess.Popen(  # the first terminal that the leader of a session opens is its own
        ["sh", "-c", 'exec "$@" <"$0" >"$0" 2>&1', os.ttyname(its_end), *begun([*command, str(scene_file)], folder)],
        start_new_session=True,
    )
    signal.signal(signal.SIGHUP, before)
    os.set_blocking(terminal, False)

    def alive() -> bool:
        with contextlib.suppress(BlockingIOError):
            os.read(terminal, 65536)
        return process.poll() is None

    wait_until_under_way(folder, alive)
    os.close(terminal)
    process.send_signal(signal.SIGHUP)  # the shell says it, too
    os.close(its_end)  # not before: a terminal that nobody has open cannot be read
    assert process.wait(timeout=60.0) == status
    check_finished(folder)
