"""Random scenes over everything that a user can set, and what must hold in each of them.

A trial is a scene, a start and a number of steps. It is refused before it starts with an InputError, or it runs to its
end and keeps its invariants:

finite      every number of every row of motion
time        it ends within a limit on the clock: no step is divided for ever
rotation    RᵀR = 1
energy      kinetic + elastic + weight rises above what it was at the start by no more than the actuators' work. The
            ground's springs and bristles are not in that sum: they start empty and give back at most what they took, so
            that they only ever lower it. What is left is the error of the integration; of all the energy that was
            turned over it may be `ENERGY_SHARE`
momentum    of a robot that floats: angular as it was at the start, linear too but for its weight
depth       of a robot that has come to rest on a plane: under 2 % of its radius
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from sim import motion_rows
from sim.body import Body, World
from sim.drive import bend_1_m, pressures_Pa
from sim.drive import curvature_1_m as given_1_m
from sim.resolution import STEPS_S
from sim.rod import RodTwin
from sim.rod_drive import drive_array
from sim.scene import CONTROL_PERIOD_S, Scene, scene_from, steps_per_period
from sim.trajectory import motion_row
from sim.twins import make_twin
from softbot.errors import InputError, SimulationError
from softbot.robot import robot_from

if TYPE_CHECKING:
    from sim.bullet import BulletTwin

FloatArray = NDArray[np.float64]

ENERGY_SHARE = 0.01
"""Of the energy that was turned over: work, heights fallen through, largest change, motion at the start."""
MOMENTUM_SHARE = 1e-9
"""Of what a motion of all that energy could have: round-off of thousands of steps."""
ROTATION_ERROR = 1e-9
DEPTH = 0.02
"""Of the radius, at rest."""
TIME_LIMIT_S = 120.0
"""Of processor time, for one trial; most take a twentieth of a second, the dearest twelve."""

LONGEST_STEP_S, SHORTEST_STEP_S = 0.02, 1e-4
_ROWS = 100  # of motion, of a trial: between them the clock is looked at
_MOST_STEPS = 1500


@dataclass(frozen=True)
class Trial:
    """A scene, how it starts, and how long it is looked at."""

    table: dict[str, Any]
    """Tables of the scene."""
    steps: int = 1000
    lift_m: float = 0.0
    """Height above the ground at the start."""
    velocity: tuple[float, ...] = (0.0,) * 6
    """At the start: of the middle [m/s] and of the whole about it [rad/s], world axes."""
    lost: tuple[float, ...] = (0.0,) * 4
    """Share that each chamber has lost."""
    keep: tuple[str, ...] = ()
    """Leave-out rules that are not applied (`sim.plan.RULES`)."""


class Verdict(NamedTuple):
    """What became of a trial."""

    outcome: str
    """ "kept", "refused", or what was broken."""
    words: str
    measures: dict[str, float]

    @property
    def failed(self) -> bool:
        """Neither kept nor refused."""
        return self.outcome not in ("kept", "refused")


class _Draw:
    """Random numbers of one trial, rounded so that a scene can be read."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)

    def decades(self, low: float, high: float) -> float:
        """Evenly by its logarithm."""
        return _rounded(low * (high / low) ** self._random.random())

    def even(self, low: float, high: float) -> float:
        """Evenly."""
        return _rounded(self._random.uniform(low, high))

    def chance(self, share: float) -> bool:
        """True so often."""
        return bool(self._random.random() < share)

    def one_of(self, *choices: str, p: tuple[float, ...] | None = None) -> str:
        """One of some words, with the chances p."""
        return str(self._random.choice(choices, p=p))

    def whole(self, low: int, high: int) -> int:
        """A whole number, both ends included."""
        return int(self._random.integers(low, high + 1))

    def spread(self, count: int, size: float) -> list[float]:
        """Normally distributed numbers."""
        return [_rounded(size * one) for one in self._random.normal(size=count)]


def _rounded(number: float) -> float:
    return float(f"{number:.4g}")


# --- trials of the rod -----------------------------------------------------------------------------------------------


