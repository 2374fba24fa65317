"""Compile what the tests of this folder run, and design the pressure loop they use: both are then found on disk."""

from __future__ import annotations

from pathlib import Path

from sim.scene import load_scene
from softbot.nodes import direct
from softbot.nodes.rehearsal import rehearse_plant, rehearse_sequencer
from softbot.nodes.warm_up import warm_up

if __name__ == "__main__":
    scene = load_scene(Path(__file__).parents[2] / "scenes" / "damaged.toml", ())
    warm_up(scene)
    rehearse_plant(scene)
    rehearse_sequencer(scene)
    direct.warm_up(scene)
