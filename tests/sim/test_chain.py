"""The chain's kinematics, mass matrix and implicit joint forces, each against a derivation of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim import chain
from sim.chain import PRISMATIC, SPHERICAL

STIFF_N_m = np.array([[0.3, 0.02, 0.0], [0.02, 0.25, 0.0], [0.0, 0.0, 0.15]])
seeds = st.integers(0, 10**6)
vectors = st.tuples(*[st.floats(-1.6, 1.6)] * 3).map(np.array)


# --- references of our own ------------------------------------------------------------


def cross_matrix(v: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def turned(v: np.ndarray) -> np.ndarray:
    """Rotation matrix of a rotation vector, Rodrigues' formula."""
    angle = float(np.linalg.norm(v))
    if angle < 1e-12:
        return np.eye(3) + cross_matrix(v)
    axis = cross_matrix(v / angle)
    return np.eye(3) + np.sin(angle) * axis + (1.0 - np.cos(angle)) * axis @ axis


def quaternion(v: np.ndarray) -> np.ndarray:
    angle = float(np.linalg.norm(v))
    axis = v / angle if angle > 0.0 else v
    return np.array([*(np.sin(0.5 * angle) * axis), np.cos(0.5 * angle)])


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.array([*(a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])), a[3] * b[3] - a[:3] @ b[:3]])


def rotation_vector(q: np.ndarray) -> np.ndarray:
    out = np.empty(3)
    chain.rotation_vector(q, out)
    return out


