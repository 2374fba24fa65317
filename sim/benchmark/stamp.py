"""What figures were measured with: program, source, engines, interpreter, machine, day."""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import subprocess
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from sim.benchmark.engine import Engine
from sim.benchmark.play import Unable

_SOURCE = Path(__file__).parents[1]
"""The package `sim`."""
_LIBRARIES = ("numpy", "scipy", "numba", "llvmlite", "pybullet", "mujoco", "pyelastica")


def stamp(engines: Sequence[Engine] = ()) -> dict[str, Any]:
    """Program version, git commit (None outside a checkout; "+" when files differ from it), digest of the source of
    `sim`, versions of libraries and engines (None: not installed), processor, cores, system, day."""
    import datetime

    from softbot import __version__

    return {
        "softbot": __version__,
        "git_commit": _git_commit(),
        "source_sha256": source_digest(),
        "engines": {engine.name: _engine_version(engine) for engine in engines},
        "libraries": {name: _library_version(name) for name in _LIBRARIES},
        "python": platform.python_version(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
    }


def source_digest() -> str:
    """SHA-256 over the source files of the package `sim`, names and contents, as hexadecimal."""
    digest = hashlib.sha256()
    for path in sorted(_SOURCE.rglob("*.py")):
        digest.update(path.relative_to(_SOURCE).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def in_words(machine: dict[str, Any]) -> str:
    """The stamp as one line."""
    versions = {**machine["libraries"], "Python": machine["python"]}
    commit = f", commit {machine['git_commit'][:12]}" if machine["git_commit"] else ""
    return (
        f"softbot {machine['softbot']}{commit}, source {machine['source_sha256'][:12]}; "
        + ", ".join(f"{name} {number}" for name, number in versions.items() if number)
        + f"; {machine['processor']}, {machine['cores']} cores, {machine['system']}; {machine['date']}"
    )


def _engine_version(engine: Engine) -> str | None:
    try:
        return engine.version()
    except Unable:
        return None


def _library_version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _git_commit() -> str | None:
    def git(*arguments: str) -> str:
        done = subprocess.run(
            ["git", "-C", str(_SOURCE), *arguments], capture_output=True, text=True, timeout=10, check=True
        )
        return done.stdout.strip()

    try:
        if Path(git("rev-parse", "--show-toplevel")).resolve() != _SOURCE.parent.resolve():
            return None  # installed into somebody else's checkout
        return git("rev-parse", "HEAD") + ("+" if git("status", "--porcelain") else "")
    except (OSError, subprocess.SubprocessError):
        return None


def _processor() -> str:
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
        return next(names, platform.machine())
    return platform.processor() or platform.machine()
