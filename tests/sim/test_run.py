"""Open-loop runs, end to end in the segment twin: what is recorded, repeatably, and whatever happens.

How a twin that plays a drive is run in blocks is tried with a made-up one, whose answer is known to the last bit.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim import motion_rows, run
from sim.body import BrokenOff, Motion
from sim.rod_drive import rest_curvature
from sim.run import RunResult, phase_name, simulate
from sim.scene import Scene, scene_from
from sim.telemetry import SHAPE_SCHEMA, read_table, read_telemetry
from sim.trajectory import motion_row
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


# --- in blocks ------------------------------------------------------------


class SteppedTube:
    """A made-up twin: it follows its rest curvature with a lag and turns as that turns. It can be stepped."""

    step_s = 0.0025

    def __init__(self) -> None:
        self.curvature_1_m = np.zeros(2)
        self.turned_rad = 0.0
        self._asked_1_m = np.zeros(2)

    def set_rest(self, strain: np.ndarray, stiffness: np.ndarray) -> None:
        assert stiffness.shape == (3, 3)
        self._asked_1_m = strain[1:].copy()

    def step(self) -> None:
        self.curvature_1_m = self.curvature_1_m + 0.2 * (self._asked_1_m - self.curvature_1_m)
        self.turned_rad += 0.01 * float(np.hypot(*self.curvature_1_m))

    def strain(self) -> np.ndarray:
        return np.array([1.0, *self.curvature_1_m])

    def motion(self) -> Motion:
        c, s = math.cos(self.turned_rad), math.sin(self.turned_rad)
        rotation = np.array([[0.0, 0.0, 1.0], [c, -s, 0.0], [s, c, 0.0]])
        zero, moved = np.zeros(3), np.array([0.0, -0.01 * self.turned_rad, 0.01])
        chord = np.array([1.0, 0.0, 0.0])
        return Motion(rotation, zero, zero, moved, 1.0, self.curvature_1_m.copy(), chord, zero)

    def shape(self) -> tuple[np.ndarray, np.ndarray]:
        return np.full((3, 3), self.turned_rad), np.ones((3, 3))

    def close(self) -> None:
        pass


class PlayedTube(SteppedTube):
    """The same, and it plays a drive by itself."""

    def __init__(self, *, fails_after: int = 10**9, seconds_a_call: float = 0.0) -> None:
        super().__init__()
        self.calls: list[tuple[int, int]] = []
        self.steps = 0
        self._lagged_1_m = np.zeros(2)
        self._fails_after, self._seconds = fails_after, seconds_a_call

    def play(self, drive: np.ndarray, samples: int, steps: int) -> np.ndarray:
        time.sleep(self._seconds)
        self.calls.append((samples, steps))
        rows = np.empty((samples, motion_rows.ROW_SIZE))
        for n in range(samples):
            for _ in range(steps):
                if self.steps == self._fails_after:
                    raise BrokenOff("the tube left its range", rows[:n])
                t_s = self.steps * self.step_s
                self._asked_1_m = np.array(
                    rest_curvature.py_func(drive, t_s, self.step_s, 1.0, *self.curvature_1_m, self._lagged_1_m)
                )
                self.step()
                self.steps += 1
            rows[n] = motion_row(self.motion())
            rows[n, motion_rows.ASLEEP] = float(np.hypot(*self._asked_1_m) == 0.0)
        return rows


@pytest.fixture
def simulate_with(monkeypatch: pytest.MonkeyPatch) -> Callable[..., RunResult]:
    """Run a scene in a given twin."""

    def run_it(twin: Any, scene: Scene, *args: Any, **options: Any) -> RunResult:
        monkeypatch.setattr(run, "make_twin", lambda scene, *, gui=False: twin)
        return simulate(scene, *args, **options)

    return run_it


def played(table: dict[str, Any], duration_s: float = 2.0, **drive: Any) -> Scene:
    """A scene whose numbers fit nowhere: a start, faults and a length between steps and samples."""
    table["drive"] |= {"start_s": 0.613, "ramp_s": 0.311, "period_s": 1.07, **drive}
    table["solver"] = {"twin": "rod", "duration_s": duration_s}
    return make(table)


FAULTS = [
    {"t_s": 0.8, "chamber": 1, "kind": "rupture", "severity": 0.5},
    {"t_s": 0.8137, "chamber": 3, "kind": "blocked_inlet"},
    {"t_s": 0.8138, "chamber": 3, "kind": "leak"},
    {"t_s": 0.8172, "chamber": 0, "kind": "rupture"},
    {"t_s": 1.5, "chamber": 1, "kind": "rupture", "severity": 0.5},
    {"t_s": 99.0, "chamber": 2, "kind": "rupture"},
]


@pytest.mark.parametrize("drive", [{}, {"lag_s": 0.05}, {"lead_rad": 0.8, "lag_s": 0.1, "direction": -1}])
def test_blocks_give_what_single_steps_give(
    scene_table: dict[str, Any], simulate_with: Callable[..., RunResult], tmp_path: Path, drive: dict[str, Any]
) -> None:
    """Faults in the middle of samples, shapes and all; but for what only the one that plays tells of itself."""
    scene_table["fault"] = FAULTS
    scene = played(scene_table, **drive)
    in_blocks = simulate_with(PlayedTube(), scene, tmp_path / "blocks")
    by_steps = simulate_with(SteppedTube(), scene, tmp_path / "steps")
    in_memory = simulate_with(PlayedTube(), scene)
    assert in_blocks.telemetry.num_rows == 200
    for name in by_steps.telemetry.column_names:
        if name == "asleep":
            continue
        expected = np.array(by_steps.telemetry[name].to_pylist())
        np.testing.assert_array_equal(np.array(in_blocks.telemetry[name].to_pylist()), expected)
        np.testing.assert_array_equal(np.array(in_memory.telemetry[name].to_pylist()), expected)
    shapes = [read_table(tmp_path / name, "shape", SHAPE_SCHEMA) for name in ("blocks", "steps")]
    assert shapes[0].equals(shapes[1])
    assert shapes[0].num_rows == 50
    noted = [{key: fault[key] for key in ("t_s", "chamber", "kind")} for fault in FAULTS[:-1]]
    assert in_blocks.summary["faults"] == by_steps.summary["faults"] == noted
    turning = in_blocks.telemetry.filter(in_blocks.telemetry["state"].to_numpy(zero_copy_only=False) == "turning")
    assert turning["bend_rad"].to_numpy().min() < 0.5 * turning["bend_rad"].to_numpy().max()  # the faults do something


def test_fault_acts_from_the_step_at_whose_end_it_is_due(
    scene_table: dict[str, Any], simulate_with: Callable[..., RunResult]
) -> None:
    scene_table["fault"] = [{"t_s": 0.8137, "chamber": 1, "kind": "rupture"}]
    simulate_with(tube := PlayedTube(), played(scene_table))
    before = [samples * steps for samples, steps in tube.calls]
    struck = np.cumsum(before).tolist().index(math.ceil(0.8137 / 0.0025) - 1)  # 325 steps are over
    assert tube.calls[struck : struck + 2] == [(1, 1), (1, 3)]
    assert sum(before) == 800


def test_blocks_are_half_a_second_and_progress_is_told_between_them(
    scene_table: dict[str, Any], simulate_with: Callable[..., RunResult]
) -> None:
    told: list[float] = []
    scene = played(scene_table, 1.7, start_s=0.1, ramp_s=0.1)
    result = simulate_with(tube := PlayedTube(), scene, progress=told.append)
    assert [samples for samples, _ in tube.calls] == [50, 50, 50, 20]
    assert told == pytest.approx([0.5, 1.0, 1.5, 1.7])
    assert result.summary["steps"] == 680
    assert result.telemetry["t_s"].to_numpy() == pytest.approx(0.01 * np.arange(1, 171))


def test_interrupt_is_heard_between_blocks(
    scene_table: dict[str, Any], simulate_with: Callable[..., RunResult], tmp_path: Path
) -> None:
    def interrupt(t_s: float) -> None:
        if t_s > 0.9:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate_with(PlayedTube(), played(scene_table), tmp_path, progress=interrupt)
    assert read_telemetry(tmp_path).num_rows == 100
    assert json.loads((tmp_path / "summary.json").read_text())["sim_time_s"] == pytest.approx(1.0)


@pytest.mark.parametrize(("fails_after", "kept"), [(0, 0), (3, 0), (4 * 77 + 1, 77), (4 * 79 + 2, 79)])
def test_failure_in_a_block_keeps_what_came_before_it(
    scene_table: dict[str, Any],
    simulate_with: Callable[..., RunResult],
    tmp_path: Path,
    fails_after: int,
    kept: int,
) -> None:
    """To the last sample, wherever the block's shapes are."""
    with pytest.raises(SimulationError, match="left its range"):
        simulate_with(PlayedTube(fails_after=fails_after), played(scene_table), tmp_path)
    assert read_telemetry(tmp_path).num_rows == kept
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["outcome"], summary["steps"]) == ("failed: the tube left its range", 4 * kept)


