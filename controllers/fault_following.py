"""A named chamber is followed: each explanation that came near goes on as a filter of its own, until one is left.

What tells two kinds apart often happens later: a kinked line from a blocked exhaust when the chamber is filled again, a
wrong scale from a chamber that balloons when it is vented. State (P, s) of each filter: absolute pressure, and what the
explanation leaves open, which is the severity (of an offset and of a drift: what the sensor adds now, over
SENSOR_OFFSET_Pa). The cost of its readings is the negative logarithm of their likelihood, beginning with what the first
look at the chamber had made of the explanation, of which no more than `_FIRST_LOOK` is believed.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.chamber_gas import Gas, lagged_opening, next_pressure
from controllers.chamber_observer import HOLE, INLET, MODEL_ERROR, OFFSET, OUTLET, STATES, between
from controllers.fault_candidates import COUNT, Candidates, Change, changed_ways
from controllers.fault_naming import EVIDENCE, USUAL_DRIFT
from controllers.fault_simulation import ballooned, swelled_by, unfelt_Pa
from controllers.fault_window import KEPT
from softbot.faults import SENSOR_SCALE_LOSS, SENSOR_DRIFT_Pa_s, SENSOR_OFFSET_Pa
from softbot.kernel_compiler import kernel, part

FloatArray = NDArray[np.float64]

_HOLE, _INLET, _OUTLET, _BOTH = int(Change.HOLE), int(Change.INLET), int(Change.OUTLET), int(Change.BOTH)
_FORCED, _LAG, _WIDENING = int(Change.FORCED), int(Change.LAG), int(Change.WIDENING)
_SCALE, _OFFSET, _DRIFT, _SWAP = int(Change.SCALE), int(Change.OFFSET), int(Change.DRIFT), int(Change.SWAP)

_NEAR, _FIRST_LOOK = 60.0, 10.0
"""Evidence behind the best within which an explanation is followed, and most of it that is believed later on."""
_WILDEST = 4.0
"""What one reading counts at most."""
_EMPTY_Pa = 2e3
"""Gauge pressure below which a chamber that is vented says nothing any more."""
_GIVEN_UP = 60.0
"""Cost above the best with which an explanation is given up."""
_LEAST_ERROR_Pa = 150.0
"""Of the pressure's change in a cycle, always there."""
_SWELLING_ERROR = 0.2
"""Share of what swelling did to the pressure that a model of the shape does not know."""
_SEVERITY_KNOWN, _SEVERITY_DRIFT = 0.08, 3e-4
"""Deviation of a fitted severity, and of its change in a cycle."""
_OFFSET_KNOWN_Pa, _DRIFTED_KNOWN_Pa = 1e3, 2.5e3
"""… of an offset and of what a drift has come to …"""
_OFFSET_KEEPS_Pa, _DRIFTS_Pa = 3.0, 12.0
"""… and of the change of the one and of the other (beside its usual rate) in a cycle."""
_ABOUT_AS_WELL = 1.4
"""Ratio of the variances of two predictions that are taken for the same."""
_STEP_OF_SEVERITY = 0.02
"""For what has no slope in closed form."""

FOLLOWER = np.dtype(
    [
        ("follows", np.int64, COUNT),
        ("busy", np.bool_),
        ("x", np.float64, (COUNT, 2)),
        ("covariance", np.float64, (COUNT, 3)),
        ("lagged", np.float64, COUNT),
        ("cost", np.float64, COUNT),
        ("off_Pa", np.float64, COUNT),
        ("spread_Pa2", np.float64, COUNT),
        ("sound", np.float64, STATES),
        ("growth_m3_Pa", np.float64),
        ("volume_m3", np.float64, COUNT),
    ],
    align=True,
)
"""The filters of a chamber, as a record: whether there are any and which; `covariance` PP, Ps, ss; `sound`: offset and
conductances of the chamber before anything was wrong with it; `growth_m3_Pa`: by how much it grows with each pascal on
its wall; `volume_m3`: as large as each explanation makes it, 0 before its first step."""


