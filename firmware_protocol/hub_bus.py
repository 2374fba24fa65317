"""A python-can interface to the hub: `can.Bus(interface="hub", channel="bench")`, from any program with python-can.

A node that finds no hub on its channel starts one, which goes when the last client has been gone for some seconds.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import subprocess
import sys
from typing import Any

import can

from firmware_protocol import hub
from firmware_protocol.errors import BusError
from firmware_protocol.hub import EXTENDED, GREETING, OWN, RECORD, REMOTE, RETURN_OWN, Address, address_of

_START_S = 10.0
_LINGER_S = 3.0
_GREETING_S = 2.0
_SEND_BUFFER_BYTES = 65536  # some hundred frames: a bus that is full is to be noticed before seconds have passed


class HubBus(can.BusABC):
    """A client of the hub on `channel`: a name, the path of a socket, or `localhost:PORT`.

    `start_hub`: start a hub if there is none. Classic CAN only. Raises can.CanInitializationError when there is no hub
    to be had, can.CanOperationError when it is gone or the transmit queue is full.
    """

    def __init__(
        self,
        channel: str = "softbot",
        can_filters: can.typechecking.CanFilters | None = None,
        *,
        receive_own_messages: bool = False,
        start_hub: bool = True,
        **options: Any,
    ) -> None:
        self._is_shutdown = True  # until it is whole
        self.channel_info = f"hub {channel}"
        self.channel = channel
        try:
            address = address_of(channel)
            self._stream = _connected(address, channel, start_hub)
        except BusError as error:
            raise can.CanInitializationError(str(error)) from None
        self._received = b""
        try:
            self._greet(receive_own_messages)
        except (OSError, can.CanError) as error:
            self._stream.close()
            raise can.CanInitializationError(f"{address} is no hub of this version: {error}") from None
        self._stream.setblocking(False)
        self._stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        super().__init__(channel, can_filters, **options)
        self._is_shutdown = False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue a frame for the bus; `timeout` [s]: how long to wait for room in the queue (None: not at all)."""
        if msg.is_fd or msg.is_error_frame:
            raise can.CanOperationError(f"{self.channel_info}: carries classic data and remote frames only")
        flags = (EXTENDED if msg.is_extended_id else 0) | (REMOTE if msg.is_remote_frame else 0)
        data = b"" if msg.is_remote_frame else bytes(msg.data)
        record = RECORD.pack(0, msg.arbitration_id, flags, msg.dlc, data)
        try:
            sent = self._stream.send(record)
            while sent < len(record):  # a record begun is finished, or the stream is worth nothing
                select.select((), (self._stream,), (), 1.0)
                sent += self._stream.send(record[sent:])
        except BlockingIOError:
            if timeout and select.select((), (self._stream,), (), timeout)[1]:
                self.send(msg)
                return
            raise can.CanOperationError(f"{self.channel_info}: the transmit queue is full", errno.ENOBUFS) from None
        except OSError as error:
            raise can.CanOperationError(f"{self.channel_info}: the hub is gone ({error.strerror})") from None

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        try:
            while len(self._received) < RECORD.size:
                ready = select.select((self._stream,), (), (), timeout)[0]
                if not ready:
                    return None, False
                came = self._stream.recv(4096)
                if not came:
                    raise can.CanOperationError(f"{self.channel_info}: the hub is gone")
                self._received += came
        except BlockingIOError:
            return None, False
        except (OSError, ValueError) as error:
            raise can.CanOperationError(f"{self.channel_info}: cannot be read ({error})") from None
        stamp_ns, frame_id, flags, length, data = RECORD.unpack(self._received[: RECORD.size])
        self._received = self._received[RECORD.size :]
        remote = bool(flags & REMOTE)
        message = can.Message(
            timestamp=stamp_ns / 1e9,
            arbitration_id=frame_id,
            is_extended_id=bool(flags & EXTENDED),
            is_remote_frame=remote,
            dlc=length,
            data=None if remote else data[:length],
            channel=self.channel,
            is_rx=not flags & OWN,
        )
        return message, False

    def fileno(self) -> int:
        """For select and python-can's notifier. Frames that were read with earlier ones do not show there."""
        return self._stream.fileno()

    def shutdown(self) -> None:
        """Disconnect."""
        if not self._is_shutdown:
            super().shutdown()
            self._stream.close()

    def _greet(self, receive_own_messages: bool) -> None:
        own = RETURN_OWN if receive_own_messages else 0
        self._stream.settimeout(_GREETING_S)
        self._stream.sendall(GREETING[:-1] + bytes([GREETING[-1] & ~RETURN_OWN | own]))
        while len(self._received) < len(GREETING):
            came = self._stream.recv(len(GREETING) - len(self._received))
            if not came:
                raise can.CanInitializationError("it hung up")
            self._received += came
        if self._received != GREETING:
            raise can.CanInitializationError(f"it says {self._received!r}")
        self._received = b""


def _connected(address: Address, channel: str, start_hub: bool) -> socket.socket:
    try:
        return address.connect()
    except OSError as error:
        if not start_hub:
            raise BusError(
                f"no hub answers on {address} ({error.strerror}); start it with `softbot hub --channel {channel}`"
            ) from None
    why = _start(channel)
    try:
        return address.connect()  # to our own hub, or that of another node that was faster
    except OSError:
        raise BusError(f"no hub answers on {address}, and none could be started: {why}") from None


def _start(channel: str) -> str:
    """A hub in the background; returns when it listens, or why it does not."""
    try:
        done = subprocess.run(
            [sys.executable, "-m", hub.__name__, channel, str(_LINGER_S)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            cwd="/",
            env=os.environ | {"PYTHONPATH": os.pathsep.join(os.path.abspath(path) for path in sys.path)},
            timeout=_START_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    return done.stderr.decode(errors="replace").strip()
