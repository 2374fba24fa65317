"""A kerb across the robot's way, which the fault `obstacle` lays: a floor with a step whose riser is far until then."""

from __future__ import annotations

from sim.scene import Scene
from softbot.errors import InputError
from softbot.faults import FaultKind

FAR_M = 1e3
"""Where the riser is before the fault strikes."""
_LEAST_M = 1e-6


def with_kerb(scene: Scene) -> Scene:
    """The scene on a floor that can have a kerb, where one of its faults is an obstacle; else the scene as it is.

    Raises InputError for two of them, for one that grows or comes and goes, and where there is no plane to lie on.
    """
    kerbs = [fault for fault in scene.fault if fault.kind is FaultKind.OBSTACLE]
    if not kerbs:
        return scene
    if len(kerbs) > 1:
        raise InputError("fault.kind = 'obstacle': there can be one of it; for more give the scene [[body]] tables")
    if kerbs[0].ramp_s > 0.0 or kerbs[0].period_s is not None:
        raise InputError("fault.ramp_s, fault.period_s: an obstacle lies there from one moment on; leave both out")
    if scene.world.ground != "plane":
        raise InputError(f"fault.kind = 'obstacle': lies on world.ground = \"plane\", this is {scene.world.ground!r}")
    floor = {"ground": "step", "step_distance_m": FAR_M, "step_height_m": _LEAST_M}
    return scene.model_copy(update={"world": scene.world.model_copy(update=floor)})