def random_trial(seed: int) -> Trial:
    """The rod's trial of a seed: four decades of stiffness, three of mass, friction and damping, all of the rest."""
    draw = _Draw(seed)
    kind = draw.one_of("curvature", "contraction", "pressure", p=(0.8, 0.1, 0.1))
    robot, tightest_1_m = _random_robot(draw, kind)
    longest_s = CONTROL_PERIOD_S if kind == "pressure" else LONGEST_STEP_S
    step_s = draw.decades(SHORTEST_STEP_S, longest_s)
    fitting = [s for s in STEPS_S if 0.999 * SHORTEST_STEP_S <= s <= 1.001 * longest_s]
    step_s = min(fitting, key=lambda s: abs(math.log(s / step_s)))
    steps = int(draw.decades(200, _MOST_STEPS))
    if kind == "pressure":  # each control period asks the actuator law
        steps = min(steps, round(1.0 / step_s))
    steps = max(steps, steps_per_period(step_s))
    drive = _random_drive(draw, kind, robot, tightest_1_m, step_s, steps * step_s)
    world = _random_world(draw, robot)
    keep = tuple(rule for rule in ("mirror", "twist", "stretch") if draw.chance(0.5))
    thrown = draw.chance(0.3)
    return Trial(
        {"robot": robot, "drive": drive, "world": world, "solver": _random_solver(draw, step_s, steps * step_s)},
        steps,
        lift_m=draw.decades(1e-3, 1.0) if world["ground"] != "none" and draw.chance(0.3) else 0.0,
        velocity=(*draw.spread(3, draw.decades(0.01, 1.0)), *draw.spread(3, draw.decades(0.1, 30.0)))
        if thrown
        else (0.0,) * 6,
        lost=tuple(draw.even(0.0, 1.0) if draw.chance(0.5) else 1.0 for _ in range(4))
        if draw.chance(0.1)
        else (0.0,) * 4,
        keep=keep,
    )


def _random_robot(draw: _Draw, kind: str) -> tuple[dict[str, Any], float]:
    """Tables of a robot, and the curvature [1/m] where it closes to a ring, folds or kinks."""
    length_m = draw.decades(0.05, 1.0)
    radius_m = _rounded(length_m / draw.decades(3.0, 60.0))
    robot: dict[str, Any] = {
        "length_m": length_m,
        "radius_m": radius_m,
        "mass_kg": draw.decades(1.6e-3, 1.6),
        "damping_time_s": 0.0 if draw.chance(0.05) else draw.decades(2e-4, 0.2),
    }
    tightest_1_m = min(2.0 * math.pi / length_m, 1.0 / radius_m)
    stiffness_N_m2 = draw.decades(4e-5, 0.4)
    if kind == "contraction" or (kind == "curvature" and draw.chance(0.25)):
        wall_m, pressure = radius_m * draw.even(0.02, 0.3), draw.decades(0.01, 10.0)
        robot["tube"] = {
            "wall_thickness_m": wall_m,
            "youngs_modulus_Pa": 0.75 * stiffness_N_m2 / (math.pi * radius_m**3 * wall_m),
            "scaled_pressure": pressure,
        }
        robot["actuation"] = draw.one_of("chamber", "muscle")
        return robot, min(tightest_1_m, math.sqrt(8.0 * pressure / 9.0) / radius_m)
    robot["bending_stiffness_N_m2"] = stiffness_N_m2
    if draw.chance(0.2):
        robot["twisting_stiffness_N_m2"] = draw.decades(1e-5, 1.0)
    if kind == "curvature" and draw.chance(0.2):
        robot["axial_stiffness_N"] = stiffness_N_m2 / radius_m**2 * draw.decades(1.0, 10.0)
    return robot, tightest_1_m


def _random_drive(
    draw: _Draw, kind: str, robot: dict[str, Any], tightest_1_m: float, step_s: float, duration_s: float
) -> dict[str, Any]:
    start_s = duration_s * draw.even(0.02, 0.7)
    drive: dict[str, Any] = {
        "kind": kind,
        # held, or turning; now and then too fast for the step
        "period_s": 1e5
        if draw.chance(0.15)
        else draw.decades(0.05 if draw.chance(0.2) else max(0.05, 20.0 * step_s), 60.0),
        "direction": 1 if draw.chance(0.5) else -1,
        "start_s": start_s,
        "ramp_s": start_s * draw.decades(0.001, 1.0),
    }
    if kind != "pressure" and draw.chance(0.2):
        drive["lag_s"] = draw.decades(1e-3, 1.0)
        if draw.chance(0.5):
            drive["lead_rad"] = draw.even(-3.1, 3.1)
    if kind == "curvature":  # to the kink and past it; now and then past a full ring, which is refused
        most = 1.5 if "tube" in robot else 1.03
        drive["curvature_1_m"] = 0.0 if draw.chance(0.1) else tightest_1_m * draw.even(0.0, most)
    elif kind == "contraction":
        drive["contraction"] = draw.decades(0.01, 1.5)
    else:
        limit_Pa = robot_from(robot, "trial").max_pressure_Pa
        both = draw.even(0.0, 0.3) if draw.chance(0.5) else 0.0
        drive["co_contraction_Pa"] = both * limit_Pa
        drive["peak_pressure_Pa"] = (1.03 - both) * limit_Pa * draw.even(0.0, 1.0)
    return drive


