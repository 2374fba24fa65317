"""`softbot plant` and `softbot sequence`, each alone on a virtual bus; together they are tested with the nodes."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

from controllers.interface import Detection, Offer, Recovery, SequencerState
from firmware_protocol.c_board import CBoardRules
from firmware_protocol.enumerations import BoardMode
from firmware_protocol.sequencer_link import LinkFailure, SequencerLink
from softbot.cli.sequence import Narrator
from softbot.nodes import wall_clock
from softbot.nodes.fixed_rate import FixedRate
from softbot.nodes.message_meter import MessageMeter
from softbot.nodes.wall_clock import RealTime, SequencerRun

VIRTUAL = ("--interface", "virtual", "--channel", "cli-bus-commands")


def test_a_plant_runs_for_the_scenes_time_and_is_reported(softbot: Any, scene_file: Path) -> None:
    result = softbot("plant", scene_file, *VIRTUAL, "--out", "here", "--json")
    assert result.exit_code == 0, result.stderr
    summary = json.loads(result.stdout)
    assert (summary["outcome"], summary["sim_time_s"]) == ("done", 0.5)
    assert re.search(r"softbot: \d+ cycles of 10 ms: .*\nsoftbot: SequencerSetpoints: 0 came", result.stderr)
    assert Path("here/report.html").exists()


def test_a_plant_may_let_the_c_reference_decide(
    softbot: Any, scene_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    boards = []
    run = wall_clock.run_plant
    monkeypatch.setattr(
        wall_clock,
        "run_plant",
        lambda *args, **options: run(*args, **options, watch=lambda node: boards.append(type(node.rules))),
    )
    result = softbot("plant", scene_file, *VIRTUAL, "--board", "c", "--out", "here", "--json")
    assert result.exit_code == 0, result.stderr
    assert json.loads(result.stdout)["outcome"] == "done"
    assert set(boards) == {CBoardRules}


def test_a_board_that_there_is_not_ends_with_2_and_the_choice(softbot: Any, scene_file: Path) -> None:
    result = softbot("plant", scene_file, *VIRTUAL, "--board", "rust")
    assert result.exit_code == 2
    assert "python" in result.stderr
    assert "Traceback" not in result.stderr


def test_a_sequencer_without_a_board_waits_for_it(softbot: Any, scene_file: Path) -> None:
    result = softbot("sequence", scene_file, *VIRTUAL, "--duration-s", "0.2", "--json")
    assert result.exit_code == 0, result.stderr
    assert json.loads(result.stdout)["state"] == "disarmed"
    assert result.stderr.count("waiting for the board on virtual cli-bus-commands") == 1


@pytest.mark.parametrize("command", ["plant", "sequence"])
def test_a_bus_that_is_not_there_ends_with_2_and_the_mend(softbot: Any, scene_file: Path, command: str) -> None:
    result = softbot(command, scene_file, "--channel", "no_such_can")
    assert result.exit_code == 2
    assert "no_such_can" in result.stderr
    assert "ip link" in result.stderr


@pytest.mark.parametrize("command", ["plant", "sequence"])
def test_bus_faults_that_cannot_be_end_with_2(softbot: Any, scene_file: Path, command: str) -> None:
    Path("faults.toml").write_text("[[bus_fault]]\nkind = 'moths'\n")
    result = softbot(command, scene_file, *VIRTUAL, "--bus-faults", "faults.toml")
    assert result.exit_code == 2
    assert "faults.toml: bus_fault.0.kind = 'moths'" in result.stderr


@pytest.mark.parametrize("times", ["0.5", "nan", "inf"])
@pytest.mark.parametrize("command", ["plant", "sequence"])
def test_a_motion_that_is_not_slow_ends_with_2(softbot: Any, scene_file: Path, command: str, times: str) -> None:
    result = softbot(command, scene_file, *VIRTUAL, "--slow-motion", times)
    assert result.exit_code == 2
    assert f"--slow-motion {times}: give a number from 1" in result.stderr


@pytest.mark.parametrize("command", ["plant", "sequence"])
def test_a_scene_without_a_sequencer_ends_with_2(softbot: Any, scene_file: Path, command: str) -> None:
    scene_file.write_text(
        scene_file.read_text().replace('"sequencer"', '"pressure"\npeak_pressure_Pa = 1e4\nperiod_s = 1')
    )
    result = softbot(command, scene_file, *VIRTUAL)
    assert result.exit_code == 2
    assert 'drive.kind = "pressure" has no sequencer' in result.stderr


def test_a_link_that_failed_ends_with_3(softbot: Any, scene_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any, **__: Any) -> SequencerRun:
        timing = RealTime(FixedRate(0.01).timing(), MessageMeter("ImuAccelerometer").timing())
        return SequencerRun(SequencerState.PRIMING, LinkFailure.BOARD_SILENT, (), (), timing)

    monkeypatch.setattr(wall_clock, "run_sequencer", fail)
    result = softbot("sequence", scene_file, *VIRTUAL, "--json")
    assert result.exit_code == 3
    assert "the link to the board failed: board silent" in result.stderr
    assert json.loads(result.stdout)["link_failure"] == "board_silent"


def test_the_narrator_says_each_thing_once(capsys: pytest.CaptureFixture[str]) -> None:
    class Node:
        """As much of a sequencer node as is told of."""

        def __init__(self) -> None:
            self.link = SequencerLink()
            self.state = SequencerState.DISARMED
            self.detections: list[Detection] = []
            self.recoveries: list[Recovery] = []

    node, tell = Node(), Narrator("socketcan vcan0")
    for _ in range(2):
        tell(node)  # type: ignore[arg-type]
    node.link.readings.board_mode = BoardMode.DISARMED
    node.detections.append(Detection(1.0, 2, "blocked_inlet", 0.9))
    node.recoveries.append(Recovery(1.0, "curvature_reversal"))
    node.recoveries.append(Recovery(9.0, "safe_stop", Offer(0.0, 2.0 * math.pi)))
    for _ in range(2):
        tell(node)  # type: ignore[arg-type]
    assert capsys.readouterr().err.splitlines() == [
        "softbot: waiting for the board on socketcan vcan0",
        "softbot: link disarmed, disarmed",
        "softbot: found: chamber 2, blocked inlet (90 %)",
        "softbot: curvature reversal",
        "softbot: safe stop: can still roll right",
    ]
