"""Lock and unlock: revolutions per cycle over frequency × peak pressure (one roll of the rod twin for each dot).

A slow sequence of pressures carries the robot along, one revolution a cycle: it is phase-locked. A fast or a weak one
slips past it. Each roll starts from rest at its full frequency, on a floor, and is judged by its cycles after the first
two: whether the sequence takes the robot along at once. (A robot that slips is dragged along a little and spins up, so
that in the end, after many more cycles, it may be caught at a frequency that it cannot start at.)

The bend that a peak pressure gives is that of one chamber in the robot's actuator law (`softbot.actuator`), and it is
given to the rod as a curvature: how far valves and gas would lag behind a fast command is left out, so that what is
seen is the mechanics alone.
"""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sim.figures._canvas import sheet, write
from sim.run_many import run_many
from softbot.errors import InputError, SoftbotError
from softbot.robot import Robot, load_robot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from sim.scene import Scene

FloatArray = NDArray[np.float64]

LOCKED = 0.95
"""Revolutions per cycle from which a roll counts as phase-locked."""

_RAMP_S = 0.3
_SETTLING_CYCLES = 2


def draw(
    path: Path,
    *,
    robot: str = "default",
    frequencies: int = 24,
    pressures: int = 20,
    lowest_Hz: float = 0.25,
    highest_Hz: float = 20.0,
    cycles: int = 8,
    friction: float = 0.6,
    accuracy: str = "standard",
    processes: int | None = None,
) -> dict[str, Any]:
    """Roll a robot at `frequencies` (logarithmic) × `pressures` (even, up to its limit), each for `cycles`, drawn.

    Returns frequencies [Hz], peak pressures [Pa], the curvatures they give [1/m], revolutions per cycle (a row for each
    pressure; None for a roll that failed), for each pressure the highest frequency up to which it is locked (None where
    it never is), and what the rolls took [s]. Raises InputError for a grid smaller than 2 × 2 or without a width, and
    for less than one cycle.
    """
    if min(frequencies, pressures) < 2:
        raise InputError(f"frequencies = {frequencies}, pressures = {pressures}: a map needs at least 2 of each")
    if not 0.0 < lowest_Hz < highest_Hz:
        raise InputError(f"lowest_Hz = {lowest_Hz:g}, highest_Hz = {highest_Hz:g}: must be above 0 and rise")
    if cycles < 1:
        raise InputError(f"cycles = {cycles}: at least one has to be measured")
    rolled = load_robot(robot)
    frequency_Hz = np.geomspace(lowest_Hz, highest_Hz, frequencies)
    pressure_Pa = np.linspace(0.0, rolled.max_pressure_Pa, pressures + 1)[1:]
    curvature_1_m = bends_1_m(rolled, pressure_Pa)
    scenes = [
        _roll(rolled, float(curvature), float(frequency), cycles, friction, accuracy)
        for curvature in curvature_1_m
        for frequency in frequency_Hz
    ]
    began_s = time.perf_counter()
    # the slow rolls are long and the fast ones fine: mixed, so that no process is left alone with the dear ones
    order = np.random.default_rng(0).permutation(len(scenes))
    results = run_many([scenes[index] for index in order], processes)
    took_s = time.perf_counter() - began_s
    turned = np.empty(len(scenes))
    for index, result in zip(order, results, strict=True):
        turned[index] = math.nan if isinstance(result, SoftbotError) else _per_cycle(result.summary, scenes[index])
    per_cycle = turned.reshape(pressures, frequencies)
    figure, ((axis,),) = sheet(1, width_in=7.2, height_in=5.0)
    _paint(axis, frequency_Hz, pressure_Pa, curvature_1_m, per_cycle)
    axis.set_title(
        f"{rolled.name}: {len(scenes)} rolls of the rod twin from rest, cycles {_SETTLING_CYCLES + 1} to "
        f"{_SETTLING_CYCLES + cycles}, friction {friction:g}",
        fontsize=9,
    )
    write(figure, path)
    return {
        "robot": rolled.name,
        "frequencies_Hz": frequency_Hz.tolist(),
        "peak_pressures_Pa": pressure_Pa.tolist(),
        "curvatures_1_m": curvature_1_m.tolist(),
        "revolutions_per_cycle": [[None if math.isnan(one) else one for one in row] for row in per_cycle.tolist()],
        "locked_up_to_Hz": [locked_up_to_Hz(frequency_Hz, row) for row in per_cycle],
        "rolls": len(scenes),
        "failed": int(np.isnan(per_cycle).sum()),
        "took_s": took_s,
    }


