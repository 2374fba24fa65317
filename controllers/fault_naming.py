"""Naming a fault: which kind and severity of the library explains the last second of a chamber's readings best.

When a chamber's filter is surprised, the library is played over what was kept of the last cycles: for each kind,
severity and time of onset the chamber is simulated from what the filter believed at that onset, with the conductances
that it had learnt of this very robot, under the openings that were really commanded. The logarithm of the likelihood
ratio against the filter itself (a healthy robot) is the evidence; the posterior over the kinds is the confidence, and
the best severity is the estimate. Nothing here decides; `controllers.fault_detection` does.

Two things that are the same are not told apart: a line that is closed for good and a valve that is stuck shut.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.chamber_gas import Gas, lagged_opening, next_pressure
from controllers.chamber_observer import HOLE, INLET, OFFSET, OUTLET, PRESSURE, STATES, between
from controllers.fault_candidates import COUNT, Candidates, Change, changed_ways
from softbot.faults import (
    BALLOON_LOSS,
    CHAMBER_COUNT,
    KINDS,
    BALLOON_VOLUME_1_Pa,
    SENSOR_DRIFT_Pa_s,
    SENSOR_OFFSET_Pa,
)
from softbot.kernel_compiler import part

FloatArray = NDArray[np.float64]

KEPT = 128
"""Cycles that are kept."""
ONSETS = np.array([2, 5, 9, 14, 22, 34, 50, 70, 95], dtype=np.int64)
"""Cycles before the alarm at which the fault may have struck."""
EVIDENCE = 0.7
"""What one reading counts: errors of the model are correlated over a few cycles."""
SYSTEMATIC_SHARE, SIMULATED_Pa = 0.05, 350.0
"""Deviation of a simulated pressure: of the whole way that it has come, by one common factor, and of each by itself."""
_SWELLING_SHARE = 0.15
"""Deviation of the factor of what swelling did: the shape is known by a law and by gains that may be a fifth off."""
_MOST_SHARES = 2.5
"""Deviations of that factor at most: a way not come at all is no error of the model."""
TIMING_KEPT = 0.9
"""Share of what a valve's moving may have made of the pressure that is still there a cycle later, squared."""
WORST = 12.0
"""Cost of one reading at most: however wild, it is no proof."""
_INLET, _OUTLET, _BOTH = int(Change.INLET), int(Change.OUTLET), int(Change.BOTH)
_FORCED, _LAG, _WIDENING = int(Change.FORCED), int(Change.LAG), int(Change.WIDENING)
_SCALE, _OFFSET, _DRIFT, _SWAP = int(Change.SCALE), int(Change.OFFSET), int(Change.DRIFT), int(Change.SWAP)


KIND_COUNT = len(KINDS) + 1

WINDOW = np.dtype(
    [
        ("step_s", np.float64, KEPT),
        ("reading_Pa", np.float64, (KEPT, CHAMBER_COUNT)),
        ("supply", np.float64, KEPT),
        ("commanded", np.float64, (KEPT, CHAMBER_COUNT)),
        ("opening", np.float64, (KEPT, CHAMBER_COUNT)),
        ("lagged", np.float64, (KEPT, CHAMBER_COUNT)),
        ("volume_m3", np.float64, (KEPT, CHAMBER_COUNT)),
        ("swelling", np.float64, (KEPT, CHAMBER_COUNT)),
        ("x", np.float64, (KEPT, CHAMBER_COUNT, STATES)),
        ("timing_Pa", np.float64, (KEPT, CHAMBER_COUNT)),
        ("doubt", np.float64, (KEPT, CHAMBER_COUNT)),
        ("innovation_Pa", np.float64, (KEPT, CHAMBER_COUNT)),
        ("deviation_Pa", np.float64, (KEPT, CHAMBER_COUNT)),
    ],
    align=True,
)
"""What is kept of the last cycles, a place each in turn: readings, absolute supply that acted until then, openings
(commanded, mean and lagged), volumes, and what the filters believed after each; `doubt`: deviation of the conductances
that they had learnt."""

