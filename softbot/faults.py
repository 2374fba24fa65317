"""The fault library: what can break in the plant, when, and how badly.

A `Fault` says that at `t_s` something happens to one chamber. `PlantConditions` holds what that does to the
plant at the present time: to its pneumatics (`PneumaticConditions`, read by `softbot.pneumatics`) and to
its pressure sensors. Nothing here is random: the same faults give the same conditions at the same time.

| kind            | what severity s in (0, 1] means                                             |
|-----------------|-----------------------------------------------------------------------------|
| `rupture`       | a tear to atmosphere: s x 10 times the conductance of the open supply valve |
| `leak`          | a hole to atmosphere: s times the conductance of the open supply valve      |
| `blocked_inlet` | the supply path keeps 1 - s of its conductance; venting is not touched      |
| `stuck_open`    | the valve stays s open towards the supply, whatever the command             |
| `stuck_closed`  | the valve stays shut, neither filling nor venting; s has no effect          |
| `sensor_offset` | the pressure sensor reads s x 50 kPa too high                               |
| `sensor_stuck`  | the pressure sensor repeats its last reading; s has no effect               |

A rupture of severity 1 passes ten times what the supply valve does: with the valve fully open the chamber
stays below 5 % of the supply's gauge pressure. With a leak of severity 1 a chamber still reaches its
working pressure, with the valve far open. Faults on one chamber combine: holes add, blockages multiply,
offsets add, and of two stuck valves the later one holds.

Leaves out: faults that heal, and faults of the common supply (`PneumaticConditions.supply_factor` is there
for whoever wants to switch it). Imports numpy only, so that reading a scene stays quick.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softbot.errors import InputError

CHAMBER_COUNT = 4

RUPTURE_CONDUCTANCE_RATIO = 10.0
"""Conductance of a rupture of severity 1 over that of the chamber's fully open supply valve."""
LEAK_CONDUCTANCE_RATIO = 1.0
"""Conductance of a leak of severity 1 over that of the chamber's fully open supply valve."""
SENSOR_OFFSET_Pa = 50e3
"""What a sensor offset of severity 1 adds to the reading."""

# Places in `PneumaticConditions.packed`, for the kernel: four chambers each, then one number for the supply.
LEAK_RATIO = 0
INLET_FACTOR = 4
EXHAUST_FACTOR = 8
FORCED_OPENING = 12
SUPPLY_FACTOR = 16
CONDITIONS_SIZE = 17


class FaultKind(StrEnum):
    """What breaks. The table at the head of this module says what severity means for each."""

    RUPTURE = "rupture"
    LEAK = "leak"
    BLOCKED_INLET = "blocked_inlet"
    STUCK_OPEN = "stuck_open"
    STUCK_CLOSED = "stuck_closed"
    SENSOR_OFFSET = "sensor_offset"
    SENSOR_STUCK = "sensor_stuck"


EMPTIES_CHAMBER = frozenset({FaultKind.RUPTURE, FaultKind.BLOCKED_INLET})
"""Faults after which a chamber cannot be filled, so that what it bends is lost."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that breaks at one time.

    t_s [s, >= 0], chamber (0...3), kind (`FaultKind` or its name), severity in (0, 1].
    Raises InputError naming the field whose value is out of range.
    """

    __pydantic_config__: ClassVar[dict[str, object]] = {"extra": "forbid"}  # as a table of a file

    t_s: float
    chamber: int
    kind: FaultKind
    severity: float = 1.0

    def __post_init__(self) -> None:
        if not (_is_number(self.t_s) and math.isfinite(self.t_s) and self.t_s >= 0):
            raise InputError(f"fault.t_s = {self.t_s!r}: must be a finite time in seconds, zero or later")
        if (
            isinstance(self.chamber, bool)
            or not isinstance(self.chamber, (int, np.integer))
            or not 0 <= self.chamber < CHAMBER_COUNT
        ):
            raise InputError(f"fault.chamber = {self.chamber!r}: must be a whole number from 0 to 3")
        try:
            object.__setattr__(self, "kind", FaultKind(self.kind))
        except ValueError:
            known = ", ".join(FaultKind)
            raise InputError(f"fault.kind = {self.kind!r}: must be one of {known}") from None
        if not (_is_number(self.severity) and 0 < self.severity <= 1):
            raise InputError(f"fault.severity = {self.severity!r}: must be above 0 and at most 1")


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def _healthy_packed() -> NDArray[np.float64]:
    packed = np.zeros(CONDITIONS_SIZE)
    packed[INLET_FACTOR : INLET_FACTOR + CHAMBER_COUNT] = 1.0
    packed[EXHAUST_FACTOR : EXHAUST_FACTOR + CHAMBER_COUNT] = 1.0
    packed[FORCED_OPENING : FORCED_OPENING + CHAMBER_COUNT] = np.nan
    packed[SUPPLY_FACTOR] = 1.0
    return packed


