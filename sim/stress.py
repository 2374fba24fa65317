"""Random scenes over everything that a user can set, and what must hold in each whatever it is: the rod's stress.

A trial is a scene, a start and a number of steps. It is refused before it starts with an InputError, or it runs to its
end and keeps its invariants:

finite      every number of every row of motion
time        within a limit on the clock: no step is divided for ever
rotation    RᵀR = 1
energy      kinetic + elastic + weight never rises above what it was at the start by more than the actuators' work.
            The springs and bristles of the ground are not in this sum. They start empty and give back at most what they
            took, so that they only ever lower it; what is left is the error of the integration, and that is allowed
            `ENERGY_SHARE` of all the energy that was turned over
momentum    of a robot that floats: angular as it was at the start, linear as it was plus the weight's
depth       of a robot that has come to rest on a plane: under 2 % of its radius
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim import motion_rows
from sim.drive import bend_1_m, pressures_Pa
from sim.resolution import STEPS_S
from sim.rod import RodTwin
from sim.rod_drive import drive_array
from sim.scene import CONTROL_PERIOD_S, Scene, scene_from, steps_per_period
from sim.twins import make_twin
from softbot.errors import InputError, SimulationError
from softbot.robot import robot_from

FloatArray = NDArray[np.float64]

ENERGY_SHARE = 0.01
"""Of the energy that was turned over: work, heights fallen through, largest change."""
MOMENTUM_SHARE = 1e-9
"""Of m L² ω and m v: round-off of thousands of steps."""
ROTATION_ERROR = 1e-9
DEPTH = 0.02
"""Of the radius, at rest."""
TIME_LIMIT_S = 20.0

LONGEST_STEP_S, SHORTEST_STEP_S = 0.02, 1e-4
_BLOCKS = 100  # rows of motion of a trial: between them the clock is looked at
_MOST_STEPS = 1500
_WIDE, _THIN = 20.0, 4.0


@dataclass(frozen=True)
class Trial:
    """A scene, how it starts, and how long it is looked at."""

    table: dict[str, Any]
    """Tables of the scene."""
    steps: int = 1000
    drop_m: float = 0.0
    """Height above the ground at the start."""
    velocity: tuple[float, ...] = (0.0,) * 6
    """At the start: of the middle [m/s] and of the section [rad/s], world axes."""
    lost: tuple[float, ...] = (0.0,) * 4
    """Share that each chamber has lost."""
    keep: tuple[str, ...] = ()
    """Leave-out rules that are not applied."""


class Verdict(NamedTuple):
    """What became of a trial."""

    outcome: str
    """ "kept", "refused", or what broke."""
    words: str
    measures: dict[str, float]

    @property
    def failed(self) -> bool:
        """Neither kept nor refused."""
        return self.outcome not in ("kept", "refused")


# --- trials ----------------------------------------------------------------------------------------------------------


def random_trial(seed: int) -> Trial:
    """The trial of a seed."""
    random = np.random.default_rng(seed)

    def decades(low: float, high: float) -> float:
        return float(f"{low * (high / low) ** random.random():.4g}")

    def even(low: float, high: float) -> float:
        return float(f"{random.uniform(low, high):.4g}")

    def chance(share: float) -> bool:
        return bool(random.random() < share)

    length_m = decades(0.05, 1.0)
    radius_m = float(f"{length_m / decades(3.0, 60.0):.4g}")
    robot: dict[str, Any] = {
        "length_m": length_m,
        "radius_m": radius_m,
        "mass_kg": decades(1.6e-3, 1.6),
        "damping_time_s": 0.0 if chance(0.05) else decades(2e-4, 0.2),
    }
    tight_1_m = min(2.0 * math.pi / length_m, 1.0 / radius_m)
    kind = str(random.choice(["curvature", "contraction", "pressure"], p=[0.8, 0.1, 0.1]))
    if kind == "contraction" or (kind == "curvature" and chance(0.25)):
        stiffness_N_m2, wall = decades(4e-5, 0.4), radius_m * even(0.02, 0.3)
        robot["tube"] = {
            "wall_thickness_m": wall,
            "youngs_modulus_Pa": 0.75 * stiffness_N_m2 / (math.pi * radius_m**3 * wall),
            "scaled_pressure": decades(0.01, 10.0),
        }
        robot["actuation"] = str(random.choice(["chamber", "muscle"]))
        tight_1_m = min(tight_1_m, math.sqrt(8.0 * robot["tube"]["scaled_pressure"] / 9.0) / radius_m)
    else:
        robot["bending_stiffness_N_m2"] = decades(4e-5, 0.4)
        if chance(0.2):
            robot["twisting_stiffness_N_m2"] = decades(1e-5, 1.0)
        if kind == "curvature" and chance(0.2):
            robot["axial_stiffness_N"] = robot["bending_stiffness_N_m2"] / radius_m**2 * decades(0.1, 10.0)
    longest_s = CONTROL_PERIOD_S if kind == "pressure" else LONGEST_STEP_S
    steps_s = [s for s in STEPS_S if 0.999 * SHORTEST_STEP_S <= s <= 1.001 * longest_s]
    step_s = decades(SHORTEST_STEP_S, longest_s)
    step_s = min(steps_s, key=lambda s: abs(math.log(s / step_s)))
    steps = int(decades(200, _MOST_STEPS))
    if kind == "pressure":
        steps = min(steps, round(1.0 / step_s))
    steps = max(steps, steps_per_period(step_s))
    duration_s = steps * step_s
    start_s = duration_s * even(0.02, 0.7)
    drive: dict[str, Any] = {
        "kind": kind,
        "period_s": 1e5 if chance(0.15) else decades(0.05 if chance(0.3) else max(0.05, 20.0 * step_s), 60.0),
        "direction": int(random.choice([-1, 1])),
        "start_s": start_s,
        "ramp_s": start_s * decades(0.001, 1.0),
        "lag_s": decades(1e-3, 1.0) if kind != "pressure" and chance(0.2) else 0.0,
    }
    if drive["lag_s"] > 0.0 and chance(0.5):
        drive["lead_rad"] = even(-3.1, 3.1)
    if kind == "curvature":
        drive["curvature_1_m"] = 0.0 if chance(0.1) else tight_1_m * even(0.0, 1.5 if "tube" in robot else 1.03)
    elif kind == "contraction":
        drive["contraction"] = decades(0.01, 3.0)
    else:
        limit_Pa = robot_from(robot, "trial").max_pressure_Pa
        both = even(0.0, 0.3) if chance(0.5) else 0.0
        drive["co_contraction_Pa"], drive["peak_pressure_Pa"] = (
            both * limit_Pa,
            (1.03 - both) * limit_Pa * even(0.0, 1.0),
        )
    viscous = chance(0.25)
    ground = str(random.choice(["plane", "none", "step", "pipe"], p=[0.6, 0.16, 0.12, 0.12]))
    world: dict[str, Any] = {
        "gravity_m_s2": 0.0 if chance(0.05) else even(0.0, 30.0),
        "ground": ground,
        "friction_law": "viscous" if viscous else "coulomb",
        "friction": 0.0 if chance(0.05) else decades(1.6e-3, 1.6) if viscous else decades(0.01, 10.0),
    }
    if ground in ("plane", "step") and chance(0.3):
        world |= {"slope_rad": even(0.0, 1.2), "slope_heading_rad": even(-math.pi, math.pi)}
    if ground == "step":
        world["step_height_m"] = radius_m * decades(0.1, 10.0)
        world["step_distance_m"] = float(random.choice([-1, 1])) * radius_m * decades(1.0, 10.0)
    if ground == "pipe":
        world |= {"pipe_radius_m": radius_m * decades(0.5, 50.0), "pipe_axis": str(random.choice(["across", "along"]))}
    if ground != "none" and chance(0.2):
        weight_N_m = robot["mass_kg"] * max(world["gravity_m_s2"], 1.0) * radius_m
        world["rolling_resistance_N_m"] = weight_N_m * decades(1e-3, 1.0)
    solver: dict[str, Any] = {"duration_s": duration_s, "step_s": step_s}
    if chance(0.9):
        solver["modes"] = int(random.integers(1, 6))
    if chance(0.9):
        solver["contact_points"] = int(2 * random.integers(2, 16))
    if chance(0.15):
        solver["tolerance"] = decades(1e-6, 1e-2)
    if chance(0.1):
        del solver["step_s"]
    keep = tuple(rule for rule in ("mirror", "twist", "stretch") if chance(0.5))
    velocity = np.zeros(6)
    if chance(0.3):
        velocity[:3] = random.normal(size=3) * decades(0.01, 1.0)
        velocity[3:] = random.normal(size=3) * decades(0.1, 30.0)
    return Trial(
        {"robot": robot, "drive": drive, "world": world, "solver": solver},
        steps,
        decades(1e-3, 1.0) if ground != "none" and chance(0.3) else 0.0,
        tuple(float(f"{one:.4g}") for one in velocity),
        tuple(even(0.0, 1.0) if chance(0.5) else 1.0 for _ in range(4)) if chance(0.1) else (0.0,) * 4,
        keep,
    )


# --- verdicts --------------------------------------------------------------------------------------------------------


def judge(trial: Trial, time_limit_s: float = TIME_LIMIT_S) -> Verdict:
    """Run a trial and judge it."""
    try:
        scene = scene_from(trial.table, "trial", Path())
        twin = make_twin(scene, keep=trial.keep)
    except InputError as error:
        return Verdict("refused", str(error), {})
    except Exception as error:
        return Verdict("crashed", f"before it started: {type(error).__name__}: {error}", {})
    assert isinstance(twin, RodTwin)
    began_s = time.perf_counter()
    try:
        twin.throw(trial.drop_m, np.array(trial.velocity))
        first, rows = _run(scene, twin, trial, began_s + time_limit_s)
    except SimulationError as error:
        return Verdict("stopped", str(error), {"t_s": twin.t_s})
    except Exception as error:
        return Verdict("crashed", f"{type(error).__name__}: {error}", {"t_s": twin.t_s})
    measures = {
        "wall_s": time.perf_counter() - began_s,
        "solves": float(twin._state.flag[8]),
        "created_J": twin.created_J,
    }
    if rows[-1, motion_rows.TIME] < (1.0 - 1e-6) * trial.steps * twin.step_s:
        return Verdict("hung", f"at t = {twin.t_s:g} s after {time_limit_s:g} s on the clock", measures)
    measures |= _measure(scene, twin, trial, first, rows)
    return Verdict(*_broken(measures), measures)


def _run(scene: Scene, twin: RodTwin, trial: Trial, until_s: float) -> tuple[FloatArray, FloatArray]:
    """The row at the start, and the rows of some `_BLOCKS` blocks, or fewer when the time is up."""
    first, rows = twin.row(), []
    block = max(1, trial.steps // _BLOCKS)
    if scene.drive.kind == "pressure":
        play: Callable[[int, int], FloatArray] = _Pressed(scene, twin).play
        block = steps_per_period(twin.step_s)
    else:
        numbers = drive_array(
            scene.drive,
            trial.lost,
            curvature_1_m=bend_1_m(scene.drive, scene.robot),
            muscle=scene.robot.actuation == "muscle",
        )

        def play(done: int, steps: int) -> FloatArray:
            del done
            return twin.play(numbers, 1, steps)[0]

    done = 0
    while done < trial.steps and time.perf_counter() < until_s:
        steps = min(block, trial.steps - done)
        rows.append(play(done, steps))
        done += steps
    return first, np.array(rows)


class _Pressed:
    """Chamber pressures as the scene asks for them at once (no valves, no gas), through the actuator law."""

    def __init__(self, scene: Scene, twin: RodTwin) -> None:
        self._scene, self._twin = scene, twin
        self._law = scene.robot.actuator_law()

    def play(self, done: int, steps: int) -> FloatArray:
        """One control period, after `done` steps."""
        rest = self._law.equilibrium(pressures_Pa(self._scene.drive, done * self._twin.step_s))
        self._twin.set_rest(np.array([rest.stretch, *rest.curvature_1_m]), rest.stiffness)
        self._twin.advance(steps)
        return self._twin.row()


def _measure(scene: Scene, twin: RodTwin, trial: Trial, first: FloatArray, rows: FloatArray) -> dict[str, float]:
    robot, world = scene.robot, scene.world
    if not np.all(np.isfinite(rows)):
        return {"finite": 0.0}
    rotation = rows[:, motion_rows.ROTATION].reshape(-1, 3, 3)
    square = np.einsum("nki,nkj->nij", rotation, rotation)
    every = np.vstack([first, rows])
    energy, work = every[:, motion_rows.ENERGY], every[:, motion_rows.WORK]
    gravity = np.array([twin._physics.gravity_x_m_s2, twin._physics.gravity_y_m_s2, twin._physics.gravity_z_m_s2])
    weight = robot.mass_kg * (every[:, motion_rows.CENTRE_OF_MASS] - first[motion_rows.CENTRE_OF_MASS]) @ gravity
    mechanical = energy - work
    kinetic = energy[0] + robot.mass_kg * first[motion_rows.CENTRE_OF_MASS] @ gravity
    turned_over = np.abs(np.diff(work)).sum() + np.abs(weight).max() + np.abs(energy - energy[0]).max() + abs(kinetic)
    gained = float((mechanical - mechanical[0]).max())
    low = np.minimum.accumulate(mechanical)
    measures = {
        "finite": 1.0,
        "rotation": float(np.abs(square - np.eye(3)).max()),
        "energy": gained / turned_over if turned_over > 0.0 else 0.0,
        "drawn_up": float((mechanical - low).max()) / turned_over if turned_over > 0.0 else 0.0,
    }
    if world.ground == "none":
        momentum = every[1:, motion_rows.ANGULAR_MOMENTUM]
        scale = robot.length_m * math.sqrt(2.0 * robot.mass_kg * turned_over)  # m L v at m v² = 2 E
        measures["angular"] = float(np.abs(momentum - momentum[0]).max() / scale) if scale > 0.0 else 0.0
        _, velocity, _ = twin.points()
        share = twin._rule.root_mass**2 / robot.mass_kg
        mean = share @ velocity
        if twin._physics.mirrored:
            mean[0] = 0.0
        t_s = rows[-1, motion_rows.TIME]
        fallen = mean - _mean_velocity(trial, twin, first) - gravity * t_s
        scale = float(np.linalg.norm(gravity) * t_s + np.abs(velocity).max())
        measures["linear"] = float(np.abs(fallen).max()) / scale if scale > 0.0 else 0.0
    resting = rows[-1, motion_rows.ASLEEP] > 0.0 and world.gravity_m_s2 > 0.0
    if resting and world.ground != "none":
        measures["depth"] = float(rows[-1, motion_rows.PENETRATION]) / robot.radius_m
        measures["plane"] = float(world.ground == "plane")
    return measures


def _mean_velocity(trial: Trial, twin: RodTwin, first: FloatArray) -> FloatArray:
    """Of the centre of mass of the straight tube as it starts [m/s]."""
    del trial
    velocity = first[motion_rows.VELOCITY].copy()
    velocity += np.cross(
        first[motion_rows.ANGULAR_VELOCITY], first[motion_rows.CENTRE_OF_MASS] - first[motion_rows.POSITION]
    )
    if twin._physics.mirrored:
        velocity[0] = 0.0
    return velocity


def _broken(measures: dict[str, float]) -> tuple[str, str]:
    """Outcome and words."""
    if measures["finite"] == 0.0:
        return "finite", "a number is not finite"
    for name, most in (
        ("rotation", ROTATION_ERROR),
        ("energy", ENERGY_SHARE),
        ("angular", MOMENTUM_SHARE),
        ("linear", MOMENTUM_SHARE),
    ):
        if measures.get(name, 0.0) > most:
            return name, f"{name}: {measures[name]:.3g}, allowed {most:g}"
    if measures.get("plane", 0.0) > 0.0 and measures["depth"] > DEPTH:
        return "depth", f"rests {measures['depth']:.3g} of its radius deep, allowed {DEPTH:g}"
    return "kept", ""


def judge_seed(seed: int) -> Verdict:
    """The verdict on the trial of a seed."""
    return judge(random_trial(seed))
