"""Lock-step runs: the same bytes every time, everything on the bus, nothing lost when a run ends early."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers.pressure_loop import PressureLoopGains
from firmware_protocol.codec import decode
from firmware_protocol.e2e import Receiver
from firmware_protocol.spec import spec
from firmware_protocol.trace import read_trace
from sim.scene import Scene
from sim.telemetry import read_telemetry
from softbot.errors import InputError, SimulationError
from softbot.nodes.lockstep import run_lockstep

MakeScene = Callable[..., Scene]


@pytest.fixture
def run(scripted: Any, gains: PressureLoopGains) -> Callable[..., Any]:
    """`run_lockstep` with a scripted sequencer that finds a rupture at 0.4 s."""

    def go(scene: Scene, run_dir: Path | None = None, **options: Any) -> Any:
        sequencer = options.pop("sequencer", None) or scripted(script={0.4: (1, "rupture")})
        return run_lockstep(scene, run_dir, sequencer=sequencer, gains=gains, **options)

    return go


def test_the_same_scene_gives_the_same_bytes(make_scene: MakeScene, run: Any, tmp_path: Path) -> None:
    for name in ("one", "two"):
        run(make_scene(), tmp_path / name)
    for file in ("telemetry.parquet", "shape.parquet", "bus.log", "scene.toml"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes(), file


def test_another_seed_gives_another_run(make_scene: MakeScene, run: Any, tmp_path: Path) -> None:
    run(make_scene(), tmp_path / "one")
    run(make_scene("solver.seed=1"), tmp_path / "two")
    assert (tmp_path / "one" / "bus.log").read_bytes() != (tmp_path / "two" / "bus.log").read_bytes()


def test_the_real_sequencer_is_reproducible_and_rolls(
    make_scene: MakeScene, gains: PressureLoopGains, tmp_path: Path
) -> None:
    scene = make_scene("solver.duration_s=2.5", "solver.segments=6", "sequencer.speed_rev_s=0.5")
    results = [run_lockstep(scene, tmp_path / name, gains=gains) for name in ("one", "two")]
    for file in ("telemetry.parquet", "bus.log"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes(), file
    states = results[0].telemetry.column("state").to_pylist()
    assert list(dict.fromkeys(states))[:3] == ["disarmed", "priming", "rolling"]
    assert results[0].summary["total_revolutions"] < -0.2  # to the left: negative
    assert results[0].summary["false_alarms"] == 0


def test_everything_that_crossed_the_bus_is_in_the_log(make_scene: MakeScene, run: Any, tmp_path: Path) -> None:
    run(make_scene(), tmp_path)
    receivers = {message.name: Receiver(message.name, 3) for message in spec().messages}
    seen: dict[str, list[float]] = {}
    for t_s, frame in read_trace(tmp_path / "bus.log"):
        name, _ = decode(frame.frame_id, frame.data)
        assert receivers[name].check(frame.data).accepted, (t_s, name)  # no frame between two is missing
        seen.setdefault(name, []).append(t_s)
    assert seen["BoardPressures"] == pytest.approx(np.arange(60) * 0.01)
    assert seen["SequencerSetpoints"] == pytest.approx(np.arange(60) * 0.01)
    assert {"SequencerControl", "SequencerHeartbeat", "SequencerFault", "BoardHeartbeat", "BoardBoot"} <= set(seen)


def test_what_the_sequencer_found_is_in_the_summary(make_scene: MakeScene, run: Any, tmp_path: Path) -> None:
    fault = '[{t_s = 0.25, chamber = 1, kind = "rupture"}]'
    summary = run(make_scene(f"fault={fault}"), tmp_path).summary
    named = {"t_s": 0.4, "chamber": 1, "kind": "rupture", "confidence": 0.9}
    assert summary["detections"] == [named | {"delay_s": pytest.approx(0.15), "judgement": "right"}]
    assert summary["recoveries"] == [{"t_s": 0.4, "strategy": "curvature_reversal"}]
    assert (summary["false_alarms"], summary["missed_faults"]) == (0, 0)
    assert json.loads((tmp_path / "summary.json").read_text())["detections"][0]["chamber"] == 1


def test_a_run_inside_another_is_not_heard_by_it(make_scene: MakeScene, run: Any, tmp_path: Path) -> None:
    alone = run(make_scene())
    inner: list[Any] = []

    def disturb(t_s: float) -> None:
        if not inner:
            inner.append(run(make_scene("solver.seed=7", "solver.duration_s=0.3")))

    disturbed = run(make_scene(), progress=disturb)
    assert len(inner) == 1
    assert disturbed.telemetry.equals(alone.telemetry)


def test_an_interrupted_run_keeps_what_it_recorded(make_scene: MakeScene, run: Any, tmp_path: Path) -> None:
    def interrupt(t_s: float) -> None:
        if t_s > 0.25:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(make_scene(), tmp_path, progress=interrupt)
    assert read_telemetry(tmp_path).num_rows == 30
    assert json.loads((tmp_path / "summary.json").read_text())["outcome"] == "interrupted"
    assert list(read_trace(tmp_path / "bus.log"))[-1].t_s == pytest.approx(0.29)


def test_a_sequencer_that_fails_ends_the_run_with_a_stop_on_the_bus(
    make_scene: MakeScene, run: Any, scripted: Any, tmp_path: Path
) -> None:
    broken = scripted(script={0.4: ZeroDivisionError("no bend")})
    with pytest.raises(SimulationError, match=r"the sequencer failed at t = 0\.40 s: no bend"):
        run(make_scene(), tmp_path, sequencer=broken)
    assert json.loads((tmp_path / "summary.json").read_text())["outcome"].startswith("failed: the sequencer failed")
    assert read_telemetry(tmp_path).num_rows == 40
    last = [decode(frame.frame_id, frame.data)[0] for t_s, frame in read_trace(tmp_path / "bus.log") if t_s > 0.395]
    assert "EmergencyStop" in last


def test_a_setpoint_that_no_frame_can_carry_is_a_failed_run(
    make_scene: MakeScene, run: Any, scripted: Any, tmp_path: Path
) -> None:
    with pytest.raises(SimulationError, match=r"the bus failed at t = .*Setpoint0"):
        run(make_scene(), tmp_path, sequencer=scripted((-5e3, 0.0, 0.0, 0.0)))
    assert (tmp_path / "summary.json").exists()


def test_a_robot_that_the_board_refuses_leaves_no_folder(make_scene: MakeScene, run: Any, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="max_chamber_pressure_Pa"):
        run(make_scene("robot.pneumatics.max_chamber_pressure_Pa=1e5"), tmp_path / "run")
    assert not (tmp_path / "run").exists()
