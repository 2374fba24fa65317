"""Runs of a campaign made again on another twin or over a real bus: are the verdicts the same?

A campaign runs the rod twin without frames. What it says of the detector has to hold on a twin that shares no mechanics
with it (PyBullet's segments) and with everything that a bus does to a signal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from firmware_protocol.errors import BusError
from sim.run_many import run_many
from sim.scene import scene_from
from softbot.campaign.bus_run import bus_row
from softbot.campaign.campaign import Campaign, Draws
from softbot.campaign.execution import direct_row, draws_here
from softbot.campaign.outcome import FAULTS
from softbot.errors import InputError, SimulationError, SoftbotError


@dataclass(frozen=True)
class Verdict:
    """What a sequencer made of a run.

    `named`: for each fault that struck, what it was named ("kind, chamber"), "missed" if it was not; `alarmed`: whether
    there was a verdict that no fault had given reason for; `failed`: why the run has no verdict.
    """

    named: tuple[str, ...]
    alarmed: bool
    failed: str | None = None


@dataclass(frozen=True)
class Compared:
    """One run both ways. Delays of the first verdict on the first fault [s], None where there is none."""

    run: int
    case: str
    campaign: Verdict
    again: Verdict
    campaign_delay_s: float | None
    again_delay_s: float | None

    @property
    def same(self) -> bool:
        """Whether both had a verdict, and the same one."""
        return self.campaign.failed is None and self.campaign == self.again


def verdict_of(row: dict[str, Any]) -> Verdict:
    """The verdict in the row of a run."""
    named = []
    for n in range(min(int(row["faults"]), FAULTS)):
        found = bool(row[f"fault_{n}_detected"])
        named.append(f"{row[f'fault_{n}_named_kind']}, {row[f'fault_{n}_named_chamber']}" if found else "missed")
    return Verdict(tuple(named), bool(row["false_alarms"]))


def compare(
    draws: Draws,
    numbers: Iterable[int],
    *,
    twin: str = "rod",
    transport: tuple[str, str] | None = None,
    processes: int | None = None,
    told: Callable[[Compared], None] = lambda one: None,
) -> list[Compared]:
    """Make runs as the campaign makes them and again, over a bus and on `twin` ("rod" or "bullet").

    transport: interface and channel of the bus, which all runs share, one after another; None: a virtual one for each.
    processes: default one a core. told: told of each run as it ends. A run that fails either way has no verdict.
    Raises InputError for what the other twin cannot run, and when the bus cannot be opened.
    """
    found: list[Compared] = []

    def keep(result: Any) -> None:
        if isinstance(result, SoftbotError):
            raise result
        found.append(result)
        told(result)

    task = partial(_compared, draws.campaign, draws.source, str(draws.folder), twin, transport)
    run_many(numbers, 1 if transport is not None else processes, run=task, each=keep)
    return sorted(found, key=lambda one: one.run)


def _compared(
    campaign: Campaign, source: str, folder: str, twin: str, transport: tuple[str, str] | None, number: int
) -> Compared:
    draws = draws_here(campaign, source, folder)
    run = draws.run(number)
    table = run.scene.table()
    table["solver"]["twin"] = twin
    again = scene_from(table, f"{draws.source}: run {number}", draws.folder)  # it may refuse what the rod takes
    ours, our_delay_s = _judged(partial(direct_row, run.scene, run.known))
    try:
        theirs, their_delay_s = _judged(partial(bus_row, again, run.known, transport=transport))
    except BusError as error:  # foreseen: a bus that there is not
        raise InputError(str(error)) from None
    return Compared(number, run.case, ours, theirs, our_delay_s, their_delay_s)


def _judged(make: Callable[[], dict[str, Any]]) -> tuple[Verdict, float | None]:
    try:
        row = make()
    except SimulationError as error:
        return Verdict((), False, str(error)), None
    return verdict_of(row), row.get("fault_0_delay_s")


def summary_of(found: list[Compared]) -> dict[str, Any]:
    """How many runs had the same verdict both ways, and those that had not; plain values."""
    both = [
        one.again_delay_s - one.campaign_delay_s
        for one in found
        if one.same and one.again_delay_s is not None and one.campaign_delay_s is not None
    ]
    same = sum(one.same for one in found)
    return {
        "runs": len(found),
        "same": same,
        "same_share": same / len(found) if found else None,
        "found_later_median_s": float(np.median(both)) if both else None,
        "others": [asdict(one) for one in found if not one.same],
    }
