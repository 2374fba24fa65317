"""What surrounds the robot, as PyBullet shapes: the ground, and the other bodies of a scene.

Coefficients of friction are products of two shapes' factors there. They are chosen so that the robot on the ground has
the world's coefficient, and a body on the ground and on the robot its own; between two bodies it is then the product
of theirs over the world's. A robot without Coulomb friction on the ground (viscous law, or coefficient 0) has the
factor 0, and so no friction on bodies either where PyBullet computes it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pybullet
from numpy.typing import NDArray

from sim.bodies import BOX, CYLINDER, OtherBody, names_of, signed_distance
from sim.body import World
from softbot.errors import InputError

_FLOOR_HALF_M = 2000.0  # of a floor that is a box: further than any body starts
_FLOOR_DEPTH_M = 100.0
_PIPE_LENGTH_M = 20.0
_SPEED_LIMIT = 1e4  # PyBullet clamps speeds at 100 m/s and rad/s unless told otherwise
_OVERLAP = 1e-3  # over the smallest half size: what bodies that were put in contact may have by rounding

FloatArray = NDArray[np.float64]
Pose = tuple[tuple[float, float, float], tuple[float, float, float, float]]
NamedPose = tuple[str, tuple[float, float, float], tuple[float, float, float, float]]
"""Name, centre [m], orientation (x, y, z, w)."""


def ground_factor(world: World) -> float:
    """The ground's factor of friction, and the robot's: its square is the world's Coulomb coefficient."""
    return math.sqrt(world.friction) if world.friction_law == "coulomb" and world.friction > 0.0 else 1.0


def robot_factor(world: World) -> float:
    """The robot's factor of friction."""
    return ground_factor(world) if world.friction_law == "coulomb" and world.friction > 0.0 else 0.0


def add_ground(client: int, world: World, *, for_bodies: bool) -> list[int]:
    """Make the ground of a world; returns its PyBullet bodies, none where there is no ground.

    for_bodies: bodies slide on it. A box that slides on PyBullet's plane sinks in (7 mm at 0.1 m/s and a step of 5 ms),
    because one corner is found a step; on a box all four are, and it sinks 10 µm. Spheres are the same on both.
    """
    p = pybullet
    shapes: list[tuple[int, list[float]]] = []
    if world.ground in ("plane", "step"):
        if for_bodies:
            half = [_FLOOR_HALF_M, _FLOOR_HALF_M, 0.5 * _FLOOR_DEPTH_M]
            floor = p.createCollisionShape(p.GEOM_BOX, halfExtents=half, physicsClientId=client)
            shapes.append((floor, [0.0, 0.0, -half[2]]))
        else:
            floor = p.createCollisionShape(p.GEOM_PLANE, planeNormal=[0, 0, 1], physicsClientId=client)
            shapes.append((floor, [0.0, 0.0, 0.0]))
    if world.ground == "step":
        size, centre_y_m = _raised(world)
        step = p.createCollisionShape(p.GEOM_BOX, halfExtents=size, physicsClientId=client)
        shapes.append((step, [0.0, centre_y_m, world.step_height_m - size[2]]))
    if world.ground == "pipe":
        s = math.sqrt(0.5)
        pipe = p.createCollisionShape(
            p.GEOM_CYLINDER,
            radius=world.pipe_radius_m,
            height=_PIPE_LENGTH_M,
            collisionFrameOrientation=[-s, 0.0, 0.0, s] if world.pipe_axis == "across" else [0.0, s, 0.0, s],
            physicsClientId=client,
        )
        shapes.append((pipe, [0.0, 0.0, -world.pipe_radius_m]))
    made = []
    for shape, place in shapes:
        made.append(p.createMultiBody(0.0, shape, basePosition=place, physicsClientId=client))
        _without_extras(client, made[-1], ground_factor(world))
    return made


def move_step(client: int, ground: Sequence[int], world: World, height_m: float, riser_m: float) -> None:
    """Let the step of a world that was made (`add_ground`) rise by another height, somewhere else, outwards."""
    (_, half_m, half_depth_m), _ = _raised(world)  # as the box was made
    centre_m = [0.0, riser_m + math.copysign(half_m, riser_m), height_m - half_depth_m]
    pybullet.resetBasePositionAndOrientation(ground[1], centre_m, [0.0, 0.0, 0.0, 1.0], physicsClientId=client)


