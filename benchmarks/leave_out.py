"""What each leave-out rule saves: wall time of the solver loop with the rule over that without it.

    python benchmarks/leave_out.py [--out benchmarks/leave_out.md]

One core; the median of nine runs of each, taken in turn, compiled before. Rules without a loop of their own to compare
(pneumatics and sensors: another drive; logs: `sim.run_many`; bodies: another scene) are measured against the scene that
has what they leave out.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from sim.benchmark.stamp import in_words, stamp
from sim.body import Body
from sim.convergence import ROBOT
from sim.drive import bend_1_m
from sim.equilibrium import equilibrium, rest_strains
from sim.rod import RodTwin
from sim.rod_drive import drive_array
from sim.run import simulate
from sim.scene import Scene, scene_from
from sim.twins import make_twin
from softbot.nodes.run import run_scene

REPEATS = 9


def roll(drive: dict[str, Any] | None = None, world: dict[str, Any] | None = None, **more: Any) -> Scene:
    """The design's slow roll at "standard", with tables laid over it."""
    tables = {
        "robot": ROBOT,
        "drive": {"kind": "curvature", "curvature_1_m": 12.0, "period_s": 2.0, **(drive or {})},
        "world": world or {},
        "solver": {"twin": "rod", "duration_s": 7.0, **more.pop("solver", {})},
        **more,
    }
    return scene_from(tables, "roll", Path())


def loop(scene: Scene, keep: tuple[str, ...] = ()) -> Callable[[], float]:
    """Wall time of playing a given drive to its end, in compiled code."""

    def timed() -> float:
        twin = make_twin(scene, keep=keep)
        assert isinstance(twin, RodTwin)
        drive = drive_array(scene.drive, curvature_1_m=bend_1_m(scene.drive, scene.robot))
        steps = round(scene.solver.duration_s / twin.step_s)
        began_s = time.perf_counter()
        twin.play(drive, 1, steps)
        return time.perf_counter() - began_s

    return timed


def sleepless(scene: Scene) -> Callable[[], float]:
    """As `loop`, and the robot is woken once a control period."""

    def timed() -> float:
        twin = make_twin(scene)
        assert isinstance(twin, RodTwin)
        drive = drive_array(scene.drive)
        steps = max(1, round(0.01 / twin.step_s))
        rows = np.zeros((round(scene.solver.duration_s / (steps * twin.step_s)), 0))
        began_s = time.perf_counter()
        for _ in rows:
            twin.wake()
            twin.play(drive, 1, steps)
        return time.perf_counter() - began_s

    return timed


def whole(run: Callable[..., Any], scene: Scene, **options: Any) -> Callable[[], float]:
    """Wall time of a whole run, recording and all."""

    def timed() -> float:
        began_s = time.perf_counter()
        run(scene, **options)
        return time.perf_counter() - began_s

    return timed


def to_rest(scene: Scene) -> Callable[[], float]:
    """Wall time of one equilibrium."""

    def timed() -> float:
        twin = make_twin(scene)
        assert isinstance(twin, RodTwin)
        began_s = time.perf_counter()
        equilibrium(twin, rest_strains(scene), Body.of(scene.robot), held=True)
        return time.perf_counter() - began_s

    return timed


def compared(with_rule: Callable[[], float], without: Callable[[], float]) -> tuple[float, float]:
    """Median wall times [s], the two taken in turn."""
    with_rule()
    without()
    pairs = [(with_rule(), without()) for _ in range(REPEATS)]
    return statistics.median(pair[0] for pair in pairs), statistics.median(pair[1] for pair in pairs)


def measurements() -> list[tuple[str, str, Callable[[], float], Callable[[], float]]]:
    """Rule, what is compared, and the two to be timed."""
    slow, afloat = roll(), roll(world={"ground": "none"})
    bent = {"kind": "curvature", "curvature_1_m": 12.0, "start_s": 1.0, "period_s": 1e5}
    resting = roll(drive={"start_s": 60.0, "ramp_s": 1.0}, solver={"duration_s": 59.0})
    pressed = {"kind": "pressure", "peak_pressure_Pa": 3e4, "period_s": 2.0}
    same = {"modes": 3, "contact_points": 12, "step_s": 0.005}
    valves = roll(drive=pressed, solver=same)
    given = valves.model_copy(update={"drive": slow.drive})
    far = {"kind": "box", "size_m": [0.05, 0.05, 0.05], "mass_kg": 0.05, "position_m": [0.0, 5.0]}
    crowded = roll(solver=same, body=[far])
    still = roll(drive=bent, solver={"question": "equilibrium", "duration_s": 1e5})
    moving = roll(drive=bent, solver={"duration_s": 10.0})
    springy = {**ROBOT, "damping_time_s": 1e-4}
    ringing = roll(drive=bent, robot=springy, solver={"duration_s": 10.0})
    stopped = roll(drive=bent, robot=springy, solver={"question": "equilibrium", "duration_s": 1e5})
    loose = roll(world={"ground": "none"}, solver=same)
    brief, full = whole(simulate, slow, record="summary"), whole(simulate, slow)
    return [
        ("contact", "the same roll afloat, against on the floor", loop(loose), loop(given)),
        ("mirror", "slow roll", loop(slow), loop(slow, ("mirror",))),
        ("mirror", "afloat", loop(afloat), loop(afloat, ("mirror",))),
        ("twist", "slow roll", loop(slow), loop(slow, ("twist",))),
        ("stretch", "slow roll", loop(slow), loop(slow, ("stretch",))),
        ("dynamics", "a bend on the floor, against motion until it sleeps", to_rest(still), loop(moving)),
        ("dynamics", "the same, hardly damped, against 10 s of motion", to_rest(stopped), loop(ringing)),
        ("sleep", "59 s of rest, against being woken each 10 ms", loop(resting), sleepless(resting)),
        ("pneumatics, sensors", "given bend against valves and gas", whole(run_scene, given), whole(run_scene, valves)),
        ("logs", "summary alone against the whole telemetry", brief, full),
        ("bodies", "no body against one 5 m away", whole(simulate, given), whole(simulate, crowded)),
    ]


def main() -> None:
    """Print the table, or write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="write the table as Markdown")
    asked = parser.parse_args()
    lines = ["| rule | compared | with [ms] | without [ms] | saved |", "|---|---|---|---|---|"]
    for rule, words, with_rule, without in measurements():
        fast_s, slow_s = compared(with_rule, without)
        lines.append(f"| {rule} | {words} | {1e3 * fast_s:.3g} | {1e3 * slow_s:.3g} | {slow_s / fast_s:.3g} × |")
        print(lines[-1], flush=True)
    if asked.out is not None:
        head = "# What leaving out saves\n\n`python benchmarks/leave_out.py --out benchmarks/leave_out.md`: "
        asked.out.write_text(head + in_words(stamp()) + "\n\n" + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
