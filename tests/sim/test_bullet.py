"""The segment twin: momentum, rest on the floor, signs, drag, stretch, and what it refuses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pybullet
import pytest

from sim import bullet
from sim.bodies import OtherBody
from sim.body import Body, World
from sim.bullet import BulletTwin
from sim.trajectory import Trajectory
from softbot.errors import InputError, SimulationError
from softbot.rolling import floating_ratio

BODY = Body(0.15, 0.01, 0.0518, 3.93e-3, 2.62e-3, 500.0, 0.02)
FLOOR = World(9.81, "plane", 0.6, "coulomb")
FLOATING = World(0.0, "none", 0.6, "coulomb")
STIFFNESS = BODY.rest_stiffness()
STRAIGHT = np.array([1.0, 0.0, 0.0])
WALL = {"kind": "box", "size_m": [0.4, 0.04, 0.04], "position_m": [0.0, 0.08], "fixed": True}
CRATE = {"kind": "box", "size_m": [0.2, 0.04, 0.04], "position_m": [0.0, 0.06], "mass_kg": 0.05, "friction": 0.2}

MakeTwin = Callable[..., BulletTwin]


@pytest.fixture
def make_twin() -> Iterator[MakeTwin]:
    """A twin of the test robot that is closed when the test is over."""
    made: list[BulletTwin] = []

    def make(world: World, *, body: Body = BODY, **changes: Any) -> BulletTwin:
        made.append(BulletTwin(body, world, **{"segments": 10, "step_s": 0.004, "stretches": False, **changes}))
        return made[-1]

    yield make
    for twin in made:
        twin.close()


def curved(angle_rad: float, size_1_m: float = 12.0) -> np.ndarray:
    return np.array([1.0, size_1_m * math.cos(angle_rad), size_1_m * math.sin(angle_rad)])


def settle(twin: BulletTwin, strain: np.ndarray, seconds: float, ramp_s: float = 0.2) -> None:
    """From straight to a rest strain over `ramp_s`, then held until `seconds` are over."""
    straight = np.array([1.0, 0.0, 0.0])
    for n in range(round(seconds / twin.step_s)):
        share = min((n + 1) * twin.step_s / ramp_s, 1.0) if ramp_s else 1.0
        twin.set_rest(straight + share * (strain - straight), STIFFNESS)
        twin.step()


def turn(
    twin: BulletTwin, seconds: float, period_s: float, trajectory: Trajectory | None = None, first_rad: float = 0.0
) -> None:
    """Turn the wanted curvature once a period, right-handed for a positive one."""
    for n in range(round(seconds / twin.step_s)):
        twin.set_rest(curved(first_rad + 2.0 * math.pi * (n + 1) * twin.step_s / period_s), STIFFNESS)
        twin.step()
        if trajectory is not None:
            trajectory.follow(twin.motion())


# --- afloat ------------------------------------------------------------


def test_floating_robot_makes_no_momentum_and_turns_as_angular_momentum_demands(make_twin: MakeTwin) -> None:
    twin = make_twin(FLOATING)
    settle(twin, curved(0.0), 0.5)
    trajectory = Trajectory(BODY.length_m, grounded=False)
    trajectory.follow(twin.motion())
    centre = twin.motion().centre_of_mass_m
    turn(twin, 2.0, 2.0, trajectory)
    posture, motion = trajectory.follow(twin.motion()), twin.motion()
    assert np.linalg.norm(motion.angular_momentum_kg_m2_s) < 1e-6
    np.testing.assert_allclose(motion.centre_of_mass_m, centre, atol=1e-3)
    ratio = posture.plane_rotation_rad / (2.0 * math.pi)
    assert ratio == pytest.approx(floating_ratio(BODY.length_m, BODY.radius_m, 12.0), rel=0.06)
    assert ratio > 0.0  # against the rolling of the material, which for this direction is negative
    assert posture.roll_rad == pytest.approx(-2.0 * math.pi, rel=0.02)


def test_floating_robot_falls_freely_under_gravity(make_twin: MakeTwin) -> None:
    twin = make_twin(World(9.81, "none", 0.0, "coulomb"))
    settle(twin, curved(0.5, 8.0), 0.4)
    assert twin.motion().mid_velocity_m_s[2] == pytest.approx(-9.81 * 0.4, rel=0.02)
    assert twin.motion().centre_of_mass_m[2] == pytest.approx(-0.5 * 9.81 * 0.4**2, rel=0.03)


# --- on the floor ------------------------------------------------------------


@pytest.mark.parametrize(("stretches", "curvature_1_m"), [(False, 0.0), (False, 12.0), (True, 6.0)])
def test_robot_rests_on_the_floor_and_hardly_sinks_in(
    make_twin: MakeTwin, stretches: bool, curvature_1_m: float
) -> None:
    twin = make_twin(FLOOR, stretches=stretches)
    settle(twin, curved(0.0, curvature_1_m), 1.0)
    points, axes = twin.shape()
    sunk = BODY.radius_m - points[:, 2]
    assert np.all(np.abs(sunk) < 0.03 * BODY.radius_m)
    assert np.linalg.norm(twin.motion().mid_velocity_m_s) < 1e-3
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0, atol=1e-9)
    # friction holds the bend back a little, and holds it where it was laid
    assert np.hypot(*twin.motion().curvature_1_m) == pytest.approx(curvature_1_m, rel=0.08, abs=1e-3)


def test_robot_starts_straight_along_x_with_chamber_0_to_its_left(make_twin: MakeTwin) -> None:
    motion = make_twin(FLOOR).motion()
    np.testing.assert_allclose(motion.rotation, np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]), atol=1e-9)
    np.testing.assert_allclose(motion.chord, [1.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(motion.centre_of_mass_m, [0.0, 0.0, BODY.radius_m], atol=1e-9)


@pytest.mark.parametrize("degrees", [0.0, 180.0])
def test_robot_bends_towards_the_wanted_side(make_twin: MakeTwin, degrees: float) -> None:
    """Curvature towards e1 (left, +y): the ends go to the left of the middle."""
    twin = make_twin(FLOOR)
    settle(twin, curved(math.radians(degrees)), 0.5)
    points = twin.shape()[0]
    middle, ends = points[len(points) // 2], 0.5 * (points[0] + points[-1])
    towards = (ends - middle)[1]
    assert towards * math.cos(math.radians(degrees)) > 0.02
    direction = math.atan2(*twin.motion().curvature_1_m[::-1])
    assert math.cos(direction - math.radians(degrees)) > 0.999


def test_direction_plus_one_rolls_negatively_to_the_left_and_minus_one_is_its_mirror(make_twin: MakeTwin) -> None:
    moved, rolled = {}, {}
    for direction in (1, -1):
        twin = make_twin(FLOOR)
        settle(twin, curved(0.0), 0.5)
        trajectory = Trajectory(BODY.length_m, grounded=True)
        start_rad = trajectory.follow(twin.motion()).roll_rad
        start = twin.motion().centre_of_mass_m
        turn(twin, 2.0, direction * 1.0, trajectory)
        moved[direction] = twin.motion().centre_of_mass_m - start
        rolled[direction] = trajectory.follow(twin.motion()).roll_rad - start_rad
    assert rolled[1] == pytest.approx(-4.0 * math.pi, rel=0.02)
    assert moved[1][1] == pytest.approx(0.94 * 4.0 * math.pi * BODY.radius_m, rel=0.15)  # +y, left
    assert rolled[-1] == pytest.approx(-rolled[1], rel=0.02)
    assert moved[-1][1] == pytest.approx(-moved[1][1], rel=0.1)


@pytest.mark.parametrize("period_s", [1.0, 0.5])
def test_turning_robot_stays_on_the_floor_and_bent_at_4_ms(make_twin: MakeTwin, period_s: float) -> None:
    twin = make_twin(FLOOR)
    settle(twin, curved(0.0), 0.5)
    for _ in range(4):
        turn(twin, 0.5, period_s)
        motion = twin.motion()
        assert np.hypot(*motion.curvature_1_m) == pytest.approx(12.0, rel=0.1)
        assert abs(motion.centre_of_mass_m[2] - BODY.radius_m) < 0.1 * BODY.radius_m


@pytest.mark.parametrize("friction_law", ["coulomb", "viscous"])
def test_sudden_bend_is_taken_calmly(make_twin: MakeTwin, friction_law: str) -> None:
    twin = make_twin(World(9.81, "plane", 0.6, friction_law), step_s=0.005)
    settle(twin, curved(0.5), 0.6, ramp_s=0.0)
    motion = twin.motion()
    assert np.hypot(*motion.curvature_1_m) == pytest.approx(12.0, rel=0.1)
    assert abs(motion.centre_of_mass_m[2] - BODY.radius_m) < 0.1 * BODY.radius_m
    assert np.linalg.norm(motion.mid_velocity_m_s) < 0.1


def test_smooth_floor_gives_no_advance(make_twin: MakeTwin) -> None:
    twin = make_twin(World(9.81, "plane", 0.0, "coulomb"))
    settle(twin, curved(0.0), 0.5)
    start = twin.motion().centre_of_mass_m
    turn(twin, 1.0, 1.0)
    moved = np.linalg.norm((twin.motion().centre_of_mass_m - start)[:2])
    assert moved < 0.15 * 2.0 * math.pi * BODY.radius_m


# --- viscous floor ------------------------------------------------------------


def test_viscous_floor_slows_a_sliding_robot_as_its_coefficient_says(make_twin: MakeTwin) -> None:
    """m v' = −c L v for a straight robot along its axis: v = v0·exp(−cLt/m), whatever the load."""
    coefficient = 2.0  # N s/m²
    twin = make_twin(World(9.81, "plane", coefficient, "viscous"))
    settle(twin, curved(0.0, 0.0), 0.1)
    pybullet.resetBaseVelocity(twin._robot, [0.5, 0.0, 0.0], [0.0, 0.0, 0.0], physicsClientId=twin._client)
    twin._read_state()
    times, speeds = [], []
    for n in range(30):
        times.append(n * twin.step_s)
        speeds.append(twin.motion().mid_velocity_m_s[0])
        twin.step()
    rate = -np.polyfit(times, np.log(speeds), 1)[0]
    assert rate == pytest.approx(coefficient * BODY.length_m / BODY.mass_kg, rel=0.05)


