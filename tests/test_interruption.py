"""Ctrl-C and SIGTERM reach a run even if a library swallows what they raise."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from sim import run as sim_run
from sim.run import simulate
from sim.run_many import run_many
from sim.scene import scene_from
from sim.telemetry import read_telemetry
from softbot.cli.exit_status import with_exit_status
from softbot.cli.streams import nothing_printed
from softbot.errors import SimulationError
from softbot.interruption import (
    HungUp,
    Terminated,
    interruptible,
    interruption_asked,
    raise_if_asked,
    stopped_by_signals,
)

RAISES = {signal.SIGINT: KeyboardInterrupt, signal.SIGTERM: Terminated, signal.SIGHUP: HungUp}
SIGNALS = pytest.mark.parametrize(("number", "interruption"), RAISES.items())


AT_FIRST = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
    signal.SIGHUP: signal.SIG_DFL,
}
"""What a command in a terminal begins with."""


@pytest.fixture(autouse=True)
def _hearing() -> Iterator[None]:
    """SIGINT is ignored where the tests run in the background, SIGHUP where they go on without a terminal."""
    before = {one: signal.signal(one, was) for one, was in AT_FIRST.items()}
    yield
    for one, was in before.items():
        signal.signal(one, was)


def swallow(number: signal.Signals) -> None:
    """What numba's dispatcher does with a signal that comes while it asks a record for its type."""
    with contextlib.suppress(KeyboardInterrupt):
        signal.raise_signal(number)


@SIGNALS
def test_a_run_that_swallows_its_interruption_ends_at_the_next_sample(
    number: signal.Signals, interruption: type[KeyboardInterrupt], scene_table: dict[str, Any], tmp_path: Path
) -> None:
    def progress(t_s: float) -> None:
        if 0.15 < t_s < 0.25:
            swallow(number)

    with interruptible(), pytest.raises(interruption) as raised:
        simulate(scene_from(scene_table, "scene.toml", tmp_path), tmp_path, progress=progress)
    assert raised.type is interruption
    assert read_telemetry(tmp_path).num_rows == 20
    assert json.loads((tmp_path / "summary.json").read_text())["outcome"] == "interrupted"


