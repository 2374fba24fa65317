"""Run time against error of the twins, on the rulers that have closed forms.

Three cases on one rod (L = 0.15 m, R = 0.01 m, density 1100 kg/m³): the floating ratio Ω/α̇ at κ = 12 and 8 /m, and the
advance ratio at φ0 = 0.9 on a Coulomb floor, slow and stiff, where the quadrature of `softbot.rolling` holds. The real
time factor is that of the solver loop alone, after a warm-up run; one core; the median of `repeats`.
"""

from __future__ import annotations

import contextlib
import math
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sim.body import Body, World
from sim.drive import curvature_1_m
from sim.run import simulate
from sim.scene import Drive, Scene, scene_from
from sim.trajectory import Trajectory
from softbot.rolling import coulomb_advance_ratio, floating_ratio

LENGTH_M, RADIUS_M, DENSITY_KG_M3 = 0.15, 0.01, 1100.0
BENDING_STIFFNESS_N_M2 = 3.93e-3


@dataclass(frozen=True)
class Case:
    """One ruler: a scene without its solver, what is read from the summary, and what theory says."""

    name: str
    scene: dict[str, Any]
    measured: Callable[[dict[str, Any]], float]
    expected: float


@dataclass(frozen=True)
class Setting:
    """One setting of a twin."""

    twin: str
    step_s: float
    segments: int | None = None
    modes: int | None = None

    @property
    def label(self) -> str:
        """For a table."""
        size = f"{self.segments} links" if self.segments else f"{self.modes} modes"
        return f"{self.twin}, {size}, {self.step_s * 1e3:g} ms"


@dataclass(frozen=True)
class Result:
    """What one setting gave on one case."""

    case: str
    setting: str
    value: float
    expected: float
    error_percent: float
    real_time_factor: float


BULLET_SETTINGS = (
    Setting("bullet", 0.005, segments=10),
    Setting("bullet", 0.0025, segments=10),
    Setting("bullet", 0.001, segments=10),
    Setting("bullet", 0.0025, segments=20),
    Setting("bullet", 0.001, segments=20),
)
ROD_SETTINGS = (
    Setting("rod", 0.005, modes=2),
    Setting("rod", 0.0025, modes=3),
    Setting("rod", 0.001, modes=4),
)


def cases() -> tuple[Case, ...]:
    """The rulers."""
    robot = {
        "length_m": LENGTH_M,
        "radius_m": RADIUS_M,
        "mass_kg": DENSITY_KG_M3 * math.pi * RADIUS_M**2 * LENGTH_M,
        "bending_stiffness_N_m2": BENDING_STIFFNESS_N_M2,
        "damping_time_s": 0.02,
    }
    stiff = {**robot, "bending_stiffness_N_m2": 10.0 * BENDING_STIFFNESS_N_M2}

    def drive(curvature_1_m: float, period_s: float) -> dict[str, Any]:
        return {"kind": "curvature", "curvature_1_m": curvature_1_m, "period_s": period_s, "start_s": 1.0}

    def turns_per_radian(summary: dict[str, Any]) -> float:
        return float(summary["plane_rotation_rad"]) / (2.0 * math.pi * summary["steady_span_s"] / 4.0)

    def advance(summary: dict[str, Any]) -> float:
        return float(summary["advance_per_revolution_m"]) / (2.0 * math.pi * RADIUS_M)

    floating = [
        Case(
            f"floating, {curvature:g} /m",
            {"robot": robot, "drive": drive(curvature, 4.0), "world": {"ground": "none"}},
            turns_per_radian,
            floating_ratio(LENGTH_M, RADIUS_M, curvature),
        )
        for curvature in (12.0, 8.0)
    ]
    rolling = Case(
        "advance, 0.9 rad",
        {"robot": stiff, "drive": drive(12.0, 4.0), "world": {"friction": 0.6}},
        advance,
        coulomb_advance_ratio(0.9),
    )
    return (*floating, rolling)