@pytest.mark.parametrize("stretches", [False, True])
def test_viscous_floor_rolls_the_robot_the_same_way(make_twin: MakeTwin, stretches: bool) -> None:
    twin = make_twin(World(9.81, "plane", 20.0, "viscous"), stretches=stretches, segments=6)
    settle(twin, curved(0.0), 0.3)
    start = twin.motion().centre_of_mass_m
    turn(twin, 1.0, 1.0)
    advance = (twin.motion().centre_of_mass_m - start)[1] / (2.0 * math.pi * BODY.radius_m)
    assert advance == pytest.approx(math.sin(0.9) / 0.9, rel=0.12)


def test_viscous_drag_is_felt_only_by_what_touches(make_twin: MakeTwin) -> None:
    twin = make_twin(World(0.0, "plane", 50.0, "viscous"))
    pybullet.resetBasePositionAndOrientation(
        twin._robot, [0.0, 0.0, 0.5], [0.5, 0.5, 0.5, 0.5], physicsClientId=twin._client
    )
    pybullet.resetBaseVelocity(twin._robot, [0.1, 0.0, 0.0], [0.0, 0.0, 0.0], physicsClientId=twin._client)
    twin._read_state()
    settle(twin, curved(0.0, 0.0), 0.1)
    assert twin.motion().mid_velocity_m_s[0] == pytest.approx(0.1, rel=1e-3)


