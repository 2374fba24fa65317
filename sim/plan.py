"""What a scene is compiled into: a twin of the right fineness, and everything that this scene can do without.

Each leave-out rule is one function here: its condition and its reason in numbers stand together. None changes a result
by more than the accuracy's target (tests/sim/test_plan.py); what each saves is measured in benchmarks/leave_out.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, NamedTuple

from sim.kerb import with_kerb
from sim.resolution import Choice, Resolution, check_turn, resolve
from sim.scene import Scene
from softbot.errors import InputError

BULLET = {"fast": (0.005, 10), "standard": (0.0025, 10), "reference": (0.001, 20)}
"""accuracy → step [s] and segments of the segment twin; how well each does stands in benchmarks/twins.md."""
BULLET_STEPS_PER_TURN = 20
"""At least: with half as many its joints turn too far in a step (`sim.resolution` has the rod's number)."""


class Verdict(NamedTuple):
    """Whether a rule holds in a scene, and why or why not."""

    left_out: bool
    reason: str


class Rule(NamedTuple):
    """Something that a scene may do without."""

    name: str
    saves: str
    """What is then not computed."""
    judge: Callable[[Scene, Resolution], Verdict]


class Decision(NamedTuple):
    """A rule as it came out in a scene."""

    name: str
    saves: str
    left_out: bool
    reason: str


GIVEN = ("curvature", "contraction")
"""Kinds of drive whose rest strains are given: no valve, no gas, no sensor."""


def contact(scene: Scene, _: Resolution) -> Verdict:
    """The ground, where there is none."""
    world = scene.world
    if world.ground == "none":
        return Verdict(True, "world.ground is none: nothing to touch, and gravity moves all of the robot alike")
    return Verdict(False, f"the robot lies on the ground ({world.ground}); aloft, a step leaves it out by itself")


def mirrored_half(scene: Scene, _: Resolution) -> Verdict:
    """One half of the tube, where all that acts on it is its own mirror image about the plane x = 0.

    The tube is uniform, starts straight along x and at rest, and whatever drives it acts alike along its length; what
    is left is the weight, the ground and other bodies.
    """
    world = scene.world
    if scene.body:
        return Verdict(False, f"{len(scene.body)} other bodies may push one half more than the other")
    downhill = world.gravity_m_s2 * math.sin(world.slope_rad) * math.cos(world.slope_heading_rad)
    if world.ground != "none" and abs(downhill) > _LEVEL * world.gravity_m_s2:
        return Verdict(False, f"the weight pulls along the tube with {downhill:.2g} m/s² (world.slope_heading_rad)")
    return Verdict(True, "tube, drive, weight and ground are their own mirror image about the middle of the tube")


_LEVEL = 1e-12


def twist_error(resolution: Resolution, scene: Scene) -> float:
    """Relative error of a tube that cannot twist: proportional to the friction torque over GJ; measured."""
    demand, robot = resolution.demand, scene.robot
    turned = demand.weight * demand.friction * robot.bending_stiffness / robot.twisting_stiffness
    return _TWIST_LAW * turned * (demand.bend_rad / _TWIST_BEND_RAD) ** _TWIST_BEND_POWER * demand.amplified


_TWIST_LAW, _TWIST_BEND_RAD, _TWIST_BEND_POWER = 4e-4, 1.8, 4.2


def twist(scene: Scene, resolution: Resolution) -> Verdict:
    """Twist, where the torque of weight and friction turns the ends too little to be noticed."""
    if scene.body:
        return Verdict(False, "other bodies may twist the tube by any amount")
    if scene.world.ground in ("pipe", "step"):
        return Verdict(False, f"on a {scene.world.ground} a part of the tube may carry its whole weight")
    if resolution.demand.rubs_on == "viscous":
        return Verdict(False, "viscous drag has no limit that would bound the torque")
    error, allowed = twist_error(resolution, scene), resolution.target - resolution.error
    words = f"it would change the result by about {_percent(error)}; the other errors leave {_percent(allowed)}"
    return Verdict(error <= allowed, words)


def stretch(scene: Scene, _: Resolution) -> Verdict:
    """The length as a coordinate, where nothing drives it."""
    if scene.drive.kind in GIVEN:
        return Verdict(True, f'drive.kind = "{scene.drive.kind}" bends and does not elongate')
    return Verdict(False, "chambers under pressure elongate the tube")


def dynamics(scene: Scene, _: Resolution) -> Verdict:
    """All motion, where only the rest is asked for."""
    if scene.solver.question == "equilibrium":
        return Verdict(True, 'solver.question = "equilibrium": one solve for the rest, no time')
    return Verdict(False, 'solver.question = "motion"')


def resting(scene: Scene, _: Resolution) -> Verdict:
    """Steps of a robot that rests, until something changes."""
    if scene.world.ground == "none":
        return Verdict(False, "afloat nothing brings the robot to rest")
    if scene.body:
        return Verdict(False, "other bodies may come and push")
    if scene.robot.damping_time_s <= 0.0:
        return Verdict(False, "robot.damping_time_s = 0: a vibration goes on for ever")
    return Verdict(True, "whenever speeds stay below 1e-5 √(gR) for 0.1 s, until the command changes")


def pneumatics(scene: Scene, _: Resolution) -> Verdict:
    """Valves and gas."""
    if scene.drive.kind in GIVEN:
        return Verdict(True, f'drive.kind = "{scene.drive.kind}": the bend is given, there is no gas to balance')
    return Verdict(False, "valves and chambers decide the bend")


def sensors(scene: Scene, _: Resolution) -> Verdict:
    """Sensor readings and the bus."""
    if scene.drive.kind in GIVEN:
        return Verdict(True, "nobody reads them: no controller in this scene")
    return Verdict(False, "the controller reads them")


def logs(scene: Scene, _: Resolution) -> Verdict:
    """Telemetry and shapes."""
    del scene
    return Verdict(False, 'a run folder keeps them; sim.run_many and record = "summary" keep the summary alone')


def bodies(scene: Scene, _: Resolution) -> Verdict:
    """PyBullet and the bodies in it."""
    if scene.body:
        return Verdict(False, f"{len(scene.body)} of them; while none is within reach the rod runs alone")
    return Verdict(True, "the scene has none")


RULES = (
    Rule("contact", "gaps, loads and friction of the contact points", contact),
    Rule("mirror", "half of the tube and of its coordinates", mirrored_half),
    Rule("twist", "the coordinates of twist", twist),
    Rule("stretch", "the coordinate of length and its stiff springs", stretch),
    Rule("dynamics", "all steps in time", dynamics),
    Rule("sleep", "steps of a robot at rest", resting),
    Rule("pneumatics", "gas balance, valves and the actuator law", pneumatics),
    Rule("sensors", "sensor noise, bus and board", sensors),
    Rule("logs", "telemetry rows and shapes", logs),
    Rule("bodies", "a second engine and its contacts", bodies),
)
"""In the order in which `softbot run --explain` shows them."""


@dataclass(frozen=True)
class Plan:
    """How a scene is solved: which twin, how fine, and without what."""

    scene: Scene
    resolution: Resolution | None
    """Of the rod; None for the segment twin."""
    step_s: float
    segments: int | None
    decisions: tuple[Decision, ...]

    def leaves_out(self, name: str) -> bool:
        """Whether the rule of this name holds."""
        return next(decision.left_out for decision in self.decisions if decision.name == name)

    def choices(self) -> tuple[tuple[str, str, Choice, str], ...]:
        """What was chosen of the rod's fineness: name, value with unit, choice, and what decided it."""
        chosen = self.resolution
        if chosen is None:
            return ()
        demand = chosen.demand
        load = (
            f"weight λgL³/EI = {demand.weight:.2g}, friction {demand.friction:.2g} of it"
            if demand.weight
            else "no load"
        )
        moves = f"the bend turns at {demand.turn_rate_rad_s:.3g} rad/s"
        if demand.lag_s + demand.valves_s > 0.0:
            moves += f" and follows with a lag of {demand.lag_s + demand.valves_s:.2g} s"
        rests = self.leaves_out("dynamics")
        rubs = "friction" if demand.friction > 0.0 else "inertia"
        return (
            ("modes", f"{chosen.modes}", chosen.modes_choice, f"a bend of {demand.bend_rad:.2g} rad under {load}"),
            (
                "points",
                f"{chosen.contact_points}",
                chosen.points_choice,
                f"sum of {rubs} along the arc against its integral",
            ),
            (
                "step",
                f"{1e3 * chosen.step_s:.4g} ms",
                chosen.step_choice,
                "pseudo-time towards one rest" if rests else moves,
            ),
        )

    def table(self) -> dict[str, Any]:
        """The plan as plain data, for `softbot run --explain --json`."""
        chosen = self.resolution
        fineness: dict[str, Any] = {"step_s": self.step_s, "segments": self.segments}
        if chosen is not None:
            fineness = {
                "target": chosen.target,
                "estimated_error": chosen.error,
                "modes": _choice(chosen.modes_choice),
                "contact_points": _choice(chosen.points_choice),
                "step_s": _choice(chosen.step_choice),
                "tolerance": self.scene.solver.tolerance,
            }
        return {
            "scene": self.scene.name,
            "twin": self.scene.solver.twin,
            "accuracy": self.scene.solver.accuracy,
            "resolution": fineness,
            "rules": [decision._asdict() for decision in self.decisions],
        }


def make_plan(scene: Scene, *, keep: Collection[str] = ()) -> Plan:
    """The plan of a scene. `keep`: names of rules that are not to be applied.

    Raises InputError for a step that the drive is too fast for, or a name that is no rule.
    """
    unknown = set(keep) - {rule.name for rule in RULES}
    if unknown:
        raise InputError(f"no leave-out rule is called {', '.join(sorted(unknown))}")
    if scene.solver.question == "equilibrium":
        _check_rest(scene)
    scene = with_kerb(scene)
    if scene.solver.twin == "bullet":
        step_s, segments = BULLET[scene.solver.accuracy]
        step_s = scene.solver.step_s or step_s
        check_turn(scene, step_s, BULLET_STEPS_PER_TURN)
        return Plan(scene, None, step_s, scene.solver.segments or segments, ())
    resolution = resolve(scene)
    return Plan(scene, resolution, resolution.step_s, None, tuple(_decide(scene, resolution, keep)))


def _check_rest(scene: Scene) -> None:
    for wrong, words in (
        (scene.solver.twin == "bullet", 'solver.twin = "bullet": only the rod finds a rest; take "rod"'),
        (bool(scene.body), "[[body]]: the rest is that of the robot alone; leave other bodies out"),
        (scene.drive.kind == "sequencer", 'drive.kind = "sequencer": rolls and does not rest; take another drive'),
    ):
        if wrong:
            raise InputError(f'solver.question = "equilibrium" with {words}')


def _decide(scene: Scene, resolution: Resolution, keep: Collection[str]) -> list[Decision]:
    decisions = []
    for rule in RULES:
        verdict = rule.judge(scene, resolution)
        if rule.name in keep and verdict.left_out:
            verdict = Verdict(False, "kept by request")
        decisions.append(Decision(rule.name, rule.saves, *verdict))
    return decisions


def _choice(choice: Choice) -> dict[str, Any]:
    return {"value": choice.value, "estimated_error": choice.error, "given": choice.given}


def _percent(share: float) -> str:
    return f"{max(100.0 * share, 0.0):.2g} %"
