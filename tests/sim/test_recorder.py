"""The recorder: what a run directory holds, when, and the clock of the solver loop."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from sim.body import Motion
from sim.recorder import SHAPE_EVERY, Recorder, active_side_rad, samples_of
from sim.scene import Scene, load_scene, scene_from
from sim.telemetry import SHAPE_SCHEMA, read_table, read_telemetry
from softbot.errors import InputError

PRESSURE_Pa = np.array([1e3, 2e3, 3e3, 4e3, 250e3])


class StillTwin:
    """A twin that only has a shape."""

    step_s = 0.005

    def shape(self) -> tuple[np.ndarray, np.ndarray]:
        return np.arange(9.0).reshape(3, 3), np.ones((3, 3))


def bent(curvature: tuple[float, float]) -> Motion:
    rotation = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    zero = np.zeros(3)
    momentum = np.array([3e-6, 0.0, 4e-6])
    return Motion(
        rotation, zero, zero, np.array([1.0, 2.0, 3.0]), 1.1, np.array(curvature), np.array([1.0, 0, 0]), momentum
    )


@pytest.fixture
def scene(scene_table: dict[str, Any]) -> Scene:
    return scene_from(scene_table, "made-up.toml", Path())


def assert_same(one: pa.Table, other: pa.Table) -> None:
    """Column by column, NaN equal to NaN."""
    assert one.schema.equals(other.schema)
    for name in one.column_names:
        np.testing.assert_array_equal(np.array(one[name].to_pylist()), np.array(other[name].to_pylist()))


def record(recorder: Recorder, samples: int, **columns: Any) -> None:
    for n in range(samples):
        recorder.sample(0.01 * (n + 1), StillTwin(), bent((8.0, 0.0)), **columns)  # type: ignore[arg-type]


def test_one_sample_is_one_row_of_what_was_told(scene: Scene) -> None:
    recorder = Recorder(scene, None)
    posture = recorder.sample(
        0.5,
        StillTwin(),  # type: ignore[arg-type]
        bent((0.0, 8.0)),
        pressure_Pa=PRESSURE_Pa,
        command_Pa=np.array([5e3, 6e3, 7e3, 8e3]),
        state="rolling",
    )
    _, telemetry = recorder.finish(1, 0.01, "done")
    (row,) = telemetry.to_pylist()
    assert [row[f"pressure_{i}_Pa"] for i in range(4)] == [1e3, 2e3, 3e3, 4e3]
    assert [row[f"command_{i}_Pa"] for i in range(4)] == [5e3, 6e3, 7e3, 8e3]
    assert (row["t_s"], row["state"], row["supply_Pa"]) == (0.5, "rolling", 250e3)
    assert [row[f"com_{axis}_m"] for axis in "xyz"] == [1.0, 2.0, 3.0]
    assert row["angular_momentum_kg_m2_s"] == pytest.approx(5e-6)
    assert row["length_m"] == pytest.approx(1.1 * 0.15)
    assert row["bend_rad"] == posture.bend_rad == pytest.approx(8.0 * 0.15)
    # the pressurised side is towards chambers 2 and 3, the C opens towards chamber 1
    assert row["theta_rad"] == pytest.approx(math.atan2(-2e3, -2e3) - math.pi / 2 + 2 * math.pi)


def test_theta_of_a_given_curvature_is_from_the_side_that_is_said_to_be_active(scene: Scene) -> None:
    recorder = Recorder(scene, None)
    record(recorder, 1, active_rad=3.0 + 2.0 * math.pi)
    (row,) = recorder.finish(1, 0.01, "done")[1].to_pylist()
    assert row["theta_rad"] == pytest.approx(3.0)
    assert math.isnan(row["pressure_0_Pa"])


def test_finished_run_directory_holds_scene_telemetry_shapes_and_summary(scene: Scene, tmp_path: Path) -> None:
    run_dir = tmp_path / "new" / "run"
    recorder = Recorder(scene, run_dir)
    record(recorder, 2 * SHAPE_EVERY + 1)
    recorder.events.faults.append({"t_s": 0.02, "chamber": 1, "kind": "leak"})
    summary, telemetry = recorder.finish(18, 0.09, "done")
    names = sorted(entry.name for entry in run_dir.iterdir())
    assert names == ["scene.toml", "shape.parquet", "summary.json", "telemetry.parquet"]
    assert load_scene(run_dir / "scene.toml") == scene
    assert_same(telemetry, read_telemetry(run_dir))
    shapes = read_table(run_dir, "shape", SHAPE_SCHEMA)
    np.testing.assert_allclose(shapes["t_s"], [0.01, 0.05, 0.09])
    assert shapes["centreline_m"].to_pylist()[0] == list(range(9))
    assert float(shapes.schema.metadata[b"radius_m"]) == scene.robot.radius_m
    written = json.loads((run_dir / "summary.json").read_text())
    assert written["missed_faults"] == summary["missed_faults"] == 1
    assert (written["steps"], written["outcome"]) == (18, "done")


def test_run_that_was_killed_leaves_its_scene_and_no_summary_of_another_run(scene: Scene, tmp_path: Path) -> None:
    record(recorder := Recorder(scene, tmp_path), 3)
    recorder.finish(3, 0.03, "done")
    record(killed := Recorder(scene, tmp_path), 60)
    assert not (tmp_path / "summary.json").exists()
    assert read_telemetry(tmp_path).num_rows == 50
    assert load_scene(tmp_path / "scene.toml") == scene
    killed.finish(60, 0.6, "done")  # so that the test leaves no open file


def test_recording_in_memory_and_on_disk_give_the_same_table(scene: Scene, tmp_path: Path) -> None:
    tables = []
    for run_dir in (None, tmp_path):
        recorder = Recorder(scene, run_dir)
        record(recorder, 7, pressure_Pa=PRESSURE_Pa, command_Pa=PRESSURE_Pa[:4])
        tables.append(recorder.finish(7, 0.07, "done")[1])
    assert_same(*tables)


def test_folder_that_cannot_be_made_is_refused_by_name(scene: Scene, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"cannot be made: .*; choose another --out"):
        Recorder(scene, tmp_path / "file" / "run")


def test_clock_counts_the_solver_alone(scene: Scene) -> None:
    recorder = Recorder(scene, None)
    for _ in range(2):
        recorder.start_clock()
        time.sleep(0.01)
        recorder.stop_clock()
        time.sleep(0.05)
    wall_time_s = recorder.finish(1, 1.0, "done")[0]["wall_time_s"]
    assert 0.02 <= wall_time_s < 0.09


@pytest.mark.parametrize(
    ("pressure", "expected"),
    [([1, 0, 0, 0], 0.0), ([0, 2, 0, 0], math.pi / 2), ([1, 1, 0, 0], math.pi / 4), ([5, 0, 5, 3], -math.pi / 2)],
)
def test_active_side_is_where_the_pressure_is(pressure: list[float], expected: float) -> None:
    assert active_side_rad(np.array(pressure, dtype=float)) == pytest.approx(expected)
    assert math.isnan(active_side_rad(np.array([math.nan] * 4)))


def test_scene_has_at_least_one_sample(scene_table: dict[str, Any]) -> None:
    scene_table["solver"]["duration_s"] = 1e-6
    assert samples_of(scene_from(scene_table, "s", Path())) == 1
    scene_table["solver"]["duration_s"] = 0.5
    assert samples_of(scene_from(scene_table, "s", Path())) == 50
