"""Open-loop drives: the intrinsic curvature or the chamber pressures that a scene asks for at a time."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sim.scene import Drive
from softbot.cross_section import CHAMBER_ANGLES_RAD
from softbot.faults import CHAMBER_COUNT, EMPTIES_CHAMBER, Fault
from softbot.muscle import linear_rest_curvature_1_m
from softbot.robot import Actuation, Robot

FloatArray = NDArray[np.float64]
Times = TypeVar("Times", float, FloatArray)


def amplitude(drive: Drive, t_s: Times) -> Times:
    """Share of the full bend at a time or at many, 0 … 1: straight, then bent by start_s over ramp_s."""
    return np.clip((t_s - drive.start_s) / drive.ramp_s + 1.0, 0.0, 1.0)


def phase_rad(drive: Drive, t_s: Times) -> Times:
    """Direction of the wanted curvature in the body frame at a time or at many [rad]; it turns from start_s on."""
    return drive.direction * 2.0 * math.pi * np.maximum(t_s - drive.start_s, 0.0) / drive.period_s


def curvature_1_m(drive: Drive, t_s: float) -> FloatArray:
    """Intrinsic curvature vector at `t_s`, shape (2,) [1/m], for drive.kind = "curvature"."""
    assert drive.curvature_1_m is not None
    angle = phase_rad(drive, t_s)
    return drive.curvature_1_m * amplitude(drive, t_s) * np.array([math.cos(angle), math.sin(angle)])


def bend_1_m(drive: Drive, robot: Robot) -> float:
    """Size of the intrinsic curvature that a given drive asks for [1/m]: as it stands, or what muscles contract to."""
    tube = robot.thin_tube()
    if drive.kind == "contraction" and tube is not None and drive.contraction is not None:
        return linear_rest_curvature_1_m(tube, drive.contraction)
    assert drive.curvature_1_m is not None
    return drive.curvature_1_m


def active_side_rad(drive: Drive, robot: Robot, t_s: FloatArray, bend_direction_rad: FloatArray) -> FloatArray:
    """Body angle of the side whose chambers or muscles are active at the times t_s, shape (n,) [rad].

    bend_direction_rad: of the C at these times, from which a drive with a lead takes its direction.
    """
    towards = phase_rad(drive, t_s)
    if drive.lead_rad is not None:
        ahead = bend_direction_rad + drive.direction * drive.lead_rad
        towards = np.where(t_s >= drive.start_s, ahead, towards)
    return towards if robot.actuation == "muscle" else towards + math.pi


def lost_shares(faults: Iterable[Fault]) -> FloatArray:
    """Share of its work, 0 … 1, that each chamber or muscle has lost to faults that have happened, shape (4,).

    Faults that only mean something with valves and sensors take nothing from a given curvature.
    """
    kept = np.ones(CHAMBER_COUNT)
    for fault in faults:
        if fault.kind in EMPTIES_CHAMBER and fault.chamber is not None:
            kept[fault.chamber] *= 1.0 - fault.severity
    return 1.0 - kept


BENDS_TOWARDS_ITSELF: dict[Actuation, float] = {"chamber": -1.0, "muscle": 1.0}
"""Side to which an active element bends the tube: a chamber away from itself, a muscle towards itself."""


def without_chamber(
    curvature_1_m: FloatArray, chamber: int, lost: float, actuation: Actuation = "chamber"
) -> FloatArray:
    """A given curvature vector (2,) [1/m] less what an element that has lost the share `lost` (0 … 1) would give.

    Chamber i bends towards α_i + π, muscle i towards α_i, and no other one does; that component is what a dead one
    takes away.
    """
    angle = CHAMBER_ANGLES_RAD[chamber]
    towards = BENDS_TOWARDS_ITSELF[actuation] * np.array([math.cos(angle), math.sin(angle)])
    return curvature_1_m - lost * max(float(curvature_1_m @ towards), 0.0) * towards


def pressures_Pa(drive: Drive, t_s: float) -> FloatArray:
    """Chamber pressures wanted at `t_s`, shape (4,) [Pa gauge], for drive.kind = "pressure".

    The chambers are pressurised one after the other, each with the positive half of a cosine about the outer side
    (opposite to the curvature), over the co-contraction.
    """
    assert drive.peak_pressure_Pa is not None
    outside = phase_rad(drive, t_s) + math.pi
    wave = np.maximum(np.cos(outside - np.array(CHAMBER_ANGLES_RAD)), 0.0)
    return drive.co_contraction_Pa + drive.peak_pressure_Pa * amplitude(drive, t_s) * wave