# --- stretch, coupling, shapes ------------------------------------------------------------


def test_stretching_robot_lengthens_to_its_rest_stretch(make_twin: MakeTwin) -> None:
    twin = make_twin(FLOATING, stretches=True)
    settle(twin, np.array([1.15, 0.0, 0.0]), 1.0)
    assert twin.motion().stretch == pytest.approx(1.15, abs=1e-3)
    points = twin.shape()[0]
    assert np.linalg.norm(points[-1] - points[0]) == pytest.approx(1.15 * BODY.length_m, rel=2e-3)
    settle(twin, np.array([1.0, 0.0, 0.0]), 1.0)
    assert twin.motion().stretch == pytest.approx(1.0, abs=1e-3)


def test_robot_without_stretch_keeps_its_length(make_twin: MakeTwin) -> None:
    twin = make_twin(FLOATING)
    settle(twin, np.array([1.15, 0.0, 0.0]), 0.2)
    assert twin.motion().stretch == 1.0


def test_curvature_of_any_direction_is_held_by_a_stiffness_with_a_preferred_axis(make_twin: MakeTwin) -> None:
    stiffness = np.array([[500.0, 0.1, 0.05], [0.1, 4e-3, 5e-4], [0.05, 5e-4, 3e-3]])
    twin = make_twin(FLOATING, stretches=True)
    for n in range(125):
        twin.set_rest(np.array([1.0, 7.0 * n / 124, -5.0 * n / 124]), stiffness)
        twin.step()
    for _ in range(125):
        twin.step()
    np.testing.assert_allclose(twin.motion().curvature_1_m, [7.0, -5.0], rtol=0.02)


