"""Random and mutated frames: no exception, no acceptance that the spec does not allow, no valve opened by them.

A live exchange between a link and a board goes on in between, so that there is something to break. What must be
accepted is worked out here from the DBC's numbers alone.
"""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest

from firmware_protocol.board import BoardLimits, BoardRules
from firmware_protocol.e2e import FrameStatus, protect
from firmware_protocol.frame import Frame
from firmware_protocol.sequencer_link import LinkLimits, LinkState, SequencerLink
from firmware_protocol.spec import BOARD, SEQUENCER, MessageSpec, SignalKind, spec

REST = (0.0, 0.0, 0.0, 0.0)
SETPOINTS = (10e3, 20e3, 30e3, 40e3)
MAX_COUNTER_DELTA = 3


def next_crc(crc: int) -> int:
    for _ in range(8):
        crc = (crc << 1 ^ 0x2F) & 0xFF if crc & 0x80 else crc << 1
    return crc


CRC_TABLE = [next_crc(crc) for crc in range(256)]


def crc_8h2f(data: bytes) -> int:
    crc = 0xFF
    for byte in data:
        crc = CRC_TABLE[crc ^ byte]
    return crc ^ 0xFF


class Judge:
    """Says of each frame that reaches a node whether the spec allows it."""

    def __init__(self, node: str) -> None:
        self.messages = {each.frame_id: each for each in spec().messages if node in each.receivers}
        self.last: dict[int, int] = {}

    def allows(self, frame: Frame) -> bool:
        message = self.messages.get(frame.frame_id)
        if message is None or len(frame.data) != message.length_bytes:
            return False
        counter = frame.data[1] & 0x0F
        if crc_8h2f(frame.data[1:] + bytes([message.data_ids[counter]])) != frame.data[0]:
            return False
        last = self.last.get(frame.frame_id)
        self.last[frame.frame_id] = counter
        in_order = last is None or 1 <= (counter - last) % 16 <= MAX_COUNTER_DELTA
        return (in_order or message.name == "EmergencyStop") and in_range(message, frame.data)


def in_range(message: MessageSpec, data: bytes) -> bool:
    word = int.from_bytes(data, "little")
    for signal in message.signals:
        mask = (1 << signal.length) - 1
        raw = word >> signal.start & mask
        word &= ~(mask << signal.start)
        if signal.signed and raw > mask // 2:
            raw -= mask + 1
        if signal.kind is SignalKind.ENUMERATION:
            if raw not in signal.choices:
                return False
        elif not signal.minimum - 1e-9 <= raw * signal.scale + signal.offset <= signal.maximum + 1e-9:
            return False
    return word == 0


def plausible(rng: random.Random, message: MessageSpec) -> bytes:
    """Values of the DBC's ranges and tables, whatever they mean together."""
    word = 0
    for signal in message.signals:
        if signal.kind is SignalKind.ENUMERATION:
            raw = rng.choice(list(signal.choices))
        else:
            raw = rng.randint(signal.raw_minimum, signal.raw_maximum)
        word |= (raw & (1 << signal.length) - 1) << signal.start
    return word.to_bytes(message.length_bytes, "little")


def junk(rng: random.Random, seen: list[Frame]) -> Iterator[Frame]:
    """Frames without end: random, random with a right CRC, and mutations of what was on the bus."""
    messages = spec().messages
    while True:
        kind = rng.randrange(8)
        if kind == 0:
            yield Frame(rng.randrange(2048), rng.randbytes(rng.randrange(9)))
        elif kind == 1:
            message = rng.choice(messages)
            yield Frame(message.frame_id, rng.randbytes(message.length_bytes))
        elif kind == 2:  # whatever it says, its CRC is right
            message = rng.choice(messages)
            content = rng.randbytes(message.length_bytes) if rng.random() < 0.5 else plausible(rng, message)
            yield Frame(message.frame_id, protect(message.name, content, rng.randrange(16)))
        else:
            frame = rng.choice(seen)
            data = bytearray(frame.data)
            if kind == 3:  # flipped bits
                for _ in range(rng.randint(1, 8)):
                    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            elif kind == 4:  # cut short, or too long
                data = data[: rng.randrange(len(data))] if rng.random() < 0.5 else data + rng.randbytes(1)
            elif kind == 5:  # under another name
                frame = Frame(rng.choice(messages).frame_id, frame.data)
            elif kind == 6:  # bytes changed places
                first, second = rng.randrange(len(data)), rng.randrange(len(data))
                data[first], data[second] = data[second], data[first]
            yield Frame(frame.frame_id, bytes(data))  # kind 7: replayed as it was


