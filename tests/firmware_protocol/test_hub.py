"""The hub joins programs of one machine like a bus: one frame at a time, by arbitration, and nobody is held up."""

from __future__ import annotations

import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from firmware_protocol import hub_bus
from firmware_protocol.bus import drain, open_bus, opened, send
from firmware_protocol.bus_load import worst_case_frame_bits
from firmware_protocol.errors import BusError
from firmware_protocol.frame import Frame
from firmware_protocol.hub import GREETING, RECORD, Hub, _Client, address_of, own_folder, run_hub
from firmware_protocol.hub_bus import HubBus

BIT_RATE = 500_000


class Running:
    """A hub in a thread of this process."""

    def __init__(self, channel: str, bit_rate_bit_s: int | None = None) -> None:
        self.channel = channel
        self.hub = Hub(address_of(channel), bit_rate_bit_s)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self.hub.serve, args=(self._over.is_set, 0.02))
        self._thread.start()

    def stop(self) -> None:
        self._over.set()
        self._thread.join()
        self.hub.close()


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


@pytest.fixture
def start() -> Iterator[Callable[..., Running]]:
    """Starts hubs, and stops them in the end."""
    running: list[Running] = []

    def go(channel: str = "bench", bit_rate_bit_s: int | None = None) -> Running:
        running.append(Running(channel, bit_rate_bit_s))
        return running[-1]

    yield go
    for one in running:
        one.stop()


def join(channel: str = "bench", **options: bool) -> HubBus:
    return HubBus(channel, start_hub=False, **options)


def received(bus: can.BusABC, count: int, wait_s: float = 5.0) -> list[can.Message]:
    """The next `count` messages, or those that came within `wait_s`."""
    messages = []
    deadline_s = time.monotonic() + wait_s
    while len(messages) < count and (left_s := deadline_s - time.monotonic()) > 0.0:
        message = bus.recv(left_s)
        if message is not None:
            messages.append(message)
    return messages


def data_frame(frame_id: int, data: bytes = b"", **more: bool) -> can.Message:
    return can.Message(arbitration_id=frame_id, data=data, **({"is_extended_id": False} | more))


@pytest.mark.parametrize("channel", ["bench", "localhost"])
def test_every_other_client_gets_a_frame_with_the_hubs_time(start: Callable[..., Running], channel: str) -> None:
    if channel == "localhost":
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            channel = f"localhost:{free.getsockname()[1]}"
    start(channel)
    with join(channel) as one, join(channel) as two, join(channel, receive_own_messages=True) as three:
        before_s = time.time()
        one.send(data_frame(0x110, bytes(range(8))))
        for bus in (two, three):
            (message,) = received(bus, 1)
            assert (message.arbitration_id, bytes(message.data), message.is_rx) == (0x110, bytes(range(8)), True)
            assert before_s <= message.timestamp <= time.time()
        assert one.recv(0.05) is None
        three.send(data_frame(0x7FF))
        (own,) = received(three, 1)
        assert not own.is_rx


def test_all_of_classic_can_is_carried(start: Callable[..., Running]) -> None:
    start()
    frames = [
        data_frame(0x1ABCDEF0, b"\x01", is_extended_id=True),
        data_frame(0x123, is_remote_frame=True),
        data_frame(0x0),
        data_frame(0x7FF, bytes(8)),
    ]
    with join() as one, join() as two:
        for frame in frames:
            one.send(frame)
            (message,) = received(two, 1)
            assert message.equals(frame, timestamp_delta=None, check_channel=False, check_direction=False)
        for refused in (data_frame(1, bytes(12), is_fd=True), can.Message(is_error_frame=True)):
            with pytest.raises(can.CanOperationError, match="classic data and remote frames only"):
                one.send(refused)


