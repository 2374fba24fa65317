"""`softbot parameters` against a board on a virtual bus: read, lowered, never raised, and never beside a sequencer."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from firmware_protocol.board import BoardLimits, BoardRules
from firmware_protocol.bus import drain, opened, send
from firmware_protocol.e2e import Sender

CHANNEL = "cli-parameters"
ON_THE_BUS = ("--interface", "virtual", "--channel", CHANNEL)


@pytest.fixture
def board() -> Iterator[BoardRules]:
    """A board that serves the bus every 10 ms."""
    rules, over = BoardRules(BoardLimits(120e3, 150e3)), threading.Event()

    def serve() -> None:
        start_s = time.monotonic()
        with opened("virtual", CHANNEL, preserve_timestamps=False) as bus:
            while not over.wait(0.01):
                t_s = time.monotonic() - start_s
                for frame, _ in drain(bus):
                    rules.receive(frame.frame_id, frame.data, t_s)
                rules.tick(t_s, [0.0] * 4)
                send(bus, rules.outgoing(t_s), t_s)

    thread = threading.Thread(target=serve)
    thread.start()
    yield rules
    over.set()
    thread.join()


@pytest.mark.usefixtures("board")
def test_all_parameters_are_shown(softbot: Any) -> None:
    result = softbot("parameters", *ON_THE_BUS)
    assert result.exit_code == 0, result.stderr
    assert "max_setpoint" in result.stdout
    shown = json.loads(softbot("parameters", *ON_THE_BUS, "--json").stdout)
    assert shown["parameters"]["max_setpoint"] == 1200
    assert shown["parameters"]["over_pressure"] == 1500
    assert len(shown["parameters"]) == 10
    assert shown["refused"] == {}


def test_a_limit_is_lowered_and_not_raised_again(softbot: Any, board: BoardRules) -> None:
    lowered = softbot("parameters", "max_setpoint=800", "command_timeout=60", *ON_THE_BUS, "--json")
    assert lowered.exit_code == 0, lowered.stderr
    assert json.loads(lowered.stdout)["parameters"]["max_setpoint"] == 800
    raised = softbot("parameters", "max_setpoint=900", "latches=0", *ON_THE_BUS)
    assert raised.exit_code == 2
    assert "max_setpoint was refused: limits are lowered over the bus and never raised" in raised.stderr
    assert "latches was refused: it can only be read" in raised.stderr
    assert dict(board.parameters.values)[1] == 800


@pytest.mark.parametrize(
    ("assignment", "says"),
    [
        ("speed=3", "'speed' is no parameter of the board; choose one of: max_setpoint"),
        ("max_setpoint", "give a whole number"),
        ("max_setpoint=-1", "give a whole number"),
        ("max_setpoint=4294967296", "give a whole number"),
    ],
)
def test_what_is_no_assignment_is_named(softbot: Any, assignment: str, says: str) -> None:
    result = softbot("parameters", assignment, *ON_THE_BUS)
    assert result.exit_code == 2
    assert says in result.stderr


def test_without_a_board_it_says_so(softbot: Any) -> None:
    result = softbot("parameters", "--interface", "virtual", "--channel", "nobody")
    assert result.exit_code == 3
    assert "no board is heard on virtual nobody" in result.stderr


@pytest.mark.usefixtures("board")
def test_beside_a_sequencer_it_says_nothing(softbot: Any) -> None:
    over = threading.Event()

    def sequence() -> None:
        sender = Sender()
        with opened("virtual", CHANNEL, preserve_timestamps=False) as bus:
            while not over.wait(0.01):
                send(bus, [sender.send("SequencerSetpoints", {f"Setpoint{n}": 0.0 for n in range(4)})], 0.0)

    thread = threading.Thread(target=sequence)
    thread.start()
    result = softbot("parameters", *ON_THE_BUS)
    over.set()
    thread.join()
    assert result.exit_code == 2
    assert "a sequencer is on virtual cli-parameters already" in result.stderr
