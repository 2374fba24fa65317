"""Kernels compiled in processes of their own while this one compiles others: on two cores half the wait.

What such a process has compiled lies in numba's cache on disk, where this one finds it. Units
(`softbot.kernel_compiler`) are promised to their callers, which are compiled meanwhile and wait for them at the last.
Should a process fail, or not be allowed to start, nothing is lost but time: what is not in the cache is compiled here.
"""

from __future__ import annotations

import contextlib
import gc
import pickle
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

from numba.core import event

from sim.run_many import interpreter_environment
from sim.scene import Scene

SEQUENCER, ROD, DETECTOR = "sequencer", "rod", "detector"
"""What a process compiles: a scene's sequencer, the units of the rod twin, those of the detector of faults."""

_CHILD = "import sys; from softbot.nodes.compiling_aside import compile_here; compile_here(sys.argv[1])"


def _units(work: str, scene: Scene) -> list[tuple[Any, Any]]:
    """Units and their signatures."""
    if work == ROD:
        from sim.rod_units import rod_units

        return rod_units()
    if work == DETECTOR:
        from controllers.detector_units import detector_units

        return detector_units(scene.robot)
    return []


def compile_here(work: str) -> None:
    """What such a process does; the scene comes on standard input."""
    gc.disable()
    scene = pickle.load(sys.stdin.buffer)
    if work == SEQUENCER:
        from softbot.nodes.rehearsal import rehearse_sequencer

        with compiled_aside(scene, DETECTOR):
            rehearse_sequencer(scene)
    for unit, signature in _units(work, scene):
        unit.compile(signature.args)


class _AtFirst(event.Listener):
    """Starts the processes once this one really compiles something."""

    def __init__(self, scene: Scene, works: tuple[str, ...]) -> None:
        self._scene, self._works = scene, works
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    def on_start(self, event: Any) -> None:
        works, self._works = self._works, ()
        for work in works:
            with contextlib.suppress(OSError):
                process = subprocess.Popen(
                    [sys.executable, "-c", _CHILD, work],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    env=interpreter_environment(),
                )
                self.processes[work] = process
                assert process.stdin is not None
                with process.stdin as pipe:
                    pickle.dump(self._scene, pipe)
                for unit, signature in _units(work, self._scene):
                    unit.promise(signature, process.wait)

    def on_end(self, event: Any) -> None:
        pass

    def end(self) -> None:
        """Nothing is promised any more, and nothing runs."""
        for work, process in self.processes.items():
            for unit, signature in _units(work, self._scene):
                unit.withdraw(signature.args)
            if process.poll() is None:
                process.kill()
                process.wait()


@contextlib.contextmanager
def compiled_aside(scene: Scene, *works: str) -> Iterator[None]:
    """If the inside compiles anything, these works are done meanwhile; the sequencer's is waited for at the end."""
    listener = _AtFirst(scene, works)
    try:
        with event.install_listener("numba:compile", listener):
            yield
        if SEQUENCER in listener.processes:
            listener.processes[SEQUENCER].wait()
    finally:
        listener.end()
