"""Commands run in this process, in a folder and with a cache of the test's own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import can
import pytest
from typer.testing import CliRunner

from controllers.pressure_loop import PressureLoopGains
from firmware_protocol.board import BoardLimits, BoardRules
from firmware_protocol.bus import open_bus, send
from firmware_protocol.frame import Frame

SCENE = """
robot = "default"
[drive]
kind = "sequencer"
[sequencer]
start_s = 0.1
[[fault]]
t_s = 0.3
chamber = 2
kind = "leak"
[solver]
twin = "bullet"
accuracy = "fast"
duration_s = 0.5
segments = 4
[metrics]
steady_after_s = 0.2
"""


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    """A scene of half a second that a sequencer drives."""
    path = tmp_path / "short.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture
def softbot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """The `softbot` command: arguments in; exit_code, stdout and stderr out. No loop is designed, no cache touched."""
    from softbot.cli.app import app
    from softbot.nodes import valve_loop

    gains = PressureLoopGains(proportional_1_s=18.0, integral_1_s2=16.0, sample_s=0.01, model_lag_s=0.03)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(valve_loop, "designed_gains", lambda robot: gains)

    def run(*arguments: object) -> Any:
        return CliRunner().invoke(app, [str(argument) for argument in arguments])

    return run


BoardFrames = Callable[[BoardRules, float], list[Frame]]


@contextmanager
def _fed_bus(channel: str, frames: BoardFrames) -> Iterator[can.BusABC]:
    """A virtual bus with a board on it that says `frames(rules, t_s)` each 10 ms, and an ear for what others say."""
    bus = open_bus("virtual", channel, preserve_timestamps=False)
    over = threading.Event()

    def feed() -> None:
        rules, start_s = BoardRules(BoardLimits(120e3, 150e3)), time.monotonic()
        while not over.wait(0.01):
            send(bus, frames(rules, time.monotonic() - start_s), 0.0)

    thread = threading.Thread(target=feed)
    thread.start()
    try:
        yield bus
    finally:
        over.set()
        thread.join()
        bus.shutdown()


@pytest.fixture
def fed_bus() -> Callable[[str, BoardFrames], AbstractContextManager[can.BusABC]]:
    """A virtual bus that a board feeds, for commands that listen: `fed_bus(channel, frames)`."""
    return _fed_bus
