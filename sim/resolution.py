"""How fine the rod twin has to be for a stated error: bending modes, contact points and step, from scene and target.

`solver.accuracy` names a target: the relative error that a run may have in revolutions, advance, bend and the turning
of the floating body. Three errors share it, and of each the coarsest choice that keeps to its share is taken:

modes     The bend that weight, friction and swing add to the given one is no arc, and few polynomials show it
          coarsely. How large it is follows from the load numbers of `Demand`; how fast it falls with the modes is
          measured (`MODES_LAW`).
points    Friction is summed over Gauss points. For the friction balance of a slow arc on a floor or a slope
          (`softbot.rolling`) both the sum and the integral are known, so their difference is computed; where the loads
          of a soft robot gather towards its ends the sum is worse by a measured amount (`GATHERED_LOAD`). The inertia
          and the spin of the arc are summed over the same points, and the error of that is computed too.
step      A steady roll has none: what stays where it is in space is carried exactly. What changes is of second order
          in the angle that the drive turns in a step; valves that are commanded step by step are of first order
          (`STEP_LAW`).

The measured constants, and whether each level keeps its word, are printed by `python benchmarks/resolution.py`; what
they came to is in docs/decisions/0008-accuracy-by-error-target.md.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.arc_sums import friction_sum_errors, spin_sum_errors
from sim.scene import CONTROL_PERIOD_S, Scene
from softbot.errors import InputError, SimulationError
from softbot.rolling import floating_ratio

FloatArray = NDArray[np.float64]

TARGETS = {"fast": 0.02, "standard": 0.005, "reference": 0.0005}
"""accuracy → relative error that a run may have."""
MODES_SHARE, POINTS_SHARE, STEP_SHARE = 0.45, 0.15, 0.3
"""Of the target: the errors may add up. What they leave is for leaving out (`sim.plan`)."""
AFLOAT_SHARE = 0.2
"""Of these: without contact fineness is cheap, and the turning of a floating robot is known in closed form."""

LEAST_STEPS_PER_TURN = 10
"""Of a drive's period: with fewer the drive aliases with the step and the result means nothing."""
MODES = (1, 3, 5, 7, 9, 11)
"""Numbers to choose from: each has one more even mode than the last, in which a tube that mirrors itself bends, and one
more odd one, in which it twists."""
LEAST_POINTS, MOST_POINTS = 6, 64
LONGEST_STEP_S = 0.2
LEAST_MODES_AMONG_BODIES, LONGEST_STEP_AMONG_BODIES_S = 5, 0.005
"""What other bodies do is not foreseen: a push is felt at one place, and lasts as short as the blow."""
SHORTEST_VALVE_STEP_S = 1e-3
"""With valves: below it the noise of the sensors, which the valves answer to, is larger than the error of the step."""

_FRICTION, _BEND_RAD = 0.6, 1.8  # what the laws below were measured at


class ModesLaw(NamedTuple):
    """Error of so many modes: (bend)^2.4 (linear q/(1 + bound q) + square q²) + swing w.

    q: number of the weight times friction, w: number of the swing.
    """

    linear: float
    bound: float
    square: float
    swing: float
    driven: float
    """Where stretch and bend are coupled by the section's pressure, instead of the law above where that is less."""


MODES_LAW = {
    1: ModesLaw(3.5e-3, 0.06, 0.0, 1e-3, 4.5e-3),
    3: ModesLaw(3.5e-4, 1.0, 1.45e-4, 1e-5, 2e-4),
    5: ModesLaw(2.2e-4, 1.0, 1.2e-5, 1e-6, 5e-5),
    7: ModesLaw(4e-5, 1.0, 2.5e-6, 1e-7, 1e-5),
    9: ModesLaw(1e-5, 1.0, 6e-7, 1e-8, 2e-6),
    11: ModesLaw(2.5e-6, 1.0, 1.5e-7, 1e-9, 5e-7),
}
_BEND_POWER = 2.4
GATHERED_LOAD = 1.2e-3
"""Error of the sum per q²/points²."""
SLOPE_LOAD = 1.1
"""Error of the sum per pull of a slope across the tube /points²: it leans, and presses its ends or its middle down."""
SPIN_SUM = 6.0
"""Measured error of a floating turn over that of the sums of spin and inertia alone."""


