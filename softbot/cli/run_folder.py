"""Where a run goes: a new folder under `runs/`, or the one that `--out` names.

Without `--out` nothing is ever overwritten: `runs/NAME`, then `runs/NAME-2` and so on. With `--out` the folder is the
user's choice: an earlier run in it is replaced, but a folder that holds anything else and no run is refused.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from softbot.errors import InputError

RUNS = Path("runs")


def open_run_folder(name: str, out: Path | None) -> Path:
    """The folder of a run of scene `name`, made. An earlier run in it stays until the new one really starts.

    Raises InputError when `out` is a file or a folder of something else, or cannot be made.
    """
    folder = _new_folder(name) if out is None else out
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--out {folder}: is a file; name a folder")
    if folder.is_dir() and any(folder.iterdir()) and not is_run_folder(folder):
        raise InputError(f"--out {folder}: holds files and no run, so nothing is written there; name another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}; choose another --out") from None
    return folder


@contextlib.contextmanager
def held(folder: Path) -> Iterator[None]:
    """The folder is this process's alone while the inside runs. Raises InputError when another run is writing there.

    A file system without locks holds nobody back.
    """
    number = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(number)
        raise InputError(f"{folder}: another run is writing there; wait for its end, or choose another --out") from None
    except OSError:
        pass
    try:
        yield
    finally:
        os.close(number)  # and with it the lock, as it is when the process is killed


def is_run_folder(folder: Path) -> bool:
    """Whether a folder holds a run, whole or killed."""
    return (folder / "scene.toml").is_file() and any(
        (folder / name).is_file() for name in ("telemetry.parquet", "telemetry.arrow")
    )


def _new_folder(name: str) -> Path:
    safe = "".join(letter if letter.isalnum() or letter in "-_." else "-" for letter in name).strip(".") or "run"
    folder, number = RUNS / safe, 1
    while folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        number += 1
        folder = RUNS / f"{safe}-{number}"
    return folder
