"""What a verdict on a fault is worth, seen from the faults that had struck: the one count of false alarms.

right         a fault of this kind had struck this chamber (or what the chambers share)
misnamed      something had struck that gave reason for a verdict here, but it was another kind, or elsewhere
false alarm   nothing had given reason for it: nothing was broken yet, or what was does not concern this chamber

A fault of what all chambers share gives reason for a verdict on any of them, exchanged lines on both of theirs, and any
fault for a verdict on what they share.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from typing import NamedTuple

from softbot.faults import CHAMBER_COUNT, NO_CHAMBER, FaultKind


class Judgement(StrEnum):
    """Of a verdict. The head of this module says what each means."""

    RIGHT = "right"
    MISNAMED = "misnamed"
    FALSE_ALARM = "false alarm"


class Told(NamedTuple):
    """A fault that struck, or a verdict on one."""

    t_s: float
    chamber: int
    """Or NO_CHAMBER."""
    kind: str


def judge(verdict: Told, faults: Iterable[Told]) -> Judgement:
    """What a verdict is worth after these faults; those that had not struck yet do not count."""
    struck = [fault for fault in faults if fault.t_s <= verdict.t_s]
    if any((fault.kind, fault.chamber) == (verdict.kind, verdict.chamber) for fault in struck):
        return Judgement.RIGHT
    return Judgement.MISNAMED if any(gives_reason(fault, verdict) for fault in struck) else Judgement.FALSE_ALARM


def gives_reason(fault: Told, verdict: Told) -> bool:
    """Whether a fault that has struck explains that something was found where the verdict says."""
    concerned = {fault.chamber}
    if fault.kind == FaultKind.LINES_SWAPPED:
        concerned.add((fault.chamber + 1) % CHAMBER_COUNT)
    return verdict.chamber == NO_CHAMBER or NO_CHAMBER in concerned or verdict.chamber in concerned
