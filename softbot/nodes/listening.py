"""Hearing a live bus without a word: what has come, when, for as long as is wanted."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import can

from firmware_protocol.bus import drain, to_frame
from firmware_protocol.errors import BusError
from firmware_protocol.frame import Frame

_WAIT_S = 0.05


def arrived(bus: can.BusABC, wait_s: float) -> list[tuple[Frame, float]]:
    """Wait for a frame for at most `wait_s`, then all that have come, with their stamps. Raises BusError."""
    try:
        first = bus.recv(wait_s)
    except (can.CanError, OSError) as error:
        raise BusError(f"cannot receive on {bus.channel_info}: {error}; check that the bus is up") from error
    if first is None:
        return []
    frame = to_frame(first)
    return ([] if frame is None else [(frame, first.timestamp)]) + list(drain(bus))


def bus_frames(
    bus: can.BusABC, stop: threading.Event, duration_s: float | None = None
) -> Iterator[tuple[float, list[Frame]]]:
    """What comes on a bus, with the time of this machine's clock [s], until `stop` is set or `duration_s` is over."""
    started_s = time.monotonic()
    while not stop.is_set() and (duration_s is None or time.monotonic() - started_s < duration_s):
        came = arrived(bus, _WAIT_S)
        if came:
            yield time.monotonic(), [frame for frame, _ in came]
