"""The natural frequency of the mode that rings loudest in a signal.

Least squares of c + e^(−σt)·(a·cos ωt + b·sin ωt) under a Hann window, whose narrow side lobes keep other modes out;
the search starts where the spectrum is highest. Of a damped mode σ = ζω₀ and ω = ω₀√(1 − ζ²), so √(σ² + ω²) is the
frequency that the mode would have undamped.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

FloatArray = NDArray[np.float64]

_FEWEST_TURNS = 3.0


def natural_frequency_rad_s(signal: FloatArray, sample_s: float) -> float:
    """Undamped angular frequency [rad/s] of the loudest mode of a signal (n,) about any constant.

    sample_s: time between samples [s]; modes above half the sampling rate are not seen. Raises ArithmeticError for a
    signal that does not ring at least three times.
    """
    window = np.hanning(len(signal))
    time = np.arange(len(signal)) * sample_s
    start = _peak_rad_s(signal, sample_s, window)
    duration_s = len(signal) * sample_s
    if start * duration_s < 2.0 * math.pi * _FEWEST_TURNS:
        raise ArithmeticError("the signal does not ring")
    weight = np.sqrt(window)

    def shapes(sigma: float, omega: float) -> FloatArray:
        fades = np.exp(-sigma * time)
        waves = [np.ones_like(time), fades * np.cos(omega * time), fades * np.sin(omega * time)]
        return weight[:, None] * np.stack(waves, axis=1)

    def residual(parameter: FloatArray) -> FloatArray:
        shape = shapes(*parameter)
        amplitude = np.linalg.lstsq(shape, weight * signal, rcond=None)[0]
        left: FloatArray = (shape @ amplitude - weight * signal) / np.ptp(signal)
        return left

    found = least_squares(residual, [1.0 / duration_s, start], x_scale=[1.0 / duration_s] * 2, xtol=1e-12, ftol=1e-14)
    return float(math.hypot(*found.x))


def _peak_rad_s(signal: FloatArray, sample_s: float, window: FloatArray) -> float:
    if not np.isfinite(signal).all() or np.ptp(signal) <= 0.0:
        return 0.0
    count = 16 * len(signal)
    mean = float(window @ signal / window.sum())
    spectrum = np.abs(np.fft.rfft((signal - mean) * window, count))
    return float(2.0 * np.pi * np.argmax(spectrum) / (count * sample_s))
