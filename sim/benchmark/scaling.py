"""How the rod's cost grows: with modes, contact points, length of the run, number of robots."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from sim.benchmark.case import Case, RunScene, rolling
from sim.benchmark.measurement import simulate_summary
from sim.benchmark.result import Growth
from sim.scene import Scene

RunMany = Callable[[Sequence[Scene]], Any]
"""Runs scenes, by whatever number at a time."""

MODES = (1, 2, 3, 4, 6, 8)
POINTS = (8, 12, 16, 24, 32, 48)
DURATIONS_S = (9.0, 30.0, 100.0, 300.0)
ROBOTS = (1, 4, 16, 64, 256)
_SOLVER: dict[str, Any] = {"twin": "rod", "modes": 2, "contact_points": 12, "step_s": 0.01}


def one_after_the_other(scenes: Sequence[Scene]) -> None:
    """Runs scenes in this thread."""
    for scene in scenes:
        simulate_summary(scene)


def growth(
    *,
    repeats: int = 3,
    run: RunScene = simulate_summary,
    run_many: RunMany = one_after_the_other,
    quick: bool = False,
) -> Iterator[Growth]:
    """Slow rolling at 2 modes, 12 points, 10 ms, with one of these (or time, or company) changed at a time.

    Wall times are of the solver loop alone, median of `repeats`; those of several robots are of everything, from the
    start of their processes to the last summary. `quick`: the two smallest sizes of each.
    """
    case = rolling()
    few = 2 if quick else None
    for modes in MODES[:few]:
        points = max(_SOLVER["contact_points"], 2 * modes + 2)
        yield _grown("modes", modes, case, {**_SOLVER, "modes": modes, "contact_points": points}, repeats, run)
    for points in POINTS[:few]:
        yield _grown("contact points", points, case, {**_SOLVER, "contact_points": points}, repeats, run)
    for duration_s in DURATIONS_S[:few]:
        solver = {**_SOLVER, "duration_s": duration_s}
        yield _grown("simulated seconds", duration_s, case, solver, repeats, run)
    scene = case.scene(_SOLVER)
    run_many([scene] * ROBOTS[0])
    for robots in ROBOTS[:few]:
        took_s = []
        for _ in range(repeats):
            began_s = time.perf_counter()
            run_many([scene] * robots)
            took_s.append(time.perf_counter() - began_s)
        each = statistics.median(took_s) / case.duration_s
        yield Growth("robots", robots, each / robots, robots / each)


def _grown(of: str, size: float, case: Case, solver: dict[str, Any], repeats: int, run: RunScene) -> Growth:
    scene = case.scene(solver)
    run(scene)
    factor = statistics.median(run(scene)["real_time_factor"] for _ in range(repeats))
    return Growth(of, size, 1.0 / factor, factor)
