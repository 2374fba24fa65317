"""Compile what the tests run, and design the pressure loop they use: both are then found on disk.

    python tests/compile_beforehand.py [PART]

Without a part, all of them, each in a process of its own: two processes of tests would compile everything twice.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from sim.scene import Scene, load_scene
from softbot.nodes import direct
from softbot.nodes.rehearsal import rehearse_plant, rehearse_sequencer
from softbot.nodes.warm_up import warm_up


def _robot(scene: Scene) -> None:
    warm_up(scene)
    rehearse_plant(scene)


def _controller(scene: Scene) -> None:
    rehearse_sequencer(scene)
    direct.warm_up(scene)  # by now the rod has been compiled by the other part


PARTS: dict[str, Callable[[Scene], None]] = {"robot": _robot, "controller": _controller}


def main() -> int:
    """Exit status: 0, or 1 when a part failed."""
    if len(sys.argv) > 1:
        PARTS[sys.argv[1]](load_scene(Path(__file__).parents[1] / "scenes" / "damaged.toml", ()))
        return 0
    running = [subprocess.Popen([sys.executable, __file__, part]) for part in PARTS]
    failed = [process.wait() for process in running]
    return int(any(failed))


if __name__ == "__main__":
    sys.exit(main())
