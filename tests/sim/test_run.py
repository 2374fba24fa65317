"""Open-loop runs, end to end in the segment twin: what is recorded, repeatably, and whatever happens."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim import run
from sim.run import RunResult, phase_name, simulate
from sim.scene import Scene, scene_from
from sim.telemetry import read_telemetry
from softbot.errors import InputError, SimulationError
from softbot.sensing import Readings

DEAD_RUPTURE = {"t_s": 0.25, "chamber": 0, "kind": "rupture"}


class Proportional:
    """The simplest valve controller there is."""

    def openings(self, setpoint_Pa: np.ndarray, readings: Readings) -> np.ndarray:
        return np.clip((setpoint_Pa - readings.pressure_Pa) / 10e3, -1.0, 1.0)


def make(table: dict[str, Any]) -> Scene:
    return scene_from(table, "short.toml", Path())


@pytest.fixture
def pressed_table(scene_table: dict[str, Any]) -> dict[str, Any]:
    """The short scene, driven by pressure, some way below the robot's limit."""
    limit_Pa = make({**scene_table, "drive": {"kind": "curvature", "curvature_1_m": 1.0}}).robot.max_pressure_Pa
    drive = {"kind": "pressure", "peak_pressure_Pa": 0.4 * limit_Pa, "period_s": 1.0, "start_s": 0.2, "ramp_s": 0.2}
    return {**scene_table, "drive": drive}


def columns(result: RunResult, *names: str) -> list[np.ndarray]:
    return [result.telemetry[name].to_numpy() for name in names]


# --- given curvature ------------------------------------------------------------


def test_given_curvature_is_bent_by_the_start_and_then_turned(scene_table: dict[str, Any]) -> None:
    told: list[float] = []
    result = simulate(make(scene_table), progress=told.append)
    t_s, bend, roll = columns(result, "t_s", "bend_rad", "roll_rad")
    np.testing.assert_allclose(t_s, 0.01 * np.arange(1, 51))
    assert bend[-1] == pytest.approx(12.0 * 0.15, rel=0.1)
    assert roll[-1] < roll[0] - 0.5  # direction +1 rolls negatively
    states = result.telemetry["state"].to_pylist()
    assert [states[0], states[9], states[30]] == ["bending", "bending", "turning"]
    assert told == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5])
    assert result.summary["steps"] == 100
    assert result.summary["sim_time_s"] == pytest.approx(0.5)
    assert 0.0 < result.summary["wall_time_s"] < 60.0
    assert result.summary["outcome"] == "done"


def test_theta_leads_the_bend_that_lags_behind_its_command(scene_table: dict[str, Any]) -> None:
    theta, t_s = columns(simulate(make(scene_table)), "theta_rad", "t_s")
    turning = theta[t_s > 0.3]
    assert np.all(np.abs(turning) > 0.5 * math.pi)  # the active side is the outer one


