"""Rolling and rotation moments of axial muscles, in closed form and summed from their forces (the paper's Fig. 3(c)).

Lines: Eq. (1) in its N-segment form and the rotation moment of the paper, from `softbot.rolling`. Dots: Σ r × F over
the pulls of straight muscles on N + 1 junctions, from `softbot.muscle`, which shares no formula with the lines. All is
over F_m R, so that of a robot only its half bend φ₀ and its number of segments N are left. Signs are those of Eq. (1):
about the tangent, and for the rotation about the chord.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.figures._canvas import COLOURS, sheet, write
from softbot.errors import InputError
from softbot.muscle import muscle_pulls, pull_moments
from softbot.rolling import rotation_moment_N_m, segmented_rolling_moment_N_m

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SLENDERNESS = 40.0 / 3.0  # length over radius, of the larva; the moments do not depend on it
_QUARTER_TURN_RAD = 0.5 * math.pi


def draw(
    path: Path,
    *,
    half_bend_rad: float = 0.9,
    half_bends_rad: tuple[float, ...] = (0.3, 0.6, 0.9, 1.2),
    segments: tuple[int, ...] = (1, 2, 3, 11),
) -> dict[str, Any]:
    """Draw the moments over θ for each N (at `half_bend_rad`), over θ for each bend (at the last N), and over φ₀.

    Returns every dot with the closed forms beside it, over F_m R, and the largest difference between the two. Raises
    InputError for half bends outside 0 … π, N below 1, and more curves than there are colours.
    """
    for bend in (half_bend_rad, *half_bends_rad):
        if not 0.0 < bend <= math.pi:
            raise InputError(f"half bend {bend:g} rad: must be above 0 and at most pi")
    if max(len(segments), len(half_bends_rad)) > len(COLOURS):
        raise InputError(f"at most {len(COLOURS)} curves of a kind can be told apart")
    figure, ((by_count, by_bend, over_bend),) = sheet(3, width_in=4.9, height_in=4.6)
    dots: list[dict[str, float]] = []
    angles = [(half_bend_rad, theta) for theta in np.linspace(-math.pi, math.pi, 181)]
    bends = [(bend, _QUARTER_TURN_RAD) for bend in np.linspace(1e-6, math.pi, 181)]
    for count, colour in zip(segments, COLOURS, strict=False):
        dots += _curves(by_count, "theta", angles, 15, count, colour, f"N = {count}")
        dots += _curves(over_bend, "bend", bends, 12, count, colour, f"N = {count}")
    for bend, colour in zip(half_bends_rad, COLOURS, strict=False):
        angles = [(bend, theta) for _, theta in angles]
        dots += _curves(by_bend, "theta", angles, 15, segments[-1], colour, f"φ₀ = {bend:g}")
    over_bend.plot([0.0, math.pi], [0.0, -2.0 * math.pi], ":", color="0.4", linewidth=1, label="N → ∞: −2φ₀")

    for axis, title in ((by_count, f"half bend φ₀ = {half_bend_rad:g} rad"), (by_bend, f"N = {segments[-1]} segments")):
        for side in (-1, 1):
            axis.axvspan(side * 90, side * 180, color="0.5", alpha=0.12, linewidth=0)
        axis.set(xlim=(-180, 180), xticks=range(-180, 181, 90), title=title)
        axis.set_xlabel("angle θ of the active muscle from the inner side [°]")
        axis.text(0.985, 0.02, "grey: the C flips instead of rolling", transform=axis.transAxes, fontsize=8, ha="right")
    over_bend.set(xlim=(0, math.pi), title="θ = 90°", xlabel="half bend φ₀ [rad]")
    by_count.set_ylabel("moment on the body / (F$_m$ R)")
    for axis in (by_count, by_bend, over_bend):
        axis.axhline(0.0, color="0.3", linewidth=0.8)
        axis.margins(y=0.05 if axis is over_bend else 0.16)
        curves = 1 if axis is over_bend else 4
        axis.legend(fontsize=8, frameon=False, ncols=curves, loc="lower left" if curves == 1 else "upper center")
    figure.suptitle(
        "Moments of axial muscles. Solid: rolling, about the curved axis; dashed: rotation of the whole, about the "
        "chord; dots: Σ r × F of the muscles' forces",
        fontsize=10,
    )
    write(figure, path)
    gaps = [abs(dot[kind] - dot[f"{kind}_summed"]) for dot in dots for kind in ("rolling", "rotation")]
    return {"unit": "F_m R", "dots": dots, "largest_difference": max(gaps)}


def _curves(
    axis: Axes, across: str, places: list[tuple[float, float]], spacing: int, count: int, colour: str, label: str
) -> list[dict[str, float]]:
    """Closed forms at places (φ₀, θ) as lines and every `spacing`-th one summed, as dots; the dots."""
    x = np.array([math.degrees(theta) if across == "theta" else bend for bend, theta in places])
    rolling = np.array([-segmented_rolling_moment_N_m(1.0, 1.0, *place, count) for place in places])
    rotation = np.array([rotation_moment_N_m(1.0, 1.0, *place, count) for place in places])
    chosen = range(spacing, len(places), spacing)
    sums = [pull_moments(muscle_pulls(1.0, 1.0, _SLENDERNESS, *places[i], count)) for i in chosen]
    axis.plot(x, rolling, color=colour, label=label)
    axis.plot(x, rotation, "--", color=colour, linewidth=1.2)
    for values in ([one.rolling_N_m for one in sums], [one.rotation_N_m for one in sums]):
        axis.plot(x[chosen], values, "o", color=colour, markersize=4, markeredgecolor="white", markeredgewidth=0.5)
    return [
        {
            "half_bend_rad": places[i][0],
            "theta_rad": float(places[i][1]),
            "segments": count,
            "rolling": float(rolling[i]),
            "rolling_summed": one.rolling_N_m,
            "rotation": float(rotation[i]),
            "rotation_summed": one.rotation_N_m,
        }
        for i, one in zip(chosen, sums, strict=True)
    ]
