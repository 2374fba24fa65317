"""Rod twin: the robot as a Kirchhoff rod of a few bending modes on the ground, made for speed.

Six unknowns of the base and three of each mode (fewer where a scene allows), one small Cholesky a step, all compiled
(`sim.rod_kernel`, where the model and its equations are). The stretch, where the robot has any, is one uniform
coordinate with its own inertia, coupled to the mean bend through the section's stiffness.

Left out: shear, stretch that varies along the tube, contact of the tube with itself.
"""

from __future__ import annotations

import copy
import math

import numpy as np
from numpy.typing import NDArray

from sim.between_steps import fill_between, straight
from sim.body import Body, BrokenOff, Motion, World
from sim.motion_rows import (
    ANGULAR_MOMENTUM,
    ANGULAR_VELOCITY,
    CENTRE_OF_MASS,
    CHORD,
    CURVATURE,
    ENERGY,
    PENETRATION,
    ROTATION,
    ROW_SIZE,
    STRETCH,
    VELOCITY,
)
from sim.rod_drive import hold
from sim.rod_ground import NO_GROUND, PIPE, PLANE, SPOTS, STEP
from sim.rod_kernel import play
from sim.rod_memory import (
    ADVICE,
    ASLEEP,
    AUDITED,
    CREATED,
    KINKED,
    RESTED,
    TIME,
    WORK,
    Layout,
    Physics,
    carve,
    instant_size,
    instants,
    places,
    rod_memory,
)
from sim.rod_rest import set_rest
from sim.rod_rule import is_even, mode_shares, rod_outline, rod_rule
from softbot.errors import InputError

FloatArray = NDArray[np.float64]

# static penetration under an even load over the radius; where few points may carry the robot, stiffer
_CONTACT_SINK = {NO_GROUND: 0.01, PLANE: 0.01, STEP: 0.001, PIPE: 0.001}
_STUBBY, _STUBBY_SINK = 6.0, 0.005  # a tube shorter than so many radii stands unevenly on its friction
_CONTACT_DAMPING_RATIO = 1.0
_LIMP, _LIMP_SINK = (
    40.0,
    0.002,
)  # a tube of more than that λgL³/EI may rest as an arch on its tips, a lighter one topples
_LEAST_GRAVITY_M_S2 = 1.0  # for the ground's stiffness, where there is less or none
_SLEEP_SPEED = 1e-5  # of √(gR): slower is at rest
_OUTLINE_PLACES = 17  # on each half of the tube, the middle counted twice
_GROUNDS = {"none": NO_GROUND, "plane": PLANE, "step": STEP, "pipe": PIPE}
_HOLD = hold()
_NO_ROWS = np.empty((0, ROW_SIZE))
_NOTHING_SEEN = np.empty((0, 0))


