"""Each fault of the bus does what its name says, to what it is aimed at, the same way every time."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from firmware_protocol.board import BoardLimits, BoardRules
from firmware_protocol.bus import drain, open_bus, send
from firmware_protocol.bus_faults import BusFault, BusFaultKind, Direction, FaultFile, FaultyBus, read_bus_faults
from firmware_protocol.codec import decode
from firmware_protocol.e2e import FrameStatus, Receiver, Sender
from firmware_protocol.enumerations import BoardMode, SafeReason
from firmware_protocol.errors import BusError, BusFaultError
from firmware_protocol.frame import Frame
from firmware_protocol.sequencer_link import LinkFailure, LinkState, SequencerLink
from firmware_protocol.spec import dbc_hash

PERIOD_S = 0.01


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s

    def pass_(self, duration_s: float) -> None:
        self.now_s = round(self.now_s + duration_s, 6)


class Bench:
    """A node with a faulty end of a bus, and a listener at the other end."""

    def __init__(self, *faults: BusFault, seed: int = 1) -> None:
        self.clock = Clock()
        channel = f"faults-{id(self)}"
        self.far = open_bus("virtual", channel)
        self.near = FaultyBus(open_bus("virtual", channel), faults, seed=seed, clock=self.clock)
        self.sender = Sender()

    def close(self) -> None:
        self.near.shutdown()
        self.far.shutdown()

    def setpoints(self) -> Frame:
        return self.sender.send("SequencerSetpoints", {f"Setpoint{chamber}": 5.0 for chamber in range(4)})

    def sent(self, cycles: int, make: Callable[[], Frame] | None = None) -> list[list[Frame]]:
        """What the far end gets in each of `cycles` cycles in which the near end sends one frame."""
        came = []
        for _ in range(cycles):
            send(self.near, [(make or self.setpoints)()], 0.0)
            list(drain(self.near))
            came.append([frame for frame, _ in drain(self.far)])
            self.clock.pass_(PERIOD_S)
        return came


@pytest.fixture
def bench() -> Iterator[Callable[..., Bench]]:
    made: list[Bench] = []

    def make(*faults: BusFault, seed: int = 1) -> Bench:
        made.append(Bench(*faults, seed=seed))
        return made[-1]

    yield make
    for one in made:
        one.close()


def flat(cycles: list[list[Frame]]) -> list[Frame]:
    return [frame for cycle in cycles for frame in cycle]


def statuses(frames: list[Frame]) -> list[FrameStatus]:
    receiver = Receiver("SequencerSetpoints")
    return [receiver.check(frame.data) for frame in frames]


def test_without_faults_it_is_the_bus(bench: Callable[..., Bench]) -> None:
    one = bench()
    assert [len(cycle) for cycle in one.sent(20)] == [1] * 20
    send(one.far, [one.setpoints()], 3.0)
    assert len(list(drain(one.near))) == 1
    assert one.near.recv(timeout=0.0) is None


def test_it_waits_for_a_frame_as_long_as_it_is_told_and_shuts_down_once() -> None:
    near = FaultyBus(open_bus("virtual", "faults-wait"), ())
    start_s = time.monotonic()
    assert near.recv(0.05) is None
    assert time.monotonic() - start_s >= 0.05
    near.shutdown()
    near.shutdown()


def test_frames_are_dropped_at_the_rate_asked_for_and_the_same_ones_each_time(bench: Callable[..., Bench]) -> None:
    fault = BusFault(BusFaultKind.DROP, probability=0.3)
    counts = [[len(cycle) for cycle in bench(fault, seed=seed).sent(400)] for seed in (7, 7, 8)]
    assert counts[0] == counts[1] != counts[2]
    assert 0.2 < counts[0].count(0) / 400 < 0.4


def test_a_fault_is_on_in_its_time_for_its_message_and_direction(bench: Callable[..., Bench]) -> None:
    one = bench(BusFault(BusFaultKind.DROP, Direction.SEND, "SequencerSetpoints", start_s=0.045, duration_s=0.1))
    assert [len(cycle) for cycle in one.sent(20)] == [1] * 5 + [0] * 10 + [1] * 5
    one.near.faults = (BusFault(BusFaultKind.DROP, message="EmergencyStop"),)
    assert len(flat(one.sent(3))) == 3
    assert flat(one.sent(3, lambda: one.sender.send("EmergencyStop", {"Reason": 0}))) == []
    one.near.faults = (BusFault(BusFaultKind.DROP, Direction.RECEIVE),)
    assert len(flat(one.sent(3))) == 3
    send(one.far, [one.setpoints()], 0.0)
    assert list(drain(one.near)) == []


def test_frames_are_delayed(bench: Callable[..., Bench]) -> None:
    one = bench(BusFault(BusFaultKind.DELAY, delay_s=0.035))
    cycles = one.sent(10)
    assert [len(cycle) for cycle in cycles] == [0, 0, 0, 0, 1, 1, 1, 1, 1, 1]
    assert set(statuses(flat(cycles))[1:]) == {FrameStatus.OK}
    send(one.far, [one.setpoints()], 0.0)
    assert list(drain(one.near)) == []
    one.clock.pass_(0.04)
    assert len(list(drain(one.near))) == 1


def test_a_frame_is_overtaken(bench: Callable[..., Bench]) -> None:
    frames = flat(bench(BusFault(BusFaultKind.REORDER)).sent(8))
    counters = [frame.data[1] & 0x0F for frame in frames]
    assert sorted(counters) == list(range(8))
    assert counters == [1, 0, 3, 2, 5, 4, 7, 6]


def test_frames_come_twice(bench: Callable[..., Bench]) -> None:
    found = statuses(flat(bench(BusFault(BusFaultKind.DUPLICATE)).sent(3)))
    assert found[::2] == [FrameStatus.INITIAL, FrameStatus.OK, FrameStatus.OK]
    assert found[1::2] == [FrameStatus.REPEATED] * 3


@pytest.mark.parametrize("bits", [1, 2, 3])
def test_as_many_bits_are_flipped_as_asked_for_and_protection_finds_them(
    bench: Callable[..., Bench], bits: int
) -> None:
    one = bench(BusFault(BusFaultKind.CORRUPT, bits=bits))
    true, clean = [], Sender()
    for _ in range(64):
        true.append(clean.send("SequencerSetpoints", {f"Setpoint{chamber}": 5.0 for chamber in range(4)}))
    frames = flat(one.sent(64))
    for frame, original in zip(frames, true, strict=True):
        flipped = int.from_bytes(frame.data, "little") ^ int.from_bytes(original.data, "little")
        assert flipped.bit_count() == bits
    assert set(statuses(frames)) == {FrameStatus.WRONG_CRC}


def test_a_node_babbles(bench: Callable[..., Bench]) -> None:
    one = bench(BusFault(BusFaultKind.BABBLE, frame_id=0x000, period_s=0.002))
    cycles = one.sent(10)
    babbled = [frame for frame in flat(cycles) if frame.frame_id == 0]
    assert len(babbled) in range(44, 48)
    assert len({frame.data for frame in babbled}) > 40
    assert len(flat(cycles)) - len(babbled) == 10


def test_a_node_of_another_version_is_valid_but_for_its_hash(bench: Callable[..., Bench]) -> None:
    one = bench(BusFault(BusFaultKind.WRONG_VERSION))
    control = {"Mode": 1, "ArmToken": 0, "DbcHash": dbc_hash()}
    receiver = Receiver("SequencerControl")
    for frame in flat(one.sent(5, lambda: one.sender.send("SequencerControl", control))):
        assert receiver.check(frame.data).accepted
        assert decode(*frame)[1]["DbcHash"] == dbc_hash() ^ 1
    assert set(statuses(flat(one.sent(5)))[1:]) == {FrameStatus.OK}  # frames without a hash are left alone


def test_a_counter_is_stuck_under_a_right_crc(bench: Callable[..., Bench]) -> None:
    found = statuses(flat(bench(BusFault(BusFaultKind.COUNTER_STUCK, start_s=0.02)).sent(6)))
    assert found == [FrameStatus.INITIAL, FrameStatus.OK, FrameStatus.OK, *[FrameStatus.REPEATED] * 3]


def test_a_message_comes_too_seldom_but_in_sequence(bench: Callable[..., Bench]) -> None:
    cycles = bench(BusFault(BusFaultKind.SLOW, period_s=0.045)).sent(21)
    assert [len(cycle) for cycle in cycles] == [1, 0, 0, 0, 0] * 4 + [1]
    assert statuses(flat(cycles)) == [FrameStatus.INITIAL] + [FrameStatus.OK] * 4


def test_silence_is_silent_and_bus_off_is_not(bench: Callable[..., Bench]) -> None:
    one = bench(BusFault(BusFaultKind.SILENCE))
    assert flat(one.sent(5)) == []
    one.near.faults = (BusFault(BusFaultKind.BUS_OFF),)
    with pytest.raises(BusError, match="bus-off"):
        send(one.near, [one.setpoints()], 0.0)
    with pytest.raises(BusError, match="bus-off"):
        list(drain(one.near))


def test_the_clock_jumps(bench: Callable[..., Bench]) -> None:
    one = bench(BusFault(BusFaultKind.CLOCK_JUMP, start_s=1.0, jump_s=-0.5))
    assert one.near.clock_offset_s() == 0.0
    one.clock.pass_(1.5)
    assert one.near.clock_offset_s() == -0.5


def test_frames_that_are_none_of_the_protocols_pass_every_fault_unharmed(bench: Callable[..., Bench]) -> None:
    kinds = [BusFaultKind.WRONG_VERSION, BusFaultKind.COUNTER_STUCK, BusFaultKind.SLOW]
    one = bench(*(BusFault(kind) for kind in kinds))
    strange = [
        can.Message(arbitration_id=0x7FF, data=b"1", is_extended_id=False),
        can.Message(arbitration_id=0x110, data=b"", is_extended_id=False),
        can.Message(arbitration_id=0x100, data=b"\x01\x02", is_extended_id=False),
        can.Message(arbitration_id=0x110, data=b"12", is_extended_id=True),
        can.Message(arbitration_id=0x100, is_extended_id=False, is_remote_frame=True),
    ]
    for message in strange:
        one.near.send(message)
        got = one.far.recv(1.0)
        assert got is not None
        assert got.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)
    one.near.faults = (BusFault(BusFaultKind.CORRUPT, bits=64), BusFault(BusFaultKind.CORRUPT))
    one.near.send(can.Message(arbitration_id=0x100, is_extended_id=False, is_remote_frame=True))
    assert one.far.recv(1.0) is not None


# ---------------------------------------------------------------------- both ends of the link under each fault


class Link:
    """The board's rules and the sequencer's link in lock-step; the sequencer's end of the bus is faulty."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.rules, self.link = BoardRules(BoardLimits(120e3, 150e3)), SequencerLink()
        self.link.arm()
        self.t_s = 0.0

    def run(self, duration_s: float) -> None:
        for _ in range(round(duration_s / PERIOD_S)):
            self.t_s = round(self.t_s + PERIOD_S, 6)
            self.bench.clock.pass_(PERIOD_S)
            for frame, _ in drain(self.bench.far):
                self.rules.receive(frame.frame_id, frame.data, self.t_s)
            self.rules.tick(self.t_s, [0.0] * 4)
            out = self.rules.outgoing(self.t_s) + self.rules.measurements(
                self.t_s,
                pressures_Pa=[0.0] * 4,
                openings=[0.0] * 4,
                supply_pressure_Pa=250e3,
                main_supply_open=True,
                angular_velocity_rad_s=[0.0] * 3,
                specific_force_m_s2=[0.0] * 3,
            )
            send(self.bench.far, out, self.t_s)
            own_s = self.t_s + self.bench.near.clock_offset_s()
            try:
                for frame, _ in drain(self.bench.near):
                    self.link.receive(frame.frame_id, frame.data, own_s)
                send(self.bench.near, self.link.outgoing(own_s, [50e3] * 4), own_s)
            except BusError:
                pass  # the board hears nothing of it


