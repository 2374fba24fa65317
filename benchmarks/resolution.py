"""Errors of modes, contact points and step against a much finer run, beside their estimates; and of each accuracy.

    python benchmarks/resolution.py [CASE …]      the laws of sim/resolution.py, one case a block
    python benchmarks/resolution.py --levels [CASE …]   whether "fast", "standard" and "reference" keep their word

Every number is the worst of a run's results (revolutions, displacement or turning, bend), in percent. The first of a
pair is measured, the second the estimate that the choice is made with: it is to be the larger one, except where both
are far below what counts.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable

from sim.benchmark.stamp import in_words, stamp
from sim.convergence import CASES, case_scene, much_finer, relative_errors
from sim.plan import make_plan
from sim.resolution import MODES, STEPS_S, TARGETS, Demand, check_turn, modes_error, points_error, step_error
from sim.scene import Scene
from softbot.errors import InputError
from softbot.nodes.run import run_scene

POINTS = (6, 8, 10, 12, 16, 20, 24, 32)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", nargs="*", help=f"of {', '.join(CASES)}; default: all")
    parser.add_argument("--levels", action="store_true", help="the three accuracies instead of the laws")
    asked = parser.parse_args()
    print(in_words(stamp()))
    for name in asked.case or CASES:
        fine_scene = much_finer(case_scene(name))
        fine = run_scene(fine_scene).summary
        own = fine_scene.solver
        print(f"\n{name} (against {own.modes} modes, {own.contact_points} points, {1e3 * (own.step_s or 0.0):.3g} ms)")
        if asked.levels:
            print_levels(name, fine)
        else:
            print_laws(fine_scene, fine)


def print_levels(name: str, fine: dict) -> None:  # type: ignore[type-arg]
    """Each accuracy's error, its estimate and speed."""
    for accuracy, target in TARGETS.items():
        scene = case_scene(name, accuracy=accuracy)
        plan, found = make_plan(scene), run_scene(scene).summary
        chosen = plan.resolution
        assert chosen is not None
        errors = relative_errors(scene, found, fine)
        worst = max(errors, key=lambda result: errors[result])
        word = "kept" if errors[worst] <= target else "BROKEN"
        print(
            f"  {accuracy:9}  {chosen.modes:2} modes {chosen.contact_points:2} points {1e3 * chosen.step_s:7.3g} ms  "
            f"{worst:14} {100 * errors[worst]:8.4f} %  estimate {100 * chosen.error:8.4f} %  "
            f"target {100 * target:g} %: {word}  {found['real_time_factor']:.0f} x real time",
            flush=True,
        )


def print_laws(fine_scene: Scene, fine: dict) -> None:  # type: ignore[type-arg]
    """Error of each choice alone, the two others fine."""
    demand, own = Demand.of(fine_scene), fine_scene.solver
    assert own.modes is not None
    least = 2 * own.modes + 2  # fewer do not see how it bends
    modes = (count for count in MODES if count < own.modes)
    points = (count for count in POINTS if count >= least)
    steps = (step_s for step_s in STEPS_S if step_s > 2.0 * (own.step_s or 0.0) and _may_step(fine_scene, step_s))
    print_row("modes", "modes", fine_scene, fine, modes, lambda value: modes_error(demand, int(value)))
    print_row("points", "contact_points", fine_scene, fine, points, lambda value: points_error(demand, int(value)))
    print_row("step, ms", "step_s", fine_scene, fine, steps, lambda value: step_error(demand, value), 1e3)


def print_row(
    label: str,
    key: str,
    fine_scene: Scene,
    fine: dict,  # type: ignore[type-arg]
    values: Iterable[float],
    estimate: Callable[[float], float],
    scale: float = 1.0,
) -> None:
    """Measured and estimated errors over the values of one key of `[solver]`."""
    cells = []
    for value in values:
        scene = fine_scene.model_copy(update={"solver": fine_scene.solver.model_copy(update={key: value})})
        error = max(relative_errors(scene, run_scene(scene).summary, fine).values())
        cells.append(f"{scale * value:.3g}: {100 * error:.4f} ({100 * estimate(value):.4f})")
    print(f"  {label:9}", "  ".join(cells), flush=True)


def _may_step(scene: Scene, step_s: float) -> bool:
    valves = scene.drive.kind in ("pressure", "sequencer")
    times_s = (scene.solver.duration_s, scene.steady_after_s)
    if step_s > 0.01 and (valves or any(abs(t_s / step_s - round(t_s / step_s)) > 1e-6 for t_s in times_s)):
        return False
    try:
        check_turn(scene, step_s)
    except InputError:
        return False
    return True


if __name__ == "__main__":
    main()
