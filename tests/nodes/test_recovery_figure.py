"""The picture of the paper's experiment is drawn from runs in which it happens."""

from __future__ import annotations

import importlib
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim.figures import draw, figures
from softbot.errors import InputError

PACKAGES = ("sim.figures", "softbot.nodes.figures")
recovery = importlib.import_module("softbot.nodes.figures.recovery")


def drawn(path: Path, **options: Any) -> dict[str, Any]:
    return draw("recovery", path, options, PACKAGES)


def test_the_robot_stops_at_a_quarter_turn_without_recovery_and_rolls_on_with_it(tmp_path: Path) -> None:
    shown = drawn(tmp_path / "r.png", accuracy="fast", duration_s=8)
    assert (tmp_path / "r.png").read_bytes().startswith(b"\x89PNG")
    assert abs(shown["stall_theta_rad"]) == pytest.approx(math.pi / 2, abs=0.1)
    assert 4.0 < shown["stall_t_s"] < 7.0
    assert shown["reversals"] >= 1
    assert min(shown["rolled_before_rev"], shown["rolled_after_rev"]) > 0.3


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"fault_s": 1.0}, "two seconds of rolling"),
        ({"fault_s": 10.0}, "two seconds of rolling"),
        ({"command": "up"}, 'rolls "left" or "right"'),
        ({"chamber": 4}, "chamber"),
        ({"robot": "nowhere.toml"}, r"nowhere\.toml"),
    ],
)
def test_what_no_run_can_show_is_refused(tmp_path: Path, options: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        drawn(tmp_path / "r.png", **options)
    assert not (tmp_path / "r.png").exists()


class Recorded:
    """A recording of ten seconds of which only states, bend and direction matter."""

    def __init__(self, spans: list[tuple[float, float]]) -> None:
        self.t_s = np.linspace(0.0, 10.0, 1001)
        self.columns = {"bend_rad": np.ones(1001), "bend_direction_rad": np.full(1001, -3.0)}
        self.spans = spans

    def state_spans(self) -> list[tuple[float, float, str]]:
        return [(start, end, "reversing") for start, end in self.spans]


@pytest.mark.parametrize("spans", [[], [(4.0, 4.3)], [(4.0, 4.3), (6.0, 6.2)], [(9.5, 10.0)]])
def test_there_are_poses_for_any_number_of_reversals(spans: list[tuple[float, float]]) -> None:
    times_s = recovery.pose_times(Recorded(spans), 3.0)
    assert len(times_s) == recovery.POSES
    assert times_s[0] == 2.0
    assert np.all(np.diff(times_s) >= 0.0)
    assert times_s[-1] <= 10.0


def test_the_angle_of_a_chamber_is_counted_from_the_inner_side() -> None:
    straight = Recorded([])
    straight.columns["bend_rad"][:500] = 0.0
    angle = recovery.dead_chamber_angle_rad(straight, 3)
    assert np.isnan(angle[:500]).all()
    np.testing.assert_allclose(angle[500:], 1.5 * math.pi + 3.0 - 2.0 * math.pi)


def test_figures_of_both_houses_are_listed() -> None:
    assert {"moments", "recovery"} <= set(figures(PACKAGES))
    assert "recovery" not in figures()
