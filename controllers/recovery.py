"""Recovery planned from the mechanics: rolling on in the same direction with what the chambers can still do.

A chamber i bends the robot towards α_i + π by as much as its strength, 0 … 1. In the body frame the curvatures that
can be had are therefore a rectangle, −s_0 … s_2 along e1 and −s_1 … s_3 along e2, here within the unit circle: 1 is the
curvature that rolling asks for. A C on side S (+1 left, −1 right) under a curvature of size r that leads it by δ gives
the rolling moment ½ r² sin 2δ, forward on both sides (the paper: sin φ0 and sin θ change sign together). So in every
cycle, for the roll that there will be when the pressures have followed, both sides are asked for the most moment that
the rectangle allows with no more than the wanted lead, and the side that gives more is taken.

With one dead chamber that is curvature reversal, two a revolution, and it begins where the wanted lead begins to fall
short on this side: there the other side offers the same lead, by exactly the opposite curvature (along the edge of the
half plane), so the C flips *through straight* and none of the lead is lost. A weak chamber is used where it gives more
than the other side would. Where neither side gives any, as between the two ends of what a pair of chambers can do, the
robot is straightened and coasts: a straight tube rolls freely.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.commutation import TURN_RAD, side_angle_rad, wrapped
from softbot.cross_section import CHAMBERS
from softbot.kernel_compiler import kernel, part

FloatArray = NDArray[np.float64]

_QUARTER_RAD = 0.5 * math.pi
_BEST_LEAD_RAD = 0.25 * math.pi
_LEADS = 8
_NOTHING = 1e-3
_ROLLED_BACK_RAD = 0.15
_FORGOTTEN = 0.8  # of a doubt, with each reversal that went well
_LEVEL_RAD = 0.1  # a curvature so near to upright bends no C to either side


class RecoveryTuning(NamedTuple):
    """How recovery is planned, as compiled code takes it."""

    ahead: float = 0.25
    """How far ahead it plans, over the pressures' lag …"""
    ahead_with_momentum: float = 1.0
    """… where statics leave gaps that momentum has to carry the robot over …"""
    farthest_rad: float = 1.2
    """… and the roll over which it does at most."""
    lead_with_momentum_rad: float = 1.3
    """The least lead then, whatever is ordered: a robot without way on does not get over the gaps."""
    brakes_rad: float = 0.6
    """A roll the wrong way by as much in a lag is braked by keeping the robot bent."""
    gives_up: float = 40.0
    """Lags without a quarter of a turn of progress after which such a robot is stopped."""
    rocks: float = 14.0
    """Lags for which it is rolled back at most, for a run-up."""
    gain: float = 0.1
    """By how much the other side must give more, over the most that the wanted lead can give."""
    carries: float = 16.0
    """Backward curvature that a roll carries the robot past, over what would stop it within a lag …"""
    borne: float = 0.03
    """… and what a reversal may begin with at rest."""
    least_strength: float = 0.45
    """A chamber that can do less is left alone: what it gives is not worth its lag …"""
    fastest_use_rad: float = 2.5
    """… nor, in a roll by more than this in a lag, is that of any weak one."""
    worth: float = 0.9
    """A chamber that can do less is not relied on: the C is reversed as if it were dead, and it adds what it can."""
    flipped: float = 0.0
    """Share of the wanted curvature that must have grown on the other side before the command leaves the line …"""
    flipped_weak: float = -0.12
    """… and with a weak chamber in use: what is left on this side has its square, a hundredth, of the moment, and the
    chambers fill while the C goes through straight instead of after it."""
    least_lead_rad: float = 0.05
    """What is left of the lead for the pressures as they will be, however fast the roll."""
    longest: float = 12.0
    """Lags after which a reversal is given up for the side that the robot then has."""


RECOVERY = np.dtype(
    [
        ("forward", np.int64),
        ("reversing", np.bool_),
        ("began_s", np.float64),
        ("began_rad", np.float64),
        ("doubt", np.float64),
        ("line_rad", np.float64),
        ("direction_rad", np.float64),
        ("share", np.float64),
        ("moment", np.float64),
    ],
    align=True,
)
"""A plan, as a record: the way it was made for; body direction and share of the curvature to command; the moment that
it gives, over EI L κ²; whether the C is being reversed, since when and which roll, and along which body direction.
`doubt`, 0 … 1: that momentum carries this robot over what pushes it back, learnt from reversals that rolled back."""


@kernel(cache=False)
def reach(direction_rad: float, strength: FloatArray) -> float:
    """Curvature that can be had in a body direction, 0 … 1 of what rolling asks for."""
    most = 1.0
    for axis in range(2):
        along = math.cos(direction_rad - axis * _QUARTER_RAD)
        bound = strength[axis + 2] if along > 0.0 else strength[axis]
        if bound < most * abs(along):
            most = bound / abs(along) if abs(along) > 1e-9 else most
    return most