@pytest.mark.parametrize("ground", ["plane", "none"])
def test_same_scene_and_seed_give_the_same_bytes(scene_table: dict[str, Any], tmp_path: Path, ground: str) -> None:
    scene_table["world"] = {"ground": ground}
    scene_table["solver"]["duration_s"] = 0.3
    for name in ("one", "two"):
        simulate(make(scene_table), tmp_path / name)
    for file in ("telemetry.parquet", "shape.parquet", "scene.toml"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


# --- given pressures ------------------------------------------------------------


def test_given_pressures_reach_the_chambers_and_bend_the_robot(pressed_table: dict[str, Any]) -> None:
    result = simulate(make(pressed_table), valves=Proportional())
    pressure, command, bend = columns(result, "pressure_2_Pa", "command_2_Pa", "bend_rad")
    peak_Pa = pressed_table["drive"]["peak_pressure_Pa"]
    assert command.max() == pytest.approx(peak_Pa, rel=1e-2)
    assert pressure.max() == pytest.approx(peak_Pa, rel=0.25)
    assert bend.max() > 0.2
    assert result.telemetry["supply_Pa"].to_numpy().min() > peak_Pa


def test_faults_are_recorded_when_they_strike_and_act(pressed_table: dict[str, Any]) -> None:
    pressed_table["fault"] = [DEAD_RUPTURE, {"t_s": 99.0, "chamber": 1, "kind": "leak"}]
    broken = simulate(make(pressed_table), valves=Proportional())
    assert broken.summary["faults"] == [{"t_s": 0.25, "chamber": 0, "kind": "rupture"}]
    assert broken.summary["missed_faults"] == 1
    (lost,) = columns(broken, "pressure_0_Pa")
    assert np.all(np.abs(lost[-10:]) < 0.2 * pressed_table["drive"]["peak_pressure_Pa"])


def test_noise_is_drawn_from_the_seed(pressed_table: dict[str, Any]) -> None:
    pressed_table["solver"]["duration_s"] = 0.25
    same = [simulate(make(pressed_table), valves=Proportional()).telemetry for _ in range(2)]
    assert same[0].equals(same[1])
    pressed_table["solver"]["seed"] = 1
    assert not simulate(make(pressed_table), valves=Proportional()).telemetry.equals(same[0])


# --- whatever happens ------------------------------------------------------------


def test_failed_run_keeps_its_record_and_says_why(scene_table: dict[str, Any], tmp_path: Path) -> None:
    scene_table["drive"]["curvature_1_m"] = 41.0  # a full circle in two segments: one joint by half a turn
    scene_table["solver"].update(segments=2, duration_s=2.0)
    with pytest.raises(SimulationError, match="left its range"):
        simulate(make(scene_table), tmp_path)
    kept = read_telemetry(tmp_path)
    assert 2 < kept.num_rows < 200
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["outcome"].startswith("failed: the segment twin left its range")
    assert summary["sim_time_s"] == pytest.approx(kept["t_s"].to_pylist()[-1])
    assert summary["steps"] == kept.num_rows * 2


def test_interrupted_run_keeps_its_record(scene_table: dict[str, Any], tmp_path: Path) -> None:
    def interrupt(t_s: float) -> None:
        if t_s > 0.15:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(make(scene_table), tmp_path, progress=interrupt)
    assert read_telemetry(tmp_path).num_rows == 20
    assert json.loads((tmp_path / "summary.json").read_text())["outcome"] == "interrupted"


def test_twin_is_closed_whatever_happens(scene_table: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    closed: list[bool] = []
    real = run.make_twin

    def watched(scene: Scene, *, gui: bool = False) -> Any:
        twin = real(scene, gui=gui)
        monkeypatch.setattr(twin, "close", lambda close=twin.close: (close(), closed.append(True)), raising=True)
        return twin

    monkeypatch.setattr(run, "make_twin", watched)
    scene_table["drive"] = {"kind": "pressure", "peak_pressure_Pa": 10.0}
    with pytest.raises(InputError, match="needs a valve controller"):
        simulate(make(scene_table))
    assert closed == [True]


def test_sequencer_scene_is_not_run_here(scene_table: dict[str, Any]) -> None:
    scene_table["drive"] = {"kind": "sequencer"}
    with pytest.raises(InputError, match=r"is run by softbot\.nodes"):
        simulate(make(scene_table))


def test_phases_have_names(scene_table: dict[str, Any]) -> None:
    scene_table["drive"].update(start_s=1.0, ramp_s=0.5)
    scene = make(scene_table)
    assert [phase_name(scene, t) for t in (0.2, 0.7, 1.0)] == ["straight", "bending", "turning"]


def test_a_rupture_takes_its_part_of_a_given_curvature(scene_table: dict[str, Any]) -> None:
    scene_table["fault"] = [{"t_s": 0.2, "chamber": 2, "kind": "rupture"}]
    held = {"period_s": 1e4, "start_s": 0.2, "ramp_s": 0.1}  # towards chamber 0, which is chamber 2's work
    scene_table["drive"] |= held
    broken = simulate(make(scene_table))
    assert broken.summary["faults"] == [{"t_s": 0.2, "chamber": 2, "kind": "rupture"}]
    (bend,) = columns(broken, "bend_rad")
    assert bend[15] > 0.5
    assert bend[-1] < 0.5 * bend[15]