SETPOINTS = "SequencerSetpoints"
ENDS: list[tuple[BusFault, set[SafeReason]]] = [
    (BusFault(BusFaultKind.DROP), {SafeReason.COMMAND_TIMEOUT}),
    (BusFault(BusFaultKind.DROP, message="SequencerHeartbeat"), {SafeReason.HEARTBEAT_TIMEOUT}),
    (BusFault(BusFaultKind.SILENCE), {SafeReason.COMMAND_TIMEOUT}),
    (BusFault(BusFaultKind.BUS_OFF), {SafeReason.COMMAND_TIMEOUT}),
    (BusFault(BusFaultKind.DELAY, delay_s=0.3), {SafeReason.COMMAND_TIMEOUT}),
    (BusFault(BusFaultKind.CORRUPT), {SafeReason.PROTECTION_ERROR}),
    (BusFault(BusFaultKind.COUNTER_STUCK, message=SETPOINTS), {SafeReason.PROTECTION_ERROR}),
    (BusFault(BusFaultKind.DUPLICATE), {SafeReason.PROTECTION_ERROR}),
    (BusFault(BusFaultKind.REORDER, message=SETPOINTS), {SafeReason.PROTECTION_ERROR}),
    (BusFault(BusFaultKind.WRONG_VERSION), {SafeReason.VERSION_MISMATCH}),
    (BusFault(BusFaultKind.SLOW, message=SETPOINTS, period_s=0.2), {SafeReason.COMMAND_TIMEOUT}),
]


