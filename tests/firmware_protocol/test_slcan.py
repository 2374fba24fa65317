"""slcan, the protocol of serial adapters, over a pseudo-terminal: both ends of the link through a stand-in adapter."""

from __future__ import annotations

import os
import pty
import select
import threading
import time
import tty
from collections.abc import Iterator

import pytest

from firmware_protocol.board import BoardLimits, BoardRules
from firmware_protocol.bus import drain, opened, send
from firmware_protocol.enumerations import BoardMode
from firmware_protocol.frame import Frame
from firmware_protocol.sequencer_link import SequencerLink

PERIOD_S = 0.01


class Adapters:
    """Two adapters on one wire: what one is told to send, the other reports. Lines end with a carriage return."""

    def __init__(self) -> None:
        self.pairs = [pty.openpty() for _ in range(2)]
        for pair in self.pairs:
            for end in pair:
                tty.setraw(end)
        self.told: list[list[bytes]] = [[], []]
        self._over = False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def path(self, number: int) -> str:
        return os.ttyname(self.pairs[number][1])

    def close(self) -> None:
        self._over = True
        self._thread.join()
        for pair in self.pairs:
            for end in pair:
                os.close(end)

    def _run(self) -> None:
        masters = [master for master, _ in self.pairs]
        rest = [b"", b""]
        while not self._over:
            for master in select.select(masters, (), (), 0.05)[0]:
                number = masters.index(master)
                *lines, rest[number] = (rest[number] + os.read(master, 4096)).split(b"\r")
                self.told[number] += lines
                for line in lines:
                    if line.startswith(b"t"):
                        os.write(masters[1 - number], line + b"\r")


@pytest.fixture
def adapters() -> Iterator[Adapters]:
    made = Adapters()
    yield made
    made.close()


def test_a_board_is_armed_through_two_serial_adapters(adapters: Adapters) -> None:
    rules, link = BoardRules(BoardLimits(120e3, 150e3)), SequencerLink()
    link.arm()
    with (
        opened("slcan", adapters.path(0), sleep_after_open=0.0) as board,
        opened("slcan", adapters.path(1), sleep_after_open=0.0) as sequencer,
    ):
        start_s = time.monotonic()
        while rules.state.mode is not BoardMode.ARMED and (t_s := time.monotonic() - start_s) < 10.0:
            for frame, _ in drain(board):
                rules.receive(frame.frame_id, frame.data, t_s)
            rules.tick(t_s, [0.0] * 4)
            send(board, rules.outgoing(t_s), t_s)
            for frame, _ in drain(sequencer):
                link.receive(frame.frame_id, frame.data, t_s)
            send(sequencer, link.outgoing(t_s, [0.0] * 4), t_s)
            time.sleep(PERIOD_S)
    assert rules.state.mode is BoardMode.ARMED
    for told in adapters.told:
        assert b"S6" in told  # 500 kbit/s
        assert b"O" in told


def test_every_byte_of_a_frame_survives(adapters: Adapters) -> None:
    frames = [Frame(0x7FF, b""), Frame(0x010, bytes(range(8))), Frame(0x110, b"\xff\x0d\x07")]
    with (
        opened("slcan", adapters.path(0), sleep_after_open=0.0) as one,
        opened("slcan", adapters.path(1), sleep_after_open=0.0) as two,
    ):
        send(one, frames, 0.0)
        came: list[Frame] = []
        deadline_s = time.monotonic() + 10.0
        while len(came) < len(frames) and time.monotonic() < deadline_s:
            came += [frame for frame, _ in drain(two)]
    assert came == frames
