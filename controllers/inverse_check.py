"""Evidence for the inverse: what is asked for against what the pressures found for it give.

- Over the workspace: pressures drawn at random give a bend (and a stretch) that can be had; the inverse has to find
  pressures that give it again. With all chambers, with each one dead, and with two dead.
- Through the hysteresis: a tour of the workspace, asked of the law alone and of the compensator, both answered by
  chambers that remember; also of a compensator whose parameters are a tenth off, since no calibration is exact.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from controllers.compensation import Compensator
from softbot.actuator import ActuatorLaw
from softbot.cross_section import CHAMBERS
from softbot.memory.chain import Memory, MemoryParts
from softbot.memory.hysteresis import Hysteresis

FloatArray = NDArray[np.float64]

DEAD: tuple[tuple[int, ...], ...] = ((), (0,), (1,), (2,), (3,), (0, 2), (0, 1))
_OFF = 0.9  # of the true parameters, for a compensator that is a tenth off
_LEAST_SHARE = 0.02  # of the largest bend: below it a relative error says nothing


@dataclass(frozen=True)
class WorkspaceError:
    """Largest error of inverse, then forward, over bends that can be had."""

    dead: tuple[int, ...]
    samples: int
    bend_percent: float
    """Of the wanted bend, without a wanted stretch."""
    bend_with_stretch_percent: float
    """Of the wanted bend, with a wanted stretch."""
    stretch_percent: float
    """Of the wanted change of length."""


@dataclass(frozen=True)
class CompensationError:
    """Root mean square error of the bend on a tour, in per cent of the largest bend wanted."""

    without_percent: float
    with_percent: float
    tenth_off_percent: float

    @property
    def ratio(self) -> float:
        """Error with compensation by parameters that are a tenth off, over that without."""
        return self.tenth_off_percent / self.without_percent


def workspace_error(
    law: ActuatorLaw, limit_Pa: float, samples: int = 300, dead: Iterable[tuple[int, ...]] = DEAD, seed: int = 0
) -> list[WorkspaceError]:
    """Errors over `samples` bends for each set of dead chambers. Raises as the law does."""
    random = np.random.default_rng(seed)
    return [_workspace_error(law, limit_Pa, samples, chambers, random) for chambers in dead]


def _workspace_error(
    law: ActuatorLaw, limit_Pa: float, samples: int, dead: tuple[int, ...], random: np.random.Generator
) -> WorkspaceError:
    available = [chamber not in dead for chamber in range(CHAMBERS)]
    pressure = random.uniform(0.0, limit_Pa, (samples, CHAMBERS)) * np.array(available)
    strain, _ = law.equilibria(pressure)
    size = np.hypot(strain[:, 1], strain[:, 2])
    asked = np.flatnonzero(size >= _LEAST_SHARE * size.max())
    worst = np.zeros(3)
    for wanted in strain[asked]:
        bend = float(np.hypot(*wanted[1:]))
        free = law.pressures(wanted[1:], limit_Pa=limit_Pa, available=available)
        both = law.pressures(wanted[1:], limit_Pa=limit_Pa, available=available, stretch=float(wanted[0]))
        errors = (
            np.hypot(*(free.curvature_1_m - wanted[1:])) / bend,
            np.hypot(*(both.curvature_1_m - wanted[1:])) / bend,
            abs(both.stretch - wanted[0]) / max(abs(wanted[0] - 1.0), 1e-6),
        )
        worst = np.maximum(worst, errors)
    bend_percent, with_stretch, stretch = (float(100.0 * one) for one in worst)
    return WorkspaceError(dead, int(asked.size), bend_percent, with_stretch, stretch)


def typical_hysteresis(limit_Pa: float) -> Hysteresis:
    """A made-up operator: the default robot's loop is 19 % of full scale wide with it; published are 16–20 %."""
    return Hysteresis(
        thresholds_Pa=tuple(share * limit_Pa for share in (0.02, 0.08, 0.2)),
        weights=(0.2, 0.2, 0.1),
        unloading_slope=1.4,
        unloading_share=0.3,
    )


def compensation_error(
    law: ActuatorLaw, hysteresis: Hysteresis, limit_Pa: float, samples: int = 300, seed: int = 0
) -> CompensationError:
    """Errors on a tour of `samples` bends that all chambers can give, through this hysteresis. Raises as the law."""
    random = np.random.default_rng(seed)
    angle = random.uniform(-np.pi, np.pi, samples)
    largest = float(np.hypot(*law.equilibrium([0.0, 0.0, 0.0, 0.6 * limit_Pa]).curvature_1_m))
    size = random.uniform(0.1, 1.0, samples) * largest
    targets = np.column_stack([size * np.cos(angle), size * np.sin(angle)])
    off = replace(
        hysteresis,
        thresholds_Pa=tuple(_OFF * one for one in hysteresis.thresholds_Pa),
        weights=tuple(_OFF * one for one in hysteresis.weights),
        unloading_slope=1.0 + _OFF * (hysteresis.unloading_slope - 1.0),
        unloading_share=_OFF * hysteresis.unloading_share,
    )
    errors = [_tour(law, hysteresis, believed, limit_Pa, targets) for believed in (None, hysteresis, off)]
    without, exact, tenth = (100.0 * one / largest for one in errors)
    return CompensationError(without, exact, tenth)


def _tour(
    law: ActuatorLaw, true: Hysteresis, believed: Hysteresis | None, limit_Pa: float, targets: FloatArray
) -> float:
    """Root mean square of the curvature's error [1/m]; the pressures for each target are there before the next."""
    truth = Memory(MemoryParts(hysteresis=true))
    state = truth.rest()
    controller = Compensator(law, None if believed is None else Memory(MemoryParts(hysteresis=believed)))
    missed = []
    for target in targets:
        pressure = controller.pressures(target, dt_s=1.0, limit_Pa=limit_Pa).pressure_Pa
        state, felt = truth.step(state, pressure, 1.0)
        missed.append(np.hypot(*(law.equilibrium(felt).curvature_1_m - target)))
        controller.observe(pressure, 1.0)
    return float(np.sqrt(np.mean(np.square(missed))))
