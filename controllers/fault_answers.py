"""What a named fault leaves of a chamber, and whether the robot may roll on with it.

A chamber that follows much later than the others slows the roll more than one that is given up (decision 0030), so a
line that is half closed and a slow valve make a dead chamber.

A row for each kind: the severity from which the chamber is dead (not used any more), the share of what its sensor is
believed that is lost each cycle (it comes to be taken as vented, and is; at once where the sensor shows nothing of the
pressure, while the chamber is vented where it still follows it), the severity from which rolling on is forbidden, how
much of its effect a chamber loses for each unit of severity where it is still used, and the severity from which it
holds its pressure whatever is commanded, so that the others have to work beside it (`controllers.held_bend`). Last,
whether what forbids rolling on leaves the other way open.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from softbot.faults import BALLOON_LOSS, KIND_CODES, KINDS, FaultKind
from softbot.kernel_compiler import kernel

FloatArray = NDArray[np.float64]

DEAD_FROM, BLIND, FORBIDS_FROM, LOSS, HOLDS_FROM, LEAVES_OTHER_WAY = range(6)
_NEVER, _ALWAYS = math.inf, -math.inf
_FADING = 0.03  # a third of a second, in which a chamber is vented
_BARS_ONE_WAY = (FaultKind.OBSTACLE,)

_ROWS: dict[FaultKind, tuple[float, float, float, float, float]] = {
    FaultKind.RUPTURE: (_ALWAYS, 0.0, _NEVER, 0.0, _NEVER),
    FaultKind.LEAK: (_NEVER, 0.0, _NEVER, 0.0, _NEVER),  # the pressure loop feeds it
    FaultKind.BLOCKED_INLET: (0.55, 0.0, _NEVER, 0.0, _NEVER),
    FaultKind.BLOCKED_EXHAUST: (0.9, 0.0, _NEVER, 0.0, 0.9),  # what went in stays in
    FaultKind.KINKED_LINE: (0.55, 0.0, _NEVER, 0.0, 0.55),
    FaultKind.VALVE_SLOW: (0.3, 0.0, _NEVER, 0.0, _NEVER),
    FaultKind.STUCK_OPEN: (_ALWAYS, 0.0, _ALWAYS, 0.0, _NEVER),  # only shutting the supply answers it
    FaultKind.STUCK_CLOSED: (_ALWAYS, 0.0, _NEVER, 0.0, _ALWAYS),
    FaultKind.BALLOONING: (_NEVER, 0.0, _NEVER, BALLOON_LOSS, _NEVER),
    FaultKind.SENSOR_OFFSET: (_ALWAYS, _FADING, _NEVER, 0.0, _NEVER),
    FaultKind.SENSOR_DRIFT: (_ALWAYS, _FADING, _NEVER, 0.0, _NEVER),
    FaultKind.SENSOR_NOISE: (_ALWAYS, 1.0, _NEVER, 0.0, _NEVER),
    FaultKind.SENSOR_STUCK: (_ALWAYS, 1.0, _NEVER, 0.0, _NEVER),
    FaultKind.SENSOR_DROPOUT: (_ALWAYS, 1.0, _NEVER, 0.0, _NEVER),
    FaultKind.SENSOR_SCALE: (_ALWAYS, _FADING, _NEVER, 0.0, _NEVER),
    FaultKind.LINES_SWAPPED: (_ALWAYS, 1.0, _NEVER, 0.0, _NEVER),
    FaultKind.SUPPLY_LOSS: (
        _NEVER,
        0.0,
        0.995,
        0.0,
        _NEVER,
    ),  # a hundredth of the regulator still rolls the robot slowly
    FaultKind.IMU_STUCK: (_NEVER, 0.0, _ALWAYS, 0.0, _NEVER),  # without the roll nobody knows which chamber is due
    FaultKind.IMU_DROPOUT: (_NEVER, 0.0, _ALWAYS, 0.0, _NEVER),
    FaultKind.OBSTACLE: (_NEVER, 0.0, _ALWAYS, 0.0, _NEVER),  # to push on helps nobody; an order may take it elsewhere
}


def answers() -> FloatArray:
    """The table for compiled code: a row for each number of a kind (0: none), columns as the constants say."""
    table = np.tile(np.array([_NEVER, 0.0, _NEVER, 0.0, _NEVER, 0.0]), (len(KINDS) + 1, 1))
    for kind, row in _ROWS.items():
        table[KIND_CODES[kind]] = *row, float(kind in _BARS_ONE_WAY)
    return table


@kernel(cache=False)
def strength_left(table: FloatArray, kind: int, severity: float) -> float:
    """What a chamber can still do, 0 … 1, with this wrong with it (0: nothing is)."""
    if severity >= table[kind, DEAD_FROM]:
        return 0.0
    return max(1.0 - table[kind, LOSS] * severity, 0.0)
