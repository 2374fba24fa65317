"""Plays a case in an engine that is stepped directly, and reads the case's quantity off what it sees of the motion.

The same eyes for every engine: `sim.trajectory` for roll and for the plane of the C, the centre of mass for the way,
the mean curvature for vibration. The wall time is what the engine says its solver took.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sim.benchmark.case import Case
from sim.benchmark.natural_frequency import natural_frequency_rad_s
from sim.body import Motion
from sim.trajectory import Trajectory


class Unable(Exception):
    """An engine cannot do a case; the message says why."""


class Player(Protocol):
    """An engine with a case's rod in it, straight and at rest at t = 0."""

    def run(self, until_s: float) -> float:
        """Step to this time [s] under the case's rest curvature; returns the wall time of the solver alone [s]."""

    def motion(self) -> Motion:
        """The rod now. Rates may be NaN: no ruler reads them."""

    def tip_m(self) -> tuple[float, float]:
        """Of a clamped rod: how far the tip hangs below the clamp, and its horizontal distance from it [m]."""

    def close(self) -> None:
        """Release what the engine holds."""


@dataclass(frozen=True)
class Measured:
    """What one run gave: the case's quantity, simulated time and wall time of the solver alone [s]."""

    value: tuple[float, ...]
    sim_s: float
    wall_s: float


def play(case: Case, player: Player, duration_s: float | None = None) -> Measured:
    """Run a case (or only its first `duration_s`, for a warm-up: the value is NaN then), and close the player.

    Raises ArithmeticError when the engine's state is no longer finite.
    """
    try:
        return _play(case, player, duration_s)
    finally:
        player.close()


def _play(case: Case, player: Player, duration_s: float | None) -> Measured:
    whole = duration_s is None
    samples = max(1, round((case.duration_s if duration_s is None else duration_s) / case.sample_s))
    follows = case.quantity in ("turning", "advance")
    eyes = Trajectory(case.body.length_m, grounded=case.world.ground != "none")
    rows, wall_s = [], 0.0
    for sample in range(1, samples + 1):
        t_s = sample * case.sample_s
        wall_s += player.run(t_s)
        if case.quantity == "tip":
            continue
        motion = player.motion()
        if not np.isfinite(motion.rotation).all():
            raise ArithmeticError(f"no longer finite at {t_s:g} s")
        posture = eyes.follow(motion) if follows else None
        x, y, _ = motion.centre_of_mass_m
        seen = (posture.roll_rad, posture.plane_rotation_rad) if posture else (0.0, 0.0)
        rows.append((t_s, x, y, *seen, motion.curvature_1_m[0]))
    value = _read(case, np.array(rows), player) if whole else (math.nan,)
    return Measured(value, samples * case.sample_s, wall_s)


def _read(case: Case, rows: np.ndarray, player: Player) -> tuple[float, ...]:
    if case.quantity == "tip":
        drop, reach = player.tip_m()
        return drop / case.body.length_m, reach / case.body.length_m
    t_s, x, y, roll, plane, curvature = rows.T
    first = int(np.argmax(t_s >= case.measured_from_s - 1e-9))
    if case.quantity == "frequency":
        return (natural_frequency_rad_s(curvature[first:], case.sample_s) / (2.0 * math.pi),)
    if case.quantity == "turning":
        directions = np.array([math.atan2(*case.rest(t)[::-1]) for t in (t_s[first], t_s[-1])])
        turned = (directions[1] - directions[0]) % (2.0 * math.pi)
        return (float(plane[-1] - plane[first]) / turned,)
    rolled = abs(roll[-1] - roll[first])
    if rolled < 0.1:
        raise ArithmeticError("the robot did not roll")
    return (math.hypot(x[-1] - x[first], y[-1] - y[first]) / (case.body.radius_m * rolled),)