class RodTwin:
    """Reduced-order rod of a robot. Implements `sim.body.Twin`.

    The robot starts straight, at rest, lying on the ground with chamber 0 (e1) to its left, tangent along x.

    modes: shape functions (`sim.rod_rule`) for each of the two bends and the twist, at least 1. contact_points: even,
    at least two for each mode and two more; the inertia is summed over the same points. step_s: longest step [s].
    stretches: False keeps the length (the rest stretch is then ignored; the bending stiffness is the one with the
    stretch relaxed either way).
    symmetric: the tube is its own mirror image about x = 0, as it is whenever all that acts on it is: half of it is
    computed. twists: False keeps the twist at zero. clamped: the middle is held where it starts (a symmetric clamped
    tube is two cantilevers). tolerance: error of a step over the radius above which it is divided; 0: never.
    Raises InputError for values out of range.
    """

    def __init__(
        self,
        body: Body,
        world: World,
        *,
        modes: int,
        contact_points: int,
        step_s: float,
        stretches: bool,
        symmetric: bool = False,
        twists: bool = True,
        clamped: bool = False,
        tolerance: float = 0.0,
    ) -> None:
        if modes < 1:
            raise InputError(f"modes = {modes}: a rod bends in at least one")
        if contact_points < max(4, 2 * modes + 2) or contact_points % 2:
            raise InputError(
                f"contact_points = {contact_points}: an even number, and at least {max(4, 2 * modes + 2)} for "
                f"modes = {modes}: with fewer, the sums along the tube do not see how it bends"
            )
        if not (np.isfinite(step_s) and step_s > 0.0):
            raise InputError(f"step_s = {step_s:g}: must be positive")
        weight_N = body.mass_kg * world.gravity_m_s2
        if stretches and world.ground != "none" and weight_N > body.axial_stiffness_N:
            raise InputError(
                f"robot.axial_stiffness_N = {body.axial_stiffness_N:g}: less than the weight of {weight_N:g} N of "
                f"robot.mass_kg = {body.mass_kg:g}, which would squeeze a standing tube to nothing; a tube has 2 to 4 "
                "times its bending stiffness over radius_m²"
            )
        self._body, self._modes, self._half = body, modes, contact_points // 2
        columns = _columns(modes, stretches, symmetric, twists, clamped)
        ground = _GROUNDS[world.ground]
        layout = Layout(
            modes=modes,
            points=self._half if symmetric else contact_points,
            half=self._half,
            strains=3 * modes + int(stretches),
            base=sum(1 for column in columns if column < 6),
            columns=len(columns),
            spots=SPOTS[ground],
            resists=int(ground != NO_GROUND and world.rolling_resistance_N_m > 0.0),
        )
        self._layout = layout
        self._physics = _physics(body, world, ground, layout, step_s, tolerance, symmetric, stretches)
        self._sound_friction = self._physics.friction
        self._memory, self._places = rod_memory(layout), places(layout)
        _, self._state, self._rule, self._contacts, self._work = carve(self._memory, self._places)
        sides = layout.points // layout.half
        rule = rod_rule(body.length_m, body.mass_kg, modes, layout.half, sides, symmetric and clamped)
        for table, values in zip(self._rule, rule, strict=True):
            table[...] = values
        self._work.column[...] = columns
        self._shares = mode_shares(modes, symmetric and clamped)
        self._outline = rod_outline(body.length_m, self._half, _OUTLINE_PLACES)
        if world.ground != "none":
            self._state.position_m[2] = body.radius_m
        self._state.rotation[...] = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
        self._state.flag[ADVICE], self._state.flag[KINKED] = step_s, -1.0
        if stretches:
            self._state.strain[-1] = self._state.rest_strain[-1] = 1.0
        self._row = np.zeros((1, ROW_SIZE))
        self._ghost: RodTwin | None = None
        self.set_rest(np.array([1.0, 0.0, 0.0]), body.rest_stiffness())
        self._find_natural_rates()

    @property
    def step_s(self) -> float:
        """Longest step of the integration [s]."""
        return self._physics.step_s

    @property
    def t_s(self) -> float:
        """Time since the start [s]."""
        return float(self._state.flag[TIME])

    @property
    def work_J(self) -> float:
        """What the actuators have put in since the start [J], by changing the rest strains."""
        return float(self._state.flag[WORK])

    @property
    def created_J(self) -> float:
        """What the errors of the steps have put into the motion and what was taken out again since the start [J]."""
        return float(self._state.flag[CREATED])

    @property
    def kinked_at_s(self) -> float | None:
        """When the tube first bent beyond the stable branch of a section that ovalises [s]."""
        return float(self._state.flag[KINKED]) if self._state.flag[KINKED] >= 0.0 else None

    @property
    def asleep(self) -> bool:
        """Whether the robot rests and is left alone until something changes."""
        return bool(self._state.flag[ASLEEP] > 0.0)

    @property
    def penetration_m(self) -> float:
        """Deepest of the contact points in the ground now [m]."""
        return float(self._look()[PENETRATION])

    @property
    def push_N(self) -> FloatArray:
        """Outside forces on the points, world axes, shape (points, 3) [N]: a view to write into, held until changed.

        Of a symmetric tube the points are those of one half, and a force on one acts on its mirror image as well, so
        that half of it goes to each. Call `wake` after a change to a robot that may be asleep.
        """
        return self._state.push_N

    @property
    def push_N_m(self) -> FloatArray:
        """Outside moments on the sections at the points, world axes, shape (points, 3) [N m]: a view like `push_N`."""
        return self._state.push_N_m

    def throw(self, lift_m: float, velocity: FloatArray) -> None:
        """Start from elsewhere: lifted off the ground [m], and moving.

        velocity: of the middle [m/s] and of the whole about it [rad/s], world axes, shape (6,); what a tube that
        mirrors itself or is clamped cannot do is left out.
        """
        self._state.position_m[2] += lift_m
        base = self._work.column[: self._layout.base].astype(int)
        self._state.velocity[base] = velocity[base]
        self._state.flag[AUDITED] = 0.0  # other energy than it had
        self.wake()

    def wake(self) -> None:
        """Rouse a sleeping robot: something outside it has changed."""
        self._state.flag[ASLEEP] = self._state.flag[RESTED] = 0.0

    @property
    def alone(self) -> bool:
        """True: a rod by itself knows of no other bodies (`sim.rod_among_bodies`)."""
        return True

    def contact_centres_m(self) -> FloatArray:
        """Centres of the cross-sections that touch now, shape (points, 3) [m]."""
        return self.points()[0]

    def change_floor(self, friction_factor: float, payload_share: float) -> None:
        """From now on: friction over that of the world; a weight on the robot over its own, without inertia."""
        own = self._physics
        self._physics = own._replace(friction=self._sound_friction * friction_factor)
        weight_N = payload_share * np.array([own.gravity_x_m_s2, own.gravity_y_m_s2, own.gravity_z_m_s2])
        self.push_N[:] = self.point_mass_kg[:, None] * weight_N
        self.wake()

    def lay_kerb(self, height_m: float, riser_m: float) -> None:
        """From now on the floor rises by `height_m` at y = `riser_m`, outwards; the world has a step somewhere."""
        self._physics = self._physics._replace(ground_a_m=height_m, ground_b_m=riser_m)
        self.wake()

    def halt(self) -> None:
        """Take away all speed, and with it the momentum: the robot stands still where it is."""
        state = self._state
        state.velocity[:] = state.momentum[:] = 0.0
        state.gain[:] = 0.0
        self.wake()

    def set_rest(self, strain: FloatArray, stiffness: FloatArray) -> None:
        """Rest strains (ℓ, k1, k2) and section stiffness (3, 3), held until the next call."""
        state = self._state
        set_rest(
            state.strain,
            state.rest_strain,
            state.stiffness,
            state.flag,
            self._shares,
            self._physics.stretches,
            self._body.length_m,
            self._body.twisting_stiffness_N_m2,
            np.asarray(strain, dtype=float),
            np.asarray(stiffness, dtype=float),
        )

    def step(self) -> None:
        """Advance by one step. Raises SimulationError when the state is no longer finite."""
        self.advance(1)

    def advance(self, count: int) -> None:
        """Advance by `count` steps under the same rest strains, without leaving compiled code.

        Raises SimulationError when the state is no longer finite.
        """
        if count > 0:
            self._play(_HOLD, 1, count, _NO_ROWS)

    def play(self, drive: FloatArray, samples: int, steps: int) -> FloatArray:
        """Advance by `samples` times `steps` steps, driven by `drive` (`sim.rod_drive.drive_array`).

        Returns a row of `sim.motion_rows` after each sample, shape (samples, ROW_SIZE). Raises BrokenOff, with the rows
        that were played, when the state is no longer finite.
        """
        rows = np.empty((samples, ROW_SIZE))
        self._play(drive, samples, steps, rows)
        return rows

    def _play(
        self, drive: FloatArray, samples: int, steps: int, rows: FloatArray, seen: FloatArray = _NOTHING_SEEN
    ) -> None:
        done = play(self._memory, self._places, self._physics, drive, samples, steps, rows, seen)
        if done < samples:
            raise BrokenOff(
                f"the rod twin left its range at t = {self.t_s:.4g} s (a strain or a speed is not finite, or the tube "
                "shrank to nothing): use a milder command or a heavier, softer or more damped robot",
                rows[:done],
            )

    def strain(self) -> FloatArray:
        """Mean strains (ℓ, k1, k2) now, shape (3,)."""
        strain = self._state.strain
        return np.array([self._stretch(), strain[1], -strain[0]])

    def motion(self) -> Motion:
        """The robot now."""
        row = self._look()
        return Motion(
            rotation=row[ROTATION].reshape(3, 3).copy(),
            angular_velocity_rad_s=row[ANGULAR_VELOCITY].copy(),
            mid_velocity_m_s=row[VELOCITY].copy(),
            centre_of_mass_m=row[CENTRE_OF_MASS].copy(),
            stretch=float(row[STRETCH]),
            curvature_1_m=row[CURVATURE].copy(),
            chord=row[CHORD].copy(),
            angular_momentum_kg_m2_s=row[ANGULAR_MOMENTUM].copy(),
        )

    def row(self) -> FloatArray:
        """The robot now as a row of `sim.motion_rows`, shape (ROW_SIZE,)."""
        return self._look().copy()

    def points(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Contact points now: centre [m], velocity [m/s], angular velocity of the section [rad/s], each (points, 3)."""
        self._look()
        rate = self._work.rate / self._rule.root_mass
        centre = self._state.position_m[:, None] + self._work.place_m
        return centre.T.copy(), rate[:3].T.copy(), (rate[3:6] * (2.0 / self._physics.radius_m)).T.copy()

    @property
    def point_mass_kg(self) -> FloatArray:
        """Mass that each contact point stands for, shape (points,) [kg]: of a symmetric tube both mirror images."""
        mass: FloatArray = self._rule.root_mass**2
        return mass

    @property
    def symmetric(self) -> bool:
        """Whether the tube is its own mirror image about x = 0."""
        return self._physics.mirrored

    @property
    def modes(self) -> int:
        """Shape functions of each bend and of the twist."""
        return self._modes

    @property
    def radius_m(self) -> float:
        """Of the tube [m]."""
        return self._body.radius_m

    def copy(self) -> RodTwin:
        """Another twin in the same state, which goes its own way."""
        other = copy.copy(self)
        other._memory, other._row, other._ghost = self._memory.copy(), self._row.copy(), None
        _, other._state, other._rule, other._contacts, other._work = carve(other._memory, self._places)
        return other

    def play_seen(self, drive: FloatArray, samples: int) -> tuple[FloatArray, FloatArray]:
        """As `play`, a step each sample: rows of motion and where the robot was before and after each, for `fill`."""
        rows, seen = np.empty((samples + 1, ROW_SIZE)), np.empty((samples + 1, instant_size(self._layout)))
        rows[0] = self._look()
        seen[0] = self._memory[: seen.shape[1]]
        try:
            self._play(drive, samples, 1, rows[1:], seen[1:])
        except BrokenOff as error:
            done = len(error.rows) + 1
            error.rows, error.seen = rows[:done], seen[:done]
            raise
        return rows, seen

    def fill(self, rows: FloatArray, seen: FloatArray, parts: int) -> tuple[FloatArray, FloatArray]:
        """What `play_seen` returned, with `parts` − 1 instants filled in within each step (`sim.between_steps`).

        Returns rows of motion, shape (steps · parts, ROW_SIZE), and for each what `seen_at` takes. Energy is laid
        straight between the ends of a step, as the work of the drive is.
        """
        steps, layout = len(rows) - 1, self._layout
        every, filled = np.zeros((steps, parts, seen.shape[1])), np.empty((steps, parts, ROW_SIZE))
        every[:, -1] = seen[1:]
        fill_between(instants(seen, layout), instants(every[:, :-1], layout), layout.modes, self.radius_m)
        flat, flat_every = filled.reshape(-1, ROW_SIZE), every.reshape(-1, seen.shape[1])
        play(self._at_another_time()._memory, self._places, self._physics, _HOLD, len(flat), 0, flat, flat_every)
        filled[:, -1] = rows[1:]
        energy_J = rows[:, ENERGY]
        filled[:, :-1, ENERGY] = straight(energy_J[:-1], energy_J[1:], np.arange(1, parts) / parts)
        return flat, flat_every

    def seen_at(self, instant: FloatArray) -> RodTwin:
        """The robot at an instant of `fill`, to be looked at, not stepped; the same one each time, elsewhere."""
        ghost = self._at_another_time()
        ghost._memory[: len(instant)] = instant
        return ghost

    def _at_another_time(self) -> RodTwin:
        if self._ghost is None:
            self._ghost = self.copy()
        return self._ghost

    def shape(self) -> tuple[FloatArray, FloatArray]:
        """Centre line (n, 3) [m] and section axis e1 (n, 3) along the robot now, equally spaced, ends included."""
        state, half = self._state, self._half
        self._look()
        tangent, first_axis = self._stretch() * self._work.section[2], self._work.section[0]
        ahead = tangent[:, :half] @ self._outline.integral
        axis_ahead = first_axis[:, :half] @ self._outline.value
        if self._layout.points == half:  # the other half mirrored about x = 0
            mirror = np.array([[-1.0], [1.0], [1.0]])
            behind, axis_behind = mirror * ahead, mirror * axis_ahead
        else:
            behind = -tangent[:, half:] @ self._outline.integral
            axis_behind = first_axis[:, half:] @ self._outline.value
        points = state.position_m[:, None] + np.hstack([behind[:, :0:-1], ahead])
        axes = np.hstack([axis_behind[:, :0:-1], state.rotation[:, :1], axis_ahead[:, 1:]])
        return points.T.copy(), (axes / np.linalg.norm(axes, axis=0)).T.copy()

    def energy_J(self) -> float:
        """Kinetic, elastic (against the rest strains) and gravitational energy [J], the ground's springs left out."""
        return float(self._look()[ENERGY])

    def close(self) -> None:
        """Nothing to release."""

    def _look(self) -> FloatArray:
        play(self._memory, self._places, self._physics, _HOLD, 1, 0, self._row, _NOTHING_SEEN)
        return self._row[0]

    def _stretch(self) -> float:
        return float(self._state.strain[-1]) if self._physics.stretches else 1.0

    def _find_natural_rates(self) -> None:
        """Square of each coordinate's natural frequency alone, the base free to follow; of the base, the ground's."""
        self._look()
        columns, base = self._work.column.astype(int), self._layout.base
        rows = self._work.rows.reshape(self._layout.columns, -1)
        mass = rows @ rows.T
        if base:
            across = mass[base:, :base]
            mass = mass[base:, base:] - across @ np.linalg.solve(mass[:base, :base], across.T)
        rates = self._state.modal_rate_1_s2
        for at, column in enumerate(columns[base:]):
            rates[column] = self._state.stiffness[column - 6, column - 6] / max(mass[at, at], 1e-300)
        rates[6] = rates[7] = max(rates[6], rates[7])  # one plane bends as the other
        if self._physics.ground != NO_GROUND:
            rates[:6] = self._physics.contact_stiffness_1_s2


def _columns(modes: int, stretches: bool, symmetric: bool, twists: bool, clamped: bool) -> list[int]:
    """Coordinates that move: of the base (0 … 5), three of each mode, the stretch."""
    base = [] if clamped else [1, 2, 3] if symmetric else list(range(6))
    strains = []
    for m in range(modes):
        for axis in range(3):
            bends = axis < 2
            if not bends and not twists:
                continue
            if symmetric and not clamped and bends != is_even(m):  # a mirror image bends evenly and twists oddly
                continue
            strains.append(6 + 3 * m + axis)
    return base + strains + ([6 + 3 * modes] if stretches else [])


def _physics(
    body: Body,
    world: World,
    ground: int,
    layout: Layout,
    step_s: float,
    tolerance: float,
    symmetric: bool,
    stretches: bool,
) -> Physics:
    gravity = world.gravity_vector_m_s2
    sink = _CONTACT_SINK[ground]
    if body.length_m < _STUBBY * body.radius_m:
        sink = min(sink, _STUBBY_SINK)
    if body.mass_kg * world.gravity_m_s2 * body.length_m**2 > _LIMP * body.bending_stiffness_N_m2:
        sink = min(sink, _LIMP_SINK)
    stiffness_1_s2 = max(world.gravity_m_s2, _LEAST_GRAVITY_M_S2) / (sink * body.radius_m)
    viscous = world.friction_law == "viscous"
    return Physics(
        step_s=float(step_s),
        tolerance=float(tolerance),
        radius_m=float(body.radius_m),
        tightest_1_m=float(min(1.0 / body.radius_m, 2.0 * math.pi / body.length_m)),
        length_m=float(body.length_m),
        mass_kg=float(body.mass_kg),
        gravity_x_m_s2=float(gravity[0]),
        gravity_y_m_s2=float(gravity[1]),
        gravity_z_m_s2=float(gravity[2]),
        damping_time_s=float(body.damping_time_s),
        bending_N_m2=float(body.bending_stiffness_N_m2),
        softening_m2=float(body.ovalisation_m2),
        mirrored=bool(symmetric),
        stretches=bool(stretches),
        viscous=viscous,
        ground=ground,
        ground_a_m=float(world.pipe_radius_m if ground == PIPE else world.step_height_m),
        ground_b_m=float(world.step_distance_m),
        grain=1 if ground == PIPE and world.pipe_axis == "across" else 0,
        friction=float(world.friction * (body.length_m / body.mass_kg if viscous else 1.0)),
        resistance_m2_s2=float(world.rolling_resistance_N_m / body.mass_kg) if layout.resists else 0.0,
        contact_stiffness_1_s2=float(stiffness_1_s2),
        contact_damping_1_s=float(2.0 * _CONTACT_DAMPING_RATIO * math.sqrt(stiffness_1_s2)),
        sleep_speed_m_s=float(_SLEEP_SPEED * math.sqrt(max(world.gravity_m_s2, _LEAST_GRAVITY_M_S2) * body.radius_m)),
    )
