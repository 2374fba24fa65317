"""MuJoCo as a peer: a chain of links on hinges, driven by the rest angles of its joint springs.

n equal links; between neighbours two hinges (bending about e1 and e2; twist is left out, with it nothing gets nearer)
with stiffness EI·n/L and damping in proportion, as Kelvin–Voigt asks. On a floor each link touches with one sphere at
its middle, the mid-point rule for the load along the tube.

Chosen for MuJoCo's best, by trying (slow rolling, MuJoCo 4.0):
- integrator "discrete": the only one that takes springs implicitly; "implicitfast" costs the same and strays further on
  a floor (with ball joints by 15 %). In free vibration, where steps are small, "implicitfast" and RK4 are nearer.
- hinges rather than ball joints: up to twice as fast, and nearer.
- spheres rather than capsules: a capsule touches with two points, which costs more and was 1.1 % off.
- solref 4 ms, impratio 10, as MuJoCo's own modelling guide recommends. Its contacts push sliding bodies up a little
  (its friction is a convex model), the more, the softer they are: with solref 20 ms, the default, the robot gets 9 %
  too far. Stiffer than 3 ms, impratio 100, noslip, more or fewer iterations bring nothing.
- the Newton solver on a sparse Jacobian (up to twice as fast as on a dense one): PGS and CG bring nothing.
- hinges rather than MuJoCo's own one-dimensional flex: that has no way to drive its rest curvature (overwriting it in
  the compiled model was unstable), and a step at equal elements took twice as long.
- elliptic cone; the pyramidal one is twice as fast and further off where sliding decides, and is measured beside it.

Its floor is stiffer than that of the twins, which gives 1 % of the radius: the soft rod of the rolling case presses on
it a little differently, which is worth 1 % of the advance. A softer one would be further off, for the reason above.

The wall time is that of `mj_step` alone: writing the joints' rest angles and reading the motion stand outside the
clock.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from typing import Any

import numpy as np

from sim.benchmark.case import Case, RunScene
from sim.benchmark.links import motion_of_links
from sim.benchmark.play import Measured, Unable, play
from sim.body import Motion

_CONTACT = 'friction="{friction} 0 0" solref="0.004 1" solimp="0.9 0.95 0.001" condim="3"'


@dataclass(frozen=True)
class ChainSetting:
    """How finely, and how, MuJoCo solves a case."""

    links: int
    step_s: float
    cone: str = "elliptic"
    joints: str = "hinges"
    integrator: str = "discrete"

    @property
    def label(self) -> str:
        """For a table."""
        extras = [] if self.joints == "hinges" else [f"{self.joints} joints"]
        extras += [] if self.cone == "elliptic" else [f"{self.cone} cone"]
        extras += [] if self.integrator == "discrete" else [self.integrator]
        return ", ".join([f"{self.links} links", f"{self.step_s * 1e3:g} ms", *extras])


_ROLLING = (
    ChainSetting(10, 0.005),
    ChainSetting(6, 0.005),
    ChainSetting(8, 0.005),
    ChainSetting(8, 0.01),
    ChainSetting(10, 0.002),
    ChainSetting(20, 0.002),
    ChainSetting(10, 0.005, cone="pyramidal"),
)
_SETTINGS: dict[str, tuple[ChainSetting, ...]] = {
    "advance": _ROLLING,
    "turning": (
        ChainSetting(10, 0.01),
        ChainSetting(20, 0.01),
        ChainSetting(20, 0.002, integrator="implicitfast"),
        ChainSetting(40, 0.005),
    ),
    "tip": (ChainSetting(10, 0.01), ChainSetting(20, 0.01), ChainSetting(40, 0.01), ChainSetting(80, 0.01)),
    "frequency": (
        ChainSetting(10, 0.001, integrator="implicitfast"),
        ChainSetting(10, 0.005),
        ChainSetting(10, 0.0025),
        ChainSetting(10, 0.001, integrator="RK4"),
        ChainSetting(20, 0.00025, integrator="RK4"),
    ),
}


class MujocoChain:
    """The engine. Implements `sim.benchmark.engine.Engine`."""

    name = "mujoco"

    def version(self) -> str:
        """Name and version. Raises Unable when it cannot be imported."""
        _import()
        return f"mujoco {version('mujoco')}"

    def settings(self, case: Case) -> Sequence[ChainSetting]:
        """Settings for a case. Raises Unable for a case that it cannot do."""
        if case.quantity == "revolutions":
            raise Unable("no pneumatics, no sequencer")
        return _SETTINGS[case.quantity]

    def warm_up(self, case: Case, setting: ChainSetting, run: RunScene) -> None:
        """A short run, not counted."""
        play(case, _Chain(case, setting), duration_s=2.0 * case.sample_s)

    def measure(self, case: Case, setting: ChainSetting, run: RunScene) -> Measured:
        """One run."""
        return play(case, _Chain(case, setting))


def _import() -> Any:
    try:
        return import_module("mujoco")
    except ImportError as error:
        raise Unable(f"not installed ({error}): pip install 'softbot[bench]'") from None


class _Chain:
    """The rod of a case in MuJoCo. Implements `sim.benchmark.play.Player`."""

    def __init__(self, case: Case, setting: ChainSetting) -> None:
        self._mujoco = _import()
        self._case, self._setting = case, setting
        self._model = self._mujoco.MjModel.from_xml_string(model_xml(case, setting))
        self._data = self._mujoco.MjData(self._model)
        first = 0 if case.clamped else 7  # of the free joint
        self._rest = self._model.qpos_spring[first:]
        count = len(self._rest) // (2 if setting.joints == "hinges" else 4)
        self._reach_m = np.full(count, case.body.length_m / setting.links)
        if case.clamped:
            self._reach_m[0] *= 0.5
        self._steps = 0

    def run(self, until_s: float) -> float:
        """Step to this time; the wall time of mj_step alone."""
        model, data, step_s = self._model, self._data, self._setting.step_s
        mj_step, clock, wall_s = self._mujoco.mj_step, time.perf_counter, 0.0
        for _ in range(round(until_s / step_s) - self._steps):
            self._steps += 1
            self._bend(*self._case.rest(self._steps * step_s))
            began_s = clock()
            mj_step(model, data)
            wall_s += clock() - began_s
        bad = self._mujoco.mjtWarning
        if any(data.warning[kind].number for kind in (bad.mjWARN_BADQPOS, bad.mjWARN_BADQVEL, bad.mjWARN_BADQACC)):
            raise ArithmeticError("unstable")  # MuJoCo starts anew, straight, and goes on
        return wall_s

    def _bend(self, k1_1_m: float, k2_1_m: float) -> None:
        # k towards the centre of curvature turns the tangent: rotation per length = t × k = (−k2, k1)
        if self._setting.joints == "hinges":
            self._rest[0::2], self._rest[1::2] = -k2_1_m * self._reach_m, k1_1_m * self._reach_m
            return
        size = math.hypot(k1_1_m, k2_1_m)
        half = 0.5 * size * self._reach_m
        sine = np.sin(half) / size if size > 0.0 else np.zeros_like(half)
        self._rest[0::4], self._rest[1::4], self._rest[2::4] = np.cos(half), -k2_1_m * sine, k1_1_m * sine

    def motion(self) -> Motion:
        """The rod now."""
        self._mujoco.mj_kinematics(self._model, self._data)
        rotation = self._data.xmat[1:].reshape(-1, 3, 3).copy()
        return motion_of_links(rotation, self._data.xpos[1:].copy(), self._case.body.length_m)

    def tip_m(self) -> tuple[float, float]:
        """Drop and reach of the end s = L from the clamp."""
        self._mujoco.mj_kinematics(self._model, self._data)
        half = 0.5 * self._case.body.length_m / self._setting.links
        tip = self._data.xpos[-1] + half * self._data.xmat[-1].reshape(3, 3)[:, 2]
        clamp = np.array([-0.5 * self._case.body.length_m, 0.0, 0.0])
        away = tip - clamp
        return float(-away[2]), float(math.hypot(away[0], away[1]))

    def close(self) -> None:
        """Nothing to release."""


def model_xml(case: Case, setting: ChainSetting) -> str:
    """The MuJoCo model of a case: tangent along x, e1 along y, lying on the floor where there is one."""
    body, world, links = case.body, case.world, setting.links
    link_m, link_kg = body.length_m / links, body.mass_kg / links
    axial = 0.5 * link_kg * body.radius_m**2
    across = link_kg * (0.25 * body.radius_m**2 + link_m**2 / 12.0)
    grounded = world.ground != "none"
    contact = _CONTACT.format(friction=world.friction)

    def joints(stiffness: float) -> str:
        if setting.joints == "ball":
            return (
                f'<joint type="ball" pos="0 0 {-0.5 * link_m}" stiffness="{stiffness}" '
                f'damping="{stiffness * body.damping_time_s}"/>'
            )
        return "".join(
            f'<joint type="hinge" axis="{axis}" pos="0 0 {-0.5 * link_m}" stiffness="{stiffness}" '
            f'damping="{stiffness * body.damping_time_s}"/>'
            for axis in ("1 0 0", "0 1 0")
        )

    parts = [
        '<mujoco><compiler angle="radian"/>'
        f'<option timestep="{setting.step_s}" integrator="{setting.integrator}" cone="{setting.cone}" impratio="10" '
        f'jacobian="sparse" gravity="0 0 {-world.gravity_m_s2}"/><worldbody>'
    ]
    if grounded:
        parts.append(f'<geom type="plane" size="5 5 1" contype="0" conaffinity="1" {contact}/>')
    for link in range(links):
        if link == 0:
            place = f"{0.5 * (link_m - body.length_m)} 0 {body.radius_m if grounded else 0.0}"
            parts.append(f'<body pos="{place}" quat="0.5 0.5 0.5 0.5">')
            # a clamp holds the face of the first link: half a link bends between it and the middle of that link
            parts.append(joints(2.0 * body.bending_stiffness_N_m2 / link_m) if case.clamped else "<freejoint/>")
        else:
            parts.append(f'<body pos="0 0 {link_m}">' + joints(body.bending_stiffness_N_m2 / link_m))
        parts.append(f'<inertial pos="0 0 0" mass="{link_kg}" diaginertia="{across} {across} {axial}"/>')
        if grounded:
            parts.append(f'<geom type="sphere" size="{body.radius_m}" mass="0" contype="1" conaffinity="0" {contact}/>')
    return "".join(parts) + "</body>" * links + "</worldbody></mujoco>"
