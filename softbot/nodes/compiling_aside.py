"""The controller compiled in a process of its own while this one compiles the robot: on two cores half the wait.

What that process has compiled lies in numba's cache on disk, where this one finds it. Should it fail, or not be allowed
to start, nothing is lost but time: what is not in the cache is compiled here.
"""

from __future__ import annotations

import contextlib
import pickle
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

from numba.core import event

from sim.run_many import interpreter_environment
from sim.scene import Scene

_CHILD = (
    "import pickle, sys; from softbot.nodes.rehearsal import rehearse_sequencer; "
    "rehearse_sequencer(pickle.load(sys.stdin.buffer))"
)


class _AtFirst(event.Listener):
    """Starts the process once this one really compiles something."""

    def __init__(self, scene: Scene) -> None:
        self._scene, self._began = scene, False
        self.process: subprocess.Popen[bytes] | None = None

    def on_start(self, event: Any) -> None:
        if self._began:
            return
        self._began = True
        with contextlib.suppress(OSError):
            process = subprocess.Popen(
                [sys.executable, "-c", _CHILD],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=interpreter_environment(),
            )
            self.process = process
            assert process.stdin is not None
            with process.stdin as pipe:
                pickle.dump(self._scene, pipe)

    def on_end(self, event: Any) -> None:
        pass


@contextlib.contextmanager
def sequencer_compiled_aside(scene: Scene) -> Iterator[None]:
    """If the inside compiles anything, the scene's sequencer is compiled meanwhile, and waited for at the end."""
    listener = _AtFirst(scene)
    try:
        with event.install_listener("numba:compile", listener):
            yield
        if listener.process is not None:
            listener.process.wait()
    finally:
        if listener.process is not None and listener.process.poll() is None:
            listener.process.kill()
            listener.process.wait()
