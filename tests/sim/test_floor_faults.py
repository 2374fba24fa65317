"""What faults make of the floor, on either twin: a straight tube that runs down a slope tells by how fast it gets.

A solid tube that rolls without slip gains ⅔ g sin β; one that slides g (sin β − µ cos β); a weight without inertia adds
its share to either.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim.plant import Plant
from sim.scene import scene_from
from sim.twins import make_twin, world_of
from softbot.errors import InputError

SLOPE_RAD, GRAVITY_M_S2, FRICTION = 0.2, 9.81, 0.6
ROLLS = 2.0 / 3.0 * GRAVITY_M_S2 * math.sin(SLOPE_RAD)
PERIOD_S = 0.01


@contextmanager
def on_a_slope(twin: str, *faults: dict[str, Any], heading_rad: float = math.pi / 2, **more: Any) -> Iterator[Plant]:
    table = {
        "robot": "default",
        "drive": {"kind": "sequencer"},
        "world": {"slope_rad": SLOPE_RAD, "slope_heading_rad": heading_rad, "friction": FRICTION},
        "fault": list(faults),
        "solver": {"twin": twin, "accuracy": "fast"},
    } | more
    scene = scene_from(table, "slope.toml", Path())
    made = make_twin(scene)
    try:
        yield Plant(scene.robot, made, scene.fault, world_of(scene).gravity_vector_m_s2, 0)
    finally:
        made.close()


def run(plant: Plant, duration_s: float) -> tuple[float, float]:
    """Speed of the middle to the left [m/s], and its spin [rad/s], after the time."""
    for _ in range(round(duration_s / PERIOD_S)):
        plant.advance(np.full(4, -1.0), False, round(PERIOD_S / plant.twin.step_s))
    motion = plant.motion
    return float(motion.mid_velocity_m_s[1]), float(motion.angular_velocity_rad_s[0])


TWINS = pytest.mark.parametrize("twin", ["rod", "bullet"])


@TWINS
@pytest.mark.parametrize("lost", [0.0, 0.95, 1.0])
def test_a_tube_slides_down_a_slope_as_fast_as_what_is_left_of_the_friction_lets_it(twin: str, lost: float) -> None:
    faults = [{"t_s": 0.0, "kind": "friction_lost", "severity": lost}] if lost else []
    with on_a_slope(twin, *faults) as plant:
        speed_m_s, spin_rad_s = run(plant, 0.2)
    friction = (1.0 - lost) * FRICTION
    slides = GRAVITY_M_S2 * (math.sin(SLOPE_RAD) - friction * math.cos(SLOPE_RAD))
    assert speed_m_s == pytest.approx(0.2 * (slides if lost else ROLLS), rel=0.03)
    # friction at the skin turns the tube: R ω̇ = 2 µ g cos β, until it rolls
    skin_m_s = 0.2 * (2.0 * friction * GRAVITY_M_S2 * math.cos(SLOPE_RAD) if lost else ROLLS)
    assert -spin_rad_s * plant.robot.radius_m == pytest.approx(skin_m_s, rel=0.05, abs=1e-3)


@TWINS
def test_more_friction_holds_on_a_slope_that_less_does_not(twin: str) -> None:
    scant = {"slope_rad": SLOPE_RAD, "friction": 0.3 * math.tan(SLOPE_RAD)}
    with on_a_slope(twin, world=scant) as plant:
        slid_m_s, _ = run(plant, 0.2)
    with on_a_slope(twin, {"t_s": 0.0, "kind": "friction_high", "severity": 0.5}, world=scant) as plant:
        rolled_m_s, _ = run(plant, 0.2)
    assert slid_m_s == pytest.approx(0.2 * 0.7 * GRAVITY_M_S2 * math.sin(SLOPE_RAD), rel=0.03)
    assert rolled_m_s == pytest.approx(0.2 * ROLLS, rel=0.03)


@TWINS
def test_a_weight_without_inertia_pulls_a_tube_down_faster(twin: str) -> None:
    with on_a_slope(twin, {"t_s": 0.0, "kind": "payload", "severity": 0.5}) as plant:
        speed_m_s, _ = run(plant, 0.2)
    assert speed_m_s == pytest.approx(1.5 * 0.2 * ROLLS, rel=0.03)


@TWINS
def test_a_floor_that_is_lost_for_a_while_holds_again(twin: str) -> None:
    with on_a_slope(
        twin, {"t_s": 0.0, "kind": "friction_lost", "severity": 1.0, "period_s": 1.0, "duty": 0.1}
    ) as plant:
        before_m_s, _ = run(plant, 0.1)
        after_m_s, spin_rad_s = run(plant, 0.2)
    assert before_m_s == pytest.approx(0.1 * GRAVITY_M_S2 * math.sin(SLOPE_RAD), rel=0.03)
    assert after_m_s == pytest.approx(-spin_rad_s * plant.robot.radius_m, rel=0.03)


@TWINS
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_kerb_as_high_as_its_middle_stops_a_tube(twin: str, side: float) -> None:
    strikes_s = 0.2
    with on_a_slope(
        twin, {"t_s": strikes_s, "kind": "obstacle", "severity": 1.0}, heading_rad=side * math.pi / 2
    ) as plant:
        radius_m = plant.robot.radius_m
        run(plant, strikes_s)
        was_m = side * plant.motion.centre_of_mass_m[1]
        speed_m_s, _ = run(plant, 1.0)
        place_m = side * plant.motion.centre_of_mass_m[1]
    assert was_m == pytest.approx(0.5 * ROLLS * strikes_s**2, rel=0.05)
    assert place_m == pytest.approx(was_m + radius_m, abs=0.05 * radius_m)  # its skin came to a riser a radius ahead
    assert abs(speed_m_s) < 0.05


def test_both_twins_climb_a_low_kerb() -> None:
    heights = []
    for twin in ("rod", "bullet"):
        with on_a_slope(twin, {"t_s": 0.2, "kind": "obstacle", "severity": 0.05}) as plant:
            run(plant, 0.5)
            assert plant.motion.mid_velocity_m_s[1] > 0.3
            heights.append(plant.motion.centre_of_mass_m[2] / plant.robot.radius_m)
    assert heights == pytest.approx([1.05, 1.05], abs=0.02)


@TWINS
def test_with_other_bodies_about_the_floor_stays_as_it_is(twin: str) -> None:
    ball = {"kind": "sphere", "radius_m": 0.02, "position_m": [0.0, 1.0, 0.02], "mass_kg": 0.1}
    flat = {"friction": FRICTION}
    with (
        pytest.raises(InputError, match="leave the other bodies out"),
        on_a_slope(twin, {"t_s": 1.0, "kind": "friction_lost"}, body=[ball], world=flat),
    ):
        pass