def test_of_frames_that_wait_the_smallest_identifier_goes_first(start: Callable[..., Running]) -> None:
    start(bit_rate_bit_s=2000)  # a frame takes tens of milliseconds: the others wait meanwhile
    with join() as one, join() as two, join() as listener:
        one.send(data_frame(0x400, b"first"))
        time.sleep(0.01)
        for frame_id in (0x300, 0x200, 0x301):
            one.send(data_frame(frame_id))
        two.send(data_frame(0x100))
        two.send(data_frame(0x200 << 18, is_extended_id=True))
        two.send(data_frame(0x200, is_remote_frame=True))
        two.send(data_frame(0x100, b"2"))
        came = [(m.arbitration_id, m.is_remote_frame, bytes(m.data)) for m in received(listener, 8)]
    assert came == [
        (0x400, False, b"first"),
        (0x100, False, b""),
        (0x100, False, b"2"),
        (0x200, False, b""),
        (0x200, True, b""),
        (0x200 << 18, False, b""),
        (0x300, False, b""),
        (0x301, False, b""),
    ]


def test_a_paced_bus_carries_no_more_than_its_bit_rate(start: Callable[..., Running]) -> None:
    start(bit_rate_bit_s=BIT_RATE)
    with join() as one, join() as two:
        start_s = time.monotonic()
        for number in range(300):
            one.send(data_frame(0x100, bytes([number % 256] * 8)), timeout=5.0)
        messages = received(two, 300)
        took_s = time.monotonic() - start_s
    assert [message.data[0] for message in messages] == [number % 256 for number in range(300)]
    assert took_s >= 299 * worst_case_frame_bits(8) / BIT_RATE


def test_a_client_that_does_not_read_holds_up_nobody_and_loses_frames(start: Callable[..., Running]) -> None:
    running = start()
    with join() as sender, join() as slow, join() as reader:
        for number in range(12_000):
            sender.send(data_frame(0x100, number.to_bytes(4, "little")), timeout=5.0)
            if number % 10 == 9:
                assert len(received(reader, 10)) == 10
        assert running.hub.dropped > 0
        kept = len(received(slow, 12_000, wait_s=1.0))
        assert kept == 12_000 - running.hub.dropped


def test_a_client_that_sends_more_than_the_bus_carries_is_told(start: Callable[..., Running]) -> None:
    start(bit_rate_bit_s=1000)

    def babble(bus: can.BusABC) -> None:
        for _ in range(2000):
            bus.send(data_frame(0x7FF, bytes(8)))

    with join() as babbling, pytest.raises(can.CanOperationError, match="the transmit queue is full"):
        babble(babbling)


def test_a_client_that_is_gone_is_forgotten(start: Callable[..., Running]) -> None:
    running = start()
    with join() as one, join() as two:
        assert running.hub.clients == 2
        two._stream.close()  # as a killed process does
        for _ in range(50):
            one.send(data_frame(0x100))
            time.sleep(0.001)
        assert running.hub.clients == 1


@pytest.mark.parametrize(
    "said",
    [
        b"GET / HTTP/1.1\r\nHost: x\r\n",
        bytes(24),
        GREETING + RECORD.pack(0, 1, 0, 9, bytes(8)),
        GREETING + RECORD.pack(0, 0x800, 0, 1, bytes(8)),
        GREETING + RECORD.pack(0, 1, 0xFF, 1, bytes(8)),
    ],
)
def test_who_says_what_no_client_says_is_hung_up_on(start: Callable[..., Running], said: bytes) -> None:
    running = start()
    with address_of("bench").connect() as stranger, join() as one:
        stranger.sendall(said)
        stranger.settimeout(5.0)
        heard = b""
        while came := stranger.recv(100):
            heard += came
        assert heard == GREETING
        one.send(data_frame(0x100))
        assert running.hub.clients == 1


@pytest.mark.parametrize(
    ("greeting", "says"),
    [
        (b"220 mail.example.org ready\r\n", r"it says b'220 mail"),
        (b"", "it hung up"),
    ],
)
def test_what_is_no_hub_is_named(greeting: bytes, says: str) -> None:
    address = address_of("bench")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(address))
        listener.listen()

        def talk() -> None:
            stream, _ = listener.accept()
            stream.sendall(greeting)
            stream.recv(100)
            stream.close()

        thread = threading.Thread(target=talk)
        thread.start()
        with pytest.raises(BusError, match=f"is no hub of this version: {says}"):
            open_bus("hub", "bench")
        thread.join()


