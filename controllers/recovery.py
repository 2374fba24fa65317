"""Recovery: rolling on in the same direction with one dead chamber, by reversing the curvature.

The paper: converting the curvature of the C and changing the active side change the signs of sin φ0 and of sin θ
together, and the rolling direction stays. Half a turn is rolled on each side; where the dead chamber would be needed
(at θ = ±π/2) the curvature is reversed *through straight*: the exactly opposite direction is commanded, without lead,
until the measured pressures bend the robot to the other side. Flipping the side and keeping the lead at once would
swing the curvature round the short way and roll the body back as far as it had come (design part 3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from controllers.commutation import TURN_RAD, room_rad, shortfall_rad
from controllers.estimation import Estimate


@dataclass(frozen=True)
class ReversalTuning:
    """When to begin a reversal, and when it is over."""

    near_stop_rad: float = 0.12
    """Room left before the dead chamber stops the roll at which the reversal begins."""
    stalled_rad_s: float = 0.25
    """… or a roll slower than this, within `stalled_within_rad` of the stop."""
    stalled_within_rad: float = 0.5
    flipped_share: float = 0.6
    """Part of the wanted curvature that must have grown on the other side."""
    longest_s: float = 2.0
    """A reversal that takes longer is given up for the side that the robot then has."""


@dataclass(frozen=True)
class Reversal:
    """A reversal under way: the body direction commanded, held until the C has flipped."""

    began_s: float
    direction_rad: float
    side: int
    """The side that the C will open to."""


class ReversalPlanner:
    """Decides for a robot with dead chambers when to reverse and when the reversal is over."""

    def __init__(self, tuning: ReversalTuning | None = None) -> None:
        self._tuning = tuning or ReversalTuning()
        self.reversal: Reversal | None = None

    def due(self, estimate: Estimate, side: int, forward: int, dead: tuple[int, ...]) -> bool:
        """Whether the roll has come to where a dead chamber is needed."""
        room = room_rad(side, estimate.roll_rad, forward, dead)
        slow = forward * -estimate.roll_rate_rad_s < self._tuning.stalled_rad_s
        return room < self._tuning.near_stop_rad or (slow and room < self._tuning.stalled_within_rad)

    def begin(self, t_s: float, estimate: Estimate, side: int, dead: tuple[int, ...]) -> Reversal:
        """Start a reversal: command the opposite of the curvature as it is, or the nearest that can be had."""
        opposite = estimate.curvature_direction_rad + math.pi
        opposite -= shortfall_rad(opposite, dead)
        self.reversal = Reversal(t_s, math.remainder(opposite, TURN_RAD), -side)
        return self.reversal

    def over(self, t_s: float, estimate: Estimate, wanted_1_m: float) -> bool:
        """Whether the C has flipped (or too long has passed); the reversal then ends."""
        reversal = self.reversal
        if reversal is None:
            return True
        along = estimate.curvature_size_1_m * math.cos(estimate.curvature_direction_rad - reversal.direction_rad)
        flipped = along > self._tuning.flipped_share * wanted_1_m
        if flipped or t_s - reversal.began_s > self._tuning.longest_s:
            self.reversal = None
            return True
        return False