@pytest.mark.parametrize(("fault", "reasons"), ENDS, ids=[f"{fault.kind}-{fault.message}" for fault, _ in ENDS])
def test_an_armed_board_latches_for_the_reason(
    bench: Callable[..., Bench], fault: BusFault, reasons: set[SafeReason]
) -> None:
    both = Link(bench())
    both.run(0.5)
    assert both.rules.state.mode is BoardMode.ARMED
    both.bench.near.faults = (BusFault(**{**vars_of(fault), "direction": Direction.SEND}),)
    both.run(1.0)
    latched = [each.reason for each in both.rules.transitions if each.mode is BoardMode.SAFE_LATCHED]
    assert set(latched) == reasons
    both.bench.near.faults = ()
    both.run(1.0)
    assert both.link.state is LinkState.FAILED  # and nobody arms it by itself
    assert both.rules.state.safe


def vars_of(fault: BusFault) -> dict[str, Any]:
    return {name: getattr(fault, name) for name in fault.__dataclass_fields__}


def test_a_clock_that_goes_back_ends_the_link(bench: Callable[..., Bench]) -> None:
    both = Link(bench())
    both.run(0.5)
    both.bench.near.faults = (BusFault(BusFaultKind.CLOCK_JUMP, jump_s=-1.0),)
    both.run(0.2)
    assert both.link.failure is LinkFailure.CLOCK_ERROR
    assert both.rules.state.safe