@kernel(cache=False)
def begin_following(
    own: Any,
    candidates: Candidates,
    verdict: Any,
    sound: FloatArray,
    atmosphere_Pa: float,
    reading_Pa: float,
    lagged: float,
    noise_Pa: float,
) -> None:
    """Go on with every explanation of a chamber that its last verdict found near the best."""
    own.busy = False
    top = -math.inf
    for m in range(COUNT):
        top = max(top, verdict.best[candidates.kind[m]])
    for i in range(STATES):
        own.sound[i] = sound[i]
    own.growth_m3_Pa = verdict.growth_m3_Pa
    for m in range(COUNT):
        behind, change = top - verdict.best[candidates.kind[m]], candidates.change[m]
        own.follows[m] = 1 if behind < _NEAR and change != _SWAP and verdict.onset[m] > 0 else 0
        if own.follows[m] == 0:
            continue
        own.busy = True
        own.cost[m] = min(behind, _FIRST_LOOK) / EVIDENCE
        own.lagged[m], own.x[m, 1] = lagged, 0.0 if change == _DRIFT else verdict.fitted[m]
    resume_following(own, candidates, atmosphere_Pa, reading_Pa, noise_Pa)


@part()
def resume_following(
    own: Any, candidates: Candidates, atmosphere_Pa: float, reading_Pa: float, noise_Pa: float
) -> None:
    """Take a reading for the pressure, at first and after an interval of which nothing is known."""
    for m in range(COUNT):
        if own.follows[m] == 0:
            continue
        change, severity, known, both = candidates.change[m], own.x[m, 1], _SEVERITY_KNOWN, 0.0
        gauge_Pa, variance_Pa2 = reading_Pa - own.sound[OFFSET], noise_Pa * noise_Pa + _LEAST_ERROR_Pa**2
        if change == _SCALE:
            scale = 1.0 - SENSOR_SCALE_LOSS * severity
            gauge_Pa /= scale
            variance_Pa2 /= scale * scale
        elif change in (_OFFSET, _DRIFT):
            known = (_OFFSET_KNOWN_Pa if change == _OFFSET else _DRIFTED_KNOWN_Pa) / SENSOR_OFFSET_Pa
            gauge_Pa -= SENSOR_OFFSET_Pa * severity
            variance_Pa2 += (known * SENSOR_OFFSET_Pa) ** 2
            both = -known * known * SENSOR_OFFSET_Pa
        own.x[m, 0] = max(gauge_Pa + atmosphere_Pa, 0.2 * atmosphere_Pa)
        own.covariance[m, 0], own.covariance[m, 1], own.covariance[m, 2] = variance_Pa2, both, known * known
        own.volume_m3[m] = 0.0


