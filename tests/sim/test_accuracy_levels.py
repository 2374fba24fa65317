"""Each accuracy keeps its word: against a much finer run no result is off by more than the target."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from sim.convergence import CASES, case_scene, much_finer, relative_errors
from sim.plan import make_plan
from sim.resolution import TARGETS
from sim.scene import scene_from
from softbot.nodes.run import run_scene
from softbot.rolling import floating_ratio

NOISE = 1e-3
"""Of scenes whose valves answer to noisy sensors: two runs with steps that differ by rounding differ by as much."""


@cache
def fine_summary(name: str) -> dict[str, Any]:
    return run_scene(much_finer(case_scene(name))).summary


def allowed(name: str, accuracy: str) -> float:
    target = TARGETS[accuracy]
    return max(target, NOISE) if CASES[name]["drive"]["kind"] in ("pressure", "sequencer") else target


def check(name: str, accuracy: str) -> None:
    scene = case_scene(name, accuracy=accuracy)
    errors = relative_errors(scene, run_scene(scene).summary, fine_summary(name))
    assert max(errors.values()) <= allowed(name, accuracy), errors


@pytest.mark.slow
@pytest.mark.parametrize("accuracy", list(TARGETS))
@pytest.mark.parametrize("name", list(CASES))
def test_each_accuracy_keeps_its_word(name: str, accuracy: str) -> None:
    check(name, accuracy)


@pytest.mark.parametrize("name", ["slow roll", "afloat"])
@pytest.mark.parametrize("accuracy", ["fast", "standard"])
def test_a_roll_and_a_floating_turn_keep_the_word_of_the_coarser_levels(name: str, accuracy: str) -> None:
    check(name, accuracy)


@pytest.mark.parametrize(("accuracy", "within"), [("standard", 1e-3), ("reference", 1e-4)])
@pytest.mark.parametrize("bend_rad", [0.2, 1.5, 3.0])
@pytest.mark.parametrize("slenderness", [1 / 0.02, 1 / 0.15])
def test_a_floating_robot_of_any_shape_turns_by_its_ratio(
    accuracy: str, within: float, bend_rad: float, slenderness: float
) -> None:
    """A fifth of the target: driven slowly, whatever the bend, thick and thin."""
    length_m, period_s = 0.15, 20.0
    radius_m = length_m / slenderness
    tables = {
        "robot": {
            "length_m": length_m,
            "radius_m": radius_m,
            "mass_kg": 1100.0 * math.pi * radius_m**2 * length_m,
            "bending_stiffness_N_m2": 3.93e-3 * (radius_m / 0.01) ** 4,
        },
        "drive": {"kind": "curvature", "curvature_1_m": bend_rad / length_m, "period_s": period_s},
        "world": {"ground": "none"},
        "solver": {"twin": "rod", "accuracy": accuracy, "duration_s": 1.0 + 1.5 * period_s},
        "metrics": {"steady_after_s": 1.0 + 0.5 * period_s},
    }
    summary = run_scene(scene_from(tables, "afloat", Path())).summary
    turned = summary["plane_rotation_rad"] / (2.0 * math.pi)
    assert turned == pytest.approx(floating_ratio(length_m, radius_m, bend_rad / length_m), rel=within)
    assert summary["angular_momentum_max_kg_m2_s"] < 1e-12


def test_a_much_finer_run_is_finer_in_everything() -> None:
    scene = case_scene("slow roll", accuracy="reference")
    finer, chosen = much_finer(scene).solver, make_plan(scene).resolution
    assert chosen is not None
    assert finer.step_s is not None
    assert finer.step_s <= chosen.step_s / 8.0
    assert finer.modes == chosen.modes + 4
    assert finer.contact_points == 2 * chosen.contact_points


def test_results_that_differ_are_told_apart() -> None:
    scene = case_scene("slow roll")
    fine = {"revolutions": -1.0, "bend_rad": 1.8, "displacement_m": [0.0, 0.06], "plane_rotation_rad": 2.0}
    found = {**fine, "displacement_m": [0.003, 0.06], "bend_rad": 1.8 * 1.01}
    errors = relative_errors(scene, found, fine)
    assert errors["displacement"] == pytest.approx(0.05)
    assert errors["bend"] == pytest.approx(0.01)
    assert errors["revolutions"] == 0.0
    floating = relative_errors(case_scene("afloat"), {**fine, "plane_rotation_rad": 2.2}, fine)
    assert floating["plane rotation"] == pytest.approx(0.1)
    assert "displacement" not in floating