@pytest.mark.parametrize("stumbles", [SimulationError("left its range"), TypeError("no matching definition")])
@SIGNALS
def test_a_run_that_fails_in_the_wake_of_what_it_swallowed_was_interrupted(
    stumbles: Exception,
    number: signal.Signals,
    interruption: type[KeyboardInterrupt],
    scene_table: dict[str, Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def stumble(self: object, done: int) -> int:
        swallow(number)
        raise stumbles

    monkeypatch.setattr(sim_run._StepByStep, "advance", stumble)
    with interruptible(), pytest.raises(interruption) as raised:
        simulate(scene_from(scene_table, "scene.toml", tmp_path), tmp_path)
    assert raised.type is interruption
    assert json.loads((tmp_path / "summary.json").read_text())["outcome"] == "interrupted"


def swallow_what(number: signal.Signals) -> None:
    """A task of `run_many`."""
    ran.append(number)
    swallow(number)


ran: list[signal.Signals] = []


@SIGNALS
def test_of_many_runs_none_is_begun_after_an_interruption(
    number: signal.Signals, interruption: type[KeyboardInterrupt]
) -> None:
    ran.clear()
    with interruptible(), pytest.raises(interruption):
        run_many([number] * 3, 1, run=swallow_what)
    assert ran == [number]


@pytest.mark.parametrize(
    ("number", "status", "said"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated"), (signal.SIGHUP, 129, "hung up")],
)
@pytest.mark.parametrize(
    ("error", "wake"),
    [
        (TypeError("no matching definition"), "TypeError: no matching definition"),
        (SimulationError("left its range"), ": left its range"),
    ],
)
def test_an_error_in_the_wake_of_a_swallowed_signal_is_the_interruption(
    number: signal.Signals, status: int, said: str, error: Exception, wake: str
) -> None:
    app = typer.Typer()

    def command() -> None:
        swallow(number)
        raise error

    app.command()(with_exit_status(command))
    result = CliRunner().invoke(app, [])
    assert result.exit_code == status
    assert result.stderr == f"softbot: {said}; in its wake{wake if wake.startswith(':') else ' ' + wake}\n"


@SIGNALS
def test_what_was_asked_of_one_command_is_not_asked_of_the_next(
    number: signal.Signals, interruption: type[KeyboardInterrupt]
) -> None:
    with interruptible():
        raise_if_asked()
        swallow(number)
        assert interruption_asked() is interruption
        with pytest.raises(interruption):
            raise_if_asked()
    assert interruption_asked() is None
    raise_if_asked()
    assert {one: signal.getsignal(one) for one in AT_FIRST} == AT_FIRST


@pytest.mark.parametrize("first", AT_FIRST)
def test_a_shell_that_is_closed_breaks_off_no_end_by_sending_more_than_one_signal(first: signal.Signals) -> None:
    with interruptible():
        with pytest.raises(RAISES[first]):
            signal.raise_signal(first)
        for _ in range(3):
            signal.raise_signal(signal.SIGHUP)
        if first is not signal.SIGTERM:
            signal.raise_signal(signal.SIGTERM)
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL  # the next one ends the process
        assert interruption_asked() is RAISES[first]
        for _ in range(2):
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)


def test_signals_of_a_closed_shell_ask_for_one_stop_and_no_more() -> None:
    with stopped_by_signals() as stop:
        for number in (signal.SIGHUP, signal.SIGHUP, signal.SIGTERM, signal.SIGHUP):
            signal.raise_signal(number)
        assert stop.is_set()
        assert signal.getsignal(signal.SIGTERM) == AT_FIRST[signal.SIGTERM]


def test_a_signal_that_comes_while_the_stop_is_being_set_does_not_wait_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    notify_all = threading.Condition.notify_all

    def interrupted(self: threading.Condition) -> None:  # the event holds its lock here
        signal.raise_signal(signal.SIGTERM)
        notify_all(self)

    with stopped_by_signals() as stop:
        monkeypatch.setattr(threading.Condition, "notify_all", interrupted)
        signal.raise_signal(signal.SIGHUP)
        assert stop.is_set()


def test_what_is_said_to_a_terminal_that_is_gone_is_no_error() -> None:
    """As `--json` does: the terminal is put aside, hangs up, and is not put back."""
    terminal, its_end = pty.openpty()
    kept = [os.dup(number) for number in (1, 2)]
    try:
        for number in (1, 2):
            os.dup2(its_end, number)
        with interruptible():
            with nothing_printed():
                os.close(terminal)
                swallow(signal.SIGHUP)
            os.write(1, b"answer")
            os.write(2, b"message")
    finally:
        for number, was in zip((1, 2), kept, strict=True):
            os.dup2(was, number)
            os.close(was)
        os.close(its_end)


@pytest.mark.parametrize("number", AT_FIRST)
def test_a_command_that_was_started_deaf_to_a_signal_stays_so(number: signal.Signals) -> None:
    signal.signal(number, signal.SIG_IGN)
    with interruptible():
        signal.raise_signal(number)
        assert interruption_asked() is None


@pytest.mark.parametrize("number", AT_FIRST)
def test_a_signal_asks_for_the_stop_and_a_second_one_is_not_held(number: signal.Signals) -> None:
    with stopped_by_signals() as stop:
        assert not stop.is_set()
        signal.raise_signal(number)
        assert stop.is_set()
        assert signal.getsignal(number) == (signal.SIG_IGN if number is signal.SIGHUP else AT_FIRST[number])
    assert signal.getsignal(number) == AT_FIRST[number]


def test_what_was_started_to_go_on_without_a_terminal_is_not_stopped_when_it_hangs_up() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with stopped_by_signals() as stop:
        signal.raise_signal(signal.SIGHUP)
        assert not stop.is_set()
        signal.raise_signal(signal.SIGINT)
        assert stop.is_set()
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN


def test_off_the_main_thread_no_handler_is_touched() -> None:
    ran: list[bool] = []

    def command() -> None:
        with interruptible():
            ran.append(signal.getsignal(signal.SIGINT) is signal.default_int_handler)

    thread = threading.Thread(target=command)
    thread.start()
    thread.join()
    assert ran == [True]