@kernel(cache=False)
def follow(own: Any, gas: Gas, candidates: Candidates, window: Any, chamber: int, now: int, noise_Pa: float) -> None:
    """One step of a chamber's filters, by what the window kept of cycle `now`."""
    k = now % KEPT
    supply, step_s = window.supply[k], window.step_s[k]
    shown_Pa = window.reading_Pa[k, chamber] - own.sound[OFFSET]
    tells = window.opening[k, chamber] > 0.0 or abs(shown_Pa) > _EMPTY_Pa  # an empty chamber explains nothing
    for m in range(COUNT):
        if own.follows[m] == 0:
            continue
        change, severity, pressure = candidates.change[m], own.x[m, 1], own.x[m, 0]
        value = candidates.base[m] + candidates.slope[m] * severity
        inlet, outlet, hole = own.sound[INLET], own.sound[OUTLET], max(own.sound[HOLE], 0.0)
        opening = window.opening[k, chamber]
        more, believed_m3, felt = (
            value + candidates.slope[m] * _STEP_OF_SEVERITY,
            window.volume_m3[k, chamber],
            window.felt[k, chamber],
        )
        other_opening, room, other_room, share = opening, 1.0, 1.0, 1.0
        inlet, outlet, hole = changed_ways(change, value, inlet, outlet, hole)
        if change == _FORCED:
            opening = value
        elif change == _LAG:
            commanded = window.commanded[k, chamber]
            later, mean = lagged_opening(gas.lag_s * more, step_s, own.lagged[m], commanded)
            other_opening = between(mean, later)
            own.lagged[m], mean = lagged_opening(gas.lag_s * value, step_s, own.lagged[m], commanded)
            opening = between(mean, own.lagged[m])
        elif change == _WIDENING:
            other_room, _share = ballooned(gas, pressure, more)
            room, share = ballooned(gas, pressure, value)
        after, volume, swelling = pressure, believed_m3, window.swelling[k, chamber]
        kept = by_inlet = by_outlet = by_hole = flowed = 0.0
        for _ in range(1 if own.growth_m3_Pa == 0.0 else 2):  # its volume is that under the pressure that it comes to
            more_Pa = unfelt_Pa(change, value, felt, after - gas.atmosphere_Pa, window.reading_Pa[k, chamber])
            volume = believed_m3 + own.growth_m3_Pa * more_Pa
            if own.volume_m3[m] > 0.0:
                swelling = swelled_by(volume, own.volume_m3[m])
            after, kept, by_inlet, by_outlet, by_hole, flowed = next_pressure(
                gas, chamber, pressure, supply, opening, room * volume, share * swelling, inlet, outlet, hole, step_s
            )
        swelling *= share
        own.volume_m3[m] = volume
        by_severity = 0.0
        if change == _HOLE:
            by_severity = by_hole * candidates.slope[m]
        elif change == _INLET:
            by_severity = by_inlet * own.sound[INLET] * candidates.slope[m]
        elif change == _OUTLET:
            by_severity = by_outlet * own.sound[OUTLET] * candidates.slope[m]
        elif change == _BOTH:
            by_severity = (by_inlet * own.sound[INLET] + by_outlet * own.sound[OUTLET]) * candidates.slope[m]
        elif change == _FORCED and opening > 0.0:
            by_severity = by_inlet * inlet / opening * candidates.slope[m]
        elif change in (_LAG, _WIDENING):
            other_Pa = unfelt_Pa(change, more, felt, after - gas.atmosphere_Pa, window.reading_Pa[k, chamber])
            other_m3 = believed_m3 + own.growth_m3_Pa * other_Pa
            other, _k, _a, _b, _l, _f = next_pressure(
                gas,
                chamber,
                pressure,
                supply,
                other_opening,
                other_room * other_m3,
                swelling,
                inlet,
                outlet,
                hole,
                step_s,
            )
            by_severity = (other - after) / _STEP_OF_SEVERITY
        pp, ps, ss = own.covariance[m, 0], own.covariance[m, 1], own.covariance[m, 2]
        pp, ps = (
            kept * (kept * pp + 2.0 * by_severity * ps) + by_severity * by_severity * ss,
            kept * ps + by_severity * ss,
        )
        pp += (MODEL_ERROR * flowed) ** 2 + (_SWELLING_ERROR * pressure * swelling) ** 2
        pp += _LEAST_ERROR_Pa**2 + window.timing_Pa[k, chamber] ** 2
        if change == _DRIFT:
            severity += USUAL_DRIFT * SENSOR_DRIFT_Pa_s * step_s / SENSOR_OFFSET_Pa
        gauge_Pa, scale, by_s = after - gas.atmosphere_Pa, 1.0, 0.0
        if change == _SCALE:
            scale, by_s = value, -SENSOR_SCALE_LOSS * gauge_Pa
        elif change in (_OFFSET, _DRIFT):
            by_s = SENSOR_OFFSET_Pa
        expected_Pa = scale * gauge_Pa + (by_s * severity if change in (_OFFSET, _DRIFT) else 0.0)
        drift = _SEVERITY_DRIFT
        if change in (_OFFSET, _DRIFT):
            drift = (_OFFSET_KEEPS_Pa if change == _OFFSET else _DRIFTS_Pa) / SENSOR_OFFSET_Pa
        ss += drift * drift
        gain_p, gain_s = scale * pp + by_s * ps, scale * ps + by_s * ss
        spread_Pa2 = scale * gain_p + by_s * gain_s + noise_Pa * noise_Pa
        off_Pa = shown_Pa - expected_Pa
        own.off_Pa[m], own.spread_Pa2[m] = off_Pa, spread_Pa2
        if not tells:
            own.x[m, 0] = max(after + pp / (pp + noise_Pa * noise_Pa) * off_Pa, 0.2 * gas.atmosphere_Pa)
            continue
        own.x[m, 0] = max(after + gain_p / spread_Pa2 * off_Pa, 0.2 * gas.atmosphere_Pa)
        if change == _DRIFT:
            least, most = -0.1, 1.0
        elif change == _OFFSET:
            least, most = -1.3, 1.3
        else:
            least, most = candidates.least[m], candidates.most[m]
        own.x[m, 1] = min(max(severity + gain_s / spread_Pa2 * off_Pa, least), most)
        own.covariance[m, 0] = pp - gain_p * gain_p / spread_Pa2
        own.covariance[m, 1] = ps - gain_p * gain_s / spread_Pa2
        own.covariance[m, 2] = max(ss - gain_s * gain_s / spread_Pa2, 1e-10)
    if tells:
        _charge(own)


