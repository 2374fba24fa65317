"""The board in C and the board in Python decide the same, event by event, whatever comes."""

from __future__ import annotations

import ctypes
import math
import random
import struct
from collections import Counter
from typing import Any

import pytest

from firmware_protocol.arming import arm_token
from firmware_protocol.board import BoardLimits, BoardRules
from firmware_protocol.c_board import CBoardRules
from firmware_protocol.codec import dbc_hash
from firmware_protocol.e2e import FrameStatus, Sender, protect
from firmware_protocol.enumerations import BoardMode, BusState, Parameter, SafeReason
from firmware_protocol.errors import LimitsError
from firmware_protocol.parameters import PARAMETERS
from firmware_protocol.reception import ReceptionLimits
from firmware_protocol.safety import SENSOR_INVALID_hPa
from firmware_protocol.spec import BOARD, spec

EVENT = struct.Struct("=Q4iIBB18s")
OUTCOME = struct.Struct("=8i4i66s2x")
RECEIVE, TICK, OUTGOING, FAILURE, BUS = range(5)
STATUSES = {status: number for number, status in enumerate(FrameStatus)}
INDEX = {message.name: number for number, message in enumerate(spec().messages)}
TO_BOARD = [message for message in spec().messages if BOARD in message.receivers]
LENGTHS = {message.name: message.length_bytes for message in spec().messages}
IDS = {message.name: message.frame_id for message in spec().messages}
LIMITS = (
    BoardLimits(200e3, 250e3),
    BoardLimits(809.0e3, 809.1e3, 0.04, 0.1, 0.2, ReceptionLimits(1, 1, 0)),
    BoardLimits(100.0, 300.0, 0.1, 0.2, 1.0, ReceptionLimits(14, 32, 31)),
)


