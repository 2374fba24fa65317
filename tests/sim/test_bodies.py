"""The `[[body]]` tables: sizes, masses and places, where a body stands, how far points are from it, refusals."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.bodies import BOX, CYLINDER, SPHERE, OtherBody, names_of, signed_distance
from sim.body import World
from sim.scene import Scene, scene_from
from softbot.errors import InputError

FLOOR = World(9.81, "plane", 0.6, "coulomb")
STEP = World(9.81, "step", 0.6, "coulomb", step_height_m=0.01, step_distance_m=-0.1)
BOX_TABLE = {"kind": "box", "size_m": [0.04, 0.02, 0.06], "mass_kg": 0.05, "position_m": [0.0, 0.1]}
BALL_TABLE = {"kind": "sphere", "radius_m": 0.02, "mass_kg": 0.03, "position_m": [0.0, 0.1]}
CAN_TABLE = {"kind": "cylinder", "radius_m": 0.02, "length_m": 0.1, "mass_kg": 0.1, "position_m": [0.0, 0.1]}

ENGINES_LOADED = "import sys, sim.bodies; print([m for m in ('numba', 'pybullet', 'scipy') if m in sys.modules])"

coordinate = st.floats(-0.2, 0.2)
half_size = st.floats(0.01, 0.1)


@pytest.fixture
def make(scene_table: dict[str, Any]) -> Any:
    """A scene with bodies, and what more is to be changed."""

    def scene(*bodies: dict[str, Any], **more: Any) -> Scene:
        return scene_from({**scene_table, "body": list(bodies), **more}, "scene.toml", Path())

    return scene


# --- geometry ------------------------------------------------------------


def surface_points(code: int, size: np.ndarray) -> np.ndarray:
    """Many points of the surface of a body, its own axes."""
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(20_000, 3))
    if code == SPHERE:
        return size[0] * direction / np.linalg.norm(direction, axis=1)[:, None]
    if code == BOX:
        on_cube = direction / np.abs(direction).max(axis=1)[:, None]
        inside = rng.uniform(-1, 1, (20_000, 3))
        face = np.abs(on_cube) == 1.0
        return np.where(face, on_cube, inside) * size
    angle, height = rng.uniform(0, 2 * math.pi, 20_000), rng.uniform(-1, 1, 20_000)
    radius = np.where(rng.random(20_000) < 0.5, 1.0, np.sqrt(rng.random(20_000)))
    height = np.where(radius < 1.0, np.sign(height), height)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height]) * size


@pytest.mark.parametrize("code", [BOX, SPHERE, CYLINDER])
@given(x=coordinate, y=coordinate, z=coordinate, a=half_size, c=half_size)
def test_distance_is_that_of_the_nearest_surface_point_and_its_slope_the_normal(
    code: int, x: float, y: float, z: float, a: float, c: float
) -> None:
    size = np.array([a, a, a] if code == SPHERE else [a, a, c])
    distance, *normal = signed_distance(code, *size, x, y, z)
    away = np.linalg.norm(surface_points(code, size) - [x, y, z], axis=1).min()
    assert abs(distance) == pytest.approx(away, abs=0.004)  # of 20 000 random points the nearest is not far
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    ahead, *_ = signed_distance(code, *size, *(np.array([x, y, z]) + 1e-7 * np.array(normal)))
    assert ahead - distance == pytest.approx(1e-7, rel=1e-3)


@pytest.mark.parametrize(
    ("axis", "reach"), [("z", (0.02, 0.02, 0.05)), ("x", (0.05, 0.02, 0.02)), ("y", (0.02, 0.05, 0.02))]
)
def test_cylinder_lies_along_its_axis(axis: str, reach: tuple[float, ...]) -> None:
    can = OtherBody(**{**CAN_TABLE, "axis": axis})
    assert can.reach_m == pytest.approx(reach)
    assert can.centre_m(FLOOR) == pytest.approx((0.0, 0.1, reach[2]))
    tip = np.array([0.0, 0.1, reach[2]]) + np.eye(3)["xyz".index(axis)] * 0.06
    assert can.distance_m(can.centre_m(FLOOR), tuple(tip)) == pytest.approx(0.01)


def test_heading_turns_a_body_about_the_vertical() -> None:
    box = OtherBody(**{**BOX_TABLE, "heading_rad": math.pi / 2})
    assert box.reach_m == pytest.approx((0.01, 0.02, 0.03))
    lying = OtherBody(**{**CAN_TABLE, "axis": "x", "heading_rad": math.pi / 6})
    beyond = (0.06 * math.cos(math.pi / 6), 0.1 + 0.06 * math.sin(math.pi / 6), 0.02)
    assert lying.distance_m(lying.centre_m(FLOOR), beyond) == pytest.approx(0.01)


@pytest.mark.parametrize("table", [BOX_TABLE, BALL_TABLE, CAN_TABLE])
def test_volume_and_inertia_are_those_of_the_solid(table: dict[str, Any]) -> None:
    body = OtherBody(**table)
    points = np.random.default_rng(2).uniform(-1, 1, (40_000, 3)) * body.half_size_m
    inside = points[[signed_distance(body.code, *body.half_size_m, *point)[0] <= 0.0 for point in points]]
    around = 8.0 * math.prod(body.half_size_m)
    assert body.volume_m3 == pytest.approx(around * len(inside) / len(points), rel=0.02)
    squares = (inside**2).mean(axis=0)
    expected = body.kilograms * (squares.sum() - squares)
    assert body.inertia_kg_m2 == pytest.approx(expected, rel=0.03)


def test_body_stands_on_what_is_under_it() -> None:
    before, beyond = {**BOX_TABLE, "position_m": [0.0, 0.3]}, {**BOX_TABLE, "position_m": [0.0, -0.3]}
    assert OtherBody(**before).centre_m(STEP)[2] == pytest.approx(0.03)
    assert OtherBody(**beyond).centre_m(STEP)[2] == pytest.approx(0.04)
    placed = OtherBody(**{**BOX_TABLE, "position_m": [0.0, 0.3, 0.5]})
    assert placed.centre_m(World(9.81, "none", 0.0, "coulomb")) == (0.0, 0.3, 0.5)


# --- tables ------------------------------------------------------------


def test_bodies_of_a_scene_go_there_and_back(make: Any) -> None:
    scene = make(BOX_TABLE, {**BALL_TABLE, "name": "ball", "position_m": [0.3, 0.1, 0.4]})
    assert names_of(scene.body) == ["box-0", "ball"]
    again = scene_from(scene.table(), "scene.toml", Path())
    assert again.body == scene.body


def test_scene_without_bodies_has_no_such_table(make: Any) -> None:
    assert "body" not in make().table()


def test_mass_of_zero_or_fixed_makes_an_obstacle() -> None:
    for table in ({**BOX_TABLE, "mass_kg": 0}, {**BOX_TABLE, "fixed": True}):
        wall = OtherBody(**table)
        assert wall.is_fixed
        assert wall.kilograms == 0.0
        assert wall.inertia_kg_m2 == (0.0, 0.0, 0.0)


def test_fixed_obstacle_may_be_let_into_the_floor(make: Any) -> None:
    bump = {"kind": "cylinder", "radius_m": 0.02, "length_m": 0.4, "axis": "x", "fixed": True}
    scene = make({**bump, "position_m": [0.0, 0.1, -0.012]})
    assert scene.body[0].centre_m(scene.world)[2] == -0.012


def test_describing_bodies_loads_no_engine() -> None:
    done = subprocess.run([sys.executable, "-c", ENGINES_LOADED], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


REFUSALS: list[tuple[dict[str, Any], str]] = [
    ({"size_m": None}, r"body\.0.*: size_m: missing; add it"),
    ({"radius_m": 0.1}, r"body\.0.*: radius_m: remove it; a box has size_m"),
    ({"size_m": [0.04, 0.02, 500.0]}, r"size_m = 500: a body measures 0\.001 … 100 m each way"),
    ({"size_m": [0.04, 0.02, 1e-5]}, r"size_m = 1e-05: a body measures"),
    ({"size_m": [0.04, 0.02]}, r"body\.0\.size_m"),
    ({"axis": "x"}, r"axis: remove it; only a cylinder has one"),
    ({"mass_kg": None}, r"mass_kg: missing; add it, or fixed = true"),
    ({"mass_kg": 50.0}, r"mass_kg = 50: 1\.04e\+06 kg/m³ for its size.*check mass and size"),
    ({"mass_kg": 1e-6}, r"mass_kg = 1e-06: 0\.0208 kg/m³"),
    ({"fixed": True, "velocity_m_s": [0, 0.1, 0]}, r"velocity_m_s: remove it, or give the body a mass"),
    ({"velocity_m_s": [0, 50, 0]}, r"velocity_m_s = \[0\.0, 50\.0, 0\.0\]: at most 10 m/s"),
    ({"position_m": [0.0]}, r"body\.0\.position_m"),
    ({"position_m": [0.0, 5e3]}, r"position_m = \[0\.0, 5000\.0\]: each within ±1000 m"),
    ({"position_m": [0.0, 0.01]}, r"body\.0\.position_m = \[0\.0, 0\.01\]: box-0 overlaps the robot.*away by 0\.01 m"),
    ({"position_m": [0.0, 0.1, 0.01]}, r"reaches 0\.02 m below the floor; raise its centre to 0\.03"),
    ({"position_m": [0.0, 0.1, -1.0], "fixed": True}, r"wholly below the floor"),
    ({"friction": -0.1}, r"body\.0\.friction = -0\.1"),
    ({"weight_kg": 0.1}, r"body\.0\.weight_kg: unknown key"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "message"), REFUSALS)
def test_refusals_name_the_key_and_the_mend(make: Any, change: dict[str, Any], message: str) -> None:
    table = {key: value for key, value in {**BOX_TABLE, **change}.items() if value is not None}
    with pytest.raises(InputError, match=message):
        make(table)


def test_two_bodies_of_one_name_are_refused(make: Any) -> None:
    with pytest.raises(InputError, match=r'body\.1\.name = "box-0": body\.0 has that name'):
        make(BOX_TABLE, {**BALL_TABLE, "name": "box-0"})


@pytest.mark.parametrize("ground", ["pipe", "none"])
def test_without_a_flat_floor_the_height_has_to_be_said(make: Any, ground: str) -> None:
    with pytest.raises(InputError, match=rf'write \[x, y, z\]; with world\.ground = "{ground}"'):
        make(BOX_TABLE, world={"ground": ground})
    make({**BOX_TABLE, "position_m": [0.0, 0.3, 0.2]}, world={"ground": ground})


def test_body_that_reaches_into_a_step_is_refused(make: Any) -> None:
    world = {"ground": "step", "step_height_m": 0.02, "step_distance_m": 0.1}
    with pytest.raises(InputError, match=r"reaches 0\.02 m below the floor; raise its centre to 0\.05"):
        make({**BOX_TABLE, "position_m": [0.0, 0.095, 0.03]}, world=world)


def test_equilibrium_among_bodies_is_refused(make: Any) -> None:
    with pytest.raises(InputError, match=r'solver\.question = "equilibrium": is answered for a robot alone'):
        make(BOX_TABLE, solver={"question": "equilibrium"})


def test_robot_that_starts_inside_the_step_is_refused(make: Any) -> None:
    with pytest.raises(InputError, match=r"world\.step_distance_m = 0\.005: the robot starts inside the step"):
        make(world={"ground": "step", "step_distance_m": 0.005})
