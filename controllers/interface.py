"""What goes into the sequencer and what comes out: orders, outputs, findings. Plain data, no logic."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class SequencerState(StrEnum):
    """States of the sequencer; the names are those of telemetry and of the bus."""

    DISARMED = "disarmed"
    PRIMING = "priming"
    ROLLING = "rolling"
    STALLED = "stalled"
    REVERSING = "reversing"
    DEGRADED = "degraded"
    SAFE = "safe"


STATES: tuple[SequencerState, ...] = tuple(SequencerState)
"""States by number, for compiled code."""
STRATEGIES = ("curvature_reversal", "safe_stop", "momentum", "rock_free", "other_way")
"""Answers to a fault, by number: one chamber is dead, and the C is reversed; nothing rolls (any more); more are dead,
and momentum has to carry the robot over what they leave out; it stands, and is rolled back for a run-up; it was
stopped, and rolls the other way, as it was told to then."""


class Command(StrEnum):
    """Orders of the operator: where to roll, facing along the robot's tangent."""

    LEFT = "left"
    RIGHT = "right"
    STOP = "stop"


@dataclass(frozen=True)
class Order:
    """What the operator wants from now on. No `speed_rev_s`: as fast as the lead allows; no `distance_m`: for ever.

    turn_back: where that proves impossible, roll the other way, once, if what is left pushes it there.
    """

    command: Command
    speed_rev_s: float | None = None
    distance_m: float | None = None
    turn_back: bool = False


@dataclass(frozen=True)
class Detection:
    """A fault that was found and named."""

    t_s: float
    chamber: int
    kind: str
    confidence: float


@dataclass(frozen=True)
class Offer:
    """What is left after a safe stop: how far the curvatures that can be had push the robot each way from there.

    A whole turn: for ever.
    """

    left_rad: float
    right_rad: float


@dataclass(frozen=True)
class Recovery:
    """A change of strategy that answers a fault; a safe stop comes with what is left."""

    t_s: float
    strategy: str
    offer: Offer | None = None

    def entry(self) -> dict[str, Any]:
        """As the summary lists it."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@dataclass(frozen=True)
class SequencerOutput:
    """One control cycle's answer."""

    setpoint_Pa: FloatArray
    """Chamber pressures wanted, shape (4,) [Pa gauge]."""
    state: SequencerState
    wants_armed: bool
    """Whether the valve board should be armed; False asks for the safe state (vented)."""
    detections: tuple[Detection, ...] = ()
    """Faults found in this cycle."""
    recoveries: tuple[Recovery, ...] = ()
    """Changes of strategy in this cycle."""
