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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.chamber_gas import Gas
from controllers.chamber_observer import OFFSET
from controllers.fault_candidates import COUNT, Candidates, Change
from controllers.fault_simulation import SIMULATED_Pa, growth_in, simulate
from controllers.fault_window import KEPT
from softbot.faults import CHAMBER_COUNT, SENSOR_DRIFT_Pa_s, SENSOR_OFFSET_Pa
from softbot.kernel_compiler import part

FloatArray = NDArray[np.float64]

ONSETS = np.array([2, 5, 9, 14, 22, 34, 50, 70, 95], dtype=np.int64)
"""Cycles before the alarm at which the fault may have struck."""
EVIDENCE = 0.7
"""What one reading counts: errors of the model are correlated over a few cycles."""
SYSTEMATIC_SHARE = 0.05
"""Deviation of the whole way that a simulated pressure has come, by one common factor for what was filled and one for
what was vented."""
_SWELLING_SHARE = 0.15
"""Deviation of the factor of what swelling did: the shape is known by a law and by gains that may be a fifth off."""
_MOST_SHARES = 2.5
"""Deviations of these factors at most: a way not come at all is no error of the model."""
WORST, WILD = 12.0, 3.0
"""Cost of one reading from which on it grows by so much with its logarithm only: however wild, one alone is no proof,
and many far off are still worse than as many less far."""
_INLET, _OUTLET, _BOTH, _FORCED = int(Change.INLET), int(Change.OUTLET), int(Change.BOTH), int(Change.FORCED)
_SCALE, _OFFSET, _DRIFT, _SWAP = int(Change.SCALE), int(Change.OFFSET), int(Change.DRIFT), int(Change.SWAP)


@part()
def _cost(error_Pa: float, deviation_Pa: float) -> float:
    ratio = error_Pa / deviation_Pa
    cost = 0.5 * ratio * ratio
    return (cost if cost < WORST else WORST + WILD * math.log(cost / WORST)) + math.log(deviation_Pa)


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
    scratch: Any,
) -> tuple[float, float]:
    """Cost of the readings of `chamber` if its sensor showed the simulated pressure so; the fitted number.

    share: deviation of the common factors by which all that was filled, and all that was vented, may be wrong; the
    factors are fitted with that as their prior, and so is one for what swelling did. A drift has begun earlier: what it
    had come to at the start, which the filter took for pressure, is fitted as well, and what the filter had not
    followed yet.
    """
    simulated_Pa, deviation_Pa = scratch.simulated_Pa, scratch.deviation_Pa
    terms, known, normal = scratch.terms, scratch.known, scratch.normal
    scale = value if change == _SCALE else 1.0
    count, usual = _FACTORS, 0.0
    known[0], known[1], known[2] = share, share, _SWELLING_SHARE
    if change == _OFFSET:
        count, known[3] = 4, _ANY_OFFSET_Pa
    elif change == _DRIFT:
        count, usual = 6, USUAL_DRIFT * SENSOR_DRIFT_Pa_s
        known[3], known[4], known[5] = _DRIFT_SPREAD * SENSOR_DRIFT_Pa_s, _DRIFTED_Pa, _START_ERROR_Pa
    for i in range(count):
        for j in range(count + 1):
            normal[i, j] = 0.0
        normal[i, i] = 1.0 / (known[i] * known[i])
    since_s = 0.0
    for n in range(since):
        k = (now - since + 1 + n) % KEPT
        since_s += window.step_s[k]
        weight = 1.0 / (deviation_Pa[n] * deviation_Pa[n])
        off_Pa = weight * (window.reading_Pa[k, chamber] - offset_Pa - scale * simulated_Pa[n] - usual * since_s)
        _terms(terms, scratch, n, scale, change, since_s)
        for i in range(count):
            weighted = weight * terms[i]
            for j in range(i + 1):
                normal[i, j] += weighted * terms[j]
            normal[i, count] += terms[i] * off_Pa
    for i in range(count):
        for j in range(i + 1, count):
            normal[i, j] = normal[j, i]
    total = 0.0
    for i in range(count):  # what was free to be fitted explains something by itself
        if i < _FACTORS or change == _DRIFT:
            total += 0.5 * math.log(normal[i, i] * known[i] * known[i])
    _solve(normal, count)
    for i in range(count):
        if i < _FACTORS:
            normal[i, count] = min(max(normal[i, count], -_MOST_SHARES * known[i]), _MOST_SHARES * known[i])
        if i < _FACTORS or change == _DRIFT:
            total += 0.5 * (normal[i, count] / known[i]) ** 2
    since_s = 0.0
    for n in range(since):
        k = (now - since + 1 + n) % KEPT
        since_s += window.step_s[k]
        seen_Pa = scale * simulated_Pa[n] + offset_Pa + usual * since_s
        _terms(terms, scratch, n, scale, change, since_s)
        for i in range(count):
            seen_Pa += normal[i, count] * terms[i]
        total += _cost(window.reading_Pa[k, chamber] - seen_Pa, deviation_Pa[n])
    return total, value if count == _FACTORS else normal[3, count] + usual


