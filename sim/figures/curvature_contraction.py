"""Curvature of a tube against the contraction of its muscles, for several pressures (the paper's Fig. 3(b)).

Lines: Eq. (2), solid up to the kink and dashed beyond it, where less contraction goes with more curvature and no tube
rests. Crosses: where the rod twin comes to rest when its muscles contract by so much (the rest curvature of
`softbot.muscle`, the ovalising section of the twin); they solve no equation of the paper, they come to rest. The
paper's own marks, one for each trial with a larva, are not published as numbers and not shown.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from sim.figures._canvas import COLOURS, sheet, write
from softbot.errors import InputError, SimulationError
from softbot.muscle import linear_rest_curvature_1_m
from softbot.robot import load_robot
from softbot.tube import (
    Tube,
    curvature_from_strain_difference,
    kink_scaled_curvature,
    max_strain_difference,
    strain_difference_from_curvature,
)

_CROSSES = 8
_LAST_CROSS = 0.98  # of the contraction at the kink, where the rod takes ever longer to come to rest
_STILL = 1e-9  # of the bend, that a rod at rest may change in a time of its damping


def draw(
    path: Path,
    *,
    scaled_pressures: tuple[float, ...] = (1.0, 2.0, 3.3, 5.0),
    poisson_ratio: float = 0.5,
    twin: bool = True,
) -> dict[str, Any]:
    """Draw κ̄ over Δε for each p̄, with the kinks, and the rod's own rest states unless `twin` is false.

    Returns, for each p̄, the kink (Δε, κ̄) and the crosses [Δε, κ̄ of the rod, κ̄ of Eq. (2)], and the largest relative
    difference between the two. Raises InputError for p̄ ≤ 0, a Poisson ratio out of range and more p̄ than colours.
    """
    if len(scaled_pressures) > len(COLOURS):
        raise InputError(f"scaled_pressures: at most {len(COLOURS)} can be told apart")
    figure, ((axis,),) = sheet(1, width_in=7.4, height_in=4.8)
    drawn: list[dict[str, Any]] = []
    for pressure, colour in zip(scaled_pressures, COLOURS, strict=False):
        kink, most = kink_scaled_curvature(pressure), max_strain_difference(pressure, poisson_ratio)
        stable = np.linspace(0.0, kink, 200)
        contraction = [strain_difference_from_curvature(value, pressure, poisson_ratio) for value in stable]
        axis.plot(contraction, stable, color=colour, label=f"p̄ = {pressure:g}")
        # beyond the kink Eq. (2) is the mirror image of a lower part of its own: sin 3u, with κ̄ = 2κ̄c sin u
        angle = np.linspace(math.pi / 6.0, math.pi / 3.0, 200)
        axis.plot(most * np.sin(3.0 * angle), 2.0 * kink * np.sin(angle), "--", color=colour, linewidth=1.2)
        axis.plot(most, kink, "o", color=colour, markersize=6)
        crosses = []
        if twin:
            for strain in np.linspace(0.0, _LAST_CROSS * most, _CROSSES + 1)[1:]:
                rested = rod_scaled_curvature(float(strain), pressure, poisson_ratio)
                theory = curvature_from_strain_difference(float(strain), pressure, poisson_ratio)
                crosses.append([float(strain), rested, theory])
            axis.plot(*np.array(crosses).T[:2], "x", color="black", markersize=6, zorder=3)
        drawn.append({"scaled_pressure": pressure, "kink": [most, kink], "crosses": crosses})
    axis.plot([], [], "o", color="0.4", label="kink")
    axis.plot([], [], "--", color="0.4", label="beyond the kink: unstable")
    if twin:
        axis.plot([], [], "x", color="black", label="rod twin, at rest")
    circle = 2.0 * math.pi * load_robot("larva").radius_m / load_robot("larva").length_m
    axis.axhline(circle, color="0.4", linewidth=1, linestyle=":", label="the larva closes to a circle")
    axis.set(xlabel="contraction of the muscles Δε", ylabel="scaled curvature κ̄ = κR", xlim=(0, None), ylim=(0, None))
    axis.set_title(f"Curvature against contraction, Eq. (2), ν = {poisson_ratio:g}")
    axis.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    write(figure, path)
    gaps = [abs(rod / theory - 1.0) for one in drawn for _, rod, theory in one["crosses"]]
    return {"pressures": drawn, "largest_relative_difference": max(gaps, default=None)}


def rod_scaled_curvature(contraction: float, scaled_pressure: float, poisson_ratio: float) -> float:
    """κ̄ at which a floating rod comes to rest when its muscles contract by Δε on one side and never let go.

    Raises SimulationError when it does not come to rest.
    """
    from sim.body import Body, World
    from sim.rod import RodTwin

    radius_m = 0.01  # of a stubby tube: what it rests at does not depend on its size, and it must not close to a circle
    tube = Tube(radius_m, 0.1 * radius_m, 1e5, poisson_ratio)
    stiffness = tube.bending_stiffness_N_m2
    body = Body(
        length_m=3.0 * radius_m,
        radius_m=radius_m,
        mass_kg=0.01,
        bending_stiffness_N_m2=stiffness,
        twisting_stiffness_N_m2=stiffness,
        axial_stiffness_N=stiffness / radius_m**2,
        damping_time_s=0.05,
        ovalisation_m2=3.0 * radius_m**2 / (8.0 * scaled_pressure),
    )
    world = World(gravity_m_s2=0.0, ground="none", friction=0.0, friction_law="coulomb")
    rod = RodTwin(body, world, modes=1, contact_points=4, step_s=0.005, stretches=False, twists=False)
    rest = np.array([1.0, linear_rest_curvature_1_m(tube, contraction), 0.0])
    rod.set_rest(rest, body.rest_stiffness())
    last = 0.0
    for _ in range(2000):
        rod.advance(10)
        now = float(np.hypot(*rod.strain()[1:])) * radius_m
        if abs(now - last) <= _STILL * now:
            return now
        last = now
    raise SimulationError(f"the rod does not come to rest at a contraction of {contraction:g}")
