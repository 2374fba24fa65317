"""A recorded bus through the sequencer's estimation and detection."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from controllers.pressure_loop import PressureLoopGains
from firmware_protocol.errors import TraceError
from firmware_protocol.frame import Frame
from firmware_protocol.trace import TraceWriter, read_trace
from sim.scene import Scene, load_scene
from softbot.nodes.lockstep import run_lockstep
from softbot.nodes.replay import replay_trace

SCENE = Path(__file__).parents[2] / "scenes" / "damaged.toml"


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene(SCENE, ("fault.0.t_s=3", "solver.duration_s=4"))


@pytest.fixture(scope="module")
def run(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of four seconds that loses a chamber."""
    folder = tmp_path_factory.mktemp("recorded")
    gains = PressureLoopGains(proportional_1_s=18.0, integral_1_s2=16.0, sample_s=0.01, model_lag_s=0.03)
    run_lockstep(scene, folder, gains=gains)
    return folder


def test_it_finds_in_a_trace_what_was_found_on_the_bus(run: Path, scene: Scene) -> None:
    found = replay_trace(run / "bus.log", scene.robot)
    assert [(one.chamber, one.kind) for one in found.detections] == [(1, "rupture")]
    assert [(one["chamber"], one["kind"]) for one in found.recorded] == [(1, "rupture")]
    assert found.detections[0].t_s == pytest.approx(float(str(found.recorded[0]["t_s"])), abs=0.02)
    assert (found.samplings, found.refused) == (400, 0)
    assert 3.0 < found.armed_s < 4.0
    assert found.report()["detections"][0]["kind"] == "rupture"  # type: ignore[index]


@pytest.mark.parametrize("name", ["bus.asc", "bus.blf"])
def test_other_formats_and_other_clocks_give_the_same(run: Path, scene: Scene, tmp_path: Path, name: str) -> None:
    with TraceWriter(tmp_path / name) as writer:
        for t_s, records in itertools.groupby(read_trace(run / "bus.log"), key=lambda record: record.t_s):
            writer.write([record.frame for record in records], 1000.0 + t_s)
    here = replay_trace(tmp_path / name, scene.robot)
    there = replay_trace(run / "bus.log", scene.robot)
    assert [(one.chamber, one.kind) for one in here.detections] == [(one.chamber, one.kind) for one in there.detections]
    assert here.samplings == there.samplings


def test_damaged_frames_are_refused_and_counted(run: Path, scene: Scene, tmp_path: Path) -> None:
    with TraceWriter(tmp_path / "damaged.log") as writer:
        for number, record in enumerate(read_trace(run / "bus.log")):
            frame = record.frame
            if number % 50 == 0:
                frame = Frame(frame.frame_id, bytes([frame.data[0] ^ 0x10]) + frame.data[1:])
            writer.write([frame], record.t_s)
    assert replay_trace(tmp_path / "damaged.log", scene.robot).refused > 20


def test_a_trace_without_a_board_is_refused(scene: Scene, tmp_path: Path) -> None:
    with TraceWriter(tmp_path / "other.log") as writer:
        writer.write([Frame(0x123, b"abc")], 0.0)
    with pytest.raises(TraceError, match=r"other\.log: holds no valid frame of a valve board"):
        replay_trace(tmp_path / "other.log", scene.robot)
