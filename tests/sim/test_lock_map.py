"""The lock map: slow sequences carry the robot along, fast and weak ones slip, and the picture shows it."""

from __future__ import annotations

import importlib
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim.figures import draw
from sim.figures.lock_map import LOCKED, bends_1_m, locked_up_to_Hz
from softbot.errors import InputError, SimulationError
from softbot.robot import load_robot

lock_map = importlib.import_module("sim.figures.lock_map")


def small(path: Path, **options: Any) -> dict[str, Any]:
    return draw(
        "lock-map",
        path,
        {
            "frequencies": 2,
            "pressures": 2,
            "highest_Hz": 8.0,
            "cycles": 2,
            "accuracy": "fast",
            "processes": 1,
            **options,
        },
    )


def test_slow_sequence_locks_and_a_fast_one_slips(tmp_path: Path) -> None:
    drawn = small(tmp_path / "lock.png")
    assert (tmp_path / "lock.png").read_bytes().startswith(b"\x89PNG")
    (weak_slow, weak_fast), (strong_slow, strong_fast) = drawn["revolutions_per_cycle"]
    assert weak_slow == pytest.approx(1.0, abs=0.02)
    assert strong_slow == pytest.approx(1.0, abs=0.02)
    assert 0.0 < weak_fast < strong_fast < 0.7
    assert drawn["locked_up_to_Hz"] == [0.25, 0.25]
    assert (drawn["rolls"], drawn["failed"]) == (4, 0)
    assert drawn["peak_pressures_Pa"] == [60e3, 120e3]
    assert drawn["took_s"] > 0.0


def test_roll_that_fails_is_counted_and_left_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = lock_map.run_many

    def one_fails(scenes: list[Any], processes: int | None) -> list[Any]:
        slow = [scene.drive.period_s > 1.0 for scene in scenes]
        results = real([scene for scene, is_slow in zip(scenes, slow, strict=True) if is_slow], processes)
        return [results.pop(0) if is_slow else SimulationError("blown up") for is_slow in slow]

    monkeypatch.setattr(lock_map, "run_many", one_fails)
    drawn = small(tmp_path / "lock.svg")
    assert [row[1] for row in drawn["revolutions_per_cycle"]] == [None, None]
    assert drawn["failed"] == 2
    assert drawn["locked_up_to_Hz"] == [0.25, 0.25]


def test_locked_is_what_is_locked_at_every_lower_frequency() -> None:
    frequencies = np.array([1.0, 2.0, 3.0])
    assert locked_up_to_Hz(frequencies, np.array([1.0, LOCKED, 0.5])) == 2.0
    assert locked_up_to_Hz(frequencies, np.array([1.0, 1.0, 1.1])) == 3.0
    assert locked_up_to_Hz(frequencies, np.array([0.9, 1.0, 1.0])) is None
    assert locked_up_to_Hz(frequencies, np.array([1.0, math.nan, 1.0])) == 1.0


def test_bend_of_a_pressure_is_that_of_the_actuator_law() -> None:
    robot = load_robot("default")
    bends = bends_1_m(robot, np.array([1.0, 60e3, 120e3]))
    slope_1_m_Pa = abs(robot.actuator_law().equilibrium([0.0] * 4).jacobian[1, 2])
    assert bends[0] == pytest.approx(slope_1_m_Pa, rel=0.1)  # of its neighbour, whose gain differs
    assert bends[2] > 2.0 * bends[1]  # the wall softens as it stretches


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"frequencies": 1}, "a map needs at least 2 of each"),
        ({"lowest_Hz": 9.0}, "must be above 0 and rise"),
        ({"cycles": 0}, "at least one has to be measured"),
        ({"robot": "nowhere.toml"}, "nowhere.toml"),
    ],
)
def test_map_without_a_meaning_is_refused(tmp_path: Path, options: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        small(tmp_path / "lock.png", **options)