VERDICT = np.dtype(
    [
        ("kind", np.int64),
        ("candidate", np.int64),
        ("chamber", np.int64),
        ("severity", np.float64),
        ("evidence", np.float64),
        ("lead", np.float64),
        ("confidence", np.float64),
        ("since", np.int64),
        ("best", np.float64, KIND_COUNT),
        ("onset", np.int64, COUNT),
        ("fitted", np.float64, COUNT),
        ("where", np.int64, COUNT),
    ],
    align=True,
)
"""What explains a chamber best, as a record: kind by number, severity, evidence against a healthy robot, lead over the
next kind (both logarithms of likelihood ratios), posterior of the kind, cycles since the onset; `best` evidence of each
kind; of each candidate where it was best: cycle of the onset, severity, chamber."""


class _Scratch(NamedTuple):
    """What was simulated last: gauge pressures, how far each may be off, the way that it has come (as far as the
    pressure still depends on it), and how much of an error at the start is still in it."""

    simulated_Pa: FloatArray
    deviation_Pa: FloatArray
    way_Pa: FloatArray
    swelled_Pa: FloatArray
    """… and of that what the chamber's swelling did."""
    start: FloatArray
    normal: FloatArray
    """Normal equations of what is fitted, shape (5, 6)."""


@part()
def _cost(error_Pa: float, deviation_Pa: float) -> float:
    ratio = error_Pa / deviation_Pa
    return min(0.5 * ratio * ratio, WORST) + math.log(deviation_Pa)


@part()
def _widened(gas: Gas, pressure: float, widening_1_Pa: float) -> float:
    """The absolute pressure of a chamber's gas after its wall has given way: p (1 + w (p − p_a)) = p before."""
    if pressure <= gas.atmosphere_Pa or widening_1_Pa <= 0.0:
        return pressure
    linear = 1.0 - widening_1_Pa * gas.atmosphere_Pa
    return (math.sqrt(linear * linear + 4.0 * widening_1_Pa * pressure) - linear) / (2.0 * widening_1_Pa)


@part()
def _growth_m3_Pa(window: Any, chamber: int) -> float:
    """By how much the shape that is believed makes a chamber larger with each pascal that its sensor shows."""
    count = volume = shown = both = square = 0.0
    for k in range(KEPT):
        if window.volume_m3[k, chamber] > 0.0:
            v, p = window.volume_m3[k, chamber], window.reading_Pa[k, chamber]
            count, volume, shown, both, square = count + 1.0, volume + v, shown + p, both + v * p, square + p * p
    spread = square - shown * shown / max(count, 1.0)
    return max(both - volume * shown / max(count, 1.0), 0.0) / spread if spread > 0.0 else 0.0


