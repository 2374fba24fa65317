"""The memory of four chambers: the parts joined, streaming, with the inverse of those that can be undone.

`Memory.step` takes the sensors' pressures to the pressures that a wall without memory would have to be given for the
same effect (`softbot.actuator` takes it from there), `Memory.run` a whole recording; `Memory.inverse` finds the
pressures that have a wanted effect at the end of a step. A step costs the same whatever happened before, is stable for
any length, and allocates nothing in `advance`. A robot without memory has no `Memory`: nothing is computed for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pydantic
from numpy.typing import ArrayLike, NDArray

from softbot.cross_section import CHAMBERS
from softbot.errors import InputError
from softbot.kernel_compiler import kernel
from softbot.memory.hysteresis import MOST_PLAYS, Hysteresis, hysteresis_inverse, hysteresis_step
from softbot.memory.line import Line, line_step
from softbot.memory.prony import MOST_TERMS, PronySeries, creep_inverse, creep_step
from softbot.memory.residual import Residual, residual_inverse, residual_step

FloatArray = NDArray[np.float64]

STANDARD_ATMOSPHERE_Pa = 101325.0

# Places in the packed numbers: first how many of what, then the parameters of each part one after the other.
_LINE, _PLAYS, _CREEP, _RESIDUAL = 0, 1, 2, 3
_FILLING, _VENTING, _GROWTH, _CRITICAL_RATIO, _ATMOSPHERE = 4, 8, 12, 13, 14
_SLOPE, _SHARE, _INSTANT = 15, 16, 17
_RESIDUAL_SHARE, _GROWTH_TIME, _RECOVERY_TIME = 18, 19, 20
_LISTS = 21  # thresholds, weights, creep shares, creep times
# Places in the state of a chamber: what the line has let through, r of the residual, the creep's last pressure and its
# z_k, the plays.
_LINE_STATE, _RESIDUE, _CREEP_STATE = 0, 1, 2
STATE_MOST = _CREEP_STATE + 1 + MOST_TERMS + MOST_PLAYS
"""Numbers a chamber of the largest state; a state may be longer than its memory needs."""


@dataclass(frozen=True)
class MemoryParts:
    """The parts that a robot has; None: off. The `[memory]` table of a robot file."""

    __pydantic_config__: ClassVar[pydantic.ConfigDict] = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)

    line: Line | None = None
    hysteresis: Hysteresis | None = None
    creep: PronySeries | None = None
    residual: Residual | None = None

    @property
    def on(self) -> bool:
        """Whether there is any part at all."""
        return any(part is not None for part in (self.line, self.hysteresis, self.creep, self.residual))


class Memory:
    """Memory of four chambers.

    volume_m3: of the chambers at rest, shape (4,), looked at only where there is a line. atmosphere_Pa: absolute.
    Raises InputError for volumes that are not above zero.
    """

    def __init__(
        self,
        parts: MemoryParts,
        volume_m3: ArrayLike | None = None,
        atmosphere_Pa: float = STANDARD_ATMOSPHERE_Pa,
    ) -> None:
        self.parts = parts
        self.numbers: FloatArray = _packed(parts, volume_m3, atmosphere_Pa)
        self.behind_lines: FloatArray = self.numbers.copy()
        """The same for pressures at the chambers themselves."""
        self.behind_lines[_LINE] = 0.0

    def rest(self, pressure_Pa: ArrayLike = (0.0, 0.0, 0.0, 0.0)) -> FloatArray:
        """State of chambers that were new, loaded once to these pressures, shape (4,) [Pa], and held there for long."""
        pressure = _four(pressure_Pa)
        state = new_state(self.numbers)
        _settle(self.numbers, state, pressure)
        return state

    def step(self, state: FloatArray, pressure_Pa: ArrayLike, dt_s: float) -> tuple[FloatArray, FloatArray]:
        """State and felt pressures, shape (4,) [Pa], after a step of dt_s ≥ 0 to these sensor pressures, shape (4,).

        `state` is left as it is. In a hot loop call `advance`. Raises InputError for what is not finite.
        """
        moved, felt = state.copy(), np.empty(CHAMBERS)
        advance(self.numbers, moved, _four(pressure_Pa), _duration(dt_s), felt)
        return moved, felt

    def run(self, t_s: ArrayLike, pressure_Pa: ArrayLike, start: FloatArray | None = None) -> FloatArray:
        """Felt pressures, shape (n, 4) [Pa], of a recording: times, shape (n,), not falling, and pressures, (n, 4).

        start: state at the first row (default: `rest` at the first row's pressures). Raises InputError for times that
        fall and numbers that are not finite.
        """
        t = np.ascontiguousarray(t_s, dtype=float)
        pressure = np.ascontiguousarray(pressure_Pa, dtype=float)
        if t.ndim != 1 or pressure.shape != (t.size, CHAMBERS) or not t.size:
            raise InputError(f"t_s {t.shape} and pressure_Pa {pressure.shape}: give shapes (n,) and (n, {CHAMBERS})")
        if not (np.all(np.isfinite(t)) and np.all(np.isfinite(pressure))):
            raise InputError("t_s and pressure_Pa: give finite numbers only; leave rows without them out")
        step_s = np.diff(t, prepend=t[0])
        if np.any(step_s < 0.0):
            raise InputError(f"t_s: falls at row {int(np.argmax(step_s < 0.0))}; sort the rows by time")
        state = self.rest(pressure[0]) if start is None else start.copy()
        felt = np.empty_like(pressure)
        _run(self.numbers, state, pressure, step_s, felt)
        return felt

    def felt_at(self, state: FloatArray, chamber_Pa: ArrayLike, dt_s: float) -> FloatArray:
        """Pressures felt, shape (4,) [Pa], if the chambers themselves, behind their lines, came to these in a step.

        `state` is left as it is. `inverse` undoes this.
        """
        felt = np.empty(CHAMBERS)
        advance(self.behind_lines, state.copy(), _four(chamber_Pa), _duration(dt_s), felt)
        return felt

    def inverse(self, state: FloatArray, felt_Pa: ArrayLike, dt_s: float) -> FloatArray:
        """Pressures at the chambers, shape (4,) [Pa], with which a step of dt_s ≥ 0 from `state` has a wanted effect.

        Exact for hysteresis, creep and residual; the line is not undone (that would take jumps of pressure without
        limit), so it has to have let the pressure through. What the valves cannot give is for the caller to limit,
        and `step` then says what it does. Raises InputError for what is not finite.
        """
        pressure = np.empty(CHAMBERS)
        undo(self.numbers, state, _four(felt_Pa), _duration(dt_s), pressure)
        return pressure


def _packed(parts: MemoryParts, volume_m3: ArrayLike | None, atmosphere_Pa: float) -> FloatArray:
    numbers = np.zeros(_LISTS)
    lists: list[ArrayLike] = []
    if parts.line is not None:
        volume = np.asarray(volume_m3 if volume_m3 is not None else (), dtype=float)
        if volume.shape != (CHAMBERS,) or not np.all(volume > 0.0) or not np.all(np.isfinite(volume)):
            raise InputError(f"volume_m3 = {volume.tolist()}: a line needs {CHAMBERS} chamber volumes above zero")
        rates = np.array([parts.line.rates(float(one)) for one in volume])
        numbers[_LINE] = 1.0
        numbers[_FILLING : _FILLING + CHAMBERS], numbers[_VENTING : _VENTING + CHAMBERS] = rates.T
        numbers[_GROWTH], numbers[_CRITICAL_RATIO] = parts.line.growth_1_Pa, parts.line.critical_ratio
        numbers[_ATMOSPHERE] = atmosphere_Pa
    if parts.hysteresis is not None:
        numbers[_PLAYS] = len(parts.hysteresis.weights)
        numbers[_SLOPE], numbers[_SHARE] = parts.hysteresis.unloading_slope, parts.hysteresis.unloading_share
        lists += [parts.hysteresis.thresholds_Pa, parts.hysteresis.weights]
    if parts.creep is not None:
        instant, shares, times_s = parts.creep.creep()
        numbers[_CREEP], numbers[_INSTANT] = len(shares), instant
        lists += [shares, times_s]
    if parts.residual is not None:
        numbers[_RESIDUAL], numbers[_RESIDUAL_SHARE] = 1.0, parts.residual.share
        numbers[_GROWTH_TIME], numbers[_RECOVERY_TIME] = parts.residual.growth_time_s, parts.residual.recovery_time_s
    return np.concatenate([numbers, *[np.asarray(one, dtype=float) for one in lists]])


def _four(values: ArrayLike) -> FloatArray:
    array = np.ascontiguousarray(values, dtype=float)
    if array.shape != (CHAMBERS,) or not np.all(np.isfinite(array)):
        raise InputError(f"pressures {array.tolist()!r}: give {CHAMBERS} finite numbers, one a chamber")
    return array


def _duration(dt_s: float) -> float:
    if not 0.0 <= dt_s < np.inf:
        raise InputError(f"dt_s = {dt_s!r}: give a step of zero or more seconds")
    return float(dt_s)


@kernel()
def new_state(numbers: FloatArray) -> FloatArray:
    """State of chambers that never held pressure, shape (4, size)."""
    return np.zeros((CHAMBERS, _CREEP_STATE + 1 + int(numbers[_CREEP]) + int(numbers[_PLAYS])))


@kernel()
def _settle(numbers: FloatArray, state: FloatArray, pressure_Pa: FloatArray) -> None:
    plays, terms = int(numbers[_PLAYS]), int(numbers[_CREEP])
    threshold, weight = numbers[_LISTS : _LISTS + plays], numbers[_LISTS + plays : _LISTS + 2 * plays]
    for i in range(CHAMBERS):
        felt = pressure_Pa[i]
        state[i, _LINE_STATE] = felt
        if plays:
            play = state[i, _CREEP_STATE + 1 + terms :]
            felt = hysteresis_step(threshold, weight, numbers[_SLOPE], numbers[_SHARE], play, felt)
        state[i, _CREEP_STATE : _CREEP_STATE + 1 + terms] = felt
        state[i, _RESIDUE] = numbers[_RESIDUAL_SHARE] * felt


@kernel()
def advance(numbers: FloatArray, state: FloatArray, pressure_Pa: FloatArray, dt_s: float, felt_Pa: FloatArray) -> None:
    """One step of four chambers over plain arrays, in place: the kernel behind `Memory.step`; checks nothing.

    numbers: `Memory.numbers`; state: shape (4, size); pressure_Pa: at the sensors at the step's end, and felt_Pa,
    written, shape (4,).
    """
    plays, terms = int(numbers[_PLAYS]), int(numbers[_CREEP])
    ends = _LISTS + 2 * plays
    threshold, weight = numbers[_LISTS : _LISTS + plays], numbers[_LISTS + plays : ends]
    share, time_s = numbers[ends : ends + terms], numbers[ends + terms : ends + 2 * terms]
    for i in range(CHAMBERS):
        felt = pressure_Pa[i]
        if numbers[_LINE] > 0.0:
            felt = line_step(
                numbers[_FILLING + i],
                numbers[_VENTING + i],
                numbers[_GROWTH],
                numbers[_CRITICAL_RATIO],
                numbers[_ATMOSPHERE],
                state[i, _LINE_STATE],
                felt,
                dt_s,
            )
            state[i, _LINE_STATE] = felt
        if plays:
            play = state[i, _CREEP_STATE + 1 + terms :]
            felt = hysteresis_step(threshold, weight, numbers[_SLOPE], numbers[_SHARE], play, felt)
        if terms:
            creep = state[i, _CREEP_STATE : _CREEP_STATE + 1 + terms]
            felt = creep_step(numbers[_INSTANT], share, time_s, creep, felt, dt_s)
        if numbers[_RESIDUAL] > 0.0:
            residue = residual_step(
                numbers[_RESIDUAL_SHARE],
                numbers[_GROWTH_TIME],
                numbers[_RECOVERY_TIME],
                state[i, _RESIDUE],
                felt,
                dt_s,
            )
            state[i, _RESIDUE] = residue
            felt = (1.0 - numbers[_RESIDUAL_SHARE]) * felt + residue
        felt_Pa[i] = felt


@kernel()
def _run(
    numbers: FloatArray, state: FloatArray, pressure_Pa: FloatArray, step_s: FloatArray, felt_Pa: FloatArray
) -> None:
    for n in range(step_s.size):
        advance(numbers, state, pressure_Pa[n], step_s[n], felt_Pa[n])


@kernel()
def undo(numbers: FloatArray, state: FloatArray, felt_Pa: FloatArray, dt_s: float, pressure_Pa: FloatArray) -> None:
    """The kernel behind `Memory.inverse`: pressures (4,), written, with which a step makes `felt_Pa` (4,) felt."""
    plays, terms = int(numbers[_PLAYS]), int(numbers[_CREEP])
    ends = _LISTS + 2 * plays
    threshold, weight = numbers[_LISTS : _LISTS + plays], numbers[_LISTS + plays : ends]
    share, time_s = numbers[ends : ends + terms], numbers[ends + terms : ends + 2 * terms]
    for i in range(CHAMBERS):
        wanted = felt_Pa[i]
        if numbers[_RESIDUAL] > 0.0:
            wanted = residual_inverse(
                numbers[_RESIDUAL_SHARE],
                numbers[_GROWTH_TIME],
                numbers[_RECOVERY_TIME],
                state[i, _RESIDUE],
                wanted,
                dt_s,
            )
        if terms:
            creep = state[i, _CREEP_STATE : _CREEP_STATE + 1 + terms]
            wanted = creep_inverse(numbers[_INSTANT], share, time_s, creep, wanted, dt_s)
        if plays:
            play = state[i, _CREEP_STATE + 1 + terms :]
            wanted = hysteresis_inverse(threshold, weight, numbers[_SLOPE], numbers[_SHARE], play, wanted)
        pressure_Pa[i] = wanted
