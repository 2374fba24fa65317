"""The rod twin in the benchmark: scenes as `softbot run` runs them, the rest with the rod stepped directly."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.benchmark.case import Case, RunScene
from sim.benchmark.play import Measured, Unable, play
from sim.benchmark.summary_value import measured_from
from sim.body import Motion
from sim.motion_rows import (
    ANGULAR_MOMENTUM,
    ANGULAR_VELOCITY,
    CENTRE_OF_MASS,
    CHORD,
    CURVATURE,
    ROTATION,
    STRETCH,
    VELOCITY,
)

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class RodSetting:
    """An accuracy by name, or step and resolution by hand."""

    accuracy: str | None = None
    modes: int = 3
    points: int = 16
    step_s: float = 0.0025

    @property
    def label(self) -> str:
        """For a table."""
        if self.accuracy:
            return f'"{self.accuracy}"'
        return f"{self.modes} modes, {self.points} points, {self.step_s * 1e3:g} ms"

    def solver(self) -> dict[str, Any]:
        """As the `[solver]` of a scene."""
        if self.accuracy:
            return {"twin": "rod", "accuracy": self.accuracy}
        return {"twin": "rod", "modes": self.modes, "contact_points": self.points, "step_s": self.step_s}


_BY_NAME = tuple(RodSetting(name) for name in ("standard", "fast", "reference"))
_BY_HAND = (
    RodSetting(modes=1, points=10, step_s=0.02),
    RodSetting(modes=2, points=12, step_s=0.02),
    RodSetting(modes=4, points=16, step_s=0.01),
    RodSetting(modes=6, points=24, step_s=0.0025),
    RodSetting(modes=6, points=32, step_s=0.001),
)
_SETTINGS = {
    "turning": (*_BY_NAME, *_BY_HAND[:1]),
    "advance": (*_BY_NAME, *_BY_HAND),
    "tip": (
        RodSetting(modes=4, points=12, step_s=0.02),
        RodSetting(modes=2, points=12, step_s=0.05),
        RodSetting(modes=3, points=12, step_s=0.05),
        RodSetting(modes=8, points=24, step_s=0.02),
    ),
    "frequency": (
        RodSetting(modes=4, points=12, step_s=0.001),
        RodSetting(modes=2, points=8, step_s=0.005),
        RodSetting(modes=2, points=8, step_s=0.0025),
        RodSetting(modes=4, points=12, step_s=0.00025),
    ),
    "revolutions": _BY_NAME,
}


class RodEngine:
    """The engine. Implements `sim.benchmark.engine.Engine`."""

    name = "rod"

    def version(self) -> str:
        """Name and version."""
        from softbot import __version__

        return f"softbot {__version__}"

    def settings(self, case: Case) -> Sequence[RodSetting]:
        """Settings for a case."""
        return _SETTINGS[case.quantity]

    def warm_up(self, case: Case, setting: RodSetting, run: RunScene) -> None:
        """Compiles what the case needs: a whole run, since what a scene is made of is compiled as it comes up."""
        self.measure(case, setting, run)

    def measure(self, case: Case, setting: RodSetting, run: RunScene) -> Measured:
        """One run."""
        if case.scene_table is not None:
            return measured_from(case, run(case.scene(setting.solver())))
        return play(case, _Rod(case, setting))


class _Rod:
    """The rod of a case, stepped directly. Implements `sim.benchmark.play.Player`.

    These rods bend in one plane and mirror themselves, so half of each is computed and none twists, as for a scene that
    may do without. A clamped rod is half of one twice as long that is clamped in its middle.
    """

    def __init__(self, case: Case, setting: RodSetting) -> None:
        from sim.rod import RodTwin
        from sim.rod_drive import hold

        if case.quantity == "revolutions":
            raise Unable("the sequencer's scene is run by softbot.nodes")
        body = case.body
        if case.clamped:
            body = replace(body, length_m=2.0 * body.length_m, mass_kg=2.0 * body.mass_kg)
        self._twin = RodTwin(
            body,
            case.world,
            modes=setting.modes,
            contact_points=setting.points,
            step_s=setting.step_s,
            stretches=False,
            symmetric=True,
            twists=False,
            clamped=case.clamped,
        )
        self._case, self._body, self._steps = case, body, 0
        self._hold = hold()
        self._row = self._twin.row()
        self._ahead: list[FloatArray] = []

    def run(self, until_s: float) -> float:
        """Step to this time; the wall time of the stepping.

        Once the rest curvature stays as it is, the rest of the case is played at once, as scenes are: its whole wall
        time belongs to the first call of these.
        """
        if self._ahead:
            self._row = self._ahead.pop(0)
            return 0.0
        case, twin, wall_s = self._case, self._twin, 0.0
        last = round(until_s / twin.step_s)
        end = case.rest(case.duration_s)
        while self._steps < last:
            rest = case.rest((self._steps + 1) * twin.step_s)
            twin.set_rest(np.array([1.0, *rest]), self._body.rest_stiffness())
            if np.array_equal(rest, end):
                return wall_s + self._play_on(last)
            self._steps += 1
            began_s = time.perf_counter()
            twin.advance(1)
            wall_s += time.perf_counter() - began_s
        self._row = twin.row()
        return wall_s

    def _play_on(self, last: int) -> float:
        """To step `last`, and on to the end of the case, a row each sample."""
        case, twin = self._case, self._twin
        each = round(case.sample_s / twin.step_s)
        samples = round(case.duration_s / case.sample_s) - round(last * twin.step_s / case.sample_s)
        began_s = time.perf_counter()
        twin.advance(last - self._steps)
        reached = twin.row()
        rows = twin.play(self._hold, samples, each)
        wall_s = time.perf_counter() - began_s
        self._row, self._ahead = reached, list(rows)
        return wall_s

    def motion(self) -> Motion:
        """The rod now."""
        row = self._row
        return Motion(
            rotation=row[ROTATION].reshape(3, 3),
            angular_velocity_rad_s=row[ANGULAR_VELOCITY],
            mid_velocity_m_s=row[VELOCITY],
            centre_of_mass_m=row[CENTRE_OF_MASS],
            stretch=float(row[STRETCH]),
            curvature_1_m=row[CURVATURE],
            chord=row[CHORD],
            angular_momentum_kg_m2_s=row[ANGULAR_MOMENTUM],
        )

    def tip_m(self) -> tuple[float, float]:
        """Drop and reach of the end from the clamp, the middle of the doubled rod."""
        points, _ = self._twin.shape()
        away = points[-1] - points[len(points) // 2]
        return float(-away[2]), float(math.hypot(away[0], away[1]))

    def close(self) -> None:
        """Release what the twin holds."""
        self._twin.close()
