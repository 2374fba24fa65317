"""What the chambers' memory costs: a step of plant and rod with all its parts, over one without: `python -m
sim.benchmark.memory_cost`.

Both are run in turn in one process, with the same valves, compiled before; the processor time of this thread counts,
and of many runs the median, so that a busy machine disturbs it little. The parts are faint: as much is computed as
ever, but the robot moves alike with and without them (a step's cost depends on what touches the floor).
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from sim.plant import Plant
from sim.scene import scene_from
from sim.twins import make_twin

FAINT_PARTS: dict[str, Any] = {
    "line": {"filling_conductance_m3_s_Pa": 1e-7, "venting_conductance_m3_s_Pa": 5e-8, "growth_1_Pa": 3e-6},
    "hysteresis": {"thresholds_Pa": [2e3, 8e3, 2e4, 4e4], "weights": [1e-6] * 4, "unloading_slope": 1.3},
    "creep": {"shares": [1e-6, 1e-6], "times_s": [1.0, 20.0]},
    "residual": {"share": 1e-6, "growth_time_s": 5.0, "recovery_time_s": 30.0},
}
_ROBOT = {"length_m": 0.15, "radius_m": 0.01, "mass_kg": 0.0518, "bending_stiffness_N_m2": 3.93e-3}
_STEPS = 100


def memory_cost(rounds: int = 60) -> tuple[float, float]:
    """Processor seconds of a step without memory and with all its parts, the medians of `rounds` runs of each."""
    plants = [_plant(_ROBOT), _plant({**_ROBOT, "memory": FAINT_PARTS})]
    random = np.random.default_rng(0)
    taken = np.empty((rounds, 2))
    for plant in plants:
        plant.advance(np.zeros(4), True, 1)  # compiled from here on
    for n in range(rounds):
        opening = random.uniform(-1.0, 1.0, 4)
        for which, plant in enumerate(plants):
            begun = time.thread_time()
            plant.advance(opening, True, _STEPS)
            taken[n, which] = (time.thread_time() - begun) / _STEPS
    without_s, with_s = np.median(taken, axis=0)
    return float(without_s), float(with_s)


def _plant(robot: dict[str, Any]) -> Plant:
    tables = {"robot": robot, "drive": {"kind": "sequencer"}, "solver": {"twin": "rod", "duration_s": 10.0}}
    scene = scene_from(tables, "memory cost", Path())
    return Plant(scene.robot, make_twin(scene), (), scene.world.gravity_m_s2, seed=0)


if __name__ == "__main__":
    without_s, with_s = memory_cost()
    print(
        f"a step of plant and rod: {1e6 * without_s:.1f} us without memory, {1e6 * with_s:.1f} us with all parts: "
        f"{with_s / without_s:.2f} times"
    )
