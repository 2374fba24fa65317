"""The segment twin (PyBullet) in the benchmark: scenes as `softbot run` runs them, vibration with the twin stepped."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np

from sim.benchmark.case import Case, RunScene
from sim.benchmark.play import Measured, Unable, play
from sim.benchmark.summary_value import measured_from
from sim.body import Motion


@dataclass(frozen=True)
class SegmentSetting:
    """How many segments, and how long a step."""

    segments: int
    step_s: float

    @property
    def label(self) -> str:
        """For a table."""
        return f"{self.segments} segments, {self.step_s * 1e3:g} ms"

    def solver(self) -> dict[str, Any]:
        """As the `[solver]` of a scene."""
        return {"twin": "bullet", "segments": self.segments, "step_s": self.step_s}


_COARSE = (SegmentSetting(10, 0.0025), SegmentSetting(10, 0.005))
_FINE = (SegmentSetting(20, 0.0025), SegmentSetting(20, 0.001))
_SETTINGS = {
    "turning": (*_COARSE, *_FINE),
    "advance": (*_COARSE, *_FINE),
    "frequency": (SegmentSetting(10, 0.001), SegmentSetting(10, 0.0025), SegmentSetting(20, 0.00025)),
    "revolutions": _COARSE,
}


class BulletEngine:
    """The engine. Implements `sim.benchmark.engine.Engine`."""

    name = "bullet"

    def version(self) -> str:
        """Name and version."""
        return f"pybullet {version('pybullet')}"

    def settings(self, case: Case) -> Sequence[SegmentSetting]:
        """Settings for a case. Raises Unable for a case that it cannot do."""
        if case.clamped:
            raise Unable("the segment twin's base is free: it has no clamp")
        return _SETTINGS[case.quantity]

    def warm_up(self, case: Case, setting: SegmentSetting, run: RunScene) -> None:
        """A few steps: compiles the joint forces."""
        if case.scene_table is not None and case.quantity != "revolutions":
            run(case.scene({**setting.solver(), "duration_s": case.measured_from_s + 0.05}))
        elif case.scene_table is None:
            play(case, _Segments(case, setting), duration_s=2.0 * case.sample_s)

    def measure(self, case: Case, setting: SegmentSetting, run: RunScene) -> Measured:
        """One run."""
        if case.scene_table is not None:
            return measured_from(case, run(case.scene(setting.solver())))
        return play(case, _Segments(case, setting))


class _Segments:
    """The segment twin of a case, stepped directly. Implements `sim.benchmark.play.Player`."""

    def __init__(self, case: Case, setting: SegmentSetting) -> None:
        from sim.bullet import BulletTwin

        self._twin = BulletTwin(
            case.body, case.world, segments=setting.segments, step_s=setting.step_s, stretches=False
        )
        self._case, self._steps = case, 0

    def run(self, until_s: float) -> float:
        """Step to this time; the wall time of the steps."""
        twin, stiffness, wall_s = self._twin, self._case.body.rest_stiffness(), 0.0
        for _ in range(round(until_s / twin.step_s) - self._steps):
            self._steps += 1
            twin.set_rest(np.array([1.0, *self._case.rest(self._steps * twin.step_s)]), stiffness)
            began_s = time.perf_counter()
            twin.step()
            wall_s += time.perf_counter() - began_s
        return wall_s

    def motion(self) -> Motion:
        """The robot now."""
        return self._twin.motion()

    def tip_m(self) -> tuple[float, float]:
        """It has no clamp."""
        raise Unable("the segment twin's base is free: it has no clamp")

    def close(self) -> None:
        """Disconnect from PyBullet."""
        self._twin.close()
