"""Measures engines on cases: every setting warmed up, run several times, the median of the wall times counts."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Iterator, Sequence
from typing import Any

from sim.benchmark.case import Case, Ruler, RunScene
from sim.benchmark.engine import Engine
from sim.benchmark.play import Measured, Unable
from sim.benchmark.result import Result
from sim.run import simulate
from sim.scene import Scene
from softbot.errors import SoftbotError
from softbot.interruption import raise_if_asked

REPEAT_FOR_S = 60.0
"""A setting is not repeated any more once its runs have taken this long: slow ones are known well enough by then."""


def simulate_summary(scene: Scene) -> dict[str, Any]:
    """Runs a scene that needs no bus."""
    return simulate(scene, record="summary").summary


def measure(
    cases: Sequence[Case],
    engines: Sequence[Engine],
    *,
    repeats: int = 3,
    settings_each: int | None = None,
    run: RunScene = simulate_summary,
) -> Iterator[Result]:
    """Each engine's settings (the first `settings_each` of them) on each case.

    `run` runs scenes; with the default one, scenes that have a sequencer are reported as not done. What an engine
    cannot do, and a run that fails, is one row with the reason.
    """
    for case in cases:
        ruler: Ruler | None = None
        for engine in engines:
            try:
                engine.version()
                settings = engine.settings(case)[:settings_each]
                ruler = ruler or case.ruler(run)
            except (Unable, SoftbotError) as error:
                yield Result(case.name, engine.name, "", reason=str(error))
                continue
            for setting in settings:
                raise_if_asked()
                yield _measured(case, engine, setting, ruler, repeats, run)


def _measured(case: Case, engine: Engine, setting: Any, ruler: Ruler, repeats: int, run: RunScene) -> Result:
    runs: list[Measured] = []
    began_s = time.perf_counter()
    try:
        engine.warm_up(case, setting, run)
        while len(runs) < repeats and (not runs or time.perf_counter() - began_s < REPEAT_FOR_S):
            runs.append(engine.measure(case, setting, run))
    except Unable as error:
        return Result(case.name, engine.name, setting.label, reason=str(error))
    except (SoftbotError, ArithmeticError) as error:
        return Result(case.name, engine.name, setting.label, reason=f"failed: {error}")
    value = runs[0].value
    if not all(map(math.isfinite, value)):
        return Result(case.name, engine.name, setting.label, reason="failed: the result is not finite")
    wall_s = statistics.median(run.wall_s / run.sim_s for run in runs)
    return Result(
        case=case.name,
        engine=engine.name,
        setting=setting.label,
        value=float(value[0]),
        expected=ruler.value[0],
        expected_from=ruler.source,
        error_percent=float(case.error_percent(value, ruler.value)),
        wall_s_per_sim_s=wall_s,
        real_time_factor=1.0 / wall_s,
        repeats=len(runs),
    )
