"""The fault library as a detector plays it: what each kind changes of a chamber, and how severe it may be.

Not among them are the kinds that the readings alone tell (a sensor that is stuck, noisy or broken), and those of what
the chambers share.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softbot.faults import (
    KIND_CODES,
    LEAK_CONDUCTANCE_RATIO,
    RUPTURE_CONDUCTANCE_RATIO,
    SENSOR_SCALE_LOSS,
    VALVE_SLOWNESS,
    BALLOON_VOLUME_1_Pa,
    FaultKind,
)
from softbot.kernel_compiler import part

FloatArray = NDArray[np.float64]


class Change(IntEnum):
    """What of a chamber, of its valve or of its sensor is another than before."""

    HOLE = 0
    INLET = 1
    OUTLET = 2
    BOTH = 3
    FORCED = 4
    LAG = 5
    WIDENING = 6
    SCALE = 7
    """From here on the gas is as it was; the sensor is not."""
    OFFSET = 8
    DRIFT = 9
    SWAP = 10


_HOLE, _INLET, _OUTLET, _BOTH = int(Change.HOLE), int(Change.INLET), int(Change.OUTLET), int(Change.BOTH)


@part()
def changed_ways(change: int, value: float, inlet: float, outlet: float, hole: float) -> tuple[float, float, float]:
    """Conductances of inlet, outlet and hole, as ratios of the nominal ones, once a change of this value has struck."""
    if change == _HOLE:
        hole += value
    elif change == _INLET:
        inlet *= value
    elif change == _OUTLET:
        outlet *= value
    elif change == _BOTH:
        inlet *= value
        outlet *= value
    return inlet, outlet, hole


class Candidates(NamedTuple):
    """The library as it is played: a row for each kind."""

    kind: NDArray[np.int64]
    change: NDArray[np.int64]
    """Numbers of `Change`."""
    base: FloatArray
    """Of the value that the change takes (hole ratio, what is left of a path, forced opening, factor of the lag,
    widening, scale) at no severity …"""
    slope: FloatArray
    """… and with each unit of it."""
    severity: FloatArray
    """That are tried at first, shape (kinds, 4)."""
    least: FloatArray
    most: FloatArray
    """Bounds of the severity."""
    prior: FloatArray
    """Logarithm; more where nothing is free to be fitted."""


def _candidates() -> Candidates:
    rows = (
        (FaultKind.LEAK, Change.HOLE, 0.0, LEAK_CONDUCTANCE_RATIO, (0.1, 0.2, 0.4, 0.9), 0.05, 1.4, -4.0),
        (FaultKind.RUPTURE, Change.HOLE, 0.0, RUPTURE_CONDUCTANCE_RATIO, (0.22, 0.35, 0.6, 1.0), 0.18, 1.0, -1.0),
        (FaultKind.BLOCKED_INLET, Change.INLET, 1.0, -1.0, (0.45, 0.65, 0.85, 1.0), 0.25, 1.0, -1.0),
        (FaultKind.BLOCKED_EXHAUST, Change.OUTLET, 1.0, -1.0, (0.45, 0.65, 0.85, 1.0), 0.25, 1.0, -1.0),
        (FaultKind.KINKED_LINE, Change.BOTH, 1.0, -1.0, (0.45, 0.65, 0.8, 0.92), 0.25, 0.96, -1.0),
        (FaultKind.STUCK_CLOSED, Change.FORCED, 0.0, 0.0, (1.0, 1.0, 1.0, 1.0), 1.0, 1.0, 1.5),
        (FaultKind.STUCK_OPEN, Change.FORCED, 0.0, 1.0, (0.1, 0.25, 0.5, 1.0), 0.05, 1.0, -1.0),
        (FaultKind.VALVE_SLOW, Change.LAG, 1.0, VALVE_SLOWNESS, (0.12, 0.25, 0.5, 1.0), 0.1, 1.0, -1.0),
        (FaultKind.BALLOONING, Change.WIDENING, 0.0, BALLOON_VOLUME_1_Pa, (0.2, 0.4, 0.65, 1.0), 0.15, 1.0, -2.0),
        (FaultKind.SENSOR_SCALE, Change.SCALE, 1.0, -SENSOR_SCALE_LOSS, (0.2, 0.4, 0.6, 0.9), 0.15, 1.0, -1.0),
        (FaultKind.SENSOR_OFFSET, Change.OFFSET, 0.0, 0.0, (0.0, 0.0, 0.0, 0.0), 0.0, 0.0, -1.0),
        (FaultKind.SENSOR_DRIFT, Change.DRIFT, 0.0, 0.0, (0.0, 0.0, 0.0, 0.0), 0.0, 0.0, -2.0),
        (FaultKind.LINES_SWAPPED, Change.SWAP, 0.0, 0.0, (1.0, 1.0, 1.0, 1.0), 1.0, 1.0, -2.0),
    )
    kind, change, base, slope, severity, least, most, prior = zip(*rows, strict=True)
    return Candidates(
        np.array([KIND_CODES[one] for one in kind], dtype=np.int64),
        np.array(change, dtype=np.int64),
        np.array(base),
        np.array(slope),
        np.array(severity),
        np.array(least),
        np.array(most),
        np.array(prior),
    )


CANDIDATES = _candidates()
COUNT = len(CANDIDATES.kind)
