"""A rod among other bodies: momentum, energy, friction that holds, convergence, what is left out, what is refused.

The laws are tried on a rigid tube that floats, whose motion under a force is known; the rod itself stands at the end.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pybullet
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sim import body_contact, rod_among_bodies
from sim.bodies import OtherBody
from sim.body import Body, Motion, World
from sim.rod import RodTwin
from sim.rod_among_bodies import QUIET_S, RodAmongBodies
from sim.rod_drive import drive_array
from sim.scene import Drive
from softbot.errors import InputError, SimulationError

BODY = Body(0.15, 0.01, 0.0518, 3.93e-3, 2.62e-3, 500.0, 0.02)
SPACE = World(0.0, "none", 0.0, "coulomb")
FLOOR = World(9.81, "plane", 0.6, "coulomb")
STIFFNESS = BODY.rest_stiffness()
CUBE = {"kind": "box", "size_m": [0.05, 0.05, 0.05]}
BALL = {"kind": "sphere", "radius_m": 0.025}
CAN = {"kind": "cylinder", "radius_m": 0.025, "length_m": 0.05, "axis": "x"}
WALL = {"kind": "box", "size_m": [1.0, 0.02, 0.2], "fixed": True}

MakeTwin = Callable[..., RodAmongBodies]


class RigidTube:
    """A straight rigid tube that floats and that outside forces act on, as a rod that does not bend."""

    def __init__(self, step_s: float, points: int = 8) -> None:
        self.step_s = step_s
        self.centre_m, self.rotation = np.zeros(3), np.eye(3)
        self.velocity_m_s, self.spin_kg_m2_s = np.zeros(3), np.zeros(3)
        self.along_m = np.linspace(-0.5, 0.5, points)[::-1] * BODY.length_m  # in any order
        self.push_N, self.push_N_m = np.zeros((points, 3)), np.zeros((points, 3))
        axial = 0.5 * BODY.radius_m**2
        across = 0.25 * BODY.radius_m**2 + BODY.length_m**2 / 12.0
        self.inertia_kg_m2 = BODY.mass_kg * np.array([axial, across, across])
        self.wakes, self.blocks = 0, list[int]()

    @property
    def spin_rad_s(self) -> np.ndarray:
        return self.rotation @ ((self.rotation.T @ self.spin_kg_m2_s) / self.inertia_kg_m2)

    def points(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        arm = np.outer(self.along_m, self.rotation[:, 0])
        spin = np.tile(self.spin_rad_s, (len(arm), 1))
        return self.centre_m + arm, self.velocity_m_s + np.cross(spin, arm), spin

    def advance(self, count: int) -> None:
        self.blocks.append(count)
        for _ in range(count):
            arm = np.outer(self.along_m, self.rotation[:, 0])
            self.velocity_m_s = self.velocity_m_s + self.step_s * self.push_N.sum(axis=0) / BODY.mass_kg
            moment = (np.cross(arm, self.push_N) + self.push_N_m).sum(axis=0)
            self.spin_kg_m2_s = self.spin_kg_m2_s + self.step_s * moment
            self.centre_m = self.centre_m + self.step_s * self.velocity_m_s
            turn = self.step_s * self.spin_rad_s
            angle = max(np.linalg.norm(turn), 1e-300)
            x, y, z = turn / angle
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            self.rotation = (
                np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
            ) @ self.rotation

    def play(self, drive: np.ndarray, samples: int, steps: int) -> np.ndarray:
        rows = []
        for _ in range(samples):
            self.advance(steps)
            rows.append(np.concatenate([self.centre_m, self.velocity_m_s]))
        return np.array(rows)

    def motion(self) -> Motion:
        return Motion(
            self.rotation, self.spin_rad_s, self.velocity_m_s, self.centre_m, 1.0, np.zeros(2), self.rotation[:, 0],
            self.spin_kg_m2_s,
        )  # fmt: skip

    def wake(self) -> None:
        self.wakes += 1

    def set_rest(self, strain: np.ndarray, stiffness: np.ndarray) -> None: ...

    def step(self) -> None:
        self.advance(1)

    def strain(self) -> np.ndarray:
        return np.array([1.0, 0.0, 0.0])

    def shape(self) -> tuple[np.ndarray, np.ndarray]:
        return self.points()[0], np.tile(self.rotation[:, 1], (len(self.along_m), 1))

    def close(self) -> None: ...


@pytest.fixture
def make_twin() -> Iterator[MakeTwin]:
    """A rigid tube, or with `rod` the rod, among bodies; closed when the test is over."""
    made: list[RodAmongBodies] = []

    def make(
        *tables: dict[str, Any], world: World = SPACE, step_s: float = 0.0025, rod: bool = False, points: int = 8
    ) -> RodAmongBodies:
        whole = {"modes": 3, "contact_points": 16, "step_s": step_s, "stretches": False}
        tube = RodTwin(BODY, world, **whole) if rod else RigidTube(step_s, points)
        made.append(RodAmongBodies(tube, [OtherBody(**table) for table in tables], BODY, world))
        return made[-1]

    yield make
    for twin in made:
        twin.close()


def run(twin: RodAmongBodies, seconds: float) -> None:
    for _ in range(round(seconds / twin.step_s)):
        twin.step()


def momentum(twin: RodAmongBodies, tables: tuple[dict[str, Any], ...]) -> tuple[np.ndarray, np.ndarray, float]:
    """Linear and angular momentum about the origin, and kinetic energy, of tube and bodies with equal moments."""
    tube = twin.rod
    linear = BODY.mass_kg * tube.velocity_m_s
    angular = np.cross(tube.centre_m, linear) + tube.spin_kg_m2_s
    energy = 0.5 * BODY.mass_kg * tube.velocity_m_s @ tube.velocity_m_s + 0.5 * tube.spin_rad_s @ tube.spin_kg_m2_s
    places = [np.array(pose[1]) for pose in twin.bodies()]
    for table, place, velocity, spin in zip(tables, places, *twin.velocities(), strict=True):
        body = OtherBody(**table)
        linear = linear + body.kilograms * velocity
        turning = body.inertia_kg_m2[0] * spin
        angular = angular + np.cross(place, body.kilograms * velocity) + turning
        energy += 0.5 * body.kilograms * velocity @ velocity + 0.5 * spin @ turning
    return linear, angular, float(energy)


# --- laws, on the rigid tube ------------------------------------------------------------


@given(
    mass=st.sampled_from([0.002, 0.05, 1.5]),
    friction=st.sampled_from([0.0, 0.5, 2.0]),
    step_s=st.sampled_from([0.001, 0.005]),
    x=st.floats(-0.07, 0.07),
    speed=st.floats(0.1, 2.0),
    spin=st.floats(-30.0, 30.0),
    kind=st.sampled_from([CUBE, BALL]),
)
@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_blow_keeps_momentum_and_makes_no_energy(
    make_twin: MakeTwin,
    mass: float,
    friction: float,
    step_s: float,
    x: float,
    speed: float,
    spin: float,
    kind: dict[str, Any],
) -> None:
    body = {**kind, "mass_kg": mass, "friction": friction, "position_m": [x, 0.05, 0.004]}
    twin = make_twin(body, step_s=step_s)
    twin.rod.velocity_m_s[:] = 0.0, speed, 0.0
    twin.rod.spin_kg_m2_s[:] = spin * twin.rod.inertia_kg_m2[0], 0.0, 0.0
    linear, angular, energy = momentum(twin, (body,))
    run(twin, 0.04 / speed)
    after_linear, after_angular, after_energy = momentum(twin, (body,))
    assert twin.velocities()[0][0, 1] > 0.0  # it was hit
    np.testing.assert_allclose(after_linear, linear, atol=1e-9 * BODY.mass_kg * speed)
    np.testing.assert_allclose(after_angular, angular, atol=1e-9 * BODY.mass_kg * speed * BODY.length_m)
    assert after_energy <= energy * (1.0 + 1e-6)


def test_a_blow_without_bounce_ends_in_the_common_speed(make_twin: MakeTwin) -> None:
    """A tube of m that hits a ball of M head on at v: the soft wall swallows most of what would bounce."""
    ball = {**BALL, "mass_kg": BODY.mass_kg, "friction": 0.0, "position_m": [0.0, 0.05, 0.0]}
    twin = make_twin(ball, step_s=0.0005)
    twin.rod.velocity_m_s[1] = 0.2
    run(twin, 0.3)
    apart = twin.velocities()[0][0, 1] - twin.rod.velocity_m_s[1]
    assert 0.0 <= apart < 0.4 * 0.2


def test_result_converges_with_the_step(make_twin: MakeTwin) -> None:
    ends = []
    for step_s in (0.004, 0.002, 0.001, 0.0005, 0.00025):
        twin = make_twin({**CUBE, "mass_kg": 0.05, "friction": 0.3, "position_m": [0.0, 0.05, 0.0]}, step_s=step_s)
        twin.rod.velocity_m_s[1], twin.rod.spin_kg_m2_s[0] = 0.3, 20.0 * twin.rod.inertia_kg_m2[0]
        run(twin, 0.2)
        ends.append(np.array(twin.bodies()[0][1]))
    error = [np.linalg.norm(end - ends[-1]) for end in ends[:-1]]
    assert all(finer < coarser for coarser, finer in pairwise(error))
    assert error[0] < 0.03 * np.linalg.norm(ends[-1])
    assert error[-1] < 0.003 * np.linalg.norm(ends[-1])


@pytest.mark.parametrize("step_s", [0.001, 0.0025, 0.005])
def test_tube_rests_against_a_wall_and_friction_holds_it_to_its_coefficient(make_twin: MakeTwin, step_s: float) -> None:
    """Pressed on with 0.5 N, friction 0.5 carries 0.2 N for ever, and slips under 0.3 N by (0.3 − 0.25) N."""
    for pull_N, slips in ((0.2, False), (0.3, True)):
        twin = make_twin({**WALL, "friction": 0.5, "position_m": [0.0, 0.02, 0.0]}, step_s=step_s)
        tube = twin.rod
        pressed = np.array([pull_N, 0.5, 0.0])

        def step(twin: RodAmongBodies = twin, tube: Any = tube, pressed: np.ndarray = pressed) -> None:
            twin._exchange(1)
            tube.push_N += pressed / len(tube.push_N)
            tube.advance(1)

        for _ in range(round(0.2 / step_s)):
            step()
        start, speed = tube.centre_m.copy(), tube.velocity_m_s.copy()
        for _ in range(round(0.3 / step_s)):
            step()
        assert 0.0 < tube.centre_m[1] < 0.05 * BODY.radius_m
        if slips:
            assert tube.velocity_m_s[0] - speed[0] == pytest.approx(0.05 / BODY.mass_kg * 0.3, rel=0.02)
        else:
            assert np.linalg.norm(tube.centre_m - start) < 1e-5 * (step_s / 0.0025) ** 4  # settling still


def test_wall_brakes_the_turning_of_a_tube_that_is_pressed_on_it(make_twin: MakeTwin) -> None:
    """Sliding friction µN has the arm R: the turning dies away at µNR/I."""
    twin = make_twin({**WALL, "friction": 0.4, "position_m": [0.0, 0.02, 0.0]}, step_s=0.001)
    tube = twin.rod
    spins = []
    tube.spin_kg_m2_s[0] = 100.0 * tube.inertia_kg_m2[0]
    for _ in range(200):
        twin._exchange(1)
        tube.push_N[:, 1] += 0.2 / len(tube.push_N)
        tube.push_N[:, 2] -= tube.push_N[:, 2].sum() / len(tube.push_N)  # held where it is
        tube.advance(1)
        spins.append(tube.spin_rad_s[0])
    rate = -np.polyfit(np.arange(100, 200) * 0.001, spins[100:], 1)[0]
    assert rate == pytest.approx(0.4 * 0.2 * BODY.radius_m / tube.inertia_kg_m2[0], rel=0.02)


def test_can_and_cube_are_felt_where_they_are(make_twin: MakeTwin) -> None:
    """Set down on the tube they are carried, by a tube that is held."""
    for table in (CUBE, CAN, BALL):
        twin = make_twin(
            {**table, "mass_kg": 0.05, "position_m": [0.0, 0.0, 0.0351]},
            world=World(9.81, "none", 0, "coulomb"),
            step_s=0.001,
        )
        for _ in range(100):
            twin._exchange(1)
            twin._move_bodies(1)
        assert twin.bodies()[0][1][2] == pytest.approx(0.035, abs=0.1 * BODY.radius_m)


# --- what is left out ------------------------------------------------------------


def test_far_bodies_cost_nothing(make_twin: MakeTwin, monkeypatch: pytest.MonkeyPatch) -> None:
    """No body within reach, all at rest: neither contact nor PyBullet is called, and steps come in blocks."""
    twin = make_twin({**CUBE, "mass_kg": 0.05, "position_m": [0.0, 1.0]}, world=FLOOR)
    twin.advance(round(2.0 * QUIET_S / twin.step_s))
    assert twin.bodies_asleep
    monkeypatch.setattr(rod_among_bodies, "press", None)
    monkeypatch.setattr(pybullet, "stepSimulation", None)
    twin.rod.blocks.clear()
    twin.advance(1000)
    assert sum(twin.rod.blocks) == 1000
    assert len(twin.rod.blocks) <= 1000 / 30  # 0.95 m at the limit of 10 m/s last 38 steps
    assert twin.rod.wakes == 0


def test_leaving_out_changes_nothing(make_twin: MakeTwin, monkeypatch: pytest.MonkeyPatch) -> None:
    ends = []
    for left_out in (True, False):
        if not left_out:
            monkeypatch.setattr(rod_among_bodies, "APPROACH_LIMIT_M_S", math.inf)
            monkeypatch.setattr(rod_among_bodies, "QUIET_S", math.inf)
        twin = make_twin({**CUBE, "mass_kg": 0.05, "position_m": [0.0, 0.4]}, world=World(9.81, "plane", 0, "coulomb"))
        twin.rod.velocity_m_s[1] = 0.5
        twin.rod.centre_m[2] = 0.02
        twin.advance(400)
        ends.append(np.concatenate([twin.bodies()[0][1], twin.rod.centre_m]))
    assert ends[0][1] > 0.41  # it was pushed
    np.testing.assert_allclose(ends[0], ends[1], atol=0.05 * BODY.radius_m)


def test_sleeping_body_wakes_when_it_is_touched(make_twin: MakeTwin) -> None:
    twin = make_twin({**CUBE, "mass_kg": 0.05, "friction": 0.1, "position_m": [0.0, 0.2]}, world=FLOOR)
    twin.rod.centre_m[2] = 0.02
    run(twin, 0.3)
    assert twin.bodies_asleep
    twin.rod.velocity_m_s[1] = 0.5
    run(twin, 0.5)
    assert twin.bodies()[0][1][1] > 0.21
    assert twin.rod.wakes > 0
    twin.rod.velocity_m_s[1] = -1.0
    run(twin, 1.0)
    assert twin.bodies_asleep
    assert not twin.rod.push_N.any()
    assert not twin.rod.push_N_m.any()


def test_play_moves_as_steps_do(make_twin: MakeTwin) -> None:
    ends = []
    for plays in (True, False):
        twin = make_twin({**CUBE, "mass_kg": 0.05, "position_m": [0.0, 0.2, 0.0]})
        twin.rod.velocity_m_s[1] = 1.0
        if plays:
            rows = twin.play(np.zeros(16), 50, 4)
            assert rows.shape == (50, 6)
            np.testing.assert_array_equal(rows[-1, :3], twin.rod.centre_m)
        else:
            twin.advance(200)
        ends.append(np.concatenate([twin.bodies()[0][1], twin.rod.centre_m]))
    assert ends[0][1] > 0.2
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-12)


def test_interpreted_and_compiled_contact_are_alike(make_twin: MakeTwin, interpreted: Callable[..., None]) -> None:
    def end() -> np.ndarray:
        tables = ({**CUBE, "mass_kg": 0.05}, {**BALL, "mass_kg": 0.05}, {**CAN, "mass_kg": 0.05})
        places = ([0.04, 0.04, 0.0], [-0.05, 0.04, 0.002], [-0.01, -0.036, 0.003])
        twin = make_twin(
            *({**table, "friction": 0.4, "position_m": place} for table, place in zip(tables, places, strict=True)),
            step_s=0.005,
        )
        twin.rod.velocity_m_s[:] = 0.1, 0.3, 0.0
        twin.rod.spin_kg_m2_s[0] = 20.0 * twin.rod.inertia_kg_m2[0]
        run(twin, 0.05)
        return np.concatenate([np.ravel(twin.velocities()), twin.rod.centre_m, twin.rod.push_N.ravel()])

    compiled = end()
    interpreted(body_contact)
    interpreted(rod_among_bodies)
    np.testing.assert_allclose(end(), compiled, atol=1e-12)


# --- refusals ------------------------------------------------------------


def test_bodies_inside_each_other_or_the_ground_are_refused(make_twin: MakeTwin) -> None:
    first, second = (
        {**CUBE, "mass_kg": 0.05, "position_m": [0, 0.1]},
        {**BALL, "mass_kg": 0.02, "position_m": [0, 0.13]},
    )
    with pytest.raises(InputError, match=r"body\.1\.position_m = .*: sphere-1 starts .* m inside body\.0 \(box-0\)"):
        make_twin(first, second, world=FLOOR)
    pipe = World(9.81, "pipe", 0.6, "coulomb", pipe_radius_m=0.1)
    with pytest.raises(InputError, match=r"box-0 starts .* m inside the ground; move one of them"):
        make_twin({**CUBE, "mass_kg": 0.05, "position_m": [0.0, 0.1, 0.01]}, world=pipe)
    with pytest.raises(InputError, match=r"write \[x, y, z\]"):
        make_twin(first, world=pipe)


def test_half_a_rod_or_one_of_too_few_points_is_refused(make_twin: MakeTwin) -> None:
    wall = {**WALL, "position_m": [0, 0.5, 0]}
    with pytest.raises(InputError, match="at least 4 points, not 3"):
        make_twin(wall, points=3)
    half = RigidTube(0.0025)
    half.along_m = np.abs(half.along_m) + 1e-3
    with pytest.raises(InputError, match="symmetric=False"):
        RodAmongBodies(half, [OtherBody(**wall)], BODY, SPACE)


def test_body_that_bursts_is_a_simulation_error(make_twin: MakeTwin) -> None:
    twin = make_twin({**CUBE, "mass_kg": 0.05, "position_m": [0.0, 0.2, 0.0]})
    pybullet.resetBaseVelocity(twin._numbers[0], [0.0, 1e5, 0.0], physicsClientId=twin._client)
    twin._read(0)
    with pytest.raises(SimulationError, match="a body left its range"):
        twin.step()


def test_closed_twin_frees_its_engine_and_may_be_closed_again(make_twin: MakeTwin) -> None:
    twin = make_twin({**WALL, "position_m": [0, 0.5, 0]})
    client = twin._client
    assert pybullet.isConnected(client)
    twin.close()
    twin.close()
    assert not pybullet.isConnected(client)


# --- the rod itself ------------------------------------------------------------

CRATE = {"kind": "box", "size_m": [0.2, 0.04, 0.04], "mass_kg": 0.05, "friction": 0.2, "position_m": [0.0, 0.09]}
ROLLING = drive_array(Drive(kind="curvature", curvature_1_m=12.0, period_s=2.0, start_s=0.5, ramp_s=0.5))


def roll(twin: RodAmongBodies, seconds: float) -> None:
    """Roll to the left, one turn in two seconds."""
    twin.play(ROLLING, 1, round(seconds / twin.step_s))


def test_rolling_rod_pushes_a_box_of_its_weight_and_the_step_hardly_matters(make_twin: MakeTwin) -> None:
    ends = []
    for step_s in (0.005, 0.0025):
        twin = make_twin(CRATE, world=FLOOR, step_s=step_s, rod=True)
        roll(twin, 3.5)
        place = np.array(twin.bodies()[0][1])
        assert place[1] > CRATE["position_m"][1] + 0.02
        touching = place[1] - 0.02 - BODY.radius_m
        ahead = twin.shape()[0][:, 1].max()
        assert 0.0 < ahead - touching < 0.002  # a tip is light, so what it leans on is soft at such steps
        assert np.hypot(*twin.motion().curvature_1_m) == pytest.approx(12.0, rel=0.1)
        ends.append(place)
    np.testing.assert_allclose(ends[0], ends[1], atol=0.1 * BODY.radius_m)


@pytest.mark.parametrize("heavy", [{"fixed": True}, {"mass_kg": 5.0, "friction": 0.5}])
def test_wall_or_heavy_box_stops_the_rolling_rod(make_twin: MakeTwin, heavy: dict[str, Any]) -> None:
    wall = {**CRATE, **heavy}
    wall.pop("mass_kg" if "fixed" in heavy else "fixed", None)
    twin = make_twin(wall, world=FLOOR, rod=True)
    roll(twin, 3.5)
    middle = twin.motion().centre_of_mass_m[1]
    roll(twin, 2.0)  # one more turn, 0.059 m if it were free
    points, _ = twin.shape()
    assert points[:, 1].max() == pytest.approx(0.09 - 0.02 - BODY.radius_m, abs=0.15 * BODY.radius_m)
    assert abs(twin.motion().centre_of_mass_m[1] - middle) < 0.012
    assert twin.bodies()[0][1][1] == pytest.approx(0.09, abs=0.001)
    assert np.abs(points[:, 2] - BODY.radius_m).max() < 0.1 * BODY.radius_m
    assert np.hypot(*twin.motion().curvature_1_m) == pytest.approx(12.0, rel=0.15)


def test_on_a_smooth_floor_rod_and_box_have_no_momentum_together(make_twin: MakeTwin) -> None:
    """A straight rod that bends all at once kicks the box away and itself back."""
    smooth = World(9.81, "plane", 0.0, "coulomb")
    box = {**CRATE, "size_m": [0.1, 0.04, 0.04], "friction": 0.0, "position_m": [0.0, 0.035]}
    twin = make_twin(box, world=smooth, rod=True)
    twin.set_rest(np.array([1.0, -18.0, 0.0]), STIFFNESS)
    given = np.zeros(3)
    for _ in range(80):
        twin.step()
        given += twin.body_force_N()[0] * twin.step_s
    box_N_s = 0.05 * twin.velocities()[0][0]
    start = twin.motion().centre_of_mass_m
    twin.advance(80)
    rod_N_s = BODY.mass_kg * (twin.motion().centre_of_mass_m - start) / (80 * twin.step_s)
    assert box_N_s[1] > 0.005
    assert given[1] == pytest.approx(box_N_s[1], rel=1e-6)
    assert rod_N_s[1] == pytest.approx(-box_N_s[1], rel=0.02)


def test_rod_asleep_beside_a_box_is_woken_by_one_that_hits_it(make_twin: MakeTwin) -> None:
    box = {**CRATE, "friction": 0.01, "position_m": [0.0, 0.4], "velocity_m_s": [0.0, -0.5, 0.0]}
    twin = make_twin(box, world=World(9.81, "plane", 0.05, "coulomb"), rod=True)
    run(twin, 0.6)
    assert twin.rod.asleep
    run(twin, 0.4)
    assert not twin.rod.asleep
    assert twin.motion().centre_of_mass_m[1] < -0.01
