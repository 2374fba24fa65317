"""Which twin a scene gets: its engine, step and resolution, from `[solver]`."""

from __future__ import annotations

import os
import sys

from sim.body import Body, Twin, World
from sim.scene import Scene, steps_per_period
from softbot.errors import InputError

# accuracy → step [s] and resolution; how well each does stands in benchmarks/segment_twin.md
BULLET = {"fast": (0.005, 10), "standard": (0.0025, 10), "reference": (0.001, 20)}
ROD = {"fast": (0.005, 2, 12), "standard": (0.0025, 3, 16), "reference": (0.001, 4, 32)}

LEAST_STEPS_PER_TURN = 20
"""Of a drive's period: with fewer the drive aliases with the step and the result means nothing."""


def make_twin(scene: Scene, *, gui: bool = False) -> Twin:
    """The twin of a scene, straight and at rest. Stretch is left out where no chamber drives it."""
    body = Body.of(scene.robot)
    world = World(**scene.world.model_dump())
    stretches = scene.drive.kind != "curvature"
    solver = scene.solver
    chosen_s = BULLET[solver.accuracy][0] if solver.twin == "bullet" else ROD[solver.accuracy][0]
    least_s = LEAST_STEPS_PER_TURN * (solver.step_s or chosen_s)
    if scene.drive.kind != "sequencer" and scene.drive.period_s < least_s:
        raise InputError(
            f"drive.period_s = {scene.drive.period_s:g}: the curvature would turn in fewer than {LEAST_STEPS_PER_TURN} "
            f"steps; take at least {least_s:g} s, a higher solver.accuracy or a smaller solver.step_s"
        )
    if gui and solver.twin != "bullet":
        raise InputError('--gui: only the segment twin has a window; add --set solver.twin="bullet"')
    if gui and sys.platform == "linux" and not os.environ.get("DISPLAY"):
        raise InputError("--gui: there is no screen (DISPLAY is not set); run without --gui")  # PyBullet would exit
    if solver.twin == "bullet":
        from sim.bullet import BulletTwin

        step_s, segments = BULLET[solver.accuracy]
        step_s = solver.step_s or step_s
        steps_per_period(step_s)
        return BulletTwin(
            body, world, segments=solver.segments or segments, step_s=step_s, stretches=stretches, gui=gui
        )
    from sim.rod import RodTwin

    step_s, modes, points = ROD[solver.accuracy]
    step_s = solver.step_s or step_s
    steps_per_period(step_s)
    return RodTwin(body, world, modes=solver.modes or modes, contact_points=points, step_s=step_s, stretches=stretches)
