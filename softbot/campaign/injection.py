"""A fault injected into a run, and what the sequencer made of it: for tests of a sequencer, one's own or this one.

    run = inject("rupture", chamber=1)
    assert run.named_right and run.delay_s < 0.5 and run.speed_kept > 0.4

`softbot.campaign.pytest_plugin` gives it to pytest as the fixture `inject_fault`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sim.scene import Scene, load_scene, scene_from
from softbot.campaign.bus_run import bus_row
from softbot.errors import InputError
from softbot.nodes.sequencer_node import ChamberSequencer
from softbot.robot import Robot

AT_S, DURATION_S = 4.0, 12.0
"""When the fault strikes and the run ends, unless it is said otherwise."""
_DEFAULT = {
    "robot": "default",
    "drive": {"kind": "sequencer"},
    "sequencer": {"speed_rev_s": 0.5},
    "solver": {"twin": "rod", "accuracy": "fast", "duration_s": DURATION_S},
}


@dataclass(frozen=True)
class Injected:
    """A run that a fault struck, or none. Times in seconds, speeds in revolutions a second, positive where ordered.

    Of the first fault: whether it was `found` by any verdict after it, the `delay_s` of the first one, and what the
    last one `named` (kind, chamber; chamber −1 for what all share). What is not there is None.
    """

    found: bool
    named: tuple[str, int] | None
    named_right: bool
    delay_s: float | None
    false_alarms: int
    speed_before_rev_s: float | None
    speed_after_rev_s: float | None
    longest_still_s: float | None
    highest_pressure_share: float
    final_state: str
    row: Mapping[str, Any]
    """All columns of a campaign's table."""

    @property
    def speed_kept(self) -> float | None:
        """Speed after the fault over the speed before it."""
        if not self.speed_before_rev_s or self.speed_after_rev_s is None:
            return None
        return self.speed_after_rev_s / self.speed_before_rev_s


def inject(
    kind: str | None = None,
    *,
    chamber: int | None = None,
    severity: float = 1.0,
    at_s: float = AT_S,
    more: Sequence[Mapping[str, Any]] = (),
    scene: Scene | Path | str | None = None,
    settings: Sequence[str] = (),
    sequencer: ChamberSequencer | None = None,
    known: Robot | None = None,
) -> Injected:
    """Run a scene with a fault.

    kind: of the fault library, None for a healthy run; `more`: further `[[fault]]` tables. scene: a scene or its file;
    default: the default robot rolls left at 0.5 rev/s for 12 s on the rod twin. settings: as for `--set`. sequencer:
    the one that is tested (`order`, `armed`, `update`: `softbot.nodes.sequencer_node.ChamberSequencer`); default: this
    program's. known: the robot that board and this program's sequencer believe in.

    With this program's sequencer and the rod twin alone the run goes without a bus, else over one. Raises InputError
    for what no scene can have, SimulationError when the run fails (as it does when the sequencer raises something).
    """
    if kind is None and chamber is not None:
        raise InputError(f"chamber = {chamber!r}: of which fault? Say its kind too, or leave the chamber out")
    if isinstance(scene, Scene):
        tables = scene.table()
        name = scene.name
    elif scene is not None:
        loaded = load_scene(Path(scene))
        tables, name = loaded.table(), loaded.name
    else:
        tables, name = _DEFAULT, "injection"
    faults = list(more) if kind is None else [{"t_s": at_s, "kind": kind, "severity": severity}, *more]
    if kind is not None and chamber is not None:
        faults[0] = {**faults[0], "chamber": chamber}
    run = scene_from({**tables, "fault": [*tables.get("fault", []), *faults]}, name, Path(), tuple(settings))
    if run.drive.kind != "sequencer":
        raise InputError(f'{name}: drive.kind = "{run.drive.kind}" has no sequencer to test; take "sequencer"')
    if sequencer is None and run.solver.twin == "rod" and not run.body:
        from softbot.campaign.execution import direct_row

        return _injected(direct_row(run, known))
    return _injected(bus_row(run, known, sequencer=sequencer))


def _injected(row: dict[str, Any]) -> Injected:
    found = bool(row.get("fault_0_detected"))
    return Injected(
        found=found,
        named=(row["fault_0_named_kind"], row["fault_0_named_chamber"]) if found else None,
        named_right=bool(row.get("fault_0_named_right")),
        delay_s=row.get("fault_0_delay_s"),
        false_alarms=row["false_alarms"],
        speed_before_rev_s=row["rate_before_rev_s"],
        speed_after_rev_s=row["rate_after_rev_s"],
        longest_still_s=row["longest_still_s"],
        highest_pressure_share=row["highest_pressure_share"],
        final_state=row["final_state"],
        row=row,
    )
