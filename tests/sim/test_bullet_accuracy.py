"""The segment twin against the project's rulers: floating ratio, advance ratio, refinement, a minute at 4 ms."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim.body import Body, World
from sim.bullet import BulletTwin
from sim.drive import curvature_1_m
from sim.run import simulate
from sim.scene import load_scene
from sim.trajectory import Trajectory
from softbot.rolling import coulomb_advance_ratio, floating_ratio

pytestmark = pytest.mark.slow

SCENES = Path(__file__).parents[2] / "scenes"


@cache
def summary_of(scene: str, accuracy: str, curvature: float) -> dict[str, Any]:
    settings = ("solver.twin=bullet", f"solver.accuracy={accuracy}", f"drive.curvature_1_m={curvature}")
    return simulate(load_scene(SCENES / f"{scene}.toml", settings)).summary


def floating_error(accuracy: str, curvature: float) -> float:
    """Ω/α̇ measured over theory, less one: the plane's turning for each turn of the material."""
    summary = summary_of("floating", accuracy, curvature)
    measured = summary["plane_rotation_rad"] / (2.0 * math.pi * -summary["revolutions"])
    return measured / floating_ratio(0.15, 0.01, curvature) - 1.0


def advance_error(accuracy: str) -> float:
    """Advance per revolution over theory at φ0 = 12·0.15/2 = 0.9, less one."""
    summary = summary_of("slow_roll", accuracy, 12.0)
    return summary["advance_per_revolution_m"] / (2.0 * math.pi * 0.01) / coulomb_advance_ratio(0.9) - 1.0


@pytest.mark.parametrize("curvature", [12.0, 8.0])
def test_floating_robot_turns_as_theory_says_and_makes_no_angular_momentum(curvature: float) -> None:
    assert abs(floating_error("reference", curvature)) < 0.03
    summary = summary_of("floating", "reference", curvature)
    spin = 2.0 * math.pi / 2.0  # of the material; its own angular momentum is ½ m R² of that
    assert summary["angular_momentum_max_kg_m2_s"] < 0.01 * 0.5 * 0.0518 * 0.01**2 * spin
    assert summary["revolutions"] == pytest.approx(-3.0, abs=0.02)


def test_slow_roll_advances_as_theory_says_and_to_the_left() -> None:
    assert abs(advance_error("reference")) < 0.05
    summary = summary_of("slow_roll", "reference", 12.0)
    assert summary["revolutions"] == pytest.approx(-3.0, rel=0.02)
    assert summary["displacement_m"][1] > 0.0


def test_errors_shrink_as_links_and_steps_are_refined() -> None:
    assert abs(floating_error("reference", 12.0)) < abs(floating_error("fast", 12.0))
    assert abs(advance_error("reference")) < abs(advance_error("fast"))


def test_ten_links_roll_for_a_minute_at_4_ms() -> None:
    scene = load_scene(SCENES / "slow_roll.toml")
    body = Body.of(scene.robot)
    twin = BulletTwin(body, World(9.81, "plane", 0.6, "coulomb"), segments=10, step_s=0.004, stretches=False)
    trajectory = Trajectory(body.length_m, grounded=True)
    stiffness = body.rest_stiffness()
    for n in range(round(60.0 / twin.step_s)):
        twin.set_rest(np.array([1.0, *curvature_1_m(scene.drive, (n + 1) * twin.step_s)]), stiffness)
        twin.step()
        if n % 5 == 0:
            motion = twin.motion()
            posture = trajectory.follow(motion)
            assert abs(motion.centre_of_mass_m[2] - body.radius_m) < 0.2 * body.radius_m
            if n * twin.step_s > 1.0:
                assert posture.bend_rad == pytest.approx(12.0 * body.length_m, rel=0.1)
    twin.close()
    assert posture.roll_rad == pytest.approx(-2.0 * math.pi * 29.5, rel=0.02)