def _random_world(draw: _Draw, robot: dict[str, Any]) -> dict[str, Any]:
    ground = draw.one_of("plane", "none", "step", "pipe", p=(0.6, 0.16, 0.12, 0.12))
    radius_m = robot["radius_m"]
    world: dict[str, Any] = {"gravity_m_s2": 0.0 if draw.chance(0.05) else draw.even(0.0, 30.0), "ground": ground}
    if draw.chance(0.25):
        world |= {"friction_law": "viscous", "friction": draw.decades(1.6e-3, 1.6)}
    else:
        world |= {"friction_law": "coulomb", "friction": 0.0 if draw.chance(0.05) else draw.decades(0.01, 10.0)}
    if ground in ("plane", "step") and draw.chance(0.3):
        world |= {"slope_rad": draw.even(0.0, 1.2), "slope_heading_rad": draw.even(-math.pi, math.pi)}
    if ground == "step":
        world["step_height_m"] = radius_m * draw.decades(0.1, 10.0)
        world["step_distance_m"] = (1.0 if draw.chance(0.5) else -1.0) * radius_m * draw.decades(1.0, 10.0)
    if ground == "pipe":
        world |= {"pipe_radius_m": radius_m * draw.decades(0.5, 50.0), "pipe_axis": draw.one_of("across", "along")}
    if ground != "none" and draw.chance(0.2):
        weight_N_m = robot["mass_kg"] * max(world["gravity_m_s2"], 1.0) * radius_m
        world["rolling_resistance_N_m"] = weight_N_m * draw.decades(1e-3, 1.0)
    return world


def _random_solver(draw: _Draw, step_s: float, duration_s: float) -> dict[str, Any]:
    """Settings of the rod; some are left to `sim.resolution`, a few are too coarse to be taken."""
    solver: dict[str, Any] = {"duration_s": duration_s}
    if draw.chance(0.9):
        solver["step_s"] = step_s
    modes = draw.whole(1, 5)
    if draw.chance(0.9):
        solver["modes"] = modes
        if draw.chance(0.9):
            least = 2 if draw.chance(0.03) else modes + 2
            solver["contact_points"] = 2 * draw.whole(least, 16)
    if draw.chance(0.15):
        solver["tolerance"] = draw.decades(1e-6, 1e-2)
    return solver


# --- trials of the segment twin --------------------------------------------------------------------------------------


def random_segment_trial(seed: int) -> Trial:
    """The segment twin's trial of a seed: scenes as people make them, two decades of each."""
    draw = _Draw(seed)
    length_m = draw.decades(0.1, 0.4)
    radius_m = _rounded(length_m / draw.decades(8.0, 25.0))
    robot: dict[str, Any] = {
        "length_m": length_m,
        "radius_m": radius_m,
        "mass_kg": draw.decades(0.02, 0.5),
        "damping_time_s": draw.decades(5e-3, 0.1),
        "bending_stiffness_N_m2": draw.decades(1e-3, 0.1),
    }
    step_s = float(draw.one_of("0.001", "0.002", "0.0025", "0.005"))
    steps = draw.whole(150, 500)
    duration_s = steps * step_s
    start_s = duration_s * draw.even(0.1, 0.5)
    ground = draw.one_of("plane", "none", p=(0.8, 0.2))
    world: dict[str, Any] = {"gravity_m_s2": draw.even(1.0, 20.0), "ground": ground, "friction": draw.decades(0.1, 1.5)}
    if ground == "plane" and draw.chance(0.2):
        world |= {"slope_rad": draw.even(0.0, 0.5), "slope_heading_rad": draw.even(-math.pi, math.pi)}
    if draw.chance(0.2):
        world |= {"friction_law": "viscous", "friction": draw.decades(0.01, 0.5)}
    drive = {
        "kind": "curvature",
        "curvature_1_m": draw.even(0.0, 4.0) / length_m,
        "period_s": draw.decades(0.25 if draw.chance(0.8) else 0.05, 20.0),
        "start_s": start_s,
        "ramp_s": start_s,
    }
    solver = {"twin": "bullet", "duration_s": duration_s, "step_s": step_s, "segments": draw.whole(4, 14)}
    return Trial({"robot": robot, "drive": drive, "world": world, "solver": solver}, steps)


