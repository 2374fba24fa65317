"""What is left after a safe stop, in words."""

from __future__ import annotations

import math
from collections.abc import Mapping

_NOTHING_RAD = math.radians(2.0)
_FOR_EVER_RAD = 2.0 * math.pi - 0.1


def spoken_offer(offer: Mapping[str, float]) -> str:
    """An offer of the summary: which ways what is left pushes the robot, and how far."""
    ways = {way: float(offer[f"{way}_rad"]) for way in ("left", "right")}
    endless = [way for way, far_rad in ways.items() if far_rad >= _FOR_EVER_RAD]
    if endless:
        return f"can still roll {' and '.join(endless)}"
    some = [f"{math.degrees(far_rad):.0f}° {way}" for way, far_rad in ways.items() if far_rad >= _NOTHING_RAD]
    if len(some) == 2:
        return f"can still be rocked, {' and '.join(some)}"
    if some:
        return f"can still be pushed {some[0]}, no further"
    return "nothing that is left pushes it either way from where it lies"
