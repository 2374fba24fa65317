"""A robot whose chambers remember rolls as it is told to, raises no false alarm, and recovers from a dead chamber."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers.pressure_loop import PressureLoopGains
from sim.scene import Scene, scene_from
from softbot.nodes.direct import run_direct

EVERY_PART = (  # as calibrated recordings find it: a line of half a second, a fifth of hysteresis, creep, some residue
    "robot.memory.line={filling_conductance_m3_s_Pa=8e-10, venting_conductance_m3_s_Pa=5e-10, growth_1_Pa=2e-6}",
    "robot.memory.hysteresis={thresholds_Pa=[7e3, 2e4, 4e4], weights=[0.07, 0.07, 0.06]}",
    "robot.memory.creep={shares=[0.3], times_s=[0.8]}",
    "robot.memory.residual={share=0.08, growth_time_s=3.0, recovery_time_s=100.0}",
)


def scene_of(*assignments: str) -> Scene:
    table: dict[str, Any] = {
        "robot": "default",
        "drive": {"kind": "sequencer"},
        "sequencer": {"command": "left", "speed_rev_s": 0.2, "start_s": 0.2},
        "solver": {"twin": "rod", "accuracy": "fast", "duration_s": 14.0},
        "metrics": {"steady_after_s": 3.0},
    }
    return scene_from(table, "memory.toml", Path(), assignments)


def test_a_robot_that_remembers_rolls_at_the_speed_it_is_told(gains: PressureLoopGains) -> None:
    plain, remembering = (run_direct(scene_of(*parts), gains=gains) for parts in ((), EVERY_PART))
    for run in (plain, remembering):
        summary = run.summary
        assert summary["outcome"] == "done"
        assert summary["false_alarms"] == 0
        assert summary["detections"] == []
        rate = abs(summary["revolutions"]) / summary["steady_span_s"]
        assert 0.15 < rate < 0.23
        bend = run.telemetry.column("bend_rad").to_numpy()
        assert np.all(np.isfinite(bend))
        assert np.max(bend) < math.pi
    # what the chambers remember is made up for by pressure: the bend is held, and other pressures hold it
    bends, pressures = (
        [np.mean([run.telemetry.column(name).to_numpy()[-500:] for name in names]) for run in (plain, remembering)]
        for names in (("bend_rad",), [f"pressure_{i}_Pa" for i in range(4)])
    )
    assert bends[1] == pytest.approx(bends[0], rel=0.15)
    assert abs(pressures[1] - pressures[0]) > 200.0


def test_a_robot_that_remembers_rolls_on_with_a_dead_chamber(gains: PressureLoopGains) -> None:
    fault = 'fault=[{t_s=5.0, chamber=1, kind="rupture"}]'
    summary, stalled = (
        run_direct(scene_of(*EVERY_PART, fault, "solver.duration_s=40.0", recovery), gains=gains).summary
        for recovery in ("sequencer.recovery=true", "sequencer.recovery=false")
    )
    assert [one["chamber"] for one in summary["detections"]] == [1]
    assert summary["recoveries"]
    assert summary["false_alarms"] == 0
    assert abs(summary["total_revolutions"]) > abs(stalled["total_revolutions"]) + 0.3
    assert stalled["stalls"][-1]["chamber"] == 1