class Session:
    """One board in Python, talked to at random, with everything recorded for the board in C.

    What is said leans towards what a sequencer would say next, so that the deep states are reached.
    """

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.limits = LIMITS[self.random.choices(range(len(LIMITS)), (6, 1, 1))[0]]
        self.seed = self.random.randint(1, 0xFFFF)
        self.board = BoardRules(self.limits, challenge_seed=self.seed, version=(1, 2, 3))
        self.now_us = self.random.choice((0, 0, 17, 4_294_960_000, 1 << 50))
        self.counters = dict.fromkeys(LENGTHS, 0)
        self.said: list[tuple[int, bytes]] = []
        self.events = bytearray()
        self.outcomes = bytearray()
        self.count = 0

    def run(self, events: int) -> None:
        if self.random.random() < 0.7:
            self.arm()
        for _ in range(events):
            self.pass_time()
            self.random.choices(
                (self.speak, self.tick, self.disturb, self.outgoing, self.failure, self.bus),
                (50, 16, 16, 14, 1, 2),
            )[0]()

    def arm(self) -> None:
        self.tick(rest=True)
        self.control(0)
        self.heartbeat(0)
        self.control(1)
        self.control(2, arm_token(self.board.state.challenge, dbc_hash()))
        self.control(3)

    # ------------------------------------------------------------------ time

    def pass_time(self) -> None:
        choice = self.random.random()
        if choice < 0.45:
            return
        if choice < 0.85:
            self.now_us += self.random.randrange(12_000)
        elif choice < 0.97:  # to the edge of a timeout
            state, values = self.board.state, self.board.parameters.values
            since_us = self.random.choice(
                (state.mode_since_us, state.setpoints_us, state.control_us, state.heartbeat_us, state.now_us)
            )
            timeout = self.random.choice(
                (Parameter.COMMAND_TIMEOUT, Parameter.HEARTBEAT_TIMEOUT, Parameter.ARMING_TIMEOUT)
            )
            edge_us = (since_us or 0) + 1000 * values[timeout] + self.random.choice((-1, 0, 1))
            self.now_us = max(self.now_us, edge_us)
        elif choice < 0.99:
            self.now_us += self.random.randrange(10_000_000_000)
        else:
            self.now_us = max(0, self.now_us - self.random.choice((1, 1000, 10_000_000)))

    # ------------------------------------------------------------------ what the sequencer says

    def speak(self) -> None:
        self.random.choices(
            (self.next_control, self.setpoints, self.any_heartbeat, self.parameter, self.sync, self.stop),
            (34, 22, 20, 14, 6, 2),
        )[0]()

    def next_control(self) -> None:
        mode = self.board.state.mode
        if self.random.random() < 0.1:
            self.control(
                self.random.randrange(4),
                self.random.randrange(0x10000),
                self.random.choice((dbc_hash(), dbc_hash() ^ 1 << self.random.randrange(32))),
            )
        elif mode is BoardMode.SAFE_LATCHED:
            self.control(0)
        elif mode is BoardMode.DISARMED:
            self.control(1)
        elif mode is BoardMode.ARMING:
            self.control(2, arm_token(self.board.state.challenge, dbc_hash()))
        else:
            self.control(self.random.choice((3, 3, 3, 3, 3, 2)))

    def control(self, mode: int, token: int = 0, peer_hash: int | None = None) -> None:
        hashed = dbc_hash() if peer_hash is None else peer_hash
        self.say("SequencerControl", mode << 12 | token << 16 | hashed << 32)

    def setpoints(self) -> None:
        limit = self.board.parameters.values[Parameter.MAX_SETPOINT]
        word = 0
        for start in (12, 25, 38, 51):
            word |= (
                self.random.choice((0, limit - 1, limit, min(limit + 1, 8191), self.random.randrange(8192))) << start
            )
        self.say("SequencerSetpoints", word)

    def any_heartbeat(self) -> None:
        self.heartbeat(self.random.choices(range(4), (90, 5, 3, 2))[0])

    def heartbeat(self, health: int) -> None:
        self.say("SequencerHeartbeat", self.random.randrange(7) << 12 | health << 16 | 5 << 20)

    def stop(self) -> None:
        self.say("EmergencyStop", self.random.choice((0, 1, 2, 3, 15)) << 12)

    def sync(self) -> None:
        self.say("TimeSyncRequest", self.random.randrange(16) << 12 | self.random.getrandbits(32) << 16)

    def parameter(self) -> None:
        wanted = self.random.choice(PARAMETERS)
        number = self.random.choice((wanted.parameter, wanted.parameter, wanted.parameter, self.random.randrange(256)))
        near = self.board.parameters.values[wanted.parameter] + self.random.choice((-5, -1, 0, 1))
        value = self.random.choice((near, near, wanted.minimum or 0, max(0, (wanted.minimum or 0) - 1), 0xFFFFFFFF))
        operation = self.random.choice((0, 1, 1, 1))
        transaction = self.random.randrange(256)
        self.say("ParameterRequest", operation << 12 | number << 16 | transaction << 24 | (value & 0xFFFFFFFF) << 32)

    def say(self, name: str, word: int) -> None:
        counter = self.counters[name]
        self.counters[name] = (counter + 1) % 16
        data = protect(name, word.to_bytes(LENGTHS[name], "little"), counter)
        self.said.append((IDS[name], data))
        self.receive(IDS[name], data)

    # ------------------------------------------------------------------ what else comes

    def disturb(self) -> None:
        self.random.choice((self.any_frame, self.flip, self.again, self.skip, self.right_crc_over_anything))()

    def any_frame(self) -> None:
        length = self.random.randrange(9)
        frame_id = self.random.choice((self.random.randrange(2048), self.random.choice(list(IDS.values()))))
        self.receive(frame_id, self.random.randbytes(length))

    def flip(self) -> None:
        if self.said:
            frame_id, data = self.random.choice(self.said)
            word = int.from_bytes(data, "little")
            for _ in range(self.random.randint(1, 4)):
                word ^= 1 << self.random.randrange(8 * len(data))
            self.receive(frame_id, word.to_bytes(len(data), "little"))

    def again(self) -> None:
        if self.said:
            frame_id, data = self.random.choice((self.said[-1], self.random.choice(self.said)))
            self.receive(frame_id, data[: self.random.choice((8, 8, 8, len(data) - 1))])

    def skip(self) -> None:
        name = self.random.choice(TO_BOARD).name
        self.counters[name] = (self.counters[name] + self.random.randint(1, 15)) % 16

    def right_crc_over_anything(self) -> None:
        message = self.random.choice(TO_BOARD)
        data = self.random.randbytes(message.length_bytes)
        self.receive(message.frame_id, protect(message.name, data, self.counters[message.name]))

    # ------------------------------------------------------------------ what is recorded

    def receive(self, frame_id: int, data: bytes) -> None:
        received = self.board.receive(frame_id, data, self.now_us / 1e6)
        index = len(INDEX) if received.name is None else INDEX[received.name]
        result = (STATUSES[received.status], index, int(received.beyond_tolerance), 0, 0, 0, 0, 0)
        self.record(RECEIVE, result, number=frame_id, data=data)

    def tick(self, *, rest: bool = False) -> None:
        limit = self.board.parameters.values[Parameter.OVER_PRESSURE]
        pressures = [0, 0, 0, 0]
        if not rest:
            pressures = [self.random.randint(-100, limit) for _ in range(4)]
            if self.random.random() < 0.08:
                odd = self.random.choice((limit, limit + 1, 70_000, SENSOR_INVALID_hPa))
                pressures[self.random.randrange(4)] = odd
        measured = [math.nan if each == SENSOR_INVALID_hPa else each * 100.0 for each in pressures]
        decision = self.board.tick(self.now_us / 1e6, measured)
        setpoints = tuple(round(each / 100) for each in decision.setpoints_Pa)
        result = (decision.mode, decision.reason, decision.safe, decision.main_supply_open, *setpoints)
        self.record(TICK, result, pressures=pressures)

    def outgoing(self) -> None:
        frames = self.board.outgoing(self.now_us / 1e6)
        flat = b"".join(struct.pack("<HB8s", frame_id, len(data), data) for frame_id, data in frames)
        self.record(OUTGOING, (len(frames), 0, 0, 0, 0, 0, 0, 0), frames=flat)

    def failure(self) -> None:
        reason = self.random.choice([each for each in SafeReason if each > SafeReason.POWER_UP])
        detail = self.random.randrange(256)
        self.board.report_failure(reason, detail)
        self.record(FAILURE, (0,) * 8, number=reason, length=detail)

    def bus(self) -> None:
        state, counts = self.random.choices(list(BusState), (10, 4, 1))[0], self.random.randbytes(2)
        self.board.report_bus(state, *counts)
        self.record(BUS, (0,) * 8, number=state, data=counts)

    def record(
        self,
        kind: int,
        result: tuple[int, ...],
        *,
        number: int = 0,
        data: bytes = b"",
        pressures: list[int] | tuple[int, ...] = (0, 0, 0, 0),
        frames: bytes = b"",
        length: int | None = None,
    ) -> None:
        state = self.board.state
        self.events += EVENT.pack(self.now_us, *pressures, number, kind, len(data) if length is None else length, data)
        self.outcomes += OUTCOME.pack(*result, state.mode, state.reason, state.control_mode, state.challenge, frames)
        self.count += 1


