"""The robot as PyBullet is given it: a chain of links with spheres or capsules, joints free, contacts yielding."""

from __future__ import annotations

import math

import numpy as np
import pybullet
from numpy.typing import NDArray

from sim.body import Body, World
from sim.chain import PRISMATIC, SPHERICAL
from sim.scenery import ground_factor, robot_factor
from softbot.errors import InputError

FloatArray = NDArray[np.float64]

_CONTACT_SINK = 0.01  # static penetration over radius
_CONTACT_DAMPING_RATIO = 1.0
_SPEED_LIMIT = 1e4  # PyBullet clamps joint speeds at 100 unless told otherwise


def make_chain(
    client: int,
    body: Body,
    world: World,
    joint_kind: NDArray[np.int64],
    mass_kg: FloatArray,
    inertia_kg_m2: FloatArray,
    *,
    capsules: bool,
) -> int:
    """Make the chain, straight and lying on the floor; returns PyBullet's number of it.

    joint_kind: SPHERICAL or PRISMATIC (`sim.chain`), shape (n − 1,); mass_kg: of its n equally long parts;
    inertia_kg_m2: in each part's own axes, shape (n, 3); a prismatic joint halves a segment. capsules: a part is one,
    where else a segment touches with a sphere at its centre.

    Raises InputError for a resistance to rolling that no load could give.
    """
    p, parts = pybullet, len(mass_kg)
    links, length = parts - 1, body.length_m / parts
    stretches = PRISMATIC in joint_kind
    rolling_factor = _rolling_friction(body, world)
    shapes = [_shape(client, body.radius_m, length, part, stretches, capsules) for part in range(parts)]
    height = body.radius_m if world.ground != "none" else 0.0
    robot = int(
        p.createMultiBody(
            baseMass=mass_kg[0],
            baseCollisionShapeIndex=shapes[0],
            basePosition=[-0.5 * body.length_m + 0.5 * length, 0.0, height],
            # z (tangent) along world x, x (e1) along world y, the robot's left
            baseOrientation=[0.5, 0.5, 0.5, 0.5],
            linkMasses=mass_kg[1:].tolist(),
            linkCollisionShapeIndices=shapes[1:],
            linkVisualShapeIndices=[-1] * links,
            linkPositions=[[0.0, 0.0, 0.5 * length]] + [[0.0, 0.0, length]] * (links - 1),
            linkOrientations=[[0.0, 0.0, 0.0, 1.0]] * links,
            linkInertialFramePositions=[[0.0, 0.0, 0.5 * length]] * links,
            linkInertialFrameOrientations=[[0.0, 0.0, 0.0, 1.0]] * links,
            linkParentIndices=list(range(links)),
            linkJointTypes=[p.JOINT_SPHERICAL if k == SPHERICAL else p.JOINT_PRISMATIC for k in joint_kind],
            linkJointAxis=[[0.0, 0.0, 1.0]] * links,
            physicsClientId=client,
        )
    )
    contact = _contact_compliance(body, world, parts // 2 if stretches else parts)
    for part in range(parts):
        link = part - 1
        p.changeDynamics(
            robot,
            link,
            localInertiaDiagonal=inertia_kg_m2[part].tolist(),
            lateralFriction=robot_factor(world),
            rollingFriction=rolling_factor,
            spinningFriction=0.0,
            restitution=0.0,
            linearDamping=0.0,
            angularDamping=0.0,
            jointDamping=0.0,
            physicsClientId=client,
            **contact,
        )
        # in calls of their own: PyBullet drops every other argument for a link that comes with one of these
        p.changeDynamics(robot, link, maxJointVelocity=_SPEED_LIMIT, physicsClientId=client)
        p.changeDynamics(robot, link, activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING, physicsClientId=client)
        if stretches and part % 2 == 1 and not capsules:
            # only the first half touches; a body without any shape loses its inertia
            p.setCollisionFilterGroupMask(robot, link, 0, 0, physicsClientId=client)
    _switch_motors_off(client, robot, joint_kind)
    return robot


def _shape(client: int, radius_m: float, length_m: float, part: int, stretches: bool, capsules: bool) -> int:
    p = pybullet
    centre_m = 0.0 if part == 0 else 0.5 * length_m  # link frames sit at their joint, the base's at its centre
    if capsules:
        return int(
            p.createCollisionShape(
                p.GEOM_CAPSULE,
                radius=radius_m,
                height=length_m,
                collisionFramePosition=[0, 0, centre_m],
                physicsClientId=client,
            )
        )
    # the sphere sits at the middle of the whole segment: at the far end of its first half
    offset_m = 0.5 * length_m if stretches and part % 2 == 0 else 0.0
    return int(
        p.createCollisionShape(
            p.GEOM_SPHERE,
            radius=radius_m,
            collisionFramePosition=[0, 0, centre_m + offset_m],
            physicsClientId=client,
        )
    )


def _switch_motors_off(client: int, robot: int, joint_kind: NDArray[np.int64]) -> None:
    p = pybullet
    for j, kind in enumerate(joint_kind):
        if kind == SPHERICAL:
            p.setJointMotorControlMultiDof(
                robot, j, p.POSITION_CONTROL, targetPosition=[0, 0, 0, 1], targetVelocity=[0, 0, 0],
                positionGain=0, velocityGain=0, force=[0, 0, 0], physicsClientId=client,
            )  # fmt: skip
        else:
            p.setJointMotorControl2(robot, j, p.VELOCITY_CONTROL, force=0, physicsClientId=client)


def _contact_compliance(body: Body, world: World, segments: int) -> dict[str, float]:
    """Stiffness and damping of one segment's contact: its weight sinks it by a small part of the radius.

    A rigid contact leaves the sharing of the load between ten spheres on a floor to rounding errors.
    """
    weight_N = -body.mass_kg * float(world.gravity_vector_m_s2[2]) / segments
    if world.ground == "none" or weight_N <= 0.0:
        return {}
    stiffness_N_m = weight_N / (_CONTACT_SINK * body.radius_m)
    damping_N_s_m = 2.0 * _CONTACT_DAMPING_RATIO * math.sqrt(stiffness_N_m * body.mass_kg / segments)
    return {"contactStiffness": stiffness_N_m, "contactDamping": damping_N_s_m}


def _rolling_friction(body: Body, world: World) -> float:
    """Factor of rolling friction [m] that gives the whole robot's weight the moment M_th."""
    moment_N_m = world.rolling_resistance_N_m
    load_N = -body.mass_kg * float(world.gravity_vector_m_s2[2])
    if moment_N_m == 0.0 or world.ground == "none":
        return 0.0
    if load_N <= 0.0:
        raise InputError(
            f"world.rolling_resistance_N_m = {moment_N_m:g}: the segment twin has it from the load on the floor, "
            'and without gravity there is none; set it to 0, or take solver.twin = "rod"'
        )
    return float(moment_N_m / load_N / ground_factor(world))
