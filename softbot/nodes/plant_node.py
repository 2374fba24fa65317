"""The plant's end of the bus: the valve board (rules, pressure loop, sensors) and the robot behind it.

One cycle a control period: frames in; the sensors are read; the board's rules decide; the pressure loop opens the
valves, or they stand in their safe state; measurements out. `advance` then runs the robot for one period and records
the truth. What the node knows of the sequencer is what it heard on the bus.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from controllers.pressure_loop import PressureLoopGains
from firmware_protocol.board_limits import BoardLimits
from firmware_protocol.enumerations import SafeReason
from firmware_protocol.errors import LimitsError
from firmware_protocol.frame import Frame
from sim.body import Twin
from sim.plant import Plant
from sim.recorder import Recorder
from sim.scene import Scene
from sim.twins import steps_per_period, world_of
from softbot.errors import InputError
from softbot.faults import CHAMBER_COUNT
from softbot.nodes.deciding_board import DecidingBoard
from softbot.nodes.heard import Heard
from softbot.nodes.valve_loop import ValveLoop
from softbot.robot import Robot

FloatArray = NDArray[np.float64]

_VENTING = np.full(CHAMBER_COUNT, -1.0)
_CHALLENGES = 0xFFFF


def board_limits(robot: Robot, place: str = "robot.") -> BoardLimits:
    """What the board enforces for a robot. Raises InputError when its two pressure limits leave no room.

    place: where the robot stands, before its keys (`sim.scene.place_of_robot`).
    """
    try:
        return BoardLimits(robot.max_pressure_Pa, robot.pneumatics.max_chamber_pressure_Pa)
    except LimitsError:
        raise InputError(
            f"{place}pneumatics.max_chamber_pressure_Pa = {robot.pneumatics.max_chamber_pressure_Pa:g}: the valve "
            f"board vents there, so it must be above the highest pressure commanded, {robot.max_pressure_Pa:g} Pa "
            f"({place.rpartition(' ')[2]}actuator.max_pressure_Pa), and at most 809.1 kPa; raise the one or lower the "
            "other"
        ) from None


class PlantNode:
    """Valve board and robot of one scene. `twin` and `recorder` belong to the caller, who closes them.

    `board` is the implementation of the board's rules that decides. known: the robot that the board believes in; None:
    the scene's own.
    """

    def __init__(
        self,
        scene: Scene,
        twin: Twin,
        recorder: Recorder,
        gains: PressureLoopGains | None = None,
        board: DecidingBoard = DecidingBoard.PYTHON,
        known: Robot | None = None,
    ) -> None:
        self.rules = board.rules(board_limits(known or scene.robot), 1 + scene.solver.seed % _CHALLENGES)
        gravity_m_s2 = world_of(scene).gravity_vector_m_s2
        self.plant = Plant(scene.robot, twin, scene.fault, gravity_m_s2, scene.solver.seed)
        self.heard = Heard()
        self._twin, self._recorder = twin, recorder
        self._steps = steps_per_period(twin.step_s)
        self._valves = ValveLoop(known or scene.robot, gains)
        self._opening: FloatArray = _VENTING
        self._main_supply_open = False
        self._command_Pa: FloatArray = np.zeros(CHAMBER_COUNT)

    def cycle(self, t_s: float, frames: Iterable[Frame]) -> list[Frame]:
        """The board's cycle at `t_s` on its own clock: what came since the last one in, what is due out."""
        for frame in frames:
            received = self.rules.receive(frame.frame_id, frame.data, t_s)
            if received.status.accepted:
                self.heard.listen(str(received.name), received.signals, self.plant.t_s)
        self._recorder.start_clock()
        readings = self.plant.read_sensors()
        decision = self.rules.tick(t_s, readings.pressure_Pa.tolist())
        self._command_Pa = np.array(decision.setpoints_Pa)
        if decision.safe:
            self._opening = _VENTING
            self._valves.rest(readings.pressure_Pa)
        else:
            self._opening = self._valves.openings(self._command_Pa, readings)
        self._opening, relieves = self._valves.relieved(self._opening, decision.safe, readings)
        self._main_supply_open = decision.main_supply_open and not relieves
        self._recorder.stop_clock()
        return self.rules.outgoing(t_s) + self.rules.measurements(
            t_s,
            pressures_Pa=readings.pressure_Pa.tolist(),
            openings=self._opening.tolist(),
            supply_pressure_Pa=readings.supply_Pa,
            main_supply_open=self._main_supply_open,
            angular_velocity_rad_s=readings.gyro_rad_s.tolist(),
            specific_force_m_s2=readings.accelerometer_m_s2.tolist(),
        )

    def advance(self) -> None:
        """Run the robot for one control period as the valves stand, and record it."""
        self._recorder.start_clock()
        struck = self.plant.advance(self._opening, self._main_supply_open, self._steps)
        self._recorder.stop_clock()
        self._recorder.note_faults(struck)
        self._recorder.sample(
            self.plant.t_s,
            self._twin,
            self.plant.motion,
            pressure_Pa=self.plant.pressure_Pa,
            command_Pa=self._command_Pa,
            state=str(self.heard.state),
        )

    @property
    def valves(self) -> tuple[FloatArray, bool]:
        """Openings (4,), −1 exhaust … +1 supply, and whether the main supply is open, as the last cycle left them."""
        return self._opening, self._main_supply_open

    def release_valves(self) -> None:
        """The valves fall into their safe state, until the board's next cycle sets them again."""
        self._opening, self._main_supply_open = _VENTING, False

    def vent(self, reason: SafeReason = SafeReason.EMERGENCY_STOP) -> None:
        """Latch the safe state: the plant is being shut down."""
        self.rules.report_failure(reason)
