"""The sequencer's end of the bus: readings out of frames, the sequencer, its setpoints and findings into frames.

The board is armed when the sequencer wants it armed, from the scene's order time on. Arming that does not succeed is
tried again (the board may still be starting); a link that fails once it was armed stays down, because what vented the
board has to be looked at first. An exception of the sequencer ends in an emergency stop on the bus.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from controllers.interface import Command, Detection, Order, Recovery, SequencerOutput, SequencerState
from controllers.pressure_loop import PressureLoopGains
from firmware_protocol import enumerations
from firmware_protocol.enumerations import EmergencyReason, FaultKind, Health
from firmware_protocol.frame import Frame
from firmware_protocol.sequencer_link import LinkFailure, LinkState, SequencerLink
from sim.scene import Scene, SequencerTable
from softbot.faults import NO_CHAMBER
from softbot.robot import Robot
from softbot.sensing import Readings

LAST_MEASUREMENT = "ImuAccelerometer"
"""The last of the messages that the board sends for one sampling; with it the readings are whole."""

RETRY_S = 1.0
"""Between two tries to arm."""

_CLOCK_CYCLE_S = 65.536
_CLOCK_ERROR_S = 1.0


class ChamberSequencer(Protocol):
    """What the node needs of a sequencer (`controllers.sequencer.Sequencer`)."""

    def order(self, order: Order, t_s: float) -> None:
        """What is wanted from now on."""

    def armed(self, is_armed: bool) -> None:
        """Whether the valve board is armed now."""

    def update(self, t_s: float, readings: Readings) -> SequencerOutput:
        """One control cycle."""


_TUNING = (
    "recovery",
    "lead_rad",
    "bend_rad",
    "co_contraction_Pa",
    "detection",
    "excitation_Pa",
    "excitation_period_s",
)


def sequencer_tuning(table: SequencerTable) -> dict[str, Any]:
    """What of a `[sequencer]` table is the sequencer's own (`SequencerConfig`), and no order."""
    return {name: getattr(table, name) for name in _TUNING}


def ordered(table: SequencerTable) -> Order:
    """The order that a `[sequencer]` table gives."""
    return Order(Command(table.command), table.speed_rev_s, table.distance_m, table.turn_back)


def make_sequencer(
    scene: Scene, known: Robot | None = None, gains: PressureLoopGains | None = None
) -> ChamberSequencer:
    """The sequencer of a scene's robot (or of the `known` one) and `[sequencer]` table.

    gains: of the board's pressure loop, which say how fast its setpoints move; None: those designed for the robot.
    """
    from controllers.sequencer import Sequencer
    from controllers.sequencer_parts import SequencerConfig
    from softbot.nodes.valve_loop import designed_gains

    robot = known or scene.robot
    rate_Pa_s = (gains or designed_gains(robot)).setpoint_rate_Pa_s
    return Sequencer(SequencerConfig(robot, **sequencer_tuning(scene.sequencer), setpoint_rate_Pa_s=rate_Pa_s))


