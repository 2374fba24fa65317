"""Rod twin: the robot as a Kirchhoff rod of a few Legendre modes on a floor, made for speed.

Thirteen unknowns for three modes, one small Cholesky a step, all compiled (`sim.rod_kernel`, where the model and its
equations are). The stretch, where the robot has any, is one uniform coordinate with its own inertia, coupled to the
mean bend through the section's stiffness.

Left out: shear, stretch that varies along the tube, contact with anything but the floor, rolling resistance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.body import Body, Motion, World
from sim.rod_kernel import steps
from sim.rod_memory import INERTIA_ROWS, Physics, carve, rod_memory
from sim.rod_rule import rod_outline, rod_rule
from softbot.errors import InputError, SimulationError

FloatArray = NDArray[np.float64]

_CONTACT_SINK = 0.01  # static penetration over radius
_CONTACT_DAMPING_RATIO = 1.0
_LEAST_GRAVITY_M_S2 = 1.0  # for the floor's stiffness, where there is less or none
_REGULAR_SPEED = 0.002  # of Coulomb friction over the rolling speed
_LEAST_SPEED = 1e-5  # its floor over √(gR)
_OUTLINE_PLACES = 17  # on each half of the tube, the middle counted twice


class RodTwin:
    """Reduced-order rod of a robot. Implements `sim.body.Twin`.

    The robot starts straight, at rest, lying on the floor with chamber 0 (e1) to its left, tangent along x.

    modes: Legendre polynomials for each of the two bends and the twist, at least 1. contact_points: even, at least 4
    and more than `modes`; the inertia is summed over the same points. step_s: step [s]. stretches: False keeps the
    length (the rest stretch is then ignored; the bending stiffness is the one with the stretch relaxed either way).
    Raises InputError for values out of range.
    """

    def __init__(
        self, body: Body, world: World, *, modes: int, contact_points: int, step_s: float, stretches: bool
    ) -> None:
        if modes < 1:
            raise InputError(f"modes = {modes}: a rod bends in at least one")
        if contact_points < max(4, modes + 1) or contact_points % 2:
            raise InputError(
                f"contact_points = {contact_points}: an even number, at least 4 and more than modes ({modes})"
            )
        if not (np.isfinite(step_s) and step_s > 0.0):
            raise InputError(f"step_s = {step_s:g}: must be positive")
        self._body, self._modes, self._points = body, modes, contact_points
        gravity = max(world.gravity_m_s2, _LEAST_GRAVITY_M_S2)
        stiffness_1_s2 = gravity / (_CONTACT_SINK * body.radius_m)
        viscous = world.friction_law == "viscous"
        self._physics = Physics(
            step_s=float(step_s),
            radius_m=float(body.radius_m),
            mass_kg=float(body.mass_kg),
            gravity_m_s2=float(world.gravity_m_s2),
            damping_time_s=float(body.damping_time_s),
            touches=world.ground != "none",
            stretches=bool(stretches),
            viscous=viscous,
            friction=float(world.friction * (body.length_m / body.mass_kg if viscous else 1.0)),
            contact_stiffness_1_s2=float(stiffness_1_s2),
            contact_damping_1_s=float(2.0 * _CONTACT_DAMPING_RATIO * np.sqrt(stiffness_1_s2)),
            regular_speed=_REGULAR_SPEED,
            least_speed_m_s=float(_LEAST_SPEED * np.sqrt(gravity * body.radius_m)),
        )
        strains = 3 * modes + int(stretches)
        memory = rod_memory(modes, contact_points, strains)
        self._state, self._rule, self._work, _ = carve(memory, modes, contact_points, strains)
        self._rod = (memory, modes, contact_points, strains, self._physics)
        for table, values in zip(self._rule, rod_rule(body.length_m, body.mass_kg, modes, contact_points), strict=True):
            table[...] = values
        self._outline = rod_outline(body.length_m, contact_points, _OUTLINE_PLACES)
        if world.ground != "none":
            self._state.position_m[2] = body.radius_m
        self._state.rotation[...] = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
        if stretches:
            self._state.strain[-1] = 1.0
        self.set_rest(np.array([1.0, 0.0, 0.0]), body.rest_stiffness())

    @property
    def step_s(self) -> float:
        """Step of the integration [s]."""
        return self._physics.step_s

    def set_rest(self, strain: FloatArray, stiffness: FloatArray) -> None:
        """Rest strains (ℓ, k1, k2) and section stiffness (3, 3), held until the next call."""
        length, modes, state = self._body.length_m, self._modes, self._state
        # with the stretch relaxed: the bending stiffness where the stretch is no coordinate of its own
        axial = stiffness[0, 0]
        k11 = stiffness[1, 1] - stiffness[1, 0] * stiffness[0, 1] / axial
        k12 = stiffness[1, 2] - stiffness[1, 0] * stiffness[0, 2] / axial
        k22 = stiffness[2, 2] - stiffness[2, 0] * stiffness[0, 2] / axial
        twist = self._body.twisting_stiffness_N_m2
        matrix = state.stiffness
        for m in range(modes):
            # k towards the centre of curvature turns the tangent: w = t × k = (−k2, k1, ·)
            share = length / (2 * m + 1)  # ∫P_m² ds
            matrix[3 * m, 3 * m] = share * k22
            matrix[3 * m + 1, 3 * m + 1] = share * k11
            matrix[3 * m, 3 * m + 1] = matrix[3 * m + 1, 3 * m] = -share * k12
            matrix[3 * m + 2, 3 * m + 2] = share * twist
        state.rest_strain[0], state.rest_strain[1] = -strain[2], strain[1]
        if self._physics.stretches:
            matrix[0, 0], matrix[1, 1] = length * stiffness[2, 2], length * stiffness[1, 1]
            matrix[0, 1] = matrix[1, 0] = -length * stiffness[1, 2]
            matrix[-1, -1] = length * axial
            matrix[0, -1] = matrix[-1, 0] = -length * stiffness[2, 0]
            matrix[1, -1] = matrix[-1, 1] = length * stiffness[1, 0]
            state.rest_strain[-1] = strain[0]

    def step(self) -> None:
        """Advance by one step. Raises SimulationError when the state is no longer finite."""
        self.advance(1)

    def advance(self, count: int) -> None:
        """Advance by `count` steps under the same rest strains, without leaving compiled code.

        Raises SimulationError when the state is no longer finite.
        """
        if count > 0 and not steps(count, *self._rod):
            raise SimulationError(
                "the rod twin left its range (a strain or a speed is not finite, or the tube shrank to nothing): "
                "use a smaller step or a milder command"
            )

    def strain(self) -> FloatArray:
        """Mean strains (ℓ, k1, k2) now, shape (3,)."""
        strain = self._state.strain
        return np.array([self._stretch(), strain[1], -strain[0]])

    def motion(self) -> Motion:
        """The robot now."""
        state, work = self._state, self._work
        steps(0, *self._rod)
        arm, velocity = work.arm_m, state.velocity[:6] + work.vector[:6]
        rows = INERTIA_ROWS * self._points
        momentum = work.rows[:6, :rows] @ work.rate[:rows]
        first, last = self._ends_from_middle()
        chord = last - first
        return Motion(
            rotation=state.rotation.copy(),
            angular_velocity_rad_s=velocity[3:],
            mid_velocity_m_s=velocity[:3],
            centre_of_mass_m=state.position_m + arm,
            stretch=self._stretch(),
            curvature_1_m=np.array([state.strain[1], -state.strain[0]]),
            chord=chord / np.linalg.norm(chord),
            angular_momentum_kg_m2_s=momentum[3:] - np.cross(arm, momentum[:3]),
        )

    def shape(self) -> tuple[FloatArray, FloatArray]:
        """Centre line (n, 3) [m] and section axis e1 (n, 3) along the robot now, equally spaced, ends included."""
        state, half = self._state, self._points // 2
        steps(0, *self._rod)
        tangent, first_axis = self._stretch() * self._work.section[2], self._work.section[0]
        ahead, behind = tangent[:, :half] @ self._outline.integral, -tangent[:, half:] @ self._outline.integral
        points = state.position_m[:, None] + np.hstack([behind[:, :0:-1], ahead])
        axes = np.hstack(
            [
                (first_axis[:, half:] @ self._outline.value)[:, :0:-1],
                state.rotation[:, :1],
                (first_axis[:, :half] @ self._outline.value)[:, 1:],
            ]
        )
        return points.T.copy(), (axes / np.linalg.norm(axes, axis=0)).T.copy()

    def energy_J(self) -> float:
        """Kinetic, elastic (against the rest strains) and gravitational energy [J], the floor's springs left out."""
        motion = self.motion()
        state, rows = self._state, INERTIA_ROWS * self._points
        off_rest = state.strain - state.rest_strain
        kinetic = 0.5 * float(self._work.rate[:rows] @ self._work.rate[:rows])
        height_m = float(motion.centre_of_mass_m[2])
        weight_N = self._body.mass_kg * self._physics.gravity_m_s2
        return kinetic + 0.5 * float(off_rest @ state.stiffness @ off_rest) + weight_N * height_m

    def close(self) -> None:
        """Nothing to release."""

    def _stretch(self) -> float:
        return float(self._state.strain[-1]) if self._physics.stretches else 1.0

    def _ends_from_middle(self) -> tuple[FloatArray, FloatArray]:
        half, to_end = self._points // 2, self._outline.integral[:, -1]
        tangent = self._stretch() * self._work.section[2]
        return -tangent[:, half:] @ to_end, tangent[:, :half] @ to_end