class StepLaw(NamedTuple):
    """Error of a step h by its causes."""

    turn: dict[str, float]
    """Per (rate of the drive × h)², by what the tube rubs on; over the floating ratio where it rubs on nothing."""
    drag: float
    """More of that per rate × time in which viscous drag takes hold."""
    slope: float
    """More of that where a slope pulls with a tenth of what friction holds, or more."""
    own: float
    """Per (rate at which the robot rolls by itself × h)²."""
    lift: float
    """Per (number of the weight times friction)², where steps are long enough for a sagging tube's ends to lift and
    press in turns."""
    damping: dict[str, float]
    """Per (rate)² × damping time × h, as far as the damped motions are not resolved, afloat and under pressure: a roll
    under a given bend is steady."""
    ramp: float
    """Per (h / time in which the bend grows)², where h is at most what is taken meanwhile."""
    valves: float
    """Per h / time in which valves and chambers follow."""
    lead: float
    """Per (h / lag)² of a curvature that is led by the robot's own roll."""


STEP_LAW = StepLaw(
    turn={"nothing": 0.03, "coulomb": 0.01, "viscous": 0.01},
    drag=0.05,
    slope=0.15,
    own=0.2,
    lift=5e-5,
    damping={"afloat": 0.2, "pressure": 0.5},
    ramp=0.05,
    valves=0.045,
    lead=0.2,
)
_UNRESOLVED, _STEEP, _LONG_S = 100.0, 0.1, 0.05
STEPS_A_RAMP = {"fast": 10, "standard": 20, "reference": 200}
"""At least, while a bend grows: a straight tube that begins to bend slides this way or that."""


