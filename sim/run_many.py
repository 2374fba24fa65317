"""Many runs at once, over processes: scenes in, their results in the same order out.

Each process is a fresh interpreter that knows nothing of the caller's main module, so a script needs no
`if __name__ == "__main__"`, and the caller may hold threads. It reads scenes from its standard input and answers each
on its own; kernels come from numba's cache, linear algebra keeps to one thread. What happens to one scene stays with
it: its error, or the death of its process, is its result, and the others go on.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import IO, TYPE_CHECKING, Any

from softbot.errors import InputError, SimulationError, SoftbotError
from softbot.interruption import left_to_the_parent, raise_if_asked
from softbot.one_thread import ONE_THREAD

if TYPE_CHECKING:
    from sim.recorder import Record
    from sim.scene import Scene

_AT_ONCE = 16  # scenes that a process is given at most, so that it need not wait for the next
_SHARES = 8  # parts that the work of each process is cut into, so that all end together
_READY = "ready"
_LISTENING_S = 0.2  # how long an interrupt may go unheard


def run_many(
    scenes: Iterable[Any],
    processes: int | None = None,
    record: Record = "summary",
    *,
    run: Callable[[Scene], Any] | None = None,
    progress: Callable[[int], None] = lambda done: None,
    each: Callable[[Any], None] | None = None,
) -> list[Any]:
    """Run scenes over processes (default: one a core that this process may use; 1: here, without another).

    Returns for each scene, in order, its `RunResult` or the SoftbotError that ended it; a process that was killed is a
    SimulationError of the scene it was at. `record`: "all", or "summary": results carry a telemetry without rows.
    `run`: what is done with a scene in place of `sim.run.simulate`, such as `softbot.nodes.run.run_scene` for scenes
    with valves or a sequencer: an importable function of the scene alone, which decides itself what it records.
    With `run`, anything that pickles may stand for a scene. `progress` is told the number of scenes done, from any
    thread, one at a time. `each` is given every result as it comes, likewise, and then none is kept: the list is empty.
    What it raises ends everything.

    Results do not depend on `processes` (but for the times on the clock). Raises InputError for `processes` below 1,
    SimulationError when a process cannot be started.
    """
    todo = list(scenes)
    count = _cores() if processes is None else processes
    if count < 1:
        raise InputError(f"processes = {count}: at least one has to do the work")
    try:
        pickle.dumps((record, run))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InputError(
            f"run = {run!r}: cannot be sent to another process ({error}); take a module's function"
        ) from None
    count = min(count, len(todo))
    if count <= 1:
        task = _task(record, run)
        results: list[Any] = []
        for done, scene in enumerate(todo, start=1):
            raise_if_asked()
            result = _outcome(task, scene)
            if each is None:
                results.append(result)
            else:
                each(result)
            progress(done)
        return results
    return _Pool(todo, count, (record, run), progress, each).results()


def serve() -> None:
    """What a process of `run_many` does: answer scenes from its standard input on its standard output."""
    left_to_the_parent()
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    replies = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what engines print must not get among the replies
    answer(sys.stdin.buffer, replies)


def _end_with(parent: int) -> None:
    """End this process when its parent has gone, however it went: nobody will hear the answer."""
    while os.getppid() == parent:
        time.sleep(_LISTENING_S)
    os._exit(1)


def answer(source: IO[bytes], replies: IO[bytes]) -> None:
    """Read what to do, say that it can be done, then read lists of scenes and answer each, until the input ends."""
    with contextlib.suppress(BrokenPipeError, EOFError):  # the parent has gone
        task = _task(*pickle.load(source))
        _send(replies, _READY)
        while True:
            for scene in pickle.load(source):
                _send(replies, _outcome(task, scene))


def _cores() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on this system
        return os.cpu_count() or 1


def _task(record: Record, run: Callable[[Scene], Any] | None) -> Callable[[Scene], Any]:
    if run is not None:
        return run
    from sim.run import RunResult, simulate

    def to_the_end(scene: Scene) -> RunResult:
        result = simulate(scene, record=record)
        if record == "summary":  # thousands of runs: the rows have done their work
            return RunResult(result.summary, result.telemetry.schema.empty_table())
        return result

    return to_the_end


def _outcome(task: Callable[[Scene], Any], scene: Scene) -> Any:
    try:
        return task(scene)
    except SoftbotError as error:
        raise_if_asked()  # it may have stumbled over an interruption that a library swallowed
        return error.with_traceback(None)
    except Exception as error:
        raise_if_asked()
        return SimulationError(f"unforeseen {type(error).__name__}: {error}")


def _send(stream: IO[bytes], message: Any) -> None:
    stream.write(pickle.dumps(message))
    stream.flush()


class _Pool:
    """Processes, each with a thread that feeds it."""

    def __init__(
        self,
        scenes: list[Any],
        count: int,
        setup: tuple[Any, ...],
        progress: Callable[[int], None],
        each: Callable[[Any], None] | None,
    ) -> None:
        self._scenes, self._setup, self._progress, self._each = scenes, setup, progress, each
        self._results: list[Any] = [None] * len(scenes)
        self._share = max(1, min(_AT_ONCE, len(scenes) // (_SHARES * count)))
        self._todo = deque(range(len(scenes)))
        self._lock = threading.Lock()
        self._done = 0
        self._stopped = False
        self._failure: Exception | None = None
        self._running: set[subprocess.Popen[bytes]] = set()
        self._threads = [threading.Thread(target=self._feed, name="run_many", daemon=True) for _ in range(count)]

    def results(self) -> list[Any]:
        """Run everything."""
        try:
            for thread in self._threads:
                thread.start()
            for thread in self._threads:
                while thread.is_alive():
                    thread.join(_LISTENING_S)
        finally:
            self._stop()
        if self._failure is not None:
            raise self._failure
        return self._results if self._each is None else []

    def _stop(self) -> None:
        with self._lock:
            self._stopped = True
            for process in self._running:
                process.kill()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join()

    def _feed(self) -> None:
        try:
            while self._work():
                pass
        except Exception as error:
            with self._lock:
                self._failure = self._failure or error
                self._stopped = True

    def _work(self) -> bool:
        """Feed one process until nothing is left to do (False) or it dies (True: the rest needs another)."""
        with self._lock:
            if self._stopped or not self._todo:
                return False
            process = _start()
            self._running.add(process)
        try:
            assert process.stdin is not None
            assert process.stdout is not None
            _begin(process, self._setup)
            while shares := self._take():
                try:
                    _send(process.stdin, [self._scenes[index] for index in shares])
                    while shares:
                        result = pickle.load(process.stdout)
                        self._finish(shares.popleft(), result)
                except (EOFError, BrokenPipeError, pickle.UnpicklingError):
                    how = _how_it_ended(process.wait())
                    self._give_back(shares, SimulationError(f"the process that ran this scene {how}"))
                    return True
            return False
        finally:
            with self._lock:
                self._running.discard(process)
            _end(process)

    def _take(self) -> deque[int]:
        with self._lock:
            if self._stopped:
                return deque()
            return deque(self._todo.popleft() for _ in range(min(self._share, len(self._todo))))

    def _give_back(self, left: deque[int], error: SimulationError) -> None:
        """The first of these was at work when its process died; the others have not begun."""
        if not self._stopped:
            self._finish(left.popleft(), error)
            with self._lock:
                self._todo.extendleft(reversed(left))

    def _finish(self, index: int, result: Any) -> None:
        with self._lock:
            if self._each is None:
                self._results[index] = result
            else:
                self._each(result)
            self._done += 1
            self._progress(self._done)


def interpreter_environment() -> dict[str, str]:
    """Environment of an interpreter that is to import what this one can, on one thread."""
    paths = [os.path.abspath(path) for path in sys.path]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths), **dict.fromkeys(ONE_THREAD, "1")}


def _start() -> subprocess.Popen[bytes]:
    command = [sys.executable, "-c", "from sim.run_many import serve; serve()"]
    try:
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=interpreter_environment())
    except OSError as error:
        raise SimulationError(f"no further process can be started: {error}; take processes = 1") from None


def _begin(process: subprocess.Popen[bytes], setup: Any) -> None:
    assert process.stdin is not None
    assert process.stdout is not None
    message = pickle.dumps(setup)
    try:
        process.stdin.write(message)
        process.stdin.flush()
        pickle.load(process.stdout)
    except (EOFError, BrokenPipeError):
        how = _how_it_ended(process.wait())
        raise SimulationError(
            f"a process for the runs {how} before the first of them; its own words are on standard error (`run` has "
            "to be importable there: no function of a script, no lambda)"
        ) from None


def _end(process: subprocess.Popen[bytes]) -> None:
    """Its input ends, and so it ends itself."""
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            with contextlib.suppress(BrokenPipeError):
                stream.close()
    process.wait()


def _how_it_ended(status: int) -> str:
    if status >= 0:
        return f"ended with status {status}"
    with contextlib.suppress(ValueError):
        return f"was killed ({signal.Signals(-status).name})"
    return f"was killed (signal {-status})"
