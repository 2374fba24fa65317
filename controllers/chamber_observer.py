"""One chamber watched: an extended Kalman filter of its pressure, its sensor's offset and its three conductances.

State (P, d, a, b, l): absolute pressure, offset of the sensor, conductance of the supply path, of the exhaust path
(both over the nominal ones) and of a hole (over that of the supply valve). The last four are nearly constant: what a
robot differs from its file by is learnt within its first revolutions and followed as it drifts. The innovation over its
own deviation, which holds sensor noise, what is not yet known of the parameters and what the model cannot know, is what
a detector tests.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.chamber_gas import Gas, next_pressure
from softbot.kernel_compiler import kernel, part

FloatArray = NDArray[np.float64]

STATES = 5
PRESSURE, OFFSET, INLET, OUTLET, HOLE = range(STATES)

PRIOR_OFFSET_Pa, PRIOR_RATIO, PRIOR_HOLE = 400.0, 0.25, 0.004
"""Deviations of what a healthy robot may differ from its file by."""
OFFSET_DRIFT_Pa, RATIO_DRIFT, HOLE_DRIFT = 1.5, 6e-4, 6e-5
"""Deviation of the change of each in one control period."""
MODEL_ERROR, SWELLING_ERROR, LEAST_ERROR_Pa = 0.06, 0.4, 60.0
"""Of the pressure's change in one period: share of what flowed, of what swelling did, and what is always there."""
SWELLING_LASTS = 15.0
"""Cycles over which the error of swelling is the same: so much the less a chamber that swells teaches of its valves."""
EMPTY_Pa = 5e3
"""Gauge pressure up to which a chamber breathes as its volume changes; that does not tell how wide its exhaust is."""
INLET_RANGE, HOLE_RANGE = (0.3, 2.0), (-0.02, 0.5)

LEAST_MOVE = 0.01
"""Of a valve within a period, from which it matters when in the period it moved."""

OBSERVER = np.dtype(
    [
        ("x", np.float64, STATES),
        ("covariance", np.float64, (STATES, STATES)),
        ("innovation_Pa", np.float64),
        ("deviation_Pa", np.float64),
        ("predicted_Pa", np.float64),
        ("timing_Pa", np.float64),
        ("slope", np.float64, STATES),
        ("scratch", np.float64, (STATES, STATES)),
    ],
    align=True,
)
"""A chamber's filter, as a record. `predicted_Pa`: the reading that it expected, gauge; `timing_Pa`: what a valve that
moved within the period may have made of it, one way or the other."""


@part()
def between(mean: float, at_end: float) -> float:
    """The opening to reckon with over a period in which a valve moved; which part of it acts, is not known."""
    return 0.5 * (mean + at_end)


@part()
def begin_observing(own: Any, gas: Gas, reading_Pa: float, noise_Pa: float) -> None:
    """Start anew from a reading, with all that is known of the parameters."""
    for i in range(STATES):
        for j in range(STATES):
            own.covariance[i, j] = 0.0
    own.x[PRESSURE] = reading_Pa + gas.atmosphere_Pa
    own.x[OFFSET] = own.x[HOLE] = 0.0
    own.x[INLET] = own.x[OUTLET] = 1.0
    own.covariance[PRESSURE, PRESSURE] = noise_Pa * noise_Pa + PRIOR_OFFSET_Pa**2
    own.covariance[PRESSURE, OFFSET] = own.covariance[OFFSET, PRESSURE] = -(PRIOR_OFFSET_Pa**2)
    own.covariance[OFFSET, OFFSET] = PRIOR_OFFSET_Pa**2
    own.covariance[INLET, INLET] = own.covariance[OUTLET, OUTLET] = PRIOR_RATIO**2
    own.covariance[HOLE, HOLE] = PRIOR_HOLE**2
    own.innovation_Pa, own.deviation_Pa = 0.0, noise_Pa


@kernel(cache=False)
def resume_observing(own: Any, gas: Gas, reading_Pa: float, noise_Pa: float) -> None:
    """Take a reading for the pressure, after an interval of which nothing is known; what was learnt is kept."""
    offset_Pa2 = own.covariance[OFFSET, OFFSET]
    own.x[PRESSURE] = max(reading_Pa - own.x[OFFSET] + gas.atmosphere_Pa, 0.2 * gas.atmosphere_Pa)
    for i in range(1, STATES):
        own.covariance[PRESSURE, i] = own.covariance[i, PRESSURE] = 0.0
        if i != OFFSET:
            own.covariance[OFFSET, i] = own.covariance[i, OFFSET] = 0.0
    own.covariance[PRESSURE, PRESSURE] = noise_Pa * noise_Pa + offset_Pa2
    own.covariance[PRESSURE, OFFSET] = own.covariance[OFFSET, PRESSURE] = -offset_Pa2
    own.innovation_Pa, own.deviation_Pa = 0.0, noise_Pa


