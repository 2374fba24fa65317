"""Campaign file: a scene, what varies about it, how the robot differs from what its controller believes, and cases.

Run number n of a campaign is drawn from the campaign's seed and n alone: the same file gives the same runs, wherever
and in whatever order they are made.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import pydantic
from pydantic import Field

from sim.scene import Scene, load_scene, scene_from
from softbot.campaign.distribution import Drawn, Spread, drawn
from softbot.errors import InputError
from softbot.robot import Robot
from softbot.toml_file import STRICT, Table, check, override, read_toml

_SEEDS = 2**31


class CaseFault(pydantic.BaseModel):
    """A `[[case.fault]]`: a fault of a scene whose fields may be distributions."""

    model_config = STRICT

    t_s: Drawn = Field(description="when it strikes, in seconds")
    kind: Drawn = Field(description="see the fault library")
    chamber: Drawn | None = Field(None, description="0 to 3; leave out where it is not one chamber's")
    severity: Drawn = 1.0
    ramp_s: Drawn = 0.0
    period_s: Drawn | None = None
    duty: Drawn = 0.5


class Case(pydantic.BaseModel):
    """A `[[case]]`: what befalls a share of the runs."""

    model_config = STRICT

    name: str = Field(min_length=1, description="for the report")
    weight: float = Field(1.0, gt=0, le=1e9, description="share of the runs, over the sum of all weights")
    fault: tuple[CaseFault, ...] = ()
    vary: dict[str, Drawn] = Field(default_factory=dict, description="laid over the campaign's [vary]")


class Campaign(pydantic.BaseModel):
    """A whole campaign."""

    model_config = STRICT

    name: str = "campaign"
    runs: int = Field(gt=0, le=100_000_000, description="number of runs")
    seed: int = Field(0, ge=0, le=2**63 - 1, description="of everything that is drawn")
    matters: bool = Field(
        False,
        description="whether each run of a single fault is made again without the fault, and with it unanswered, so "
        "that its row says whether the fault matters",
    )
    scene: dict[str, Any] = Field(description="as in a scene file")
    vary: dict[str, Drawn] = Field(
        default_factory=dict, description="key of the scene (as for --set) → distribution; the controller knows these"
    )
    mismatch: dict[str, Spread] = Field(
        default_factory=dict,
        description="key of the scene → distribution of a factor by which the simulated robot differs from the one "
        "that the controller believes in; numbers of a list get a factor each",
    )
    case: tuple[Case, ...] = Field((Case(name="all"),), min_length=1)

    @pydantic.field_validator("name")
    @classmethod
    def _names_a_folder(cls, name: str) -> str:
        if name in ("", ".", "..") or "/" in name or "\0" in name:
            raise ValueError("its folder in runs/ is called so, too: take letters and digits")
        return name

    @pydantic.model_validator(mode="after")
    def _distinct(self) -> Self:
        names = [one.name for one in self.case]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"case: two are called {twice[0]!r}; give each a name of its own")
        return self


@dataclass(frozen=True)
class DrawnRun:
    """One run as it was drawn."""

    number: int
    case: str
    scene: Scene
    known: Robot
    """The robot that the controller believes in."""
    values: dict[str, Any]
    """What was drawn, by key of the campaign file."""


class Draws:
    """The runs of a campaign, by number."""

    def __init__(self, campaign: Campaign, source: str, folder: Path) -> None:
        self.campaign = campaign
        self.source, self.folder = source, folder
        base = scene_from(campaign.scene, f"{source}: scene", folder)
        if base.drive.kind != "sequencer":
            raise InputError(f'{source}: scene.drive.kind = "{base.drive.kind}": a campaign runs the sequencer')
        if base.solver.twin != "rod":
            raise InputError(
                f'{source}: scene.solver.twin = "{base.solver.twin}": a campaign runs "rod"; take '
                f"--compare N --twin {base.solver.twin} to make its runs again with the other"
            )
        if base.body:
            raise InputError(f"{source}: scene.body: a campaign runs the robot alone; take the bodies out")
        self._tables: Table = base.table()
        self._known: dict[str, Robot] = {}
        self.run(0)  # whatever is wrong with the keys is wrong with the first

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of all values that a run may have drawn, in the file's order."""
        campaign = self.campaign
        names = [*campaign.vary, *(key for case in campaign.case for key in case.vary)]
        return (*dict.fromkeys(names), *(f"mismatch.{key}" for key in campaign.mismatch))

    def run(self, number: int) -> DrawnRun:
        """Run `number`, from 0 on. Raises InputError when what was drawn is no scene."""
        campaign = self.campaign
        random = np.random.default_rng([campaign.seed, number])
        weights = np.array([case.weight for case in campaign.case])
        case = campaign.case[int(random.choice(len(weights), p=weights / weights.sum()))]
        values: dict[str, Any] = {key: drawn(value, random) for key, value in (campaign.vary | case.vary).items()}
        tables = copy.deepcopy(self._tables)
        for key, value in values.items():
            tables = _set(tables, key, value, f"{self.source}: vary")
        tables["fault"] = [_fault(one, random) for one in case.fault]
        tables["solver"]["seed"] = int(random.integers(_SEEDS))
        tables["name"] = f"{campaign.name}-{number}"
        source = f"{self.source}: run {number}"
        real = copy.deepcopy(tables)
        for key, spread in campaign.mismatch.items():
            factors = _scale(real, key, spread, random, f"{self.source}: mismatch")
            values[f"mismatch.{key}"] = factors[0] if len(factors) == 1 else factors
        known = self._known_robot(tables, source)
        return DrawnRun(number, case.name, scene_from(real, source, Path()), known, values)

    def _known_robot(self, tables: Table, source: str) -> Robot:
        text = repr(tables["robot"])
        if text not in self._known:
            if len(self._known) > 64:
                self._known.clear()
            self._known[text] = check(Robot, tables["robot"], source)
        return self._known[text]


