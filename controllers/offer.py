"""What is left when rolling as ordered proves impossible: how far the curvatures that can be had push it each way.

At the roll ρ a curvature of size r in the body direction d pushes to the left with ½ r² sin 2(d + ρ), to the right with
the opposite of that. Whatever the chambers can still do, two things follow:

- Somewhere in a revolution nothing pushes a given way unless the directions that can be had, which count modulo half a
  turn, span more than a quarter turn: a narrower span can be laid where sin 2(d + ρ) has the wrong sign throughout. One
  dead chamber leaves all of them, two adjacent ones a quarter turn, two opposite ones and three a single one.
- sin 2(x + π/2) = −sin 2x, so what pushes to the right at ρ pushes to the left at ρ + π/2: both ways have the same
  gaps, a quarter turn apart. What statics cannot roll one way they cannot roll the other. With momentum, too, the ways
  differ by where the robot lies and by no more: the mirror that swaps left and right takes every set of dead chambers
  into the same set, turned.

So what is offered is counted from where the robot lies, by asking the plan for each direction, roll by roll.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.commutation import TURN_RAD
from controllers.interface import STRATEGIES, Offer, Recovery
from controllers.recovery import best_on_side
from softbot.kernel_compiler import kernel, part

FloatArray = NDArray[np.float64]

NOTHING, OTHER_WAY, BOTH_WAYS = range(3)
"""What the reason of a stop leaves to be offered: nothing may move the robot; the ordered way is barred; neither is."""
WORTH_TURNING_RAD = 0.25
"""The least push the other way that is worth turning for."""
_STEP_RAD = 0.02
_LEAD_RAD = 0.25 * np.pi  # that has the most moment; the plan takes more where there is no less


@part()
def _pushes(plan: Any, towards: int, side: int, roll_rad: float, strength: FloatArray) -> bool:
    best_on_side(plan, side, towards, _LEAD_RAD, roll_rad, strength)
    return bool(plan.share > 0.0)


@kernel(cache=False)
def pushed_rad(plan: Any, towards: int, only_side: int, roll_rad: float, strength: FloatArray) -> float:
    """How far what can be had pushes a robot one way (+1: left) from this roll, 0 … a turn. `plan` is scratch.

    only_side: of a C that cannot be straightened, and stays on its side; 0: either.
    """
    turned_rad = 0.0
    while turned_rad < TURN_RAD:
        at_rad = roll_rad - towards * turned_rad
        left = only_side >= 0 and _pushes(plan, towards, 1, at_rad, strength)
        if not left and not (only_side <= 0 and _pushes(plan, towards, -1, at_rad, strength)):
            return turned_rad
        turned_rad += _STEP_RAD
    return TURN_RAD


@part()
def offer_ways(
    plan: Any, freedom: int, turn: int, only_side: int, roll_rad: float, strength: FloatArray, offered_rad: FloatArray
) -> None:
    """How far it can be pushed to the left and to the right after a stop, into offered_rad (2,). turn: as ordered."""
    for way in range(2):
        towards = 1 - 2 * way
        barred = freedom == NOTHING or (freedom == OTHER_WAY and towards == turn)
        offered_rad[way] = 0.0 if barred else pushed_rad(plan, towards, only_side, roll_rad, strength)


def recovery_of(t_s: float, number: int, left_rad: float, right_rad: float) -> Recovery:
    """An answer of compiled code, with its offer where it is a stop."""
    strategy = STRATEGIES[number]
    return Recovery(t_s, strategy, Offer(left_rad, right_rad) if strategy == "safe_stop" else None)
