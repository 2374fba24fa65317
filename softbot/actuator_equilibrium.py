"""Wall forces of a section, and the strains at which they balance the chambers: the kernels of `softbot.actuator`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from softbot.kernel_compiler import kernel, part
from softbot.material import PARAMETERS, is_within, nominal_stress, tangent_modulus

FloatArray = NDArray[np.float64]

_MIN_STRETCH = 0.05  # below this the wall is crushed and no law means anything
_NEWTON_STEPS = 60
_PRE_STRETCH = PARAMETERS  # its place in the kernels' numbers of a wall, after those of the material


@kernel()
def wall_forces(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    strain: FloatArray,
    force: FloatArray,
    stiffness: FloatArray,
) -> bool:
    """Wall force and tangent stiffness at a strain; False when some fibre is crushed or beyond its law."""
    for k in range(3):
        force[k] = 0.0
        for m in range(3):
            stiffness[k, m] = 0.0
    pre_stretch = wall[_PRE_STRETCH]
    held_Pa = nominal_stress(code, wall, pre_stretch)
    for n in range(points.shape[0]):
        x1, x2, area = points[n, 0], points[n, 1], points[n, 2]
        stretch = strain[0] - strain[1] * x1 - strain[2] * x2
        if not (stretch > _MIN_STRETCH and is_within(code, wall, pre_stretch * stretch)):
            return False
        stress = pre_stretch * (nominal_stress(code, wall, pre_stretch * stretch) - held_Pa) * area
        tangent = pre_stretch * pre_stretch * tangent_modulus(code, wall, pre_stretch * stretch) * area
        force[0] += stress
        force[1] -= stress * x1
        force[2] -= stress * x2
        stiffness[0, 0] += tangent
        stiffness[0, 1] -= tangent * x1
        stiffness[0, 2] -= tangent * x2
        stiffness[1, 1] += tangent * x1 * x1
        stiffness[1, 2] += tangent * x1 * x2
        stiffness[2, 2] += tangent * x2 * x2
    stiffness[1, 0] = stiffness[0, 1]
    stiffness[2, 0] = stiffness[0, 2]
    stiffness[2, 1] = stiffness[1, 2]
    return True


@part()
def _solve_symmetric(matrix: FloatArray, first: float, second: float, third: float, solution: FloatArray) -> bool:
    """x of a symmetric 3 × 3 system by its adjugate; False where it has none."""
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
    dd, ee, ff = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * aa + b * bb + c * cc
    if not abs(determinant) > 0.0:
        return False
    solution[0] = (aa * first + bb * second + cc * third) / determinant
    solution[1] = (bb * first + dd * second + ee * third) / determinant
    solution[2] = (cc * first + ee * second + ff * third) / determinant
    return True


@kernel()
def solve_strain(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    load: FloatArray,
    strain: FloatArray,
    stiffness: FloatArray,
) -> bool:
    """Newton with step halving on F(e) = load, from `strain`, in place; leaves K at the solution."""
    force, trial, step = np.empty(3), np.empty(3), np.empty(3)
    radius = 0.0
    for n in range(points.shape[0]):
        radius = max(radius, abs(points[n, 0]), abs(points[n, 1]))
    if not wall_forces(points, code, wall, strain, force, stiffness):
        strain[0], strain[1], strain[2] = 1.0, 0.0, 0.0
        wall_forces(points, code, wall, strain, force, stiffness)
    for _ in range(_NEWTON_STEPS):
        if not _solve_symmetric(stiffness, load[0] - force[0], load[1] - force[1], load[2] - force[2], step):
            return False
        size = abs(step[0]) + radius * (abs(step[1]) + abs(step[2]))
        fraction = min(1.0, 0.5 / size) if size > 0.0 else 1.0  # at most a strain of 50 % at once
        while True:
            for k in range(3):
                trial[k] = strain[k] + fraction * step[k]
            if wall_forces(points, code, wall, trial, force, stiffness):
                break
            fraction *= 0.5
            if fraction < 1e-6:
                return False
        for k in range(3):
            strain[k] = trial[k]
        if size < 1e-10:  # what is left is of its square
            return True
    return size < 1e-9


@kernel()
def equilibrium_under(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    load: FloatArray,
    dead_band_Pa: float,
    pressure_Pa: FloatArray,
    strain: FloatArray,
    stiffness: FloatArray,
    jacobian: FloatArray,
) -> bool:
    """Strains (3,) at rest under the pressures (4,), from `strain`; their stiffness and ∂strain/∂pressure (3, 4)."""
    force, column = np.zeros(3), np.empty(3)
    for i in range(load.shape[1]):
        effective = max(pressure_Pa[i] - dead_band_Pa, 0.0) + min(pressure_Pa[i], 0.0)
        for k in range(3):
            force[k] += load[k, i] * effective
    if not solve_strain(points, code, wall, force, strain, stiffness):
        return False
    for i in range(load.shape[1]):
        # at the edge of the dead band the slope is that of rising pressure
        active = 1.0 if pressure_Pa[i] >= dead_band_Pa or pressure_Pa[i] < 0.0 else 0.0
        _solve_symmetric(stiffness, active * load[0, i], active * load[1, i], active * load[2, i], column)
        for k in range(3):
            jacobian[k, i] = column[k]
    return True


@kernel()
def equilibria_under(
    points: FloatArray,
    code: int,
    wall: FloatArray,
    loads: FloatArray,
    along: bool,
    strains: FloatArray,
    stiffnesses: FloatArray,
) -> int:
    """`solve_strain` for each row of `loads`, shape (n, 3); the first row without an equilibrium, or -1.

    `along`: from the row before it, moved on by its tangent, instead of what stands in the row of `strains`.
    """
    step = np.empty(3)
    for n in range(loads.shape[0]):
        if along and n > 0:
            more = loads[n] - loads[n - 1]
            strains[n] = strains[n - 1]
            if _solve_symmetric(stiffnesses[n - 1], more[0], more[1], more[2], step):
                strains[n] += step
        if not solve_strain(points, code, wall, loads[n], strains[n], stiffnesses[n]):
            return n
    return -1
