"""Where a bent robot comes to rest, without the motion that leads there.

Pseudo-transient continuation: steps of the rod that are far longer than any of its motions, each started from
standstill (`RodTwin.halt`). Such a step solves (M/h² + K + contact) Δq = forces, which is Newton's method on the energy
with the inertia as its safeguard; at rest it changes nothing. The bend is brought on in a few parts, because where
friction holds a robot depends on how it got there: this is the rest of a robot that was bent slowly.

A robot that slides or rolls on for ever has no rest, and is refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from sim import motion_rows
from sim.body import Body
from sim.drive import active_side_rad, bend_1_m, lost_shares, pressures_Pa, without_chamber
from sim.recorder import Recorder
from sim.rod import RodTwin
from sim.scene import Scene
from sim.summary import write_summary
from softbot.errors import SimulationError
from softbot.faults import CHAMBER_COUNT

FloatArray = NDArray[np.float64]
RestStrains = Callable[[float], tuple[FloatArray, FloatArray]]
"""Share of the load, 0 … 1 → rest strains (ℓ, k1, k2) and section stiffness (3, 3)."""

PARTS = 4
_CLOSE = 1e-3  # radii a step, within which an earlier part is near enough
_MOST_ITERATIONS = 3000


@dataclass(frozen=True)
class Equilibrium:
    """The rest that was found."""

    row: FloatArray
    """As `sim.motion_rows` lays it out."""
    iterations: int
    residual: float
    """Largest move of pose or shape in the last step, over the radius."""


def equilibrium(
    rod: RodTwin, rest: RestStrains, body: Body, *, held: bool, tolerance: float = 1e-5, parts: int = PARTS
) -> Equilibrium:
    """Bring a rod to rest under `rest(1)`, going there in `parts` parts. The rod is left where it rests.

    The rod's own step is the pseudo-time step: longer is faster, `sim.resolution.equilibrium_step_s` is long enough.
    held: ground or a clamp holds the rod; else only its shape comes to rest. tolerance: largest move in one more step,
    over the radius. Raises SimulationError when there is no rest.
    """
    iterations, moved = 0, 0.0
    before = _places(rod.row(), body, held)
    for part in range(1, parts + 1):
        rod.set_rest(*rest(part / parts))
        enough = tolerance if part == parts else max(_CLOSE, tolerance)
        while True:
            rod.step()
            rod.halt()
            iterations += 1
            row = rod.row()
            after = _places(row, body, held)
            moved = float(np.abs(after - before).max()) / body.radius_m
            before = after
            if moved <= enough:
                break
            if iterations >= _MOST_ITERATIONS:
                raise SimulationError(
                    f"no rest was found in {iterations} steps (it still moves by {moved:.2g} radii a step): does the "
                    'robot slide or roll on for ever? more friction, less slope, or solver.question = "motion"'
                )
    row[motion_rows.TIME] = 0.0
    return Equilibrium(row, iterations, moved)


def _places(row: FloatArray, body: Body, held: bool) -> FloatArray:
    """Lengths that tell pose and shape [m]: middle, centre of mass, skin about the middle, ends, depth of the bend.

    Of a rod that nothing holds, seen from its middle.
    """
    half_m, deep_m2 = 0.5 * body.length_m, body.length_m**2 / 8.0
    middle, centre = row[motion_rows.POSITION], row[motion_rows.CENTRE_OF_MASS]
    return np.concatenate(
        [
            middle if held else np.zeros(3),
            centre if held else centre - middle,
            body.radius_m * row[motion_rows.ROTATION],
            half_m * row[motion_rows.CHORD],
            deep_m2 * row[motion_rows.CURVATURE],
            [deep_m2 * row[motion_rows.SHARPEST_CURVATURE], half_m * row[motion_rows.STRETCH]],
        ]
    )


def rest_strains(scene: Scene) -> RestStrains:
    """What an open-loop scene asks of the tube at `start_s`, bent and before it turns, with all its faults."""
    drive, robot = scene.drive, scene.robot
    lost = lost_shares(scene.fault)
    if drive.kind == "pressure":
        law = robot.actuator_law()
        asked_Pa = pressures_Pa(drive, drive.start_s) * (1.0 - lost)

        def under_pressure(share: float) -> tuple[FloatArray, FloatArray]:
            rest = law.equilibrium(share * asked_Pa)
            return np.array([rest.stretch, *rest.curvature_1_m]), rest.stiffness

        return under_pressure
    curvature_1_m = np.array([bend_1_m(drive, robot), 0.0])
    for chamber in range(CHAMBER_COUNT):
        curvature_1_m = without_chamber(curvature_1_m, chamber, float(lost[chamber]), robot.actuation)
    stiffness = Body.of(robot).rest_stiffness()
    return lambda share: (np.array([1.0, *(share * curvature_1_m)]), stiffness)


def run_equilibrium(
    scene: Scene, rod: RodTwin, recorder: Recorder, run_dir: Path | None = None
) -> tuple[dict[str, Any], pa.Table]:
    """Find the rest of a scene and record it as a run of one sample, at time 0; its summary and telemetry.

    The summary's `steps` are the iterations, and `equilibrium` says how well the rest is known. run_dir: the recorder's
    folder. Raises SimulationError when there is no rest; the recording is then finished too, without a sample.
    """
    recorder.start_clock()
    try:
        found = equilibrium(rod, rest_strains(scene), Body.of(scene.robot), held=scene.world.ground != "none")
    except SimulationError as error:
        recorder.finish(0, 0.0, f"failed: {error}")
        raise
    recorder.stop_clock()
    row = found.row[None]
    k1, k2 = row[:, motion_rows.CURVATURE].T
    given: dict[str, Any] = {}
    if scene.drive.kind == "pressure":
        asked_Pa = pressures_Pa(scene.drive, scene.drive.start_s)
        held_Pa = asked_Pa * (1.0 - lost_shares(scene.fault))
        given = {"pressure_Pa": np.append(held_Pa, scene.robot.pneumatics.supply_pressure_Pa), "command_Pa": asked_Pa}
    else:
        at_s = np.array([scene.drive.start_s])
        given = {"active_rad": active_side_rad(scene.drive, scene.robot, at_s, np.arctan2(k2, k1))}
    recorder.block(row, states=("resting",), **given)
    recorder.shape((0.0,), rod)
    summary, telemetry = recorder.finish(found.iterations, 0.0, "done")
    summary["equilibrium"] = {"iterations": found.iterations, "residual": found.residual}
    if run_dir is not None:
        write_summary(run_dir, summary)
    return summary, telemetry
