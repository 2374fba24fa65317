"""A rehearsal goes as far as a loop does in its first moments, and leaves nothing behind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from controllers.interface import SequencerState
from controllers.pressure_loop import PressureLoopGains
from firmware_protocol.enumerations import BoardMode
from sim.scene import Scene
from softbot.nodes import rehearsal
from softbot.nodes.plant_node import PlantNode
from softbot.nodes.rehearsal import rehearse_plant, rehearse_sequencer
from softbot.nodes.sequencer_node import SequencerNode

MakeScene = Callable[..., Scene]


def remembered(monkeypatch: pytest.MonkeyPatch, made: type) -> list[Any]:
    """The nodes that a rehearsal makes."""
    nodes: list[Any] = []

    def make(*arguments: Any) -> Any:
        nodes.append(made(*arguments))
        return nodes[-1]

    monkeypatch.setattr(rehearsal, made.__name__, make)
    return nodes


def test_the_plant_is_armed_and_pressurised(
    make_scene: MakeScene, gains: PressureLoopGains, monkeypatch: pytest.MonkeyPatch
) -> None:
    nodes = remembered(monkeypatch, PlantNode)
    rehearse_plant(make_scene(), gains)
    assert nodes[0].rules.state.mode is BoardMode.ARMED
    assert nodes[0].plant.pressure_Pa[:4].min() > 1e3


def test_the_sequencer_is_armed_and_commands(make_scene: MakeScene, monkeypatch: pytest.MonkeyPatch) -> None:
    nodes = remembered(monkeypatch, SequencerNode)
    rehearse_sequencer(make_scene("sequencer.start_s=5"))
    assert nodes[0].failure is None
    assert nodes[0].link.armed
    assert nodes[0].state is not SequencerState.DISARMED
