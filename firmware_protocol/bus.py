"""CAN buses by python-can's names, opened with one clear error, and frames over them.

`virtual` joins nodes of one process and keeps the sender's timestamps (simulated time); `hub` joins programs of one
machine (`hub_bus`); `socketcan` is vcan and hardware on Linux; every other interface that python-can knows works by its
name, with its own options.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from firmware_protocol.errors import BusError
from firmware_protocol.frame import Frame
from firmware_protocol.spec import spec

if TYPE_CHECKING:
    import can

    from firmware_protocol.controller_state import ControllerState

HUB = "hub"
_WITHOUT_BITRATE = frozenset({"virtual", "socketcan", "udp_multicast", HUB})
"""Interfaces whose bit rate is set elsewhere (`ip link set … bitrate`) or does not exist."""


def open_bus(
    interface: str,
    channel: str,
    *,
    receive_own_messages: bool = False,
    **options: Any,
) -> can.BusABC:
    """Opens a bus; close it with `shutdown()` or use it in a `with` statement.

    `options` go to python-can's interface as they are; the DBC's bit rate goes along where an interface sets
    one itself. python-can's own configuration files are not read. Raises BusError naming interface, channel
    and the mend.
    """
    import can

    if interface not in can.VALID_INTERFACES | {HUB}:
        known = ", ".join(sorted(can.VALID_INTERFACES | {HUB}))
        raise BusError(f"CAN interface {interface!r} (channel {channel!r}) is unknown; choose one of: {known}")
    if interface == "virtual":
        options.setdefault("preserve_timestamps", True)
    elif interface not in _WITHOUT_BITRATE:
        options.setdefault("bitrate", spec().bitrate_bit_s)
    if interface == "socketcan":
        options.setdefault("ignore_rx_error_frames", False)
    try:
        if interface == HUB:  # known without the package's entry point, too
            from firmware_protocol.hub_bus import HubBus

            return HubBus(channel, receive_own_messages=receive_own_messages, **options)
        return can.Bus(
            channel,
            interface,
            ignore_config=True,
            receive_own_messages=receive_own_messages,
            **options,
        )
    except Exception as error:  # drivers raise what they like; the user gets one kind of error
        raise BusError(
            f"cannot open CAN interface {interface!r}, channel {channel!r}: {error}; {_mend(interface, channel)}"
        ) from error


def send(bus: can.BusABC, frames: Iterable[Frame], t_s: float) -> None:
    """Sends frames stamped with `t_s` (buses with a clock of their own replace the stamp).

    Raises BusError if the bus takes none, for example bus-off or a full queue.
    """
    import can

    for frame in frames:
        try:
            bus.send(to_message(frame, t_s))
        except (can.CanError, OSError) as error:
            raise BusError(
                f"cannot send on {bus.channel_info}: {error}; check that the bus is up and another node acknowledges"
            ) from error


def drain(bus: can.BusABC, controller: ControllerState | None = None) -> Iterator[tuple[Frame, float]]:
    """The classic data frames that have arrived, with their timestamps [s], until none is left; never waits.

    Error, remote, extended and CAN FD frames are no part of the protocol and are left out; `controller`, if given,
    takes over what the error frames say of this node's CAN controller.
    Raises BusError if the bus cannot be read (link down, adapter gone).
    """
    import can

    while True:
        try:
            message = bus.recv(timeout=0)
        except (can.CanError, OSError) as error:
            raise BusError(f"cannot receive on {bus.channel_info}: {error}; check that the bus is up") from error
        if message is None:
            return
        if message.is_error_frame and controller is not None:
            controller.take(message.arbitration_id, bytes(message.data))
        frame = to_frame(message)
        if frame is not None:
            yield frame, message.timestamp


def to_message(frame: Frame, t_s: float) -> can.Message:
    """python-can's message of a frame."""
    import can

    return can.Message(timestamp=t_s, arbitration_id=frame.frame_id, data=frame.data, is_extended_id=False)


def to_frame(message: can.Message) -> Frame | None:
    """The frame of python-can's message; None for what the protocol has not: error, remote, extended, FD."""
    if message.is_error_frame or message.is_remote_frame or message.is_extended_id or message.is_fd:
        return None
    return Frame(message.arbitration_id, bytes(message.data))


@contextlib.contextmanager
def opened(interface: str, channel: str, **options: Any) -> Iterator[can.BusABC]:
    """`open_bus` for a `with` statement: shut down at its end, whatever happens."""
    bus = open_bus(interface, channel, **options)
    try:
        yield bus
    finally:
        bus.shutdown()


def _mend(interface: str, channel: str) -> str:
    if interface == "socketcan":
        return (
            f"bring it up: `sudo ip link add dev {channel} type vcan && sudo ip link set {channel} up` "
            f"for a virtual one, `sudo ip link set {channel} up type can bitrate {spec().bitrate_bit_s}` "
            "for an adapter"
        )
    if interface == HUB:
        return "`softbot hub --help` tells about channels"
    return "check that the adapter is plugged in, its driver installed, and channel and options right"
