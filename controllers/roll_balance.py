"""Balance of the moments that roll the robot: what the curvature pushes, and what friction, inertia and wall take.

A C that lies flat under an intrinsic curvature (k_x level, k_y upright; over the one that rolling asks for) is rolled
by the moment −k_x k_y, over EI L κ² (`controllers.recovery`: ½ r² sin 2δ). It is balanced by

    −k_x k_y = c sgn ω + d ω k_x² + ω̇/A + Σ_i g_i p_i (u_ix k_y + u_iy k_x)

dry friction c, the wall's damping d, the inertia 1/A; and, as the curvature is estimated from the pressures p_i with
gains that are not known to a few percent, the error g_i of the chamber that bends towards u_i. A Kalman filter learns
the seven from means over a few readings. Two sequential tests (Page's CUSUM) watch what it leaves:

- a robot that stands under a moment that would have rolled it is *held*;
- the innovations' squares, over what they are when this robot is healthy, tell that something *changed*. Then the gains
  are learnt anew, over a turn: a wall that has become soft beside one chamber shows as that chamber's gain, which has
  risen against the others'. What all four have in common the balance does not show.

Left out: slopes, and what chambers do to each other's gain.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from softbot.cross_section import CHAMBERS
from softbot.kernel_compiler import kernel, part

DRY, VISCOUS, INERTIA, GAIN = range(4)
"""Places of the states; the chambers' gains from GAIN on. INERTIA is 100 / A."""
STATES = 3 + CHAMBERS
NOTHING, HELD, SOFTENED = range(3)
"""What the balance tells."""

READINGS_A_MEAN = 5
_QUARTER_RAD, _TURN_RAD = 0.5 * math.pi, 2.0 * math.pi
_SLOW_RAD_S = 0.3  # below it dry friction has no side, and the robot stands
_FIRST = np.array([0.05, 0.01, 0.2, 0.0, 0.0, 0.0, 0.0])
_KNOWN = np.array([0.05, 0.01, 0.2, 0.15, 0.15, 0.15, 0.15])
_CHANGES = 0.02  # of what was known at first, in a mean
_NOISE = 0.02  # of a moment: what the balance leaves out
_SIZE_MEANS = 200.0  # over which the innovations' size is known
_ALLOWANCE, _MOST, _LEARNS_BELOW, _CHANGED_AT = 2.5, 9.0, 6.0, 40.0  # of the squares
_HELD_BEYOND, _HELD_SCALE, _HELD_ALLOWANCE, _HELD_AT = 0.15, 0.1, 1.0, 12.0  # of the moment under which it stands
_TRUSTED_FROM = 100  # means, until what was learnt is this robot's nature
_TRUSTED_SHARE = 0.01
_SETTLE_RAD = 1.25 * _TURN_RAD  # rolled since the alarm, until the new gains are known
_SOFT, _SOFT_ROUGH, _SOFT_MOST = 0.1, 0.25, 0.4  # rise of a gain that makes a wall soft: on a robot whose balance is …
_ALONE = 0.5  # … exact, more for each deviation that its innovations have, at most; and what the next may have of it

BALANCE = np.dtype(
    [
        ("x", np.float64, STATES),
        ("covariance", np.float64, (STATES, STATES)),
        ("row", np.float64, STATES),
        ("mean", np.float64, STATES),
        ("moment", np.float64),
        ("readings", np.int64),
        ("first_rad_s", np.float64),
        ("turned_rad", np.float64),
        ("seen", np.int64),
        ("innovation", np.float64),
        ("size", np.float64),
        ("held", np.float64),
        ("changed", np.float64),
        ("alarm", np.bool_),
        ("rolled_rad", np.float64),
        ("trusted", np.float64, CHAMBERS),
        ("soft", np.float64, CHAMBERS),
        ("soft_chamber", np.int64),
    ],
    align=True,
)
"""What is believed and remembered, as a record: states, covariance and scratch; sums of the mean that is being made
(`moment`, `turned_rad` in it), and the rate at its beginning; means so far; the innovation over its deviation, and its
mean square while healthy; the CUSUMs; whether the gains are being learnt anew, and the roll since then; gains over
their mean, as trusted; by how much those of chambers with a soft wall have risen, and which was found last (−1:
none)."""


def balance_memory() -> Any:
    """Memory of a balance that has seen nothing, shape (1,) of BALANCE."""
    memory = np.zeros(1, BALANCE).view(np.recarray)
    own = memory[0]
    own["x"], own["covariance"], own["size"], own["soft_chamber"] = _FIRST, np.diag(_KNOWN**2), 1.0, -1
    return memory


@kernel(cache=False)
def pause_balance(own: Any) -> None:
    """Nothing is to be learnt or judged now: what is under way is dropped, what was learnt stays."""
    own.readings = 0
    own.held = own.changed = 0.0
    own.alarm = False


