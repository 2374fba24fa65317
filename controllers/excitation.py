"""Persistent excitation: small test pulses into the chambers that rest, so that what is wrong with them shows.

A chamber that is vented, or holds its pressure behind a shut valve, tells nothing of its inlet, its wall or its line
until it is needed. So while the robot rolls, each chamber that is asked for less is asked for an idle pressure that
steps up and down by a few kilopascals, the four of them one after the other. A step tells within a few cycles what
waiting for the chamber's turn tells within half a revolution. A chamber that was named and is not used any more gets
its steps for as long as another explanation is still near: what is not excited cannot be told apart.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softbot.cross_section import CHAMBERS
from softbot.kernel_compiler import kernel

FloatArray = NDArray[np.float64]


class Excitation(NamedTuple):
    """Steps of the idle pressure, as compiled code takes them."""

    size_Pa: float
    """Above the co-contraction; 0: none."""
    period_s: float


@kernel(cache=False)
def excite(
    excitation: Excitation, idle_Pa: float, t_s: float, wanted: NDArray[np.int64], setpoint_Pa: FloatArray
) -> None:
    """Raise setpoints (4,) to the idle pressure and its steps at t_s, in place, where it is wanted, (4,)."""
    if excitation.size_Pa <= 0.0:
        return
    for i in range(CHAMBERS):
        turns = t_s / excitation.period_s + i / CHAMBERS
        if wanted[i] > 0 and turns - math.floor(turns) < 0.5:
            setpoint_Pa[i] = max(setpoint_Pa[i], idle_Pa + excitation.size_Pa)
