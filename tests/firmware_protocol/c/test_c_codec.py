"""The C codec and the Python codec give the same bytes, the same values and the same refusals."""

from __future__ import annotations

import ctypes
import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from firmware_protocol.c_codec import c_codec as generate
from firmware_protocol.c_names import payload, snake_case, type_bits
from firmware_protocol.c_physical import to_physical_name, to_raw_name
from firmware_protocol.codec import decode, encode
from firmware_protocol.e2e import FrameStatus, Receiver, check, protect
from firmware_protocol.enumerations import SafeReason
from firmware_protocol.errors import FrameError, SpecError
from firmware_protocol.spec import MessageSpec, SignalKind, SignalSpec, dbc_text, message_spec, read_spec, spec

MESSAGES = spec().messages
NAMES = [message.name for message in MESSAGES]
Generator = np.random.Generator


def random_whole(random: Generator, signal: SignalSpec, rows: int) -> np.ndarray:
    """Mostly what may be sent, else anything that the signal's C type holds."""
    bits = type_bits(signal)
    low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signal.signed else (0, (1 << bits) - 1)
    values = random.integers(signal.raw_minimum, signal.raw_maximum, rows, endpoint=True)
    if signal.kind is SignalKind.ENUMERATION:
        values = random.choice(sorted(signal.choices), rows)
    wild = random.random(rows) < 0.05
    values[wild] = random.integers(low, min(high, 2**63 - 1), wild.sum(), endpoint=True)
    return values


def random_physical(random: Generator, signal: SignalSpec, rows: int) -> np.ndarray:
    """Anything within the range, exact counts, exact ties, the ends with and without slack, what is no number."""
    steps = random.uniform(signal.raw_minimum, signal.raw_maximum, rows)
    kind = random.random(rows)
    steps = np.where(kind < 0.3, np.round(steps), np.where(kind < 0.6, np.floor(steps) + 0.5, steps))
    ends = random.choice([signal.raw_minimum, signal.raw_maximum], rows)
    beyond = random.choice([0.0, 0.9e-6, 1.1e-6, 0.4, 1.0, 1e6], rows) * random.choice([-1.0, 1.0], rows)
    steps = np.where((kind > 0.9) & (kind < 0.99), ends + beyond, steps)
    values = steps * signal.scale + signal.offset
    odd = kind > 0.995
    values[odd] = random.choice([math.nan, math.inf, -math.inf, 1.7e308, -1.7e308, 5e-324], odd.sum())
    return values


def random_messages(random: Generator, message: MessageSpec, rows: int) -> tuple[np.ndarray, np.ndarray]:
    signals = payload(message)
    whole, physical = np.zeros((rows, len(signals)), np.int64), np.zeros((rows, len(signals)))
    for column, signal in enumerate(signals):
        if signal.whole:
            whole[:, column] = random_whole(random, signal, rows)
        else:
            physical[:, column] = random_physical(random, signal, rows)
    return whole, physical


def rows_of_values(message: MessageSpec, whole: np.ndarray, physical: np.ndarray) -> list[list[float]]:
    """Each row's values as Python numbers, whole ones as integers."""
    wholes, physicals = whole.tolist(), physical.tolist()
    is_whole = [signal.whole for signal in payload(message)]
    return [
        [whole_row[i] if each else physical_row[i] for i, each in enumerate(is_whole)]
        for whole_row, physical_row in zip(wholes, physicals, strict=True)
    ]


def assert_encoded_alike(c_codec: Any, message: MessageSpec, random: Generator, rows: int) -> np.ndarray:
    """Encodes random messages with both; returns the frames that were accepted."""
    names = [signal.name for signal in payload(message)]
    whole, physical = random_messages(random, message, rows)
    frames, accepted = c_codec.encode(message, whole, physical)
    padded = bytes(8 - message.length_bytes)
    expected, taken = bytearray(), bytearray()
    for row, values in enumerate(rows_of_values(message, whole, physical)):
        try:
            data = encode(message.name, dict(zip(names, values, strict=True))).data
        except FrameError:
            expected += bytes(8)
            taken.append(0)
        else:
            expected += protect(message.name, data, row % 16) + padded
            taken.append(1)
    assert accepted.tolist() == list(taken)
    assert frames.tobytes() == bytes(expected)
    return frames[accepted == 1]