@kernel(cache=False)
def observe_balance(own: Any, estimate: Any, curvature_1_m: float, limit_Pa: float, step_s: float) -> int:
    """One reading: NOTHING, HELD or SOFTENED (`soft_chamber`; each once). estimate: record of `controllers.estimation`;
    curvature_1_m: that rolling asks for; limit_Pa: of a chamber's pressure."""
    if own.readings == 0:
        own.first_rad_s, own.moment, own.turned_rad = estimate.spin_rad_s, 0.0, 0.0
        for i in range(STATES):
            own.mean[i] = 0.0
    c, s = math.cos(estimate.roll_rad), math.sin(estimate.roll_rad)
    k_1, k_2 = estimate.curvature_1_m[0] / curvature_1_m, estimate.curvature_1_m[1] / curvature_1_m
    level, upright = k_1 * c - k_2 * s, k_1 * s + k_2 * c
    spin = estimate.spin_rad_s
    own.moment -= level * upright / READINGS_A_MEAN
    own.mean[DRY] += min(max(spin / _SLOW_RAD_S, -1.0), 1.0) / READINGS_A_MEAN
    own.mean[VISCOUS] += spin * level * level / READINGS_A_MEAN
    for i in range(CHAMBERS):
        angle = i * _QUARTER_RAD + estimate.roll_rad + math.pi
        push = math.cos(angle) * upright + math.sin(angle) * level
        own.mean[GAIN + i] += estimate.felt_Pa[i] / limit_Pa * push / READINGS_A_MEAN
    own.turned_rad += spin * step_s
    own.readings += 1
    if own.readings < READINGS_A_MEAN:
        return NOTHING
    common = own.mean[GAIN : GAIN + CHAMBERS].mean()
    for i in range(CHAMBERS):
        own.mean[GAIN + i] -= common  # all gains together are the moment itself: they would explain whatever comes
    own.mean[INERTIA] = (spin - own.first_rad_s) / (100.0 * step_s * (READINGS_A_MEAN - 1))
    own.readings = 0
    return _weigh(own, own.turned_rad / (step_s * READINGS_A_MEAN))


@part()
def _weigh(own: Any, spin_rad_s: float) -> int:
    off, mean, row = own.moment, own.mean, own.row
    for i in range(STATES):
        off -= mean[i] * own.x[i]
    if abs(spin_rad_s) < _SLOW_RAD_S:  # what is learnt while it is being stopped is not its nature: the moment itself
        beyond = (abs(own.moment) - _HELD_BEYOND) / _HELD_SCALE
        own.held = max(0.0, own.held + beyond - _HELD_ALLOWANCE)
        return _hold(own) if own.held >= _HELD_AT else NOTHING
    own.held = max(0.0, own.held - _HELD_ALLOWANCE)
    own.seen += 1
    spread = _NOISE * _NOISE
    for i in range(STATES):
        own.covariance[i, i] += (_CHANGES * _KNOWN[i]) ** 2
        row[i] = 0.0
    for i in range(STATES):
        for j in range(STATES):
            row[i] += own.covariance[i, j] * mean[j]
        spread += row[i] * mean[i]
    own.innovation = off / math.sqrt(spread)
    for i in range(STATES):
        own.x[i] += row[i] / spread * off
        for j in range(STATES):
            own.covariance[i, j] -= row[i] * row[j] / spread
    return _judge(own)


@part()
def _hold(own: Any) -> int:
    """It is held; the balance is learnt anew when it rolls again."""
    pause_balance(own)
    own.seen = 0
    for i in range(STATES):
        own.x[i] = _FIRST[i]
        for j in range(STATES):
            own.covariance[i, j] = _KNOWN[i] ** 2 if i == j else 0.0
    return HELD


@part()
def _judge(own: Any) -> int:
    square = own.innovation * own.innovation
    if own.alarm:
        own.rolled_rad += abs(own.turned_rad)
        return _explain(own) if own.rolled_rad > _SETTLE_RAD else NOTHING
    if own.seen > _TRUSTED_FROM // 2:
        own.changed = max(0.0, own.changed + min(square / max(own.size, 0.05), _MOST) - _ALLOWANCE)
    if own.changed < _LEARNS_BELOW:
        own.size += (square - own.size) / min(own.seen, _SIZE_MEANS)
        common = own.x[GAIN : GAIN + CHAMBERS].mean()
        share = max(_TRUSTED_SHARE, 1.0 / own.seen)
        for i in range(CHAMBERS):
            own.trusted[i] += share * (own.x[GAIN + i] - common - own.trusted[i])
    elif own.changed >= _CHANGED_AT:
        own.alarm, own.rolled_rad = True, 0.0
        for i in range(CHAMBERS):
            own.covariance[GAIN + i, GAIN + i] += _KNOWN[GAIN + i] ** 2
    return NOTHING


@part()
def _explain(own: Any) -> int:
    """The gains, learnt anew: which of them has risen over the others."""
    common = own.x[GAIN : GAIN + CHAMBERS].mean()
    most, next_most, chamber = -1.0, -1.0, -1
    for i in range(CHAMBERS):
        rise = own.x[GAIN + i] - common - own.trusted[i]
        if rise > most:
            most, next_most, chamber = rise, most, i
        elif rise > next_most:
            next_most = rise
    own.alarm, own.changed = False, 0.0
    for i in range(CHAMBERS):
        own.trusted[i] = own.x[GAIN + i] - common
    soft = min(_SOFT + _SOFT_ROUGH * math.sqrt(own.size), _SOFT_MOST)
    if not (most > soft and next_most < _ALONE * most):
        return NOTHING
    known = own.soft[chamber] > 0.0
    own.soft[chamber] += most
    own.soft_chamber = chamber
    return NOTHING if known else SOFTENED