@part()
def _charge(own: Any) -> None:
    """Add what a reading costs each explanation, over what it costs none.

    Those that know about as well what the next reading will be are given the same deviation: a filter that only says
    that it knows a little better would win in the long run by saying so.
    """
    least_Pa2 = math.inf
    for m in range(COUNT):
        if own.follows[m] > 0:
            least_Pa2 = min(least_Pa2, own.spread_Pa2[m])
    for m in range(COUNT):
        if own.follows[m] > 0:
            ratio = own.spread_Pa2[m] / least_Pa2
            if ratio < _ABOUT_AS_WELL:
                ratio = 1.0
            off_Pa2 = own.off_Pa[m] * own.off_Pa[m] / (ratio * least_Pa2)
            own.cost[m] += min(0.5 * off_Pa2, _WILDEST) + 0.5 * math.log(ratio)


@kernel(cache=False)
def give_up(own: Any) -> None:
    """Follow what costs far more than the best no longer; with one left there is nothing more to find out."""
    best, left = math.inf, 0
    for m in range(COUNT):
        if own.follows[m] > 0:
            best = min(best, own.cost[m])
    for m in range(COUNT):
        if own.cost[m] > best + _GIVEN_UP:
            own.follows[m] = 0
        left += own.follows[m]
    own.busy = left > 1


@kernel(cache=False)
def likeliest(own: Any, candidates: Candidates, named: int) -> tuple[int, float]:
    """The explanation that costs least, and its evidence against the kind that was named (0: it is that)."""
    best, cost = -1, math.inf
    for m in range(COUNT):
        if own.follows[m] > 0 and (best < 0 or own.cost[m] < own.cost[best]):
            best = m
        if own.follows[m] > 0 and candidates.kind[m] == named:
            cost = own.cost[m]
    if best < 0 or candidates.kind[best] == named:
        return best, 0.0
    return best, EVIDENCE * (cost - own.cost[best])


@part()
def severity_of(own: Any, candidates: Candidates, m: int, fitted: float) -> float:
    """What an explanation comes to; of a drift, which is followed by what it adds, the severity fitted first."""
    return abs(fitted) if candidates.change[m] == _DRIFT else abs(own.x[m, 1])