@dataclass(frozen=True)
class Demand:
    """What a scene asks of the rod, as the numbers that decide how fine it has to be."""

    bend_rad: float
    """Largest bend κL that the drive asks for."""
    slenderness: float
    """Length over radius."""
    rubs_on: str
    """ "nothing", "coulomb" or "viscous"."""
    weight: float
    """λgL³/EI: how far its own weight bends the tube."""
    friction: float
    """Line load of friction over that of the weight: the coefficient, or of viscous drag the largest."""
    downhill: tuple[float, float]
    """Pull of a slope along and across the tube, over what friction can hold."""
    amplified: float
    """How much more errors count than on a level floor, where weight moves the robot along as it rolls (measured)."""
    floating_ratio: float
    """Ω/α̇ of the floating arc."""
    swing: float
    """λΩ²L⁴/EI at the speed Ω at which the C turns in space: how far its own swing bends it."""
    turn_rate_rad_s: float
    """At which the curvature direction turns."""
    own_rate_rad_s: float
    """At which the robot rolls by itself, off a pipe or a step."""
    hold_s: float
    """In which viscous drag brings the robot to the speed of what it lies on."""
    natural_rad_s: float
    """Slowest natural frequency of the bend."""
    damping_s: float
    """Damping time."""
    ramp_s: float
    """In which the bend grows; 0: it does so by a lag only."""
    growing_step_s: float
    """Longest step meanwhile."""
    lag_s: float
    """With which a curvature that is led by the roll follows; 0: it turns by itself."""
    valves_s: float
    """In which valves and chambers follow; 0: none."""

    @classmethod
    def of(cls, scene: Scene) -> Demand:
        """The demand of a scene."""
        robot, world, drive = scene.robot, scene.world, scene.drive
        length, line_kg_m = robot.length_m, robot.mass_kg / robot.length_m
        bend = min(_largest_bend_rad(scene), 2.0 * math.pi)
        rate, lag_s, valves_s = _turning(scene)
        softening = 3.0 * robot.ovalisation_m2 * (bend / length) ** 2
        bending_N_m2 = robot.bending_stiffness * max(1.0 - softening, _SOFTEST)
        ratio = floating_ratio(length, robot.radius_m, bend / length)
        turning_rad_s = rate * ratio
        grounded = world.ground != "none"
        weight_N_m = line_kg_m * world.gravity_m_s2 if grounded else 0.0
        viscous = world.friction_law == "viscous"
        drag_N_m = world.friction * (rate * robot.radius_m if viscous else weight_N_m) if grounded else 0.0
        swing_N_m = line_kg_m * turning_rad_s**2 * length * bend / 8.0
        loose = min(1.0, swing_N_m / drag_N_m) if drag_N_m > 0.0 else 1.0  # held by the floor it does not swing
        pull = math.tan(world.slope_rad) / max(world.friction, _LEAST_FRICTION)
        tilted = world.ground in ("plane", "step") and not viscous
        pull = min(pull, _STEEPEST) if tilted else 0.0
        along = abs(math.cos(world.slope_heading_rad))
        return cls(
            bend_rad=bend,
            slenderness=length / robot.radius_m,
            rubs_on="nothing" if drag_N_m == 0.0 else world.friction_law,
            weight=weight_N_m * length**3 / bending_N_m2,
            friction=min(drag_N_m / weight_N_m, _LARGEST_FRICTION) if weight_N_m > 0.0 else 0.0,
            downhill=(
                pull * along,
                pull * abs(math.sin(world.slope_heading_rad)),
            ),
            amplified=_ON_A_CREST if world.ground in ("pipe", "step") else 1.0 + _CREEP * pull * along,
            floating_ratio=ratio,
            swing=loose * line_kg_m * turning_rad_s**2 * length**4 / bending_N_m2,
            turn_rate_rad_s=rate,
            own_rate_rad_s=_own_rate_rad_s(scene),
            hold_s=line_kg_m / world.friction if viscous and world.friction > 0.0 else 0.0,
            # of ∫κ² against the arc's inertia λL⁵/720, its ends free
            natural_rad_s=math.sqrt(720.0 * bending_N_m2 / line_kg_m) / length**2,
            damping_s=robot.damping_time_s,
            ramp_s=drive.ramp_s if drive.kind != "sequencer" else 0.0,
            growing_step_s=growing_step_s(scene),
            lag_s=lag_s,
            valves_s=valves_s,
        )


_SOFTEST = 0.1  # of EI: a section near its kink
_LARGEST_FRICTION, _LEAST_FRICTION = 10.0, 1e-3
_STEEPEST = 0.9  # of what friction holds: beyond, the robot slides off faster and faster
_CREEP, _ON_A_CREST = 30.0, 12.0
_LARGEST_LEAD = 2.5  # tangent of the lead
_FILLING_S = 0.1  # time of a pressure loop on the shipped valves


def growing_step_s(scene: Scene) -> float:
    """Longest step while the bend grows [s]."""
    return scene.drive.ramp_s / STEPS_A_RAMP[scene.solver.accuracy]


def _own_rate_rad_s(scene: Scene) -> float:
    """Rate at which weight moves the robot by itself, off a pipe or a step [rad/s]."""
    world, radius_m = scene.world, scene.robot.radius_m
    gravity = world.gravity_m_s2
    if world.ground == "pipe":
        return math.sqrt(gravity / (world.pipe_radius_m + radius_m))
    if world.ground == "step":
        return math.sqrt(gravity / radius_m)
    return 0.0


