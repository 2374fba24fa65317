"""A supply that stands low, explained twice: a regulator set lower (sag), or one that passes less (loss).

The manifold's gas balance at absolute pressure P, with the regulator's flow F_r and what the valves draw:

    dP/dt = (RT/V) (c F_r(P_r, P) − draw),  F_r ≥ 0: a regulator does not relieve

From when the supply was first low a bank of extended Kalman filters follows its readings. In one half c = 1 and the
regulator's pressure P_r is a state beside P; in the other P_r is what it should be and c is. Each filter begins at a
value of its own and knows it to half the distance to the next, so that together they cover what may be: where the
pressure still falls, nothing is known of a lower P_r. Evidence is the logarithm of the ratio of the halves' mean
likelihoods; the best filter tells how severe it is.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controllers.chamber_gas import Gas
from softbot.pneumatics import flow_and_slopes

FloatArray = NDArray[np.float64]

LEAST_REGULATED = 0.08
"""P_r over what it should be (gauge) below which a regulator does not sag any more: nothing comes, by either name."""
REGULATED: FloatArray = np.arange(0.1, 0.95, 0.07)
"""P_r over what it should be (gauge), of the filters for a sag."""
CONDUCTANCE: FloatArray = np.array([0.0, 0.01, 0.03, 0.06, 0.12, 0.25, 0.5])
"""c of the filters for a loss."""
_SAGS, _FILTERS = len(REGULATED), len(REGULATED) + len(CONDUCTANCE)


def _bank() -> tuple[FloatArray, FloatArray]:
    begins = np.concatenate([REGULATED, CONDUCTANCE])
    known = np.concatenate([np.gradient(REGULATED), np.gradient(CONDUCTANCE)])
    return begins, 0.5 * known


_BEGINS, _KNOWN = _bank()
_DRIFT = 1e-4
"""Deviation of the change of the second state in a cycle."""
_DRAW_ERROR, _LEAST_ERROR_Pa = 0.15, 200.0
"""Of the pressure's change in a cycle: share of what was drawn, and what is always there."""
_WILDEST = 6.0
"""What one reading counts at most."""

SUPPLY = np.dtype(
    [
        ("begun", np.bool_),
        ("x", np.float64, (_FILTERS, 2)),
        ("variance", np.float64, (_FILTERS, 3)),
        ("cost", np.float64, _FILTERS),
    ],
    align=True,
)
"""The bank, as a record: `x` absolute pressure and second state of each, `variance` of the one, of both, of the other,
`cost` the negative logarithm of the likelihood."""


@njit
def begin_supply(own: Any, gas: Gas, reading_Pa: float, noise_Pa: float) -> None:
    """All filters anew, from a reading (gauge)."""
    own.begun = True
    for f in range(_FILTERS):
        own.x[f, 0], own.x[f, 1] = reading_Pa + gas.atmosphere_Pa, _BEGINS[f]
        own.variance[f, 0], own.variance[f, 1], own.variance[f, 2] = noise_Pa * noise_Pa, 0.0, _KNOWN[f] ** 2
        own.cost[f] = 0.0


@njit
def observe_supply(own: Any, gas: Gas, reading_Pa: float, noise_Pa: float, drawn_kg_s: float, step_s: float) -> None:
    """One step of all filters. drawn_kg_s: what all valves took over the step, by the openings that acted."""
    per_flow = gas.specific_J_kg * step_s / gas.manifold_m3
    error_Pa = _DRAW_ERROR * per_flow * drawn_kg_s
    noise_Pa2 = noise_Pa * noise_Pa
    for f in range(_FILTERS):
        x, variance, sags = own.x[f], own.variance[f], f < _SAGS
        source = gas.atmosphere_Pa + gas.regulated_Pa * (x[1] if sags else 1.0)
        share = 1.0 if sags else x[1]
        feed = by_source = by_own = 0.0
        if source > x[0]:
            feed, by_source, by_own = flow_and_slopes(gas.regulator, gas.critical_ratio, source, x[0])
        damped = 1.0 / (1.0 - per_flow * share * min(by_own, 0.0))
        after = x[0] + damped * per_flow * (share * feed - drawn_kg_s)
        by_state = damped * per_flow * (by_source * gas.regulated_Pa if sags else feed)
        pp, ps, ss = variance[0], variance[1], variance[2] + _DRIFT * _DRIFT
        pp, ps = damped * (damped * pp + 2.0 * by_state * ps) + by_state * by_state * ss, damped * ps + by_state * ss
        pp += (damped * error_Pa) ** 2 + _LEAST_ERROR_Pa**2
        spread_Pa2 = pp + noise_Pa2
        off_Pa = reading_Pa + gas.atmosphere_Pa - after
        own.cost[f] += min(0.5 * off_Pa * off_Pa / spread_Pa2, _WILDEST) + 0.5 * math.log(spread_Pa2)
        x[0] = max(after + pp / spread_Pa2 * off_Pa, 0.2 * gas.atmosphere_Pa)
        x[1] = min(max(x[1] + ps / spread_Pa2 * off_Pa, LEAST_REGULATED if sags else 0.0), 1.0)
        variance[0] = pp - pp * pp / spread_Pa2
        variance[1] = ps - pp * ps / spread_Pa2
        variance[2] = max(ss - ps * ps / spread_Pa2, 1e-10)


@njit
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


@njit
def drawn_kg_s(gas: Gas, chamber: int, inlet: float, opening: float, supply: float, pressure: float) -> float:
    """What a chamber at an absolute pressure takes from a supply at another; inlet: conductance over the nominal."""
    if opening <= 0.0:
        return 0.0
    return flow_and_slopes(inlet * opening * gas.supply[chamber], gas.critical_ratio, supply, pressure)[0]
