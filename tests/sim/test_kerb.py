"""An obstacle in the robot's way: what happens at it follows from the mechanics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim.plan import make_plan
from sim.plant import Plant
from sim.rod import RodTwin
from sim.scene import Scene, scene_from
from sim.twins import make_twin, world_of
from softbot.errors import InputError

SPEED_M_S = 0.4


def rolling(severity: float, direction: float = 1.0) -> tuple[RodTwin, Plant]:
    """A straight tube that rolls freely towards its left (direction +1), before an obstacle that comes after 0.1 s."""
    scene = scene_from(
        {
            "robot": "default",
            "drive": {"kind": "sequencer"},
            "fault": [{"t_s": 0.1, "kind": "obstacle", "severity": severity}],
            "solver": {"twin": "rod", "accuracy": "fast"},
        },
        "kerb.toml",
        Path(),
    )
    twin = make_twin(scene)
    assert isinstance(twin, RodTwin)
    spin = -direction * SPEED_M_S / scene.robot.radius_m
    twin.throw(0.0, np.array([0.0, direction * SPEED_M_S, 0.0, spin, 0.0, 0.0]))
    return twin, Plant(scene.robot, twin, scene.fault, world_of(scene).gravity_vector_m_s2, 0)


def after(duration_s: float, twin: RodTwin, plant: Plant) -> np.ndarray:
    steps = round(0.01 / twin.step_s)
    for _ in range(round(duration_s / 0.01)):
        plant.advance(np.full(4, -1.0), False, steps)
    return twin.motion().centre_of_mass_m


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_tube_climbs_what_its_speed_carries_it_over(direction: float) -> None:
    twin, plant = rolling(0.05, direction)
    radius_m = plant.robot.radius_m
    start_m = after(0.3, *(flat := rolling(1e-4, direction)))
    over_m = after(0.3, twin, plant)
    assert over_m[2] - start_m[2] == pytest.approx(0.05 * radius_m, abs=0.01 * radius_m)
    assert direction * over_m[1] > 0.05
    assert flat[0].penetration_m < 0.01 * radius_m


def test_a_tube_is_thrown_back_by_a_kerb_as_high_as_its_middle() -> None:
    twin, plant = rolling(1.0)
    furthest_m = max(after(0.05, twin, plant)[1] for _ in range(12))
    riser_m = 0.1 * SPEED_M_S + 2.0 * plant.robot.radius_m
    assert furthest_m < riser_m - 0.9 * plant.robot.radius_m
    assert twin.motion().centre_of_mass_m[2] < 1.5 * plant.robot.radius_m


def test_there_is_no_kerb_before_its_time() -> None:
    twin, plant = rolling(1.0)
    assert after(0.09, twin, plant)[1] == pytest.approx(0.09 * SPEED_M_S, rel=0.05)
    assert make_plan(scene_of({"t_s": 1.0, "kind": "obstacle"})).scene.world.ground == "step"
    assert make_plan(scene_of({"t_s": 1.0, "kind": "payload"})).scene.world.ground == "plane"


def scene_of(*faults: dict[str, Any], twin: str = "rod", ground: str = "plane") -> Scene:
    table = {
        "robot": "default",
        "drive": {"kind": "sequencer"},
        "world": {"ground": ground},
        "fault": list(faults),
        "solver": {"twin": twin, "accuracy": "fast"},
    }
    return scene_from(table, "kerb.toml", Path())


KERB = {"t_s": 1.0, "kind": "obstacle", "severity": 0.5}


def test_two_obstacles_and_other_grounds_are_refused() -> None:
    with pytest.raises(InputError, match="there can be one of it"):
        make_plan(scene_of(KERB, KERB))
    with pytest.raises(InputError, match="'step'"):
        make_plan(scene_of(KERB, ground="step"))


@pytest.mark.parametrize("fields", [{"ramp_s": 1.0}, {"period_s": 1.0}])
def test_an_obstacle_neither_grows_nor_comes_and_goes(fields: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="leave both out"):
        make_plan(scene_of(KERB | fields))