# --- verdicts --------------------------------------------------------------------------------------------------------


def judge_seed(seed: int) -> Verdict:
    """The verdict on the rod's trial of a seed."""
    return judge(random_trial(seed))


def judge(trial: Trial, time_limit_s: float = TIME_LIMIT_S) -> Verdict:
    """Run a trial and judge it."""
    try:
        scene = scene_from(trial.table, "trial", Path())
        twin = make_twin(scene, keep=trial.keep)
    except InputError as error:
        return Verdict("refused", str(error), {})
    except Exception as error:
        return Verdict("crashed", f"before it started: {type(error).__name__}: {error}", {})
    try:
        if isinstance(twin, RodTwin):
            return _judged(_RodRun(scene, twin, trial), trial, time_limit_s)
        return _judged(_SegmentRun(scene, cast("BulletTwin", twin), trial), trial, time_limit_s)
    except SimulationError as error:
        return Verdict("stopped", str(error), {})
    except Exception as error:
        return Verdict("crashed", f"{type(error).__name__}: {error}", {})
    finally:
        twin.close()


class _Run(ABC):
    """A trial on its way."""

    energy_share, momentum_share = ENERGY_SHARE, MOMENTUM_SHARE

    def __init__(self, scene: Scene, twin: Any, trial: Trial) -> None:
        self.scene, self.twin, self.trial = scene, twin, trial

    @abstractmethod
    def play(self, done: int, steps: int) -> FloatArray:
        """A row of motion after so many steps more."""

    @abstractmethod
    def row(self) -> FloatArray:
        """A row of motion now."""

    @abstractmethod
    def velocity_m_s(self) -> FloatArray:
        """Of the centre of mass now, shape (3,)."""

    def measures(self) -> dict[str, float]:
        """What else is worth knowing."""
        return {}


class _RodRun(_Run):
    """Of the rod, under a given curvature or under chamber pressures."""

    twin: RodTwin

    def __init__(self, scene: Scene, twin: RodTwin, trial: Trial) -> None:
        super().__init__(scene, twin, trial)
        twin.throw(trial.lift_m, np.array(trial.velocity))
        if scene.drive.kind == "pressure":
            self._law = scene.robot.actuator_law()
            self._drive = np.zeros(0)
        else:
            size_1_m, muscle = bend_1_m(scene.drive, scene.robot), scene.robot.actuation == "muscle"
            self._drive = drive_array(scene.drive, trial.lost, curvature_1_m=size_1_m, muscle=muscle)

    def play(self, done: int, steps: int) -> FloatArray:
        if len(self._drive):
            return self.twin.play(self._drive, 1, steps)[0]
        period = steps_per_period(self.twin.step_s)
        for at in range(done, done + steps, period):  # pressures as they are asked for at once: no valves, no gas
            rest = self._law.equilibrium(pressures_Pa(self.scene.drive, at * self.twin.step_s))
            self.twin.set_rest(np.array([rest.stretch, *rest.curvature_1_m]), rest.stiffness)
            self.twin.advance(min(period, done + steps - at))
        return self.twin.row()

    def row(self) -> FloatArray:
        return self.twin.row()

    def velocity_m_s(self) -> FloatArray:
        _, velocity, _ = self.twin.points()
        mean: FloatArray = self.twin.point_mass_kg @ velocity / self.scene.robot.mass_kg
        if self.twin.symmetric:
            mean[0] = 0.0
        return mean

    def measures(self) -> dict[str, float]:
        return {"created_J": self.twin.created_J}


_TOLD = np.r_[4:33]
"""Columns of a row of motion that the segment twin can fill: from its rotation to the actuators' work."""


