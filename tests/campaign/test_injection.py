"""Fault-injection tests in a few lines, as the documentation shows them."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers.interface import Order, SequencerOutput, SequencerState
from sim.scene import load_scene
from softbot.campaign.injection import inject
from softbot.errors import InputError, SimulationError
from softbot.robot import load_robot
from softbot.sensing import Readings

ROOT = Path(__file__).parents[2]
SHORT = ("solver.duration_s=3", "sequencer.start_s=0.1")


class Still:
    """A sequencer that holds the C, finds nothing, and keeps count of what it was told."""

    def __init__(self, fails_at_s: float = np.inf) -> None:
        self.orders: list[Order] = []
        self.updates = 0
        self._fails_at_s = fails_at_s

    def order(self, order: Order, t_s: float) -> None:
        self.orders.append(order)

    def armed(self, is_armed: bool) -> None:
        self._armed = is_armed

    def update(self, t_s: float, readings: Readings) -> SequencerOutput:
        self.updates += 1
        if t_s > self._fails_at_s:
            raise ZeroDivisionError("mine")
        return SequencerOutput(np.array([30e3, 0.0, 0.0, 0.0]), SequencerState.ROLLING, bool(self.orders))


def test_the_example_of_the_documentation_passes(tmp_path: Path) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "campaign.md").read_text(), re.DOTALL)
    (tmp_path / "test_mine.py").write_text(example)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "softbot.campaign.pytest_plugin", "test_mine.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "6 passed" in done.stdout


def test_a_sequencer_that_notices_nothing_is_seen_to_notice_nothing() -> None:
    mine = Still()
    run = inject("rupture", chamber=0, at_s=1.5, settings=SHORT, sequencer=mine)
    assert (run.found, run.named, run.named_right, run.delay_s) == (False, None, False, None)
    assert mine.updates == 300
    assert len(mine.orders) == 1
    assert run.highest_pressure_share > 0.1
    assert run.row["fault_0_kind"] == "rupture"


def test_a_sequencer_that_raises_is_a_failed_run() -> None:
    with pytest.raises(SimulationError, match=r"the sequencer failed at t = 1\.01 s: mine"):
        inject(settings=SHORT, sequencer=Still(fails_at_s=1.0))


def test_over_a_bus_and_without_one_the_same_is_found() -> None:
    from controllers.sequencer import Sequencer
    from controllers.sequencer_parts import SequencerConfig

    fault: dict[str, Any] = {"chamber": 3, "at_s": 1.5, "settings": ("solver.duration_s=5", "sequencer.start_s=0.1")}
    direct = inject("stuck_open", **fault)
    on_bus = inject("stuck_open", **fault, sequencer=Sequencer(SequencerConfig(load_robot("default"))))
    assert direct.named == on_bus.named == ("stuck_open", 3)
    assert direct.named_right
    for name in direct.row.keys() - {
        "heading_drift_rad",
        "moved_along_m",
        "moved_left_m",
    }:  # of the middle, not the mass
        value = direct.row[name]
        if isinstance(value, float):
            assert on_bus.row[name] == pytest.approx(value, rel=1e-5, abs=1e-6), name
        else:
            assert on_bus.row[name] == value, name


def test_scenes_and_further_faults_are_taken() -> None:
    scene = load_scene(ROOT / "scenes" / "damaged.toml", ("fault=[]", *SHORT))
    run = inject("leak", chamber=1, at_s=2.0, more=[{"t_s": 1.0, "kind": "payload", "severity": 0.2}], scene=scene)
    assert (run.row["fault_0_kind"], run.row["fault_1_kind"], run.row["faults"]) == ("payload", "leak", 2)
    healthy = inject(scene=scene)
    assert (healthy.row["faults"], healthy.found, healthy.false_alarms) == (0, False, 0)
    assert healthy.speed_kept is None


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"kind": "gremlin"}, "gremlin"),
        ({"kind": "rupture"}, "chamber"),
        ({"chamber": 2}, "of which fault"),
        ({"kind": "rupture", "chamber": 7}, "from 0 to 3"),
        ({"kind": "leak", "chamber": 1, "severity": float("nan")}, "severity"),
        ({"scene": "nowhere.toml"}, "nowhere.toml"),
        ({"scene": ROOT / "scenes" / "slow_roll.toml"}, "has no sequencer to test"),
        ({"settings": ["speed=3"]}, "speed"),
    ],
)
def test_what_cannot_be_injected_is_refused(arguments: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        inject(**arguments)
