"""PyElastica as a peer: a Cosserat rod of n elements, driven by its rest curvature, stepped explicitly.

The rod is the physical one, with E = EI/(πR⁴/4) and Poisson ratio ½, and with PyElastica's own laws of contact,
friction and damping. What differs from the other engines:
- It shears and stretches as the material does (the ruler's rod does neither). `shear` multiplies both stiffnesses:
  nearer to the ruler, at smaller steps.
- Kelvin–Voigt damping does not exist in it, and taken explicitly would ask for steps of 2 µs. Its uniform damping
  against the surrounding takes the place, as little as keeps the rod quiet; linear and angular momentum decay at the
  same rate, so a floating rod keeps none. In free vibration its Laplace filter damps the high modes instead (elsewhere
  the filter would not do: it turns a floating rod).

Chosen for PyElastica's best, by trying (PyElastica 1.0): the position Verlet stepper; the largest steps that stayed
stable; floor springs that give 1 % of the radius, as in the twins (0.1 % and 3 % change the advance by 0.6 points);
the speed below which its friction holds at a hundredth of the rolling speed (a thousandth: the same; a tenth: 7 points
off).

The wall time is that of the stepper's `step` alone, the compiling of its kernels left out.
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

_SINK = 0.01
"""Of the floor's springs under the rod's weight, over its radius: as in the twins."""
_HOLDING_SPEED = 0.01
"""Below this part of the rolling speed its friction holds."""


@dataclass(frozen=True)
class ElementSetting:
    """How finely PyElastica solves a case."""

    elements: int
    step_s: float
    shear: float = 1.0
    damping_1_s: float = 0.0
    """Uniform damping against the surrounding."""
    filter_order: int = 0
    """Of the Laplace filter; 0: none."""

    @property
    def label(self) -> str:
        """For a table."""
        stiffer = f", shear × {self.shear:g}" if self.shear != 1.0 else ""
        return f"{self.elements} elements, {self.step_s * 1e3:g} ms{stiffer}"


_SETTINGS: dict[str, tuple[ElementSetting, ...]] = {
    "advance": (
        ElementSetting(20, 2e-4, damping_1_s=1.0),
        ElementSetting(10, 4e-4, damping_1_s=1.0),
        ElementSetting(40, 1e-4, damping_1_s=1.0),
    ),
    "turning": (
        ElementSetting(20, 2.5e-4, damping_1_s=5.0),
        ElementSetting(10, 4e-4, damping_1_s=5.0),
        ElementSetting(40, 1e-4, damping_1_s=5.0),
    ),
    "tip": (
        ElementSetting(20, 2.5e-4, damping_1_s=20.0),
        ElementSetting(10, 4e-4, damping_1_s=20.0),
        ElementSetting(20, 1e-4, shear=10.0, damping_1_s=20.0),
    ),
    "frequency": (
        ElementSetting(20, 2.5e-4, filter_order=7),
        ElementSetting(20, 1e-4, shear=10.0, filter_order=7),
        ElementSetting(40, 2.5e-5, shear=10.0, filter_order=7),
    ),
}
_LIMIT_SETTINGS = (ElementSetting(10, 5e-5, damping_1_s=0.2), ElementSetting(20, 2e-5, damping_1_s=0.2))
"""Of the stiff, light rod, in which waves run ten times as fast."""


class ElasticaRod:
    """The engine. Implements `sim.benchmark.engine.Engine`."""

    name = "pyelastica"

    def version(self) -> str:
        """Name and version. Raises Unable when it cannot be imported."""
        _import()
        return f"pyelastica {version('pyelastica')}"

    def settings(self, case: Case) -> Sequence[ElementSetting]:
        """Settings for a case. Raises Unable for a case that it cannot do."""
        if case.quantity == "revolutions":
            raise Unable("no pneumatics, no sequencer")
        return _LIMIT_SETTINGS if case.name == "rolling-limit" else _SETTINGS[case.quantity]

    def warm_up(self, case: Case, setting: ElementSetting, run: RunScene) -> None:
        """A short run, not counted: compiles its kernels."""
        play(case, _Elements(case, setting), duration_s=case.sample_s)

    def measure(self, case: Case, setting: ElementSetting, run: RunScene) -> Measured:
        """One run."""
        return play(case, _Elements(case, setting))


def _import() -> Any:
    try:
        return import_module("elastica")
    except ImportError as error:
        raise Unable(f"not installed ({error}): pip install 'softbot[bench]'") from None


class _Elements:
    """The rod of a case in PyElastica. Implements `sim.benchmark.play.Player`."""

    def __init__(self, case: Case, setting: ElementSetting) -> None:
        ea = _import()
        body, world = case.body, case.world
        self._case, self._setting, self._steps, self._t_s = case, setting, 0, 0.0

        class Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Contact, ea.Damping):  # type: ignore[name-defined]
            """What the case needs of PyElastica."""

        simulator = Simulator()
        grounded = world.ground != "none"
        # what holds an end holds the whole first element: the clamp is its middle, and half an element comes before it
        self._before_m = body.length_m / (2 * setting.elements - 1) if case.clamped else 0.0
        self._rod = ea.CosseratRod.straight_rod(
            setting.elements,
            np.array([-0.5 * body.length_m - self._before_m, 0.0, body.radius_m if grounded else 0.0]),
            np.array([1.0, 0.0, 0.0]),
            np.array([0.0, 1.0, 0.0]),
            base_length=body.length_m + self._before_m,
            base_radius=body.radius_m,
            density=body.mass_kg / (math.pi * body.radius_m**2 * body.length_m),
            youngs_modulus=4.0 * body.bending_stiffness_N_m2 / (math.pi * body.radius_m**4),
            shear_modulus=4.0 * body.bending_stiffness_N_m2 / (math.pi * body.radius_m**4) / 3.0,
        )
        self._rod.shear_matrix *= setting.shear
        simulator.append(self._rod)
        if case.clamped:
            simulator.constrain(self._rod).using(
                ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
            )
        if world.gravity_m_s2 > 0.0:
            simulator.add_forcing_to(self._rod).using(
                ea.GravityForces, acc_gravity=np.array([0.0, 0.0, -world.gravity_m_s2])
            )
        if grounded:
            self._lay_on_floor(ea, simulator)
        if setting.damping_1_s > 0.0:
            simulator.dampen(self._rod).using(
                ea.AnalyticalLinearDamper, uniform_damping_constant=setting.damping_1_s, time_step=setting.step_s
            )
        if setting.filter_order > 0:
            simulator.dampen(self._rod).using(ea.LaplaceDissipationFilter, filter_order=setting.filter_order)
        simulator.finalize()
        self._simulator, self._stepper = simulator, ea.PositionVerlet()

    def _lay_on_floor(self, ea: Any, simulator: Any) -> None:
        body, world = self._case.body, self._case.world
        floor = ea.Plane(plane_origin=np.zeros(3), plane_normal=np.array([0.0, 0.0, 1.0]))
        simulator.append(floor)
        element_kg = body.mass_kg / self._setting.elements
        stiffness_N_m = element_kg * world.gravity_m_s2 / (_SINK * body.radius_m)
        friction = np.full(3, world.friction)
        simulator.detect_contact_between(self._rod, floor).using(
            ea.RodPlaneContactWithAnisotropicFriction,
            k=stiffness_N_m,
            nu=2.0 * math.sqrt(stiffness_N_m * element_kg),
            slip_velocity_tol=_HOLDING_SPEED * self._rolling_speed_m_s(),
            static_mu_array=friction,
            kinetic_mu_array=friction,
        )

    def _rolling_speed_m_s(self) -> float:
        first, then = (self._case.rest(self._case.measured_from_s + dt_s) for dt_s in (0.0, 1e-3))
        turned = math.atan2(first[0] * then[1] - first[1] * then[0], float(first @ then))
        return max(abs(turned) / 1e-3 * self._case.body.radius_m, 1e-4)

    def run(self, until_s: float) -> float:
        """Step to this time; the wall time of the stepper alone."""
        step_s, step, simulator = self._setting.step_s, self._stepper.step, self._simulator
        rest_curvature, rest, clock, wall_s = self._rod.rest_kappa, self._case.rest, time.perf_counter, 0.0
        for _ in range(round(until_s / step_s) - self._steps):
            self._steps += 1
            k1, k2 = rest(self._steps * step_s)
            # k towards the centre of curvature turns the tangent: rotation per length = t × k = (−k2, k1)
            rest_curvature[0], rest_curvature[1] = -k2, k1
            began_s = clock()
            self._t_s = step(simulator, self._t_s, step_s)
            wall_s += clock() - began_s
        if not np.isfinite(self._rod.position_collection).all():
            raise ArithmeticError("unstable")
        return wall_s

    def motion(self) -> Motion:
        """The rod now."""
        position = self._rod.position_collection
        rotation = np.ascontiguousarray(np.moveaxis(self._rod.director_collection, 2, 0).transpose(0, 2, 1))
        return motion_of_links(rotation, 0.5 * (position[:, 1:] + position[:, :-1]).T, self._case.body.length_m)

    def tip_m(self) -> tuple[float, float]:
        """Drop and reach of the end s = L from the clamp."""
        away = self._rod.position_collection[:, -1] - self._rod.position_collection[:, 0]
        return float(-away[2]), float(math.hypot(away[0], away[1])) - self._before_m

    def close(self) -> None:
        """Nothing to release."""
