"""The fault library: what can break in the plant, when, and how badly.

A `Fault` says that from `t_s` on something happens to one chamber, or to what all share. It grows to its severity over
`ramp_s`; an intermittent one is there for the first `duty` of every `period_s`. `softbot.plant_conditions` turns the
faults of a scene into what the plant is like at a time. Nothing here is random: the same faults give the same plant.

| kind              | what severity s in (0, 1] means                                                        |
|-------------------|----------------------------------------------------------------------------------------|
| `rupture`         | a tear to atmosphere: s x 10 times the conductance of the open supply valve            |
| `leak`            | a hole to atmosphere: s times the conductance of the open supply valve                 |
| `blocked_inlet`   | the supply path keeps 1 - s of its conductance; venting is not touched                 |
| `blocked_exhaust` | the exhaust path keeps 1 - s of its conductance; filling is not touched                |
| `kinked_line`     | the line to the chamber keeps 1 - s of its conductance, both ways                      |
| `stuck_open`      | the valve stays s open towards the supply, whatever the command                        |
| `stuck_closed`    | the valve stays shut, neither filling nor venting; s has no effect                     |
| `valve_slow`      | the valve's lag is 1 + 30 s times as long                                              |
| `supply_sag`      | the regulator holds 1 - s of its gauge pressure                                        |
| `supply_loss`     | the regulator keeps 1 - s of its conductance; at s = 1 nothing comes                   |
| `sensor_offset`   | the pressure sensor reads s x 50 kPa too high                                          |
| `sensor_drift`    | the pressure sensor reads too high by s x 2 kPa for each second, up to 50 kPa          |
| `sensor_noise`    | white noise of s x 20 kPa on the pressure sensor                                       |
| `sensor_stuck`    | the pressure sensor repeats its last reading; s has no effect                          |
| `sensor_dropout`  | the pressure sensor's wire is broken: it reads the bottom of its range; s has no effect |
| `sensor_scale`    | the pressure sensor reads s x 50 % too low                                             |
| `lines_swapped`   | the sensors of this chamber and the next one are exchanged; s has no effect            |
| `imu_bias`        | the gyro's axial rate reads s x 0.5 rad/s too high                                     |
| `imu_stuck`       | the inertial unit repeats its last reading; s has no effect                            |
| `imu_dropout`     | the inertial unit reads zero; s has no effect                                          |
| `wall_softening`  | fatigue: the wall around the chamber keeps 1 - s/2 of its modulus                      |
| `ballooning`      | a lost fibre: the chamber widens, by s of its volume at 100 kPa, and loads the wall    |
|                   | with 1 - 0.7 s of its force                                                            |
| `friction_lost`   | the floor keeps 1 - s of its friction                                                  |
| `friction_high`   | the floor has 1 + 4 s times its friction                                               |
| `payload`         | a weight of s times the robot's own rests on it, along its length, without inertia     |
| `obstacle`        | a kerb of s times the robot's radius across its way, a radius ahead of it; it stays    |

A rupture of severity 1 passes ten times what the supply valve does: with the valve fully open the chamber
stays below 5 % of the supply's gauge pressure. With a leak of severity 1 a chamber still reaches its
working pressure, with the valve far open. Faults on one chamber combine: holes add, blockages multiply,
offsets add, and of two stuck valves the later one holds.

Imports numpy only, so that reading a scene stays quick.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from softbot.errors import InputError

CHAMBER_COUNT = 4
NO_CHAMBER = -1
"""Stands for the chamber of a fault that is not one chamber's, wherever a number has to."""

RUPTURE_CONDUCTANCE_RATIO = 10.0
"""Conductance of a rupture of severity 1 over that of the chamber's fully open supply valve."""
LEAK_CONDUCTANCE_RATIO = 1.0
"""Conductance of a leak of severity 1 over that of the chamber's fully open supply valve."""
VALVE_SLOWNESS = 30.0
"""What a slow valve of severity 1 adds to its lag, over the lag."""
SENSOR_OFFSET_Pa = 50e3
"""What a sensor offset of severity 1 adds to the reading, and what a drift of any severity ends at."""
SENSOR_DRIFT_Pa_s = 2e3
"""Rate of a sensor drift of severity 1."""
SENSOR_NOISE_Pa = 20e3
"""Standard deviation of the noise of severity 1."""
SENSOR_SCALE_LOSS = 0.5
"""Share of the pressure that a wrong scale of severity 1 does not show."""
SENSOR_FLOOR_Pa = -10e3
"""What a pressure sensor with a broken wire reads: the bottom of its range."""
IMU_BIAS_rad_s = 0.5
"""What a gyro bias of severity 1 adds to the axial rate."""
WALL_SOFTENING = 0.5
"""Share of the modulus that a softening of severity 1 takes."""
BALLOON_VOLUME_1_Pa = 1.0 / 100e3
"""Widening of a ballooning chamber of severity 1, over its volume and its pressure."""
BALLOON_LOSS = 0.7
"""Share of its load on the wall that a ballooning chamber of severity 1 loses."""
FRICTION_GAIN = 4.0
"""What a friction too high of severity 1 adds, over the friction."""