def bends_1_m(robot: Robot, pressure_Pa: FloatArray) -> FloatArray:
    """Curvature that each peak pressure gives in one chamber (1, of nominal gain), shape of `pressure_Pa` [1/m]."""
    law = robot.actuator_law()
    return np.array([np.hypot(*law.equilibrium([0.0, peak_Pa, 0.0, 0.0]).curvature_1_m) for peak_Pa in pressure_Pa])


def locked_up_to_Hz(frequency_Hz: FloatArray, per_cycle: FloatArray) -> float | None:
    """Highest of the frequencies below which every one is locked; None where the lowest is not."""
    slips = np.flatnonzero(~(per_cycle >= LOCKED))
    locked = len(frequency_Hz) if len(slips) == 0 else int(slips[0])
    return float(frequency_Hz[locked - 1]) if locked else None


def _roll(
    robot: Robot, curvature_1_m: float, frequency_Hz: float, cycles: int, friction: float, accuracy: str
) -> Scene:
    from sim.scene import scene_from

    period_s = 1.0 / frequency_Hz
    steady_s = _RAMP_S + _SETTLING_CYCLES * period_s
    return scene_from(
        {
            "robot": robot.table(),
            "drive": {
                "kind": "curvature",
                "curvature_1_m": curvature_1_m,
                "period_s": period_s,
                "start_s": _RAMP_S,
                "ramp_s": _RAMP_S,
            },
            "world": {"friction": friction},
            "solver": {"twin": "rod", "accuracy": accuracy, "duration_s": steady_s + cycles * period_s},
            "metrics": {"steady_after_s": steady_s},
        },
        f"lock map at {frequency_Hz:.3g} Hz, {curvature_1_m:.3g} /m",
        Path(),
    )


def _per_cycle(summary: dict[str, Any], scene: Scene) -> float:
    """Revolutions of the robot per cycle of the drive, positive in the direction that the drive rolls it."""
    return (
        -scene.drive.direction * float(summary["revolutions"]) * scene.drive.period_s / float(summary["steady_span_s"])
    )


def _paint(
    axis: Axes, frequency_Hz: FloatArray, pressure_Pa: FloatArray, curvature_1_m: FloatArray, per_cycle: FloatArray
) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    pressure_kPa = 1e-3 * pressure_Pa
    axis.set_facecolor("0.8")  # a roll that failed
    axis.grid(visible=False)
    shown = axis.pcolormesh(
        frequency_Hz,
        pressure_kPa,
        np.ma.masked_invalid(per_cycle),
        cmap="viridis",
        vmin=0.0,
        vmax=1.0,
        shading="nearest",
    )
    bar = axis.figure.colorbar(shown, ax=axis, extend="both")
    bar.set_label("revolutions per cycle")
    if np.nanmin(per_cycle) < LOCKED <= np.nanmax(per_cycle):
        line = axis.contour(
            frequency_Hz, pressure_kPa, np.nan_to_num(per_cycle), [LOCKED], colors="#d55e00", linewidths=2
        )
        axis.clabel(line, fmt={LOCKED: f"locked: {LOCKED:g}"}, fontsize=9)
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_xlabel("frequency of the sequence [Hz]")
    axis.set_ylabel("peak pressure of a chamber [kPa]")
    ends_kPa, ends_1_m = (np.insert(ends, 0, 0.0) for ends in (pressure_kPa, curvature_1_m))
    ends_kPa, ends_1_m = (
        np.append(ends, 2.0 * ends[-1] - ends[-2]) for ends in (ends_kPa, ends_1_m)
    )  # half a dot more

    def curvatures(kPa: Any) -> Any:
        return np.interp(kPa, ends_kPa, ends_1_m)

    def pressures(per_m: Any) -> Any:
        return np.interp(per_m, ends_1_m, ends_kPa)

    bent = axis.secondary_yaxis("right", functions=(curvatures, pressures))
    bent.set_ylabel("curvature it gives [1/m]")
