"""What of the controller's code another process may compile meanwhile: the detector of faults."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numba.core import types
from numba.core.typing import Signature

from controllers.detector_parts import detector_memory, parts_of_detector
from controllers.fault_detection import detect
from softbot.robot import Robot
from softbot.sensing import READINGS


def detector_units(robot: Robot) -> list[tuple[Any, Signature]]:
    """Units and what they take and give, for a robot's detector."""
    parts = parts_of_detector(robot.pneumatics, robot.sensors, None)
    arguments = (numba.typeof(one) for one in (parts, detector_memory(), np.zeros(1, READINGS).view(np.recarray)))
    return [(detect, types.none(*arguments, types.Array(types.float64, 1, "C")))]
