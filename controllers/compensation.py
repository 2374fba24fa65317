"""Feed-forward compensation: pressures for a wanted bend, through what the chambers remember.

The compensator follows the chambers' memory (`softbot.memory`) by the measured pressures. For a wanted curvature it
asks the wall's law for the pressures that the wall has to feel, each within what its chamber can make it feel at the
end of the next control period (a vented chamber may still feel some, and the others have to make up for it), and undoes
the memory of each. Hysteresis, creep and residual are undone exactly; the line is not (that would take jumps of
pressure).

Without memory it is the law's own inverse, at no further cost.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.robot_model import RobotModel
from softbot.actuator import ActuatorLaw, InverseSolution
from softbot.cross_section import CHAMBERS
from softbot.errors import InputError
from softbot.kernel_compiler import kernel
from softbot.memory.chain import Memory, advance, undo

FloatArray = NDArray[np.float64]


@kernel()
def compensate(model: RobotModel, estimate: Any, strength: FloatArray, pressure_Pa: FloatArray) -> None:
    """From pressures (4,) that the wall shall feel to those to command, in place: the sequencer's compensator.

    estimate: record of `controllers.estimation`, which follows the chambers; strength (4,): 0 of a chamber that is not
    used. What a vented chamber still feels is balanced by the opposite one.
    """
    step_s, scratch, left_Pa = estimate.step_s, estimate.chamber_scratch, estimate.felt_Pa
    for i in range(CHAMBERS):
        left_Pa[i] = 0.0
        for n in range(scratch.shape[1]):
            scratch[i, n] = estimate.chamber_state[i, n]
    advance(model.behind_lines, scratch, left_Pa, step_s, left_Pa)
    for i in range(2):
        j = i + 2
        first, second = max(pressure_Pa[i], left_Pa[i]), max(pressure_Pa[j], left_Pa[j])
        over = (first - pressure_Pa[i]) * model.load[0, i] - (second - pressure_Pa[j]) * model.load[0, j]
        if over > 0.0 and strength[j] > 0.0:
            second += over / model.load[0, j]
        elif over < 0.0 and strength[i] > 0.0:
            first -= over / model.load[0, i]
        pressure_Pa[i], pressure_Pa[j] = first, second
    for i in range(CHAMBERS):
        left_Pa[i] = 1.0 if pressure_Pa[i] > left_Pa[i] else 0.0
    undo(model.behind_lines, estimate.chamber_state, pressure_Pa, step_s, pressure_Pa)
    for i in range(CHAMBERS):
        pressure_Pa[i] = min(max(left_Pa[i] * pressure_Pa[i], model.co_contraction_Pa), model.pressure_limit_Pa)


class Compensator:
    """The inverse of one robot's actuator, wall and memory. `observe` once a control cycle, then `pressures`."""

    def __init__(self, law: ActuatorLaw, memory: Memory | None = None) -> None:
        self._law, self._memory = law, memory
        self._state: FloatArray | None = None if memory is None else memory.rest()

    def observe(self, pressure_Pa: ArrayLike, dt_s: float) -> FloatArray:
        """Pressures that the wall feels, shape (4,) [Pa], now that the sensors say these, dt_s ≥ 0 after the last time.

        Raises InputError for what is not four finite pressures.
        """
        if self._memory is None or self._state is None:
            return np.asarray(pressure_Pa, dtype=float)
        self._state, felt_Pa = self._memory.step(self._state, pressure_Pa, dt_s)
        return felt_Pa

    def pressures(
        self,
        curvature_1_m: ArrayLike,
        *,
        dt_s: float,
        limit_Pa: float,
        co_contraction_Pa: float = 0.0,
        available: Sequence[bool] = (True, True, True, True),
        stretch: float | None = None,
    ) -> InverseSolution:
        """Pressures to command for a curvature vector, shape (2,) [1/m], at the end of the next dt_s.

        As `ActuatorLaw.pressures`, with the memory undone; curvature and stretch of the solution are those that its
        pressures really give then.
        """
        if self._memory is None or self._state is None:
            return self._law.pressures(
                curvature_1_m,
                limit_Pa=limit_Pa,
                co_contraction_Pa=co_contraction_Pa,
                available=available,
                stretch=stretch,
            )
        if not 0.0 <= co_contraction_Pa <= limit_Pa:
            raise InputError(f"co_contraction_Pa = {co_contraction_Pa:g}: give 0 … limit_Pa = {limit_Pa:g}")
        usable = np.array([bool(one) for one in available])
        low, high = np.where(usable, co_contraction_Pa, 0.0), np.where(usable, limit_Pa, 0.0)
        least, most = (np.maximum(self._memory.felt_at(self._state, end, dt_s), 0.0) for end in (low, high))
        felt = self._law.pressures_within(curvature_1_m, least_Pa=least, most_Pa=most, stretch=stretch)
        pressure = self._memory.inverse(self._state, felt.pressure_Pa, dt_s)
        pressure = np.where(felt.pressure_Pa > least, np.clip(pressure, low, high), low)
        return InverseSolution(pressure, felt.curvature_1_m, felt.reached, felt.stretch, felt.stretch_reached)
