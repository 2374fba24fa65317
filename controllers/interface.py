"""What goes into the sequencer and what comes out: orders, outputs, findings. Plain data, no logic."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

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
STRATEGIES = ("curvature_reversal", "safe_stop", "momentum", "rock_free")
"""Answers to a fault, by number: one chamber is dead, and the C is reversed; nothing rolls (any more); more are dead,
and momentum has to carry the robot over what they leave out; it stands, and is rolled back for a run-up."""


class Command(StrEnum):
    """Orders of the operator: where to roll, facing along the robot's tangent."""

    LEFT = "left"
    RIGHT = "right"
    STOP = "stop"


@dataclass(frozen=True)
class Order:
    """What the operator wants from now on. No `speed_rev_s`: as fast as the lead allows; no `distance_m`: for ever."""

    command: Command
    speed_rev_s: float | None = None
    distance_m: float | None = None


@dataclass(frozen=True)
class Detection:
    """A fault that was found and named."""

    t_s: float
    chamber: int
    kind: str
    confidence: float


@dataclass(frozen=True)
class Recovery:
    """A change of strategy that answers a fault."""

    t_s: float
    strategy: str


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