class SequencerNode:
    """Link and sequencer of one scene. `detections` and `recoveries` are all so far; `failure` is the sequencer's."""

    def __init__(self, scene: Scene, sequencer: ChamberSequencer | None = None) -> None:
        self.link = SequencerLink()
        self.detections: list[Detection] = []
        self.recoveries: list[Recovery] = []
        self.failure: Exception | None = None
        self.was_armed = False
        self._sequencer = sequencer or make_sequencer(scene)
        own = scene.sequencer
        self._order = ordered(own)
        self._order_after_s = own.start_s
        self._heard_since_s: float | None = None
        self._ordered, self._stopped = False, False
        self._output = SequencerOutput(np.zeros(4), SequencerState.DISARMED, False)
        self._next_try_s = -math.inf
        self._clock = _BoardClock()
        self._opening: NDArray[np.float64] | None = None
        self._main_supply_shut = True

    @property
    def state(self) -> SequencerState:
        """The sequencer's state in the last cycle."""
        return self._output.state

    @property
    def link_failure(self) -> LinkFailure:
        """Why a link that was armed went down; NONE while it has not."""
        return self.link.failure if self.was_armed else LinkFailure.NONE

    def cycle(self, t_s: float, frames: Iterable[Frame]) -> list[Frame]:
        """One control cycle at `t_s`: what came since the last one in, what is due out.

        The sequencer is updated with each whole sampling that came, in order.
        """
        for frame in frames:
            received = self.link.receive(frame.frame_id, frame.data, t_s)
            if received.status.accepted and received.name == LAST_MEASUREMENT:
                # At once: what comes after it may be half of the next sampling, and two samplings may come together.
                self._control_with(self._readings(t_s), t_s)
        self._arm_or_disarm(t_s)
        state = enumerations.SequencerState[self._output.state.name]
        return self.link.outgoing(t_s, self._output.setpoint_Pa.tolist(), state, self._health())

    def stop(self) -> None:
        """Vent and disarm, for good: the process is about to end."""
        self._stopped = True
        self.link.disarm()

    def _control_with(self, readings: Readings | None, t_s: float) -> None:
        if readings is None or self.failure is not None:
            return
        try:
            self._control(t_s, readings)
        except Exception as error:  # whatever it is, the robot must not go on with old setpoints
            self.failure = error
            self.link.emergency_stop(EmergencyReason.INTERNAL_ERROR)

    def _control(self, t_s: float, readings: Readings) -> None:
        if self._heard_since_s is None:
            self._heard_since_s = t_s
        if not self._ordered and t_s - self._heard_since_s >= self._order_after_s - 1e-9:
            self._ordered = True
            self._sequencer.order(self._order, t_s)
        self._sequencer.armed(self.link.armed)
        output = self._sequencer.update(t_s, readings)
        if not np.isfinite(output.setpoint_Pa).all():
            raise ValueError(f"setpoints {output.setpoint_Pa.tolist()} Pa are not finite")
        self._output = output
        self.detections += output.detections
        self.recoveries += output.recoveries
        for found in output.detections:
            chamber = None if found.chamber == NO_CHAMBER else found.chamber
            self.link.report_fault(FaultKind.of_name(found.kind), chamber=chamber, confidence=found.confidence)

    def _arm_or_disarm(self, t_s: float) -> None:
        link = self.link
        self.was_armed = self.was_armed or link.armed
        if not self._output.wants_armed or self._stopped:
            if link.state is not LinkState.FAILED or not self.was_armed:
                link.disarm()
            return
        down = link.state is LinkState.DISARMED or (link.state is LinkState.FAILED and not self.was_armed)
        if down and t_s >= self._next_try_s:
            self._next_try_s = t_s + RETRY_S
            link.arm()

    def _health(self) -> Health:
        if self.failure is not None:
            return Health.FAILED
        return Health.DEGRADED if self.detections else Health.OK

    def _readings(self, t_s: float) -> Readings | None:
        """The newest readings, on this node's clock; None until every message has come once."""
        new = self.link.readings
        if (
            new.pressures_Pa is None
            or new.openings is None
            or new.supply_pressure_Pa is None
            or new.sample_time_s is None
            or new.angular_velocity_rad_s is None
            or new.specific_force_m_s2 is None
        ):
            return None
        commanded = np.array(new.openings)  # from this sampling on; what acted until it was told before
        acted, self._opening = commanded if self._opening is None else self._opening, commanded
        shut, self._main_supply_shut = self._main_supply_shut, not new.main_supply_open
        return Readings(
            t_s=self._clock.here_s(new.sample_time_s, t_s),
            pressure_Pa=np.array(new.pressures_Pa),
            supply_Pa=new.supply_pressure_Pa,
            gyro_rad_s=np.array(new.angular_velocity_rad_s),
            accelerometer_m_s2=np.array(new.specific_force_m_s2),
            opening=acted,
            main_supply_shut=shut,
        )


class _BoardClock:
    """The board's sampling times on this node's clock: their distances are the board's, free of the bus's jitter."""

    def __init__(self) -> None:
        self._last_ms = 0
        self._elapsed_ms = 0
        self._origin_s: float | None = None

    def here_s(self, sample_s: float, now_s: float) -> float:
        """When the board's clock said `sample_s` (it wraps at 65.536 s), given that it is `now_s` here."""
        sample_ms = round(1e3 * sample_s)
        self._elapsed_ms += (sample_ms - self._last_ms) % round(1e3 * _CLOCK_CYCLE_S)
        self._last_ms = sample_ms
        if self._origin_s is not None:
            here_s = round(self._origin_s + 1e-3 * self._elapsed_ms, 6)
            if abs(here_s - now_s) < _CLOCK_ERROR_S:
                return here_s
        self._origin_s, self._elapsed_ms = now_s, 0  # the first reading, or the board was restarted
        return now_s
