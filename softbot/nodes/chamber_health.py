"""What is learnt of a robot's chambers, kept from one session of watching to the next, and what its drift says.

A slow leak or a path that silts up is no surprise to a filter that follows it: within a session it is learnt, not
found. Kept over sessions it shows: against the robot file, and against the sessions before.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pydantic

from controllers.chamber_observer import HOLE, INLET, OFFSET, OUTLET, PRIOR_HOLE, PRIOR_RATIO, STATES
from controllers.detector_parts import DetectorMemory
from softbot.errors import InputError
from softbot.faults import CHAMBER_COUNT

SCHEMA = "softbot-health-1"
LEAKS_FROM, NARROWED_FROM = 0.03, 0.25
"""A leak (over the supply valve) and a loss of a path's conductance (over the first session) worth a word …"""
DEVIATIONS = 4.0
"""… where they are also so many deviations of what was learnt."""
BETWEEN_RATIO, BETWEEN_HOLE = 0.03, 0.001
"""Deviation by which a robot may have changed between two sessions: another supply, another temperature."""
WORN_LEAK = 0.2
"""A leak that has to be mended: the rest of a trend is told up to here."""
_TREND_SESSIONS, _TREND = 3, timedelta(hours=1)
_MOST_SESSIONS = 10_000


@dataclass(frozen=True)
class Learnt:
    """What was learnt of one chamber: offset of its sensor [Pa]; what its supply and exhaust path pass, over what the
    robot file says; its hole, over the open supply valve; deviations; and over how many cycles, and of them filling."""

    sensor_offset_Pa: float
    supply_path: float
    exhaust_path: float
    leak: float
    supply_path_deviation: float
    exhaust_path_deviation: float
    leak_deviation: float
    cycles: int
    fills: int


class Session(pydantic.BaseModel):
    """One session of watching, at its end."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    ended: datetime
    watched_s: float = pydantic.Field(ge=0.0)
    chambers: tuple[Learnt, ...] = pydantic.Field(min_length=CHAMBER_COUNT, max_length=CHAMBER_COUNT)


class Health(pydantic.BaseModel):
    """A robot's sessions, the oldest first."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    schema_name: str = pydantic.Field(SCHEMA, alias="schema", pattern=f"^{SCHEMA}$")
    robot: str
    sessions: tuple[Session, ...] = ()

    def after(self, session: Session) -> Health:
        """With one more session; the oldest but the first go when there are very many."""
        kept = self.sessions
        if len(kept) >= _MOST_SESSIONS:
            kept = (kept[0], *kept[2:])
        return self.model_copy(update={"sessions": (*kept, session)})


def read_health(path: Path, robot: str) -> Health:
    """The health file of a robot; one without sessions where there is none yet.

    Raises InputError for a file that is none, and for another robot's.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return Health(robot=robot)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"--health {path}: cannot be read: {error}; name another file") from None
    try:
        health = Health.model_validate_json(text)
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise InputError(
            f"--health {path}: is no health file of this program ({where}: {first['msg']}); name another file"
        ) from None
    if health.robot != robot:
        raise InputError(f"--health {path}: is the robot {health.robot!r}'s, this is {robot!r}; name a file for each")
    return health


def write_health(path: Path, health: Health) -> None:
    """Write a health file in one piece. Raises InputError where it cannot be written."""
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_text(json.dumps(health.model_dump(mode="json", by_alias=True), indent=1) + "\n", encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        raise InputError(f"--health {path}: cannot be written: {error.strerror}; choose another place") from None


def carry_into(memory: DetectorMemory, health: Health) -> None:
    """Let a detector that has just begun know what the last session had learnt, and be as sure of it as may be."""
    if not health.sessions:
        return
    own = memory.own[0]
    for chamber, learnt in enumerate(health.sessions[-1].chambers):
        observer = memory.observer[chamber]
        known = np.array(observer["x"])
        for state, value, spread, between, prior in (
            (INLET, learnt.supply_path, learnt.supply_path_deviation, BETWEEN_RATIO, PRIOR_RATIO),
            (OUTLET, learnt.exhaust_path, learnt.exhaust_path_deviation, BETWEEN_RATIO, PRIOR_RATIO),
            (HOLE, learnt.leak, learnt.leak_deviation, BETWEEN_HOLE, PRIOR_HOLE),
        ):
            known[state] = value
            observer["covariance"][state, :] = observer["covariance"][:, state] = 0.0
            observer["covariance"][state, state] = min(spread**2 + between**2, prior**2)
        known[OFFSET] = observer["x"][OFFSET]  # a sensor is set to zero between sessions
        for state in range(STATES):
            observer["x"][state] = known[state]
            own["trusted"][chamber][state] = known[state]
        own["learnt"][chamber] = min(learnt.cycles, 1000)
        own["filled"][chamber] = min(learnt.fills, 1000)


def concerns(health: Health) -> list[dict[str, Any]]:
    """What the last session gives reason to look at, the worst first: chamber, what, how much, and where it leads."""
    if not health.sessions:
        return []
    first, last = health.sessions[0], health.sessions[-1]
    found: list[dict[str, Any]] = []
    for chamber, now in enumerate(last.chambers):
        if now.leak > max(LEAKS_FROM, DEVIATIONS * now.leak_deviation):
            found.append(
                {"chamber": chamber, "what": "leak", "share": now.leak, "days_left": days_left(health, chamber)}
            )
        for what in ("supply_path", "exhaust_path"):
            passes, before = getattr(now, what), getattr(first.chambers[chamber], what)
            lost = 1.0 - passes / before
            if len(health.sessions) > 1 and lost > max(
                NARROWED_FROM, DEVIATIONS * getattr(now, f"{what}_deviation") / before
            ):
                found.append({"chamber": chamber, "what": what, "share": lost, "days_left": None})
    return sorted(found, key=lambda one: -one["share"])


def days_left(health: Health, chamber: int) -> float | None:
    """Days until a growing leak of a chamber has to be mended, by a line through its sessions; None without a trend."""
    leaks = np.array([session.chambers[chamber].leak for session in health.sessions])
    span = health.sessions[-1].ended - health.sessions[0].ended
    if len(leaks) < _TREND_SESSIONS or span < _TREND:
        return None
    days = np.array([(one.ended - health.sessions[0].ended) / timedelta(days=1) for one in health.sessions])
    slope = float(np.polyfit(days, leaks, 1)[0])
    if slope <= 0.0 or leaks[-1] >= WORN_LEAK:
        return None if slope <= 0.0 else 0.0
    return (WORN_LEAK - float(leaks[-1])) / slope


def concern_in_words(concern: dict[str, Any]) -> str:
    """One of the `concerns` for people."""
    percent = f"{100.0 * concern['share']:.0f} %"
    if concern["what"] == "leak":
        text = f"chamber {concern['chamber']} leaks {percent} of what its supply valve passes"
        if concern["days_left"] is not None:
            text += f"; at this rate {100.0 * WORN_LEAK:.0f} % in {concern['days_left']:.1f} days"
        return text
    path = str(concern["what"]).replace("_", " ")
    return f"the {path} of chamber {concern['chamber']} passes {percent} less than in the first session"
