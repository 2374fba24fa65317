"""The command as a whole: quick to answer, one message for a failure, a clean standard output."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from firmware_protocol.errors import BusError
from softbot import __version__
from softbot.cli import main
from softbot.cli.exit_status import with_exit_status
from softbot.cli.streams import messages, nothing_printed, progress_bar
from softbot.errors import InputError, SimulationError, SoftbotError
from softbot.interruption import Terminated

COMMANDS = ("demo", "run", "report", "calibrate", "pressure-loop", "plant", "sequence", "campaign", "bench", "figure")


def _python(code: str, *arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=300,
        env=os.environ | environment,
    )


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys, softbot.cli.app\n"
        "heavy = {'numpy', 'scipy', 'numba', 'pybullet', 'pyarrow', 'pydantic', 'matplotlib', 'can', 'cantools'}\n"
        "heavy |= {'rich', 'control'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    result = _python(code)
    assert result.stdout.strip() == "[]", result.stdout + result.stderr


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_every_command_explains_itself(softbot: Any, command: str) -> None:
    result = softbot(*command.split(), "--help")
    assert result.exit_code == 0
    for name in COMMANDS if not command else ("Usage", "--help"):
        assert name in result.stdout


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["--version"]])
def test_what_a_full_disk_does_not_take_is_no_traceback(arguments: list[str]) -> None:
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-c", "import softbot.cli; softbot.cli.main()", *arguments]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=300)
    assert done.stderr == "softbot: No space left on device\n"
    assert done.returncode == 2


def test_version(softbot: Any) -> None:
    assert softbot("--version").stdout == f"softbot {__version__}\n"


def test_main_is_the_command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["softbot", "--version"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("softbot ")


def test_a_whole_process_prints_one_json_object_whatever_libraries_say(scene_file: Path) -> None:
    """In a process of its own, where PyBullet greets: standard output stays clean, and main() is what runs."""
    code = "import sys; sys.argv[0] = 'softbot'; from softbot.cli import main; main()"
    cache = scene_file.parent / "cache"
    kept = cache / "softbot"
    kept.mkdir(parents=True)
    curvature = ['drive={kind="curvature", curvature_1_m=8.0}', "fault=[]", "solver.duration_s=0.2"]
    curvature.append("metrics.steady_after_s=0.1")
    sets = [part for assignment in curvature for part in ("--set", assignment)]
    asked = (code, "run", scene_file, "--out", scene_file.parent / "out", "--json", *sets)
    _python(*asked, XDG_CACHE_HOME=str(cache))  # the first on a machine compiles, and says so
    result = _python(*asked, XDG_CACHE_HOME=str(cache))
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["schema"] == "softbot-summary-1"
    assert result.stdout.count("\n{") == 0
    assert result.stderr == ""
    bad = _python(code, "run", scene_file, "--set", "solver.twin=maglev")
    assert bad.returncode == 2
    assert "solver.twin = 'maglev'" in bad.stderr


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (InputError("bad"), 2),
        (SimulationError("bad"), 3),
        (SoftbotError("bad"), 1),
        (BusError("bad"), 2),
        (KeyboardInterrupt(), 130),
    ],
)
def test_each_failure_has_its_exit_status_and_one_message(error: BaseException, status: int) -> None:
    app = typer.Typer()

    def command() -> None:
        raise error

    app.command()(with_exit_status(command))
    result = CliRunner().invoke(app, [])
    assert result.exit_code == status
    assert result.stderr == ("softbot: interrupted\n" if status == 130 else "softbot: bad\n")
    assert result.stdout == ""


def test_an_error_nobody_foresaw_is_not_hidden() -> None:
    app = typer.Typer()

    def command() -> None:
        raise ZeroDivisionError

    app.command()(with_exit_status(command))
    assert isinstance(CliRunner().invoke(app, []).exception, ZeroDivisionError)


@pytest.mark.parametrize(("interruption", "status"), [(KeyboardInterrupt, 130), (Terminated, 143)])
def test_an_error_in_the_wake_of_an_interruption_is_the_interruption(
    interruption: type[BaseException], status: int
) -> None:
    app = typer.Typer()

    def command() -> None:
        try:
            raise interruption
        finally:
            raise RuntimeError("no compiled object yet")

    app.command()(with_exit_status(command))
    assert CliRunner().invoke(app, []).exit_code == status


def test_what_libraries_print_is_kept_off_standard_output(capfd: pytest.CaptureFixture[str]) -> None:
    with nothing_printed(quiet=False):
        os.write(1, b"greeting")
    with nothing_printed():
        os.write(1, b"unheard")
        os.write(2, b"unheard")
    os.write(1, b"answer")
    out, err = capfd.readouterr()
    assert (out, err) == ("answer", "greeting")


def test_progress_is_silent_without_a_terminal(capfd: pytest.CaptureFixture[str]) -> None:
    with progress_bar("rolling", 1.0) as show, messages().status("thinking"):
        show(0.5)
    assert capfd.readouterr() == ("", "")


def test_progress_is_shown_on_a_terminal(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    with progress_bar("rolling", 1.0) as show:
        show(0.5)
    out, err = capfd.readouterr()
    assert out == ""
    assert "rolling" in err
    assert "0.5 of 1.0 s" in err