def test_among_other_bodies_the_robot_is_a_capsule_chain_that_rests_on_the_floor(make_twin: MakeTwin) -> None:
    twin = make_twin(FLOOR, bodies=[OtherBody(**WALL)], stretches=True)
    settle(twin, np.array([1.0, 0.0, 0.0]), 0.5)
    assert abs(twin.motion().centre_of_mass_m[2] - BODY.radius_m) < 0.1 * BODY.radius_m
    shapes = [part[2] for part in pybullet.getCollisionShapeData(twin._robot, -1, physicsClientId=twin._client)]
    assert shapes == [pybullet.GEOM_CAPSULE]


# --- slopes, steps, pipes, resistance ------------------------------------------------------------


@pytest.mark.parametrize(("degrees", "holds"), [(20.0, True), (35.0, False)])
def test_straight_robot_slides_along_itself_down_a_slope_beyond_the_friction_angle(
    make_twin: MakeTwin, degrees: float, holds: bool
) -> None:
    slope = math.radians(degrees)  # the friction angle of 0.6 is 31°
    twin = make_twin(World(9.81, "plane", 0.6, "coulomb", slope_rad=slope, slope_heading_rad=0.0))
    settle(twin, STRAIGHT, 0.5)
    slid_m = 0.0 if holds else 0.5 * 9.81 * (math.sin(slope) - 0.6 * math.cos(slope)) * 0.5**2
    assert twin.motion().centre_of_mass_m[0] == pytest.approx(slid_m, abs=2e-5, rel=0.03)


@pytest.mark.parametrize("share", [0.0, 0.9, 1.1])
def test_rolling_resistance_is_the_moment_that_rolling_has_to_overcome(make_twin: MakeTwin, share: float) -> None:
    """Down a slope the moment is m g R sin(slope), and a full tube rolls at two thirds of what is left of it."""
    slope = math.radians(10.0)
    downhill = 9.81 * math.sin(slope)
    resistance_N_m = share * BODY.mass_kg * downhill * BODY.radius_m
    world = World(9.81, "plane", 0.6, "coulomb", slope_rad=slope, rolling_resistance_N_m=resistance_N_m)
    twin = make_twin(world, step_s=0.002)
    settle(twin, STRAIGHT, 0.5)
    rolled_m = 0.5 * max(0.0, 1.0 - share) * downhill / 1.5 * 0.5**2
    assert twin.motion().centre_of_mass_m[1] == pytest.approx(rolled_m, rel=0.08, abs=2e-5)