class Replayer:
    """Plays a session's events to a board in C."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self.rules = CBoardRules(LIMITS[0], library=library)
        self.library = library

    def outcomes(self, session: Session) -> bytes:
        outcomes = (ctypes.c_uint8 * (OUTCOME.size * session.count))()
        self.library.replay(
            self.rules.board,
            (ctypes.c_uint16 * 8)(*counts_of(session.limits)),
            ctypes.c_uint16(session.seed),
            ctypes.c_size_t(session.count),
            (ctypes.c_uint8 * len(session.events)).from_buffer(session.events),
            outcomes,
        )
        return bytes(outcomes)

    def assert_remembers_the_same(self, ours: BoardRules) -> None:
        theirs = self.rules
        ours.state.last_error = theirs.state.last_error
        assert theirs.state == ours.state
        assert theirs.parameters.values == ours.parameters.values
        assert theirs.transitions == tuple(ours.transitions)[-16:]
        assert theirs.faults_to_send == tuple(ours.faults_to_send)
        for name, entry in ours.reception.messages.items():
            assert theirs.counts(name) == entry.counts


def counts_of(limits: BoardLimits) -> tuple[int, ...]:
    reception = limits.reception
    return (
        *(limits.max_setpoint_hPa, limits.over_pressure_hPa),
        *(limits.command_timeout_ms, limits.heartbeat_timeout_ms, limits.arming_timeout_ms),
        *(reception.max_counter_delta, reception.window_frames, reception.tolerated_errors),
    )


def first_difference(session: Session, theirs: bytes) -> str:
    for number in range(session.count):
        at = slice(number * OUTCOME.size, (number + 1) * OUTCOME.size)
        if theirs[at] != bytes(session.outcomes[at]):
            event = EVENT.unpack(session.events[number * EVENT.size : (number + 1) * EVENT.size])
            return (
                f"event {number} {event}\nPython {OUTCOME.unpack(session.outcomes[at])}\nC {OUTCOME.unpack(theirs[at])}"
            )
    return ""


def play(library: ctypes.CDLL, first_seed: int, sessions: int, events: int) -> Counter[tuple[BoardMode, SafeReason]]:
    """Plays sessions to both; returns which transitions were made, and how often."""
    replayer = Replayer(library)
    seen: Counter[tuple[BoardMode, SafeReason]] = Counter()
    for seed in range(first_seed, first_seed + sessions):
        session = Session(seed)
        session.run(events)
        theirs = replayer.outcomes(session)
        assert theirs == bytes(session.outcomes), f"seed {seed}: {first_difference(session, theirs)}"
        replayer.assert_remembers_the_same(session.board)
        seen.update((each.mode, each.reason) for each in session.board.transitions)
    return seen


EVERY_TRANSITION = {
    *((BoardMode.SAFE_LATCHED, reason) for reason in SafeReason if reason > SafeReason.POWER_UP),
    *((mode, SafeReason.NONE) for mode in (BoardMode.DISARMED, BoardMode.ARMING, BoardMode.ARMED)),
}


def test_random_events_lead_both_boards_through_the_same_transitions(c_library: ctypes.CDLL) -> None:
    seen = play(c_library, 0, 1500, 30)
    assert set(seen) == EVERY_TRANSITION, EVERY_TRANSITION - set(seen)


@pytest.mark.slow
@pytest.mark.parametrize("part", range(4))
def test_a_hundred_thousand_sequences_lead_both_boards_through_the_same_transitions(
    c_library: ctypes.CDLL, part: int
) -> None:
    seen = play(c_library, 1_000_000 + 25_000 * part, 25_000, 30)
    assert set(seen) == EVERY_TRANSITION


def test_long_sequences_fill_and_turn_every_queue(c_library: ctypes.CDLL) -> None:
    play(c_library, 500, 4, 5_000)


# ---------------------------------------------------------------------- one thing at a time


@pytest.fixture
def boards(c_library: ctypes.CDLL) -> tuple[BoardRules, CBoardRules]:
    """One board in Python and one in C, of the same limits."""
    return BoardRules(LIMITS[0]), CBoardRules(LIMITS[0], library=c_library)


def test_measurements_go_out_as_the_same_bytes(boards: tuple[BoardRules, CBoardRules]) -> None:
    chance = random.Random(4)

    def some(low: float, high: float) -> float:
        odd = (math.nan, math.inf, low * 1.5, high * 1.5)
        return chance.choice(odd) if chance.random() < 0.03 else chance.uniform(low, high)

    sent = 0
    for cycle in range(1500):
        measured = {
            "pressures_Pa": [some(-9e3, 9e5) for _ in range(4)],
            "openings": [some(-1, 1) for _ in range(4)],
            "supply_pressure_Pa": some(-9e3, 1.7e6),
            "main_supply_open": chance.random() < 0.5,
            "angular_velocity_rad_s": [some(-70, 70) for _ in range(3)],
            "specific_force_m_s2": [some(-170, 170) for _ in range(3)],
        }
        t_s = cycle * chance.choice((0.004, 0.01, 0.01))
        ours, theirs = (board.measurements(t_s, **measured) for board in boards)
        assert theirs == ours
        sent += len(ours)
    assert 2000 < sent < 7000  # some were not due, some left out


@pytest.mark.parametrize(
    "measured",
    [
        {"pressures_Pa": (0.0,) * 3},
        {"openings": None},
        {"supply_pressure_Pa": "much"},
        {"angular_velocity_rad_s": (0.0,) * 4},
    ],
)
def test_measurements_that_make_no_sense_end_in_the_safe_state(
    boards: tuple[BoardRules, CBoardRules], measured: dict[str, Any]
) -> None:
    good = {
        "pressures_Pa": (0.0,) * 4,
        "openings": (0.0,) * 4,
        "supply_pressure_Pa": 0.0,
        "main_supply_open": False,
        "angular_velocity_rad_s": (0.0,) * 3,
        "specific_force_m_s2": (0.0,) * 3,
    }
    for board in boards:
        assert board.measurements(0.0, **(good | measured)) == []
        assert board.state.reason is SafeReason.INTERNAL_ERROR
        assert "Error" in board.state.last_error


def test_a_wrong_number_of_pressures_ends_in_the_safe_state(boards: tuple[BoardRules, CBoardRules]) -> None:
    for board in boards:
        for measured in ((0.0,) * 3, (0.0,) * 5, ("low",) * 4, None):
            decision = board.tick(0.0, measured)  # type: ignore[arg-type]
            assert (decision.safe, decision.reason) == (True, SafeReason.INTERNAL_ERROR)
            assert not board.state.pressures_valid


def test_times_and_frames_that_make_no_sense_end_in_the_safe_state(c_library: ctypes.CDLL) -> None:
    for t_s in (math.nan, -1.0, 1e300):
        for call in ("tick", "receive", "outgoing"):
            board = CBoardRules(LIMITS[0], library=c_library)
            board.tick(5.0, (0.0,) * 4)
            if call == "tick":
                decision = board.tick(t_s, (0.0,) * 4)
                assert (decision.safe, decision.reason) == (True, SafeReason.INTERNAL_ERROR)
            elif call == "receive":
                assert board.receive(0x10, bytes(2), t_s).status is FrameStatus.MALFORMED
            else:
                assert board.outgoing(t_s) == []
            assert board.state.reason is SafeReason.INTERNAL_ERROR
            assert board.state.now_us == 5_000_000


def test_identifiers_outside_of_eleven_bits_and_long_frames_are_refused(
    boards: tuple[BoardRules, CBoardRules],
) -> None:
    for frame_id, data in ((-1, b""), (1 << 40, bytes(8)), (0x810, bytes(2)), (0x10, bytes(64)), (0x10, b"")):
        ours, theirs = (board.receive(frame_id, data, 0.0) for board in boards)
        assert theirs == ours
        assert not theirs.status.accepted


def test_the_whole_identifier_space_but_the_list_is_refused_in_c(c_library: ctypes.CDLL) -> None:
    board = CBoardRules(LIMITS[0], library=c_library)
    listed = {message.frame_id: message.length_bytes for message in TO_BOARD}
    refused = 0
    for frame_id in range(2048):
        for length in range(9):
            if listed.get(frame_id) != length:
                status = board.receive(frame_id, bytes(length), 0.0).status
                assert status is (FrameStatus.MALFORMED if frame_id in listed else FrameStatus.NOT_LISTED)
                refused += 1
    assert refused == 2048 * 9 - len(TO_BOARD)
    assert board.state.mode is BoardMode.SAFE_LATCHED


# ---------------------------------------------------------------------- limits


def init(library: ctypes.CDLL, counts: tuple[int, ...], seed: int = 1, major: int = 0) -> tuple[bool, ctypes.Array]:
    CBoardRules(LIMITS[0], library=library)  # tells ctypes what the functions return
    board = (ctypes.c_uint64 * library.softbot_host_size())()
    accepted = library.softbot_host_init(
        board, (ctypes.c_uint16 * 8)(*counts), ctypes.c_uint16(seed), (ctypes.c_uint8 * 3)(major, 0, 0)
    )
    return accepted, board


def test_c_accepts_the_limits_that_python_accepts(c_library: ctypes.CDLL) -> None:
    usual = counts_of(LIMITS[0])
    edges: tuple[tuple[int, ...], ...] = (
        *((0, 1, 2499, 2500, 2501), (1999, 2000, 2001, 8091, 8092, 65535)),
        *((0, 1, 10_000, 10_001),) * 3,
        *((0, 1, 14, 15), (0, 1, 3, 4, 32, 33), (0, 15, 16, 31, 32)),
    )
    verdicts = Counter()
    for place, values in enumerate(edges):
        for value in values:
            counts = (*usual[:place], value, *usual[place + 1 :])
            try:
                BoardLimits(
                    *(each * 100.0 for each in counts[:2]),
                    *(each / 1000 for each in counts[2:5]),
                    ReceptionLimits(*counts[5:]),
                )
                expected = counts[6] <= 32
            except LimitsError:
                expected = False
            assert init(c_library, counts)[0] is expected, counts
            verdicts[expected] += 1
    assert min(verdicts.values()) > 10
    assert not init(c_library, usual, seed=0)[0]
    assert init(c_library, usual, major=15)[0]
    assert not init(c_library, usual, major=16)[0]


def test_a_board_whose_limits_were_refused_cannot_be_armed(c_library: ctypes.CDLL) -> None:
    accepted, memory = init(c_library, (3000, 2000, 100, 200, 1000, 3, 16, 3))
    assert not accepted
    board = CBoardRules(LIMITS[0], library=c_library)
    board.board = memory
    for number, (mode, counter) in enumerate(((0, 0), (1, 1), (2, 2), (3, 3))):
        t_s = 0.001 * number
        assert board.tick(t_s, (-1e3,) * 4).safe
        word = mode << 12 | arm_token(board.state.challenge, dbc_hash()) << 16 | dbc_hash() << 32
        data = protect("SequencerControl", word.to_bytes(8, "little"), counter)
        assert board.receive(0x100, data, t_s).status.accepted
        data = protect("SequencerSetpoints", (0xFFF << 12).to_bytes(8, "little"), counter)
        assert board.receive(0x110, data, t_s).status.accepted
        decision = board.tick(t_s, (-1e3,) * 4)
        assert (decision.safe, decision.main_supply_open) == (True, False)
        assert decision.mode is not BoardMode.ARMED


def test_the_adapter_says_what_the_board_in_c_cannot_do(c_library: ctypes.CDLL) -> None:
    with pytest.raises(LimitsError, match="challenge_seed = 0 must be from 1 to 65535"):
        CBoardRules(LIMITS[0], challenge_seed=0, library=c_library)
    with pytest.raises(LimitsError, match="window_frames = 33 must be at most 32"):
        CBoardRules(BoardLimits(200e3, 250e3, reception=ReceptionLimits(window_frames=33)), library=c_library)
    with pytest.raises(LimitsError, match="major number must be from 0 to 15"):
        CBoardRules(LIMITS[0], version=(16, 0, 0), library=c_library)


# ---------------------------------------------------------------------- what only a C caller can get wrong


def test_what_is_no_reason_to_latch_counts_as_an_internal_error(c_library: ctypes.CDLL) -> None:
    for reason in (0, 1, 16, 1 << 31):
        board = CBoardRules(LIMITS[0], library=c_library)
        c_library.softbot_board_report_failure(board.board, ctypes.c_uint(reason), ctypes.c_uint16(9))
        assert (board.state.mode, board.state.reason) == (BoardMode.SAFE_LATCHED, SafeReason.INTERNAL_ERROR)
        assert board.faults_to_send[0].detail == 9


def test_what_is_no_bus_state_counts_as_bus_off(c_library: ctypes.CDLL) -> None:
    board = CBoardRules(LIMITS[0], library=c_library)
    c_library.softbot_board_report_bus(board.board, ctypes.c_uint(77), ctypes.c_uint8(0), ctypes.c_uint8(0))
    assert (board.state.bus_state, board.state.reason) == (BusState.BUS_OFF, SafeReason.BUS_OFF)


def test_when_no_fault_is_sent_the_last_eight_are_kept(boards: tuple[BoardRules, CBoardRules]) -> None:
    disarm, stop = {"Mode": 0, "ArmToken": 0, "DbcHash": dbc_hash()}, "EmergencyStop"
    for board in boards:
        peer = Sender()
        for number in range(11):
            board.tick(0.0, (0.0,) * 4)
            assert board.receive(*peer.send("SequencerControl", disarm), 0.0).status.accepted
            board.receive(*peer.send(stop, {"Reason": (0, 1, 2, 3, 15)[number % 5]}), 0.0)
    ours, theirs = boards
    assert theirs.faults_to_send == tuple(ours.faults_to_send)
    assert [fault.detail for fault in theirs.faults_to_send] == [3, 15, 0, 1, 2, 3, 15, 0]
    for cycle in range(60):
        assert theirs.outgoing(cycle / 100) == ours.outgoing(cycle / 100)
    assert theirs.faults_to_send == ()


def test_a_measurement_that_the_message_cannot_carry_is_left_out_and_takes_no_counter(c_library: ctypes.CDLL) -> None:
    board = CBoardRules(LIMITS[0], library=c_library)
    frames, physical = (ctypes.c_uint8 * 66)(), (ctypes.c_double * 15)()
    for now_us, is_open, sent in ((0, 2, 4), (10_000, 1, 5), (20_000, 255, 4), (30_000, 0, 5)):
        count = c_library.softbot_host_measurements(
            board.board, ctypes.c_uint64(now_us), physical, ctypes.c_uint8(is_open), frames
        )
        assert count == sent
    assert frames[11 + 4] & 0x0F == 1  # the second BoardValves that went out
