"""Kinematics, mass matrix and implicit joint forces of a chain of rigid segments (plain arrays, compiled).

The segment twin leaves contact and integration to PyBullet and computes here what PyBullet does not offer: joint
forces taken linearly implicitly. Explicit spring torques blow up on such a chain; solving

    (M + h C + h² K) a = −K̃(q + h v) − C v        and applying     f = −K̃(q + h v + h² a) − C (v + h a)

is stable. (PyBullet's own `calculateMassMatrix` ignores inertias set after creation, so M is made here too.)

Bodies are numbered along the chain, body 0 is the floating base. Body b > 0 hangs on its predecessor by a spherical or
a prismatic joint. Frames: z along the tangent, x = e1, y = e2. Velocities: base linear (centre of mass) and angular in
world axes, spherical joints in the axes of the child body (as PyBullet has them), prismatic joints along z.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SPHERICAL, PRISMATIC = 0, 1
MAX_ROTATION_RAD = 3.0  # of one joint: beyond, the rotation vector is no longer smooth


@njit(cache=True)
def rotation_of(quaternion: FloatArray, out: FloatArray) -> None:
    """Rotation matrix (3, 3) of a unit quaternion (x, y, z, w)."""
    x, y, z, w = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    out[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    out[0, 1] = 2.0 * (x * y - z * w)
    out[0, 2] = 2.0 * (x * z + y * w)
    out[1, 0] = 2.0 * (x * y + z * w)
    out[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    out[1, 2] = 2.0 * (y * z - x * w)
    out[2, 0] = 2.0 * (x * z - y * w)
    out[2, 1] = 2.0 * (y * z + x * w)
    out[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@njit(cache=True)
def rotation_vector(quaternion: FloatArray, out: FloatArray) -> None:
    """Rotation vector [rad] of a unit quaternion (x, y, z, w), of size at most π."""
    sign = 1.0 if quaternion[3] >= 0.0 else -1.0
    sine = np.sqrt(quaternion[0] ** 2 + quaternion[1] ** 2 + quaternion[2] ** 2)
    factor = 2.0 * sign
    if sine > 1e-9:
        factor = 2.0 * sign * np.arctan2(sine, sign * quaternion[3]) / sine
    out[0] = factor * quaternion[0]
    out[1] = factor * quaternion[1]
    out[2] = factor * quaternion[2]


@njit(cache=True)
def vector_rate(vector: FloatArray, out: FloatArray) -> None:
    """Inverse right Jacobian (3, 3) of SO(3): rate of the rotation vector = out @ (angular velocity, child axes)."""
    size = np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    if size < 1e-4:
        c = 1.0 / 12.0
    else:
        c = 1.0 / (size * size) - 0.5 / (size * np.tan(0.5 * size))
    x, y, z = vector[0], vector[1], vector[2]
    square = x * x + y * y + z * z
    out[0, 0] = 1.0 + c * (x * x - square)
    out[1, 1] = 1.0 + c * (y * y - square)
    out[2, 2] = 1.0 + c * (z * z - square)
    out[0, 1] = -0.5 * z + c * x * y
    out[1, 0] = 0.5 * z + c * x * y
    out[0, 2] = 0.5 * y + c * x * z
    out[2, 0] = -0.5 * y + c * x * z
    out[1, 2] = -0.5 * x + c * y * z
    out[2, 1] = 0.5 * x + c * y * z


@njit(cache=True)
def place_bodies(
    base_position: FloatArray,
    base_rotation: FloatArray,
    joint_kind: IntArray,
    joint_quaternion: FloatArray,
    joint_slide: FloatArray,
    body_length: FloatArray,
    rotation: FloatArray,
    centre: FloatArray,
    joint: FloatArray,
) -> None:
    """Forward kinematics: body rotations (b, 3, 3), centres of mass (b, 3), joint points (b, 3; row 0 is unused)."""
    local = np.empty((3, 3))
    rotation[0] = base_rotation
    centre[0] = base_position
    for b in range(1, joint_kind.size + 1):
        tangent = rotation[b - 1, :, 2]
        if joint_kind[b - 1] == SPHERICAL:
            joint[b] = centre[b - 1] + 0.5 * body_length[b - 1] * tangent
            rotation_of(joint_quaternion[b - 1], local)
            rotation[b] = rotation[b - 1] @ local
        else:
            joint[b] = centre[b - 1] + (0.5 * body_length[b - 1] + joint_slide[b - 1]) * tangent
            rotation[b] = rotation[b - 1]
        centre[b] = joint[b] + 0.5 * body_length[b] * rotation[b, :, 2]


@njit(cache=True)
def mass_matrix(
    joint_kind: IntArray,
    first_dof: IntArray,
    mass: FloatArray,
    inertia: FloatArray,
    rotation: FloatArray,
    centre: FloatArray,
    joint: FloatArray,
    out: FloatArray,
) -> None:
    """Mass matrix (n, n) of the chain: composite bodies, from the free end to the base.

    `inertia` (b, 3) holds principal moments in body axes. Each column of motion is a twist about the world origin of
    the composite body behind its joint, so M[i, j] = S_iᵀ I_c(later of i, j) S_j.
    """
    bodies = mass.size
    size = out.shape[0]
    twist = np.zeros((size, 6))  # angular, linear velocity of the body point at the world origin
    owner = np.zeros(size, dtype=np.int64)
    origin = centre[0]
    for k in range(3):
        twist[k, 3 + k] = 1.0
        twist[3 + k, k] = 1.0  # angular velocity about the base's centre, taken as the origin
    for b in range(1, bodies):
        arm = joint[b] - origin
        if joint_kind[b - 1] == SPHERICAL:
            for k in range(3):
                d = first_dof[b - 1] + k
                owner[d] = b
                axis = rotation[b, :, k]
                twist[d, 0], twist[d, 1], twist[d, 2] = axis[0], axis[1], axis[2]
                twist[d, 3] = arm[1] * axis[2] - arm[2] * axis[1]
                twist[d, 4] = arm[2] * axis[0] - arm[0] * axis[2]
                twist[d, 5] = arm[0] * axis[1] - arm[1] * axis[0]
        else:
            d = first_dof[b - 1]
            owner[d] = b
            for k in range(3):
                twist[d, 3 + k] = rotation[b, k, 2]
    composite = np.zeros((6, 6))
    momentum = np.empty(6)
    d_high = size
    for b in range(bodies - 1, -1, -1):
        r = centre[b] - origin
        m = mass[b]
        square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
        for i in range(3):
            for j in range(3):
                moment = 0.0
                for k in range(3):
                    moment += rotation[b, i, k] * inertia[b, k] * rotation[b, j, k]
                composite[i, j] += moment - m * r[i] * r[j]
            composite[i, i] += m * square
            composite[3 + i, 3 + i] += m
        composite[0, 4] -= m * r[2]
        composite[0, 5] += m * r[1]
        composite[1, 3] += m * r[2]
        composite[1, 5] -= m * r[0]
        composite[2, 3] -= m * r[1]
        composite[2, 4] += m * r[0]
        composite[4, 0] -= m * r[2]
        composite[5, 0] += m * r[1]
        composite[3, 1] += m * r[2]
        composite[5, 1] -= m * r[0]
        composite[3, 2] -= m * r[1]
        composite[4, 2] += m * r[0]
        d_low = d_high
        while d_low > 0 and owner[d_low - 1] == b:
            d_low -= 1
        for d in range(d_low, d_high):
            for i in range(6):
                total = 0.0
                for j in range(6):
                    total += composite[i, j] * twist[d, j]
                momentum[i] = total
            for e in range(d + 1):
                total = 0.0
                for i in range(6):
                    total += momentum[i] * twist[e, i]
                out[d, e] = total
                out[e, d] = total
        d_high = d_low


@njit(cache=True)
def implicit_joint_forces(
    step_s: float,
    damping_time_s: float,
    joint_kind: IntArray,
    first_dof: IntArray,
    joint_quaternion: FloatArray,
    joint_slide: FloatArray,
    velocity: FloatArray,
    rest_rotation: FloatArray,
    rest_slide: float,
    rotation_stiffness: FloatArray,
    slide_stiffness: float,
    contact_drag: FloatArray,
    outer_force: FloatArray,
    mass: FloatArray,
    force: FloatArray,
) -> bool:
    """Joint forces f (n,), linearly implicit, from the springs K(φ − φ0) and Kelvin–Voigt damping C = damping_time·K.

    `rest_rotation` (3,) and `rotation_stiffness` (3, 3) hold for every spherical joint, `rest_slide` [m] and
    `slide_stiffness` [N/m] for every prismatic one. `contact_drag` (n, n) is viscous drag taken implicitly in the same
    solve (zero if none); its own force is added to `force` on all rows. `mass` is left as it is. False, and no force,
    when a joint is turned further than a rotation vector can say or anything is not finite.

    `outer_force` (n,) is what else acts (gravity, contact, gyroscopic terms), as it was in the last step: without it
    the spring's answer to the contact comes a step late, and a rolling robot is braked by its own time step.
    """
    size = mass.shape[0]
    phi = np.empty(3)
    rate = np.empty((3, 3))
    lever = np.empty((3, 3))
    matrix = mass.copy()
    torque = np.zeros(size)  # −K(q + h v − q0) − C v, without the drag
    implicit = step_s * (step_s + damping_time_s)
    stiff = np.zeros((joint_kind.size, 3, 3))
    ok = True
    for j in range(joint_kind.size):
        d = first_dof[j]
        if joint_kind[j] == SPHERICAL:
            rotation_vector(joint_quaternion[j], phi)
            if not phi[0] ** 2 + phi[1] ** 2 + phi[2] ** 2 <= MAX_ROTATION_RAD**2:  # or not a number
                ok = False
            vector_rate(phi, rate)
            # stiffness in child axes: rateᵀ K rate; torque: −rateᵀ K (φ − φ0 + (h + τ) rate v)
            for a in range(3):
                for b in range(3):
                    total = 0.0
                    for c in range(3):
                        total += rotation_stiffness[a, c] * rate[c, b]
                    lever[a, b] = total
            for a in range(3):
                pull = 0.0
                for c in range(3):
                    spring = 0.0
                    for b in range(3):
                        spring += rotation_stiffness[c, b] * (phi[b] - rest_rotation[b])
                        spring += (step_s + damping_time_s) * lever[c, b] * velocity[d + b]
                    pull += rate[c, a] * spring
                torque[d + a] = -pull
                for b in range(3):
                    total = 0.0
                    for c in range(3):
                        total += rate[c, a] * lever[c, b]
                    stiff[j, a, b] = total
                    matrix[d + a, d + b] += implicit * total
        else:
            torque[d] = -slide_stiffness * (joint_slide[j] - rest_slide + (step_s + damping_time_s) * velocity[d])
            stiff[j, 0, 0] = slide_stiffness
            matrix[d, d] += implicit * slide_stiffness
    drag = contact_drag @ velocity
    matrix += step_s * contact_drag
    loads = torque - drag + outer_force
    if not (ok and np.isfinite(matrix).all() and np.isfinite(loads).all()):
        return False
    acceleration = np.linalg.solve(matrix, loads)
    force[:] = torque - drag - step_s * (contact_drag @ acceleration)
    for j in range(joint_kind.size):
        d = first_dof[j]
        if joint_kind[j] == SPHERICAL:
            for a in range(3):
                for b in range(3):
                    force[d + a] -= implicit * stiff[j, a, b] * acceleration[d + b]
        else:
            force[d] -= implicit * stiff[j, 0, 0] * acceleration[d]
    return ok


@njit(cache=True)
def generalised_forces(
    joint_kind: IntArray,
    first_dof: IntArray,
    rotation: FloatArray,
    base_centre: FloatArray,
    joint: FloatArray,
    body: IntArray,
    point: FloatArray,
    force: FloatArray,
    out: FloatArray,
) -> None:
    """Forces (m, 3) at points (m, 3) of the bodies (m,), world axes, as generalised forces (n,) of the chain."""
    out[:] = 0.0
    for n in range(body.size):
        f = force[n]
        out[:3] += f
        out[3:6] += np.cross(point[n] - base_centre, f)
        for b in range(1, body[n] + 1):
            d = first_dof[b - 1]
            if joint_kind[b - 1] == SPHERICAL:
                moment = np.cross(point[n] - joint[b], f)
                for k in range(3):
                    for i in range(3):
                        out[d + k] += rotation[b, i, k] * moment[i]
            else:
                for i in range(3):
                    out[d] += rotation[b, i, 2] * f[i]


@njit(cache=True)
def body_velocities(
    joint_kind: IntArray,
    first_dof: IntArray,
    rotation: FloatArray,
    centre: FloatArray,
    joint: FloatArray,
    generalised: FloatArray,
    velocity: FloatArray,
    spin: FloatArray,
) -> None:
    """Velocities of the centres of mass (b, 3) and angular velocities (b, 3), world axes, from the generalised ones."""
    velocity[0] = generalised[:3]
    spin[0] = generalised[3:6]
    for b in range(1, joint_kind.size + 1):
        d = first_dof[b - 1]
        at_joint = velocity[b - 1] + np.cross(spin[b - 1], joint[b] - centre[b - 1])
        if joint_kind[b - 1] == SPHERICAL:
            spin[b] = spin[b - 1] + rotation[b] @ generalised[d : d + 3]
        else:
            spin[b] = spin[b - 1]
            at_joint = at_joint + generalised[d] * rotation[b, :, 2]
        velocity[b] = at_joint + np.cross(spin[b], centre[b] - joint[b])


@njit(cache=True)
def angular_momentum(
    mass: FloatArray,
    inertia: FloatArray,
    rotation: FloatArray,
    centre: FloatArray,
    velocity: FloatArray,
    spin: FloatArray,
    out: FloatArray,
) -> None:
    """Angular momentum about the centre of mass, shape (3,) [kg m²/s]."""
    total = mass.sum()
    mean_centre, mean_velocity = np.zeros(3), np.zeros(3)
    for b in range(mass.size):
        mean_centre += mass[b] / total * centre[b]
        mean_velocity += mass[b] / total * velocity[b]
    out[:] = 0.0
    for b in range(mass.size):
        out += rotation[b] @ (inertia[b] * (rotation[b].T @ spin[b]))
        out += mass[b] * np.cross(centre[b] - mean_centre, velocity[b] - mean_velocity)


@njit(cache=True)
def mean_rotation_vector(joint_kind: IntArray, joint_quaternion: FloatArray, out: FloatArray) -> None:
    """Mean rotation vector (3,) [rad] of the spherical joints."""
    phi = np.empty(3)
    count = 0
    out[:] = 0.0
    for j in range(joint_kind.size):
        if joint_kind[j] == SPHERICAL:
            rotation_vector(joint_quaternion[j], phi)
            out += phi
            count += 1
    out /= count