def scene_of(case: Case, setting: Setting) -> Scene:
    """The case's scene with the setting's solver: one whole cycle is measured, after one to settle."""
    solver: dict[str, Any] = {"twin": setting.twin, "step_s": setting.step_s, "duration_s": 9.0}
    if setting.segments is not None:
        solver["segments"] = setting.segments
    if setting.modes is not None:
        solver["modes"] = setting.modes
    tables = {**case.scene, "solver": solver, "metrics": {"steady_after_s": 5.0}, "name": case.name}
    return scene_from(tables, case.name, Path())


def run_benchmark(settings: tuple[Setting, ...], repeats: int = 3) -> Iterator[Result]:
    """Each setting on each case, the compiled kernels warmed up first."""
    warm: set[str] = set()
    for case in cases():
        for setting in settings:
            scene = scene_of(case, setting)
            if setting.twin not in warm:
                simulate(scene)
                warm.add(setting.twin)
            summaries = [simulate(scene).summary for _ in range(repeats)]
            value = case.measured(summaries[0])
            yield Result(
                case.name,
                setting.label,
                value,
                case.expected,
                100.0 * (value / case.expected - 1.0),
                statistics.median(summary["real_time_factor"] for summary in summaries),
            )


def segment_twin_at_4_ms(repeats: int = 3, duration_s: float = 20.0) -> Result:
    """The slow rolling scene (κ = 12 /m, 2 s a cycle) on 10 links at 4 ms, which no scene file can ask for.

    4 ms does not divide the control period, so the twin is stepped alone; the value is the revolutions a cycle.
    """
    from sim.bullet import BulletTwin

    scene = scene_of(cases()[-1], Setting("bullet", 0.005, segments=10))
    drive = Drive(kind="curvature", curvature_1_m=12.0, period_s=2.0, start_s=1.0)
    world = World(scene.world.gravity_m_s2, "plane", scene.world.friction, scene.world.friction_law)
    body = replace(Body.of(scene.robot), bending_stiffness_N_m2=BENDING_STIFFNESS_N_M2)
    step_s, factors, revolutions = 0.004, [], 0.0
    for _ in range(repeats):
        twin = BulletTwin(body, world, segments=10, step_s=step_s, stretches=False)
        trajectory, samples = Trajectory(body.length_m, grounded=True), []
        wall_s = 0.0
        for n in range(1, round(duration_s / step_s) + 1):
            began_s = time.perf_counter()
            strain = np.array([1.0, *curvature_1_m(drive, n * step_s)])
            twin.set_rest(strain, body.rest_stiffness())
            twin.step()
            wall_s += time.perf_counter() - began_s
            if n % 5 == 0:
                samples.append((n * step_s, trajectory.follow(twin.motion()).roll_rad))
        twin.close()
        t_s, roll_rad = np.array(samples).T
        cycles = (duration_s - 5.0) / drive.period_s
        revolutions = float(np.interp(5.0, t_s, roll_rad) - roll_rad[-1]) / (2.0 * math.pi) / cycles
        factors.append(duration_s / wall_s)
    label = Setting("bullet", step_s, segments=10).label
    return Result(
        "slow roll, rev a cycle", label, revolutions, 1.0, 100.0 * (revolutions - 1.0), statistics.median(factors)
    )


def stamp() -> str:
    """What the figures were measured with: program, interpreter, libraries, processor, date."""
    import datetime
    import platform
    from importlib.metadata import version

    from softbot import __version__

    libraries = ", ".join(f"{name} {version(name)}" for name in ("numpy", "numba", "pybullet"))
    processor = platform.processor() or platform.machine()
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), processor)
    day = datetime.datetime.now(datetime.UTC).date().isoformat()
    return f"softbot {__version__}, Python {platform.python_version()}, {libraries}; {processor}; {day}"


def markdown(results: list[Result]) -> str:
    """The results as a Markdown table."""
    lines = [
        "| case | twin | value | theory | error [%] | × real time |",
        "|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {r.case} | {r.setting} | {r.value:.4f} | {r.expected:.4f} "
        f"| {r.error_percent:+.2f} | {r.real_time_factor:.1f} |"
        for r in results
    ]
    return "\n".join(lines)
