"""The rod between two steps against the same rod with fine steps, and the rows of a run that are filled in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sim import motion_rows
from sim.rod import RodTwin
from sim.rod_drive import drive_array
from sim.run import simulate
from sim.scene import Scene, scene_from
from sim.telemetry import SHAPE_SCHEMA, read_table
from sim.twins import make_twin

FloatArray = NDArray[np.float64]

ROLL: dict[str, Any] = {
    "robot": {
        "length_m": 0.15,
        "radius_m": 0.01,
        "mass_kg": 0.0518,
        "damping_time_s": 0.02,
        "bending_stiffness_N_m2": 3.93e-3,
    },
    "drive": {"kind": "curvature", "curvature_1_m": 12.0, "period_s": 2.0, "start_s": 0.5, "ramp_s": 0.25},
    "world": {"friction": 0.6},
}


def scene(step_s: float, **world: Any) -> Scene:
    solver = {"step_s": step_s, "modes": 3, "contact_points": 12, "duration_s": 3.0}
    counted = {"steady_after_s": 1.0}
    return scene_from({**ROLL, "world": ROLL["world"] | world, "solver": solver, "metrics": counted}, "scene", Path())


def rod(step_s: float, **world: Any) -> tuple[RodTwin, FloatArray]:
    made = scene(step_s, **world)
    twin = make_twin(made)
    assert isinstance(twin, RodTwin)
    return twin, drive_array(made.drive)


@pytest.mark.parametrize(("ground", "most"), [("plane", 1e-5), ("none", 5e-3)])
def test_instants_of_a_long_step_are_those_of_ten_short_ones(ground: str, most: float) -> None:
    """Both from the same state: shape, roll, place; afloat the bend rings a little, which long steps damp out."""
    coarse, drive = rod(0.1, ground=ground)
    for _ in range(15):
        coarse.play(drive, 1, 1)
    for _ in range(10):
        fine = coarse.copy()
        fine._physics = fine._physics._replace(step_s=0.01)
        rows = fine.play(drive, 10, 1)
        shown = coarse.fill(*coarse.play_seen(drive, 1), 10)[0][:9]
        for column, scale in (
            (motion_rows.POSITION, 0.01),
            (motion_rows.ROTATION, 1.0),
            (motion_rows.CENTRE_OF_MASS, 0.01),
            (motion_rows.CURVATURE, 12.0),
            (motion_rows.CHORD, 1.0),
        ):
            assert np.abs(shown[:, column] - rows[:9, column]).max() < most * scale
        np.testing.assert_allclose(shown[:, motion_rows.TIME], rows[:9, motion_rows.TIME])


def test_pose_and_rates_run_on_into_both_ends_of_a_step() -> None:
    """While the bend still grows and the tube begins to roll: nothing jumps at the ends."""
    twin, drive = rod(0.05)
    twin.play(drive, 9, 1)
    for _ in range(8):
        start = twin.row()
        count = 1000
        shown, seen = twin.fill(*twin.play_seen(drive, 1), count)
        for row, one in ((shown[0], start), (shown[-2], twin.row())):
            for column in (motion_rows.POSITION, motion_rows.ROTATION, motion_rows.CURVATURE, motion_rows.VELOCITY):
                near = 5.0 / count * (np.ptp(shown[:, column], axis=0).max() + 1e-9)
                assert np.abs(row[column] - one[column]).max() < near
        lines = [twin.seen_at(instant).shape()[0] for instant in seen]
        moved = np.abs(np.diff(lines, axis=0)).max(axis=(1, 2))
        assert moved.max() < 5.0 * (moved.mean() + 1e-9)


def test_a_look_between_steps_leaves_the_run_as_it_is() -> None:
    watched, drive = rod(0.05)
    alone, _ = rod(0.05)
    for _ in range(30):
        _, seen = watched.fill(*watched.play_seen(drive, 1), 5)
        watched.seen_at(seen[2]).shape()
        alone.play(drive, 1, 1)
    np.testing.assert_array_equal(watched.row(), alone.row())


def test_many_steps_are_filled_in_as_one_after_another() -> None:
    together, drive = rod(0.05)
    single, _ = rod(0.05)
    whole, seen = together.fill(*together.play_seen(drive, 30), 5)
    parts = [single.fill(*single.play_seen(drive, 1), 5) for _ in range(30)]
    np.testing.assert_allclose(whole, np.concatenate([rows for rows, _ in parts]), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(seen, np.concatenate([each for _, each in parts]), rtol=1e-12, atol=1e-15)


def test_momentum_of_a_floating_robot_is_kept_between_steps_too() -> None:
    result = simulate(scene(0.1, ground="none", gravity_m_s2=0.0))
    assert result.telemetry.num_rows == 300
    assert result.summary["angular_momentum_max_kg_m2_s"] < 1e-15


def test_a_run_of_long_steps_has_samples_and_shapes_like_any_other(tmp_path: Path) -> None:
    result = simulate(scene(0.1), tmp_path)
    t_s, roll, y, bend = (result.telemetry[name].to_numpy() for name in ("t_s", "roll_rad", "com_y_m", "bend_rad"))
    np.testing.assert_allclose(t_s, 0.01 * np.arange(1, 301))
    assert result.summary["steps"] == 30
    shapes = read_table(tmp_path, "shape", SHAPE_SCHEMA)
    np.testing.assert_allclose(shapes["t_s"].to_numpy(), 0.01 + 0.04 * np.arange(75))
    turning = t_s > 1.0
    for column in (roll, y):
        steps = np.diff(column[turning])
        assert steps.max() < 0.0 or steps.min() > 0.0
        assert np.abs(steps - steps.mean()).max() < 0.1 * abs(steps.mean())
    assert np.ptp(bend[turning]) < 2e-3
    middle = np.array(shapes["centreline_m"].to_pylist())[:, 48:51]
    assert np.abs(np.diff(middle, axis=0)).max() < 0.04 * 0.04


def test_the_summary_alone_fills_nothing_in_and_says_the_same() -> None:
    whole, alone = (simulate(scene(0.1), record=kept) for kept in ("all", "summary"))
    assert alone.telemetry.num_rows == 30
    for key in ("revolutions", "displacement_m", "advance_per_revolution_m", "bend_rad", "plane_rotation_rad"):
        assert alone.summary[key] == pytest.approx(whole.summary[key], rel=1e-6, abs=1e-9)


def test_a_sleeping_robot_is_not_looked_at_between_steps() -> None:
    table = {**ROLL, "drive": ROLL["drive"] | {"start_s": 60.0}}
    still = scene_from({**table, "solver": {"step_s": 0.1, "duration_s": 61.0}}, "scene", Path())
    result = simulate(still)
    t_s, asleep, bend = (result.telemetry[name].to_numpy() for name in ("t_s", "asleep", "bend_rad"))
    np.testing.assert_allclose(t_s, 0.01 * np.arange(1, 6101))
    assert asleep[100:5970].min() == 1.0
    assert np.abs(np.diff(bend)).max() < 0.15 * bend.max()