def _largest_bend_rad(scene: Scene) -> float:
    robot, drive = scene.robot, scene.drive
    if drive.kind == "curvature":
        assert drive.curvature_1_m is not None
        return drive.curvature_1_m * robot.length_m
    if drive.kind == "contraction":
        from softbot.muscle import linear_rest_curvature_1_m

        tube = robot.thin_tube()
        assert tube is not None
        assert drive.contraction is not None
        linear_1_m = linear_rest_curvature_1_m(tube, drive.contraction)
        return _softened_1_m(linear_1_m, robot.ovalisation_m2) * robot.length_m
    if drive.kind == "sequencer" and scene.sequencer.bend_rad is not None:
        return scene.sequencer.bend_rad
    law = robot.actuator_law()
    if drive.kind == "pressure":
        assert drive.peak_pressure_Pa is not None
        others_Pa, peak_Pa = drive.co_contraction_Pa, drive.co_contraction_Pa + drive.peak_pressure_Pa
    else:
        others_Pa, peak_Pa = scene.sequencer.co_contraction_Pa, robot.max_pressure_Pa
    try:
        curvature = law.equilibrium([peak_Pa, others_Pa, others_Pa, others_Pa]).curvature_1_m
    except SimulationError as error:
        raise SimulationError(
            f"{scene.name}: {error}; mind the units of robot.actuator.modulus_Pa and of the largest pressure"
        ) from None
    return float(math.hypot(*curvature)) * robot.length_m


def _softened_1_m(linear_1_m: float, ovalisation_m2: float) -> float:
    """κ with κ − aκ³ = the linear curvature, on the stable branch; at the kink where there is none."""
    curvature_1_m = 0.0
    for _ in range(100):
        slope = 1.0 - 3.0 * ovalisation_m2 * curvature_1_m**2
        if slope < _SOFTEST:
            break
        missing_1_m = linear_1_m - curvature_1_m + ovalisation_m2 * curvature_1_m**3
        curvature_1_m += missing_1_m / slope
        if missing_1_m < 1e-9 * linear_1_m:
            break
    kink_1_m = 1.0 / math.sqrt(3.0 * ovalisation_m2) if ovalisation_m2 else math.inf
    return min(curvature_1_m, kink_1_m)


def _turning(scene: Scene) -> tuple[float, float, float]:
    """Rate at which the curvature direction turns [rad/s], lag of a led curvature [s], and that of valves [s].

    Under feedback of the roll the curvature is asked for a lead ahead and follows with a lag τ: it turns at
    tan(lead)/τ.
    """
    drive, damping_s = scene.drive, scene.robot.damping_time_s
    if drive.kind in ("curvature", "contraction"):
        if drive.lead_rad is None:
            return 2.0 * math.pi / drive.period_s, 0.0, 0.0
        return _led_rad_s(drive.lead_rad, drive.lag_s + damping_s), drive.lag_s, 0.0
    follow_s = _FILLING_S + scene.robot.pneumatics.valve_lag_s
    if drive.kind == "pressure":
        return 2.0 * math.pi / drive.period_s, 0.0, follow_s
    fastest = _led_rad_s(scene.sequencer.lead_rad, follow_s + damping_s)
    if scene.sequencer.speed_rev_s is not None:
        fastest = min(fastest, 2.0 * math.pi * scene.sequencer.speed_rev_s)
    return fastest, 0.0, follow_s


def _led_rad_s(lead_rad: float, lag_s: float) -> float:
    tangent = abs(math.tan(lead_rad)) if abs(lead_rad) < 0.5 * math.pi else _LARGEST_LEAD
    return min(tangent, _LARGEST_LEAD) / lag_s


# --- the three errors -----------------------------------------------------------------------------------------------


def modes_error(demand: Demand, modes: int) -> float:
    """Relative error of a rod of so many bending polynomials; even numbers do no more than the odd one below."""
    law = MODES_LAW[max(m for m in MODES if m <= modes)]
    load = demand.weight * demand.friction / _FRICTION
    bent = (demand.bend_rad / _BEND_RAD) ** _BEND_POWER
    error = bent * (law.linear * load / (1.0 + law.bound * load) + law.square * load * load)
    if demand.valves_s > 0.0:
        error = max(error, law.driven)
    return error * demand.amplified + law.swing * demand.swing