@part()
def _simulate(
    gas: Gas,
    window: Any,
    chamber: int,
    now: int,
    since: int,
    change: int,
    value: float,
    scratch: _Scratch,
    noise_Pa: float,
) -> None:
    """Gauge pressures of the last `since` cycles up to number `now` if this were wrong with the chamber."""
    at = (now - since) % KEPT
    believed = window.x[at, chamber]
    pressure, inlet, outlet, hole = believed[PRESSURE], believed[INLET], believed[OUTLET], max(believed[HOLE], 0.0)
    lagged = window.lagged[at, chamber]
    inlet, outlet, hole = changed_ways(change, value, inlet, outlet, hole)
    way, swelled, start, timing_Pa2 = 0.0, 0.0, 1.0, 0.0
    volume_before, growth_m3_Pa = window.volume_m3[at, chamber], 0.0
    if change in (_SCALE, _WIDENING):
        growth_m3_Pa = _growth_m3_Pa(window, chamber)
    if change == _WIDENING:
        way = _widened(gas, pressure, value) - pressure
        pressure += way
    for n in range(since):
        k = (now - since + 1 + n) % KEPT
        opening, step_s = window.opening[k, chamber], window.step_s[k]
        if change == _FORCED:
            opening = value
        elif change == _LAG:
            lagged, opening = lagged_opening(gas.lag_s * value, step_s, lagged, window.commanded[k, chamber])
            opening = between(opening, lagged)
        volume, swelling = window.volume_m3[k, chamber], window.swelling[k, chamber]
        if change in (_SCALE, _WIDENING):
            # the shape was reckoned with what was shown, and with a chamber that presses on its wall
            gauge_Pa = max(pressure - gas.atmosphere_Pa, 0.0)
            unseen = 1.0 - value if change == _SCALE else -BALLOON_LOSS / BALLOON_VOLUME_1_Pa * value
            volume += growth_m3_Pa * unseen * gauge_Pa
            swelling = (volume - volume_before) / volume
            volume_before = volume
            if change == _WIDENING:
                volume *= 1.0 + value * (gauge_Pa + pressure)
        after, kept, _a, _b, _l, _flowed = next_pressure(
            gas, chamber, pressure, window.supply[k], opening, volume, swelling, inlet, outlet, hole, step_s
        )
        # what the chamber has come to forget of its way, as when it is vented, is no error any more
        way, start = kept * way + after - pressure, kept * start
        swelled = kept * swelled - pressure * swelling / (1.0 + swelling)
        pressure = after
        scratch.simulated_Pa[n] = pressure - gas.atmosphere_Pa
        scratch.way_Pa[n], scratch.swelled_Pa[n], scratch.start[n] = way, swelled, start
        timing_Pa2 = TIMING_KEPT * timing_Pa2 + window.timing_Pa[k, chamber] ** 2
        scratch.deviation_Pa[n] = math.sqrt(noise_Pa * noise_Pa + SIMULATED_Pa * SIMULATED_Pa + timing_Pa2)


@part()
def _healthy_cost(window: Any, chamber: int, now: int, since: int, noise_Pa: float) -> float:
    """Cost of the filter's own predictions, each a step ahead, with the deviations of what is simulated.

    The same deviations, so that no explanation gains by reaching back into a time when nothing was wrong.
    """
    total = 0.0
    for n in range(since):
        k = (now - n) % KEPT
        timing_Pa = window.timing_Pa[k, chamber]
        deviation_Pa = math.sqrt(noise_Pa * noise_Pa + SIMULATED_Pa * SIMULATED_Pa + timing_Pa * timing_Pa)
        total += _cost(window.innovation_Pa[k, chamber], deviation_Pa)
    return total


@part()
def _solve(normal: FloatArray, count: int) -> None:
    """Normal equations in place; the solution stands in the column after the last. They are positive definite."""
    for i in range(count):
        for r in range(count):
            if r != i:
                ratio = normal[r, i] / normal[i, i]
                for j in range(i, count + 1):
                    normal[r, j] -= ratio * normal[i, j]
    for i in range(count):
        normal[i, count] /= normal[i, i]


