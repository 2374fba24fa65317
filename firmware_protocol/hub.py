"""A CAN bus in a process of its own, for several programs on one machine whose kernel has no CAN.

Clients (`hub_bus.HubBus`, a python-can interface) connect over a local socket. Frames that wait go out one after the
other, the one that wins arbitration first, to every other client; with pacing each holds the bus for as long as its
worst-case length takes at the DBC's bit rate. A client that does not read loses frames when its queue is full and
holds up nobody; one that sends faster than the bus carries is no longer read from until its queue has room, which it
sees as a full transmit queue.

Left out of a real bus: bit errors, acknowledgement, error counters and bus-off (`bus_faults` brings these about at a
node's end). A record on the socket is 24 bytes, little-endian: time stamp [ns], identifier, flags, length, data.
Nothing but this machine is ever listened to: AF_UNIX in a folder of the user's own, or TCP on the loopback address.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import heapq
import os
import selectors
import socket
import struct
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from firmware_protocol.bus_load import worst_case_frame_bits
from firmware_protocol.errors import BusError

RECORD = struct.Struct("<QIBBxx8s")
"""Time stamp [ns], identifier, flags, length, data."""
EXTENDED, REMOTE, OWN, RETURN_OWN = 1, 2, 4, 8
"""Flags. OWN: this client's own frame comes back. RETURN_OWN: of the first record of a client, asks for them."""
GREETING = b"softbot CAN hub 1 000000"
"""What each side says first; exactly as long as a record, so that a stranger is told at once."""

_RECEIVE_QUEUE = 4096
_TRANSMIT_QUEUE = 64
_READ_AT_ONCE = 16
_LISTEN = 16


@dataclass(frozen=True)
class Address:
    """Where a hub listens: the path of a socket (`path`), or a port of the loopback address."""

    path: Path | None
    port: int = 0

    def __str__(self) -> str:
        return str(self.path) if self.path is not None else f"127.0.0.1:{self.port}"

    def connect(self) -> socket.socket:
        """A connected stream socket. Raises OSError."""
        family = socket.AF_INET if self.path is None else socket.AF_UNIX
        stream = socket.socket(family, socket.SOCK_STREAM)
        try:
            if self.path is None:
                stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                stream.connect(("127.0.0.1", self.port))
            else:
                stream.connect(str(self.path))
        except BaseException:
            stream.close()
            raise
        return stream


def address_of(channel: str) -> Address:
    """Where the hub of a channel listens: a name, the path of a socket, or `localhost:PORT`.

    Raises BusError for a channel that is none of these, or that is not on this machine.
    """
    host, separator, port = channel.rpartition(":")
    if separator:
        if host not in ("localhost", "127.0.0.1"):
            raise BusError(f"hub channel {channel!r}: a hub is on this machine only; give a name or localhost:PORT")
        if not port.isdecimal() or not 0 < int(port) < 65536:
            raise BusError(f"hub channel {channel!r}: {port!r} is no port; give a number from 1 to 65535")
        return Address(None, int(port))
    if "/" in channel:
        return Address(Path(channel).absolute())
    if not channel or not all(letter.isalnum() or letter in "-_." for letter in channel) or channel.startswith("."):
        raise BusError(f"hub channel {channel!r}: give a name of letters, digits, - and _, a path, or localhost:PORT")
    return Address(own_folder() / f"{channel}.sock")


def own_folder() -> Path:
    """The folder of this user's hubs, made for nobody else. Raises BusError where it belongs to somebody else."""
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    base = Path(runtime) if os.path.isabs(runtime) and os.path.isdir(runtime) else Path(tempfile.gettempdir())
    folder = base / f"softbot-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError as error:
        raise BusError(f"the hub's folder {folder} cannot be made: {error.strerror}") from None
    if found.st_uid != os.getuid() or found.st_mode & 0o077 or not folder.is_dir() or folder.is_symlink():
        raise BusError(f"the hub's folder {folder} is not this user's alone; remove it or set XDG_RUNTIME_DIR")
    return folder


@dataclass(frozen=True, order=True)
class _Waiting:
    """A frame that waits for the bus; the smallest wins arbitration."""

    priority: tuple[int, ...]
    number: int
    record: bytes = field(compare=False)
    sender: _Client = field(compare=False)


class _Client:
    """One connection: what it sent and the bus has not carried yet is counted, what it has not read yet is kept."""

    def __init__(self, stream: socket.socket) -> None:
        self.stream = stream
        self.received = b""
        self.greeted = False
        self.wants_own = False
        self.waiting = 0
        self.to_read: deque[bytes] = deque()
        self.half_read = b""
        self.dropped = 0


