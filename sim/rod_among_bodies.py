"""The rod twin among other bodies: pushed by them and pushing them, step by step.

Two engines share each step. The rod has its own contact with the ground; PyBullet has the other bodies, their contact
with the ground and with each other. Between the two stands `sim.body_contact`: from where both are at the start of a
step it computes soft contact forces that hold for that step, equal and opposite, so momentum passes without loss.

What need not be computed is left out:
- while no body is within reach, that is for as many steps as the nearest gap would take to close at
  APPROACH_LIMIT_M_S, contact is not looked for; if no body moves, those steps go to the rod alone, in one block.
- PyBullet stands still while no body that can move is touched, and all have been slower than QUIET_SPEED (of their
  surface, over √(gR)) for QUIET_S.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
import pybullet
from numpy.typing import NDArray

from sim.bodies import OtherBody, names_of
from sim.body import Body, Motion, Twin, World
from sim.body_contact import Feelers, Obstacles, lay_feelers, nearest_m, press
from sim.chain import rotation_of
from sim.scenery import NamedPose, add_bodies, add_ground
from softbot.errors import InputError, SimulationError

FloatArray = NDArray[np.float64]

APPROACH_LIMIT_M_S = 10.0
QUIET_SPEED, QUIET_S = 1e-3, 0.1

_SINK = 1e-3  # of the tube under its own weight, evenly loaded, into a body; over its radius
_REFERENCE_GRAVITY_M_S2 = 9.81  # for that: how soft a wall is does not depend on the scene's gravity
_DAMPING_RATIO = 2.0  # of the whole tube; where it touches in few places less of it is at work
_SOLVER_ITERATIONS = 30
_LONGEST_STEP_S = 2.5e-3  # of PyBullet: with longer ones what slides sinks into the floor
_SPEED_LIMIT = 1e3  # m/s and rad/s of a body: beyond, something has burst


class PushedRod(Twin, Protocol):
    """A rod that outside forces and moments act on: what is asked of `sim.rod.RodTwin` here."""

    @property
    def push_N(self) -> FloatArray:
        """Outside forces on the points, shape (n, 3), world axes, held until changed: a view."""

    @property
    def push_N_m(self) -> FloatArray:
        """Outside moments on the sections at the points, shape (n, 3), world axes, held until changed: a view."""

    def points(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Centre [m], velocity [m/s] and angular velocity [rad/s] of the points, each (n, 3)."""

    def wake(self) -> None:
        """Something outside has changed."""

    def advance(self, count: int) -> None:
        """Steps under the same rest strains and pushes."""

    def play(self, drive: FloatArray, samples: int, steps: int) -> FloatArray:
        """Steps under a drive; a row of `sim.motion_rows` for each sample."""