@part()
def _sensor_cost(
    window: Any,
    chamber: int,
    now: int,
    since: int,
    change: int,
    value: float,
    offset_Pa: float,
    share: float,
    scratch: _Scratch,
) -> tuple[float, float]:
    """Cost of the readings of `chamber` if its sensor showed the simulated pressure so; the fitted number.

    share: deviation of the common factor by which all ways may be wrong; the factor is fitted with that as its prior,
    and so is one for what swelling did. A drift has begun earlier: what it had come to at the start, which the filter
    took for pressure, is fitted as well, and what the filter had not followed yet.
    """
    simulated_Pa, deviation_Pa, way_Pa, swelled_Pa, starts, normal = scratch
    scale = value if change == _SCALE else 1.0
    count, usual, spread = 2, 0.0, _DRIFT_SPREAD * SENSOR_DRIFT_Pa_s
    if change == _OFFSET:
        count = 3
    elif change == _DRIFT:
        count, usual = 5, _USUAL_DRIFT * SENSOR_DRIFT_Pa_s
    for i in range(count):
        for j in range(count + 1):
            normal[i, j] = 0.0
    normal[0, 0], normal[1, 1] = 1.0 / (share * share), 1.0 / (_SWELLING_SHARE * _SWELLING_SHARE)
    if change == _OFFSET:
        normal[2, 2] = 1e-12
    elif change == _DRIFT:
        normal[2, 2], normal[3, 3] = 1.0 / (spread * spread), 1.0 / _DRIFTED_Pa**2
        normal[4, 4] = 1.0 / _START_ERROR_Pa**2
    since_s = third = fourth = fifth = 0.0
    for n in range(since):
        k = (now - since + 1 + n) % KEPT
        since_s += window.step_s[k]
        weight = 1.0 / (deviation_Pa[n] * deviation_Pa[n])
        off_Pa = weight * (window.reading_Pa[k, chamber] - offset_Pa - scale * simulated_Pa[n] - usual * since_s)
        first, second = scale * way_Pa[n], scale * swelled_Pa[n]
        normal[0, 0] += weight * first * first
        normal[1, 0] += weight * second * first
        normal[1, 1] += weight * second * second
        normal[0, count] += first * off_Pa
        normal[1, count] += second * off_Pa
        if count > 2:
            third = 1.0 if change == _OFFSET else since_s
            normal[2, 0] += weight * third * first
            normal[2, 1] += weight * third * second
            normal[2, 2] += weight * third * third
            normal[2, count] += third * off_Pa
        if count > 3:
            fourth, fifth = 1.0 - starts[n], starts[n]
            normal[3, 0] += weight * fourth * first
            normal[3, 1] += weight * fourth * second
            normal[3, 2] += weight * fourth * third
            normal[3, 3] += weight * fourth * fourth
            normal[3, count] += fourth * off_Pa
            normal[4, 0] += weight * fifth * first
            normal[4, 1] += weight * fifth * second
            normal[4, 2] += weight * fifth * third
            normal[4, 3] += weight * fifth * fourth
            normal[4, 4] += weight * fifth * fifth
            normal[4, count] += fifth * off_Pa
    for i in range(count):
        for j in range(i + 1, count):
            normal[i, j] = normal[j, i]
    # what was free to be fitted explains something by itself
    total = 0.5 * math.log(normal[0, 0] * share * share * normal[1, 1] * _SWELLING_SHARE * _SWELLING_SHARE)
    if count > 3:
        total += 0.5 * math.log(normal[2, 2] * spread * spread * normal[3, 3] * _DRIFTED_Pa**2)
    _solve(normal, count)
    factor = min(max(normal[0, count], -_MOST_SHARES * share), _MOST_SHARES * share)
    swell = min(max(normal[1, count], -_MOST_SHARES * _SWELLING_SHARE), _MOST_SHARES * _SWELLING_SHARE)
    total += 0.5 * (factor / share) ** 2 + 0.5 * (swell / _SWELLING_SHARE) ** 2
    fitted = value if count == 2 else normal[2, count]
    came = began = 0.0
    if count > 3:
        came, began = normal[3, count], normal[4, count]
        total += 0.5 * (came / _DRIFTED_Pa) ** 2 + 0.5 * (began / _START_ERROR_Pa) ** 2 + 0.5 * (fitted / spread) ** 2
        fitted += usual
    since_s = 0.0
    for n in range(since):
        k = (now - since + 1 + n) % KEPT
        since_s += window.step_s[k]
        seen_Pa = scale * (simulated_Pa[n] + factor * way_Pa[n] + swell * swelled_Pa[n]) + offset_Pa
        if count > 2:
            seen_Pa += fitted * (1.0 if change == _OFFSET else since_s)
        if count > 3:
            seen_Pa += came * (1.0 - starts[n]) + began * starts[n]
        total += _cost(window.reading_Pa[k, chamber] - seen_Pa, deviation_Pa[n])
    return total, fitted