class _SegmentRun(_Run):
    """Of the segment twin, under a given curvature."""

    twin: BulletTwin
    energy_share = momentum_share = 0.02  # PyBullet's step is of first order

    def __init__(self, scene: Scene, twin: BulletTwin, trial: Trial) -> None:
        super().__init__(scene, twin, trial)
        self._stiffness, self._t_s, self._work_J = Body.of(scene.robot).rest_stiffness(), 0.0, 0.0

    def play(self, done: int, steps: int) -> FloatArray:
        for step in range(done, done + steps):
            t_s = (step + 1) * self.twin.step_s
            before_J = self.twin.elastic_energy_J()
            self.twin.set_rest(np.array([1.0, *given_1_m(self.scene.drive, t_s)]), self._stiffness)
            self._work_J += self.twin.elastic_energy_J() - before_J
            self.twin.step()
            self._t_s = t_s
        return self.row()

    def row(self) -> FloatArray:
        row = motion_row(self.twin.motion(), self._t_s)
        row[motion_rows.ENERGY], row[motion_rows.WORK] = self.twin.energy_J(), self._work_J
        row[motion_rows.PENETRATION] = self.twin.penetration_m
        row[motion_rows.ASLEEP] = float(self._at_rest(row))
        return np.nan_to_num(row, nan=0.0) if np.isfinite(row[_TOLD]).all() else row

    def _at_rest(self, row: FloatArray) -> bool:
        speed_m_s = np.abs(row[motion_rows.VELOCITY]).max()
        speed_m_s += self.scene.robot.radius_m * np.abs(row[motion_rows.ANGULAR_VELOCITY]).max()
        return bool(speed_m_s < 1e-3 * math.sqrt(self.scene.world.gravity_m_s2 * self.scene.robot.radius_m))

    def velocity_m_s(self) -> FloatArray:
        return self.twin.centre_velocity_m_s()


def _judged(run: _Run, trial: Trial, time_limit_s: float) -> Verdict:
    began_s, step_s = time.process_time(), run.twin.step_s
    start_m_s, first, rows, done = run.velocity_m_s(), run.row(), [], 0
    while done < trial.steps and time.process_time() - began_s < time_limit_s:
        steps = min(max(1, trial.steps // _ROWS), trial.steps - done)
        rows.append(run.play(done, steps))
        done += steps
    measures = {"wall_s": time.process_time() - began_s, **run.measures()}
    if done < trial.steps:
        return Verdict("hung", f"at step {done} of {step_s:g} s after {time_limit_s:g} s of processor time", measures)
    every = np.vstack([first, *rows])
    if not np.all(np.isfinite(every)):
        return Verdict("finite", "a number is not finite", measures)
    measures |= _measured(run, every, start_m_s)
    for name, most in (
        ("rotation", ROTATION_ERROR),
        ("energy", run.energy_share),
        ("angular", run.momentum_share),
        ("linear", run.momentum_share),
        ("depth", DEPTH),
    ):
        if measures.get(name, 0.0) > most:
            return Verdict(name, f"{name}: {measures[name]:.3g}, allowed {most:g}", measures)
    return Verdict("kept", "", measures)


def _measured(run: _Run, rows: FloatArray, start_m_s: FloatArray) -> dict[str, float]:
    """How far each invariant is broken, over its scale."""
    robot, world = run.scene.robot, run.scene.world
    gravity = World(**world.model_dump()).gravity_vector_m_s2
    rotation = rows[:, motion_rows.ROTATION].reshape(-1, 3, 3)
    energy, work = rows[:, motion_rows.ENERGY], rows[:, motion_rows.WORK]
    weight = robot.mass_kg * rows[:, motion_rows.CENTRE_OF_MASS] @ gravity
    turned_over = (
        np.abs(np.diff(work)).sum()
        + np.abs(weight - weight[0]).max()
        + np.abs(energy - energy[0]).max()
        + abs(energy[0] + weight[0])  # of the straight robot at rest strains: its motion
    )
    square = np.einsum("nki,nkj->nij", rotation, rotation)
    measures = {
        "rotation": float(np.abs(square - np.eye(3)).max()),
        "energy": _over((energy - work).max() - energy[0] + work[0], turned_over),
    }
    if world.ground == "none":
        momentum = rows[:, motion_rows.ANGULAR_MOMENTUM]
        speed_m_s = math.sqrt(2.0 * turned_over / robot.mass_kg)
        fallen_m_s = run.velocity_m_s() - start_m_s - gravity * rows[-1, motion_rows.TIME]
        measures["angular"] = _over(np.abs(momentum - momentum[0]).max(), robot.mass_kg * robot.length_m * speed_m_s)
        measures["linear"] = _over(np.abs(fallen_m_s).max(), speed_m_s)
    elif world.ground == "plane" and rows[-1, motion_rows.ASLEEP] > 0.0:
        measures["depth"] = float(rows[-1, motion_rows.PENETRATION]) / robot.radius_m
    return measures


def _over(error: float, scale: float) -> float:
    return float(error) / float(scale) if scale > 0.0 else 0.0
