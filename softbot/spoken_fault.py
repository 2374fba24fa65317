"""Where a fault is, in words."""

from __future__ import annotations

from numbers import Integral


def spoken_where(chamber: object) -> str:
    """`chamber 2`; "the robot" for what is no one chamber's: NO_CHAMBER, or none named."""
    return f"chamber {chamber}" if isinstance(chamber, Integral) and int(chamber) >= 0 else "the robot"
