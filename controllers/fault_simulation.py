"""A chamber simulated over the last cycles as if one fault of the library had struck it.

It starts from what the filter believed at the onset, with the conductances that it had learnt of this very robot, under
the openings that were really commanded. The volumes that are believed come from the readings: where a kind says that
these are wrong, or that the chamber does not press on its wall, its simulation has other volumes.
"""

from __future__ import annotations

import math
from typing import Any

from controllers.chamber_gas import Gas, lagged_opening, next_pressure
from controllers.chamber_observer import HOLE, INLET, OUTLET, PRESSURE, between
from controllers.fault_candidates import Change, changed_ways
from controllers.fault_window import KEPT
from softbot.faults import BALLOON_LOSS, BALLOON_VOLUME_1_Pa
from softbot.kernel_compiler import part

SIMULATED_Pa = 350.0
"""Deviation of each simulated pressure by itself."""
FASTEST_SWELLING = 0.05
"""Of a volume, in one cycle."""
TIMING_KEPT = 0.9
"""Share of what a valve's moving may have made of the pressure that is still there a cycle later, squared."""
TIMING_KEPT = 0.9
"""Share of what a valve's moving may have made of the pressure that is still there a cycle later, squared."""
_FORCED, _LAG, _WIDENING = int(Change.FORCED), int(Change.LAG), int(Change.WIDENING)
_SCALE, _OFFSET, _DRIFT = int(Change.SCALE), int(Change.OFFSET), int(Change.DRIFT)


@part()
def _widened(gas: Gas, pressure: float, widening_1_Pa: float) -> float:
    """The absolute pressure of a chamber's gas after its wall has given way: p (1 + w (p − p_a)) = p before."""
    if pressure <= gas.atmosphere_Pa or widening_1_Pa <= 0.0:
        return pressure
    linear = 1.0 - widening_1_Pa * gas.atmosphere_Pa
    return (math.sqrt(linear * linear + 4.0 * widening_1_Pa * pressure) - linear) / (2.0 * widening_1_Pa)


@part()
def growth_in(window: Any, chamber: int) -> float:
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
def simulate(
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