def test_a_stranger_who_has_not_greeted_hears_no_frames(start: Callable[..., Running]) -> None:
    start()
    with address_of("bench").connect() as stranger, join() as one, join() as two:
        one.send(data_frame(0x100))
        assert len(received(two, 1)) == 1
        stranger.settimeout(5.0)
        assert stranger.recv(100) == GREETING
        stranger.settimeout(0.05)
        with pytest.raises(TimeoutError):
            stranger.recv(100)


def test_a_frame_on_the_bus_outlives_its_sender(start: Callable[..., Running]) -> None:
    running = start(bit_rate_bit_s=1000)  # a frame takes a tenth of a second
    with join() as one, join() as two:
        one.send(data_frame(0x100, bytes(8)))
        one._stream.close()
        (message,) = received(two, 1)
        assert message.arbitration_id == 0x100
        assert running.hub.clients == 1


class Trickle:
    """A stream of which the kernel takes `at_once` bytes at a time, or that has nothing to say after all."""

    def __init__(self, stream: socket.socket, at_once: int) -> None:
        self._stream, self._at_once = stream, at_once

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def send(self, data: bytes) -> int:
        return self._stream.send(data[: self._at_once])

    def recv(self, size: int) -> bytes:
        raise BlockingIOError


def test_a_record_that_the_kernel_takes_in_pieces_is_whole_at_the_other_end(start: Callable[..., Running]) -> None:
    start()
    with join() as one, join() as two:
        one._stream = Trickle(one._stream, at_once=7)  # type: ignore[assignment]
        for number in range(3):
            one.send(data_frame(0x100, bytes([number])))
        assert [message.data[0] for message in received(two, 3)] == [0, 1, 2]


def test_a_stream_that_seemed_to_have_something_to_say_is_asked_again(start: Callable[..., Running]) -> None:
    start()
    with join() as one, join() as two:
        stream = two._stream
        one.send(data_frame(0x100))
        select.select((stream,), (), (), 5.0)
        two._stream = Trickle(stream, at_once=1)  # type: ignore[assignment]
        assert two.recv(0.0) is None
        two._stream = stream
        assert len(received(two, 1)) == 1


class Aborted:
    """A listener whose next client hung up before it was welcomed."""

    def accept(self) -> None:
        raise ConnectionAbortedError


def test_a_peer_that_is_gone_before_it_is_served_harms_nothing() -> None:
    own = Hub(address_of("bench"))
    listener, own._listener = own._listener, Aborted()  # type: ignore[assignment]
    own._welcome()
    own._listener = listener
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    client = _Client(ours)
    own._clients.add(client)
    own._read(client)  # nothing there after all
    assert own.clients == 1
    theirs.close()
    client.to_read.append(GREETING)
    own._write(client)
    assert own.clients == 0
    own.close()


def test_a_client_that_left_without_hearing_what_it_was_told_is_forgotten() -> None:
    """Whoever hangs up with unread bytes resets the stream: its next reading is an error instead of an end."""
    own = Hub(address_of("bench"))
    ours, theirs = socket.socketpair()
    client = _Client(ours)
    own._clients.add(client)
    ours.send(GREETING)
    theirs.close()
    own._read(client)
    assert own.clients == 0
    own.close()


def test_a_bus_that_was_closed_cannot_be_read(start: Callable[..., Running]) -> None:
    start()
    one = join()
    one._stream.close()
    with pytest.raises(can.CanOperationError, match="cannot be read"):
        one.recv(0.0)
    one.shutdown()


def test_a_client_leaves_twice_without_harm(start: Callable[..., Running]) -> None:
    start()
    one = join()
    one.shutdown()
    one.shutdown()


