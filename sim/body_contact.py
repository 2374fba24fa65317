"""Contact of a round tube with boxes, spheres and cylinders: soft, with friction that holds, equal and opposite.

The tube is felt by feelers, spheres of its radius spaced evenly from end to end; each stands for an equal share of the
tube's mass, and its place, velocity and spin are interpolated between the points that carry the tube. A feeler of mass
m that is pressed by δ into a body, closing at speed u, feels along the normal

    f = m (κ (δ + h u) + γ u) / (1 + (h²κ + hγ) w),    f ≥ 0 and only where δ + h u > 0,

the spring and damper of a soft wall taken linearly implicitly: h is the step and w bounds what the force changes of u,
times m (one for the tube, whose mass matrix is at least that of its feelers; for the body, the sum over the feelers
that touch it of m times their mobility on it). With a bound the explicit exchange of forces between two engines is
stable whatever κ, h and the ratio of the masses. Friction is a spring across the normal that lets go at µ f and keeps
what it can carry (Cundall and Strack, Géotechnique 29, 1979), taken implicitly in the same way.

What a feeler feels, the body feels with the opposite sign at the same place, and the feeler's force and its moment
about the centre line go to the points with the weights of the interpolation, so that linear and angular momentum are
exchanged without loss. Left out: the tube's flat ends (they are round here), and its squashing as a shape.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim import bodies
from softbot.errors import InputError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

STENCIL = 4
_SPACING = 0.5  # of the feelers over the radius
_LEAST_FEELERS, _MOST_FEELERS = 16, 400
_SLIDING_MOBILITY = 3.0  # of a disc: 1 for its mass, R²/(R²/2) for its rolling

_signed_distance = njit(cache=True)(bodies.signed_distance)


class Feelers(NamedTuple):
    """Where the feelers are between the points that carry the tube: f feelers, n points."""

    first: IntArray
    """First of the STENCIL points, as a place in `order`, shape (f,)."""
    weight: FloatArray
    """Of these points, rows summing to one, shape (f, STENCIL)."""
    order: IntArray
    """The points in the order of their place along the tube, shape (n,)."""


class Obstacles(NamedTuple):
    """The bodies, b of them, and the friction springs of f feelers; mutable where a step changes it."""

    code: IntArray
    """BOX, SPHERE or CYLINDER, shape (b,)."""
    half_size_m: FloatArray
    """Shape (b, 3)."""
    friction: FloatArray
    """Shape (b,)."""
    mobility_1_kg: FloatArray
    """One over the mass, 0 for a fixed body, shape (b,)."""
    turning_1_kg_m2: FloatArray
    """One over the principal moments, shape (b, 3)."""
    position_m: FloatArray
    """Shape (b, 3)."""
    rotation: FloatArray
    """Columns: body axes, shape (b, 3, 3)."""
    velocity_m_s: FloatArray
    """Shape (b, 3)."""
    spin_rad_s: FloatArray
    """Shape (b, 3)."""
    spring_m: FloatArray
    """Friction springs, shape (b, f, 3)."""
    force_N: FloatArray
    """On the bodies, out, shape (b, 3)."""
    moment_N_m: FloatArray
    """On the bodies about their centres, out, shape (b, 3)."""


def lay_feelers(place_m: FloatArray, length_m: float, radius_m: float) -> Feelers:
    """Feelers over a tube carried by points at `place_m` (n,), measured along it from its middle.

    Interpolation is cubic, through the four points nearest. Raises InputError for fewer than four points.
    """
    if len(place_m) < STENCIL:
        raise InputError(f"a tube among other bodies is carried by at least {STENCIL} points, not {len(place_m)}")
    count = int(np.clip(np.ceil(length_m / (_SPACING * radius_m)), _LEAST_FEELERS, _MOST_FEELERS))
    feeler = np.linspace(-0.5, 0.5, count) * length_m
    order = np.argsort(place_m)
    points = place_m[order]
    first = np.clip(np.searchsorted(points, feeler) - STENCIL // 2, 0, len(points) - STENCIL)
    near = points[first[:, None] + np.arange(STENCIL)]
    weight = np.ones((count, STENCIL))
    for j in range(STENCIL):  # Lagrange
        for k in range(STENCIL):
            if k != j:
                weight[:, j] *= (feeler - near[:, k]) / (near[:, j] - near[:, k])
    return Feelers(first.astype(np.int64), weight, order.astype(np.int64))


@njit(cache=True)
def nearest_m(radius_m: float, obstacles: Obstacles, centre_m: FloatArray) -> float:
    """Distance of the nearest body from the spheres of the tube's radius about the points (n, 3) that carry it [m]."""
    least = np.inf
    for b in range(obstacles.code.size):
        size, turn = obstacles.half_size_m[b], obstacles.rotation[b]
        for i in range(centre_m.shape[0]):
            x, y, z = 0.0, 0.0, 0.0
            for k in range(3):
                away = centre_m[i, k] - obstacles.position_m[b, k]
                x += turn[k, 0] * away
                y += turn[k, 1] * away
                z += turn[k, 2] * away
            d, _, _, _ = _signed_distance(obstacles.code[b], size[0], size[1], size[2], x, y, z)
            least = min(least, d - radius_m)
    return least


