"""The twin of a scene, made as its plan says (`sim.plan`)."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection

from sim.body import Body, Twin, World
from sim.plan import Plan, make_plan
from sim.scene import Scene, steps_per_period
from softbot.errors import InputError


def world_of(scene: Scene) -> World:
    """What surrounds the robot of a scene."""
    return World(**scene.world.model_dump())


def chosen_step_s(scene: Scene) -> float:
    """The step that a scene is run with [s]."""
    return make_plan(scene).step_s


def make_twin(scene: Scene, *, gui: bool = False, keep: Collection[str] = ()) -> Twin:
    """The twin of a scene, straight and at rest.

    keep: names of leave-out rules that are not to be applied (`sim.plan.RULES`). Raises InputError for a drive too fast
    for the step, and for a window where there can be none.
    """
    plan = make_plan(scene, keep=keep)
    steps_per_period(plan.step_s)
    if gui and scene.solver.twin != "bullet":
        raise InputError('--gui: only the segment twin has a window; add --set solver.twin="bullet"')
    if gui and sys.platform == "linux" and not os.environ.get("DISPLAY"):
        raise InputError("--gui: there is no screen (DISPLAY is not set); run without --gui")  # PyBullet would exit
    return _segment_twin(plan, gui) if scene.solver.twin == "bullet" else _rod_twin(plan)


def _rod_twin(plan: Plan) -> Twin:
    from sim.rod import RodTwin

    scene, resolution = plan.scene, plan.resolution
    assert resolution is not None
    body, world = Body.of(scene.robot), world_of(scene)
    rod = RodTwin(
        body,
        world,
        modes=resolution.modes,
        contact_points=resolution.contact_points,
        step_s=resolution.step_s,
        stretches=not plan.leaves_out("stretch"),
        symmetric=plan.leaves_out("mirror"),
        twists=not plan.leaves_out("twist"),
        tolerance=scene.solver.tolerance or 0.0,
    )
    if not scene.body:
        return rod
    from sim.rod_among_bodies import RodAmongBodies

    return RodAmongBodies(rod, scene.body, body, world)


def _segment_twin(plan: Plan, gui: bool) -> Twin:
    from sim.bullet import BulletTwin

    scene = plan.scene
    assert plan.segments is not None
    return BulletTwin(
        Body.of(scene.robot),
        world_of(scene),
        segments=plan.segments,
        step_s=plan.step_s,
        stretches=scene.drive.kind not in ("curvature", "contraction"),
        bodies=scene.body,
        gui=gui,
    )
