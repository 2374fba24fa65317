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
"""Deviation of a simulated pressure: of the whole way that it has come, by one common factor for what was filled and
one for what was vented, and of each by itself."""
_SWELLING_SHARE = 0.15
"""Deviation of the factor of what swelling did: the shape is known by a law and by gains that may be a fifth off."""
_MOST_SHARES = 2.5
"""Deviations of these factors at most: a way not come at all is no error of the model."""
FASTEST_SWELLING = 0.05
"""Of a volume, in one cycle."""
TIMING_KEPT = 0.9
"""Share of what a valve's moving may have made of the pressure that is still there a cycle later, squared."""
WORST, WILD = 12.0, 3.0
"""Cost of one reading from which on it grows by so much with its logarithm only: however wild, one alone is no proof,
and many far off are still worse than as many less far."""
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
        ("felt", np.float64, (KEPT, CHAMBER_COUNT)),
        ("x", np.float64, (KEPT, CHAMBER_COUNT, STATES)),
        ("timing_Pa", np.float64, (KEPT, CHAMBER_COUNT)),
        ("doubt", np.float64, (KEPT, CHAMBER_COUNT)),
        ("innovation_Pa", np.float64, (KEPT, CHAMBER_COUNT)),
        ("deviation_Pa", np.float64, (KEPT, CHAMBER_COUNT)),
    ],
    align=True,
)
"""What is kept of the last cycles, a place each in turn: readings, absolute supply that acted until then, openings
(commanded, mean and lagged), volumes, and what the filters believed after each; `felt`: share of a reading that the
shape was reckoned with; `doubt`: deviation of the conductances that they had learnt."""

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
        ("growth_m3_Pa", np.float64),
        ("best", np.float64, KIND_COUNT),
        ("onset", np.int64, COUNT),
        ("fitted", np.float64, COUNT),
        ("where", np.int64, COUNT),
    ],
    align=True,
)
"""What explains a chamber best, as a record: kind by number, severity, evidence against a healthy robot, lead over the
next kind (both logarithms of likelihood ratios), posterior of the kind, cycles since the onset; by how much the chamber
grows with each pascal on its wall, as it was before anything was named; `best` evidence of each kind; of each candidate
where it was best: cycle of the onset, severity, chamber."""

MOST_TERMS = 6
"""Terms that are fitted to the readings."""
SCRATCH = np.dtype(
    [
        ("simulated_Pa", np.float64, KEPT),
        ("deviation_Pa", np.float64, KEPT),
        ("filled_Pa", np.float64, KEPT),
        ("vented_Pa", np.float64, KEPT),
        ("swelled_Pa", np.float64, KEPT),
        ("start", np.float64, KEPT),
        ("terms", np.float64, MOST_TERMS),
        ("known", np.float64, MOST_TERMS),
        ("normal", np.float64, (MOST_TERMS, MOST_TERMS + 1)),
        ("healthy", np.float64, KEPT),
        ("best", np.float64, COUNT),
        ("severity", np.float64, COUNT),
        ("since", np.int64, COUNT),
        ("where", np.int64, COUNT),
        ("growth_m3_Pa", np.float64),
    ],
    align=True,
)
"""Scratch of a look, as a record. What was simulated last: gauge pressures, how far each may be off, the ways that it
has come while it was filled and while it was vented (as far as the pressure still depends on them), of these what the
chamber's swelling did, and how much of an error at the start is still in it. What is fitted: its terms for a reading,
the deviations that are known of it before, and its normal equations. Then the cost of a healthy chamber by cycles since
the onset, and of each candidate what explains best so far."""


@part()
def _cost(error_Pa: float, deviation_Pa: float) -> float:
    ratio = error_Pa / deviation_Pa
    cost = 0.5 * ratio * ratio
    return (cost if cost < WORST else WORST + WILD * math.log(cost / WORST)) + math.log(deviation_Pa)


@part()
def _widened(gas: Gas, pressure: float, widening_1_Pa: float) -> float:
    """The absolute pressure of a chamber's gas after its wall has given way: p (1 + w (p − p_a)) = p before."""
    if pressure <= gas.atmosphere_Pa or widening_1_Pa <= 0.0:
        return pressure
    linear = 1.0 - widening_1_Pa * gas.atmosphere_Pa
    return (math.sqrt(linear * linear + 4.0 * widening_1_Pa * pressure) - linear) / (2.0 * widening_1_Pa)


@part()
def _growth_m3_Pa(window: Any, chamber: int) -> float:
    """By how much the shape that is believed makes a chamber larger with each pascal that its wall is taken to feel."""
    count = volume = felt = both = square = 0.0
    for k in range(KEPT):
        if window.volume_m3[k, chamber] > 0.0:
            v, p = window.volume_m3[k, chamber], window.felt[k, chamber] * window.reading_Pa[k, chamber]
            count, volume, felt, both, square = count + 1.0, volume + v, felt + p, both + v * p, square + p * p
    spread = square - felt * felt / max(count, 1.0)
    return max(both - volume * felt / max(count, 1.0), 0.0) / spread if spread > 0.0 else 0.0


