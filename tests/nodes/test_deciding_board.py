"""With the C reference as its board a plant is the same plant, to the last byte on the bus."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from controllers.pressure_loop import PressureLoopGains
from firmware_protocol.c_board import CBoardRules
from firmware_protocol.errors import CompilerError
from sim.scene import Scene, load_scene
from softbot.nodes.deciding_board import DecidingBoard
from softbot.nodes.lockstep import run_lockstep
from softbot.nodes.plant_node import board_limits

MakeScene = Callable[..., Scene]
DAMAGED = Path(__file__).parents[2] / "scenes" / "damaged.toml"


def assert_the_same_run(first: Path, second: Path) -> None:
    for file in ("telemetry.parquet", "bus.log"):
        assert (first / file).read_bytes() == (second / file).read_bytes(), file


def test_the_board_in_c_runs_a_short_scene_as_the_board_in_python(
    make_scene: MakeScene, gains: PressureLoopGains, scripted: Any, tmp_path: Path
) -> None:
    fault = '[{t_s = 0.3, chamber = 0, kind = "leak", severity = 0.5}]'
    for board in DecidingBoard:
        sequencer = scripted(setpoint_Pa=(60e3, 500e3, 0.0, 25e3), script={0.4: (1, "rupture")})
        run_lockstep(make_scene(f"fault={fault}"), tmp_path / board, sequencer=sequencer, gains=gains, board=board)
    assert_the_same_run(tmp_path / "python", tmp_path / "c")


@pytest.mark.slow
def test_the_board_in_c_takes_the_robot_through_rupture_and_recovery(tmp_path: Path) -> None:
    for board in DecidingBoard:
        result = run_lockstep(load_scene(DAMAGED), tmp_path / board, board=board)
        assert len(result.summary["recoveries"]) == 1
        assert result.summary["missed_faults"] == 0
    assert_the_same_run(tmp_path / "python", tmp_path / "c")


def test_without_a_compiler_it_says_so(make_scene: MakeScene, monkeypatch: pytest.MonkeyPatch) -> None:
    from firmware_protocol import c_board

    def fail() -> None:
        raise CompilerError("no C compiler is here")

    monkeypatch.setattr(c_board, "_library", fail)
    limits = board_limits(make_scene().robot)
    with pytest.raises(CompilerError, match="no C compiler"):
        DecidingBoard.C.rules(limits, 1)


def test_the_names_are_those_of_the_option(make_scene: MakeScene) -> None:
    limits = board_limits(make_scene().robot)
    assert isinstance(DecidingBoard("c").rules(limits, 7), CBoardRules)
    assert DecidingBoard("python").rules(limits, 7).state.challenge_seed == 7
