"""Rest strains and stiffness of the rod: what a law of the section says of a tube, in the coordinates of its modes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.rod_energy import elastic_energy_J
from sim.rod_memory import ASLEEP, RESTED, WORK
from softbot.kernel_compiler import kernel

FloatArray = NDArray[np.float64]


@kernel()
def set_rest(
    strain: FloatArray,
    rest_strain: FloatArray,
    matrix: FloatArray,
    flag: FloatArray,
    shares: FloatArray,
    stretches: bool,
    length_m: float,
    twisting_N_m2: float,
    rest: FloatArray,
    stiffness: FloatArray,
) -> bool:
    """Write rest strains (ℓ, k1, k2) and section stiffness (3, 3) [N, N m, N m²] of a tube into `rod_memory.State`.

    strain, rest_strain: shape (s,); matrix: its stiffness, shape (s, s); shares: of the bending energy in the
    modes. The actuators' work goes into the ledger, and a sleeping robot wakes. False, and neither, where nothing
    changed.
    """
    before_J, changed = elastic_energy_J(strain, rest_strain, matrix), False
    # with the stretch relaxed: the bending stiffness where the stretch is no coordinate of its own
    axial = stiffness[0, 0]
    k11 = stiffness[1, 1] - stiffness[1, 0] * stiffness[0, 1] / axial
    k12 = stiffness[1, 2] - stiffness[1, 0] * stiffness[0, 2] / axial
    k22 = stiffness[2, 2] - stiffness[2, 0] * stiffness[0, 2] / axial
    for m in range(shares.shape[0]):
        # k towards the centre of curvature turns the tangent: w = t × k = (−k2, k1, ·)
        share = length_m * shares[m]
        first = m == 0 and stretches
        a, b = (length_m * stiffness[2, 2], length_m * stiffness[1, 1]) if first else (share * k22, share * k11)
        c = -length_m * stiffness[1, 2] if first else -share * k12
        i = 3 * m
        changed = changed or matrix[i, i] != a or matrix[i + 1, i + 1] != b or matrix[i, i + 1] != c
        matrix[i, i], matrix[i + 1, i + 1] = a, b
        matrix[i, i + 1] = matrix[i + 1, i] = c
        matrix[i + 2, i + 2] = share * twisting_N_m2
    changed = changed or rest_strain[0] != -rest[2] or rest_strain[1] != rest[1]
    rest_strain[0], rest_strain[1] = -rest[2], rest[1]
    if stretches:
        a, b, c = length_m * axial, -length_m * stiffness[2, 0], length_m * stiffness[1, 0]
        changed = changed or matrix[-1, -1] != a or matrix[0, -1] != b or matrix[1, -1] != c
        changed = changed or rest_strain[-1] != rest[0]
        matrix[-1, -1] = a
        matrix[0, -1] = matrix[-1, 0] = b
        matrix[1, -1] = matrix[-1, 1] = c
        rest_strain[-1] = rest[0]
    if changed:
        flag[WORK] += elastic_energy_J(strain, rest_strain, matrix) - before_J
        flag[ASLEEP] = flag[RESTED] = 0.0
    return changed