@part()
def _consider(
    plan: Any, side: int, forward: int, lead_rad: float, roll_rad: float, strength: FloatArray, most: float
) -> float:
    direction = side_angle_rad(side) + forward * lead_rad - roll_rad
    share = reach(direction, strength)
    moment = 0.5 * share * share * math.sin(2.0 * lead_rad)
    if moment > most + 1e-9:
        plan.direction_rad, plan.share, plan.moment = wrapped(direction), share, moment
        return moment
    return most


@kernel(cache=False)
def best_on_side(
    plan: Any, side: int, forward: int, largest_rad: float, roll_rad: float, strength: FloatArray
) -> float:
    """The most moment that a side gives at this roll with a lead of 0 … the largest; `plan` gets how."""
    largest = min(largest_rad, _BEST_LEAD_RAD)
    plan.direction_rad, plan.share, plan.moment = wrapped(side_angle_rad(side) - roll_rad), 0.0, 0.0
    most = _NOTHING
    for n in range(_LEADS):
        most = _consider(plan, side, forward, largest * (_LEADS - n) / _LEADS, roll_rad, strength, most)
        if n == 0 and plan.share == 1.0:
            return plan.moment  # all the curvature under all the lead: nothing gives more
    first = forward * (roll_rad - side_angle_rad(side))
    for chamber in range(CHAMBERS):  # edges of the rectangle's corners lie where a chamber bends alone
        lead = first + chamber * _QUARTER_RAD
        lead -= TURN_RAD * math.floor(lead / TURN_RAD)
        if lead < largest:
            most = _consider(plan, side, forward, lead, roll_rad, strength, most)
    if plan.share == 0.0:
        _least_lead(plan, side, forward, first, roll_rad, strength)
        return 0.0
    return plan.moment


@part()
def _least_lead(plan: Any, side: int, forward: int, first_rad: float, roll_rad: float, strength: FloatArray) -> None:
    """Where no lead that is wanted can be had: the least beyond that can."""
    least = _QUARTER_RAD - _LEVEL_RAD
    for chamber in range(CHAMBERS):
        lead = first_rad + chamber * _QUARTER_RAD
        lead -= TURN_RAD * math.floor(lead / TURN_RAD)
        if lead < least and _consider(plan, side, forward, lead, roll_rad, strength, _NOTHING) > _NOTHING:
            least = lead


@part()
def within_reach(first: float, second: float, strength: FloatArray) -> tuple[float, float]:
    """The curvature (body frame) nearest to this one that can be had."""
    return min(max(first, -strength[0]), strength[2]), min(max(second, -strength[1]), strength[3])


@part()
def _through_straight_rad(bent: FloatArray, strength: FloatArray) -> float:
    """Body direction opposite to the curvature as it is, or the nearest that can be had."""
    first, second = within_reach(-bent[0], -bent[1], strength)
    return math.atan2(second, first)


@part()
def _rolls_back(line_rad: float, towards: int, roll_rad: float, bent: FloatArray, share: float) -> float:
    """How much a reversal along this line would roll the robot back, before the C has flipped.

    What lies across the line does not flip with the C, and lingers: where it pushes back it has to be less than what
    momentum carries the robot past (`carries` and `borne` of the tuning).
    """
    x, y = math.cos(line_rad), math.sin(line_rad)
    along = bent[0] * x + bent[1] * y
    upwards = math.sin(roll_rad), math.cos(roll_rad)
    line_up = along * (upwards[0] * x + upwards[1] * y)
    up = upwards[0] * bent[0] + upwards[1] * bent[1]
    return -towards * (up - (1.0 - share) * line_up)


@part()
def use_of(tuning: RecoveryTuning, strength: FloatArray, turned_rad: float, used: FloatArray) -> None:
    """What is used of each chamber's strength, into used (4,). turned_rad: roll in a lag of the pressures, so fast."""
    fast = abs(turned_rad) > tuning.fastest_use_rad
    for i in range(CHAMBERS):
        weak = strength[i] < tuning.worth
        used[i] = 0.0 if weak and (fast or strength[i] < tuning.least_strength) else strength[i]


@part()
def needs_momentum(tuning: RecoveryTuning, strength: FloatArray) -> bool:
    """Whether statics leave gaps in the roll: with more than one chamber that is dead, or as good as dead.

    Two adjacent ones leave a quarter plane of curvatures without its opposite, two opposite ones a line without a
    sweep, three a ray: somewhere in a revolution no curvature that can be had has a forward moment.
    """
    dead = 0
    for i in range(CHAMBERS):
        dead += 1 if strength[i] < tuning.least_strength else 0
    return dead > 1


@part()
def _uses_weak(tuning: RecoveryTuning, strength: FloatArray, held: FloatArray) -> bool:
    """Whether a chamber is used that is not relied on for the side; one beside a held pressure is."""
    uses = False
    for i in range(CHAMBERS):
        beside = held[i] + held[(i + 2) % CHAMBERS] > 0.0
        uses = uses or (0.0 < strength[i] < tuning.worth and not beside)
    return uses


