"""Segment twin: a chain of rigid segments in PyBullet, for scenes with other bodies and as a cross-check.

N segments of equal length; each spherical joint between neighbours carries the bending and twisting stiffness of one
segment length, and, where the robot stretches, each segment is cut in two halves on a prismatic joint that carries the
axial stiffness. Joint forces are taken linearly implicitly (`sim.chain`); PyBullet integrates, finds contacts and
solves Coulomb friction (elliptic cone). On a bare flat floor a segment touches with one sphere at its centre, so that
the load is shared equally, as by the mid-point rule along the tube; on a step or a pipe, and with other bodies about,
it is a capsule. A slope is tilted gravity: axes are those of the floor. Resistance to rolling is PyBullet's rolling
friction, a moment in proportion to the load; that of the whole weight is M_th.

Left out: shear, the coupling of stretch and bending in the section's stiffness (the rest strains hold it exactly), and
the friction of other bodies on a robot that has no Coulomb friction on the ground (`sim.scenery`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pybullet
from numpy.typing import NDArray

from sim.bodies import OtherBody, names_of
from sim.body import Body, Motion, World
from sim.bullet_chain import make_chain
from sim.chain import (
    PRISMATIC,
    SPHERICAL,
    angular_momentum,
    body_velocities,
    generalised_forces,
    implicit_joint_forces,
    mass_matrix,
    mean_rotation_vector,
    place_bodies,
    rotation_of,
    rotation_vector,
)
from sim.scenery import NamedPose, add_bodies, add_ground, ground_at, move_step, pose_of, robot_factor
from softbot.errors import InputError, SimulationError

FloatArray = NDArray[np.float64]

_SOLVER_ITERATIONS = 30
_TOUCHING = 1.05  # height of the centre over the radius below which viscous drag acts
_LOWEST_MODE = 22.37  # of a free rod: ω √(m L³/EI)
_LARGEST_SWING_RAD = 0.55  # of the free tube's lowest bending mode, in a step on the ground
_MOST_PARTS = 16  # of a step


def _parts_of_step(body: Body, world: World, step_s: float) -> int:
    """Steps of PyBullet's that a step is taken in.

    Its contacts and our joint forces each answer to the state before the step. Where the whole tube swings far within
    one, they work against each other and make energy: 3 of 300 random scenes did, at 0.58 rad a step and above.
    """
    if world.ground == "none":
        return 1
    swing_1_s = _LOWEST_MODE * np.sqrt(body.bending_stiffness_N_m2 / (body.mass_kg * body.length_m**3))
    return int(np.clip(np.ceil(step_s * swing_1_s / _LARGEST_SWING_RAD), 1, _MOST_PARTS))


class BulletTwin:
    """PyBullet chain of a robot. Implements `sim.body.Twin`.

    The robot starts straight, at rest, lying on the floor with chamber 0 (e1) to its left, tangent along x. `bodies`:
    what else is there. Raises InputError for a resistance to rolling that no load could give, and for bodies that start
    inside each other or the ground; SimulationError for what PyBullet refuses.
    """

    def __init__(
        self,
        body: Body,
        world: World,
        *,
        segments: int,
        step_s: float,
        stretches: bool,
        bodies: Sequence[OtherBody] = (),
        gui: bool = False,
    ) -> None:
        if segments < 2:
            raise SimulationError(f"segments = {segments}: a chain has at least two")
        self._body, self._world, self._step_s = body, world, step_s
        self._parts = _parts_of_step(body, world, step_s)
        self._part_s = step_s / self._parts
        self._segments, self._stretches = segments, stretches
        self._halves = 2 if stretches else 1
        self._bodies = tuple(bodies)
        self._capsules = bool(bodies) or world.ground in ("step", "pipe")
        self._gravity_m_s2 = world.gravity_vector_m_s2
        self._lay_out_chain()
        self._client = pybullet.connect(pybullet.GUI if gui else pybullet.DIRECT)
        if self._client < 0:
            raise SimulationError("PyBullet could not open its window: is there a screen? run without --gui")
        try:
            self._build_world()
            self._robot = make_chain(
                self._client, body, world, self._joint_kind, self._mass_kg, self._inertia, capsules=self._capsules
            )
        except pybullet.error as error:
            self.close()
            raise SimulationError(f"PyBullet refused the scene: {error}") from None
        except InputError:
            self.close()
            raise
        self.set_rest(np.array([1.0, 0.0, 0.0]), body.rest_stiffness())
        self._read_state()

    @property
    def step_s(self) -> float:
        """Step of the integration [s]."""
        return self._step_s

    # ---------------------------------------------------------------- construction

    def _lay_out_chain(self) -> None:
        bodies = self._segments * self._halves
        joints = bodies - 1
        body, part_length = self._body, self._body.length_m / bodies
        self._part_length_m = np.full(bodies, part_length)
        self._mass_kg = np.full(bodies, body.mass_kg / bodies)
        axial = 0.5 * body.radius_m**2
        across = 0.25 * body.radius_m**2 + part_length**2 / 12.0
        self._inertia = np.tile(np.array([across, across, axial]) * body.mass_kg / bodies, (bodies, 1))
        kinds = [PRISMATIC if self._stretches and j % 2 == 0 else SPHERICAL for j in range(joints)]
        self._joint_kind = np.array(kinds, dtype=np.int64)
        widths = np.where(self._joint_kind == SPHERICAL, 3, 1)
        self._first_dof = 6 + np.concatenate([[0], np.cumsum(widths)[:-1]]).astype(np.int64)
        self._size = int(6 + widths.sum())
        self._links = list(range(joints))
        self._torque_order: list[list[float]] = [[0.0]] * joints
        self._joint_quaternion = np.tile([0.0, 0.0, 0.0, 1.0], (joints, 1))
        self._joint_slide = np.zeros(joints)
        self._base_position, self._base_rotation = np.zeros(3), np.eye(3)
        self._velocity = np.zeros(self._size)
        self._rotation = np.zeros((bodies, 3, 3))
        self._centre, self._joint = np.zeros((bodies, 3)), np.zeros((bodies, 3))
        self._body_velocity, self._body_spin = np.zeros((bodies, 3)), np.zeros((bodies, 3))
        self._mass = np.zeros((self._size, self._size))
        self._force = np.zeros(self._size)
        self._outer = np.zeros(self._size)
        self._weight_N = np.outer(self._mass_kg, self._gravity_m_s2)
        self._load_N = self._weight_N  # with what rests on the robot
        self._friction_factor = 1.0
        self._drag = np.zeros((self._size, self._size))
        self._floats = self._world.ground == "none" and not self._bodies
        self._steps = 0
        self._has_drag = self._world.ground != "none" and self._world.friction_law == "viscous"

    def _build_world(self) -> None:
        p, client = pybullet, self._client
        # a robot that nothing touches is computed in the frame that falls with it, where gravity does nothing
        gravity_m_s2 = [0.0, 0.0, 0.0] if self._floats else self._gravity_m_s2.tolist()
        p.setGravity(*gravity_m_s2, physicsClientId=client)
        p.setPhysicsEngineParameter(
            fixedTimeStep=self._part_s,
            numSolverIterations=_SOLVER_ITERATIONS,
            numSubSteps=0,
            enableConeFriction=1,
            deterministicOverlappingPairs=1,
            solverResidualThreshold=0.0,
            contactBreakingThreshold=0.1 * self._body.radius_m,
            physicsClientId=client,
        )
        self._ground = add_ground(client, self._world, for_bodies=bool(self._bodies))
        self._others = add_bodies(client, self._bodies, self._world, self._ground)

    # ---------------------------------------------------------------- the twin's contract

    def set_rest(self, strain: FloatArray, stiffness: FloatArray) -> None:
        """Rest strains (ℓ, k1, k2) and section stiffness (3, 3), held until the next call."""
        segment_m = self._body.length_m / self._segments
        # k towards the centre of curvature turns the tangent: rotation vector per length = t × k = (−k2, k1, 0)
        self._rest_rotation = segment_m * np.array([-strain[2], strain[1], 0.0])
        self._rest_slide = segment_m * (strain[0] - 1.0)
        axial = stiffness[0, 0]
        # the stretch is free to follow a bend, so the bending stiffness is what is left with it relaxed
        bend = stiffness[1:, 1:] - np.outer(stiffness[1:, 0], stiffness[0, 1:]) / axial
        matrix = np.zeros((3, 3))
        matrix[:2, :2] = [[bend[1, 1], -bend[0, 1]], [-bend[0, 1], bend[0, 0]]]
        matrix[2, 2] = self._body.twisting_stiffness_N_m2
        self._rotation_stiffness = matrix / segment_m
        self._slide_stiffness = axial / segment_m

    def step(self) -> None:
        """Advance by one step. Raises SimulationError when the state is no longer finite."""
        for _ in range(self._parts):
            self._step()

    def _step(self) -> None:
        p, client = pybullet, self._client
        self._mass[:, :] = 0.0
        mass_matrix(
            self._joint_kind, self._first_dof, self._mass_kg, self._inertia,
            self._rotation, self._centre, self._joint, self._mass,
        )  # fmt: skip
        if self._floats:
            self._keep_momentum()
        if self._has_drag:
            self._viscous_drag()
        ok = implicit_joint_forces(
            self._part_s,
            self._body.damping_time_s,
            self._joint_kind,
            self._first_dof,
            self._joint_quaternion,
            self._joint_slide,
            self._velocity,
            self._rest_rotation,
            self._rest_slide,
            self._rotation_stiffness,
            self._slide_stiffness,
            self._drag,
            self._outer,
            self._mass,
            self._force,
        )
        if not ok or not np.isfinite(self._force).all():
            raise SimulationError(
                f"the segment twin left its range (a joint turned by over {np.degrees(3.0):.0f}° or is not finite): "
                "use a smaller step, more segments or a milder command"
            )
        force = self._force
        for j, (kind, d) in enumerate(zip(self._joint_kind, self._first_dof, strict=True)):
            self._torque_order[j] = force[d : d + 3].tolist() if kind == SPHERICAL else [float(force[d])]
        p.setJointMotorControlMultiDofArray(
            self._robot, self._links, p.TORQUE_CONTROL, forces=self._torque_order, physicsClientId=client
        )
        if self._has_drag:
            p.applyExternalForce(
                self._robot, -1, force[:3].tolist(), self._base_position.tolist(), p.WORLD_FRAME, physicsClientId=client
            )
            p.applyExternalTorque(self._robot, -1, force[3:6].tolist(), p.WORLD_FRAME, physicsClientId=client)
        p.stepSimulation(physicsClientId=client)
        self._steps += 1
        self._read_state()
        self._gather_outer_forces()

    def strain(self) -> FloatArray:
        """Mean strains (ℓ, k1, k2) now, shape (3,)."""
        stretch, curvature = self._mean_strain()
        return np.array([stretch, curvature[0], curvature[1]])

    def motion(self) -> Motion:
        """The robot now."""
        middle = len(self._mass_kg) // 2  # the mid cross-section is the near end of this body
        body_velocities(
            self._joint_kind,
            self._first_dof,
            self._rotation,
            self._centre,
            self._joint,
            self._velocity,
            self._body_velocity,
            self._body_spin,
        )
        momentum = np.empty(3)
        angular_momentum(
            self._mass_kg,
            self._inertia,
            self._rotation,
            self._centre,
            self._body_velocity,
            self._body_spin,
            momentum,
        )
        spin, lever = self._body_spin[middle], self._joint[middle] - self._centre[middle]
        stretch, curvature = self._mean_strain()
        first, last = self._ends()
        chord = last - first
        fallen_m, falling_m_s = self._fall()
        return Motion(
            rotation=_halfway(self._rotation[middle - 1], self._rotation[middle]),
            angular_velocity_rad_s=0.5 * (self._body_spin[middle - 1] + spin),
            mid_velocity_m_s=self._body_velocity[middle] + _cross(spin, lever) + falling_m_s,
            centre_of_mass_m=self._mass_kg @ self._centre / self._body.mass_kg + fallen_m,
            stretch=stretch,
            curvature_1_m=curvature,
            chord=chord / np.linalg.norm(chord),
            angular_momentum_kg_m2_s=momentum,
        )

    def shape(self) -> tuple[FloatArray, FloatArray]:
        """Centre line (n, 3) [m] and section axis e1 (n, 3) along the robot now."""
        first, last = self._ends()
        points = np.vstack([first, self._joint[1:], last]) + self._fall()[0]
        axes = np.vstack([self._rotation[0, :, 0], self._rotation[1:, :, 0], self._rotation[-1, :, 0]])
        return points, axes

    def elastic_energy_J(self) -> float:
        """Of the joints, against the rest strains [J]."""
        turn, total = np.empty(3), 0.0
        for kind, quaternion, slide in zip(self._joint_kind, self._joint_quaternion, self._joint_slide, strict=True):
            if kind == SPHERICAL:
                rotation_vector(quaternion, turn)
                off = turn - self._rest_rotation
                total += 0.5 * float(off @ self._rotation_stiffness @ off)
            else:
                total += 0.5 * float(self._slide_stiffness) * float(slide - self._rest_slide) ** 2
        return total

    def energy_J(self) -> float:
        """Kinetic, elastic (against the rest strains) and gravitational energy [J], the ground's springs left out."""
        self.motion()  # the velocities of the bodies
        fallen_m, falling_m_s = self._fall()
        velocity = self._body_velocity + falling_m_s
        spin = np.einsum("bki,bk->bi", self._rotation, self._body_spin)  # in each body's own axes
        kinetic = 0.5 * float(self._mass_kg @ np.sum(velocity**2, axis=1) + np.sum(self._inertia * spin**2))
        weight = float(np.sum(self._weight_N * (self._centre + fallen_m)))
        return kinetic + self.elastic_energy_J() - weight

    def centre_velocity_m_s(self) -> FloatArray:
        """Of the centre of mass, shape (3,) [m/s]."""
        self.motion()
        velocity: FloatArray = self._mass_kg @ self._body_velocity / self._body.mass_kg + self._fall()[1]
        return velocity

    @property
    def penetration_m(self) -> float:
        """How deep the lowest segment's centre is below where it would just touch a flat floor [m]."""
        if self._world.ground != "plane":
            return 0.0
        return max(0.0, self._body.radius_m - float(self._centre[:, 2].min()))

    def bodies(self) -> list[NamedPose]:
        """Name, centre [m] and orientation (x, y, z, w) of each of the other bodies now."""
        poses = [pose_of(self._client, number) for number in self._others]
        return [(name, *pose) for name, pose in zip(names_of(self._bodies), poses, strict=True)]

    def close(self) -> None:
        """Disconnect from PyBullet."""
        if self._client >= 0:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = -1

    @property
    def alone(self) -> bool:
        """Whether there are no other bodies."""
        return not self._bodies

    @property
    def radius_m(self) -> float:
        """Of the tube [m]."""
        return self._body.radius_m

    def contact_centres_m(self) -> FloatArray:
        """Centres of the cross-sections that can touch the floor now, shape (segments, 3) [m]."""
        centres = self._centre[:: self._halves].copy()
        if self._stretches:
            centres += 0.5 * self._part_length_m[0] * self._rotation[:: self._halves, :, 2]
        return centres

    def change_floor(self, friction_factor: float, payload_share: float) -> None:
        """From now on: friction over that of the world; a weight on the robot over its own, without inertia."""
        if self._floats:  # there is no floor, and nothing rests on what falls
            return
        self._friction_factor = friction_factor
        for link in range(-1, len(self._links)):
            pybullet.changeDynamics(
                self._robot,
                link,
                lateralFriction=friction_factor * robot_factor(self._world),
                physicsClientId=self._client,
            )
        # weight without inertia is gravity, where nothing else has any
        self._load_N = (1.0 + payload_share) * self._weight_N
        pybullet.setGravity(*((1.0 + payload_share) * self._gravity_m_s2).tolist(), physicsClientId=self._client)

    def lay_kerb(self, height_m: float, riser_m: float) -> None:
        """From now on the floor rises by `height_m` at y = `riser_m`, outwards; the world has a step somewhere."""
        move_step(self._client, self._ground, self._world, height_m, riser_m)
        self._world = replace(self._world, step_height_m=height_m, step_distance_m=riser_m)

    # ---------------------------------------------------------------- inside

    def _gather_outer_forces(self) -> None:
        """Weight and contact forces of the step that was, in joint coordinates, for the next implicit solve."""
        if self._floats:
            return
        bodies, rows = list(range(len(self._mass_kg))), []
        for contact in pybullet.getContactPoints(self._robot, physicsClientId=self._client):
            first = contact[1] == self._robot  # the normal points from the second body to the first
            bodies.append(1 + (contact[3] if first else contact[4]))
            x, y, z = contact[5] if first else contact[6]
            sign = 1.0 if first else -1.0
            n, f, g = sign * contact[9], sign * contact[10], sign * contact[12]
            along, friction, across = contact[7], contact[11], contact[13]
            rows.append((x, y, z, *(n * along[k] + f * friction[k] + g * across[k] for k in range(3))))
        weights = np.column_stack([self._centre, self._load_N])
        acting = np.vstack([weights, rows]) if rows else weights
        generalised_forces(
            self._joint_kind,
            self._first_dof,
            self._rotation,
            self._centre[0],
            self._joint,
            np.array(bodies, dtype=np.int64),
            acting[:, :3],
            acting[:, 3:],
            self._outer,
        )

    def _read_state(self) -> None:
        p, client = pybullet, self._client
        position, quaternion = p.getBasePositionAndOrientation(self._robot, physicsClientId=client)
        linear, angular = p.getBaseVelocity(self._robot, physicsClientId=client)
        self._base_position = np.array(position)
        rotation_of(np.array(quaternion), self._base_rotation)
        self._velocity[:3], self._velocity[3:6] = linear, angular
        states = p.getJointStatesMultiDof(self._robot, self._links, physicsClientId=client)
        for j, state in enumerate(states):
            d = self._first_dof[j]
            if self._joint_kind[j] == SPHERICAL:
                self._joint_quaternion[j] = state[0]
                self._velocity[d : d + 3] = state[1]
            else:
                self._joint_slide[j] = state[0][0]
                self._velocity[d] = state[1][0]
        place_bodies(
            self._base_position, self._base_rotation, self._joint_kind, self._joint_quaternion, self._joint_slide,
            self._part_length_m, self._rotation, self._centre, self._joint,
        )  # fmt: skip

    def _keep_momentum(self) -> None:
        """Give the base the velocity that keeps the momentum of a robot that nothing touches: none.

        PyBullet's first-order step keeps joint and base velocities while the shape changes, and so makes angular
        momentum from nothing: a few percent of the floating robot's turning.
        """
        momentum = self._mass[:6] @ self._velocity  # linear, and angular about the base's centre
        self._velocity[:6] -= np.linalg.solve(self._mass[:6, :6], momentum)
        pybullet.resetBaseVelocity(
            self._robot, self._velocity[:3].tolist(), self._velocity[3:6].tolist(), physicsClientId=self._client
        )

    def _fall(self) -> tuple[FloatArray, FloatArray]:
        """How far and how fast the frame of a floating robot has fallen, shapes (3,) [m], [m/s]."""
        if not self._floats:
            return np.zeros(3), np.zeros(3)
        t_s = self._steps * self._part_s
        return 0.5 * t_s**2 * self._gravity_m_s2, t_s * self._gravity_m_s2

    def _mean_strain(self) -> tuple[float, FloatArray]:
        mean = np.empty(3)
        mean_rotation_vector(self._joint_kind, self._joint_quaternion, mean)
        mean *= self._segments / self._body.length_m
        stretch = 1.0
        if self._stretches:
            stretch += float(self._joint_slide.sum()) / self._body.length_m
        return stretch, np.array([mean[1], -mean[0]])

    def _ends(self) -> tuple[FloatArray, FloatArray]:
        half = 0.5 * self._part_length_m[0]
        return (
            self._centre[0] - half * self._rotation[0, :, 2],
            self._centre[-1] + half * self._rotation[-1, :, 2],
        )

    def _viscous_drag(self) -> None:
        """Drag of the floor in joint coordinates: each segment's lowest point slides through c·length."""
        self._drag[:, :] = 0.0
        radius_m = self._body.radius_m
        drag_N_s_m = self._friction_factor * self._world.friction * self._body.length_m / self._segments
        row = np.zeros((3, self._size))
        for b in range(0, len(self._mass_kg), self._halves):
            point = self._centre[b].copy()
            if self._stretches:
                point += 0.5 * self._part_length_m[b] * self._rotation[b, :, 2]
            height_m, normal = ground_at(self._world, point)
            if height_m > _TOUCHING * radius_m:
                continue
            point -= radius_m * normal
            row[:, :] = 0.0
            row[0, 0] = row[1, 1] = row[2, 2] = 1.0
            arm = point - self._centre[0]
            row[:, 3:6] = [[0.0, arm[2], -arm[1]], [-arm[2], 0.0, arm[0]], [arm[1], -arm[0], 0.0]]
            for a in range(1, b + 1):
                d = self._first_dof[a - 1]
                if self._joint_kind[a - 1] == SPHERICAL:
                    arm = point - self._joint[a]
                    for k in range(3):
                        row[:, d + k] = _cross(self._rotation[a, :, k], arm)
                else:
                    row[:, d] = self._rotation[a, :, 2]
            sliding = row - np.outer(normal, normal @ row)
            self._drag += drag_N_s_m * sliding.T @ sliding


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """a × b; numpy's own takes ten times as long for three numbers."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _halfway(first: FloatArray, second: FloatArray) -> FloatArray:
    """The rotation midway between two near ones: their mean, made orthonormal."""
    mean = first + second
    tangent = mean[:, 2] / np.linalg.norm(mean[:, 2])
    across = mean[:, 0] - tangent * (tangent @ mean[:, 0])
    across /= np.linalg.norm(across)
    return np.column_stack([across, _cross(tangent, across), tangent])