@part()
def _share(window: Any, chamber: int, now: int, since: int) -> float:
    return math.hypot(SYSTEMATIC_SHARE, window.doubt[(now - since) % KEPT, chamber])


@part()
def _other_valves(
    gas: Gas, window: Any, chamber: int, now: int, since: int, noise_Pa: float, scratch: _Scratch
) -> float:
    """Cost of a healthy chamber whose valves are a little other than its filter has learnt."""
    offset_Pa = window.x[(now - since) % KEPT, chamber, OFFSET]
    _simulate(gas, window, chamber, now, since, -1, 0.0, scratch, noise_Pa)
    share = _share(window, chamber, now, since)
    return _sensor_cost(window, chamber, now, since, -1, 0.0, offset_Pa, share, scratch)[0]


@part()
def _explained(
    gas: Gas,
    window: Any,
    chamber: int,
    now: int,
    since: int,
    candidates: Candidates,
    m: int,
    severity: float,
    noise_Pa: float,
    scratch: _Scratch,
) -> tuple[float, float]:
    """Cost of the readings if candidate m had struck `since` cycles ago, and the severity (fitted, for some)."""
    change = candidates.change[m]
    value = candidates.base[m] + candidates.slope[m] * severity
    share = _share(window, chamber, now, since)
    offset_Pa = window.x[(now - since) % KEPT, chamber, OFFSET]
    if change < _SCALE:
        _simulate(gas, window, chamber, now, since, change, value, scratch, noise_Pa)
        cost, _unused = _sensor_cost(window, chamber, now, since, -1, 0.0, offset_Pa, share, scratch)
        return cost, severity
    _simulate(gas, window, chamber, now, since, _SCALE if change == _SCALE else -1, value, scratch, noise_Pa)
    cost, fitted = _sensor_cost(window, chamber, now, since, change, value, offset_Pa, share, scratch)
    if change == _OFFSET:
        severity = fitted / SENSOR_OFFSET_Pa
        if not _LEAST_OFFSET < abs(severity) < _MOST_OFFSET:
            return math.inf, 0.0
    elif change == _DRIFT:
        severity = fitted / SENSOR_DRIFT_Pa_s
        if not _LEAST_DRIFT < severity < _MOST_DRIFT or since * window.step_s[now % KEPT] < _LEAST_DRIFT_S:
            return math.inf, 0.0
    return cost, severity


@part()
def _swapped(
    gas: Gas, window: Any, chamber: int, other: int, now: int, since: int, noise_Pa: float, scratch: _Scratch
) -> float:
    """Cost of this chamber's readings if its sensor and the other's were exchanged, less what that explains there."""
    share = _share(window, chamber, now, since)
    here_Pa = window.x[(now - since) % KEPT, chamber, OFFSET]
    there_Pa = window.x[(now - since) % KEPT, other, OFFSET]
    _simulate(gas, window, other, now, since, -1, 0.0, scratch, noise_Pa)
    cost, _unused = _sensor_cost(window, chamber, now, since, -1, 0.0, here_Pa, share, scratch)
    _simulate(gas, window, chamber, now, since, -1, 0.0, scratch, noise_Pa)
    theirs, _unused = _sensor_cost(window, other, now, since, -1, 0.0, there_Pa, share, scratch)
    return cost + theirs - _healthy_cost(window, other, now, since, noise_Pa)


