"""A case's quantity out of the summary of a run."""

from __future__ import annotations

import math
from typing import Any

from sim.benchmark.case import Case
from sim.benchmark.play import Measured


def measured_from(case: Case, summary: dict[str, Any]) -> Measured:
    """Quantity, simulated time and wall time. Raises ArithmeticError when the robot did not roll."""
    return Measured((quantity_of(case, summary),), float(summary["sim_time_s"]), float(summary["wall_time_s"]))


def quantity_of(case: Case, summary: dict[str, Any]) -> float:
    """Turning per radian of the drive, advance per revolution over 2πR, or revolutions."""
    if case.quantity == "revolutions":
        return float(summary["revolutions"])
    if case.quantity == "turning":
        assert case.scene_table is not None
        cycles = summary["steady_span_s"] / case.scene_table["drive"]["period_s"]
        return float(summary["plane_rotation_rad"]) / (2.0 * math.pi * cycles)
    advance_m = summary["advance_per_revolution_m"]
    if advance_m is None:
        raise ArithmeticError("the robot did not roll")
    return float(advance_m) / (2.0 * math.pi * case.body.radius_m)