def test_robot_asleep_is_played_in_long_blocks_and_looked_at_again_when_it_bends(
    scene_table: dict[str, Any], simulate_with: Callable[..., RunResult], tmp_path: Path
) -> None:
    scene = played(scene_table, 26.0, start_s=25.3, ramp_s=0.3)
    result = simulate_with(tube := PlayedTube(), scene, tmp_path)
    assert result.summary["asleep_s"] == pytest.approx(25.0, abs=0.02)
    calls = [samples for samples, _ in tube.calls]
    assert max(calls) == 1000
    assert len(calls) < 100 * 1.0 / 4 + 30
    shapes = read_table(tmp_path, "shape", SHAPE_SCHEMA)
    np.testing.assert_allclose(shapes["t_s"].to_numpy(), 0.01 + 0.04 * np.arange(650))
    turned = np.array([shape[0] for shape in shapes["centreline_m"].to_pylist()])
    assert np.all(turned[shapes["t_s"].to_numpy() < 25.0] == 0.0)
    assert np.all(np.diff(turned[-20:]) > 0.0)


def test_step_longer_than_the_control_period_is_a_sample(
    scene_table: dict[str, Any], simulate_with: Callable[..., RunResult], tmp_path: Path
) -> None:
    tube = PlayedTube()
    tube.step_s = 0.02
    told: list[float] = []
    result = simulate_with(tube, played(scene_table), tmp_path, progress=told.append)
    assert result.telemetry["t_s"].to_numpy() == pytest.approx(0.02 * np.arange(1, 101))
    assert result.summary["steps"] == 100
    assert result.summary["sim_time_s"] == pytest.approx(2.0)
    assert {steps for _, steps in tube.calls} == {1}
    assert read_table(tmp_path, "shape", SHAPE_SCHEMA)["t_s"].to_pylist()[:3] == pytest.approx([0.02, 0.06, 0.1])
    assert told == pytest.approx([1.0, 2.0])  # fifty steps a block


