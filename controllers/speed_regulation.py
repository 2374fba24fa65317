"""Regulation of the speed, from what was ordered and what is measured: PI, without wind-up against a bound.

A robot that statics roll is regulated by the lead, of which the moment is a sine. One that lives on its momentum needs
all the lead wherever there is a push at all, and is regulated by how strong its pushes are. It coasts for a part of
every revolution, so an integral that is as quick as its revolutions makes it surge; and a straight tube coasts for
long, so it has to be pushed back where it is too fast.
"""

from __future__ import annotations

import math
from typing import Any

from softbot.kernel_compiler import kernel

LAG_S = 0.12
"""By about this the curvature follows its command late, so a steady roll at ω needs a lead of ω·LAG_S …"""
PROPORTIONAL_S = 0.05
INTEGRAL = 0.15
"""… and what friction asks for."""
PUSH_PROPORTIONAL_S, PUSH_INTEGRAL = 0.25, 0.02
"""Share of the most moment, for each rad/s that is wanting, and for each rad that is …"""
BRAKE_S, BRAKES_FROM = 0.05, 0.1
"""… and backwards for each rad/s beyond what exceeds the wanted speed by this share."""


@kernel()
def regulated_lead_rad(own: Any, largest_rad: float, measured_rad_s: float, step_s: float) -> float:
    """The lead for this cycle, 0 … the largest [rad]; speeds are positive in the ordered direction.

    Feed-forward of the pressure lag, and a PI correction. Without a wanted speed the lead is the largest.
    """
    wanted = own.speed_rad_s
    if math.isnan(wanted):
        return largest_rad
    error = wanted - measured_rad_s
    lead = wanted * LAG_S + PROPORTIONAL_S * error + own.lead_integral_rad
    if 0.0 < lead < largest_rad or (lead <= 0.0) == (error > 0.0):  # no wind-up against a bound
        own.lead_integral_rad += INTEGRAL * error * step_s
    return min(max(lead, 0.0), largest_rad)


@kernel()
def regulated_push(own: Any, measured_rad_s: float, step_s: float) -> float:
    """Share of the most moment for this cycle, −1 … 1; it and speeds are positive in the ordered direction.

    Without a wanted speed it is 1, and so it is after a run-up until that is reached. Where the robot has stalled again
    and again the wanted speed is what it needs to get on at all.
    """
    if math.isnan(own.speed_rad_s):
        return 1.0
    wanted = max(own.speed_rad_s, own.least_rad_s)
    error = wanted - measured_rad_s
    own.runs_up = own.runs_up and error > 0.0
    if own.runs_up:
        return 1.0
    push = PUSH_PROPORTIONAL_S * error + own.push_integral
    if 0.0 < push < 1.0 or (push <= 0.0) == (error > 0.0):
        own.push_integral += PUSH_INTEGRAL * error * step_s
    if push < 0.0:
        return -min(max(BRAKE_S * (-error - BRAKES_FROM * wanted), 0.0), 1.0)
    return min(push, 1.0)
