"""A robot whose pressure limits leave the valve board no room is refused by file and key, before a folder is made."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim.scene import Scene


def check_board_room(scene: Scene, path: Path, assignments: tuple[str, ...]) -> None:
    """Raise InputError for a scene with a board that would refuse its limits. path: the scene's file."""
    if scene.drive.kind == "sequencer":
        from sim.scene import place_of_robot
        from softbot.nodes.plant_node import board_limits

        board_limits(scene.robot, place_of_robot(path, assignments))
