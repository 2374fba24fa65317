"""Compile what a run will use before the run, so that neither its wall time nor its progress counts compiling.

The kernels are kept on disk by numba, so only the very first run on a machine waits.
"""

from __future__ import annotations

import numpy as np

from sim.body import Body
from sim.plan import GIVEN
from sim.scene import Scene
from sim.trajectory import Trajectory
from sim.twins import make_twin


def warm_up(scene: Scene) -> None:
    """Run a throw-away plant of the same making for a step."""
    twin = make_twin(scene)
    try:
        if scene.drive.kind in GIVEN:
            twin.set_rest(np.array([1.0, 0.0, 0.0]), Body.of(scene.robot).rest_stiffness())
            twin.step()
        else:
            from sim.plant import Plant

            plant = Plant(scene.robot, twin, (), scene.world.gravity_m_s2, scene.solver.seed)
            plant.advance(np.zeros(4), True, 1)
            plant.read_sensors()
        Trajectory(scene.robot.length_m, grounded=True).follow(twin.motion())
    finally:
        twin.close()