@part()
def name_fault(
    gas: Gas,
    window: Any,
    chamber: int,
    now: int,
    alarm: int,
    oldest: int,
    noise_Pa: float,
    candidates: Candidates,
    afresh: bool,
    verdict: Any,
) -> None:
    """Write into `verdict` what explains the chamber best at cycle `now`; the alarm was given at cycle `alarm`.

    oldest: the first cycle that the window holds of this run. afresh: search coarsely over onsets and severities first;
    otherwise go on from where the last verdict on this chamber found each kind best. Then the kinds that come near the
    best are fitted each.
    """
    scratch = _Scratch(np.empty(KEPT), np.empty(KEPT), np.empty(KEPT), np.empty(KEPT), np.empty(KEPT), np.empty((5, 6)))
    longest = min(KEPT - 2, now - oldest)
    healthy = np.full(KEPT, math.nan)
    best, severity = np.full(COUNT, -math.inf), np.zeros(COUNT)
    since, where = np.zeros(COUNT, np.int64), np.full(COUNT, chamber)
    sound = 0.0  # evidence for a healthy chamber after all
    for o in range(ONSETS.shape[0] if afresh else 0):
        back = now - alarm + ONSETS[o]
        if back > longest:
            break
        healthy[back] = _healthy_cost(window, chamber, now, back, noise_Pa)
        cost = _other_valves(gas, window, chamber, now, back, noise_Pa, scratch)
        sound = max(sound, EVIDENCE * (healthy[back] - cost))
        for m in range(COUNT):
            if candidates.change[m] == _SWAP:
                for towards in range(2):
                    other = (chamber + (1 if towards == 0 else CHAMBER_COUNT - 1)) % CHAMBER_COUNT
                    cost = _swapped(gas, window, chamber, other, now, back, noise_Pa, scratch)
                    evidence = EVIDENCE * (healthy[back] - cost) + candidates.prior[m]
                    if evidence > best[m]:
                        best[m], since[m], severity[m] = evidence, back, 1.0
                        where[m] = chamber if towards == 0 else other
                continue
            tries = 1 if candidates.most[m] == candidates.least[m] else candidates.severity.shape[1]
            for n in range(tries):
                cost, fitted = _explained(
                    gas, window, chamber, now, back, candidates, m, candidates.severity[m, n], noise_Pa, scratch
                )
                evidence = EVIDENCE * (healthy[back] - cost) + candidates.prior[m]
                if evidence > best[m]:
                    best[m], since[m], severity[m] = evidence, back, fitted
    for m in range(0 if afresh else COUNT):
        back = now - verdict.onset[m]
        if verdict.onset[m] > 0 and back > longest and candidates.change[m] not in (_SCALE, _OFFSET, _SWAP):
            back = longest  # the filter has followed the pressure since, whatever the valves had
        if verdict.onset[m] == 0 or back > longest:
            continue
        since[m], severity[m], where[m] = back, verdict.fitted[m], verdict.where[m]
        if math.isnan(healthy[back]):
            healthy[back] = _healthy_cost(window, chamber, now, back, noise_Pa)
            cost = _other_valves(gas, window, chamber, now, back, noise_Pa, scratch)
            sound = max(sound, EVIDENCE * (healthy[back] - cost))
        if candidates.change[m] == _SWAP:
            other = (where[m] + 1) % CHAMBER_COUNT if where[m] == chamber else where[m]
            cost = _swapped(gas, window, chamber, other, now, back, noise_Pa, scratch)
        else:
            cost, severity[m] = _explained(
                gas, window, chamber, now, back, candidates, m, severity[m], noise_Pa, scratch
            )
        best[m] = EVIDENCE * (healthy[back] - cost) + candidates.prior[m]
    lead = int(np.argmax(best))
    for m in range(COUNT):
        # what came near by another way may come nearer by the best one's: its onset and, for paths, its severity
        change, back = candidates.change[m], since[lead]
        if m == lead or change == _SWAP or back == 0 or since[m] == 0:
            continue
        value = severity[m]
        if change in (_INLET, _OUTLET, _BOTH) and candidates.change[lead] in (_INLET, _OUTLET, _BOTH):
            value = min(max(severity[lead], candidates.least[m]), candidates.most[m])
        if math.isnan(healthy[back]):
            healthy[back] = _healthy_cost(window, chamber, now, back, noise_Pa)
        cost, fitted = _explained(gas, window, chamber, now, back, candidates, m, value, noise_Pa, scratch)
        evidence = EVIDENCE * (healthy[back] - cost) + candidates.prior[m]
        if evidence > best[m]:
            best[m], since[m], severity[m] = evidence, back, fitted
    top = best.max()
    for m in range(COUNT):
        if candidates.change[m] == _SWAP or since[m] == 0 or best[m] < top - _NEAR:
            continue
        by, hop = (0.5, 4) if afresh else (0.12, 2)
        for _ in range(_FITTING_ROUNDS if afresh else _FOLLOWING_ROUNDS):
            better = False
            for n in range(4):
                back, value = since[m], severity[m]
                if n < 2:
                    if candidates.most[m] == candidates.least[m]:
                        continue
                    # moved by a share of what is left of a path, or of what there is of the rest
                    left = 1.0 - value if candidates.slope[m] == -1.0 else value
                    left = (left + 0.02) * (1.0 + by) - 0.02 if n == 0 else (left + 0.02) / (1.0 + by) - 0.02
                    value = 1.0 - left if candidates.slope[m] == -1.0 else left
                    value = min(max(value, candidates.least[m]), candidates.most[m])
                else:
                    back += hop if n == 2 else -hop
                    if back > longest or back < now - alarm + 1:
                        continue
                if math.isnan(healthy[back]):
                    healthy[back] = _healthy_cost(window, chamber, now, back, noise_Pa)
                cost, fitted = _explained(gas, window, chamber, now, back, candidates, m, value, noise_Pa, scratch)
                evidence = EVIDENCE * (healthy[back] - cost) + candidates.prior[m]
                if evidence > best[m]:
                    best[m], since[m], severity[m], better = evidence, back, fitted, True
            if not better:
                if hop == 1 and by < 0.1:
                    break
                by, hop = 0.5 * by, max(hop // 2, 1)
    verdict.kind, verdict.evidence, verdict.lead, verdict.confidence = 0, 0.0, 0.0, 0.0
    first = 0
    for m in range(COUNT):
        verdict.best[candidates.kind[m]] = best[m]
        verdict.onset[m] = now - since[m] if since[m] > 0 else 0
        verdict.fitted[m], verdict.where[m] = severity[m], where[m]
        if best[m] > best[first]:
            first = m
    if best[first] <= sound:
        return
    second, total = sound, math.exp(max(sound - best[first], -700.0))
    for m in range(COUNT):
        total += math.exp(max(best[m] - best[first], -700.0))
        if m != first:
            second = max(second, best[m])
    verdict.candidate = first
    verdict.kind, verdict.evidence, verdict.lead = candidates.kind[first], best[first] - sound, best[first] - second
    verdict.chamber, verdict.severity, verdict.since = where[first], abs(severity[first]), since[first]
    verdict.confidence = 1.0 / total


_DRIFTED_Pa, _START_ERROR_Pa = 2.5e3, 600.0
"""Deviation of what a drift may have come to before the window, and of what the filter had not followed."""
_LEAST_OFFSET, _MOST_OFFSET = 0.08, 1.3
_LEAST_DRIFT, _MOST_DRIFT, _LEAST_DRIFT_S = 0.05, 1.6, 0.3
"""Severities of what is fitted to the readings, and how long a drift has to be watched."""
_USUAL_DRIFT, _DRIFT_SPREAD = 0.6, 0.35
"""Severity of a drift, and its deviation, before anything is fitted."""
_NEAR, _FITTING_ROUNDS, _FOLLOWING_ROUNDS = 80.0, 12, 3
"""Evidence behind the best within which a kind is fitted, and how often its severity and onset are moved, at first and
later on."""
