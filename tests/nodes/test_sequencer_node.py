"""The sequencer's end of the bus, against the board's rules alone and a scripted sequencer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.interface import Command, Order, SequencerState
from controllers.pressure_loop import PressureLoopGains
from firmware_protocol import enumerations
from firmware_protocol.board import BoardDecision, BoardLimits, BoardRules
from firmware_protocol.codec import decode
from firmware_protocol.e2e import Sender
from firmware_protocol.enumerations import BoardMode, FaultKind, Health, SafeReason
from firmware_protocol.frame import Frame
from firmware_protocol.sequencer_link import LinkFailure, LinkState
from sim.scene import CONTROL_PERIOD_S, Scene
from softbot.nodes.sequencer_node import SequencerNode, make_sequencer

MakeScene = Callable[..., Scene]


class Board:
    """The valve board's rules with sensors that always say the same. `plugged_in` False cuts the cable."""

    def __init__(self, node: SequencerNode, clock_start_s: float = 0.0) -> None:
        self.node = node
        self.rules = BoardRules(BoardLimits(120e3, 150e3))
        self.plugged_in = True
        self.said: list[tuple[str, dict[str, Any]]] = []
        self.decision: BoardDecision | None = None
        self.ahead_s = clock_start_s
        self._cycle = 0
        self._frames: list[Frame] = []

    def run(self, duration_s: float) -> None:
        for _ in range(round(duration_s / CONTROL_PERIOD_S)):
            t_s = round(self._cycle * CONTROL_PERIOD_S, 6)
            self._cycle += 1
            out: list[Frame] = []
            if self.plugged_in:
                now_s = t_s + self.ahead_s
                for frame in self._frames:
                    self.rules.receive(frame.frame_id, frame.data, now_s)
                self.decision = self.rules.tick(now_s, [1e3, 2e3, 3e3, 4e3])
                out = self.rules.outgoing(now_s) + self.rules.measurements(
                    now_s,
                    pressures_Pa=[1e3, 2e3, 3e3, 4e3],
                    openings=[0.5, -0.5, 0.0, 1.0],
                    supply_pressure_Pa=250e3,
                    main_supply_open=True,
                    angular_velocity_rad_s=[0.1, 0.2, 0.3],
                    specific_force_m_s2=[1.0, 2.0, 3.0],
                )
            self._frames = self.node.cycle(t_s, out)
            self.said += [decode(frame.frame_id, frame.data) for frame in self._frames]

    def heard(self, name: str) -> list[dict[str, Any]]:
        return [signals for said, signals in self.said if said == name]


def test_readings_are_what_the_board_measured(make_scene: MakeScene, scripted: Any) -> None:
    sequencer = scripted()
    Board(SequencerNode(make_scene(), sequencer)).run(0.05)
    reading = sequencer.readings[-1]
    assert reading.pressure_Pa == pytest.approx([1e3, 2e3, 3e3, 4e3], abs=50)
    assert reading.opening == pytest.approx([0.5, -0.5, 0.0, 1.0], abs=1e-3)
    assert reading.supply_Pa == pytest.approx(250e3, abs=50)
    assert reading.gyro_rad_s == pytest.approx([0.1, 0.2, 0.3], abs=1e-3)
    assert reading.accelerometer_m_s2 == pytest.approx([1.0, 2.0, 3.0], abs=3e-3)
    assert [reading.t_s for reading in sequencer.readings] == pytest.approx([0.0, 0.01, 0.02, 0.03, 0.04])


def test_the_order_comes_at_its_time_and_arms_the_board(make_scene: MakeScene, scripted: Any) -> None:
    sequencer = scripted((40e3, 0.0, 20e3, 0.0))
    scene = make_scene("sequencer.start_s=0.3", 'sequencer.command="right"', "sequencer.speed_rev_s=0.25")
    board = Board(SequencerNode(scene, sequencer))
    board.run(0.3)
    assert sequencer.orders == []
    assert {signals["Mode"] for signals in board.heard("SequencerControl")} == {0}
    board.run(0.3)
    assert sequencer.orders == [(0.3, Order(Command.RIGHT, 0.25, None))]
    assert sequencer.armed_since_s is not None
    assert sequencer.armed_since_s < 0.6
    assert board.decision is not None
    assert board.decision.setpoints_Pa == pytest.approx((40e3, 0.0, 20e3, 0.0))
    assert not board.decision.safe


def test_setpoints_stay_zero_until_the_board_is_armed(make_scene: MakeScene, scripted: Any) -> None:
    sequencer = scripted()
    board = Board(SequencerNode(make_scene(), sequencer))
    board.run(0.5)
    first = next(i for i, (_, signals) in enumerate(board.said) if signals.get("Setpoint0", 0.0) > 0.0)
    modes = [signals["Mode"] for name, signals in board.said[:first] if name == "SequencerControl"]
    assert enumerations.ControlMode.ARM_CONFIRM in modes


