"""Relief of the manifold through the chambers: what a valve board does about a chamber that fills against its command.

A supply valve that sticks open joins its chamber to the manifold. Shutting the main supply alone leaves the manifold's
gas, which has no other way to go: 100 ml at 250 kPa bring a chamber of 55 ml from 100 to 200 kPa. But the same gas
spread over the four chambers is below 100 kPa. So once a chamber is seen to be fed, the main supply is shut and the
others take gas from the manifold and vent it, in turns, until the chamber is empty.

A chamber is fed that has risen by `FED_Pa` over its lowest reading since its valve was shut, as far as it obeyed,
whether that was in the safe state or before. It is relieved in the safe state, where nothing else is wanted of the
chambers.

While setpoints are obeyed whoever names faults has time for it, and a reading that rises against its command may be
another chamber's, which would be brought over its limit if it were opened to the manifold for long. But where a chamber
rises so fast that its name might come too late, it is relieved beforehand, for the `BEFOREHAND` cycles that naming and
stopping take. If nobody has stopped the robot by then its setpoints are obeyed again, and that sensor is not believed
so soon a second time before the board has been at rest.

A board that has lost its current cannot do this; its valves fall into the safe state, and the manifold's gas stays.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softbot.faults import CHAMBER_COUNT
from softbot.kernel_compiler import kernel, part
from softbot.sensing import LEAST_READING_Pa

FloatArray = NDArray[np.float64]

FED_Pa = 4e3
"""Rise over the lowest reading since the valve was shut as far as it obeyed: eight deviations of a reading."""
SLOWER, SHUT = 1.1, 0.1
"""How much slower than it should a valve may be, and the opening below which it is taken for shut: while it is not,
what its chamber does tells nothing."""
FAST_Pa, AHEAD = 2e3, 7
"""Rise in a cycle, twice in a row, with which a chamber that would be at its limit within so many more is fast."""
BEFOREHAND = 5
"""Cycles for which a fast chamber is relieved before anybody has named what it has: at the second reading it is seen,
at the fourth it is named, and a bus takes a cycle or two."""
RELIEVED = 0.1
"""Share of the chambers' pressure limit below which a chamber need not be relieved (any more)."""
TAKES_TO, SUPPLY_SHARE, VENTS_TO = 0.6, 0.7, 0.5
"""A chamber takes gas up to this share of the limit, or of the manifold's pressure where that is less, and then vents
down to this share of that."""
LONGEST_TAKING, SHORTEST_VENTING = 20, 5
"""Cycles for which a chamber takes gas at most and then vents at least, whatever its sensor shows."""

RELIEF = np.dtype(
    [
        ("left", np.float64),
        ("lowest_Pa", np.float64, CHAMBER_COUNT),
        ("opened", np.float64, CHAMBER_COUNT),
        ("fills", np.int64, CHAMBER_COUNT),
        ("fed", np.int64, CHAMBER_COUNT),
        ("takes", np.int64, CHAMBER_COUNT),
        ("turn", np.int64, CHAMBER_COUNT),
        ("last_Pa", np.float64, CHAMBER_COUNT),
        ("rise_Pa", np.float64, CHAMBER_COUNT),
        ("beforehand", np.int64, CHAMBER_COUNT),
    ],
    align=True,
)
"""What a board remembers for it, as a record: the share of a valve's opening that is left a period after another was
commanded; the lowest reading since each valve was shut; how far it is open if it
obeys, and whether it was open at any time since the last reading (1); which chambers are fed (1), and of the others
which take gas or wait for room (1), and for how many cycles they have taken it, or vented; the last reading, what it
had risen by while its valve was shut, and for how many cycles (0 none yet, −1 no more) a chamber is still relieved
beforehand."""


def relief_memory(valve_lag_s: float, period_s: float) -> Any:
    """Memory of a board that has read nothing, shape (1,) of RELIEF. period_s: of its cycles."""
    memory = np.zeros(1, RELIEF).view(np.recarray)
    memory[0]["left"] = math.exp(-period_s / (SLOWER * valve_lag_s)) if valve_lag_s > 0.0 else 0.0
    memory[0]["lowest_Pa"] = memory[0]["last_Pa"] = np.nan
    return memory


@part()
def _fed_beforehand(own: Any, i: int, shown: float, limit_Pa: float) -> bool:
    """Whether chamber i is taken for fed while setpoints are obeyed."""
    rise_Pa = shown - own.last_Pa[i] if own.fills[i] == 0 else 0.0
    fast = rise_Pa > FAST_Pa and own.rise_Pa[i] > FAST_Pa
    if own.beforehand[i] > 0:
        own.beforehand[i] -= 1
        if own.beforehand[i] == 0:
            own.beforehand[i] = -1
    elif fast and own.beforehand[i] == 0 and shown + AHEAD * 0.5 * (rise_Pa + own.rise_Pa[i]) > limit_Pa:
        own.beforehand[i] = BEFOREHAND
    own.rise_Pa[i] = rise_Pa
    return bool(own.beforehand[i] > 0)


@kernel()
def relieve_manifold(
    memory: Any, measured_Pa: FloatArray, supply_Pa: float, limit_Pa: float, rests: bool, opening: FloatArray
) -> bool:
    """One cycle: whether a chamber is relieved; then `opening` (4,) is changed, and the main supply is to be shut.

    measured_Pa (4,), supply_Pa: gauge readings of this cycle; limit_Pa: of a chamber; rests: the board is in its safe
    state. opening (4,): as commanded otherwise. memory: shape (1,) of RELIEF.
    """
    own = memory[0]
    any_fed = False
    for i in range(CHAMBER_COUNT):
        shown = measured_Pa[i]
        if own.fills[i] > 0 or not shown >= own.lowest_Pa[i]:
            own.lowest_Pa[i] = shown
        if not rests:
            own.fed[i] = 1 if _fed_beforehand(own, i, shown, limit_Pa) else 0
        elif not shown > RELIEVED * limit_Pa:  # where it is NaN too
            own.fed[i] = 0
        elif shown - own.lowest_Pa[i] > FED_Pa:
            own.fed[i] = 1
        own.last_Pa[i] = shown
        if rests:
            own.rise_Pa[i], own.beforehand[i] = 0.0, 0
        any_fed = any_fed or own.fed[i] > 0
    ceiling_Pa = min(TAKES_TO * limit_Pa, SUPPLY_SHARE * supply_Pa)
    for i in range(CHAMBER_COUNT):
        if not any_fed:
            own.takes[i], own.turn[i] = 1, 0
        elif own.fed[i] == 0:
            room = LEAST_READING_Pa <= measured_Pa[i] < ceiling_Pa  # no room where a wire is broken, or it is NaN
            if own.takes[i] > 0 and (own.turn[i] >= LONGEST_TAKING or (own.turn[i] > 0 and not room)):
                own.takes[i], own.turn[i] = 0, 0
            elif own.takes[i] == 0 and own.turn[i] >= SHORTEST_VENTING and measured_Pa[i] < VENTS_TO * ceiling_Pa:
                own.takes[i], own.turn[i] = 1, 0
            if own.takes[i] == 0 or room:
                own.turn[i] += 1
            opening[i] = 1.0 if own.takes[i] > 0 and room else -1.0
        before = own.opened[i]
        own.opened[i] = own.left * before + (1.0 - own.left) * opening[i]
        own.fills[i] = 1 if max(before, own.opened[i]) > SHUT else 0
    return any_fed