@part()
def most_moment(plan: Any, forward: int, lead_rad: float, roll_rad: float, strength: FloatArray) -> float:
    """The most moment of both sides at this roll, over the most that this lead gives at all."""
    left = best_on_side(plan, 1, forward, lead_rad, roll_rad, strength)
    right = best_on_side(plan, -1, forward, lead_rad, roll_rad, strength)
    return max(left, right) / (0.5 * math.sin(2.0 * min(lead_rad, _BEST_LEAD_RAD)))


@part()
def arch(plan: Any, strength: FloatArray) -> None:
    """Plan the most curvature that can be had, whichever way: it brakes a roll, and from upright falls to one side."""
    strongest = 0
    for i in range(1, CHAMBERS):
        strongest = i if strength[i] > strength[strongest] else strongest
    plan.direction_rad = wrapped(math.pi + strongest * _QUARTER_RAD)
    plan.share = strength[strongest]


@part()
def _rolled_ahead_rad(tuning: RecoveryTuning, momentum: bool, forward: int, turned_rad: float) -> float:
    """The roll to plan for, beyond where the robot is; `turned_rad`: in a lag."""
    if momentum:
        ahead = tuning.ahead_with_momentum * (0.0 if forward * turned_rad > 0.0 else turned_rad)  # no push too early
    else:
        ahead = tuning.ahead * turned_rad
    return min(max(ahead, -tuning.farthest_rad), tuning.farthest_rad)


@kernel(cache=False)
def plan_roll(
    tuning: RecoveryTuning,
    plan: Any,
    other: Any,
    side: int,
    forward: int,
    lead_rad: float,
    roll_rad: float,
    rate_rad_s: float,
    bent: FloatArray,
    strength: FloatArray,
    held: FloatArray,
    t_s: float,
    lag_s: float,
    agility_1_s2: float,
) -> int:
    """Plan this cycle: the side from now on; `plan` says what to command, `other` is scratch.

    forward: +1 to the left, −1 to the right. lead_rad: the largest; what the roll needs of it while the pressures
    follow is no lead any more then. bent (2,): curvature as it is, body frame, over what rolling asks for. strength
    (4,): what is held is reckoned in (`controllers.held_bend`); held (4,): that. lag_s, agility_1_s2: as in
    `controllers.robot_model`.
    """
    if plan.forward != forward:
        plan.forward, plan.reversing = forward, False  # to roll the other way is another plan
    if plan.reversing:
        along = bent[0] * math.cos(plan.line_rad) + bent[1] * math.sin(plan.line_rad)
        flipped = tuning.flipped_weak if _uses_weak(tuning, strength, held) else tuning.flipped
        plan.reversing = along <= flipped and t_s - plan.began_s <= tuning.longest * lag_s
        if not plan.reversing:
            rolled_back = forward * (roll_rad - plan.began_rad) > _ROLLED_BACK_RAD
            plan.doubt = min(2.0 * plan.doubt + 0.1, 1.0) if rolled_back else plan.doubt * _FORGOTTEN
    momentum = needs_momentum(tuning, strength)
    if momentum and forward * rate_rad_s * lag_s > tuning.brakes_rad:
        plan.reversing = False
        arch(plan, strength)
        return side
    later_rad = _rolled_ahead_rad(tuning, momentum, forward, rate_rad_s * lag_s)
    if not plan.reversing:
        worth = np.empty(CHAMBERS)
        for i in range(CHAMBERS):
            beside = held[i] + held[(i + 2) % CHAMBERS] > 0.0  # neither comes late: what they differ by is there
            worth[i] = 1.0 if strength[i] >= tuning.worth else strength[i] if beside else 0.0
        here = best_on_side(plan, side, forward, lead_rad, roll_rad + later_rad, worth)
        there = best_on_side(other, -side, forward, lead_rad, roll_rad + later_rad, worth)
        if there > here + tuning.gain * 0.5 * math.sin(2.0 * min(lead_rad, _BEST_LEAD_RAD)):
            line_rad = _through_straight_rad(bent, strength)
            trust = 1.0 - plan.doubt
            carried = -trust * tuning.carries * forward * rate_rad_s / (agility_1_s2 * lag_s)
            if _rolls_back(line_rad, side * forward, roll_rad, bent, 0.5 * trust) < carried + tuning.borne:
                side = -side
                plan.reversing, plan.began_s, plan.line_rad = True, t_s, line_rad
                plan.began_rad = roll_rad
    if plan.reversing:
        first, second = within_reach(math.cos(plan.line_rad), math.sin(plan.line_rad), strength)
        plan.direction_rad, plan.share = math.atan2(second, first), math.hypot(first, second)
    else:
        most = max(lead_rad - tuning.least_lead_rad, 0.0)
        later_rad = min(max(later_rad, -most), most)
        left_rad = max(lead_rad - abs(later_rad), tuning.least_lead_rad)
        best_on_side(plan, side, forward, left_rad, roll_rad + later_rad, strength)
    return side
