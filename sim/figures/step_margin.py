"""Margin of the step: the largest one at which a rolling tube keeps its invariants, over bending stiffness, both twins.

A tube of the design's size, at rest on the floor, is bent and rolled; only its stiffness and the step change. A step
counts as stable when it and every shorter one that was tried keep what `sim.stress` asks of every scene. For measure,
the step is drawn at which an explicit integrator of the same tube's first bending vibrations would blow up, 2/ω.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.figures._canvas import COLOURS, sheet, write
from sim.resolution import STEPS_S
from sim.stress import Trial, judge
from softbot.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LENGTH_M, _RADIUS_M, _MASS_KG, _DAMPING_TIME_S = 0.15, 0.01, 0.0518, 0.005
_BEND_RAD = 1.8
_PERIOD_S, _RAMP_S = 2.0, 0.2
_FREE_FREE = (4.7300, 7.8532, 10.9956)  # βL of a free tube's first bending vibrations


def draw(
    path: Path,
    *,
    stiffnesses: int = 7,
    lowest_N_m2: float = 4e-5,
    highest_N_m2: float = 0.4,
    duration_s: float = 1.0,
    modes: int = 3,
    segments: int = 10,
    shortest_step_s: float = 1e-3,
) -> dict[str, Any]:
    """Find the margin at `stiffnesses` (logarithmic), drawn.

    Returns the stiffnesses [N m²], for either twin the largest stable step at each [s] (None where even the shortest
    fails), and the largest step tried [s]. Raises InputError for fewer than two stiffnesses or a range without a width.
    """
    if stiffnesses < 2 or not 0.0 < lowest_N_m2 < highest_N_m2:
        raise InputError(
            f"stiffnesses = {stiffnesses}, {lowest_N_m2:g} to {highest_N_m2:g} N m²: take at least 2, rising"
        )
    stiffness_N_m2 = np.geomspace(lowest_N_m2, highest_N_m2, stiffnesses)
    steps_s = [one for one in sorted(STEPS_S) if one >= 0.999 * shortest_step_s]
    solvers: dict[str, dict[str, Any]] = {
        "rod": {"modes": modes, "contact_points": 12},
        "bullet": {"twin": "bullet", "segments": segments},
    }
    stable: dict[str, list[float | None]] = {
        twin: [_largest_stable_s(float(one), steps_s, solver, duration_s) for one in stiffness_N_m2]
        for twin, solver in solvers.items()
    }
    figure, ((axis,),) = sheet(1, width_in=6.4, height_in=4.6)
    _paint(axis, stiffness_N_m2, stable, steps_s)
    write(figure, path)
    return {
        "stiffnesses_N_m2": stiffness_N_m2.tolist(),
        "rod_largest_step_s": stable["rod"],
        "bullet_largest_step_s": stable["bullet"],
        "largest_step_tried_s": steps_s[-1],
    }


def rolling_trial(stiffness_N_m2: float, step_s: float, solver: dict[str, Any], duration_s: float) -> Trial:
    """The tube of one stiffness, bent and rolled with one step."""
    return Trial(
        {
            "robot": {
                "length_m": _LENGTH_M,
                "radius_m": _RADIUS_M,
                "mass_kg": _MASS_KG,
                "damping_time_s": _DAMPING_TIME_S,
                "bending_stiffness_N_m2": stiffness_N_m2,
            },
            "drive": {
                "kind": "curvature",
                "curvature_1_m": _BEND_RAD / _LENGTH_M,
                "period_s": _PERIOD_S,
                "start_s": _RAMP_S,
                "ramp_s": _RAMP_S,
            },
            "world": {"friction": 0.6},
            "solver": {"duration_s": duration_s, "step_s": step_s, **solver},
        },
        steps=math.ceil(duration_s / step_s),
    )


def _largest_stable_s(
    stiffness_N_m2: float, steps_s: list[float], solver: dict[str, Any], duration_s: float
) -> float | None:
    largest = None
    for step_s in steps_s:
        if judge(rolling_trial(stiffness_N_m2, step_s, solver, duration_s)).outcome != "kept":
            break
        largest = step_s
    return largest


def _paint(axis: Axes, stiffness_N_m2: Any, stable: dict[str, list[float | None]], steps_s: list[float]) -> None:
    names = {"rod": "rod twin", "bullet": "segment twin"}
    for (twin, largest_s), colour, mark in zip(stable.items(), COLOURS, "os", strict=False):
        shown_ms = [math.nan if one is None else 1e3 * one for one in largest_s]
        axis.plot(stiffness_N_m2, shown_ms, mark + "-", color=colour, label=names[twin])
    for mode, root in enumerate(_FREE_FREE, start=1):
        omega_1_s = root**2 * np.sqrt(stiffness_N_m2 / (_MASS_KG * _LENGTH_M**3))
        axis.plot(stiffness_N_m2, 2e3 / omega_1_s, ":", color="0.5", label="explicit limit" if mode == 1 else None)
        axis.annotate(f"mode {mode}", (stiffness_N_m2[-1], 2e3 / omega_1_s[-1]), fontsize=8, color="0.4", ha="right")
    axis.axhline(1e3 * steps_s[-1], color="0.7", linewidth=0.8)
    axis.annotate("longest step tried", (stiffness_N_m2[-1], 1.1e3 * steps_s[-1]), fontsize=8, color="0.4", ha="right")
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_ylim(0.5e3 * steps_s[0], 2e3 * steps_s[-1])
    axis.set_xlabel("bending stiffness [N m²]")
    axis.set_ylabel("largest stable step [ms]")
    axis.set_title(f"rolling tube, {1e3 * _LENGTH_M:.0f} mm, {1e3 * _MASS_KG:.0f} g, κL = {_BEND_RAD:g}", fontsize=9)
    axis.legend(fontsize=8)