@njit(cache=True)
def _cross(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """out ← a × b."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def press(
    step_s: float,
    radius_m: float,
    feeler_kg: float,
    stiffness_1_s2: float,
    damping_1_s: float,
    feelers: Feelers,
    obstacles: Obstacles,
    centre_m: FloatArray,
    velocity_m_s: FloatArray,
    spin_rad_s: FloatArray,
    push_N: FloatArray,
    push_N_m: FloatArray,
) -> int:
    """Forces of the tube on the bodies (into `obstacles`) and of the bodies on the tube's points (n, 3), for a step.

    centre_m, velocity_m_s, spin_rad_s: of the points, shape (n, 3). Forces are set, not added to. Returns 0: nothing
    touches; 1: fixed bodies alone are touched; 2: bodies that can move are.
    """
    count, bodies_count = feelers.first.size, obstacles.code.size
    push_N[:, :] = 0.0
    push_N_m[:, :] = 0.0
    obstacles.force_N[:, :] = 0.0
    obstacles.moment_N_m[:, :] = 0.0
    depth = np.zeros((bodies_count, count))  # at the end of the step, as foreseen now; 0: not touched
    normal = np.zeros((bodies_count, count, 3))
    arm = np.zeros((bodies_count, count, 3))  # of the touched place about the body's centre
    slip = np.zeros((bodies_count, count, 3))  # speed of the tube's surface there against the body's
    bound, sliding_bound = np.zeros(bodies_count), np.zeros(bodies_count)
    place, shift, turned, away = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    local, surface, lever, force = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    touched = 0
    found = 0
    for i in range(count):
        place[:] = 0.0
        shift[:] = 0.0
        turned[:] = 0.0
        for j in range(STENCIL):
            p, share = feelers.order[feelers.first[i] + j], feelers.weight[i, j]
            for k in range(3):
                place[k] += share * centre_m[p, k]
                shift[k] += share * velocity_m_s[p, k]
                turned[k] += share * spin_rad_s[p, k]
        for b in range(bodies_count):
            size, turn, spin = obstacles.half_size_m[b], obstacles.rotation[b], obstacles.spin_rad_s[b]
            far2, fast2 = 0.0, 0.0
            for k in range(3):
                away[k] = place[k] - obstacles.position_m[b, k]
                far2 += away[k] ** 2
                fast2 += (shift[k] - obstacles.velocity_m_s[b, k]) ** 2
            across = size[0] + size[1] + size[2]
            turning_m_s = across * np.sqrt(spin[0] ** 2 + spin[1] ** 2 + spin[2] ** 2)
            if np.sqrt(far2) > across + radius_m + step_s * (np.sqrt(fast2) + turning_m_s):
                obstacles.spring_m[b, i] = 0.0
                continue
            for k in range(3):
                local[k] = turn[0, k] * away[0] + turn[1, k] * away[1] + turn[2, k] * away[2]
            d, nx, ny, nz = _signed_distance(obstacles.code[b], size[0], size[1], size[2], local[0], local[1], local[2])
            n, a, u = normal[b, i], arm[b, i], slip[b, i]
            for k in range(3):
                n[k] = turn[k, 0] * nx + turn[k, 1] * ny + turn[k, 2] * nz
                surface[k] = -radius_m * n[k]  # from the centre line to the touched place
                a[k] = away[k] + surface[k]
            _cross(turned, surface, u)
            _cross(spin, a, lever)
            closing = 0.0
            for k in range(3):
                u[k] += shift[k] - lever[k] - obstacles.velocity_m_s[b, k]
                closing -= u[k] * n[k]
            depth[b, i] = radius_m - d + step_s * closing
            if depth[b, i] <= 0.0:
                obstacles.spring_m[b, i] = 0.0
                depth[b, i] = 0.0
                continue
            if bound[b] == 0.0:
                touched += 1
                found = max(found, 2 if obstacles.mobility_1_kg[b] > 0.0 else 1)
            _cross(a, n, lever)
            turning, easiest, arm2 = 0.0, 0.0, 0.0
            for k in range(3):
                along = turn[0, k] * lever[0] + turn[1, k] * lever[1] + turn[2, k] * lever[2]
                turning += obstacles.turning_1_kg_m2[b, k] * along * along
                easiest = max(easiest, obstacles.turning_1_kg_m2[b, k])
                arm2 += a[k] ** 2
            # the smallest number tells a touched fixed body from one that is not touched
            bound[b] += feeler_kg * (obstacles.mobility_1_kg[b] + turning) + 1e-300
            sliding_bound[b] += feeler_kg * (obstacles.mobility_1_kg[b] + arm2 * easiest)
    if touched == 0:
        return 0
    implicit = step_s * step_s * stiffness_1_s2 + step_s * damping_1_s
    for b in range(bodies_count):
        if bound[b] == 0.0:
            continue
        pressing_kg = feeler_kg / (1.0 + implicit * (touched + bound[b]))
        sliding_kg = feeler_kg / (1.0 + implicit * (_SLIDING_MOBILITY * touched + sliding_bound[b]))
        for i in range(count):
            if depth[b, i] == 0.0:
                continue
            n, u, spring = normal[b, i], slip[b, i], obstacles.spring_m[b, i]
            closing, off = 0.0, 0.0
            for k in range(3):
                closing -= u[k] * n[k]
                off += spring[k] * n[k]
            pressed = pressing_kg * (stiffness_1_s2 * depth[b, i] + damping_1_s * closing)
            if pressed <= 0.0:
                spring[:] = 0.0
                continue
            held2 = 0.0
            for k in range(3):
                u[k] += closing * n[k]
                spring[k] += step_s * u[k] - off * n[k]  # the body may have turned since
                force[k] = -sliding_kg * (stiffness_1_s2 * spring[k] + damping_1_s * u[k])
                held2 += force[k] ** 2
            limit = obstacles.friction[b] * pressed
            if held2 > limit * limit:
                for k in range(3):
                    force[k] *= limit / np.sqrt(held2)
                    # stretched by what it carries: it holds when the sliding stops, and gives way when it turns round
                    spring[k] = -force[k] / (sliding_kg * stiffness_1_s2)
            for k in range(3):
                force[k] += pressed * n[k]
                surface[k] = -radius_m * n[k]
                obstacles.force_N[b, k] -= force[k]
            _cross(arm[b, i], force, lever)
            _cross(surface, force, turned)
            for k in range(3):
                obstacles.moment_N_m[b, k] -= lever[k]
                for j in range(STENCIL):
                    p, share = feelers.order[feelers.first[i] + j], feelers.weight[i, j]
                    push_N[p, k] += share * force[k]
                    push_N_m[p, k] += share * turned[k]
    return found
