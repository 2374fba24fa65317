"""The tables of the report as HTML: the summary's numbers with their units, and what happened when.

Everything that comes from a file is escaped here, at the one place where text becomes HTML.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from html import escape
from typing import Any

from softbot.faults import NO_CHAMBER
from softbot.report.headline import spoken_kind
from softbot.report.recording import Recording
from softbot.spoken_fault import spoken_where
from softbot.spoken_offer import spoken_offer
from softbot.verdict import Judgement

MINUS = "\N{MINUS SIGN}"
ABSENT = "\N{EM DASH}"

EVENT_TITLES = {"faults": "fault", "stalls": "stall", "detections": "detection", "recoveries": "recovery"}
"""The lists of the summary that hold events, and what one entry of each is called."""


def number(value: object, scale: float = 1.0, figures: int = 4) -> str:
    """A number times `scale` to some significant figures, with a true minus; a dash for what is no number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return ABSENT
    if isinstance(value, int) and scale == 1.0:
        return f"{value:,}".replace(",", "\N{THIN SPACE}").replace("-", MINUS)
    return f"{value * scale:.{figures}g}".replace("-", MINUS)


def _pair(value: object, scale: float) -> str:
    if not isinstance(value, list | tuple):
        return ABSENT
    return ", ".join(number(part, scale) for part in value)


def _count(value: object) -> str:
    return str(len(value)) if isinstance(value, list) else number(value)


DEGREES = 180.0 / math.pi

_ROWS: tuple[tuple[str, str, str, Callable[[Any], str]], ...] = (
    ("sim_time_s", "simulated time", "s", number),
    ("wall_time_s", "solver time on the clock", "s", number),
    ("real_time_factor", "times real time", "×", number),
    ("steps", "solver steps", "", number),
    ("total_revolutions", "revolutions in all", "", number),
    ("steady_span_s", "steady span at the end, over which the next four are measured", "s", number),
    ("revolutions", "revolutions of the mid section (right-handed about its tangent)", "", number),
    ("displacement_m", "displacement x, y", "cm", lambda value: _pair(value, 100.0)),
    ("advance_per_revolution_m", "advance per revolution", "mm", lambda value: number(value, 1000.0)),
    ("plane_rotation_rad", "rotation of the C's plane about its chord", "°", lambda value: number(value, DEGREES)),
    ("bend_rad", "bend", "°", lambda value: number(value, DEGREES)),
    ("angular_momentum_max_kg_m2_s", "largest angular momentum", "kg m²/s", number),
    ("energy_gain_J", "most energy beyond the actuators' work", "J", number),
    ("asleep_s", "asleep, and not computed", "s", number),
    ("highest_pressure_share", "highest pressure, of the chambers' limit", "%", lambda value: number(value, 100.0)),
    ("false_alarms", "false alarms", "", _count),
    ("misnamed", "verdicts that gave a fault another name", "", number),
    ("missed_faults", "missed faults", "", _count),
)

_ELSEWHERE = frozenset({"schema", "scene", "twin", "accuracy", *EVENT_TITLES})
"""Keys that the page shows in another place than the table of numbers."""


def summary_table(summary: Mapping[str, Any]) -> str:
    """The summary's numbers as an HTML table; keys that this module does not know come last, as they are."""
    rows = [
        (label, text(summary[key]), unit)
        for key, label, unit, text in _ROWS
        if key in summary and summary[key] is not None
    ]
    known = {key for key, *_ in _ROWS} | _ELSEWHERE
    rows += [
        (key, number(value) if isinstance(value, int | float) and not isinstance(value, bool) else str(value), "")
        for key, value in summary.items()
        if key not in known and isinstance(value, str | int | float)
    ]
    return "\n".join(
        f"<tr><th scope='row'>{escape(label)}</th><td>{escape(text)}</td><td class='unit'>{escape(unit)}</td></tr>"
        for label, text, unit in rows
    )


def event_list(recording: Recording) -> list[dict[str, Any]]:
    """Faults, stalls, detections and recoveries in order of time: `t_s`, `type`, `text`."""
    events = [
        {"t_s": float(entry["t_s"]), "type": title, "text": _event_text(title, entry)}
        for key, title in EVENT_TITLES.items()
        for entry in recording.events(key)
    ]
    return sorted(events, key=lambda event: float(event["t_s"]))


def event_table(recording: Recording) -> str:
    """What happened when, as rows of an HTML table; a time is a button that takes the animation there."""
    events = event_list(recording)
    if not events:
        return "<tr><td colspan='3' class='quiet'>no faults, stalls or recoveries</td></tr>"
    return "\n".join(
        f"<tr><td><button type='button' class='seek' data-t='{event['t_s']:.6g}'>{event['t_s']:.2f} s</button></td>"
        f"<td><span class='mark {event['type']}'></span>{event['type']}</td><td>{escape(event['text'])}</td></tr>"
        for event in events
    )


def _event_text(title: str, entry: Mapping[str, Any]) -> str:
    if title == "recovery":
        strategy, offer = spoken_kind(entry.get("strategy", "recovery")), entry.get("offer")
        return f"{strategy}: {spoken_offer(offer)}" if isinstance(offer, dict) else strategy
    if title == "stall":
        theta = entry.get("theta_rad")
        if entry.get("chamber") in (None, NO_CHAMBER):
            return "stopped"  # none is dead
        at = f"θ = {number(theta, DEGREES, 3)}°" if isinstance(theta, int | float) else ""
        return ", ".join(part for part in (spoken_where(entry.get("chamber")), at) if part)
    kind = spoken_kind(entry.get("kind", ""))
    text = ", ".join(part for part in (spoken_where(entry.get("chamber")), kind) if part)
    delay = entry.get("delay_s")
    if title == "detection" and isinstance(delay, int | float):
        text += f", after {number(delay, figures=3)} s"
    elif title == "detection" and entry.get("judgement") in (Judgement.MISNAMED, Judgement.FALSE_ALARM):
        text += f" ({entry['judgement']})"
    return text
