"""Linear viscoelasticity of the wall by a Prony series, as creep under a given load.

Quasi-linear: the elastic section force F(e) of the wall is followed by decaying overstresses, so that under a load q

    F + Σ h_k = q,   dh_k/dt + h_k/τ_k = γ_k dF/dt,   γ_k = g_k/(1 − Σ g)

with g_k the shares of the instantaneous modulus (relaxation G(t)/G(0) = 1 − Σ g_k (1 − e^{−t/τ_k})) and F the law of
slow loading. That is linear in F, whatever the wall: per chamber, with q a pressure p and y the pressure that the wall
feels,

    y = c₀ p + Σ c_k z_k,   θ_k dz_k/dt = p − z_k,   c₀ = 1 − Σ g

The c_k and θ_k (creep) follow from the g_k and τ_k (relaxation) by one symmetric eigenproblem. A step is exact for a
pressure that runs linearly over it, takes a time that does not depend on the past, and is a weighted mean of what was
and what is: it cannot overshoot, whatever the step. So is its inverse, the pressure for a wanted y.

Source: Y. C. Fung's quasi-linear viscoelasticity; the exponential integration after R. L. Taylor, K. S. Pister and
G. L. Goudreau (1970).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pydantic
from numpy.typing import ArrayLike, NDArray

from softbot.errors import InputError
from softbot.kernel_compiler import kernel, part

FloatArray = NDArray[np.float64]

MOST_TERMS = 8
SHARE_BOUND = 0.95
TIME_BOUNDS_S = (1e-4, 1e7)


@dataclass(frozen=True)
class PronySeries:
    """Relaxation of the wall: `shares` g_k of the instantaneous modulus that decay with `times_s` τ_k.

    Raises InputError unless there are as many shares as times (1 … 8), the shares are not negative and add up to at
    most 0.95, and the times are 1e-4 … 1e7 s.
    """

    __pydantic_config__: ClassVar[pydantic.ConfigDict] = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)

    shares: tuple[float, ...]
    times_s: tuple[float, ...]

    def __post_init__(self) -> None:
        if not 1 <= len(self.shares) == len(self.times_s) <= MOST_TERMS:
            raise InputError(
                f"memory.creep: shares and times_s have {len(self.shares)} and {len(self.times_s)} numbers: "
                f"give 1 to {MOST_TERMS} of each, one of each a term"
            )
        if not (all(0.0 <= share <= SHARE_BOUND for share in self.shares) and sum(self.shares) <= SHARE_BOUND):
            raise InputError(f"memory.creep.shares = {list(self.shares)}: each from 0, together at most {SHARE_BOUND}")
        low, high = TIME_BOUNDS_S
        if not all(low <= time <= high for time in self.times_s):
            raise InputError(f"memory.creep.times_s = {list(self.times_s)}: give {low:g} to {high:g} s each")

    @property
    def instantaneous_ratio(self) -> float:
        """Modulus of fast loading over that of slow loading."""
        return 1.0 / (1.0 - sum(self.shares))

    def relaxation(self, t_s: ArrayLike) -> FloatArray:
        """Load that holds a strain which is there from t = 0 on, over what holds it in the end, at times t_s ≥ 0."""
        t, rest = np.asarray(t_s, dtype=float), 1.0 - sum(self.shares)
        return np.asarray(
            1.0 + sum(g / rest * np.exp(-t / tau) for g, tau in zip(self.shares, self.times_s, strict=True))
        )

    def creep(self) -> tuple[float, FloatArray, FloatArray]:
        """c₀, the c_k and the θ_k [s] of the module's docstring; together c₀ + Σ c_k = 1, and every θ_k ≥ its τ_k."""
        rest = 1.0 - sum(self.shares)
        excess = np.array(self.shares) / rest
        rate = 1.0 / np.array(self.times_s)
        coupling = np.sqrt(excess * rate)
        eigenvalue, vector = np.linalg.eigh(np.diag(rate) - rest * np.outer(coupling, coupling))
        drive = rest * (vector.T @ coupling)
        return rest, drive**2 / eigenvalue, 1.0 / eigenvalue


@part()
def decay_and_mean(step_over_time: float) -> tuple[float, float]:
    """e^{−x} and (1 − e^{−x})/x at x = step/time ≥ 0: the weights of an exponential step over a linear run."""
    if step_over_time < 1e-8:
        return 1.0 - step_over_time, 1.0 - 0.5 * step_over_time
    gone = -math.expm1(-step_over_time)
    return 1.0 - gone, gone / step_over_time


@kernel()
def creep_step(
    instant: float, share: FloatArray, time_s: FloatArray, state: FloatArray, pressure_Pa: float, dt_s: float
) -> float:
    """The pressure that the wall feels at the end of a step in which the pressure runs linearly to `pressure_Pa`.

    `state`, shape (1 + terms,): the pressure before, and the z_k; moved on by dt_s ≥ 0 in place.
    """
    felt = instant * pressure_Pa
    before = state[0]
    for k in range(share.size):
        decay, mean = decay_and_mean(dt_s / time_s[k])
        state[1 + k] = decay * state[1 + k] + (mean - decay) * before + (1.0 - mean) * pressure_Pa
        felt += share[k] * state[1 + k]
    state[0] = pressure_Pa
    return felt


@kernel()
def creep_inverse(
    instant: float, share: FloatArray, time_s: FloatArray, state: FloatArray, felt_Pa: float, dt_s: float
) -> float:
    """The pressure at the end of a step with which `creep_step` gives `felt_Pa`; `state` is left as it is."""
    weight, known = instant, 0.0
    for k in range(share.size):
        decay, mean = decay_and_mean(dt_s / time_s[k])
        known += share[k] * (decay * state[1 + k] + (mean - decay) * state[0])
        weight += share[k] * (1.0 - mean)
    return (felt_Pa - known) / weight