@part()
def _terms(terms: FloatArray, scratch: Any, n: int, scale: float, change: int, since_s: float) -> None:
    """What reading n depends on, for each thing that is fitted."""
    terms[0], terms[1], terms[2] = (
        scale * scratch.filled_Pa[n],
        scale * scratch.vented_Pa[n],
        scale * scratch.swelled_Pa[n],
    )
    if change == _OFFSET:
        terms[3] = 1.0
    elif change == _DRIFT:
        terms[3], terms[4], terms[5] = since_s, 1.0 - scratch.start[n], scratch.start[n]


@part()
def _share(window: Any, chamber: int, now: int, since: int) -> float:
    return math.hypot(SYSTEMATIC_SHARE, window.doubt[(now - since) % KEPT, chamber])


@part()
def _other_valves(gas: Gas, window: Any, chamber: int, now: int, since: int, noise_Pa: float, scratch: Any) -> float:
    """Cost of a healthy chamber whose valves are a little other than its filter has learnt."""
    offset_Pa = window.x[(now - since) % KEPT, chamber, OFFSET]
    simulate(gas, window, chamber, now, since, -1, 0.0, scratch, noise_Pa)
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
    scratch: Any,
) -> tuple[float, float]:
    """Cost of the readings if candidate m had struck `since` cycles ago, and the severity (fitted, for some)."""
    change = candidates.change[m]
    value = candidates.base[m] + candidates.slope[m] * severity
    share = _share(window, chamber, now, since)
    offset_Pa = window.x[(now - since) % KEPT, chamber, OFFSET]
    if change < _SCALE:
        simulate(gas, window, chamber, now, since, change, value, scratch, noise_Pa)
        cost, _unused = _sensor_cost(window, chamber, now, since, -1, 0.0, offset_Pa, share, scratch)
        return cost, severity
    simulate(gas, window, chamber, now, since, change, value, scratch, noise_Pa)
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
    gas: Gas, window: Any, chamber: int, other: int, now: int, since: int, noise_Pa: float, scratch: Any
) -> float:
    """Cost of this chamber's readings if its sensor and the other's were exchanged, less what that explains there."""
    share = _share(window, chamber, now, since)
    here_Pa = window.x[(now - since) % KEPT, chamber, OFFSET]
    there_Pa = window.x[(now - since) % KEPT, other, OFFSET]
    simulate(gas, window, other, now, since, -1, 0.0, scratch, noise_Pa)
    cost, _unused = _sensor_cost(window, chamber, now, since, -1, 0.0, here_Pa, share, scratch)
    simulate(gas, window, chamber, now, since, -1, 0.0, scratch, noise_Pa)
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
    scratch: Any,
) -> None:
    """Write into `verdict` what explains the chamber best at cycle `now`; the alarm was given at cycle `alarm`.

    oldest: the first cycle that the window holds of this run. afresh: search coarsely over onsets and severities first;
    otherwise go on from where the last verdict on this chamber found each kind best. Then the kinds that come near the
    best are fitted each. scratch: a record of SCRATCH.
    """
    longest = min(KEPT - 2, now - oldest)
    healthy, best, severity, since, where = (
        scratch.healthy,
        scratch.best,
        scratch.severity,
        scratch.since,
        scratch.where,
    )
    for back in range(KEPT):
        healthy[back] = math.nan
    for m in range(COUNT):
        best[m], severity[m], since[m], where[m] = -math.inf, 0.0, 0, chamber
    if afresh:
        verdict.growth_m3_Pa = growth_in(window, chamber)
    scratch.growth_m3_Pa = verdict.growth_m3_Pa
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
        # a valve stuck between two of the openings tried at first may look worse than it is by any measure
        far = best[m] < top - _NEAR and not (afresh and candidates.change[m] == _FORCED)
        if candidates.change[m] == _SWAP or since[m] == 0 or far:
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


_FACTORS, _ANY_OFFSET_Pa = 3, 1e6
"""Factors that are always fitted, and the deviation of an offset of which nothing is known."""
_DRIFTED_Pa, _START_ERROR_Pa = 2.5e3, 2e3
"""Deviation of what a drift may have come to before the window, and of what the filter had not followed."""
_LEAST_OFFSET, _MOST_OFFSET = 0.08, 1.3
_LEAST_DRIFT, _MOST_DRIFT, _LEAST_DRIFT_S = -0.3, 1.6, 0.3
"""Severities of what is fitted to the readings, and how long a drift has to be watched."""
USUAL_DRIFT, _DRIFT_SPREAD = 0.6, 0.35
"""Severity of a drift, and its deviation, before anything is fitted."""
_NEAR, _FITTING_ROUNDS, _FOLLOWING_ROUNDS = 80.0, 12, 3
"""Evidence behind the best within which a kind is fitted, and how often its severity and onset are moved, at first and
later on."""