def test_step_is_climbed_where_it_is_low_and_stops_the_robot_where_it_is_high(make_twin: MakeTwin) -> None:
    heights = {}
    for step_height_m in (0.001, 0.03):
        world = World(9.81, "step", 0.6, "coulomb", step_height_m=step_height_m, step_distance_m=0.03)
        twin = make_twin(world, step_s=0.0025)
        settle(twin, curved(0.0), 0.5)
        turn(twin, 2.0, 1.0)
        heights[step_height_m] = twin.motion().centre_of_mass_m
    assert heights[0.001][2] == pytest.approx(0.011, abs=0.0005)
    assert heights[0.001][1] > 0.07
    assert heights[0.03][1] < 0.03 - BODY.radius_m + 0.001


@pytest.mark.parametrize(("axis", "stays"), [("across", True), ("along", False)])
def test_straight_robot_lies_across_a_pipe_and_rolls_off_one_along_it(
    make_twin: MakeTwin, axis: str, stays: bool
) -> None:
    world = World(9.81, "pipe", 0.6, "coulomb", pipe_radius_m=0.05, pipe_axis=axis)
    body = Body(0.15, 0.01, 0.0518, 0.5, 0.4, 500.0, 0.02)  # stiff: it does not hang down
    twin = make_twin(world, body=body, step_s=0.0025)
    twin.set_rest(STRAIGHT, body.rest_stiffness())
    pybullet.resetBaseVelocity(twin._robot, [0.0, 0.05, 0.0], [-5.0, 0.0, 0.0], physicsClientId=twin._client)
    twin._read_state()
    for _ in range(160):
        twin.step()
    centre = twin.motion().centre_of_mass_m
    assert centre[1] > 0.015
    if stays:
        assert centre[2] == pytest.approx(BODY.radius_m, abs=0.05 * BODY.radius_m)
    else:
        assert centre[2] < 0.5 * BODY.radius_m


@pytest.mark.parametrize(
    "changes",
    [
        {"ground": "pipe", "pipe_radius_m": 0.1, "pipe_axis": "along"},
        {"ground": "pipe", "pipe_radius_m": 0.1, "pipe_axis": "across"},
        {"ground": "step", "step_height_m": 0.003, "step_distance_m": -0.1},
    ],
)
def test_viscous_drag_lies_in_the_ground_whatever_its_shape(make_twin: MakeTwin, changes: dict[str, Any]) -> None:
    """Sliding along itself a straight robot is slowed by the whole of it, or by what lies on the pipe."""
    twin = make_twin(World(9.81, friction=2.0, friction_law="viscous", **changes), step_s=0.0025)
    settle(twin, STRAIGHT, 0.02)
    twin._viscous_drag()
    touching = 1.0 if changes.get("pipe_axis") != "across" else 2.0 / twin._segments  # its middle two
    assert twin._drag[0, 0] == pytest.approx(2.0 * BODY.length_m * touching, rel=0.01)
    assert twin._drag[2, 2] < 1e-2 * twin._drag[0, 0]


# --- other bodies ------------------------------------------------------------


def test_rolling_segments_push_a_box_and_stop_at_a_wall(make_twin: MakeTwin) -> None:
    for table, moves in ((CRATE, True), (WALL, False)):
        twin = make_twin(FLOOR, bodies=[OtherBody(**table)])
        settle(twin, curved(0.0), 0.5)
        turn(twin, 2.0, 1.0)
        ((name, place, quaternion),) = twin.bodies()
        assert name == "box-0"
        assert np.linalg.norm(quaternion) == pytest.approx(1.0)
        assert (place[1] > table["position_m"][1] + 0.02) == moves
        points, _ = twin.shape()
        assert points[:, 1].max() < place[1] - 0.02 - 0.8 * BODY.radius_m


def test_body_alone_feels_its_own_friction(make_twin: MakeTwin) -> None:
    """Sliding at 0.5 m/s it stops after v²/(2µg), whatever the robot's friction is."""
    sliding = {**CRATE, "position_m": [0.0, 0.3], "velocity_m_s": [0.0, 0.5, 0.0]}
    for friction in (0.6, 0.05):
        twin = make_twin(World(9.81, "plane", friction, "coulomb"), bodies=[OtherBody(**sliding)])
        settle(twin, STRAIGHT, 0.5)
        assert twin.bodies()[0][1][1] - 0.3 == pytest.approx(0.25 / (2.0 * 0.2 * 9.81), rel=0.03)