@dataclass(frozen=True, slots=True)
class PneumaticConditions:
    """What is wrong with the pneumatics now; `PneumaticConditions()` is a healthy plant.

    All numbers are relative to the valves, so they mean the same for a plant of any size. They live in one
    array, `packed` (float64[17], the kernel's argument); the properties are views into it, to be read and
    written in place.
    """

    packed: NDArray[np.float64] = field(default_factory=_healthy_packed)

    @property
    def leak_ratio(self) -> NDArray[np.float64]:
        """[4] conductance of the hole to atmosphere over that of the chamber's open supply valve; 0 is
        tight."""
        return self.packed[LEAK_RATIO : LEAK_RATIO + CHAMBER_COUNT]

    @property
    def inlet_factor(self) -> NDArray[np.float64]:
        """[4] what is left of the supply path's conductance, 0 (blocked) to 1 (free)."""
        return self.packed[INLET_FACTOR : INLET_FACTOR + CHAMBER_COUNT]

    @property
    def exhaust_factor(self) -> NDArray[np.float64]:
        """[4] what is left of the exhaust path's conductance, 0 (blocked) to 1 (free)."""
        return self.packed[EXHAUST_FACTOR : EXHAUST_FACTOR + CHAMBER_COUNT]

    @property
    def forced_opening(self) -> NDArray[np.float64]:
        """[4] opening in [-1, 1] at which the valve is stuck; NaN is a valve that obeys."""
        return self.packed[FORCED_OPENING : FORCED_OPENING + CHAMBER_COUNT]

    @property
    def supply_factor(self) -> float:
        """What is left of the regulator's conductance, 0 to 1."""
        return float(self.packed[SUPPLY_FACTOR])

    def set_supply_factor(self, factor: float) -> None:
        """Set what is left of the regulator's conductance. Raises InputError outside 0...1."""
        if not 0 <= factor <= 1:
            raise InputError(f"supply_factor = {factor!r}: must be from 0 to 1")
        self.packed[SUPPLY_FACTOR] = factor


class PlantConditions:
    """What is wrong with the plant now, given the faults of a scene.

    `faults`: any order. `pneumatic`: `PneumaticConditions`. `sensor_offset_Pa` [4] is added to the
    readings; `sensor_stuck` [4] are the sensors that repeat themselves. All healthy until `advance` has
    reached a fault.
    """

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        # sorted() is stable: faults of one time keep the order in which they were given.
        self.faults: tuple[Fault, ...] = tuple(sorted(faults, key=lambda fault: fault.t_s))
        self.pneumatic = PneumaticConditions()
        self.sensor_offset_Pa: NDArray[np.float64] = np.zeros(CHAMBER_COUNT)
        self.sensor_stuck: NDArray[np.bool_] = np.zeros(CHAMBER_COUNT, dtype=np.bool_)
        self._applied = 0
        self._t_s = -math.inf

    def advance(self, t_s: float) -> tuple[Fault, ...]:
        """Apply the faults due at or before `t_s` [s]; return those that are new since the last call.

        Raises InputError when time runs backwards: a fault that has happened stays.
        """
        if not t_s >= self._t_s:
            raise InputError(f"t_s = {t_s!r}: time must not run backwards (it was {self._t_s!r})")
        self._t_s = t_s
        first = self._applied
        while self._applied < len(self.faults) and self.faults[self._applied].t_s <= t_s:
            self._apply(self.faults[self._applied])
            self._applied += 1
        return self.faults[first : self._applied]

    @property
    def active(self) -> tuple[Fault, ...]:
        """The faults that have happened, earliest first."""
        return self.faults[: self._applied]

    def sensor_reading_Pa(self, true_Pa: ArrayLike, last_reading_Pa: ArrayLike) -> NDArray[np.float64]:
        """What the four pressure sensors say [Pa], given the true pressures [4] and their last readings
        [4]."""
        shown = np.asarray(true_Pa, dtype=np.float64) + self.sensor_offset_Pa
        return np.where(self.sensor_stuck, np.asarray(last_reading_Pa, dtype=np.float64), shown)

    def _apply(self, fault: Fault) -> None:
        i, s = fault.chamber, fault.severity
        match fault.kind:
            case FaultKind.RUPTURE:
                self.pneumatic.leak_ratio[i] += s * RUPTURE_CONDUCTANCE_RATIO
            case FaultKind.LEAK:
                self.pneumatic.leak_ratio[i] += s * LEAK_CONDUCTANCE_RATIO
            case FaultKind.BLOCKED_INLET:
                self.pneumatic.inlet_factor[i] *= 1.0 - s
            case FaultKind.STUCK_OPEN:
                self.pneumatic.forced_opening[i] = s
            case FaultKind.STUCK_CLOSED:
                self.pneumatic.forced_opening[i] = 0.0
            case FaultKind.SENSOR_OFFSET:
                self.sensor_offset_Pa[i] += s * SENSOR_OFFSET_Pa
            case FaultKind.SENSOR_STUCK:
                self.sensor_stuck[i] = True