def points_error(demand: Demand, points: int) -> float:
    """Relative error of summing friction, spin and inertia over so many contact points.

    The sum's own error changes sign with the bend, and a bend that grows passes through the zeros: the largest over the
    bends from 70 % up counts.
    """
    if demand.bend_rad < _STRAIGHT_RAD:
        return 0.0
    half = points // 2
    error = SPIN_SUM * float(np.max(spin_sum_errors(demand.bend_rad, half, demand.slenderness)))
    if demand.rubs_on == "coulomb":
        error = max(error, float(np.max(friction_sum_errors(demand.bend_rad, demand.downhill, half))))
        load = demand.weight * demand.friction / _FRICTION
        bent = (demand.bend_rad / _BEND_RAD) ** _BEND_POWER
        error += bent * (GATHERED_LOAD * load * load + SLOPE_LOAD * demand.downhill[1]) / points**2
    return error


def step_error(demand: Demand, step_s: float) -> float:
    """Relative error of a step [s]."""
    law, turn = STEP_LAW, demand.turn_rate_rad_s * step_s
    steep = min(1.0, sum(demand.downhill) / _STEEP)
    each = law.turn[demand.rubs_on] + law.drag * demand.turn_rate_rad_s * demand.hold_s + law.slope * steep
    error = each * turn * turn
    if demand.rubs_on == "nothing":
        error /= max(demand.floating_ratio, _LEAST_RATIO)
    error += law.own * (demand.own_rate_rad_s * step_s) ** 2
    if demand.ramp_s > 0.0:  # meanwhile steps are divided
        error += law.ramp * min(step_s, demand.growing_step_s) ** 2 / demand.ramp_s**2
    if demand.rubs_on == "coulomb":
        load, long = demand.weight * demand.friction / _FRICTION, (step_s / _LONG_S) ** 2
        error += law.lift * load * load * long / (1.0 + long)
    driven = "pressure" if demand.valves_s > 0.0 else "afloat" if demand.rubs_on == "nothing" else ""
    if driven:
        unresolved = (step_s * demand.natural_rad_s) ** 2
        unresolved += (step_s * demand.damping_s * demand.natural_rad_s**2) ** 2
        unresolved /= unresolved + _UNRESOLVED
        error += law.damping[driven] * demand.turn_rate_rad_s * demand.damping_s * turn * unresolved
    if demand.valves_s > 0.0:
        error += law.valves * step_s / demand.valves_s
    if demand.lag_s > 0.0:
        error += law.lead * (step_s / demand.lag_s) ** 2
    return error


_STRAIGHT_RAD = 2e-3
_LEAST_RATIO = 1e-3


# --- the choice -----------------------------------------------------------------------------------------------------


class Choice(NamedTuple):
    """One of the three, with the relative error that it is estimated to bring."""

    value: float
    error: float
    given: bool
    """Stated in the scene's `[solver]` table, whatever its error."""


@dataclass(frozen=True)
class Resolution:
    """Modes, contact points and step [s] of a rod, and the target they were chosen for."""

    target: float
    demand: Demand
    modes_choice: Choice
    points_choice: Choice
    step_choice: Choice

    @property
    def modes(self) -> int:
        """Bending polynomials."""
        return int(self.modes_choice.value)

    @property
    def contact_points(self) -> int:
        """Points along the whole tube."""
        return int(self.points_choice.value)

    @property
    def step_s(self) -> float:
        """Longest step [s]."""
        return self.step_choice.value

    @property
    def error(self) -> float:
        """Sum of the three estimates."""
        return self.modes_choice.error + self.points_choice.error + self.step_choice.error