def ground_at(world: World, point_m: FloatArray) -> tuple[float, FloatArray]:
    """Distance of a point from the ground [m], and the ground's normal there, shape (3,)."""
    x, y, z = (float(value) for value in point_m)
    nearest = (math.inf, 0.0, 0.0, 1.0)
    if world.ground in ("plane", "step"):
        nearest = (z, 0.0, 0.0, 1.0)
    if world.ground == "step":
        size, centre_y_m = _raised(world)
        nearest = min(nearest, signed_distance(BOX, *size, x, y - centre_y_m, z - world.step_height_m + size[2]))
    if world.ground == "pipe":
        size = (world.pipe_radius_m, world.pipe_radius_m, 0.5 * _PIPE_LENGTH_M)
        up = z + world.pipe_radius_m
        if world.pipe_axis == "across":
            distance, nx, nz, ny = signed_distance(CYLINDER, *size, x, up, y)
        else:
            distance, ny, nz, nx = signed_distance(CYLINDER, *size, y, up, x)
        nearest = (distance, nx, ny, nz)
    return nearest[0], np.array(nearest[1:])


def _raised(world: World) -> tuple[tuple[float, float, float], float]:
    """Half sizes of the box beyond a step's riser, and y of its centre; it goes deep, so that nothing is under it."""
    size = (_FLOOR_HALF_M, 0.5 * _FLOOR_HALF_M, 0.5 * (_FLOOR_DEPTH_M + world.step_height_m))
    return size, world.step_distance_m + math.copysign(size[1], world.step_distance_m)


def add_bodies(client: int, bodies: Sequence[OtherBody], world: World, ground: Sequence[int]) -> list[int]:
    """Make the bodies where they start; returns their PyBullet bodies.

    Raises InputError for bodies that start inside each other or inside the ground.
    """
    p = pybullet
    names, made = names_of(bodies), list[int]()
    for index, body in enumerate(bodies):
        half, centre = body.half_size_m, _centre_m(index, body, world)
        if body.code == BOX:
            shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=half, physicsClientId=client)
        elif body.code == CYLINDER:
            shape = p.createCollisionShape(p.GEOM_CYLINDER, radius=half[0], height=2 * half[2], physicsClientId=client)
        else:
            shape = p.createCollisionShape(p.GEOM_SPHERE, radius=half[0], physicsClientId=client)
        number = p.createMultiBody(
            body.kilograms, shape, basePosition=centre, baseOrientation=body.quaternion, physicsClientId=client
        )
        _without_extras(client, number, body.friction / ground_factor(world))
        if not body.is_fixed:
            inertia = {"localInertiaDiagonal": list(body.inertia_kg_m2)}
            p.changeDynamics(number, -1, physicsClientId=client, **inertia)
            p.changeDynamics(number, -1, maxJointVelocity=_SPEED_LIMIT, physicsClientId=client)
            p.resetBaseVelocity(number, body.velocity_m_s, [0.0, 0.0, 0.0], physicsClientId=client)
        others = [(other, f"body.{n} ({names[n]})", bodies[n].is_fixed) for n, other in enumerate(made)]
        others += [(other, "the ground", True) for other in ground]
        for other, what, stays in others:
            room_m = _room_m(client, number, other)
            if room_m < -_OVERLAP * min(half) and not (stays and body.is_fixed):
                raise InputError(
                    f"body.{index}.position_m = {list(body.position_m)}: {names[index]} starts {-room_m:.3g} m inside "
                    f"{what}; move one of them"
                )
        made.append(number)
    return made


def pose_of(client: int, number: int) -> Pose:
    """Centre [m] and orientation (x, y, z, w) of a body now."""
    position, quaternion = pybullet.getBasePositionAndOrientation(number, physicsClientId=client)
    return position, quaternion


def _centre_m(index: int, body: OtherBody, world: World) -> tuple[float, float, float]:
    try:
        return body.centre_m(world)
    except ValueError as error:
        raise InputError(f"body.{index}.position_m = {list(body.position_m)}: {error}") from None


def _room_m(client: int, first: int, second: int) -> float:
    """Distance of two PyBullet bodies, negative where they overlap; at most 0."""
    return min(
        (contact[8] for contact in pybullet.getClosestPoints(first, second, 0.0, physicsClientId=client)), default=0.0
    )


def _without_extras(client: int, number: int, factor: float) -> None:
    """Friction as given, and none of what PyBullet adds to it."""
    pybullet.changeDynamics(
        number,
        -1,
        lateralFriction=factor,
        restitution=0.0,
        rollingFriction=0.0,
        spinningFriction=0.0,
        linearDamping=0.0,
        angularDamping=0.0,
        physicsClientId=client,
    )
