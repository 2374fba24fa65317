"""Tables with time: trials found, gaps kept out, the clock checked."""

from pathlib import Path

import numpy as np
import pytest

import calib
from calib.recording import is_recording, trials_of
from calib.table import read_rows
from softbot.errors import InputError

SERIES = Path(calib.__file__).parent / "data" / "asu_four_chamber_arm" / "series.csv"
HEAD = "t_s,pressure_0_kPa,bend_deg"


def table(tmp_path: Path, rows: list[str], header: str = HEAD):
    path = tmp_path / "series.csv"
    path.write_text("\n".join([header, *rows]), encoding="utf-8")
    return read_rows(path)


def step(extra: str = "", start_s: float = 0.0) -> list[str]:
    """10 s at 20 Hz: 80 kPa from 1 s on, and a bend that follows."""
    t = np.arange(0.0, 10.0, 0.05)
    pressure = np.where(t > 1.0, 80.0, 5.0)
    bend = np.where(t > 1.0, 30.0 * (1.0 - np.exp(-(t - 1.0))), 0.0)
    return [f"{start_s + a:.2f},{p:g},{b:.3f}{extra}" for a, p, b in zip(t, pressure, bend, strict=True)]


def test_shipped_recording_has_four_trials_with_their_gaps() -> None:
    trials, notes = trials_of(read_rows(SERIES))
    assert [one.name for one in trials] == ["apr4_1", "apr4_2", "apr4_3", "apr4_4"]
    assert [one.driven for one in trials] == [(0,), (2,), (2,), (0,)]
    assert trials[0].gaps == 58
    assert notes == []
    for one in trials:
        away = np.array([-1.0, 0.0]) if one.driven == (0,) else np.array([1.0, 0.0])
        assert one.direction @ away > 0.99  # a chamber bends the robot away from itself
        assert 33.0 < np.degrees(one.full_scale_rad) < 44.0
        assert one.bend_rad[0] == pytest.approx(0.0, abs=0.01)
    assert np.degrees(trials[3].start_bend_rad[0]) == pytest.approx(10.35, abs=0.1)


def test_grid_is_fine_where_pressures_move_and_coarse_in_holds() -> None:
    for one in trials_of(read_rows(SERIES))[0]:
        gaps = np.diff(one.grid_s)
        assert len(one.grid_s) < 0.4 * one.grid_s[-1] / 0.025
        moving = (
            np.max(np.abs(np.diff(one.pressure_Pa[:, one.driven[0]])))
            / gaps[np.argmax(np.abs(np.diff(one.pressure_Pa[:, one.driven[0]])))]
        )
        assert moving > 5e4
        assert np.max(gaps) <= 0.5 + 1e-9
        assert np.min(gaps) >= 0.02


def test_few_rows_with_time_are_no_recording(tmp_path: Path) -> None:
    assert not is_recording(table(tmp_path, step()[:20]))
    assert is_recording(table(tmp_path, step()))
    holds = [f"{60 * n},{10 * n},{4 * n}" for n in range(1, 41)]
    assert not is_recording(table(tmp_path, holds))


def test_flagged_and_missing_bends_are_gaps(tmp_path: Path) -> None:
    rows = step(",1")
    for n in range(50, 80):
        t, p, _, _ = rows[n].split(",")
        rows[n] = f"{t},{p},999,0" if n % 2 else f"{t},{p},,1"
    (one,), _ = trials_of(table(tmp_path, rows, HEAD + ",valid"))
    assert one.gaps == 30
    assert np.degrees(one.full_scale_rad) < 31.0


def test_a_clock_that_restarts_begins_a_trial(tmp_path: Path) -> None:
    trials, notes = trials_of(table(tmp_path, step() + step()))
    assert len(trials) == 2
    assert any("the clock restarts" in note for note in notes)


def test_a_clock_that_jumps_about_is_refused(tmp_path: Path) -> None:
    rows = step()
    mixed = [rows[i] for i in np.random.default_rng(0).permutation(len(rows))]
    with pytest.raises(InputError, match=r"line \d+: the time goes backwards, .* times in all; sort the rows"):
        trials_of(table(tmp_path, mixed))


def test_rows_of_the_same_time_are_left_out_and_said(tmp_path: Path) -> None:
    rows = step()
    (one,), notes = trials_of(table(tmp_path, rows[:50] + rows[49:]))
    assert len(one.t_s) == 200
    assert any("1 rows of the same time" in note for note in notes)


def test_a_hole_in_time_is_said(tmp_path: Path) -> None:
    rows = step()
    _, notes = trials_of(table(tmp_path, rows[:80] + rows[140:]))
    assert any("3.1 s without rows at 4.0 s" in note or "3.0 s without rows at" in note for note in notes)


def test_trials_that_do_not_move_are_left_out(tmp_path: Path) -> None:
    still = [f"{0.05 * n:.2f},5,0.1" for n in range(100)]
    rows = [f"{row},a" for row in step()] + [f"{row},b" for row in still]
    trials, notes = trials_of(table(tmp_path, rows, HEAD + ",trial"))
    assert [one.name for one in trials] == ["a"]
    assert any("trial b left out" in note for note in notes)
    with pytest.raises(InputError, match="no trial moves"):
        trials_of(table(tmp_path, still))


def test_sizes_of_two_opposite_chambers_together_need_a_direction(tmp_path: Path) -> None:
    rows = [",".join([*row.split(",")[:2], row.split(",")[1], row.split(",")[2]]) for row in step()]
    with pytest.raises(InputError, match="add bend_direction_deg"):
        trials_of(table(tmp_path, rows, "t_s,pressure_0_kPa,pressure_2_kPa,bend_deg"))