def test_state_and_health_are_told(make_scene: MakeScene, scripted: Any) -> None:
    sequencer = scripted(script={0.5: (2, "rupture")})
    node = SequencerNode(make_scene(), sequencer)
    board = Board(node)
    board.run(0.8)
    beats = board.heard("SequencerHeartbeat")
    assert beats[0]["State"] == enumerations.SequencerState.DISARMED
    assert beats[-1]["State"] == enumerations.SequencerState.ROLLING
    assert (beats[0]["Health"], beats[-1]["Health"]) == (Health.OK, Health.DEGRADED)
    assert node.state is SequencerState.ROLLING


def test_findings_go_onto_the_bus_by_chamber_and_kind(make_scene: MakeScene, scripted: Any) -> None:
    sequencer = scripted(script={0.3: (2, "rupture"), 0.31: (0, "sensor_stuck"), 0.32: (1, "moths")})
    node = SequencerNode(make_scene(), sequencer)
    board = Board(node)
    board.run(0.6)
    told = [(fault["Chamber"], fault["Kind"]) for fault in board.heard("SequencerFault")]
    assert told == [(2, FaultKind.RUPTURE), (0, FaultKind.SENSOR_STUCK), (1, FaultKind.UNKNOWN)]
    assert [found.t_s for found in node.detections] == pytest.approx([0.3, 0.31, 0.32])
    assert len(node.recoveries) == 3


@pytest.mark.parametrize("failure", [RuntimeError("out of its mind"), None])
def test_a_sequencer_that_fails_stops_the_robot(make_scene: MakeScene, scripted: Any, failure: Exception) -> None:
    sequencer = scripted(script={} if failure is None else {0.4: failure})
    node = SequencerNode(make_scene(), sequencer)
    board = Board(node)
    board.run(0.4)
    assert node.link.armed
    if failure is None:
        sequencer.setpoint_Pa = np.array([np.nan, 0.0, 0.0, 0.0])
    board.run(0.02)
    assert node.failure is failure or "not finite" in str(node.failure)
    assert board.rules.state.reason is SafeReason.EMERGENCY_STOP
    assert board.heard("EmergencyStop")
    board.run(0.2)
    assert board.rules.state.mode is BoardMode.SAFE_LATCHED  # and stays so
    assert board.heard("SequencerHeartbeat")[-1]["Health"] == Health.FAILED


def test_when_the_sequencer_is_done_the_board_is_disarmed(make_scene: MakeScene, scripted: Any) -> None:
    sequencer = scripted(script={0.5: Order(Command.STOP)})
    node = SequencerNode(make_scene(), sequencer)
    board = Board(node)
    board.run(0.45)
    assert board.rules.state.mode is BoardMode.ARMED
    board.run(0.15)
    assert board.rules.state.mode is BoardMode.DISARMED
    assert node.link_failure is LinkFailure.NONE


def test_stopping_disarms_the_board_whatever_the_sequencer_wants(make_scene: MakeScene, scripted: Any) -> None:
    node = SequencerNode(make_scene(), scripted())
    board = Board(node)
    board.run(0.4)
    node.stop()
    board.run(0.1)
    assert board.rules.state.mode is BoardMode.DISARMED


def test_a_stop_order_never_arms(make_scene: MakeScene, scripted: Any) -> None:
    board = Board(SequencerNode(make_scene('sequencer.command="stop"'), scripted()))
    board.run(0.5)
    assert {signals["Mode"] for signals in board.heard("SequencerControl")} == {0}


def test_a_board_that_starts_late_is_armed_in_the_end(make_scene: MakeScene, scripted: Any) -> None:
    sequencer = scripted()
    node = SequencerNode(make_scene(), sequencer)
    board = Board(node)
    board.plugged_in = False
    board.run(1.0)
    assert node.link.state is LinkState.DISARMED  # nothing heard: nothing asked
    board.plugged_in = True
    board.run(0.5)
    assert node.link.armed


def test_arming_that_is_not_answered_is_tried_again(make_scene: MakeScene, scripted: Any) -> None:
    node = SequencerNode(make_scene(), scripted())
    board = Board(node)
    board.run(0.12)  # ordered, asked to arm …
    board.plugged_in = False  # … and the board is gone
    board.run(2.5)
    assert not node.link.armed
    assert node.link_failure is LinkFailure.NONE
    board.plugged_in = True
    board.run(2.5)
    assert node.link.armed


