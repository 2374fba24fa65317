"""Many runs over processes: order, errors, deaths, and the same results as one after the other."""

from __future__ import annotations

import _thread
import importlib
import io
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

import sim
from sim import run_many
from sim.run_many import answer, interpreter_environment
from sim.scene import Scene, scene_from
from softbot.errors import InputError, SimulationError

CHORES = '''
"""What may be asked of a process; a "scene" is a number here."""
import os, signal, time
from pathlib import Path
from softbot.errors import InputError

def square(n):
    return n * n

def where(n):
    time.sleep(0.02)
    return os.getpid(), os.environ["OMP_NUM_THREADS"]

def process(n):
    return os.getpid()

def noisy(n):
    print("printed to standard output")
    os.write(1, b"and past Python, too\\n")
    return n

def fragile(n):
    if n % 7 == 3:
        raise InputError(f"scene {n}: refused")
    if n % 7 == 5:
        raise ZeroDivisionError("a mistake")
    return n

def mortal(n):
    if n in (2, 9):
        os.kill(os.getpid(), signal.SIGKILL)
    if n == 5:
        os._exit(7)
    return n

def asked_to_end(n):
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(os.getpid(), number)
    return n

def slow(n):
    Path(os.environ["STARTED"]).write_text(str(os.getpid()))
    time.sleep(60.0)
'''


@pytest.fixture
def chores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    (tmp_path / "chores_of_a_test.py").write_text(CHORES)
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("chores_of_a_test")
    del sys.modules["chores_of_a_test"]


def texts(results: list[Any]) -> list[str]:
    return [f"{type(result).__name__}: {result}" for result in results]


@pytest.mark.parametrize("processes", [1, 2, 3])
def test_results_are_in_the_order_of_the_scenes(chores: Any, processes: int) -> None:
    told: list[int] = []
    results = run_many(range(100), processes, run=chores.square, progress=told.append)
    assert results == [n * n for n in range(100)]
    assert told == list(range(1, 101))
    assert run_many([], processes, run=chores.square) == []


def test_processes_share_the_work_with_one_thread_each(chores: Any) -> None:
    ids, threads = zip(*run_many(range(24), 2, run=chores.where), strict=True)
    assert len(set(ids)) == 2
    assert os.getpid() not in ids
    assert set(threads) == {"1"}


def test_one_scene_or_one_process_is_run_here(chores: Any) -> None:
    assert run_many([1], 4, run=chores.process) == [os.getpid()]
    assert run_many([1, 2], 1, run=chores.process) == [os.getpid()] * 2


def test_what_a_run_prints_does_not_get_among_the_results(chores: Any, capfd: pytest.CaptureFixture[str]) -> None:
    assert run_many(range(10), 2, run=chores.noisy) == list(range(10))
    out, err = capfd.readouterr()
    assert out == ""
    assert err.count("and past Python, too") == 10


@pytest.mark.parametrize("processes", [1, 2])
def test_error_of_a_scene_is_its_result(chores: Any, processes: int) -> None:
    results = run_many(range(14), processes, run=chores.fragile)
    for n, result in enumerate(results):
        if n % 7 == 3:
            assert isinstance(result, InputError)
            assert str(result) == f"scene {n}: refused"
        elif n % 7 == 5:
            assert isinstance(result, SimulationError)
            assert str(result) == "unforeseen ZeroDivisionError: a mistake"
        else:
            assert result == n


def test_death_of_a_process_is_the_result_of_the_scene_that_it_was_at(chores: Any) -> None:
    results = run_many(range(40), 2, run=chores.mortal)
    dead = {n: str(result) for n, result in enumerate(results) if isinstance(result, SimulationError)}
    assert dead == {
        2: "the process that ran this scene was killed (SIGKILL)",
        5: "the process that ran this scene ended with status 7",
        9: "the process that ran this scene was killed (SIGKILL)",
    }
    assert [result for n, result in enumerate(results) if n not in dead] == [n for n in range(40) if n not in dead]


def test_what_asks_the_whole_group_to_end_is_no_death_of_a_run(chores: Any) -> None:
    assert run_many(range(4), 2, run=chores.asked_to_end) == list(range(4))


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_processes_end_with_their_parent(chores: Any, tmp_path: Path, number: signal.Signals) -> None:
    started = tmp_path / "started"
    script = "from chores_of_a_test import slow\nfrom sim import run_many\nrun_many(range(2), 2, run=slow)"
    parent = subprocess.Popen([sys.executable, "-c", script], env=interpreter_environment() | {"STARTED": str(started)})
    deadline_s = time.monotonic() + 60.0
    while not (started.exists() and started.read_text()):
        assert parent.poll() is None
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    parent.send_signal(number)
    parent.wait(timeout=30.0)
    deadline_s = time.monotonic() + 20.0  # of the run's minute
    while runs(int(started.read_text())):
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


