"""Metrics of made-up trajectories whose answers are known."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.scene import Scene, scene_from
from sim.summary import (
    STALL_ROLL_RAD,
    STALL_WINDOW_S,
    SUMMARY_COLUMNS,
    Cost,
    Events,
    summarise,
    write_summary,
)
from sim.telemetry import NULLABLE, TELEMETRY_SCHEMA

PERIOD_s = 0.01
RATE_rad_s = 3.0
# A stall is noticed to begin when what is left of the roll no longer fills the span of a stall.
EARLY_s = STALL_ROLL_RAD / RATE_rad_s + 2 * PERIOD_s
COST = Cost(steps=1000, sim_time_s=10.0, wall_time_s=2.0)
DESIGN = ["schema", "scene", "twin", "accuracy", "sim_time_s", "wall_time_s", "real_time_factor", "steps",
          "revolutions", "displacement_m", "advance_per_revolution_m", "plane_rotation_rad", "bend_rad",
          "angular_momentum_max_kg_m2_s", "stalls", "faults", "detections", "recoveries", "false_alarms",
          "missed_faults", "steady_span_s"]  # fmt: skip


@pytest.fixture
def scene(scene_table: dict[str, Any]) -> Scene:
    return scene_from(scene_table, "made-up.toml", Path())


def telemetry(seconds: float, **columns: Any) -> pa.Table:
    """Samples from 10 ms on, zero but for the columns given (numbers or functions of time)."""
    t_s = PERIOD_s * np.arange(1, round(seconds / PERIOD_s) + 1)
    data: dict[str, Any] = {}
    for field in TELEMETRY_SCHEMA:
        value = columns.get(field.name, "" if field.type == pa.string() else 0.0)
        values = value(t_s) if callable(value) else np.full(len(t_s), value)
        data[field.name] = pa.array(values.tolist()).cast(field.type)
    data["t_s"] = pa.array(t_s)
    return pa.table(data, schema=TELEMETRY_SCHEMA)


def summary_of(scene: Scene, table: pa.Table, **events: list[dict[str, Any]]) -> dict[str, Any]:
    return summarise(scene, table, Events(**events), COST, "done")


def rolled_until(stop_s: float, go_on_s: float = math.inf) -> Any:
    """Roll at a steady rate, at rest from `stop_s` to `go_on_s`."""
    return lambda t: -RATE_rad_s * (np.minimum(t, stop_s) + np.maximum(t - go_on_s, 0.0))


# --- how far ------------------------------------------------------------


def test_summary_has_every_key_that_other_programs_rely_on(scene: Scene) -> None:
    summary = summary_of(scene, telemetry(10.0))
    assert set(DESIGN) <= set(summary)
    assert (summary["schema"], summary["outcome"]) == ("softbot-summary-1", "done")
    assert (summary["scene"], summary["twin"], summary["accuracy"]) == ("made-up", "bullet", "fast")
    assert (summary["steps"], summary["real_time_factor"]) == (1000, 5.0)


def test_distances_count_from_the_steady_time_to_the_end(scene: Scene) -> None:
    steady_s = scene.steady_after_s
    assert steady_s == pytest.approx(0.2 + 2 * 1.0)
    table = telemetry(
        10.0,
        roll_rad=lambda t: np.where(t < steady_s, 50.0 * t, -2.0 * math.pi * t),
        com_x_m=lambda t: 0.03 * t,
        com_y_m=lambda t: 0.04 * t,
        plane_rotation_rad=lambda t: 0.5 * t,
        bend_rad=lambda t: t,
        angular_momentum_kg_m2_s=lambda t: np.where(t > 9.0, np.nan, t),
    )
    summary = summary_of(scene, table)
    span_s = 10.0 - 2.2
    assert summary["steady_span_s"] == pytest.approx(span_s)
    assert summary["revolutions"] == pytest.approx(-span_s)
    np.testing.assert_allclose(summary["displacement_m"], [0.03 * span_s, 0.04 * span_s])
    assert summary["advance_per_revolution_m"] == pytest.approx(0.05)
    assert summary["plane_rotation_rad"] == pytest.approx(0.5 * span_s)
    assert summary["total_revolutions"] == pytest.approx((-20.0 * math.pi - 0.5) / (2.0 * math.pi))
    assert summary["bend_rad"] == pytest.approx(10.0)
    assert summary["angular_momentum_max_kg_m2_s"] == pytest.approx(9.0)


def test_robot_that_does_not_roll_has_no_advance_per_revolution(scene: Scene) -> None:
    summary = summary_of(scene, telemetry(10.0, com_y_m=lambda t: t))
    assert summary["revolutions"] == 0.0
    assert summary["advance_per_revolution_m"] is None


@pytest.mark.parametrize("seconds", [0.0, 0.01, 2.0])
def test_run_that_ended_before_the_steady_time_still_has_a_summary(scene: Scene, seconds: float) -> None:
    summary = summarise(scene, telemetry(seconds, roll_rad=lambda t: t), Events(), Cost(0, 0.0, 0.0), "interrupted")
    assert summary["steady_span_s"] == 0.0
    assert summary["revolutions"] is summary["plane_rotation_rad"] is summary["advance_per_revolution_m"] is None
    assert summary["displacement_m"] == [None, None]
    assert summary["real_time_factor"] is None
    assert summary["stalls"] == []
    assert summary["outcome"] == "interrupted"


# --- energy, sleep, kinks ------------------------------------------------------------


def test_energy_gain_is_the_most_that_ever_stood_above_the_work(scene: Scene) -> None:
    """Work is put in, some of it is lost, and at 5 s a tenth of a joule comes from nowhere for a while."""
    table = telemetry(
        10.0,
        energy_J=lambda t: 2.0 + 3.0 * t - 0.5 * t + np.where((t > 5.0) & (t < 6.0), 0.1 + 0.5 * t, 0.0),
        work_J=lambda t: 3.0 * t,
    )
    assert summary_of(scene, table)["energy_gain_J"] == pytest.approx(0.1 + 0.5 * PERIOD_s, abs=1e-9)
    lossy = telemetry(10.0, energy_J=lambda t: -t)
    assert summary_of(scene, lossy)["energy_gain_J"] == 0.0


def test_what_a_twin_does_not_tell_is_null_or_nothing(scene: Scene) -> None:
    table = telemetry(2.0)
    unknown = pa.nulls(table.num_rows, pa.float64())
    for name in NULLABLE:
        table = table.set_column(table.schema.get_field_index(name), name, unknown)
    summary = summary_of(scene, table)
    assert (summary["energy_gain_J"], summary["asleep_s"], summary["kinks"]) == (None, 0.0, [])
    earlier = table.drop_columns(sorted(NULLABLE))
    assert {**summary, "wall_time_s": 0.0} == {**summary_of(scene, earlier), "wall_time_s": 0.0}


def test_sleep_is_summed_up_whatever_the_time_between_samples(scene: Scene) -> None:
    assert summary_of(scene, telemetry(5.0, asleep=lambda t: (t > 1.0) & (t <= 3.5)))["asleep_s"] == pytest.approx(2.5)
    assert summary_of(scene, telemetry(5.0, asleep=1.0))["asleep_s"] == pytest.approx(5.0)


def test_kinks_are_the_times_at_which_the_tube_bends_beyond_its_stable_branch() -> None:
    drive = {"kind": "curvature", "curvature_1_m": 100.0}
    scene = scene_from({"robot": "larva", "drive": drive}, "s.toml", Path())
    kink_1_m = scene.robot.kink_curvature_1_m
    bent = telemetry(4.0, sharpest_curvature_1_m=lambda t: kink_1_m * (1.2 * np.sin(math.pi * t) ** 2))
    kinks = summary_of(scene, bent)["kinks"]
    crossing_s = math.asin(math.sqrt(1.0 / 1.2)) / math.pi
    assert [kink["t_s"] for kink in kinks] == pytest.approx([n + crossing_s for n in range(4)], abs=PERIOD_s)
    assert [kink["curvature_1_m"] for kink in kinks] == pytest.approx([1.2 * kink_1_m] * 4, rel=1e-3)
    assert summary_of(scene, telemetry(4.0, sharpest_curvature_1_m=0.99 * kink_1_m))["kinks"] == []


def test_a_section_that_keeps_its_shape_has_no_kink(scene: Scene) -> None:
    assert summary_of(scene, telemetry(4.0, sharpest_curvature_1_m=1e6))["kinks"] == []


def test_metrics_read_no_other_columns_than_those_that_are_kept_for_them(scene: Scene) -> None:
    table = telemetry(8.0, roll_rad=rolled_until(3.0), bend_rad=1.5, energy_J=lambda t: -t)
    kept = table.select([name for name in table.column_names if name in SUMMARY_COLUMNS])
    assert repr(summary_of(scene, kept)) == repr(summary_of(scene, table))


# --- stalls ------------------------------------------------------------


@given(stop_s=st.floats(1.0, 5.0), chamber=st.integers(0, 3), direction=st.floats(-3.1, 3.1))
def test_stop_of_a_bent_robot_is_a_stall_at_the_angle_of_the_dead_chamber(
    stop_s: float, chamber: int, direction: float
) -> None:
    scene = scene_from(
        {
            "robot": {"length_m": 0.15, "radius_m": 0.01, "mass_kg": 0.05, "bending_stiffness_N_m2": 4e-3},
            "drive": {"kind": "curvature", "curvature_1_m": 12.0},
        },
        "s.toml",
        Path(),
    )
    table = telemetry(8.0, roll_rad=rolled_until(stop_s), bend_rad=1.5, bend_direction_rad=direction)
    fault = {"t_s": 0.5, "chamber": chamber, "kind": "rupture"}
    (stall,) = summary_of(scene, table, faults=[fault])["stalls"]
    assert stall["t_s"] == pytest.approx(stop_s, abs=EARLY_s)
    assert stall["until_s"] == pytest.approx(8.0, abs=0.02)
    assert stall["chamber"] == chamber
    assert math.cos(stall["theta_rad"] - (chamber * math.pi / 2 - direction)) == pytest.approx(1.0)
    assert -math.pi < stall["theta_rad"] <= math.pi


def test_stall_ends_when_the_robot_rolls_on_and_another_may_follow(scene: Scene) -> None:
    def roll(t: np.ndarray) -> np.ndarray:
        return RATE_rad_s * (np.minimum(t, 2.0) + np.clip(t - 4.0, 0.0, 1.0))

    stalls = summary_of(scene, telemetry(8.0, roll_rad=roll, bend_rad=1.0))["stalls"]
    assert [stall["t_s"] for stall in stalls] == pytest.approx([2.0, 5.0], abs=EARLY_s)
    assert [stall["until_s"] for stall in stalls] == pytest.approx([4.0, 8.0], abs=EARLY_s)
    assert [stall["chamber"] for stall in stalls] == [-1, -1]  # nothing is broken


def slowly_on(t: np.ndarray) -> np.ndarray:
    """From two seconds on, just fast enough to get on."""
    return RATE_rad_s * np.minimum(t, 2.0) + 1.1 * STALL_ROLL_RAD / STALL_WINDOW_S * np.maximum(t - 2.0, 0.0)


@pytest.mark.parametrize(
    ("why", "columns"),
    [
        ("it never rolled", {"roll_rad": 0.0, "bend_rad": 1.5}),
        ("it is straight", {"roll_rad": rolled_until(2.0), "bend_rad": 0.05}),
        ("it only pauses", {"roll_rad": rolled_until(2.0, 2.0 + 0.6 * STALL_WINDOW_S), "bend_rad": 1.5}),
        ("it rolls on slowly", {"roll_rad": slowly_on, "bend_rad": 1.5}),
    ],
)
def test_what_is_no_stall(scene: Scene, why: str, columns: dict[str, Any]) -> None:
    assert summary_of(scene, telemetry(6.0, **columns))["stalls"] == [], why


def test_stall_names_a_chamber_only_when_it_was_dead_by_then(scene: Scene) -> None:
    table = telemetry(8.0, roll_rad=rolled_until(3.0), bend_rad=1.5)
    later = {"t_s": 6.0, "chamber": 2, "kind": "rupture"}
    lives = {"t_s": 1.0, "chamber": 1, "kind": "sensor_offset"}
    blocked = {"t_s": 1.5, "chamber": 3, "kind": "blocked_inlet"}
    assert summary_of(scene, table, faults=[lives, later])["stalls"][0]["chamber"] == -1
    assert summary_of(scene, table, faults=[lives, blocked, later])["stalls"][0]["chamber"] == 3


# --- pressures ------------------------------------------------------------


def test_highest_pressure_is_told_as_a_share_of_the_limit(scene: Scene) -> None:
    limit_Pa = scene.robot.pneumatics.max_chamber_pressure_Pa
    table = telemetry(
        2.0, pressure_1_Pa=0.5 * limit_Pa, pressure_2_Pa=lambda t: np.where(t == 1.0, 1.2, 0.1) * limit_Pa
    )
    assert summary_of(scene, table)["highest_pressure_share"] == pytest.approx(1.2)
    unknown = {f"pressure_{i}_Pa": math.nan for i in range(4)}
    assert summary_of(scene, telemetry(2.0, **unknown))["highest_pressure_share"] is None


# --- faults and detections ------------------------------------------------------------


def fault(t_s: float, chamber: int = 2, kind: str = "rupture") -> dict[str, Any]:
    return {"t_s": t_s, "chamber": chamber, "kind": kind}


@pytest.mark.parametrize(
    ("faults", "found", "delays", "false_alarms", "missed"),
    [
        ([], [], [], 0, 0),
        ([fault(4.0)], [], [], 0, 1),
        ([fault(4.0)], [fault(4.5)], [0.5], 0, 0),
        ([fault(4.0)], [fault(3.5)], [None], 1, 1),  # before it happened
        ([fault(4.0)], [fault(4.5, chamber=1)], [None], 1, 1),  # another chamber
        ([fault(4.0)], [fault(4.5, kind="leak")], [None], 0, 1),  # another kind: misnamed
        ([fault(4.0)], [fault(4.5), fault(5.0)], [0.5, None], 0, 0),  # said twice: no false alarm
        ([fault(4.0), fault(5.0, chamber=0)], [fault(5.2, chamber=0)], [0.2], 0, 1),
        ([fault(4.0), fault(6.0)], [fault(4.1), fault(6.3)], [0.1, 0.3], 0, 0),  # each its own
        ([fault(4.0), fault(6.0)], [fault(4.1)], [0.1], 0, 0),  # the chamber was known to be broken
        ([], [fault(1.0), fault(2.0)], [None, None], 2, 0),
    ],
)
def test_detections_are_matched_to_faults_of_their_chamber_and_kind(
    scene: Scene,
    faults: list[dict[str, Any]],
    found: list[dict[str, Any]],
    delays: list[float | None],
    false_alarms: int,
    missed: int,
) -> None:
    summary = summary_of(scene, telemetry(1.0), faults=faults, detections=found)
    assert [one["delay_s"] for one in summary["detections"]] == [d if d is None else pytest.approx(d) for d in delays]
    assert (summary["false_alarms"], summary["missed_faults"]) == (false_alarms, missed)
    assert summary["faults"] == faults
    assert [
        {k: v for k, v in one.items() if k not in ("delay_s", "judgement")} for one in summary["detections"]
    ] == found


@pytest.mark.parametrize(
    ("broken", "found", "judgement"),
    [
        (fault(4.0), fault(4.5), "right"),
        (fault(4.0), fault(4.5, kind="leak"), "misnamed"),
        (fault(4.0), fault(4.5, chamber=1), "false alarm"),
        (fault(4.0), fault(3.5), "false alarm"),
        (fault(4.0), fault(4.5, chamber=-1, kind="supply_sag"), "misnamed"),
        (fault(4.0, -1, "supply_loss"), fault(4.5, -1, "supply_sag"), "misnamed"),
        (fault(4.0, -1, "supply_loss"), fault(4.5, 1, "blocked_inlet"), "misnamed"),
        (fault(4.0, 3, "lines_swapped"), fault(4.5, 0, "sensor_offset"), "misnamed"),
        (fault(4.0, 3, "lines_swapped"), fault(4.5, 1, "sensor_offset"), "false alarm"),
    ],
)
def test_verdicts_that_something_gave_reason_for_are_no_false_alarms(
    scene: Scene, broken: dict[str, Any], found: dict[str, Any], judgement: str
) -> None:
    """As campaigns count them."""
    summary = summary_of(scene, telemetry(1.0), faults=[broken], detections=[found])
    assert [one["judgement"] for one in summary["detections"]] == [judgement]
    assert (summary["false_alarms"], summary["misnamed"]) == (judgement == "false alarm", judgement == "misnamed")


# --- the file ------------------------------------------------------------


def test_file_is_strict_json_with_null_for_what_is_not_finite(scene: Scene, tmp_path: Path) -> None:
    table = telemetry(8.0, roll_rad=rolled_until(3.0), bend_rad=1.5, angular_momentum_kg_m2_s=math.nan)
    summary = summary_of(scene, table, recoveries=[{"t_s": np.float64(4.0), "strategy": "reverse"}])
    summary["counted"], summary["infinite"] = np.int64(3), math.inf
    assert math.isnan(summary["stalls"][0]["theta_rad"])
    write_summary(tmp_path, summary)
    assert [entry.name for entry in tmp_path.iterdir()] == ["summary.json"]

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    read = json.loads((tmp_path / "summary.json").read_text(), parse_constant=refuse)
    assert read["stalls"][0]["theta_rad"] is None
    assert read["angular_momentum_max_kg_m2_s"] is None
    assert (read["counted"], read["infinite"]) == (3, None)
    assert read["recoveries"] == [{"t_s": 4.0, "strategy": "reverse"}]
    assert read["steps"] == 1000
