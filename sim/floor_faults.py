"""What faults change between robot and floor: friction, a weight that rests on the robot, a kerb in its way.

They change from one control period to the next, not within one. What each does to the mechanics is the twin's own
(`FloorTwin`); where the kerb comes to lie and when is decided here, for every twin alike.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from sim.body import Twin
from softbot.errors import InputError
from softbot.faults import FaultKind
from softbot.plant_conditions import FRICTION_FACTOR, KERB_SHARE, PAYLOAD_SHARE, PlantConditions, conditions_at

ON_THE_FLOOR = frozenset({FaultKind.FRICTION_LOST, FaultKind.FRICTION_HIGH, FaultKind.PAYLOAD, FaultKind.OBSTACLE})
"""Faults that act between robot and floor."""

_MOMENT_S = 1e-6
_KERB_AHEAD = 1.0  # of the radius, from the robot's side to the kerb


@runtime_checkable
class FloorTwin(Twin, Protocol):
    """A twin whose floor can become another one while it runs."""

    @property
    def alone(self) -> bool:
        """Whether there are no other bodies, which would have their own part in it."""

    @property
    def radius_m(self) -> float:
        """Of the tube [m]."""

    def contact_centres_m(self) -> NDArray[np.float64]:
        """Centres of the cross-sections that can touch the floor now, shape (n, 3) [m]."""

    def change_floor(self, friction_factor: float, payload_share: float) -> None:
        """From now on: friction over that of the world; a weight on the robot over its own, without inertia."""

    def lay_kerb(self, height_m: float, riser_m: float) -> None:
        """From now on the floor rises by `height_m` at y = `riser_m`, outwards; the world has a step somewhere."""


class Floor:
    """The floor of a run, as its faults make it. Raises InputError for a twin that cannot have them."""

    def __init__(self, conditions: PlantConditions, twin: Twin) -> None:
        self._faults = tuple(fault for fault in conditions.faults if fault.kind in ON_THE_FLOOR)
        self._twin: FloorTwin | None = None
        if self._faults:
            if not (isinstance(twin, FloorTwin) and twin.alone):
                raise InputError(
                    f"fault.kind = {str(self._faults[0].kind)!r}: only a robot alone on its floor can have that; "
                    "leave the other bodies out"
                )
            self._twin = twin
        self._rows, self._scratch = conditions.rows, conditions.packed.copy()
        self._now = (1.0, 0.0)
        self._kerb_lies = False

    def changes_between(self, from_s: float, to_s: float) -> bool:
        """Whether the floor may be another at `to_s` than at `from_s`; for a moment more, as times are rounded."""
        return any(
            fault.t_s - _MOMENT_S <= to_s
            and (fault.period_s is not None or from_s <= fault.t_s + fault.ramp_s + _MOMENT_S)
            for fault in self._faults
        )

    def lay(self, t_s: float) -> None:
        """Make the floor what it is at `t_s`."""
        if self._twin is None:
            return
        conditions_at(t_s, self._rows, self._scratch)
        if self._scratch[KERB_SHARE] > 0.0 and not self._kerb_lies:
            _lay_kerb(self._twin, float(self._scratch[KERB_SHARE]))
            self._kerb_lies = True
        now = (float(self._scratch[FRICTION_FACTOR]), float(self._scratch[PAYLOAD_SHARE]))
        if now != self._now:
            self._now = now
            self._twin.change_floor(*now)


def _lay_kerb(twin: FloorTwin, share: float) -> None:
    """A step of a share of the radius, a radius ahead of the robot on the side to which it rolls; it rises outwards."""
    radius_m = twin.radius_m
    ahead = 1.0 if twin.motion().mid_velocity_m_s[1] >= 0.0 else -1.0
    front_m = float((ahead * twin.contact_centres_m()[:, 1]).max()) + radius_m
    twin.lay_kerb(share * radius_m, ahead * max(front_m + _KERB_AHEAD * radius_m, radius_m))
