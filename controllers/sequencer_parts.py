"""What a sequencer is made of and remembers: its configuration, parts and records, as compiled code takes them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.detector_parts import SILENT, DetectorMemory, DetectorParts, detector_memory, parts_of_detector
from controllers.estimation import estimator_memory
from controllers.excitation import Excitation
from controllers.fault_answers import answers
from controllers.gas_ledger import ledger_memory
from controllers.proof import proof_memory
from controllers.recovery import RECOVERY, RecoveryTuning
from controllers.robot_model import RobotModel, robot_model
from controllers.roll_observer import RollMemory, RollParts, parts_of_roll, roll_memory
from softbot.cross_section import CHAMBERS
from softbot.robot import Robot

FloatArray = NDArray[np.float64]
MOST_ANSWERS = 8
"""Of one cycle."""


class SequencerParts(NamedTuple):
    """What a sequencer is made of, as compiled code takes it."""

    model: RobotModel
    detector: DetectorParts
    detects: bool
    """Whether faults are found at all: else `detector` is silent, and the roll is not watched."""
    recovers: bool
    lead_rad: float
    tuning: RecoveryTuning
    answers: FloatArray
    """`controllers.fault_answers.answers()`."""
    roll: RollParts
    excitation: Excitation


SEQUENCER = np.dtype(
    [
        ("turn", np.int64),
        ("speed_rad_s", np.float64),
        ("distance_m", np.float64),
        ("turn_back", np.bool_),
        ("armed", np.bool_),
        ("state", np.int64),
        ("side", np.int64),
        ("roll_at_order_rad", np.float64),
        ("entered_s", np.float64),
        ("still_since_s", np.float64),
        ("mean_rate_rad_s", np.float64),
        ("last_t_s", np.float64),
        ("lead_integral_rad", np.float64),
        ("push_integral", np.float64),
        ("least_rad_s", np.float64),
        ("rocking", np.bool_),
        ("rocked_s", np.float64),
        ("rocked_rad", np.float64),
        ("runs_up", np.bool_),
        ("farthest_rad", np.float64),
        ("farthest_s", np.float64),
        ("offered_rad", np.float64, 2),
        ("turning", np.bool_),
        ("strength", np.float64, CHAMBERS),
        ("used", np.float64, CHAMBERS),
        ("sighted", np.float64, CHAMBERS),
        ("held", np.float64, CHAMBERS),
        ("excited", np.int64, CHAMBERS),
        ("setpoint_Pa", np.float64, CHAMBERS),
        ("wants_armed", np.bool_),
        ("answered", np.int64),
        ("answer", np.int64, MOST_ANSWERS),
    ],
    align=True,
)
"""What a sequencer was ordered, remembers and answers, as a record. `turn`: +1 left, −1 right, 0 stop; speed and
distance NaN where none was ordered; `turn_back`: the other way, once, where that proves impossible; `strength` 0 of a
chamber that is dead, `used`: how much of it recovery uses, `sighted`: how much of what its sensor says the wall feels,
0 where the sensor lies; `held`: the bend over what rolling asks for that a chamber holds which cannot be vented;
`excited`: whether it gets steps while it rests; `rocking`: rolled back for a run-up, since when and from which roll;
`runs_up`: and not come to the ordered speed since; `least_rad_s`: the speed that it needs by its stalls, 0 without any;
`farthest`: the most progress, and when it was made; `offered_rad`: how far what was left at the last safe stop pushed
it to the left and to the right; `turning`: it rolls the other way next; `answer`: numbers of STRATEGIES taken in this
cycle."""


class SequencerMemory(NamedTuple):
    """All that a sequencer remembers: records of shape (1,), and its detector's."""

    own: Any
    estimator: Any
    detector: DetectorMemory
    recovery: Any
    """Two plans: what is done, and the other side's."""
    proof: Any
    roll: RollMemory
    ledger: Any
    """Of the gas in the chambers: `controllers.gas_ledger`."""


def sequencer_memory() -> SequencerMemory:
    """Memory of a sequencer that has seen nothing and was ordered nothing."""
    own = np.zeros(1, SEQUENCER).view(np.recarray)
    first = own[0]
    for name in ("speed_rad_s", "distance_m", "roll_at_order_rad", "still_since_s", "last_t_s", "farthest_s"):
        first[name] = math.nan
    first["side"] = 1
    first["strength"] = first["used"] = first["sighted"] = 1.0
    return SequencerMemory(
        own,
        estimator_memory(),
        detector_memory(),
        np.zeros(2, RECOVERY).view(np.recarray),
        proof_memory(),
        roll_memory(),
        ledger_memory(),
    )


@dataclass(frozen=True)
class SequencerConfig:
    """The robot as the sequencer knows it, and its tuning.

    `setpoint_rate_Pa_s`: by which the board's pressure loop lets a setpoint move at most.
    """

    robot: Robot
    recovery: bool = True
    lead_rad: float = 0.8
    bend_rad: float | None = None
    co_contraction_Pa: float = 0.0
    detection: bool = True
    excitation_Pa: float = 0.0
    excitation_period_s: float = 0.3
    setpoint_rate_Pa_s: float = math.inf

    def parts(self) -> SequencerParts:
        """As compiled code takes it."""
        detector = parts_of_detector(self.robot.pneumatics, self.robot.sensors, None if self.detection else SILENT)
        return SequencerParts(
            robot_model(self.robot, self.bend_rad, self.co_contraction_Pa, self.setpoint_rate_Pa_s),
            detector,
            bool(self.detection),
            bool(self.recovery),
            float(self.lead_rad),
            RecoveryTuning(),
            answers(),
            parts_of_roll(self.robot, detector.period_s),
            Excitation(float(self.excitation_Pa), float(self.excitation_period_s)),
        )