def test_box_that_hits_a_floating_robot_hands_over_its_momentum(make_twin: MakeTwin) -> None:
    space = World(0.0, "none", 0.0, "coulomb")
    box = {**CRATE, "position_m": [0.0, 0.06, 0.0], "velocity_m_s": [0.0, -0.3, 0.0]}
    twin = make_twin(space, bodies=[OtherBody(**box)], step_s=0.002)
    settle(twin, STRAIGHT, 0.4)
    before, box_before = twin.motion().centre_of_mass_m, np.array(twin.bodies()[0][1])
    settle(twin, STRAIGHT, 0.1)
    robot_N_s = BODY.mass_kg * (twin.motion().centre_of_mass_m - before) / 0.1
    box_N_s = 0.05 * (np.array(twin.bodies()[0][1]) - box_before) / 0.1
    assert robot_N_s[1] < -0.3 * 0.3 * 0.05
    assert robot_N_s[1] + box_N_s[1] == pytest.approx(-0.05 * 0.3, rel=0.03)


# --- refusals ------------------------------------------------------------


def test_rolling_resistance_without_a_load_is_refused(make_twin: MakeTwin) -> None:
    with pytest.raises(InputError, match=r'rolling_resistance_N_m = 0\.001: .* solver\.twin = "rod"'):
        make_twin(World(0.0, "plane", 0.6, "coulomb", rolling_resistance_N_m=1e-3))


def test_bodies_inside_each_other_are_refused(make_twin: MakeTwin) -> None:
    with pytest.raises(InputError, match=r"box-1 starts .* m inside body\.0 \(box-0\)"):
        make_twin(FLOOR, bodies=[OtherBody(**WALL), OtherBody(**CRATE)])


def test_absurd_command_is_a_simulation_error_and_not_a_number(make_twin: MakeTwin) -> None:
    twin = make_twin(FLOOR, segments=2)
    with pytest.raises(SimulationError, match="use a smaller step, more segments or a milder command"):
        settle(twin, curved(0.0, 60.0), 2.0)  # 4.5 rad in the one joint
    shattered = make_twin(FLOOR)
    with pytest.raises(SimulationError, match="left its range"):
        settle(shattered, np.array([1.0, math.nan, 0.0]), 0.1)


def test_chain_of_one_and_scene_that_pybullet_refuses_are_errors(make_twin: MakeTwin) -> None:
    with pytest.raises(SimulationError, match="at least two"):
        make_twin(FLOOR, segments=1)
    with pytest.raises(SimulationError, match="PyBullet"):
        make_twin(FLOOR, segments=150)  # more links than its engine has room for


def test_window_without_a_screen_is_refused(monkeypatch: pytest.MonkeyPatch, make_twin: MakeTwin) -> None:
    monkeypatch.setattr(pybullet, "connect", lambda mode: -1)
    with pytest.raises(SimulationError, match="is there a screen"):
        make_twin(FLOOR, gui=True)


def test_closed_twin_frees_its_engine_and_may_be_closed_again(make_twin: MakeTwin) -> None:
    twin = make_twin(FLOOR)
    client = twin._client
    assert pybullet.isConnected(client)
    twin.close()
    twin.close()
    assert not pybullet.isConnected(client)


def test_interpreted_and_compiled_twins_move_alike(make_twin: MakeTwin, interpreted: Callable[..., None]) -> None:
    def end() -> np.ndarray:
        twin = make_twin(World(9.81, "plane", 20.0, "viscous"), segments=3, stretches=True)
        settle(twin, curved(0.4, 6.0), 5 * twin.step_s)
        return np.concatenate([twin.shape()[0].ravel(), twin.motion().angular_momentum_kg_m2_s])

    compiled = end()
    interpreted(bullet)
    np.testing.assert_allclose(end(), compiled, atol=1e-10)