@pytest.mark.parametrize(
    "fault",
    [
        BusFault(BusFaultKind.DROP, probability=0.05),
        BusFault(BusFaultKind.DELAY, delay_s=0.02),
        BusFault(BusFaultKind.DUPLICATE, probability=0.02),
        BusFault(BusFaultKind.CORRUPT, probability=0.02),
        BusFault(BusFaultKind.BABBLE, period_s=0.0005),
        BusFault(BusFaultKind.SLOW, message=SETPOINTS, period_s=0.05),
    ],
    ids=lambda fault: str(fault.kind),
)
def test_what_is_tolerated_goes_on(bench: Callable[..., Bench], fault: BusFault) -> None:
    both = Link(bench(fault, seed=3))
    both.run(3.0)
    assert both.rules.state.mode is BoardMode.ARMED
    assert both.link.armed


# ---------------------------------------------------------------------- the file


GOOD = """
[[bus_fault]]
kind = "corrupt"
direction = "receive"
message = "BoardPressures"
start_s = 2
probability = 0.5
bits = 3

[[bus_fault]]
kind = "babble"
frame_id = 0x7F
"""


def test_faults_are_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "faults.toml"
    path.write_text(GOOD)
    assert read_bus_faults(path) == (
        BusFault(BusFaultKind.CORRUPT, Direction.RECEIVE, "BoardPressures", 2, probability=0.5, bits=3),
        BusFault(BusFaultKind.BABBLE, frame_id=0x7F),
    )
    path.write_text("")
    assert read_bus_faults(path) == ()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[[bus_fault]]\nkind='moths'", r"bus_fault\.0\.kind = 'moths': take one of drop, delay"),
        ("[[bus_fault]]\nstart_s=1", r"bus_fault\.0\.kind: missing"),
        ("[[bus_fault]]\nkind='drop'\nchance=1", r"bus_fault\.0\.chance: unknown key"),
        ("[[bus_fault]]\nkind='drop'\nprobability=1.5", r"bus_fault\.0\.probability = 1\.5: must be from 0 to 1"),
        ("[[bus_fault]]\nkind='drop'\nprobability=nan", r"bus_fault\.0\.probability = nan: must be a number"),
        ("[[bus_fault]]\nkind='drop'\nbits=true", r"bus_fault\.0\.bits = True: must be a number"),
        ("[[bus_fault]]\nkind='drop'\nbits=1.5", r"bus_fault\.0\.bits = 1\.5: must be a number"),
        ("[[bus_fault]]\nkind='drop'\nmessage='Setpoints'", r"bus_fault\.0\.message = 'Setpoints': no message of"),
        ("[[bus_fault]]\nkind='drop'\nmessage=1", r"bus_fault\.0\.message = 1: must be a word"),
        ("[[bus_fault]]\nkind='drop'\ndirection='up'", r"bus_fault\.0\.direction = 'up': take one of send"),
        ("[bus_fault]\nkind='drop'", r"only \[\[bus_fault\]\] tables belong there"),
        ("[drive]\nkind='drop'", r"holds drive; only"),
        ("kind=", "is no TOML"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "faults.toml"
    path.write_text(text)
    with pytest.raises(BusFaultError, match=says) as error:
        read_bus_faults(path)
    assert str(path) in str(error.value)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(BusFaultError, match=r"none\.toml: cannot be read: No such file"):
        read_bus_faults(tmp_path / "none.toml")


def test_a_file_may_be_edited_while_the_node_runs(bench: Callable[..., Bench], tmp_path: Path) -> None:
    path = tmp_path / "faults.toml"
    path.write_text(GOOD)
    told: list[str] = []
    near = bench().near
    file = FaultFile(path, near, told.append)
    assert len(near.faults) == 2
    file.poll()
    assert told == []
    path.write_text("[[bus_fault]]\nkind = 'silence'\n")
    file.poll()
    assert [fault.kind for fault in near.faults] == [BusFaultKind.SILENCE]
    path.write_text("[[bus_fault]]\nkind = 'moths'\n")
    file.poll()
    assert [fault.kind for fault in near.faults] == [BusFaultKind.SILENCE]
    path.write_text("")
    file.poll()
    assert near.faults == ()
    os.unlink(path)
    file.poll()
    assert told[0] == "faults of the bus from now on: silence"
    assert "moths" in told[1]
    assert told[2] == "faults of the bus from now on: none"
    assert "cannot be read" in told[3]