def load_campaign(path: Path, assignments: Iterable[str] = ()) -> Draws:
    """A campaign file with `--set` assignments laid over it. Raises InputError that names file, key and mend."""
    tables = override(read_toml(path), assignments)
    scene = tables.get("scene")
    if isinstance(scene, str):  # a scene file beside the campaign
        tables["scene"] = load_scene(path.parent / scene).table()
    tables.setdefault("name", path.stem)
    campaign = check(Campaign, tables, str(path))
    whole = scene_from(campaign.scene, f"{path}: scene", path.parent).table()  # with its robot, so that it can travel
    return Draws(campaign.model_copy(update={"scene": whole}), str(path), path.parent)


def _fault(fault: CaseFault, random: np.random.Generator) -> Table:
    fields = {name: drawn(getattr(fault, name), random) for name in CaseFault.model_fields}
    return {name: value for name, value in fields.items() if value is not None}


def _place(tables: Table, key: str, where: str) -> tuple[Table, str]:
    *path, last = key.split(".")
    place: Any = tables
    for part in path:
        place = place.get(part) if isinstance(place, dict) else None
    if not isinstance(place, dict):
        raise InputError(f"{where}.{key!r}: no such key of a scene; write it as in robot.pneumatics.valve_lag_s")
    return place, last


def _set(tables: Table, key: str, value: Any, where: str) -> Table:
    *path, last = key.split(".")
    place: Any = tables
    for part in path:
        place = place.setdefault(part, {}) if isinstance(place, dict) else None
        if not isinstance(place, dict):
            raise InputError(f"{where}.{key!r}: no such key of a scene; write it as in world.friction")
    place[last] = value
    return tables


def _scale(tables: Table, key: str, spread: Any, random: np.random.Generator, where: str) -> list[float]:
    place, last = _place(tables, key, where)
    before = place.get(last)
    numbers = before if isinstance(before, list | tuple) else [before]
    if not all(isinstance(one, int | float) and not isinstance(one, bool) for one in numbers):
        raise InputError(f"{where}.{key!r} = {before!r}: is no number, so no factor can be put on it; take another key")
    factors = [float(spread.draw(random)) for _ in numbers]
    if not all(math.isfinite(factor) for factor in factors):
        raise InputError(f"{where}.{key!r}: a factor of {factors} was drawn; give finite bounds")
    scaled = [one * factor for one, factor in zip(numbers, factors, strict=True)]
    place[last] = scaled if isinstance(before, list | tuple) else scaled[0]
    return factors
