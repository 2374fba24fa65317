"""A supply that stands low, explained twice: a regulator set lower (sag), or one that passes less (loss).

The manifold's gas balance at absolute pressure P, with the regulator's flow F_r and what the valves draw:

    dP/dt = (RT/V) (c F_r(P_r, P) − g draw),  F_r ≥ 0: a regulator does not relieve

From when the supply was first low a bank of extended Kalman filters follows its readings. In one half c = 1 and the
regulator's pressure P_r is a state beside P; in the other P_r is what it should be and c is; g, the error of the draw
that is reckoned with, is one in both. Each filter begins at a
value of its own and knows it to half the distance to the next, so that together they cover what may be: where the
pressure still falls, nothing is known of a lower P_r. Evidence is the logarithm of the ratio of the halves' mean
likelihoods; the best filter tells how severe it is.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.chamber_gas import Gas
from softbot.kernel_compiler import kernel, part
from softbot.pneumatics import flow_and_slopes

FloatArray = NDArray[np.float64]

LEAST_REGULATED = 0.08
"""P_r over what it should be (gauge) below which a regulator does not sag any more: nothing comes, by either name."""
REGULATED: FloatArray = np.arange(0.1, 0.93, 0.03)
"""P_r over what it should be (gauge), of the filters for a sag."""
CONDUCTANCE: FloatArray = np.array([0.0, 0.01, 0.03, 0.06, 0.12, 0.25, 0.5])
"""c of the filters for a loss."""
_STATES = 3
_SAGS, _FILTERS = len(REGULATED), len(REGULATED) + len(CONDUCTANCE)


def _bank() -> tuple[FloatArray, FloatArray]:
    begins = np.concatenate([REGULATED, CONDUCTANCE])
    known = np.concatenate([np.gradient(REGULATED), np.gradient(CONDUCTANCE)])
    return begins, 0.5 * known


_BEGINS, _KNOWN = _bank()
_DRIFT = (1e-3, 1e-4)
"""Deviation of the change of P_r and of c in a cycle; a pressure that still falls teaches P_r too early."""
_DRAW_KNOWN, _DRAW_ERROR, _LEAST_ERROR_Pa = 0.15, 0.1, 200.0
"""Deviation of g; of the pressure's change in a cycle: share of what was drawn, and what is always there."""
_DRAW_FORGOTTEN = 0.03
"""Share of g's error that is another one a cycle later: each chamber is known otherwise, and they take turns."""
_WILDEST = 6.0
"""What one reading counts at most."""

SUPPLY = np.dtype(
    [
        ("begun", np.bool_),
        ("x", np.float64, (_FILTERS, _STATES)),
        ("covariance", np.float64, (_FILTERS, _STATES, _STATES)),
        ("cost", np.float64, _FILTERS),
        ("slope", np.float64, _STATES),
        ("row", np.float64, _STATES),
    ],
    align=True,
)
"""The bank, as a record: `x` absolute pressure, P_r (over the regulated) or c, and g of each; `cost` the negative
logarithm of the likelihood; scratch."""


@kernel(cache=False)
def begin_supply(own: Any, gas: Gas, reading_Pa: float, noise_Pa: float) -> None:
    """All filters anew, from a reading (gauge)."""
    own.begun = True
    for f in range(_FILTERS):
        own.x[f, 0], own.x[f, 1], own.x[f, 2] = reading_Pa + gas.atmosphere_Pa, _BEGINS[f], 1.0
        for i in range(_STATES):
            for j in range(_STATES):
                own.covariance[f, i, j] = 0.0
        own.covariance[f, 0, 0], own.covariance[f, 1, 1] = noise_Pa * noise_Pa, _KNOWN[f] ** 2
        own.covariance[f, 2, 2] = _DRAW_KNOWN**2
        own.cost[f] = 0.0


