"""Arm, roll, rupture, recovery over a bus: what happened is read from the plant's own recording."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers.pressure_loop import PressureLoopGains
from firmware_protocol.codec import decode
from firmware_protocol.enumerations import BoardMode, ControlMode
from firmware_protocol.sequencer_link import LinkFailure
from firmware_protocol.trace import read_trace
from sim.scene import Scene
from sim.telemetry import read_telemetry
from softbot.nodes.deciding_board import DecidingBoard
from softbot.nodes.wall_clock import PlantRun, SequencerRun, run_plant, run_sequencer

FAULT_S, END_S = 4.0, 8.0
HELD_UP_S = 0.05
"""A loop that woke up so late was held up by the machine: half of the time-outs, more than the observers bridge."""
SLOW_MOTIONS = (1.0, 2.0, 4.0, 8.0)
"""Tried in turn until the machine keeps up: what is shown does not hang on its being quiet."""


class Rolled:
    """The two ends' outcomes and the plant's run folder."""

    def __init__(
        self,
        scene: Scene,
        gains: PressureLoopGains,
        transport: tuple[str, str],
        beside: Any,
        folder: Path,
        board: DecidingBoard,
        slow_motion: float,
    ):
        self.folder = folder
        self._slow_motion = slow_motion
        other = beside(transport, lambda stop: run_sequencer(scene, *transport, stop=stop, slow_motion=slow_motion))
        try:
            self.planted: PlantRun = run_plant(
                scene,
                *transport,
                folder,
                gains=gains,
                board=board,
                slow_motion=slow_motion,
                progress=lambda t_s: other.stop.set() if t_s > END_S - 0.3 else None,
            )
        finally:
            self.sequenced: SequencerRun = other.result()

    @property
    def held_up(self) -> bool:
        """Whether the machine was away in the run: it then tells of the machine, not of the program."""
        latest_s = max(end.timing.loop.max_lateness_s for end in (self.planted, self.sequenced))
        return latest_s > HELD_UP_S * self._slow_motion

    @property
    def summary(self) -> dict:
        return self.planted.result.summary


@pytest.fixture(scope="module")
def slow_motions() -> list[float]:
    """Those that are left to try."""
    return list(SLOW_MOTIONS)


@pytest.fixture(scope="module")
def rolled(
    shared_transport: tuple[str, str],
    damaged_scene: Callable[..., Scene],
    gains: PressureLoopGains,
    beside: Any,
    deciding_board: DecidingBoard,
    tmp_path_factory: pytest.TempPathFactory,
    slow_motions: list[float],
) -> Rolled:
    # On the virtual bus both ends are one process: nothing is armed before both have started.
    scene = damaged_scene(f"fault.0.t_s={FAULT_S}", f"solver.duration_s={END_S}", "sequencer.start_s=1")
    while True:
        folder = tmp_path_factory.mktemp("rolled") / "run"
        run = Rolled(scene, gains, shared_transport, beside, folder, deciding_board, slow_motions[0])
        if not run.held_up or len(slow_motions) == 1:
            return run
        del slow_motions[0]  # for the runs that follow as well


def test_it_was_armed_by_the_handshake_and_only_then_pressurised(rolled: Rolled) -> None:
    modes, first_pressure = [], None
    for t_s, frame in read_trace(rolled.folder / "bus.log"):
        name, signals = decode(frame.frame_id, frame.data)
        if name == "SequencerControl" and (not modes or modes[-1] != signals["Mode"]):
            modes.append(int(signals["Mode"]))
        if name == "BoardValves" and signals["MainSupplyOpen"]:
            assert signals["BoardMode"] == BoardMode.ARMED
            first_pressure = first_pressure or t_s
    assert modes == [
        ControlMode.DISARM,
        ControlMode.ARM_REQUEST,
        ControlMode.ARM_CONFIRM,
        ControlMode.RUN,
        ControlMode.DISARM,
    ]
    assert first_pressure is not None


def test_the_rupture_is_named_and_answered_by_reversing_the_curvature(rolled: Rolled) -> None:
    assert [(found["chamber"], found["kind"]) for found in rolled.summary["detections"]] == [(1, "rupture")]
    # when on a wall clock the chamber's turn comes is chance: within a revolution, 2 s, and until then it is empty
    assert 0.0 < rolled.summary["detections"][0]["delay_s"] < 2.5
    assert [answer["strategy"] for answer in rolled.summary["recoveries"]] == ["curvature_reversal"]
    assert (rolled.summary["false_alarms"], rolled.summary["missed_faults"]) == (0, 0)


def test_it_rolls_on_in_the_same_direction(rolled: Rolled) -> None:
    telemetry = read_telemetry(rolled.folder)
    t = telemetry.column("t_s").to_numpy()
    turned = telemetry.column("roll_rad").to_numpy() / (2.0 * np.pi)
    before, after = np.interp(FAULT_S, t, turned), turned[-1] - np.interp(FAULT_S + 0.5, t, turned)
    assert before < -0.5  # to the left: negative
    assert after < -0.5


def test_no_command_is_lost_and_the_board_never_vents(rolled: Rolled) -> None:
    assert rolled.sequenced.link_failure is LinkFailure.NONE
    for timing in (rolled.planted.timing.link, rolled.sequenced.timing.link):
        assert (timing.lost, timing.refused) == (0, 0)
