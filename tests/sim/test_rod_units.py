"""The rod's units are compiled elsewhere for just the types that its kernel calls them with."""

from __future__ import annotations

from pathlib import Path

from sim.rod_kernel import play
from sim.rod_units import rod_units
from sim.scene import load_scene
from sim.twins import make_twin
from softbot.kernel_cache import units_of


def test_what_is_told_of_a_unit_is_what_it_is_called_with() -> None:
    scene = load_scene(Path(__file__).parents[2] / "scenes" / "slow_roll.toml")
    make_twin(scene).step()
    (compiled,) = play.overloads.values()
    called = {unit.name for unit in units_of(compiled.library)}
    assert called >= {unit.__name__ for unit, _ in rod_units()} - {"place_rod"}
    for unit, signature in rod_units():
        (made,) = unit.overloads.values()
        assert made.signature == signature, unit.__name__
