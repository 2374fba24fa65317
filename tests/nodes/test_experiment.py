"""The paper's experiment over the bus: roll, lose a chamber, stop or reverse and roll on. And the phase lock."""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from sim.scene import Scene, load_scene, scene_from
from softbot.nodes.run import run_scene
from softbot.toml_file import read_toml

FAULT_S, END_S = 6.0, 14.0


def demo_scene(*assignments: str) -> Scene:
    path = Path(str(resources.files("softbot") / "data" / "demo.toml"))
    shorter = (f"fault.0.t_s={FAULT_S}", f"solver.duration_s={END_S}")
    return scene_from(read_toml(path), str(path), path.parent, (*shorter, *assignments))


def check_recovered(scene: Scene) -> None:
    """Healthy revolutions at a steady rate, the fault named, and more than one revolution on in the same direction."""
    fault = scene.fault[0]
    result = run_scene(scene)
    t = result.telemetry.column("t_s").to_numpy()
    turned = result.telemetry.column("roll_rad").to_numpy() / (2.0 * math.pi)
    sign = -1.0 if scene.sequencer.command == "left" else 1.0
    healthy = sign * np.diff(np.interp([3.0, 4.0, 5.0, 6.0], t, turned))
    np.testing.assert_allclose(healthy, 0.5, rtol=0.1)
    summary = result.summary
    assert [(d["chamber"], d["kind"]) for d in summary["detections"]] == [(fault.chamber, "rupture")]
    assert (summary["false_alarms"], summary["missed_faults"]) == (0, 0)
    assert [r["strategy"] for r in summary["recoveries"]] == ["curvature_reversal"]
    named_s = summary["detections"][0]["t_s"]
    sides = result.telemetry.column("c_bend_side").to_numpy()[t > named_s]
    assert {-1, 1} <= set(sides.tolist())  # the curvature reversed
    assert sign * (turned[-1] - np.interp(named_s, t, turned)) > 1.0


def check_stopped(scene: Scene) -> None:
    """Without recovery: it stops with the dead chamber within 20° of ±π/2, and stays."""
    result = run_scene(scene)
    t = result.telemetry.column("t_s").to_numpy()
    roll = result.telemetry.column("roll_rad").to_numpy()
    last = result.summary["stalls"][-1]
    assert last["chamber"] == scene.fault[0].chamber
    assert abs(last["theta_rad"]) == pytest.approx(math.pi / 2, abs=math.radians(20.0))
    assert last["until_s"] == pytest.approx(END_S, abs=0.2)
    assert np.ptp(roll[t > END_S - 3.0]) < math.radians(20.0)
    assert result.summary["recoveries"] == []


@pytest.mark.parametrize(("command", "chamber"), [("left", 2), ("right", 1)])
def test_on_the_rod_it_rolls_on_with_one_dead_chamber(command, chamber):
    check_recovered(demo_scene('solver.twin="rod"', f'sequencer.command="{command}"', f"fault.0.chamber={chamber}"))


def test_on_the_rod_it_stops_without_recovery():
    check_stopped(demo_scene('solver.twin="rod"', "sequencer.recovery=false"))


@pytest.mark.slow
@pytest.mark.parametrize("command", ["left", "right"])
@pytest.mark.parametrize("chamber", [0, 1, 2, 3])
class TestOnTheSegmentTwin:
    """Every chamber and both directions, as the demo runs."""

    def test_it_rolls_on(self, command, chamber):
        check_recovered(demo_scene(f'sequencer.command="{command}"', f"fault.0.chamber={chamber}"))

    def test_it_stops_without_recovery(self, command, chamber):
        check_stopped(
            demo_scene(f'sequencer.command="{command}"', f"fault.0.chamber={chamber}", "sequencer.recovery=false")
        )


@pytest.mark.slow
@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("twin", ["bullet", "rod"])
def test_a_slow_open_loop_sequence_is_phase_locked(twin, direction):
    path = Path(__file__).parents[2] / "scenes" / "open_loop.toml"
    scene = load_scene(path, (f'solver.twin="{twin}"', f"drive.direction={direction}"))
    summary = run_scene(scene).summary
    cycles = summary["steady_span_s"] / scene.drive.period_s
    assert summary["revolutions"] / cycles == pytest.approx(-direction, rel=0.02)


@pytest.mark.slow
def test_the_two_twins_agree_on_the_healthy_part():
    span = ("fault.0.t_s=13.9", "metrics.steady_after_s=3.0")
    segments = run_scene(demo_scene(*span, 'solver.accuracy="standard"')).summary
    rod = run_scene(demo_scene(*span, 'solver.twin="rod"')).summary
    assert rod["revolutions"] == pytest.approx(segments["revolutions"], rel=0.02)
    assert math.hypot(*rod["displacement_m"]) == pytest.approx(math.hypot(*segments["displacement_m"]), rel=0.02)
