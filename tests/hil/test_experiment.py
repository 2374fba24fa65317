"""The paper's experiment for a minute, its two ends two processes on vcan at 100 Hz: in time, and as in lock-step."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from sim.scene import Scene
from sim.telemetry import read_telemetry
from softbot.nodes.lockstep import run_lockstep

DURATION_S, FAULT_S = 60, 20
SCENE = Path(__file__).parents[2] / "scenes" / "damaged.toml"
SETTINGS = (f"solver.duration_s={DURATION_S}", f"fault.0.t_s={FAULT_S}")
SOFTBOT = "import sys; from softbot.cli import main; sys.argv = ['softbot', *sys.argv[1:]]; main()"


def softbot(command: str, *options: str) -> subprocess.Popen[str]:
    """`softbot COMMAND` on vcan0 as a process; it prints one JSON object."""
    settings = [word for setting in SETTINGS for word in ("--set", setting)]
    bus = ["--interface", "socketcan", "--channel", "vcan0", "--real-time", "--json"]
    return subprocess.Popen(
        [sys.executable, "-c", SOFTBOT, command, str(SCENE), *settings, *bus, *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"TERM": "dumb"},
    )


def test_a_minute_of_rolling_rupture_and_recovery(
    damaged_scene: Callable[..., Scene], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    expected = run_lockstep(damaged_scene(*SETTINGS)).summary
    sequencer = softbot("sequence")
    assert sequencer.stderr is not None
    assert "waiting for the board" in sequencer.stderr.readline()
    plant = softbot("plant", "--out", str(tmp_path / "run"))
    printed, said = plant.communicate(timeout=DURATION_S + 120)
    assert plant.returncode == 0, said
    summary: dict[str, Any] = json.loads(printed)
    printed, said_too = sequencer.communicate(timeout=60)  # the plant is gone: the link fails, and says so
    sequenced: dict[str, Any] = json.loads(printed)
    assert sequenced["link_failure"] in ("measurements_missing", "board_silent"), said_too

    told = [line for line in (said + said_too).splitlines() if "cycles of" in line or "acted on" in line]
    result = ", ".join(f"{one['total_revolutions']:+.3f}" for one in (summary, expected))
    with capsys.disabled():
        print("\n" + "\n".join(told) + f"\nrevolutions over vcan and in lock-step: {result}")
    assert (summary["outcome"], summary["sim_time_s"]) == ("done", DURATION_S)
    assert [(one["chamber"], one["kind"]) for one in summary["detections"]] == [(1, "rupture")]
    assert [one["strategy"] for one in summary["recoveries"]] == ["curvature_reversal"]
    assert (summary["false_alarms"], summary["missed_faults"]) == (0, 0)
    assert summary["total_revolutions"] == pytest.approx(expected["total_revolutions"], rel=0.03)
    assert summary["displacement_m"][1] == pytest.approx(expected["displacement_m"][1], rel=0.03)

    states = read_telemetry(tmp_path / "run").column("state").to_pylist()
    assert {"rolling", "reversing", "degraded"} <= set(states)
    timing = json.loads((tmp_path / "run" / "timing.json").read_text())
    for loop in (timing["loop"], sequenced["timing"]["loop"]):
        assert loop["p99_lateness_s"] <= 0.005
    for link in (timing["link"], sequenced["timing"]["link"]):
        assert (link["lost"], link["refused"]) == (0, 0)
    assert timing["link"]["received"] >= 100 * (DURATION_S - 1)
    assert timing["link"]["longest_gap_s"] < 0.05