def test_clock_counts_playing_alone(scene_table: dict[str, Any], simulate_with: Callable[..., RunResult]) -> None:
    result = simulate_with(PlayedTube(seconds_a_call=0.05), played(scene_table), progress=lambda t_s: time.sleep(0.2))
    assert 0.2 <= result.summary["wall_time_s"] < 0.6


def test_summary_alone_is_that_of_the_whole_run(
    scene_table: dict[str, Any], simulate_with: Callable[..., RunResult]
) -> None:
    scene = played(scene_table)
    whole, alone = (simulate_with(PlayedTube(), scene, record=kept) for kept in ("all", "summary"))
    for key in ("wall_time_s", "real_time_factor"):
        del whole.summary[key], alone.summary[key]
    assert repr(alone.summary) == repr(whole.summary)
    assert alone.telemetry.num_rows == whole.telemetry.num_rows
    assert "command_0_Pa" not in alone.telemetry.column_names


def test_rod_plays_its_drive_and_tells_its_energy(scene_table: dict[str, Any], tmp_path: Path) -> None:
    scene_table["solver"] = {"twin": "rod", "duration_s": 1.5, "step_s": 0.02}
    result = simulate(make(scene_table), tmp_path)
    work, energy, roll = columns(result, "work_J", "energy_J", "roll_rad")
    assert np.all(work[-50:] > 0.0)
    assert 0.0 <= result.summary["energy_gain_J"] < 1e-3 * np.ptp(energy)
    assert roll[-1] < roll[0] - 1.0
    assert read_table(tmp_path, "shape", SHAPE_SCHEMA).num_rows == 38


# --- at rest ------------------------------------------------------------


def test_question_for_the_rest_is_answered_without_a_motion(scene_table: dict[str, Any], tmp_path: Path) -> None:
    scene_table["solver"] = {"twin": "rod", "question": "equilibrium"}
    result = simulate(make(scene_table), tmp_path / "run")
    assert result.summary["bend_rad"] == pytest.approx(12.0 * 0.15, rel=0.1)
    assert result.telemetry.num_rows == 1
