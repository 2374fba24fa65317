"""A file that a command writes at its end: what is wrong with its path is said before the work, not after it."""

from __future__ import annotations

import os
from pathlib import Path

PICTURES = (".png", ".svg", ".pdf")


def can_be_written(option: str, path: Path, endings: tuple[str, ...] = ()) -> None:
    """Raises InputError where no file can be made at `path`, or its name has none of the `endings`."""
    from softbot.errors import InputError

    if path.is_dir():
        raise InputError(f"{option} {path}: is a folder; name a file in it")
    if endings and path.suffix.lower() not in endings:
        raise InputError(f"{option} {path}: the name ends in {', '.join(endings)}")
    if not path.parent.is_dir():
        raise InputError(
            f"{option} {path}: cannot be written: there is no folder {path.parent}; choose another {option}"
        )
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise InputError(f"{option} {path}: cannot be written: not permitted; choose another {option}")
