"""Scene files: defaults, overrides, robots by name, there and back, and refusals that name the mend."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sim.scene import Scene, load_scene, sample_period_s, scene_from, steps_per_period
from softbot.errors import InputError
from softbot.faults import Fault, FaultKind
from softbot.toml_file import write_toml

SCENES = Path(__file__).parents[2] / "scenes"
RUPTURE = {"t_s": 4.0, "chamber": 2, "kind": "rupture", "severity": 0.5}


def make(table: dict[str, Any], *assignments: str) -> Scene:
    return scene_from(table, "scene.toml", Path(), assignments)


def pressed(table: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {**table, "drive": {"kind": "pressure", "peak_pressure_Pa": 1e3}, **more}


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.toml")), ids=lambda path: path.stem)
def test_every_shipped_scene_is_valid_and_named_after_its_file(path: Path) -> None:
    assert load_scene(path).name == path.stem


def test_left_out_tables_have_the_defaults_of_the_design(robot_table: dict[str, Any]) -> None:
    scene = make({"robot": robot_table, "drive": {"kind": "curvature", "curvature_1_m": 12.0}})
    assert (scene.drive.period_s, scene.drive.direction, scene.drive.start_s, scene.drive.ramp_s) == (2.0, 1, 1.0, 0.5)
    assert (scene.world.gravity_m_s2, scene.world.ground, scene.world.friction_law) == (9.81, "plane", "coulomb")
    assert (scene.solver.twin, scene.solver.accuracy, scene.solver.seed) == ("rod", "standard", 0)
    assert scene.fault == ()
    assert scene.sequencer.recovery


def test_faults_are_those_of_the_fault_library(scene_table: dict[str, Any]) -> None:
    scene = make(pressed(scene_table, fault=[RUPTURE, {"t_s": 1, "chamber": 0, "kind": "sensor_stuck"}]))
    assert scene.fault == (Fault(4.0, 2, FaultKind.RUPTURE, 0.5), Fault(1.0, 0, FaultKind.SENSOR_STUCK))


@pytest.mark.parametrize(
    ("assignments", "expected_s"),
    [
        ((), 0.2 + 2 * 1.0),
        (("drive.start_s=3", "drive.period_s=4"), 11.0),
        (("metrics.steady_after_s=0.25",), 0.25),
        (('drive.kind="sequencer"', "sequencer.start_s=0.7"), 2.7),
    ],
)
def test_steady_from_two_cycles_after_the_start_unless_stated(
    scene_table: dict[str, Any], assignments: tuple[str, ...], expected_s: float
) -> None:
    assert make(scene_table, *assignments).steady_after_s == pytest.approx(expected_s)


# --- there and back ------------------------------------------------------------


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=30)
@given(
    curvature=st.floats(0.0, 40.0),
    period_s=st.floats(1e-3, 1e5),
    direction=st.sampled_from([1, -1]),
    seed=st.integers(0, 2**63 - 1),
    twin=st.sampled_from(["rod", "bullet"]),
)
def test_scene_written_out_in_full_is_the_same_scene(
    tmp_path: Path,
    scene_table: dict[str, Any],
    curvature: float,
    period_s: float,
    direction: int,
    seed: int,
    twin: str,
) -> None:
    scene_table["drive"] = {
        "kind": "curvature", "curvature_1_m": curvature, "period_s": period_s, "direction": direction
    }  # fmt: skip
    scene_table["solver"] = {"twin": twin, "seed": seed, "duration_s": 3.0}
    scene = make(scene_table)
    path = tmp_path / "scene.toml"
    write_toml(path, scene.table())
    assert load_scene(path) == scene


def test_faults_and_robot_survive_the_way_through_a_file(tmp_path: Path, scene_table: dict[str, Any]) -> None:
    scene = make(pressed(scene_table, robot="default", fault=[RUPTURE]))
    path = tmp_path / "scene.toml"
    write_toml(path, scene.table())
    assert load_scene(path) == scene


# --- robots by name, overrides ------------------------------------------------------------


def test_robot_is_read_from_the_scenes_folder_and_overrides_reach_into_it(
    tmp_path: Path, scene_table: dict[str, Any], robot_table: dict[str, Any]
) -> None:
    (tmp_path / "robots").mkdir()
    write_toml(tmp_path / "robots" / "long.toml", {**robot_table, "length_m": 0.3})
    path = tmp_path / "scene.toml"
    write_toml(path, {**scene_table, "robot": "robots/long.toml"})
    assert load_scene(path).robot.length_m == 0.3
    assert load_scene(path, ("robot.mass_kg=0.2",)).robot.mass_kg == 0.2
    write_toml(path, scene_table)
    assert load_scene(path, ("robot=robots/long.toml", "robot.mass_kg=0.2")).robot.length_m == 0.3
    assert load_scene(path, ('robot="robots/long.toml"',)).robot.length_m == 0.3


def test_wrong_robot_file_is_named_itself(tmp_path: Path, scene_table: dict[str, Any]) -> None:
    write_toml(tmp_path / "bad.toml", {"length_m": 0.15})
    write_toml(tmp_path / "scene.toml", {**scene_table, "robot": "bad.toml"})
    with pytest.raises(InputError) as refusal:
        load_scene(tmp_path / "scene.toml")
    assert all(line.startswith(str(tmp_path / "bad.toml")) for line in str(refusal.value).splitlines())
    with pytest.raises(InputError, match=r"nowhere\.toml: no such file"):
        load_scene(tmp_path / "scene.toml", ("robot=nowhere.toml",))


# --- refusals ------------------------------------------------------------


def test_an_undamped_robot_that_leads_itself_afloat_is_refused(scene_table: dict[str, Any]) -> None:
    endless = ("world.ground=none", "drive.lag_s=0.1", "robot.damping_time_s=0")
    with pytest.raises(InputError, match="would spin up without end"):
        make(scene_table, *endless, "drive.lead_rad=2")
    assert make(scene_table, *endless, "drive.lead_rad=1").drive.lead_rad == 1.0


@pytest.mark.parametrize(
    ("assignment", "says"),
    [
        ("drive.period_s=0", "drive.period_s = 0: input should be greater than or equal to"),
        ("drive.period_ms=5", "drive.period_ms: unknown key; did you mean period_s? (mind the unit)"),
        (
            "drive.kind=wind",
            "drive.kind = 'wind': input should be 'curvature', 'contraction', 'pressure' or 'sequencer'",
        ),
        ("drive.kind=pressure", "peak_pressure_Pa: missing"),
        ("drive.direction=2", "drive.direction = 2: input should be 1 or -1"),
        ("drive.curvature_1_m=50", "more than a full circle; at most 41.9"),
        ("drive.curvature_1_m=-1", "drive.curvature_1_m = -1"),
        ("robot.radius_m=0.07", "inner side would fold; stay below 1/radius_m"),
        ("world.friction=20", "a Coulomb coefficient is 0 … 10"),
        ("world.ground=ice", "world.ground = 'ice': input should be 'plane', 'step', 'pipe' or 'none'"),
        ("world.gravity=3", "did you mean gravity_m_s2? (mind the unit)"),
        ("solver.twin=mujoco", "solver.twin = 'mujoco'"),
        ("solver.duration_s=nan", "solver.duration_s = nan: input should be a finite number"),
        ("solver.seed=1.5", "solver.seed = 1.5: input should be a valid integer"),
        ("solver.segments=1", "solver.segments = 1"),
        ("metrics.steady_after_s=50", "metrics.steady_after_s = 50: not before the end at solver.duration_s = 0.5"),
        ("sequencer.comand=left", "did you mean command?"),
        ("fault={t_s=1, chamber=1, kind='leak'}", "list of tables, each under [[fault]]"),
        ("worlds=1", "worlds: unknown key; did you mean world?"),
    ],
)
def test_wrong_scene_is_refused_by_file_key_value_and_mend(
    scene_table: dict[str, Any], assignment: str, says: str
) -> None:
    scene_table["drive"]["curvature_1_m"] = 20.0
    with pytest.raises(InputError) as refusal:
        make(scene_table, assignment)
    assert all(line.startswith("scene.toml: ") for line in str(refusal.value).splitlines())
    assert says in str(refusal.value)


@pytest.mark.parametrize(
    ("fault", "says"),
    [
        ({**RUPTURE, "chamber": 4}, "fault.chamber = 4"),
        ({**RUPTURE, "kind": "explosion"}, "fault.0.kind = 'explosion': input should be 'rupture'"),
        ({**RUPTURE, "t_s": -1.0}, "fault.t_s = -1.0"),
        ({**RUPTURE, "severity": 2.0}, "fault.severity = 2.0"),
        ({"t_ms": 1, "chamber": 1, "kind": "leak"}, "fault.0.t_ms: unknown key; did you mean t_s? (mind the unit)"),
        ({"chamber": 1, "kind": "leak"}, "fault.0.t_s: missing; add it"),
        (3, "fault.0 = 3: input should be a table"),
    ],
)
def test_wrong_fault_is_refused(scene_table: dict[str, Any], fault: Any, says: str) -> None:
    with pytest.raises(InputError) as refusal:
        make(pressed(scene_table, fault=[fault]))
    assert str(refusal.value).startswith("scene.toml: ")
    assert says in str(refusal.value)


def test_what_does_not_go_together_is_refused(scene_table: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="above the robot's limit"):
        make(pressed(scene_table), "drive.peak_pressure_Pa=1e7")
    with pytest.raises(InputError, match="above the robot's limit"):
        make(pressed(scene_table), "drive.co_contraction_Pa=1e7")
    with pytest.raises(InputError, match=r"curvature_1_m: missing; drive\.kind = \"curvature\" needs it"):
        make({**scene_table, "drive": {"kind": "curvature"}})
    with pytest.raises(InputError, match="the sequencer rolls on a floor"):
        make(scene_table, 'drive.kind="sequencer"', 'world.ground="none"')
    limit = make(pressed(scene_table)).robot.max_pressure_Pa
    assert make(pressed(scene_table), f"drive.peak_pressure_Pa={0.99 * limit}").drive.peak_pressure_Pa < limit
    assert math.isfinite(limit)


@pytest.mark.parametrize(("step_s", "sample_s"), [(0.02, 0.02), (0.05, 0.05), (0.01, 0.01), (0.0025, 0.01)])
def test_step_of_whole_control_periods_is_a_sample(step_s: float, sample_s: float) -> None:
    assert sample_period_s(step_s) == sample_s
    assert steps_per_period(step_s) * step_s == pytest.approx(sample_s)


@pytest.mark.parametrize("kind", ["pressure", "sequencer"])
def test_valves_are_commanded_in_every_control_period(scene_table: dict[str, Any], kind: str) -> None:
    scene_table["solver"] = {"twin": "rod", "step_s": 0.02}
    assert scene_from(scene_table, "s.toml", Path()).solver.step_s == 0.02
    scene_table["drive"] = {"kind": kind, "peak_pressure_Pa": 10.0}
    with pytest.raises(InputError, match=r"step_s = 0\.02: longer than the control period of 0\.01 s"):
        scene_from(scene_table, "s.toml", Path())