def assert_decoded_alike(c_codec: Any, message: MessageSpec, frames: np.ndarray) -> int:
    """Decodes with both; returns how many were accepted."""
    names = [signal.name for signal in payload(message)]
    whole, physical, accepted, protected = c_codec.decode(message, frames)
    rows = rows_of_values(message, whole, physical)
    for row, frame in enumerate(frames):
        data = frame.tobytes()[: message.length_bytes]
        assert bool(protected[row]) == check(message.name, data)
        try:
            values = decode(message.frame_id, data)[1]
        except FrameError:
            assert not accepted[row], data.hex()
        else:
            assert accepted[row], data.hex()
            assert rows[row] == [values[name] for name in names], data.hex()
    return int(accepted.sum())


def mutated(random: Generator, message: MessageSpec, frames: np.ndarray) -> np.ndarray:
    """The frames with none to four of their bits flipped."""
    flipped = np.unpackbits(frames[:, : message.length_bytes], axis=1)
    for _ in range(4):
        struck = random.random(len(frames)) < 0.4
        flipped[struck, random.integers(0, 8 * message.length_bytes, struck.sum())] ^= 1
    changed = np.zeros_like(frames)
    changed[:, : message.length_bytes] = np.packbits(flipped, axis=1)
    return changed


def compare(c_codec: Any, seed: int, total: int) -> None:
    random = np.random.default_rng(seed)
    each = -(-total // len(MESSAGES))
    for message in MESSAGES:
        valid = assert_encoded_alike(c_codec, message, random, each)
        assert each * 0.3 < len(valid) < each  # both paths were walked
        assert assert_decoded_alike(c_codec, message, valid[: each // 4]) == len(valid[: each // 4])
        assert_decoded_alike(c_codec, message, mutated(random, message, valid[: each // 4]))


def test_c_and_python_code_the_same_messages_to_the_same_bytes(c_codec: Any) -> None:
    compare(c_codec, 1, 26_000)


@pytest.mark.slow
def test_c_and_python_code_a_million_messages_to_the_same_bytes(c_codec: Any) -> None:
    compare(c_codec, 2, 1_000_000)


@pytest.mark.parametrize(
    ("message", "signal"),
    [(message, signal) for message in MESSAGES for signal in payload(message) if signal.length <= 16],
    ids=lambda each: each.name,
)
def test_every_count_of_a_signal_decodes_to_the_same_value(
    c_codec: Any, message: MessageSpec, signal: SignalSpec
) -> None:
    words = np.arange(1 << signal.length, dtype=np.uint64) << np.uint64(signal.start)
    frames = words.astype("<u8").view(np.uint8).reshape(-1, 8)
    step = 1 if signal.length <= 11 else 7  # 7 divides no power of two: every bit pattern of the ends comes by
    kept = np.ascontiguousarray(np.concatenate([frames[::step], frames[-1:]]))
    assert assert_decoded_alike(c_codec, message, kept) > 0


@pytest.mark.parametrize("message", MESSAGES, ids=NAMES)
def test_raw_counts_are_checked_saturated_and_placed(c_codec: Any, message: MessageSpec) -> None:
    random = np.random.default_rng(message.frame_id)
    signals = payload(message)
    raw = np.stack([random_whole(random, signal, 4000) for signal in signals], axis=1)
    for column, signal in enumerate(signals):  # each signal alone beyond its ends, and at the ends of its C type
        bits = type_bits(signal)
        least, most = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signal.signed else (0, (1 << bits) - 1)
        ends = (signal.raw_minimum - 1, signal.raw_maximum + 1, least, most)
        for row, value in enumerate(ends):
            each = 8 * column + row
            raw[each] = [max(0, other.raw_minimum) for other in signals]
            raw[each, column] = min(max(value, least), most)
    frames, accepted = c_codec.pack(message, np.ascontiguousarray(raw))
    for row, values in enumerate(raw.tolist()):
        word, allowed = 0, True
        for signal, value in zip(signals, values, strict=True):
            if signal.kind is SignalKind.SATURATED_NUMBER:
                value = min(max(value, signal.raw_minimum), signal.raw_maximum)
            elif signal.kind is SignalKind.ENUMERATION:
                allowed &= value in signal.choices
            allowed &= signal.raw_minimum <= value <= signal.raw_maximum
            word |= (value & (1 << signal.length) - 1) << signal.start
        assert bool(accepted[row]) is allowed
        assert frames[row].tobytes() == (word if allowed else 0).to_bytes(8, "little")


def test_ties_go_to_the_even_count_and_the_slack_ends_where_pythons_does(c_codec: Any) -> None:
    message, signal = (
        message_spec("ImuGyro"),
        next(each for each in message_spec("ImuGyro").signals if each.name == "X"),
    )
    from_physical = c_codec.library[to_raw_name(message, signal)]
    from_physical.restype = ctypes.c_bool
    back = c_codec.library[to_physical_name(message, signal)]
    back.restype = ctypes.c_double

    def count(physical: float) -> int | None:
        raw = ctypes.c_int16(0x55)
        accepted = from_physical(ctypes.c_double(physical), ctypes.byref(raw))
        assert accepted or raw.value == 0x55  # a refusal writes nothing
        return raw.value if accepted else None

    ties = {0.001: 0, 0.003: 2, 0.005: 2, 0.007: 4, -0.001: 0, -0.003: -2, -0.005: -2, -0.007: -4}
    assert {each: count(each) for each in ties} == ties
    assert (count(0.0011), count(-0.0011), count(0.0031), count(-0.0031)) == (1, -1, 2, -2)
    assert (count(1e300), count(-1e300)) == (32767, -32768)  # a measurement saturates
    assert [count(each) for each in (math.nan, math.inf, -math.inf, 1.7e308)] == [None] * 4
    assert back(ctypes.c_int16(-3)) == -3 * 0.002


def test_an_unlisted_index_is_neither_packed_nor_unpacked(c_codec: Any) -> None:
    for index in (len(MESSAGES), len(MESSAGES) + 1):
        signals, data = (ctypes.c_uint32 * 32)(index), (ctypes.c_uint8 * 8)()
        assert not c_codec.library.softbot_pack(signals, data) & 0xFF
        assert not c_codec.library.softbot_unpack(ctypes.c_uint32(index), data, signals) & 0xFF


# ---------------------------------------------------------------------- the generated text


def test_the_header_carries_hash_tables_and_identifiers_of_the_dbc() -> None:
    header = generate(spec())["softbot_messages.h"]
    assert f"#define SOFTBOT_DBC_HASH 0x{spec().dbc_hash:08X}u" in header
    assert "#define SOFTBOT_EMERGENCY_STOP_ID 0x010u" in header
    assert f"SOFTBOT_SAFE_REASON_CLOCK_ERROR = {SafeReason.CLOCK_ERROR}" in header
    assert "uint16_t pressure0; /* 0 to 8191 times 0.1 kPa - 10 kPa */" in header


def test_another_dbc_gives_another_codec() -> None:
    before, after = "(0.002,0) [-65.536|65.534]", "(0.004,1) [-130.072|132.068]"
    source = generate(read_spec(dbc_text().replace(before, after)))["softbot_physical.c"]
    assert ".scale = 0.004,\n    .offset = 1.0,\n    .minimum = -32768,\n    .maximum = 32767," in source
    assert "0.002" not in source


def test_names_are_snake_case() -> None:
    assert [snake_case(each) for each in ("DbcHash", "UptimeS", "X", "Setpoint0", "ImuGyro")] == [
        "dbc_hash",
        "uptime_s",
        "x",
        "setpoint0",
        "imu_gyro",
    ]


def test_what_c_cannot_carry_is_refused_by_name() -> None:
    message = message_spec("EmergencyStop")
    empty = dataclasses.replace(message, signals=message.signals[:2])
    with pytest.raises(SpecError, match="EmergencyStop: carries nothing"):
        generate(dataclasses.replace(spec(), messages=(empty,)))
    long = dataclasses.replace(message.signals[2], length=54, scale=0.1)
    with pytest.raises(SpecError, match=r"EmergencyStop\.Reason: scaled, and 54 bits"):
        generate(
            dataclasses.replace(spec(), messages=(dataclasses.replace(message, signals=(*message.signals[:2], long)),))
        )


# ---------------------------------------------------------------------- protection


class CReceiver(ctypes.Structure):
    """softbot_e2e_receiver_t."""

    _fields_ = (
        ("message", ctypes.c_void_p),
        ("max_delta", ctypes.c_uint8),
        ("has_last", ctypes.c_bool),
        ("last_counter", ctypes.c_uint8),
        ("lost_frames", ctypes.c_uint32),
    )


class CMessage(ctypes.Structure):
    """softbot_message_t."""

    _fields_ = (
        ("id", ctypes.c_uint16),
        ("length", ctypes.c_uint8),
        ("sender", ctypes.c_uint8),
        ("receivers", ctypes.c_uint8),
        ("cycle_us", ctypes.c_uint32),
        ("gap_us", ctypes.c_uint32),
        ("data_ids", ctypes.c_uint8 * 16),
    )


def c_messages(c_codec: Any) -> Any:
    return (CMessage * len(MESSAGES)).in_dll(c_codec.library, "softbot_messages")


def test_the_list_of_messages_is_that_of_the_dbc(c_codec: Any) -> None:
    nodes = {1: "Board", 2: "Sequencer"}
    for theirs, message in zip(c_messages(c_codec), MESSAGES, strict=True):
        assert (theirs.id, theirs.length) == (message.frame_id, message.length_bytes)
        assert nodes[theirs.sender] == message.sender
        assert {name for bit, name in nodes.items() if theirs.receivers & bit} == message.receivers
        assert theirs.cycle_us == round((message.cycle_s or 0) * 1e6)
        assert theirs.gap_us == round(message.minimum_gap_s * 1e6)
        assert tuple(theirs.data_ids) == message.data_ids


@pytest.mark.parametrize("max_delta", [1, 3, 14])
def test_a_receiver_in_c_judges_every_step_of_the_counter_as_python_does(c_codec: Any, max_delta: int) -> None:
    random = np.random.default_rng(max_delta)
    for number, message in enumerate(MESSAGES):
        ours, theirs = Receiver(message.name, max_delta), CReceiver()
        entry = ctypes.addressof(c_messages(c_codec)[number])
        c_codec.library.softbot_e2e_receiver_init(
            ctypes.byref(theirs), ctypes.c_void_p(entry), ctypes.c_uint8(max_delta)
        )
        data = encode(message.name, {each.name: max(0, each.minimum) for each in payload(message)}).data
        for step in range(300):
            counter = step % 16 if random.random() < 0.5 else int(random.integers(16))
            frame = bytearray(protect(message.name, data, counter))
            if random.random() < 0.1:
                frame[random.integers(len(frame))] ^= 1 << int(random.integers(8))
            status = c_codec.library.softbot_e2e_receive(ctypes.byref(theirs), (ctypes.c_uint8 * 8)(*frame))
            assert list(FrameStatus)[status] is ours.check(bytes(frame))
        assert theirs.lost_frames == ours.lost_frames
        assert sum(count > 0 for count in ours.counts.values()) >= 5


def test_every_flip_of_one_or_two_bits_is_found_in_c_too(c_codec: Any) -> None:
    for message in MESSAGES:
        bits = 8 * message.length_bytes
        data = protect(message.name, bytes(message.length_bytes), 5)
        word = int.from_bytes(data, "little")
        flips = [1 << first | 1 << second for first in range(bits) for second in range(first, bits)]
        frames = np.array([word ^ flip for flip in flips], "<u8").view(np.uint8).reshape(-1, 8)
        assert not c_codec.decode(message, frames)[3].any()
        assert c_codec.decode(message, np.frombuffer(data + bytes(8 - len(data)), np.uint8).reshape(1, 8))[3].all()
