"""One classic CAN frame as everything above the bus sees it."""

from __future__ import annotations

from typing import NamedTuple


class Frame(NamedTuple):
    """An 11-bit identifier and 0 to 8 data bytes."""

    frame_id: int
    data: bytes