def fuzz(count: int, seed: int, frames_a_cycle: int) -> dict[str, int]:
    """Feeds `count` frames to both ends; the counts of what happened."""
    rng = random.Random(seed)
    tally = dict.fromkeys(("frames", "accepted", "armed cycles", "latches", "links failed"), 0)
    board, link = BoardRules(BoardLimits(200e3, 250e3)), SequencerLink(LinkLimits())
    judges = {BOARD: Judge(BOARD), SEQUENCER: Judge(SEQUENCER)}
    seen = [Frame(0x010, protect("EmergencyStop", bytes(2), 0))]
    noise = junk(rng, seen)
    cycle = 0

    def to_board(frame: Frame, t_s: float) -> None:
        state = board.state
        was_safe, mode, setpoints = state.safe, state.mode, state.setpoints_hPa
        allowed = judges[BOARD].allows(frame)
        status = board.receive(frame.frame_id, frame.data, t_s).status
        assert status.accepted == allowed, (frame, status)
        assert state.last_error == ""
        if not allowed:
            assert state.safe or not was_safe  # it opened nothing
            assert state.mode in (mode, 0)
            assert state.setpoints_hPa in (setpoints, (0, 0, 0, 0))
        assert max(state.setpoints_hPa) <= 2000

    def to_link(frame: Frame, t_s: float) -> None:
        allowed = judges[SEQUENCER].allows(frame)
        assert link.receive(frame.frame_id, frame.data, t_s).status.accepted == allowed, frame

    while tally["frames"] < count:
        t_s = cycle / 100
        if link.state in (LinkState.DISARMED, LinkState.FAILED):
            tally["links failed"] += link.state is LinkState.FAILED
            link.arm()
        for frame in link.outgoing(t_s, SETPOINTS):
            seen.append(frame)
            to_board(frame, t_s)
        # Three cycles in four are quiet, or the two would never come to be armed.
        for _ in range(frames_a_cycle if cycle % 40 >= 30 else 0):
            frame = next(noise)
            tally["frames"] += 1
            to_board(frame, t_s)
            to_link(frame, t_s)
        decision = board.tick(t_s, REST)
        tally["armed cycles"] += not decision.safe
        for frame in board.outgoing(t_s):
            seen.append(frame)
            to_link(frame, t_s)
        for frame in board.measurements(
            t_s,
            pressures_Pa=REST,
            openings=REST,
            supply_pressure_Pa=0.0,
            main_supply_open=decision.main_supply_open,
            angular_velocity_rad_s=(0.0, 0.0, 0.0),
            specific_force_m_s2=(0.0, 0.0, 9.81),
        ):
            to_link(frame, t_s)
        del seen[:-40]
        cycle += 1
    for reception in (board.reception, link.reception):
        for entry in reception.messages.values():
            tally["accepted"] += sum(number for status, number in entry.counts.items() if status.accepted)
    tally["latches"] = board.parameters.values[18]  # type: ignore[index]
    print(tally)
    return tally


def assert_that_there_was_something_to_break(tally: dict[str, int]) -> None:
    assert tally["armed cycles"] > 200
    assert tally["latches"] > 3
    assert tally["links failed"] > 3


def test_random_and_mutated_frames_do_nothing_that_the_spec_does_not_allow() -> None:
    assert_that_there_was_something_to_break(fuzz(6_000, seed=1, frames_a_cycle=20))


@pytest.mark.slow
def test_a_million_random_and_mutated_frames() -> None:
    assert_that_there_was_something_to_break(fuzz(1_000_000, seed=2, frames_a_cycle=200))


def test_random_frames_alone_never_open_a_valve() -> None:
    rng = random.Random(3)
    board = BoardRules(BoardLimits(200e3, 250e3))
    noise = junk(rng, [Frame(0x110, bytes(8))])
    for number in range(20_000):
        frame = next(noise)
        board.receive(frame.frame_id, frame.data, number * 1e-4)
        if number % 10 == 0:
            assert board.tick(number * 1e-4, REST).safe
    assert board.state.last_error == ""
    assert sum(entry.counts[FrameStatus.OK] for entry in board.reception.messages.values()) > 10