@kernel(cache=False)
def observe(
    own: Any,
    gas: Gas,
    chamber: int,
    reading_Pa: float,
    noise_Pa: float,
    supply: float,
    opening: float,
    opening_at_end: float,
    volume_m3: float,
    swelling: float,
    step_s: float,
    timing: float,
    learns: bool,
) -> None:
    """One step of the filter: predict, compare, correct. Where it must not learn, only the pressure is corrected.

    opening: mean over the step. timing: share of the step by which it may have been longer or shorter than its stamps
    say.
    """
    x, covariance, slope = own.x, own.covariance, own.slope
    own.timing_Pa = 0.0
    if abs(opening_at_end - opening) > LEAST_MOVE:
        early = next_pressure(
            gas, chamber, x[PRESSURE], supply, opening_at_end, volume_m3, swelling, x[INLET], x[OUTLET], x[HOLE], step_s
        )
        late = next_pressure(
            gas, chamber, x[PRESSURE], supply, opening, volume_m3, swelling, x[INLET], x[OUTLET], x[HOLE], step_s
        )
        own.timing_Pa = 0.5 * abs(early[0] - late[0])
    opening = between(opening, opening_at_end)
    after, kept, by_inlet, by_outlet, by_hole, flowed = next_pressure(
        gas, chamber, x[PRESSURE], supply, opening, volume_m3, swelling, x[INLET], x[OUTLET], x[HOLE], step_s
    )
    if x[PRESSURE] < gas.atmosphere_Pa + EMPTY_Pa:
        by_outlet = by_hole = 0.0
    slope[PRESSURE], slope[OFFSET], slope[INLET], slope[OUTLET], slope[HOLE] = kept, 0.0, by_inlet, by_outlet, by_hole
    # only the pressure moves: the first row and column of the covariance
    for j in range(STATES):
        total = 0.0
        for i in range(STATES):
            total += slope[i] * covariance[i, j]
        own.scratch[0, j] = total
    corner = 0.0
    for j in range(STATES):
        corner += own.scratch[0, j] * slope[j]
    for j in range(1, STATES):
        covariance[0, j] = covariance[j, 0] = own.scratch[0, j]
    swelled = x[PRESSURE] * swelling
    error_Pa2 = (
        ((MODEL_ERROR + timing) * flowed) ** 2 + (SWELLING_ERROR * swelled) ** 2 + LEAST_ERROR_Pa**2 + own.timing_Pa**2
    )
    covariance[0, 0] = corner + error_Pa2
    x[PRESSURE] = after
    if learns:
        covariance[OFFSET, OFFSET] = min(covariance[OFFSET, OFFSET] + OFFSET_DRIFT_Pa**2, PRIOR_OFFSET_Pa**2)
        covariance[INLET, INLET] = min(covariance[INLET, INLET] + RATIO_DRIFT**2, PRIOR_RATIO**2)
        covariance[OUTLET, OUTLET] = min(covariance[OUTLET, OUTLET] + RATIO_DRIFT**2, PRIOR_RATIO**2)
        covariance[HOLE, HOLE] = min(covariance[HOLE, HOLE] + HOLE_DRIFT**2, PRIOR_HOLE**2)
    own.predicted_Pa = after - gas.atmosphere_Pa + x[OFFSET]
    innovation = reading_Pa - own.predicted_Pa
    variance = covariance[0, 0] + 2.0 * covariance[0, OFFSET] + covariance[OFFSET, OFFSET] + noise_Pa * noise_Pa
    own.innovation_Pa, own.deviation_Pa = innovation, math.sqrt(max(variance, 1.0))
    limited = min(max(innovation, -4.0 * own.deviation_Pa), 4.0 * own.deviation_Pa)  # one wild reading teaches little
    lasting = variance + SWELLING_LASTS * (SWELLING_ERROR * swelled) ** 2
    for i in range(STATES):
        own.scratch[1, i] = covariance[0, i] + covariance[OFFSET, i]
    for i in range(STATES):
        if i == 0 or learns:
            x[i] += own.scratch[1, i] / (variance if i == 0 else lasting) * limited
            for j in range(STATES):
                spread = variance if i == 0 or j == 0 else lasting
                covariance[i, j] -= own.scratch[1, i] * own.scratch[1, j] / spread
                if not learns:
                    covariance[j, i] = covariance[i, j]
    x[PRESSURE] = max(x[PRESSURE], 0.2 * gas.atmosphere_Pa)
    x[INLET] = min(max(x[INLET], INLET_RANGE[0]), INLET_RANGE[1])
    x[OUTLET] = min(max(x[OUTLET], INLET_RANGE[0]), INLET_RANGE[1])
    x[HOLE] = min(max(x[HOLE], HOLE_RANGE[0]), HOLE_RANGE[1])
    for i in range(STATES):  # round-off must not make it unsymmetric or negative
        covariance[i, i] = max(covariance[i, i], 1e-12)
        for j in range(i):
            covariance[i, j] = covariance[j, i] = 0.5 * (covariance[i, j] + covariance[j, i])