class Hub:
    """The bus. `serve` runs it until `until` says so; `carried` and `dropped` count frames.

    `bit_rate_bit_s` paces the bus; None: as fast as it goes. Raises BusError when nothing can listen there.
    """

    def __init__(self, address: Address, bit_rate_bit_s: int | None = None) -> None:
        self.address = address
        self.carried, self.dropped = 0, 0
        self._bit_rate = bit_rate_bit_s
        self._waiting: list[_Waiting] = []
        self._number = 0
        self._free_at_s = 0.0
        self._on_the_bus: _Waiting | None = None
        self._selector = selectors.DefaultSelector()
        self._clients: set[_Client] = set()
        self._listener = _listen(address)
        self._selector.register(self._listener, selectors.EVENT_READ)

    @property
    def clients(self) -> int:
        """Clients connected now."""
        return len(self._clients)

    def serve(self, until: Callable[[], bool], every_s: float = 0.1) -> None:
        """Run the bus; `until` is asked at least every `every_s`."""
        while not until():
            self.turn(every_s)

    def turn(self, wait_s: float) -> None:
        """Whatever there is to do now, after waiting for it for at most `wait_s`."""
        if self._on_the_bus is not None:
            wait_s = min(wait_s, max(self._free_at_s - time.monotonic(), 0.0))
        for key, events in self._selector.select(wait_s):
            client = key.data
            if client is None:
                self._welcome()
                continue
            if events & selectors.EVENT_READ:
                self._read(client)
            if events & selectors.EVENT_WRITE and client in self._clients:
                self._write(client)
        self._carry()

    def close(self) -> None:
        """Hang up on everybody."""
        for client in list(self._clients):
            self._drop(client)
        self._selector.close()
        self._listener.close()
        if self.address.path is not None:
            self.address.path.unlink(missing_ok=True)

    def _welcome(self) -> None:
        try:
            stream, _ = self._listener.accept()
        except OSError:
            return  # gone again
        stream.setblocking(False)
        client = _Client(stream)
        client.to_read.append(GREETING)
        self._clients.add(client)
        self._selector.register(stream, selectors.EVENT_READ | selectors.EVENT_WRITE, client)

    def _read(self, client: _Client) -> None:
        try:
            came = client.stream.recv(_READ_AT_ONCE * RECORD.size)
        except BlockingIOError:
            return
        except OSError:
            came = b""
        if not came:
            self._drop(client)
            return
        client.received += came
        while len(client.received) >= RECORD.size:
            record, client.received = client.received[: RECORD.size], client.received[RECORD.size :]
            if not self._take(client, record):
                self._drop(client)
                return
        self._listen_to(client)

    def _take(self, client: _Client, record: bytes) -> bool:
        """Queue a record; False for what no client says."""
        if not client.greeted:
            client.greeted = record[:-1] == GREETING[:-1]
            client.wants_own = bool(record[-1] & RETURN_OWN)
            return client.greeted
        _, frame_id, flags, length, _ = RECORD.unpack(record)
        if length > 8 or flags & ~(EXTENDED | REMOTE) or frame_id >= (1 << 29 if flags & EXTENDED else 1 << 11):
            return False
        self._number += 1
        client.waiting += 1
        heapq.heappush(self._waiting, _Waiting(_priority(frame_id, flags), self._number, record, client))
        return True

    def _carry(self) -> None:
        """Deliver the frames whose time on the bus is over, and start the next."""
        now_s = time.monotonic()
        while True:
            if self._on_the_bus is not None:
                if now_s < self._free_at_s:
                    return
                self._deliver(self._on_the_bus)
                self._on_the_bus = None
            if not self._waiting:
                return
            self._on_the_bus = heapq.heappop(self._waiting)
            if self._bit_rate is not None:
                length = self._on_the_bus.record[13]
                # A bus that was busy goes on where it was, so that a late wake-up costs no time on the bus.
                start_s = self._free_at_s if now_s - self._free_at_s < 1e-3 else now_s
                self._free_at_s = start_s + worst_case_frame_bits(length) / self._bit_rate

    def _deliver(self, frame: _Waiting) -> None:
        self.carried += 1
        sender = frame.sender
        sender.waiting -= 1
        stamp_ns, frame_id, flags, length, data = RECORD.unpack(frame.record)
        stamp_ns = time.time_ns()
        for client in list(self._clients):
            if client is sender and not client.wants_own:
                continue
            if not client.greeted:
                continue
            if len(client.to_read) >= _RECEIVE_QUEUE:
                client.dropped += 1
                self.dropped += 1
                continue
            own = OWN if client is sender else 0
            client.to_read.append(RECORD.pack(stamp_ns, frame_id, flags | own, length, data))
            self._write(client)
        if sender in self._clients:
            self._listen_to(sender)

    def _write(self, client: _Client) -> None:
        while client.half_read or client.to_read:
            if not client.half_read:
                client.half_read = client.to_read.popleft()
            try:
                sent = client.stream.send(client.half_read)
            except BlockingIOError:
                break
            except OSError:
                self._drop(client)
                return
            client.half_read = client.half_read[sent:]
        self._listen_to(client)

    def _listen_to(self, client: _Client) -> None:
        events = 0
        if client.waiting < _TRANSMIT_QUEUE:
            events |= selectors.EVENT_READ
        if client.half_read or client.to_read:
            events |= selectors.EVENT_WRITE
        if events:
            try:
                self._selector.modify(client.stream, events, client)
            except KeyError:
                self._selector.register(client.stream, events, client)
        else:
            with contextlib.suppress(KeyError):
                self._selector.unregister(client.stream)

    def _drop(self, client: _Client) -> None:
        self._clients.discard(client)
        with contextlib.suppress(KeyError):
            self._selector.unregister(client.stream)
        client.stream.close()