@dataclass
class Chain:
    """A chain in some posture, with everything the kernels want."""

    kind: np.ndarray
    position: np.ndarray
    base: np.ndarray
    joint_quaternion: np.ndarray
    slide: np.ndarray
    part_length: np.ndarray
    mass: np.ndarray
    inertia: np.ndarray

    @property
    def first_dof(self) -> np.ndarray:
        widths = np.where(self.kind == SPHERICAL, 3, 1)
        return 6 + np.concatenate([[0], np.cumsum(widths)[:-1]]).astype(np.int64)

    @property
    def size(self) -> int:
        return int(6 + np.where(self.kind == SPHERICAL, 3, 1).sum())

    def places(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        bodies = len(self.mass)
        rotation, centre, joint = np.zeros((bodies, 3, 3)), np.zeros((bodies, 3)), np.zeros((bodies, 3))
        chain.place_bodies(
            self.position, self.base, self.kind, self.joint_quaternion, self.slide, self.part_length,
            rotation, centre, joint,
        )  # fmt: skip
        return rotation, centre, joint

    def moved(self, velocity: np.ndarray, time_s: float) -> Chain:
        """The chain after moving with this generalised velocity for a (short) time."""
        quaternions, slide = self.joint_quaternion.copy(), self.slide.copy()
        for j, (kind, d) in enumerate(zip(self.kind, self.first_dof, strict=True)):
            if kind == SPHERICAL:  # angular velocity in the child's axes: multiply from the right
                quaternions[j] = product(quaternions[j], quaternion(velocity[d : d + 3] * time_s))
            else:
                slide[j] += velocity[d] * time_s
        return Chain(
            self.kind,
            self.position + velocity[:3] * time_s,
            turned(velocity[3:6] * time_s) @ self.base,
            quaternions,
            slide,
            self.part_length,
            self.mass,
            self.inertia,
        )

    def mass_matrix(self) -> np.ndarray:
        out = np.zeros((self.size, self.size))
        chain.mass_matrix(self.kind, self.first_dof, self.mass, self.inertia, *self.places(), out)
        return out

    def velocities(self, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        linear, spin = np.zeros_like(self.inertia), np.zeros_like(self.inertia)
        chain.body_velocities(self.kind, self.first_dof, *self.places(), velocity, linear, spin)
        return linear, spin


def some_chain(seed: int, bend: float = 0.6) -> Chain:
    """Any chain: both kinds of joints in any order, every body another, in any posture."""
    random = np.random.default_rng(seed)
    joints = int(random.integers(1, 6))
    kind = random.integers(0, 2, joints).astype(np.int64)
    return Chain(
        kind,
        random.normal(size=3),
        turned(random.normal(size=3)),
        np.array([quaternion(bend * random.normal(size=3)) for _ in range(joints)]),
        0.1 * random.normal(size=joints),
        random.uniform(0.5, 1.5, joints + 1),
        random.uniform(0.2, 2.0, joints + 1),
        random.uniform(0.1, 0.5, (joints + 1, 3)),
    )


# --- rotations ------------------------------------------------------------


@given(v=vectors)
def test_rotation_matrix_and_vector_of_a_quaternion_are_those_of_rodrigues(v: np.ndarray) -> None:
    out = np.empty((3, 3))
    chain.rotation_of(quaternion(v), out)
    np.testing.assert_allclose(out, turned(v), atol=1e-12)
    np.testing.assert_allclose(rotation_vector(quaternion(v)), v, atol=1e-9)
    np.testing.assert_allclose(rotation_vector(-quaternion(v)), v, atol=1e-9)  # the same rotation


@given(v=vectors, spin=vectors)
def test_vector_rate_is_the_derivative_of_the_rotation_vector(v: np.ndarray, spin: np.ndarray) -> None:
    rate, h = np.empty((3, 3)), 1e-5
    chain.vector_rate(v, rate)
    ahead, behind = (rotation_vector(product(quaternion(v), quaternion(s * h * spin))) for s in (1, -1))
    np.testing.assert_allclose(rate @ spin, (ahead - behind) / (2.0 * h), atol=2e-8 * (1.0 + np.linalg.norm(spin)))


@pytest.mark.parametrize("size", [0.3e-4, 0.99e-4, 1.01e-4, 3e-4])
def test_vector_rate_has_no_seam_where_its_series_takes_over(size: float) -> None:
    rate, v = np.empty((3, 3)), size * np.array([0.36, -0.48, 0.8])
    chain.vector_rate(v, rate)
    np.testing.assert_allclose(0.5 * (rate - rate.T), 0.5 * cross_matrix(v), rtol=1e-12)
    second_order = (0.5 * (rate + rate.T) - np.eye(3)) / size**2
    np.testing.assert_allclose(second_order, cross_matrix(v) @ cross_matrix(v) / (12.0 * size**2), atol=1e-6)


# --- kinematics ------------------------------------------------------------


@given(seed=seeds)
def test_neighbours_meet_at_their_joint_and_slides_part_them_along_the_tangent(seed: int) -> None:
    robot = some_chain(seed)
    rotation, centre, joint = robot.places()
    for b in range(1, len(robot.mass)):
        far_end = centre[b - 1] + 0.5 * robot.part_length[b - 1] * rotation[b - 1, :, 2]
        near_end = centre[b] - 0.5 * robot.part_length[b] * rotation[b, :, 2]
        np.testing.assert_allclose(near_end, joint[b], atol=1e-12)
        slides = robot.slide[b - 1] if robot.kind[b - 1] == PRISMATIC else 0.0
        np.testing.assert_allclose(near_end - far_end, slides * rotation[b - 1, :, 2], atol=1e-12)
        np.testing.assert_allclose(rotation[b] @ rotation[b].T, np.eye(3), atol=1e-12)


@given(seed=seeds)
def test_body_velocities_are_the_derivative_of_the_places(seed: int) -> None:
    robot, h = some_chain(seed), 1e-6
    velocity = np.random.default_rng(seed + 1).normal(size=robot.size)
    linear, spin = robot.velocities(velocity)
    ahead, behind = (robot.moved(velocity, s * h).places() for s in (1, -1))
    np.testing.assert_allclose(linear, (ahead[1] - behind[1]) / (2.0 * h), atol=1e-7)
    for b, rotation in enumerate(robot.places()[0]):
        rate = (ahead[0][b] - behind[0][b]) / (2.0 * h) @ rotation.T
        np.testing.assert_allclose(rate, cross_matrix(spin[b]), atol=1e-7)


@given(seed=seeds)
def test_mass_matrix_holds_the_kinetic_energy_of_the_moving_bodies(seed: int) -> None:
    """½ vᵀMv against ½ Σ m|ẋ|² + ωᵀIω with ẋ and ω differenced from the places, for every pair of coordinates."""
    robot, h = some_chain(seed), 1e-5
    rotation = robot.places()[0]
    motions = []
    for unit in np.eye(robot.size):
        ahead, behind = (robot.moved(unit, s * h).places() for s in (1, -1))
        linear = (ahead[1] - behind[1]) / (2.0 * h)
        rates = (ahead[0] - behind[0]) / (2.0 * h) @ np.swapaxes(rotation, 1, 2)
        spin = np.column_stack([rates[:, 2, 1], rates[:, 0, 2], rates[:, 1, 0]])
        body_spin = np.einsum("bji,bj->bi", rotation, spin)
        motions.append(np.hstack([linear * np.sqrt(robot.mass)[:, None], body_spin * np.sqrt(robot.inertia)]).ravel())
    expected = np.array(motions) @ np.array(motions).T
    np.testing.assert_allclose(robot.mass_matrix(), expected, atol=1e-7 * np.abs(expected).max())
    assert np.linalg.eigvalsh(robot.mass_matrix()).min() > 0.0


# --- momentum and means ------------------------------------------------------------


@given(seed=seeds)
def test_angular_momentum_is_that_of_many_mass_points(seed: int) -> None:
    """Each body as six point masses of its mass and inertia; a drift of the whole changes nothing."""
    robot = some_chain(seed)
    random = np.random.default_rng(seed + 2)
    robot.inertia = np.tile(random.uniform(0.2, 0.3, 3), (len(robot.mass), 1))  # sides of a possible body
    velocity, drift = random.normal(size=robot.size), random.normal(size=3)
    rotation, centre, _ = robot.places()
    linear, spin = robot.velocities(velocity)
    out, drifting = np.empty(3), np.empty(3)
    chain.angular_momentum(robot.mass, robot.inertia, rotation, centre, linear, spin, out)
    chain.angular_momentum(robot.mass, robot.inertia, rotation, centre, linear + drift, spin, drifting)
    points, speeds, masses = [], [], []
    for b, mass in enumerate(robot.mass):
        second = 0.5 * robot.inertia[b].sum() - robot.inertia[b]  # ∫ x² dm along each axis
        for axis in range(3):
            for side in (-1.0, 1.0):
                arm = rotation[b, :, axis] * side * np.sqrt(3.0 * second[axis] / mass)
                points.append(centre[b] + arm)
                speeds.append(linear[b] + np.cross(spin[b], arm))
                masses.append(mass / 6.0)
    mean = np.average(points, axis=0, weights=masses)
    expected = np.sum([m * np.cross(x - mean, v) for m, x, v in zip(masses, points, speeds, strict=True)], axis=0)
    np.testing.assert_allclose(out, expected, atol=1e-10)
    np.testing.assert_allclose(drifting, out, atol=1e-10)


def test_mean_rotation_vector_counts_spherical_joints_alone() -> None:
    kind = np.array([PRISMATIC, SPHERICAL, PRISMATIC, SPHERICAL])
    turns = [np.zeros(3), np.array([0.2, 0.0, 0.1]), np.zeros(3), np.array([0.4, -0.2, 0.0])]
    mean = np.empty(3)
    chain.mean_rotation_vector(kind, np.array([quaternion(v) for v in turns]), mean)
    np.testing.assert_allclose(mean, [0.3, -0.1, 0.05], atol=1e-12)


# --- implicit joint forces ------------------------------------------------------------


def joint_forces(
    robot: Chain, velocity: np.ndarray, step_s: float, damping_time_s: float, drag: np.ndarray | None = None,
    outer: np.ndarray | None = None,
) -> tuple[bool, np.ndarray]:  # fmt: skip
    force, mass = np.zeros(robot.size), robot.mass_matrix()
    ok = chain.implicit_joint_forces(
        step_s, damping_time_s, robot.kind, robot.first_dof, robot.joint_quaternion, robot.slide, velocity,
        np.array([0.1, -0.2, 0.05]), 0.03, STIFF_N_m, 4.0,
        np.zeros((robot.size, robot.size)) if drag is None else drag,
        np.zeros(robot.size) if outer is None else outer, mass, force,
    )  # fmt: skip
    np.testing.assert_array_equal(mass, robot.mass_matrix())  # the caller goes on using it
    return ok, force


def explicit_parts(robot: Chain) -> tuple[np.ndarray, np.ndarray]:
    """Spring force at rest, −K̃(q − q0), and stiffness K in joint coordinates: dense, written anew."""
    spring, stiffness = np.zeros(robot.size), np.zeros((robot.size, robot.size))
    for j, (kind, d) in enumerate(zip(robot.kind, robot.first_dof, strict=True)):
        if kind == SPHERICAL:
            phi, rate = rotation_vector(robot.joint_quaternion[j]), np.empty((3, 3))
            chain.vector_rate(phi, rate)
            spring[d : d + 3] = -rate.T @ STIFF_N_m @ (phi - [0.1, -0.2, 0.05])
            stiffness[d : d + 3, d : d + 3] = rate.T @ STIFF_N_m @ rate
        else:
            spring[d], stiffness[d, d] = -4.0 * (robot.slide[j] - 0.03), 4.0
    return spring, stiffness


@given(seed=seeds, step_s=st.floats(1e-4, 0.1), damping_time_s=st.floats(0.0, 0.5))
def test_implicit_forces_solve_their_equation(seed: int, step_s: float, damping_time_s: float) -> None:
    robot = some_chain(seed)
    random = np.random.default_rng(seed + 3)
    velocity, rows = random.normal(size=robot.size), random.normal(size=(2, robot.size))
    drag, outer = 0.3 * rows.T @ rows, random.normal(size=robot.size)
    spring, stiffness = explicit_parts(robot)
    damping = damping_time_s * stiffness + drag
    mass = robot.mass_matrix()
    left = mass + step_s * damping + step_s**2 * stiffness
    acceleration = np.linalg.solve(left, spring - step_s * stiffness @ velocity - damping @ velocity + outer)
    ahead = velocity + step_s * acceleration
    expected = spring - step_s * stiffness @ ahead - damping @ ahead
    ok, force = joint_forces(robot, velocity, step_s, damping_time_s, drag, outer)
    assert ok
    np.testing.assert_allclose(force, expected, atol=1e-9 * (1.0 + np.abs(expected).max()))
    np.testing.assert_allclose(mass @ acceleration, force + outer, atol=1e-8 * (1.0 + np.abs(expected).max()))


@given(seed=seeds)
def test_implicit_forces_become_the_explicit_ones_as_the_step_vanishes(seed: int) -> None:
    robot = some_chain(seed)
    velocity = np.random.default_rng(seed + 4).normal(size=robot.size)
    spring, stiffness = explicit_parts(robot)
    explicit = spring - 0.05 * stiffness @ velocity
    misses = [np.abs(joint_forces(robot, velocity, h, 0.05)[1] - explicit).max() for h in (1e-5, 1e-6)]
    assert misses[1] < 1e-3 * (1.0 + np.abs(explicit).max())
    assert misses[1] == pytest.approx(0.1 * misses[0], rel=0.05, abs=1e-8)  # first order in the step
    assert np.all(joint_forces(robot, velocity, 1e-3, 0.05)[1][:6] == 0.0)  # joints do not push the base


def test_stiff_joint_is_calm_at_a_step_far_beyond_the_explicit_limit() -> None:
    robot = some_chain(5)
    robot.kind = np.array([SPHERICAL], dtype=np.int64)
    robot.joint_quaternion, robot.slide = np.array([quaternion(np.array([0.3, 0.0, 0.0]))]), np.zeros(1)
    robot.part_length, robot.mass, robot.inertia = np.ones(2), np.full(2, 1e-4), np.full((2, 3), 1e-5)
    velocity, step_s = np.zeros(robot.size), 0.05
    stiffness = explicit_parts(robot)[1]
    fastest = np.sqrt(np.linalg.eigvals(np.linalg.solve(robot.mass_matrix(), stiffness)).real.max())
    assert step_s * fastest > 5.0  # an explicit step is stable below 2
    for _ in range(60):
        force = joint_forces(robot, velocity, step_s, 0.0)[1]
        velocity = velocity + step_s * np.linalg.solve(robot.mass_matrix(), force)
        robot = robot.moved(velocity, step_s)
    np.testing.assert_allclose(rotation_vector(robot.joint_quaternion[0]), [0.1, -0.2, 0.05], atol=1e-3)
    assert np.abs(velocity[6:]).max() < 1e-3  # the base drifts on


def test_joint_turned_further_than_a_rotation_vector_can_say_is_reported() -> None:
    robot = some_chain(5)
    robot.kind[:] = SPHERICAL
    robot.joint_quaternion[0] = quaternion(np.array([0.0, 3.05, 0.0]))
    assert not joint_forces(robot, np.zeros(robot.size), 1e-3, 0.0)[0]


@pytest.mark.parametrize("where", ["posture", "velocity", "outer force"])
def test_what_is_no_longer_a_number_is_reported_and_not_raised(where: str) -> None:
    robot = some_chain(5)
    robot.kind[0] = SPHERICAL
    velocity, outer = np.zeros(robot.size), np.zeros(robot.size)
    if where == "posture":
        robot.joint_quaternion[0, 1] = np.nan
    elif where == "velocity":
        velocity[6] = np.inf
    else:
        outer[0] = np.nan
    assert not joint_forces(robot, velocity, 1e-3, 0.01, outer=outer)[0]


# --- the kernels as plain Python ------------------------------------------------------------


@settings(max_examples=3)
@given(data=st.data())
def test_interpreted_and_compiled_kernels_agree(data: st.DataObject) -> None:
    seed = data.draw(seeds)
    robot = some_chain(seed)
    robot.kind[0] = SPHERICAL
    velocity = np.random.default_rng(seed).normal(size=robot.size)

    def everything() -> list[np.ndarray]:
        momentum, mean, seam = np.empty(3), np.empty(3), np.empty((3, 3))
        linear, spin = robot.velocities(velocity)
        rotation, centre, _ = robot.places()
        chain.angular_momentum(robot.mass, robot.inertia, rotation, centre, linear, spin, momentum)
        chain.mean_rotation_vector(robot.kind, robot.joint_quaternion, mean)
        chain.vector_rate(np.zeros(3), seam)
        force = joint_forces(robot, velocity, 0.01, 0.02)[1]
        return [rotation, centre, linear, spin, robot.mass_matrix(), momentum, mean, seam, force]

    compiled = everything()
    with pytest.MonkeyPatch.context() as patch:
        for name in [name for name, value in vars(chain).items() if hasattr(value, "py_func")]:
            patch.setattr(chain, name, getattr(chain, name).py_func)
        robot_far = some_chain(5)
        robot_far.kind[:] = SPHERICAL
        robot_far.joint_quaternion[0] = quaternion(np.array([0.0, 3.05, 0.0]))
        assert not joint_forces(robot_far, np.zeros(robot_far.size), 1e-3, 0.0)[0]
        python = everything()
    for one, other in zip(compiled, python, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)