@pytest.mark.parametrize(
    ("channel", "says"),
    [
        ("example.org:5000", "on this machine only"),
        ("0.0.0.0:5000", "on this machine only"),
        ("localhost:", "is no port"),
        ("localhost:70000", "is no port"),
        ("", "give a name"),
        ("..", "give a name"),
        ("a b", "give a name"),
        ("/no/such/folder/x.sock", "none could be started: no hub can listen on /no/such/folder/x.sock: No such file"),
    ],
)
def test_a_channel_that_cannot_be_says_why(channel: str, says: str) -> None:
    with pytest.raises(BusError, match=says):
        open_bus("hub", channel)


def test_a_hub_that_cannot_be_started_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/no/such/python")
    with pytest.raises(BusError, match=r"none could be started: .*No such file"):
        open_bus("hub", "bench")


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / f"softbot-{os.getuid()}").write_text("in the way")
    with pytest.raises(BusError, match="cannot be made: File exists"):
        address_of("bench")


def test_a_folder_that_others_can_write_is_not_used(tmp_path: Path) -> None:
    own_folder().chmod(0o777)
    with pytest.raises(BusError, match="is not this user's alone"):
        address_of("bench")


def test_a_second_hub_on_a_channel_is_refused_and_a_killed_ones_place_is_taken(start: Callable[..., Running]) -> None:
    start()
    with pytest.raises(BusError, match=r"no hub can listen on .*bench\.sock: .*a hub is there already"):
        Hub(address_of("bench"))
    code = "import sys, firmware_protocol.hub as h; h.run_hub('killed', stop=lambda: print('up', flush=True))"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    process.kill()
    process.wait()
    process.stdout.close()
    assert address_of("killed").path is not None
    assert os.path.exists(str(address_of("killed")))
    start("killed")
    with join("killed") as one, join("killed") as two:
        one.send(data_frame(0x100))
        assert len(received(two, 1)) == 1


def test_the_first_node_starts_a_hub_which_goes_with_the_last_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hub_bus, "_LINGER_S", 0.3)
    frames = [Frame(0x110, bytes(8))]
    with opened("hub", "on-demand") as one, opened("hub", "on-demand") as two:
        send(one, frames, 0.0)
        deadline_s = time.monotonic() + 5.0
        came: list[Frame] = []
        while not came and time.monotonic() < deadline_s:
            came = [frame for frame, _ in drain(two)]
        assert came == frames
    deadline_s = time.monotonic() + 10.0
    while os.path.exists(str(address_of("on-demand"))) and time.monotonic() < deadline_s:
        time.sleep(0.05)
    assert not os.path.exists(str(address_of("on-demand")))


def test_a_hub_that_dies_is_a_bus_error_at_every_client() -> None:
    code = "import firmware_protocol.hub as h; h.run_hub('dying', stop=lambda: print('up', flush=True))"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    with opened("hub", "dying") as one, opened("hub", "dying") as two:
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        with pytest.raises(BusError, match="hub dying: the hub is gone"):
            list(drain(one))
        with pytest.raises(BusError, match="hub dying: the hub is gone"):
            send(two, [Frame(0x100, b"")], 0.0)


def test_without_a_hub_and_without_leave_to_start_one_the_mend_is_said() -> None:
    with pytest.raises(BusError, match=r"no hub answers on .*start it with `softbot hub --channel bench`"):
        open_bus("hub", "bench", start_hub=False)


def test_a_hub_can_be_told_to_stop_and_says_what_it_carried() -> None:
    turns = iter([False, False, True])
    assert run_hub("brief", stop=lambda: next(turns)).carried == 0
    assert not os.path.exists(str(address_of("brief")))


def test_an_unread_hub_is_seen_by_select(start: Callable[..., Running]) -> None:
    start()
    with join() as one, join() as two:
        one.send(data_frame(0x100))
        notified: list[can.Message] = []
        notifier = can.Notifier(two, [notified.append], timeout=0.1)
        deadline_s = time.monotonic() + 5.0
        while not notified and time.monotonic() < deadline_s:
            time.sleep(0.01)
        notifier.stop()
        assert [message.arbitration_id for message in notified] == [0x100]
