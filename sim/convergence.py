"""How far a run is from a much finer one: what `solver.accuracy` promises, measured.

A run's results are its revolutions, displacement, bend and (afloat) the turning of its plane, from `summary.json`. The
scenes are of all kinds: slow and fast, soft and stiff, afloat, on slopes, pipes and steps, given bends, pressures and a
sequencer.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from sim.plan import make_plan
from sim.resolution import STEPS_S
from sim.scene import Scene, scene_from

Tables = dict[str, Any]

_LEAST_REVOLUTIONS, _LEAST_BEND_RAD, _LEAST_TURN_RAD = 0.05, 0.1, 0.1
"""Smaller results than these are measured against these."""
_FINE_STEP_S = 0.00125

ROBOT: Tables = {
    "length_m": 0.15,
    "radius_m": 0.01,
    "mass_kg": 0.0518,
    "bending_stiffness_N_m2": 3.93e-3,
    "damping_time_s": 0.02,
}


def _given(robot: Tables, drive: Tables, world: Tables, cycles: float = 1.0) -> Tables:
    """A given curvature, measured over `cycles` after one to settle."""
    start_s, period_s = drive.get("start_s", 1.0), drive["period_s"]
    return {
        "robot": {**ROBOT, **robot},
        "drive": {"kind": "curvature", "start_s": start_s, **drive},
        "world": world,
        "solver": {"twin": "rod", "duration_s": start_s + (1.0 + cycles) * period_s},
        "metrics": {"steady_after_s": start_s + period_s},
    }


def _driven(drive: Tables, duration_s: float, steady_after_s: float, **more: Any) -> Tables:
    """The default robot under pressure."""
    return {
        "robot": "default",
        "drive": drive,
        "solver": {"twin": "rod", "duration_s": duration_s},
        "metrics": {"steady_after_s": steady_after_s},
        **more,
    }


CASES: dict[str, Tables] = {
    "slow roll": _given({}, {"curvature_1_m": 12.0, "period_s": 2.0}, {}),
    "slight bend, viscous floor": _given(
        {}, {"curvature_1_m": 5.0, "period_s": 4.0}, {"friction_law": "viscous", "friction": 2.0}
    ),
    "tight bend": _given({}, {"curvature_1_m": 18.0, "period_s": 4.0}, {}),
    "fast roll": _given({}, {"curvature_1_m": 6.0, "period_s": 0.5}, {}, cycles=4.0),
    "soft robot": _given({"bending_stiffness_N_m2": 1.2e-3}, {"curvature_1_m": 8.0, "period_s": 3.0}, {}),
    "stiff robot": _given({"bending_stiffness_N_m2": 4e-2}, {"curvature_1_m": 12.0, "period_s": 2.0}, {}),
    "slippery floor": _given({}, {"curvature_1_m": 9.0, "period_s": 1.0}, {"friction": 0.15}, cycles=2.0),
    "afloat": _given({}, {"curvature_1_m": 12.0, "period_s": 2.0}, {"ground": "none"}),
    "afloat, fast": _given({}, {"curvature_1_m": 8.0, "period_s": 0.4}, {"ground": "none"}, cycles=4.0),
    # bent at once, or it rolls off before it is
    "down a slope": _given(
        {}, {"curvature_1_m": 9.0, "period_s": 2.0, "start_s": 0.1, "ramp_s": 0.1}, {"slope_rad": 0.1}
    ),
    "along a slope": _given({}, {"curvature_1_m": 9.0, "period_s": 2.0}, {"slope_rad": 0.1, "slope_heading_rad": 0.0}),
    "on a pipe": _given({}, {"curvature_1_m": 5.0, "period_s": 4.0}, {"ground": "pipe", "pipe_radius_m": 0.3}),
    "led by its roll": _given(
        {}, {"curvature_1_m": 9.0, "period_s": 2.0, "lead_rad": 0.8, "lag_s": 0.1}, {}, cycles=1.0
    ),
    "muscles": {
        "robot": "larva",
        "drive": {"kind": "contraction", "contraction": 0.4, "period_s": 2.0, "start_s": 0.5, "ramp_s": 0.4},
        "solver": {"twin": "rod", "duration_s": 4.5},
        "metrics": {"steady_after_s": 2.5},
    },
    "open-loop pressures": _driven(
        {"kind": "pressure", "peak_pressure_Pa": 100e3, "period_s": 4.0, "start_s": 1.0}, 9.0, 5.0
    ),
    "sequencer": _driven({"kind": "sequencer"}, 6.0, 3.0, sequencer={"speed_rev_s": 0.5}),
}


def case_scene(name: str, **solver: Any) -> Scene:
    """One of `CASES`, with keys of `[solver]` laid over it."""
    tables = {**CASES[name], "name": name}
    tables["solver"] = {**tables["solver"], **solver}
    return scene_from(tables, name, Path())


def much_finer(scene: Scene) -> Scene:
    """The scene at twice the points, an eighth of the step or less and four modes more than `reference` would take."""
    plan = make_plan(scene.model_copy(update={"solver": scene.solver.model_copy(update={"accuracy": "reference"})}))
    assert plan.resolution is not None
    finer = {
        "modes": min(plan.resolution.modes + 4, 11),
        "contact_points": min(2 * plan.resolution.contact_points, 64),
        "step_s": next((s for s in STEPS_S if s <= min(plan.step_s / 8.0, _FINE_STEP_S) * (1.0 + 1e-9)), STEPS_S[-1]),
        "accuracy": "reference",
    }
    return scene.model_copy(update={"solver": scene.solver.model_copy(update=finer)})


def relative_errors(scene: Scene, found: Tables, fine: Tables) -> dict[str, float]:
    """Relative differences of two summaries of a scene, by result."""
    grounded = scene.world.ground != "none"
    revolutions = max(abs(fine["revolutions"]), _LEAST_REVOLUTIONS)
    errors = {
        "revolutions": abs(found["revolutions"] - fine["revolutions"]) / revolutions,
        "bend": abs(found["bend_rad"] - fine["bend_rad"]) / max(fine["bend_rad"], _LEAST_BEND_RAD),
    }
    if grounded:
        way_m = max(math.hypot(*fine["displacement_m"]), _LEAST_REVOLUTIONS * 2.0 * math.pi * scene.robot.radius_m)
        errors["displacement"] = math.dist(found["displacement_m"], fine["displacement_m"]) / way_m
    else:
        turned = max(abs(fine["plane_rotation_rad"]), _LEAST_TURN_RAD)
        errors["plane rotation"] = abs(found["plane_rotation_rad"] - fine["plane_rotation_rad"]) / turned
    return errors
