"""Cases of the benchmark: what happens and what is measured, and nothing of how it is solved.

One physical rod in all of them (length 0.15 m, radius 0.01 m, density 1100 kg/m³, EI = 3.93e-3 N m², Kelvin–Voigt
damping of 0.02 s), but where a case says otherwise. A case knows its ruler: the value that theory, or a refined
computation where there is no theory, gives.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sim.body import Body, World
from sim.drive import curvature_1_m
from sim.scene import Scene, scene_from
from softbot.elastica import free_frequencies_rad_s, heavy_cantilever
from softbot.rolling import coulomb_advance_ratio, floating_ratio

FloatArray = NDArray[np.float64]
RunScene = Callable[[Scene], dict[str, Any]]
"""A scene in, the summary of its run out: `softbot.nodes.run.run_scene` runs all of them, `sim.run.simulate` most."""
Quantity = Literal["turning", "advance", "tip", "frequency", "revolutions"]

LENGTH_M, RADIUS_M, DENSITY_KG_M3 = 0.15, 0.01, 1100.0
BENDING_STIFFNESS_N_M2, DAMPING_TIME_S, FRICTION = 3.93e-3, 0.02, 0.6
MASS_KG = DENSITY_KG_M3 * math.pi * RADIUS_M**2 * LENGTH_M
GRAVITY_M_S2 = 9.81

ROBOT: dict[str, Any] = {
    "length_m": LENGTH_M,
    "radius_m": RADIUS_M,
    "mass_kg": MASS_KG,
    "bending_stiffness_N_m2": BENDING_STIFFNESS_N_M2,
    "damping_time_s": DAMPING_TIME_S,
}


@dataclass(frozen=True)
class Ruler:
    """The value that a case is measured against, and where it comes from."""

    value: tuple[float, ...]
    source: str


@dataclass(frozen=True)
class Case:
    """One case. What drives the rod is `rest`: its intrinsic curvature vector (2,) [1/m], body frame, over time."""

    name: str
    title: str
    quantity: Quantity
    body: Body
    world: World
    rest: Callable[[float], FloatArray]
    duration_s: float
    measured_from_s: float
    ruler: Callable[[RunScene], Ruler]
    """Computed when it is asked for; where that takes runs, as the given function runs scenes."""
    sample_s: float = 0.01
    clamped: bool = False
    """The end s = 0 is held, horizontal; the rod starts straight."""
    scene_table: dict[str, Any] | None = field(default=None, repr=False)
    """The same as a scene file has it, where a scene file can say it; without `[solver]`."""

    def scene(self, solver: dict[str, Any]) -> Scene:
        """The case as a scene with this `[solver]`. Raises ValueError where no scene file can say it."""
        if self.scene_table is None:
            raise ValueError(f"{self.name} is no scene")
        return _scene(self.name, self.scene_table, {"duration_s": self.duration_s, **solver}, self.measured_from_s)

    def error_percent(self, value: Sequence[float], ruler: Sequence[float]) -> float:
        """Signed error [%] of a value; of a point (reach, drop over length) its distance, in % of the length."""
        if self.quantity == "tip":
            return 100.0 * math.dist(value, ruler)
        return 100.0 * (value[0] / ruler[0] - 1.0)


def _scene(name: str, table: dict[str, Any], solver: dict[str, Any], measured_from_s: float) -> Scene:
    tables = {**table, "solver": solver, "metrics": {"steady_after_s": measured_from_s}, "name": name}
    return scene_from(tables, name, Path())


def cases() -> tuple[Case, ...]:
    """All cases, in the order in which they are reported."""
    return (floating(), rolling(), rolling_limit(), cantilever(), vibration(), fault_and_recovery())


def _driven(
    name: str,
    title: str,
    quantity: Quantity,
    table: dict[str, Any],
    duration_s: float,
    measured_from_s: float,
    ruler: Callable[[RunScene], Ruler],
) -> Case:
    scene = _scene(name, table, {"duration_s": duration_s}, measured_from_s)
    return Case(
        name=name,
        title=title,
        quantity=quantity,
        body=Body.of(scene.robot),
        world=World(**scene.world.model_dump()),
        rest=lambda t_s: curvature_1_m(scene.drive, t_s),
        duration_s=duration_s,
        measured_from_s=measured_from_s,
        ruler=ruler,
        scene_table=table,
    )


def floating() -> Case:
    """(a) The robot floats and turns without torque: Ω/α̇ at κ = 12 /m, so slowly that damping bends it no less."""
    drive = {"kind": "curvature", "curvature_1_m": 12.0, "period_s": 20.0, "start_s": 1.0}
    return _driven(
        "floating",
        "Floating ratio, 20 s a cycle",
        "turning",
        {"robot": ROBOT, "drive": drive, "world": {"ground": "none", "gravity_m_s2": 0.0}},
        duration_s=8.0,
        measured_from_s=3.0,
        ruler=lambda _run: Ruler((floating_ratio(LENGTH_M, RADIUS_M, 12.0),), "softbot.rolling.floating_ratio"),
    )


def rolling() -> Case:
    """(b) Slow rolling on a plane: κ = 12 /m, 2 s a cycle; two cycles after two to settle.

    The ruler is the rod itself, refined (`sim.benchmark.converged`): inertia, weight and damping matter here, and no
    formula has them.
    """
    from sim.benchmark.converged import converged_advance

    drive = {"kind": "curvature", "curvature_1_m": 12.0, "period_s": 2.0, "start_s": 1.0}
    table = {"robot": ROBOT, "drive": drive, "world": {"friction": FRICTION}}
    return _driven(
        "rolling",
        "Advance ratio, 2 s a cycle",
        "advance",
        table,
        duration_s=9.0,
        measured_from_s=5.0,
        ruler=lambda run: converged_advance(rolling(), run),
    )


def rolling_limit() -> Case:
    """(b) again in the limit that the quadrature holds for: stiff (10 × EI), light (a tenth), slow (8 s a cycle).

    The weight bends this tube a hundred times less, so every section carries its own weight, whatever the floor is
    made of. Half a cycle is measured.
    """
    robot = {**ROBOT, "mass_kg": 0.1 * MASS_KG, "bending_stiffness_N_m2": 10.0 * BENDING_STIFFNESS_N_M2}
    drive = {"kind": "curvature", "curvature_1_m": 12.0, "period_s": 8.0, "start_s": 1.0}
    return _driven(
        "rolling-limit",
        "Advance ratio, stiff, light, slow",
        "advance",
        {"robot": robot, "drive": drive, "world": {"friction": FRICTION}},
        duration_s=7.0,
        measured_from_s=3.0,
        ruler=lambda _run: Ruler(
            (coulomb_advance_ratio(0.5 * 12.0 * LENGTH_M),), "quadrature, softbot.rolling.coulomb_advance_ratio"
        ),
    )


def _free_body(damping_time_s: float = DAMPING_TIME_S) -> Body:
    scene = _scene("body", {"robot": ROBOT, "drive": {"kind": "curvature", "curvature_1_m": 0.0}}, {}, 0.0)
    return replace(Body.of(scene.robot), damping_time_s=damping_time_s)


def cantilever() -> Case:
    """(c) A cantilever bends under its own weight until it rests: the tip against the elastica, over the length."""

    def elastica(_run: RunScene) -> Ruler:
        tip = heavy_cantilever(LENGTH_M, BENDING_STIFFNESS_N_M2, MASS_KG / LENGTH_M * GRAVITY_M_S2)
        return Ruler((tip.drop_m / LENGTH_M, tip.reach_m / LENGTH_M), "elastica, softbot.elastica.heavy_cantilever")

    return Case(
        name="cantilever",
        title="Tip of a cantilever under its weight",
        quantity="tip",
        body=_free_body(),
        world=World(GRAVITY_M_S2, "none", FRICTION, "coulomb"),
        rest=lambda _t_s: np.zeros(2),
        duration_s=6.0,
        measured_from_s=6.0,
        ruler=elastica,
        sample_s=0.1,
        clamped=True,
    )


VIBRATION_CURVATURE_1_M, VIBRATION_RISE_S = 0.1, 0.04
VIBRATION_DAMPING_TIME_S = 5e-4


def vibration() -> Case:
    """(d) Free vibration of the floating rod after its rest curvature has changed a little: the first frequency.

    It rises as half a cosine within 40 ms, quick for the first mode and slow for the high ones. Damped by 0.5 ms, so
    that the first mode rings alone after 0.1 s (its damping ratio is 2.6 %); what is read is the undamped frequency.
    """

    def theory(_run: RunScene) -> Ruler:
        line_kg_m = MASS_KG / LENGTH_M
        first = free_frequencies_rad_s(
            LENGTH_M, BENDING_STIFFNESS_N_M2, line_kg_m, line_kg_m * RADIUS_M**2 / 4.0, count=1
        )[0]
        return Ruler((first / (2.0 * math.pi),), "Rayleigh's rod, softbot.elastica.free_frequencies_rad_s")

    def rest(t_s: float) -> FloatArray:
        share = min(t_s / VIBRATION_RISE_S, 1.0)
        return np.array([0.5 * VIBRATION_CURVATURE_1_M * (1.0 - math.cos(math.pi * share)), 0.0])

    return Case(
        name="vibration",
        title="First free frequency [Hz]",
        quantity="frequency",
        body=_free_body(VIBRATION_DAMPING_TIME_S),
        world=World(0.0, "none", FRICTION, "coulomb"),
        rest=rest,
        duration_s=0.7,
        measured_from_s=0.1,
        ruler=theory,
        sample_s=0.005,
    )


FAULT_SCENE: dict[str, Any] = {
    "robot": "default",
    "drive": {"kind": "sequencer"},
    "sequencer": {"command": "left", "speed_rev_s": 0.5, "recovery": True},
    "fault": [{"t_s": 6.0, "chamber": 1, "kind": "rupture"}],
}
"""As in scenes/damaged.toml."""


def fault_and_recovery() -> Case:
    """(e) The calibrated robot under its sequencer loses a chamber, reverses its curvature and rolls on.

    Measured: the revolutions from the start of the order to the end, against the same run at the finest setting.
    """
    from sim.benchmark.converged import converged_experiment

    case = _driven(
        "fault",
        "Fault and recovery, revolutions",
        "revolutions",
        FAULT_SCENE,
        duration_s=16.0,
        measured_from_s=0.5,
        ruler=lambda run: converged_experiment(fault_and_recovery(), run),
    )
    return replace(case, rest=lambda _t_s: np.zeros(2))
