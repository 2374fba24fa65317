"""Open-loop drives: the intrinsic curvature or the chamber pressures that a scene asks for at a time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim.scene import Drive
from softbot.cross_section import CHAMBER_ANGLES_RAD

FloatArray = NDArray[np.float64]


def amplitude(drive: Drive, t_s: float) -> float:
    """Share of the full bend at `t_s`, 0 … 1: straight, then bent by start_s over ramp_s."""
    return min(max((t_s - drive.start_s) / drive.ramp_s + 1.0, 0.0), 1.0)


def phase_rad(drive: Drive, t_s: float) -> float:
    """Direction of the wanted curvature in the body frame at `t_s` [rad]; it turns from start_s on."""
    return drive.direction * 2.0 * math.pi * max(t_s - drive.start_s, 0.0) / drive.period_s


def curvature_1_m(drive: Drive, t_s: float) -> FloatArray:
    """Intrinsic curvature vector at `t_s`, shape (2,) [1/m], for drive.kind = "curvature"."""
    assert drive.curvature_1_m is not None
    angle = phase_rad(drive, t_s)
    return drive.curvature_1_m * amplitude(drive, t_s) * np.array([math.cos(angle), math.sin(angle)])


def without_chamber(curvature_1_m: FloatArray, chamber: int, lost: float) -> FloatArray:
    """A given curvature vector (2,) [1/m] less what a chamber that has lost the share `lost` (0 … 1) would give.

    Chamber i bends towards α_i + π, and no other chamber does; that component is what a dead one takes away.
    """
    angle = CHAMBER_ANGLES_RAD[chamber] + math.pi
    towards = np.array([math.cos(angle), math.sin(angle)])
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
