"""Any scene is run by whom its drive needs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers.pressure_loop import PressureLoopGains
from sim.scene import Scene, scene_from
from softbot.nodes import lockstep, valve_loop
from softbot.nodes.run import paced, run_scene


def test_a_given_curvature_needs_no_valves(scene_table: dict[str, Any], tmp_path: Path) -> None:
    scene = scene_from(scene_table, "curved.toml", Path(), ("solver.segments=4",))
    result = run_scene(scene, tmp_path)
    assert result.summary["steps"] == 100
    assert np.isnan(result.telemetry.column("pressure_0_Pa").to_numpy()).all()
    assert not (tmp_path / "bus.log").exists()


def test_open_loop_pressures_are_held_by_the_pressure_loop(
    make_scene: Callable[..., Scene], gains: PressureLoopGains, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(valve_loop, "designed_gains", lambda robot: gains)
    scene = make_scene(
        'drive.kind="pressure"',
        "drive.peak_pressure_Pa=60e3",
        "drive.start_s=0.5",
        "drive.ramp_s=0.4",
        "drive.period_s=4.0",
        "solver.duration_s=1.5",
    )
    telemetry = run_scene(scene).telemetry
    wanted, given = (
        np.column_stack([telemetry.column(f"{what}_{i}_Pa").to_numpy() for i in range(4)])
        for what in ("command", "pressure")
    )
    late = telemetry.column("t_s").to_numpy() > 0.7
    assert wanted.max() > 55e3
    assert np.abs(given - wanted)[late].max() < 6e3  # a setpoint that turns by 0.25 rev/s is followed 30 ms late
    assert "turning" in telemetry.column("state").to_pylist()


def test_a_sequencer_scene_is_run_in_lock_step(
    make_scene: Callable[..., Scene], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[Any] = []
    monkeypatch.setattr(lockstep, "run_lockstep", lambda *args, **options: asked.append((args, options)))
    scene = make_scene()
    run_scene(scene, tmp_path)
    assert asked[0][0] == (scene, tmp_path)


def test_pacing_holds_a_run_back_to_the_wall_clock() -> None:
    now_s = 50.0
    slept: list[float] = []
    told: list[float] = []

    def sleep(duration_s: float) -> None:
        nonlocal now_s
        slept.append(duration_s)
        now_s += duration_s

    hold = paced(told.append, clock=lambda: now_s, sleep=sleep)
    hold(0.1)
    now_s += 0.02
    hold(0.2)
    now_s += 0.3  # slower than real time: not held back
    hold(0.3)
    assert told == [0.1, 0.2, 0.3]
    assert slept == [pytest.approx(0.08)]