def runs(process: int) -> bool:
    """Whether there is such a process, and not only what is left of it until somebody asks."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_interrupt_ends_the_processes(chores: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started = tmp_path / "started"
    monkeypatch.setenv("STARTED", str(started))
    interrupted_s: list[float] = []

    def interrupt() -> None:
        while not started.exists():
            time.sleep(0.01)
        interrupted_s.append(time.monotonic())
        _thread.interrupt_main()

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where the tests run in the background
    try:
        threading.Thread(target=interrupt, daemon=True).start()
        with pytest.raises(KeyboardInterrupt):
            run_many(range(4), 2, run=chores.slow)
    finally:
        signal.signal(signal.SIGINT, before)
    assert time.monotonic() - interrupted_s[0] < 30.0
    while any(thread.name.startswith("run_many") for thread in threading.enumerate()):
        assert time.monotonic() - interrupted_s[0] < 60.0
        time.sleep(0.05)


def test_function_that_cannot_be_found_elsewhere_is_refused(chores: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"cannot be sent to another process .*take a module's function"):
        run_many(range(3), 2, run=lambda n: n)
    stranger = type(sys)("stranger_of_a_test")
    exec("def here_only(n):\n    return n", stranger.__dict__)
    stranger.here_only.__module__ = "stranger_of_a_test"
    monkeypatch.setitem(sys.modules, "stranger_of_a_test", stranger)
    with pytest.raises(SimulationError, match="ended with status 1 before the first of them"):
        run_many(range(3), 2, run=stranger.here_only)
    with pytest.raises(InputError, match="processes = 0: at least one"):
        run_many(range(3), 0, run=chores.square)


def test_no_process_at_all_is_said(chores: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with pytest.raises(SimulationError, match=r"no further process can be started: .*take processes = 1"):
        run_many(range(3), 2, run=chores.square)


def rolls(table: dict[str, Any]) -> list[Scene]:
    """Three short rolls on the rod, the second refused for its step."""
    table["solver"] = {"twin": "rod", "accuracy": "fast", "duration_s": 0.6}
    found = []
    for curvature_1_m in (6.0, 8.0, 10.0):
        table["drive"] |= {"curvature_1_m": curvature_1_m, "period_s": 0.002 if curvature_1_m == 8.0 else 1.0}
        table["solver"]["step_s"] = 0.005
        found.append(scene_from(table, f"{curvature_1_m:g}", Path()))
    return found


def plain(result: Any) -> Any:
    return {key: value for key, value in result.summary.items() if key not in ("wall_time_s", "real_time_factor")}


def test_scenes_run_elsewhere_as_they_do_here(scene_table: dict[str, Any]) -> None:
    scenes = rolls(scene_table)
    here, there = run_many(scenes, 1), run_many(scenes, 2)
    whole = run_many(scenes[:1], 1, "all")[0]
    assert [result.summary["scene"] for result in (here[0], here[2], there[0], there[2])] == ["6", "10"] * 2
    assert [repr(plain(result)) for result in here[::2]] == [repr(plain(result)) for result in there[::2]]
    assert str(here[1]) == str(there[1])
    assert isinstance(there[1], InputError)
    assert (there[0].telemetry.num_rows, whole.telemetry.num_rows) == (0, 60)
    assert repr(plain(whole)) == repr(plain(there[0]))


def test_the_package_offers_the_function_and_not_its_module() -> None:
    assert callable(sim.run_many)
    module: Any = importlib.import_module("sim.run_many")
    assert module.run_many is sim.run_many


@pytest.mark.parametrize(
    ("messages", "answers"),
    [([], []), ([("all", abs)], ["ready"]), ([("summary", abs), [-1, -2], [-3]], ["ready", 1, 2, 3])],
)
def test_answers_come_one_by_one_until_the_input_ends(messages: list[Any], answers: list[Any]) -> None:
    replies = io.BytesIO()
    answer(io.BytesIO(b"".join(pickle.dumps(message) for message in messages)), replies)
    end = replies.tell()
    replies.seek(0)
    heard = []
    while replies.tell() < end:
        heard.append(pickle.load(replies))
    assert heard == answers