def test_a_link_that_fails_once_armed_stays_down(make_scene: MakeScene, scripted: Any) -> None:
    node = SequencerNode(make_scene(), scripted())
    board = Board(node)
    board.run(0.5)
    assert node.link.armed
    board.rules.report_failure(SafeReason.OVER_PRESSURE)
    board.run(3.0)
    assert node.link_failure is LinkFailure.BOARD_LATCHED
    assert not node.link.armed
    assert board.decision is not None
    assert board.decision.safe


def test_without_new_readings_the_sequencer_is_not_asked(make_scene: MakeScene, scripted: Any) -> None:
    sequencer = scripted()
    board = Board(SequencerNode(make_scene(), sequencer))
    board.run(0.3)
    asked = len(sequencer.readings)
    board.plugged_in = False
    board.run(0.05)
    assert len(sequencer.readings) == asked


def test_readings_are_given_only_once_they_are_whole(make_scene: MakeScene, scripted: Any) -> None:
    sequencer = scripted()
    node = SequencerNode(make_scene(), sequencer)
    node.cycle(0.0, [Sender().send("ImuAccelerometer", {"X": 0.0, "Y": 0.0, "Z": 9.81})])
    assert sequencer.readings == []


def sampling(sender: Sender, value: float) -> list[Frame]:
    """The frames of one sampling of the board, all telling of `value`."""
    return [
        sender.send("BoardPressures", {f"Pressure{chamber}": value for chamber in range(4)}),
        sender.send(
            "BoardValves",
            {f"Opening{chamber}": 0.01 * value for chamber in range(4)} | {"MainSupplyOpen": 1, "BoardMode": 1},
        ),
        sender.send("BoardSupply", {"SupplyPressure": 100.0 + value, "SampleTimeMs": 10 * value}),
        sender.send("ImuGyro", {"X": value, "Y": 0.0, "Z": 0.0}),
        sender.send("ImuAccelerometer", {"X": 0.0, "Y": value, "Z": 0.0}),
    ]


def told(sequencer: Any) -> list[tuple[float, ...]]:
    """What each reading says in units of the value of its sampling."""
    return [
        tuple(
            np.round(
                [
                    1e-3 * reading.pressure_Pa[0],
                    100.0 * reading.opening[0],
                    1e-3 * reading.supply_Pa - 100.0,
                    reading.gyro_rad_s[0],
                    reading.accelerometer_m_s2[1],
                ],
                6,
            )
        )
        for reading in sequencer.readings
    ]


@pytest.mark.parametrize("torn_after", range(11))
def test_a_reading_is_of_one_sampling_wherever_the_cycle_cuts(
    make_scene: MakeScene, scripted: Any, torn_after: int
) -> None:
    sequencer = scripted()
    node = SequencerNode(make_scene(), sequencer)
    sender = Sender()
    frames = sampling(sender, 1.0) + sampling(sender, 2.0)
    node.cycle(0.0, frames[:torn_after])
    node.cycle(0.01, frames[torn_after:])
    # Openings are those that acted until the sampling: of the one before, where there was one.
    assert told(sequencer) == [(1.0,) * 5, (2.0, 1.0, 2.0, 2.0, 2.0)]
    assert sequencer.readings[1].t_s - sequencer.readings[0].t_s == pytest.approx(0.01)


def test_readings_keep_the_boards_rate_over_the_wrap_of_its_clock(make_scene: MakeScene, scripted: Any) -> None:
    sequencer = scripted()
    Board(SequencerNode(make_scene(), sequencer), clock_start_s=65.5).run(0.2)
    times = np.array([reading.t_s for reading in sequencer.readings])
    assert times[0] == 0.0
    assert np.diff(times) == pytest.approx(0.01)


def test_a_board_that_restarts_begins_a_new_clock(make_scene: MakeScene, scripted: Any) -> None:
    sequencer = scripted()
    node = SequencerNode(make_scene(), sequencer)
    first = Board(node, clock_start_s=30.0)
    first.run(0.2)
    first.rules = BoardRules(BoardLimits(120e3, 150e3))
    first.ahead_s = 0.0
    first.run(0.3)
    assert sequencer.readings[-1].t_s == pytest.approx(0.49, abs=0.05)


def test_the_scenes_sequencer_is_the_controllers(make_scene: MakeScene, gains: PressureLoopGains) -> None:
    from controllers.sequencer import Sequencer

    made = make_sequencer(make_scene("sequencer.recovery=false"), gains=gains)
    assert isinstance(made, Sequencer)
    slow = make_sequencer(make_scene(), gains=replace(gains, setpoint_rate_Pa_s=50e3))
    assert isinstance(slow, Sequencer)
    assert slow.parts.model.lag_s > 3.0 * made.parts.model.lag_s  # setpoints move slowly, and pressures with them
