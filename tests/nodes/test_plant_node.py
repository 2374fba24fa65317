"""The plant's end of the bus, talked to in frames by a link of the protocol package alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from controllers.pressure_loop import PressureLoopGains
from firmware_protocol.enumerations import BoardMode, SafeReason
from firmware_protocol.frame import Frame
from firmware_protocol.sequencer_link import SequencerLink
from sim.recorder import Recorder
from sim.scene import CONTROL_PERIOD_S, Scene
from sim.twins import make_twin
from softbot.errors import InputError
from softbot.nodes.deciding_board import DecidingBoard
from softbot.nodes.plant_node import PlantNode, board_limits

MakeScene = Callable[..., Scene]


class Bench:
    """A plant node and a link joined by lists of frames, in lock-step."""

    def __init__(self, scene: Scene, gains: PressureLoopGains, board: DecidingBoard = DecidingBoard.PYTHON) -> None:
        self.twin = make_twin(scene)
        self.recorder = Recorder(scene, None)
        self.node = PlantNode(scene, self.twin, self.recorder, gains, board)
        self.link = SequencerLink()
        self.setpoint_Pa = [0.0] * 4
        self.link_is_up = True
        self._cycle = 0
        self._said: list[Frame] = []

    def run(self, duration_s: float) -> None:
        for _ in range(round(duration_s / CONTROL_PERIOD_S)):
            t_s = self._cycle * CONTROL_PERIOD_S
            self._cycle += 1
            frames = self.node.cycle(t_s, self._said)
            for frame in frames:
                self.link.receive(frame.frame_id, frame.data, t_s)
            self._said = self.link.outgoing(t_s, self.setpoint_Pa) if self.link_is_up else []
            self.node.advance()

    @property
    def pressure_Pa(self) -> np.ndarray:
        return self.node.plant.pressure_Pa

    def column(self, name: str) -> list[float]:
        return self.recorder.finish(0, 1.0, "done")[1].column(name).to_pylist()


@pytest.fixture(params=list(DecidingBoard))
def bench(make_scene: MakeScene, gains: PressureLoopGains, request: pytest.FixtureRequest) -> Iterator[Bench]:
    made = Bench(make_scene(), gains, request.param)
    yield made
    made.twin.close()


def test_before_it_is_armed_the_robot_is_vented_and_the_supply_is_shut(bench: Bench) -> None:
    bench.setpoint_Pa = [50e3] * 4
    bench.run(0.1)
    said = bench.link.readings
    assert said.board_mode is BoardMode.DISARMED
    assert said.openings == (-1.0, -1.0, -1.0, -1.0)
    assert said.main_supply_open is False
    assert np.abs(bench.pressure_Pa[:4]).max() < 1e3
    assert set(bench.column("command_0_Pa")) == {0.0}


def test_armed_it_holds_the_pressures_it_is_asked_for(bench: Bench) -> None:
    bench.link.arm()
    bench.setpoint_Pa = [60e3, 0.0, 25e3, 0.0]
    bench.run(1.2)
    assert bench.link.armed
    assert bench.link.readings.main_supply_open is True
    assert bench.pressure_Pa[:4] == pytest.approx([60e3, 0.0, 25e3, 0.0], abs=3e3)
    assert bench.link.readings.pressures_Pa == pytest.approx(bench.pressure_Pa[:4], abs=3e3)
    assert bench.column("command_0_Pa")[-1] == pytest.approx(60e3)


def test_a_setpoint_above_the_robots_limit_is_clamped_to_it(bench: Bench) -> None:
    bench.link.arm()
    bench.setpoint_Pa = [400e3, 0.0, 0.0, 0.0]
    bench.run(0.9)
    assert max(bench.column("command_0_Pa")) == pytest.approx(120e3)  # the default robot's max_pressure_Pa
    assert bench.pressure_Pa[0] < 130e3
    assert bench.link.armed


def test_a_silent_sequencer_vents_the_robot(bench: Bench) -> None:
    bench.link.arm()
    bench.setpoint_Pa = [60e3, 0.0, 0.0, 0.0]
    bench.run(0.8)
    assert bench.pressure_Pa[0] > 50e3
    bench.link_is_up = False
    bench.run(0.12)
    assert bench.node.rules.state.mode is BoardMode.SAFE_LATCHED
    assert bench.node.rules.state.reason is SafeReason.COMMAND_TIMEOUT
    bench.run(0.4)
    assert bench.pressure_Pa[0] < 10e3


def test_venting_latches_the_board_and_says_so(bench: Bench) -> None:
    bench.link.arm()
    bench.setpoint_Pa = [60e3, 0.0, 0.0, 0.0]
    bench.run(0.6)
    bench.node.vent()
    bench.run(0.5)
    assert bench.pressure_Pa[0] < 10e3
    assert bench.link.readings.last_fault == (SafeReason.EMERGENCY_STOP, None, 0)


def test_imu_and_supply_reach_the_bus_within_their_resolution(make_scene: MakeScene, gains: PressureLoopGains) -> None:
    quiet = [
        f"robot.sensors.{name}=0"
        for name in (
            "supply_noise_Pa",
            "gyro_noise_rad_s",
            "gyro_bias_rad_s",
            "accelerometer_noise_m_s2",
            "accelerometer_bias_m_s2",
        )
    ]
    bench = Bench(make_scene(*quiet), gains)
    bench.run(0.3)
    bench.twin.close()
    said = bench.link.readings
    assert said.supply_pressure_Pa == pytest.approx(250e3, abs=51)
    assert said.specific_force_m_s2 is not None
    assert np.hypot(*said.specific_force_m_s2[:2]) == pytest.approx(9.81, abs=0.3)  # at rest: gravity, across the tube
    assert said.angular_velocity_rad_s == pytest.approx((0.0, 0.0, 0.0), abs=0.1)


def test_a_fault_strikes_and_is_recorded(make_scene: MakeScene, gains: PressureLoopGains) -> None:
    fault = '[{t_s = 0.25, chamber = 3, kind = "leak", severity = 0.5}]'
    bench = Bench(make_scene(f"fault={fault}"), gains)
    bench.run(0.4)
    bench.twin.close()
    assert bench.recorder.events.faults == [{"t_s": 0.25, "chamber": 3, "kind": "leak"}]


def test_limits_that_leave_the_board_no_room_are_refused(make_scene: MakeScene) -> None:
    scene = make_scene("robot.pneumatics.max_chamber_pressure_Pa=100e3")
    with pytest.raises(InputError, match=r"max_chamber_pressure_Pa = 100000.*above the highest pressure commanded"):
        board_limits(scene.robot)