class FaultKind(StrEnum):
    """What breaks. The table at the head of this module says what severity means for each."""

    RUPTURE = "rupture"
    LEAK = "leak"
    BLOCKED_INLET = "blocked_inlet"
    STUCK_OPEN = "stuck_open"
    STUCK_CLOSED = "stuck_closed"
    SENSOR_OFFSET = "sensor_offset"
    SENSOR_STUCK = "sensor_stuck"
    BLOCKED_EXHAUST = "blocked_exhaust"
    KINKED_LINE = "kinked_line"
    VALVE_SLOW = "valve_slow"
    SUPPLY_SAG = "supply_sag"
    SUPPLY_LOSS = "supply_loss"
    SENSOR_DRIFT = "sensor_drift"
    SENSOR_NOISE = "sensor_noise"
    SENSOR_DROPOUT = "sensor_dropout"
    SENSOR_SCALE = "sensor_scale"
    LINES_SWAPPED = "lines_swapped"
    IMU_BIAS = "imu_bias"
    IMU_STUCK = "imu_stuck"
    IMU_DROPOUT = "imu_dropout"
    WALL_SOFTENING = "wall_softening"
    BALLOONING = "ballooning"
    FRICTION_LOST = "friction_lost"
    FRICTION_HIGH = "friction_high"
    PAYLOAD = "payload"
    OBSTACLE = "obstacle"


KIND_CODES: dict[FaultKind, int] = {kind: code for code, kind in enumerate(FaultKind, start=1)}
"""Numbers of the kinds, for compiled code; 0 is no fault."""
KINDS: tuple[FaultKind, ...] = tuple(FaultKind)
"""Kinds by number: KINDS[code - 1]."""

SHARED_KINDS = frozenset(
    {
        FaultKind.SUPPLY_SAG,
        FaultKind.SUPPLY_LOSS,
        FaultKind.IMU_BIAS,
        FaultKind.IMU_STUCK,
        FaultKind.IMU_DROPOUT,
        FaultKind.FRICTION_LOST,
        FaultKind.FRICTION_HIGH,
        FaultKind.PAYLOAD,
        FaultKind.OBSTACLE,
    }
)
"""Faults of what the chambers share: they name no chamber."""
EMPTIES_CHAMBER = frozenset({FaultKind.RUPTURE, FaultKind.BLOCKED_INLET})
"""Faults after which a chamber cannot be filled, so that what it bends is lost."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that breaks at one time.

    t_s [s, >= 0], chamber (0...3; None for what the chambers share), kind (`FaultKind` or its name), severity in
    (0, 1], ramp_s [s, >= 0] from nothing to the full severity, period_s [s, > 0] of an intermittent fault (None: it
    stays) and duty in (0, 1], the share of each period for which it is there.
    Raises InputError naming the field whose value is out of range.
    """

    __pydantic_config__: ClassVar[dict[str, object]] = {"extra": "forbid"}  # as a table of a file

    t_s: float
    chamber: int | None = None
    kind: FaultKind | None = None
    severity: float = 1.0
    ramp_s: float = 0.0
    period_s: float | None = None
    duty: float = 0.5

    def __post_init__(self) -> None:
        if not (_is_number(self.t_s) and math.isfinite(self.t_s) and self.t_s >= 0):
            raise InputError(f"fault.t_s = {self.t_s!r}: must be a finite time in seconds, zero or later")
        if self.chamber is not None and (
            isinstance(self.chamber, bool)
            or not isinstance(self.chamber, (int, np.integer))
            or not 0 <= self.chamber < CHAMBER_COUNT
        ):
            raise InputError(f"fault.chamber = {self.chamber!r}: must be a whole number from 0 to 3")
        known = ", ".join(FaultKind)
        if self.kind is None:
            raise InputError(f"fault.kind: missing; must be one of {known}")
        try:
            object.__setattr__(self, "kind", FaultKind(self.kind))
        except ValueError:
            raise InputError(f"fault.kind = {self.kind!r}: must be one of {known}") from None
        if self.kind in SHARED_KINDS and self.chamber is not None:
            raise InputError(f"fault.chamber = {self.chamber!r}: {self.kind} concerns all chambers; leave chamber out")
        if self.kind not in SHARED_KINDS and self.chamber is None:
            raise InputError(f"fault.chamber: missing; {self.kind} is one chamber's, from 0 to 3")
        if not (_is_number(self.severity) and 0 < self.severity <= 1):
            raise InputError(f"fault.severity = {self.severity!r}: must be above 0 and at most 1")
        if not (_is_number(self.ramp_s) and math.isfinite(self.ramp_s) and self.ramp_s >= 0):
            raise InputError(f"fault.ramp_s = {self.ramp_s!r}: must be a finite time in seconds, zero or more")
        if self.period_s is not None and not (
            _is_number(self.period_s) and math.isfinite(self.period_s) and self.period_s > 0
        ):
            raise InputError(f"fault.period_s = {self.period_s!r}: must be a finite time in seconds, above zero")
        if not (_is_number(self.duty) and 0 < self.duty <= 1):
            raise InputError(f"fault.duty = {self.duty!r}: must be above 0 and at most 1")

    @property
    def chamber_number(self) -> int:
        """The chamber, or NO_CHAMBER."""
        return NO_CHAMBER if self.chamber is None else int(self.chamber)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


