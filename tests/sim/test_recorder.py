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

from sim import motion_rows
from sim.body import Motion
from sim.recorder import LEFT_OUT_OF_SUMMARY, SHAPE_EVERY, Recorder, active_side_rad, samples_of
from sim.scene import Scene, load_scene, scene_from
from sim.summary import SUMMARY_COLUMNS
from sim.telemetry import SHAPE_SCHEMA, read_table, read_telemetry
from sim.trajectory import motion_row
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


def rows_of(samples: int, **columns: float) -> np.ndarray:
    """Rows of a robot that rolls about its tangent."""
    rows = np.empty((samples, motion_rows.ROW_SIZE))
    for n in range(samples):
        rows[n] = motion_row(bent((8.0 * math.cos(0.1 * n), 8.0 * math.sin(0.1 * n))), 0.01 * (n + 1))
    for name, value in columns.items():
        rows[:, getattr(motion_rows, name)] = value
    return rows


@pytest.mark.parametrize("cut", [1, 7, 50, 130])
def test_blocks_are_recorded_as_the_same_samples_one_by_one(scene: Scene, tmp_path: Path, cut: int) -> None:
    rows = rows_of(130)
    alone, blocks = Recorder(scene, tmp_path / "alone"), Recorder(scene, tmp_path / "blocks")
    for n in range(130):
        k = (8.0 * math.cos(0.1 * n), 8.0 * math.sin(0.1 * n))
        alone.sample(rows[n, 0], StillTwin(), bent(k), active_rad=0.1 * n, state=f"{n % 3}")  # type: ignore[arg-type]
    for first in range(0, 130, cut):
        taken = np.arange(first, min(first + cut, 130))
        blocks.block(rows[taken], active_rad=0.1 * taken, states=[f"{n % 3}" for n in taken])
    assert_same(alone.finish(130, 1.3, "done")[1], blocks.finish(130, 1.3, "done")[1])
    assert (tmp_path / "alone" / "telemetry.parquet").read_bytes() == (
        tmp_path / "blocks" / "telemetry.parquet"
    ).read_bytes()


def test_block_with_pressures_of_every_sample(scene: Scene) -> None:
    pressures = np.arange(15.0).reshape(3, 5)
    recorder = Recorder(scene, None)
    recorder.block(rows_of(3), pressure_Pa=pressures, command_Pa=pressures[0, :4], states=["", "", ""])
    _, telemetry = recorder.finish(3, 0.03, "done")
    assert telemetry["pressure_1_Pa"].to_pylist() == [1.0, 6.0, 11.0]
    assert telemetry["supply_Pa"].to_pylist() == [4.0, 9.0, 14.0]
    assert telemetry["command_2_Pa"].to_pylist() == [2.0, 2.0, 2.0]


def test_energies_are_null_where_the_twin_does_not_tell_them(scene: Scene) -> None:
    recorder = Recorder(scene, None)
    recorder.block(rows_of(2), states=["", ""])
    told_of = rows_of(3, ENERGY=2.0, WORK=1.5, SHARPEST_CURVATURE=9.0, PENETRATION=1e-6, ASLEEP=1.0)
    recorder.block(told_of[2:], states=[""])
    _, telemetry = recorder.finish(3, 0.03, "done")
    assert telemetry["energy_J"].to_pylist() == [None, None, 2.0]
    told = ("work_J", "sharpest_curvature_1_m", "penetration_m", "asleep")
    assert [telemetry[name].to_pylist()[-1] for name in told] == [1.5, 9.0, 1e-6, 1.0]


def test_summary_alone_keeps_the_columns_of_the_metrics_and_gives_the_same_summary(scene: Scene) -> None:
    results = []
    for kept in ("all", "summary"):
        recorder = Recorder(scene, None, record=kept)  # type: ignore[arg-type]
        recorder.block(rows_of(1200, ENERGY=1.0, WORK=0.0), states=["turning"] * 1200)
        results.append(recorder.finish(1200, 12.0, "done"))
    (summary, table), (alone, columns) = results
    assert repr(alone) == repr(summary)
    assert set(table.column_names) - set(columns.column_names) == set(LEFT_OUT_OF_SUMMARY) - {"shape"}
    assert set(columns.column_names) == SUMMARY_COLUMNS


def test_run_folder_holds_the_whole_run(scene: Scene, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r'record = "summary": a run folder holds the whole run'):
        Recorder(scene, tmp_path / "run", record="summary")
    assert not (tmp_path / "run").exists()


def test_shapes_keep_their_pace_where_samples_are_far_between(scene: Scene, tmp_path: Path) -> None:
    assert Recorder(scene, None).shape_every is None
    for sample_s, every in ((0.01, SHAPE_EVERY), (0.02, 2), (0.1, 1)):
        recorder = Recorder(scene, tmp_path / str(every), sample_s=sample_s)
        assert recorder.shape_every == every
        recorder.shape((0.1, 0.2), StillTwin())  # type: ignore[arg-type]
        recorder.finish(0, 0.0, "done")
        assert read_table(tmp_path / str(every), "shape", SHAPE_SCHEMA)["t_s"].to_pylist() == [0.1, 0.2]


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
    assert samples_of(scene_from(scene_table, "s", Path()), 0.02) == 25