def resolve(scene: Scene) -> Resolution:
    """Modes, points and step of a scene's rod; what `[solver]` states stands.

    Raises InputError when the drive turns in fewer than `LEAST_STEPS_PER_TURN` of the steps that the scene states.
    """
    solver, demand = scene.solver, Demand.of(scene)
    target = TARGETS[solver.accuracy]
    spent = target * (AFLOAT_SHARE if demand.rubs_on == "nothing" else 1.0)
    tries = MODES if not scene.body else tuple(m for m in MODES if m >= LEAST_MODES_AMONG_BODIES)
    modes = solver.modes or _first(tries, lambda m: modes_error(demand, m), MODES_SHARE * spent)
    points = solver.contact_points
    if points is None:
        least = max(LEAST_POINTS, 2 * modes + 2)
        points = _first(range(least, MOST_POINTS + 1, 2), lambda n: points_error(demand, n), POINTS_SHARE * spent)
    rests = solver.question == "equilibrium"
    if rests:
        step_s = solver.step_s or equilibrium_step_s(scene.robot.damping_time_s)
    else:
        step_s = solver.step_s or _longest_step_s(scene, demand, STEP_SHARE * spent)
        check_turn(scene, step_s)
    return Resolution(
        target,
        demand,
        Choice(modes, modes_error(demand, modes), solver.modes is not None),
        Choice(points, points_error(demand, points), solver.contact_points is not None),
        Choice(step_s, 0.0 if rests else step_error(demand, step_s), solver.step_s is not None),
    )


def equilibrium_step_s(damping_time_s: float) -> float:
    """Pseudo-time step towards a rest [s]: long against every motion, and against the damping that would brake it."""
    return CONTROL_PERIOD_S * math.ceil(max(0.2, 10.0 * damping_time_s) / CONTROL_PERIOD_S - 1e-9)


def _first(tries: Sequence[int], error: Callable[[int], float], allowed: float) -> int:
    """The first from which on two in a row are within `allowed` (one alone may be so by luck); else the last."""
    for value, following in itertools.pairwise(tries):
        if error(value) <= allowed and error(following) <= allowed:
            return value
    return tries[-1]


def _longest_step_s(scene: Scene, demand: Demand, allowed: float) -> float:
    given = scene.drive.kind in ("curvature", "contraction")
    longest_s = LONGEST_STEP_S if given else CONTROL_PERIOD_S
    if scene.body:
        longest_s = LONGEST_STEP_AMONG_BODIES_S
    shortest_s = STEPS_S[-1] if given else SHORTEST_VALVE_STEP_S
    if scene.drive.kind != "sequencer" and scene.drive.lead_rad is None:
        longest_s = min(longest_s, scene.drive.period_s / LEAST_STEPS_PER_TURN)
    steps = [s for s in STEPS_S if s <= longest_s * (1.0 + 1e-9) and _fits(scene, s)]
    for step_s in steps:
        if step_error(demand, step_s) <= allowed or step_s <= shortest_s * (1.0 + 1e-9):
            return step_s
    return STEPS_S[-1]


def _fits(scene: Scene, step_s: float) -> bool:
    """Whether samples a step apart fall on the times from and to which the metrics count."""
    if step_s <= CONTROL_PERIOD_S:
        return True
    times = np.array([scene.solver.duration_s, scene.steady_after_s]) / step_s
    return bool(np.abs(times - np.round(times)).max() < 1e-6)


STEPS_S = (
    *(periods * CONTROL_PERIOD_S for periods in (20, 16, 12, 10, 8, 6, 5, 4, 3, 2)),
    *(CONTROL_PERIOD_S / parts for parts in (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 25, 32, 40, 50, 64, 80, 100)),
)
"""Whole numbers of control periods, and whole parts of one."""


def check_turn(scene: Scene, step_s: float, steps: int = LEAST_STEPS_PER_TURN) -> None:
    """Raise InputError when a drive of given period turns in fewer than this many steps."""
    least_s = steps * step_s
    turns = scene.drive.kind != "sequencer" and scene.drive.lead_rad is None
    if turns and scene.drive.period_s < least_s * (1.0 - 1e-9):
        raise InputError(
            f"drive.period_s = {scene.drive.period_s:g}: the curvature would turn in fewer than {steps} "
            f"steps; take at least {least_s:g} s, a higher solver.accuracy or a smaller solver.step_s"
        )