class FaultTimeline:
    """Faults by the time at which they strike, and how many of them have; given in any order."""

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        # sorted() is stable: faults of one time keep the order in which they were given.
        self.faults: tuple[Fault, ...] = tuple(sorted(faults, key=lambda fault: fault.t_s))
        self._struck = 0
        self._t_s = -math.inf

    def note(self, t_s: float) -> tuple[Fault, ...]:
        """The faults that are new at `t_s` [s]. Raises InputError when time runs backwards."""
        if not t_s >= self._t_s:
            raise InputError(f"t_s = {t_s!r}: time must not run backwards (it was {self._t_s!r})")
        self._t_s = t_s
        first = self._struck
        while self._struck < len(self.faults) and self.faults[self._struck].t_s <= t_s:
            self._struck += 1
        return self.faults[first : self._struck]

    @property
    def active(self) -> tuple[Fault, ...]:
        """The faults that have struck, earliest first."""
        return self.faults[: self._struck]


# Places in `PneumaticConditions.packed`, for the kernels: four chambers each, but for the two numbers of the supply.
LEAK_RATIO = 0
INLET_FACTOR = 4
EXHAUST_FACTOR = 8
FORCED_OPENING = 12
LAG_FACTOR = 16
VOLUME_FACTOR = 20
SUPPLY_FACTOR = 24
SUPPLY_PRESSURE_FACTOR = 25
WIDENING_1_Pa = 26
CONDITIONS_SIZE = 30


def _healthy_packed() -> NDArray[np.float64]:
    packed = np.zeros(CONDITIONS_SIZE)
    for first in (INLET_FACTOR, EXHAUST_FACTOR, LAG_FACTOR, VOLUME_FACTOR):
        packed[first : first + CHAMBER_COUNT] = 1.0
    packed[FORCED_OPENING : FORCED_OPENING + CHAMBER_COUNT] = np.nan
    packed[SUPPLY_FACTOR] = packed[SUPPLY_PRESSURE_FACTOR] = 1.0
    return packed


@dataclass(frozen=True, slots=True)
class PneumaticConditions:
    """What is wrong with the pneumatics now; `PneumaticConditions()` is a healthy plant.

    All numbers are relative to the valves, so they mean the same for a plant of any size. They live in one
    array, `packed` (float64[30], the kernel's argument); the properties are views into it, to be read and
    written in place.
    """

    packed: NDArray[np.float64] = field(default_factory=_healthy_packed)

    def _four(self, first: int) -> NDArray[np.float64]:
        return self.packed[first : first + CHAMBER_COUNT]

    @property
    def leak_ratio(self) -> NDArray[np.float64]:
        """[4] conductance of the hole to atmosphere over that of the chamber's open supply valve; 0 is
        tight."""
        return self._four(LEAK_RATIO)

    @property
    def inlet_factor(self) -> NDArray[np.float64]:
        """[4] what is left of the supply path's conductance, 0 (blocked) to 1 (free)."""
        return self._four(INLET_FACTOR)

    @property
    def exhaust_factor(self) -> NDArray[np.float64]:
        """[4] what is left of the exhaust path's conductance, 0 (blocked) to 1 (free)."""
        return self._four(EXHAUST_FACTOR)

    @property
    def forced_opening(self) -> NDArray[np.float64]:
        """[4] opening in [-1, 1] at which the valve is stuck; NaN is a valve that obeys."""
        return self._four(FORCED_OPENING)

    @property
    def lag_factor(self) -> NDArray[np.float64]:
        """[4] lag of the valve over that of a healthy one."""
        return self._four(LAG_FACTOR)

    @property
    def volume_factor(self) -> NDArray[np.float64]:
        """[4] volume of the chamber over that of a healthy one of the same strain."""
        return self._four(VOLUME_FACTOR)

    @property
    def widening_1_Pa(self) -> NDArray[np.float64]:
        """[4] relative growth of the chamber's volume for each pascal (gauge) that it holds."""
        return self._four(WIDENING_1_Pa)

    @property
    def supply_factor(self) -> float:
        """What is left of the regulator's conductance, 0 to 1."""
        return float(self.packed[SUPPLY_FACTOR])

    def set_supply_factor(self, factor: float) -> None:
        """Set what is left of the regulator's conductance. Raises InputError outside 0...1."""
        if not 0 <= factor <= 1:
            raise InputError(f"supply_factor = {factor!r}: must be from 0 to 1")
        self.packed[SUPPLY_FACTOR] = factor