@part()
def unfelt(change: int, value: float, felt: float) -> float:
    """Share of a chamber's gauge pressure that its wall feels if this is wrong with it, and the shape does not know of.

    felt: share of what was shown that the shape was reckoned with.
    """
    if change == _WIDENING:
        return 1.0 - BALLOON_LOSS / BALLOON_VOLUME_1_Pa * value - felt
    return 1.0 - felt * (value if change == _SCALE else 1.0)


@part()
def unfelt_Pa(change: int, value: float, felt: float, gauge_Pa: float, shown_Pa: float) -> float:
    """The pressure that the wall feels and the shape does not know of; of what adds to the reading, by the reading."""
    if change in (_OFFSET, _DRIFT):
        return max(gauge_Pa, 0.0) - felt * max(shown_Pa, 0.0)
    return unfelt(change, value, felt) * max(gauge_Pa, 0.0)


@part()
def ballooned(gas: Gas, pressure: float, value: float) -> tuple[float, float]:
    """Of a chamber that balloons, at an absolute pressure: its room for gas over its volume, and what swelling does."""
    gauge_Pa = max(pressure - gas.atmosphere_Pa, 0.0)
    room = 1.0 + value * (gauge_Pa + pressure)
    return room, (1.0 + value * gauge_Pa) / room


@part()
def swelled_by(volume_m3: float, before_m3: float) -> float:
    """Relative growth of a volume in a cycle; a shape that is believed may jump, a chamber does not."""
    return min(max((volume_m3 - before_m3) / volume_m3, -FASTEST_SWELLING), FASTEST_SWELLING)


@part()
def _simulate(
    gas: Gas,
    window: Any,
    chamber: int,
    now: int,
    since: int,
    change: int,
    value: float,
    scratch: Any,
    noise_Pa: float,
) -> None:
    """Gauge pressures of the last `since` cycles up to number `now` if this were wrong with the chamber."""
    at = (now - since) % KEPT
    believed = window.x[at, chamber]
    pressure, inlet, outlet, hole = believed[PRESSURE], believed[INLET], believed[OUTLET], max(believed[HOLE], 0.0)
    lagged = window.lagged[at, chamber]
    inlet, outlet, hole = changed_ways(change, value, inlet, outlet, hole)
    filled, vented, swelled, start, timing_Pa2 = 0.0, 0.0, 0.0, 1.0, 0.0
    growth_m3_Pa, corrected = scratch.growth_m3_Pa, False
    volume_before = window.volume_m3[at, chamber]
    volume_before += growth_m3_Pa * unfelt(-1, 0.0, window.felt[at, chamber]) * max(pressure - gas.atmosphere_Pa, 0.0)
    if change == _WIDENING:
        vented = _widened(gas, pressure, value) - pressure
        pressure += vented
    for n in range(since):
        k = (now - since + 1 + n) % KEPT
        opening, step_s = window.opening[k, chamber], window.step_s[k]
        if change == _FORCED:
            opening = value
        elif change == _LAG:
            lagged, opening = lagged_opening(gas.lag_s * value, step_s, lagged, window.commanded[k, chamber])
            opening = between(opening, lagged)
        volume, passes = window.volume_m3[k, chamber], 1
        felt, shown_Pa = window.felt[k, chamber], window.reading_Pa[k, chamber]
        believes_wrong = change in (_OFFSET, _DRIFT) or unfelt(change, value, felt) != 0.0
        swelling, room, share, after, kept = window.swelling[k, chamber], 1.0, 1.0, pressure, 1.0
        if change == _WIDENING:
            room, share = ballooned(gas, pressure, value)
        if corrected or change == _WIDENING or (growth_m3_Pa != 0.0 and believes_wrong):
            passes, corrected = 2, True  # its volume is that under the pressure that it comes to
        for _ in range(passes):
            if passes > 1:
                volume = window.volume_m3[k, chamber]
                volume += growth_m3_Pa * unfelt_Pa(change, value, felt, after - gas.atmosphere_Pa, shown_Pa)
                swelling = swelled_by(volume, volume_before)
            after, kept, _a, _b, _l, _flowed = next_pressure(
                gas,
                chamber,
                pressure,
                window.supply[k],
                opening,
                room * volume,
                share * swelling,
                inlet,
                outlet,
                hole,
                step_s,
            )
        swelling *= share
        volume_before = volume
        # what the chamber has come to forget of its way, as when it is vented, is no error any more
        filled, vented, start = kept * filled, kept * vented, kept * start
        if opening > 0.0:
            filled += after - pressure
        else:
            vented += after - pressure
        swelled = kept * swelled - pressure * swelling / (1.0 + swelling)
        pressure = after
        scratch.simulated_Pa[n] = pressure - gas.atmosphere_Pa
        scratch.filled_Pa[n], scratch.vented_Pa[n] = filled, vented
        scratch.swelled_Pa[n], scratch.start[n] = swelled, start
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
    scratch: Any,
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
    _simulate(gas, window, chamber, now, since, change, value, scratch, noise_Pa)
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
        verdict.growth_m3_Pa = _growth_m3_Pa(window, chamber)
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
