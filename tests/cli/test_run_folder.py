"""Which folder a run may use."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from softbot.cli.run_folder import held, is_run_folder, open_run_folder
from softbot.errors import InputError


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def _run_in(folder: Path) -> Path:
    folder.mkdir(parents=True)
    for name in ("scene.toml", "telemetry.parquet", "report.html", "bus.log", "mine.txt"):
        (folder / name).write_text("old")
    return folder


def test_without_out_the_next_free_name_is_taken() -> None:
    assert open_run_folder("roll", None) == Path("runs/roll")
    _run_in(Path("runs/other"))
    (Path("runs/roll") / "scene.toml").write_text("")
    assert open_run_folder("roll", None) == Path("runs/roll-2")
    assert open_run_folder("roll", None) == Path("runs/roll-2")  # still empty: its run never began
    assert open_run_folder("other", None) == Path("runs/other-2")


@pytest.mark.parametrize("name", ["../up", "a/b", "", "..", "sp ace"])
def test_a_scenes_name_cannot_leave_the_runs_folder(name: str) -> None:
    folder = open_run_folder(name, None)
    assert folder.resolve().parent == Path("runs").resolve()
    assert folder.resolve() != Path("runs").resolve()


def test_an_earlier_run_in_out_stays_until_the_new_one_starts() -> None:
    folder = _run_in(Path("mine"))
    assert open_run_folder("roll", folder) == folder
    assert {path.name for path in folder.iterdir()} == {
        "scene.toml", "telemetry.parquet", "report.html", "bus.log", "mine.txt"
    }  # fmt: skip


def test_a_folder_of_something_else_is_refused() -> None:
    Path("photos").mkdir()
    Path("photos/cat.png").write_text("cat")
    with pytest.raises(InputError, match="--out photos: holds files and no run"):
        open_run_folder("roll", Path("photos"))


def test_a_file_is_refused() -> None:
    Path("file").write_text("")
    with pytest.raises(InputError, match="--out file: is a file"):
        open_run_folder("roll", Path("file"))
    with pytest.raises(InputError, match=r"file/below: cannot be made: .*; choose another --out"):
        open_run_folder("roll", Path("file/below"))


def test_a_killed_run_is_a_run(tmp_path: Path) -> None:
    for name in ("scene.toml", "telemetry.arrow"):
        assert not is_run_folder(tmp_path)
        (tmp_path / name).write_text("")
    assert is_run_folder(tmp_path)


def test_a_folder_that_another_run_writes_is_refused_until_that_one_ends(tmp_path: Path) -> None:
    with held(tmp_path):
        with pytest.raises(InputError, match="another run is writing there"), held(tmp_path):
            raise AssertionError("it was let in")
        code = (
            "import sys; from pathlib import Path; from softbot.cli.run_folder import held\n"
            "with held(Path(sys.argv[1])): pass"
        )
        other = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=False)
        assert "another run is writing there" in other.stderr
    with held(tmp_path):
        pass