@kernel(cache=False)
def observe_supply(own: Any, gas: Gas, reading_Pa: float, noise_Pa: float, drawn_kg_s: float, step_s: float) -> None:
    """One step of all filters. drawn_kg_s: what all valves took over the step, by the openings that acted."""
    per_flow = gas.specific_J_kg * step_s / gas.manifold_m3
    error_Pa = _DRAW_ERROR * per_flow * drawn_kg_s
    noise_Pa2 = noise_Pa * noise_Pa
    for f in range(_FILTERS):
        x, covariance, sags, slope, row = own.x[f], own.covariance[f], f < _SAGS, own.slope, own.row
        source = gas.atmosphere_Pa + gas.regulated_Pa * (x[1] if sags else 1.0)
        share = 1.0 if sags else x[1]
        feed = by_source = by_own = 0.0
        if source > x[0]:
            feed, by_source, by_own = flow_and_slopes(gas.regulator, gas.critical_ratio, source, x[0])
        damped = 1.0 / (1.0 - per_flow * share * min(by_own, 0.0))
        after = x[0] + damped * per_flow * (share * feed - x[2] * drawn_kg_s)
        slope[0], slope[2] = damped, -damped * per_flow * drawn_kg_s
        slope[1] = damped * per_flow * (by_source * gas.regulated_Pa if sags else feed)
        covariance[1, 1] += _DRIFT[0 if sags else 1] ** 2
        x[2] += _DRAW_FORGOTTEN * (1.0 - x[2])
        for j in range(_STATES):
            covariance[2, j] *= 1.0 - _DRAW_FORGOTTEN
            covariance[j, 2] *= 1.0 - _DRAW_FORGOTTEN
        covariance[2, 2] += (1.0 - (1.0 - _DRAW_FORGOTTEN) ** 2) * _DRAW_KNOWN**2
        # only the pressure moves: the first row and column of the covariance
        for j in range(_STATES):
            row[j] = slope[0] * covariance[0, j] + slope[1] * covariance[1, j] + slope[2] * covariance[2, j]
        spread_Pa2 = row[0] * slope[0] + row[1] * slope[1] + row[2] * slope[2]
        spread_Pa2 += (damped * error_Pa) ** 2 + _LEAST_ERROR_Pa**2
        covariance[0, 0] = spread_Pa2
        covariance[0, 1] = covariance[1, 0] = row[1]
        covariance[0, 2] = covariance[2, 0] = row[2]
        spread_Pa2 += noise_Pa2
        off_Pa = reading_Pa + gas.atmosphere_Pa - after
        own.cost[f] += min(0.5 * off_Pa * off_Pa / spread_Pa2, _WILDEST) + 0.5 * math.log(spread_Pa2)
        for i in range(_STATES):
            row[i] = covariance[0, i]
        x[0] = max(after + row[0] / spread_Pa2 * off_Pa, 0.2 * gas.atmosphere_Pa)
        x[1] = min(max(x[1] + row[1] / spread_Pa2 * off_Pa, LEAST_REGULATED if sags else 0.0), 1.0)
        x[2] = min(max(x[2] + row[2] / spread_Pa2 * off_Pa, 0.5), 1.5)
        for i in range(_STATES):
            for j in range(_STATES):
                covariance[i, j] -= row[i] * row[j] / spread_Pa2
            covariance[i, i] = max(covariance[i, i], 1e-10)


@kernel(cache=False)
def weigh_supply(own: Any) -> tuple[float, float, float]:
    """Evidence for a loss against a sag, severity of the likeliest sag, severity of the likeliest loss."""
    best_sag, best_loss = 0, _SAGS
    for f in range(_FILTERS):
        if f < _SAGS and own.cost[f] < own.cost[best_sag]:
            best_sag = f
        elif f >= _SAGS and own.cost[f] < own.cost[best_loss]:
            best_loss = f
    sag = loss = 0.0
    for f in range(_FILTERS):
        if f < _SAGS:
            sag += math.exp(max(own.cost[best_sag] - own.cost[f], -700.0)) / _SAGS
        else:
            loss += math.exp(max(own.cost[best_loss] - own.cost[f], -700.0)) / (_FILTERS - _SAGS)
    evidence = own.cost[best_sag] - own.cost[best_loss] + math.log(loss / sag)
    return evidence, 1.0 - own.x[best_sag, 1], 1.0 - own.x[best_loss, 1]


@part()
def drawn_kg_s(gas: Gas, chamber: int, inlet: float, opening: float, supply: float, pressure: float) -> float:
    """What a chamber at an absolute pressure takes from a supply at another; inlet: conductance over the nominal."""
    if opening <= 0.0:
        return 0.0
    return flow_and_slopes(inlet * opening * gas.supply[chamber], gas.critical_ratio, supply, pressure)[0]