def _priority(frame_id: int, flags: int) -> tuple[int, ...]:
    """Arbitration, dominant bits first: base identifier, data before remote, 11 before 29 bits, extension."""
    remote = int(bool(flags & REMOTE))
    if flags & EXTENDED:
        return frame_id >> 18, 1, 1, frame_id & 0x3FFFF, remote
    return frame_id, remote, 0, 0, 0


def _listen(address: Address) -> socket.socket:
    listener = socket.socket(socket.AF_INET if address.path is None else socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.setblocking(False)
        if address.path is None:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(("127.0.0.1", address.port))
        else:
            with _alone(address.path):
                if answers(address):
                    raise OSError(errno.EADDRINUSE, os.strerror(errno.EADDRINUSE))
                address.path.unlink(missing_ok=True)  # of a hub that was killed
                listener.bind(str(address.path))
        listener.listen(_LISTEN)
    except OSError as error:
        listener.close()
        mend = "a hub is there already" if error.errno == errno.EADDRINUSE else "choose another channel"
        raise BusError(f"no hub can listen on {address}: {error.strerror or error}; {mend}") from None
    return listener


@contextlib.contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Only one process at a time takes the place of a hub that was killed."""
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def answers(address: Address) -> bool:
    """Whether something listens there."""
    try:
        address.connect().close()
    except OSError:
        return False
    return True


def run_hub(
    channel: str,
    bit_rate_bit_s: int | None = None,
    linger_s: float | None = None,
    stop: Callable[[], bool] = lambda: False,
    ready: Callable[[], None] = lambda: None,
) -> Hub:
    """A hub on a channel until `stop`, or (`linger_s`) until it has had no client for so long.

    `ready` is called once it listens. Raises BusError when it cannot.
    """
    hub = Hub(address_of(channel), bit_rate_bit_s)
    ready()
    alone_since_s = time.monotonic()

    def over() -> bool:
        nonlocal alone_since_s
        if hub.clients:
            alone_since_s = time.monotonic()
        return stop() or (linger_s is not None and time.monotonic() - alone_since_s > linger_s)

    try:
        hub.serve(over)
    finally:
        hub.close()
    return hub


def main() -> None:
    """`python -m firmware_protocol.hub CHANNEL LINGER_S`: the hub that a node starts when there is none.

    Returns once it listens, and leaves it in the background; exit status 2 and why when it cannot.
    """
    channel, linger_s = sys.argv[1:]
    try:
        run_hub(channel, linger_s=float(linger_s), ready=_into_the_background)
    except BusError as error:
        print(error, file=sys.stderr)
        sys.exit(2)


def _into_the_background() -> None:
    """Outlive the node that needed the hub first."""
    # The one that was started is done, and leaves the socket to the one that goes on.
    sys.exit() if os.fork() else _leave_the_terminal()


def _leave_the_terminal() -> None:
    os.setsid()
    nowhere = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2):
        os.dup2(nowhere, number)
    os.close(nowhere)


if __name__ == "__main__":
    main()