class RodAmongBodies:
    """A rod and the other bodies of a scene. Implements `sim.body.Twin`, and `play` as the rod does.

    rod: straight, as it starts, both halves computed (not `symmetric`). robot, world: what the rod was made of.
    Raises InputError for bodies that start inside each other or inside the ground, or a rod of too few points.
    """

    def __init__(self, rod: PushedRod, bodies: Sequence[OtherBody], robot: Body, world: World) -> None:
        self.rod = rod
        self._robot, self._names = robot, names_of(bodies)
        centre, _, _ = rod.points()
        place_m = centre[:, 0] - rod.motion().centre_of_mass_m[0]
        if not (place_m.min() < 0.0 < place_m.max()):
            raise InputError("a rod among other bodies is computed whole: make it with symmetric=False")
        self._feelers: Feelers = lay_feelers(place_m, robot.length_m, robot.radius_m)
        ends = np.concatenate([[-0.5 * robot.length_m], np.sort(place_m), [0.5 * robot.length_m]])
        self._slack_m = float(np.diff(ends).max())
        stiffness_1_s2 = _REFERENCE_GRAVITY_M_S2 / (_SINK * robot.radius_m)
        rate_1_s = math.sqrt(stiffness_1_s2)
        self._law = (
            rod.step_s,
            robot.radius_m,
            robot.mass_kg / len(self._feelers.first),
            stiffness_1_s2,
            2.0 * _DAMPING_RATIO * rate_1_s,
        )
        self._quiet_m_s = QUIET_SPEED * math.sqrt(_REFERENCE_GRAVITY_M_S2 * robot.radius_m)
        self._obstacles = _obstacles(bodies, len(self._feelers.first))
        self._movable = [index for index, body in enumerate(bodies) if not body.is_fixed]
        self._size_m = np.linalg.norm([body.half_size_m for body in bodies], axis=1) if bodies else np.zeros(0)
        self._parts = max(1, math.ceil(rod.step_s / _LONGEST_STEP_S - 1e-9))
        self._client = pybullet.connect(pybullet.DIRECT)
        try:
            self._numbers = self._build(bodies, world)
        except InputError:
            self.close()
            raise
        except pybullet.error as error:
            self.close()
            raise SimulationError(f"PyBullet refused the bodies: {error}") from None
        for index in range(len(bodies)):
            self._read(index)
        self._quiet_s = 0.0
        self._free_steps = 0
        self._pushes = False

    def _build(self, bodies: Sequence[OtherBody], world: World) -> list[int]:
        pybullet.setGravity(*world.gravity_vector_m_s2.tolist(), physicsClientId=self._client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=self.rod.step_s / self._parts,
            numSolverIterations=_SOLVER_ITERATIONS,
            numSubSteps=0,
            enableConeFriction=1,
            deterministicOverlappingPairs=1,
            solverResidualThreshold=0.0,
            physicsClientId=self._client,
        )
        ground = add_ground(self._client, world, for_bodies=True)
        return add_bodies(self._client, bodies, world, ground)

    # ---------------------------------------------------------------- the twin's contract

    @property
    def step_s(self) -> float:
        """Step of the integration [s]."""
        return self.rod.step_s

    def set_rest(self, strain: FloatArray, stiffness: FloatArray) -> None:
        """Rest strains (ℓ, k1, k2) and section stiffness (3, 3), held until the next call."""
        self.rod.set_rest(strain, stiffness)

    def step(self) -> None:
        """Advance by one step. Raises SimulationError when the state is no longer finite."""
        self.advance(1)

    def advance(self, count: int) -> None:
        """Advance by `count` steps under the same rest strains. Raises SimulationError as `step`."""
        while count > 0:
            block = self._exchange(count)
            self.rod.advance(block)
            self._move_bodies(block)
            count -= block

    def play(self, drive: FloatArray, samples: int, steps: int) -> FloatArray:
        """Advance by `samples` times `steps` steps, driven by `drive` (`sim.rod_drive.drive_array`).

        Returns a row of `sim.motion_rows` after each sample, shape (samples, ROW_SIZE). Raises SimulationError as
        `step` does.
        """
        rows: list[FloatArray] = []
        while len(rows) < samples:
            left = (samples - len(rows)) * steps
            block = self._exchange(left)
            if block >= steps:  # whole samples
                block -= block % steps
                rows.extend(self.rod.play(drive, block // steps, steps))
                self._move_bodies(block)
                continue
            for done in range(steps):
                if done:
                    self._exchange(1)
                row = self.rod.play(drive, 1, 1)
                self._move_bodies(1)
            rows.extend(row)
        return np.array(rows)

    def strain(self) -> FloatArray:
        """Mean strains (ℓ, k1, k2) now, shape (3,)."""
        return self.rod.strain()

    def motion(self) -> Motion:
        """The robot now."""
        return self.rod.motion()

    def shape(self) -> tuple[FloatArray, FloatArray]:
        """Centre line (n, 3) [m] and section axis e1 (n, 3) along the robot now."""
        return self.rod.shape()

    def close(self) -> None:
        """Release what both engines hold."""
        if self._client >= 0:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = -1
        self.rod.close()

    # ---------------------------------------------------------------- the bodies

    def bodies(self) -> list[NamedPose]:
        """Name, centre [m] and orientation (x, y, z, w) of each body now."""
        poses = [pybullet.getBasePositionAndOrientation(n, physicsClientId=self._client) for n in self._numbers]
        return [(name, *pose) for name, pose in zip(self._names, poses, strict=True)]

    def velocities(self) -> tuple[FloatArray, FloatArray]:
        """Linear [m/s] and angular [rad/s] velocity of each body now, each (bodies, 3)."""
        return self._obstacles.velocity_m_s.copy(), self._obstacles.spin_rad_s.copy()

    def body_force_N(self) -> FloatArray:
        """Force of the robot on each body in the last step, shape (bodies, 3)."""
        return self._obstacles.force_N.copy()

    @property
    def bodies_asleep(self) -> bool:
        """Whether no body moves, so that PyBullet stands still."""
        return self._quiet_s >= QUIET_S or not self._movable

    # ---------------------------------------------------------------- inside

    def _exchange(self, most: int) -> int:
        """Set the forces of the next step; how many steps (at most `most`) the rod may go before they are due again."""
        if self._free_steps > 0:
            block = min(self._free_steps, most)
            self._free_steps -= block
            return block
        centre, velocity, spin = self.rod.points()
        if not self._pushes:
            gap_m = nearest_m(self._robot.radius_m, self._obstacles, centre) - self._slack_m
            free = min(gap_m / (APPROACH_LIMIT_M_S * self.rod.step_s), 1e9)
            if free >= 1.0:
                self._free_steps = int(free) if self.bodies_asleep else 1
                return self._exchange(most)
        touched = press(
            *self._law, self._feelers, self._obstacles, centre, velocity, spin, self.rod.push_N, self.rod.push_N_m
        )  # fmt: skip
        if touched or self._pushes:
            self.rod.wake()
        if touched == 2:
            self._quiet_s = 0.0
        self._pushes = touched > 0
        return 1

    def _move_bodies(self, steps: int) -> None:
        if self.bodies_asleep:
            return
        p, client, obstacles = pybullet, self._client, self._obstacles
        for _ in range(steps * self._parts):
            if self._pushes:
                for index in self._movable:
                    force = obstacles.force_N[index]
                    if force.any():
                        number = self._numbers[index]
                        place = obstacles.position_m[index].tolist()  # in all parts of the step, as the rod feels it
                        p.applyExternalForce(number, -1, force.tolist(), place, p.WORLD_FRAME, physicsClientId=client)
                        p.applyExternalTorque(
                            number, -1, obstacles.moment_N_m[index].tolist(), p.WORLD_FRAME, physicsClientId=client
                        )
            p.stepSimulation(physicsClientId=client)
        fastest = 0.0
        for index in self._movable:
            fastest = max(fastest, self._read(index))
        if not fastest < _SPEED_LIMIT:
            raise SimulationError(
                f"a body left its range (moving at {fastest:.3g} m/s): use a smaller solver.step_s, a heavier body, or "
                "more room between the bodies"
            )
        self._quiet_s = self._quiet_s + steps * self.rod.step_s if fastest < self._quiet_m_s else 0.0

    def _read(self, index: int) -> float:
        """Take over a body's state; returns a bound of the speed of its surface [m/s]."""
        obstacles, number = self._obstacles, self._numbers[index]
        position, quaternion = pybullet.getBasePositionAndOrientation(number, physicsClientId=self._client)
        linear, angular = pybullet.getBaseVelocity(number, physicsClientId=self._client)
        obstacles.position_m[index] = position
        rotation_of(np.array(quaternion), obstacles.rotation[index])
        obstacles.velocity_m_s[index] = linear
        obstacles.spin_rad_s[index] = angular
        return math.hypot(*linear) + self._size_m[index] * math.hypot(*angular)


def _obstacles(bodies: Sequence[OtherBody], feelers: int) -> Obstacles:
    count = len(bodies)
    mass = np.array([body.kilograms for body in bodies])
    inertia = np.array([body.inertia_kg_m2 for body in bodies]).reshape(count, 3)
    with np.errstate(divide="ignore"):
        mobility, turning = np.where(mass > 0.0, 1.0 / mass, 0.0), np.where(inertia > 0.0, 1.0 / inertia, 0.0)
    return Obstacles(
        code=np.array([body.code for body in bodies], dtype=np.int64),
        half_size_m=np.array([body.half_size_m for body in bodies]).reshape(count, 3),
        friction=np.array([body.friction for body in bodies]),
        mobility_1_kg=mobility,
        turning_1_kg_m2=turning,
        position_m=np.zeros((count, 3)),
        rotation=np.zeros((count, 3, 3)),
        velocity_m_s=np.zeros((count, 3)),
        spin_rad_s=np.zeros((count, 3)),
        spring_m=np.zeros((count, feelers, 3)),
        force_N=np.zeros((count, 3)),
        moment_N_m=np.zeros((count, 3)),
    )
