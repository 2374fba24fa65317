"""What a fault does to a robot whose sequencer does not answer it: does it matter?

A single fault matters that costs more than a tenth of the speed, or that takes a chamber over its pressure limit. Both
are found from runs and not from a table of opinions: the same run (robot, floor, order, noise) is made once without the
fault and once with it, both times under a sequencer that names nothing and answers nothing. Until the fault strikes the
two are the same to the last bit, so what is lost from then on is the fault's doing, and never that of an answer to it:
a robot that detection stops has lost nothing here.

The valve board is the robot's and not the sequencer's: where its own over-pressure rule vents the chambers, that speed
is lost to the fault.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.recorder import samples_of
from sim.scene import Scene
from sim.summary import highest_pressure_share
from softbot.campaign.outcome import ordered_turns, pressures_Pa
from softbot.errors import SimulationError
from softbot.nodes.direct import DirectRun
from softbot.robot import Robot

FloatArray = NDArray[np.float64]

LOST_SHARE = 0.1
"""Share of the speed from which on a fault matters."""
_LEAST_RATE_rev_s = 0.02  # of a robot that rolls


def consequence(scene: Scene, known: Robot | None = None) -> dict[str, Any]:
    """The columns that say whether the one fault of a scene matters; none for a scene of no fault or of several.

    `rate_without_fault_rev_s`, `rate_unanswered_rev_s`: mean speeds in the ordered direction from the fault on, without
    it and with it; `pressure_without_fault_share`, `pressure_unanswered_share`: the highest pressure of a chamber in
    that time over its limit; `matters`: null where one of the two runs failed. known: as for `direct_row`.
    """
    if len(scene.fault) != 1:
        return {}
    silent = scene.model_copy(update={"sequencer": scene.sequencer.model_copy(update={"detection": False})})
    since_s = scene.fault[0].t_s
    try:
        without = _trace(silent.model_copy(update={"fault": ()}), known)
        unanswered = _trace(silent, known)
    except SimulationError:
        return {"matters": None}
    limit_Pa = (known or scene.robot).pneumatics.max_chamber_pressure_Pa
    return compared(scene, without, unanswered, since_s, limit_Pa)


def compared(
    scene: Scene, without: FloatArray, unanswered: FloatArray, since_s: float, limit_Pa: float
) -> dict[str, Any]:
    """The same columns from the traces of the two runs (`softbot.nodes.direct.TRACE`)."""
    rates = [_rate_rev_s(scene, trace, since_s) for trace in (without, unanswered)]
    shares = [_highest_share(trace, since_s, limit_Pa) for trace in (without, unanswered)]
    row = {
        "rate_without_fault_rev_s": rates[0],
        "rate_unanswered_rev_s": rates[1],
        "pressure_without_fault_share": shares[0],
        "pressure_unanswered_share": shares[1],
    }
    if any(value is None for value in (*rates, *shares)):  # it strikes after the end
        return row | {"matters": None}
    slowed = rates[0] > _LEAST_RATE_rev_s and rates[1] < (1.0 - LOST_SHARE) * rates[0]
    endangered = shares[0] <= 1.0 < shares[1]
    return row | {"matters": bool(slowed or endangered)}


def _trace(scene: Scene, known: Robot | None) -> FloatArray:
    return DirectRun(scene, known).advance(samples_of(scene)).trace


def _rate_rev_s(scene: Scene, trace: FloatArray, since_s: float) -> Any:
    within = trace[:, 0] >= since_s
    if within.sum() < 2:
        return None
    t_s, turns = trace[within, 0], ordered_turns(scene, trace)[within]
    rate = float((turns[-1] - turns[0]) / (t_s[-1] - t_s[0]))
    return rate if math.isfinite(rate) else None


def _highest_share(trace: FloatArray, since_s: float, limit_Pa: float) -> Any:
    return highest_pressure_share(pressures_Pa(trace)[trace[:, 0] >= since_s], limit_Pa)
