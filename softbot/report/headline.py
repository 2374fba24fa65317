"""What happened in a run, in a sentence or two made from its data.

Rolling is counted from the telemetry over the whole recording (the summary counts it over the steady span only), so
that the parts before and after a fault add up.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from softbot.faults import NO_CHAMBER
from softbot.report.recording import CHAMBER_COUNT, Recording
from softbot.spoken_fault import spoken_where
from softbot.spoken_offer import spoken_offer
from softbot.verdict import Judgement, Told, gives_reason

STILL_REV = 0.05
"""Turning by less than this is standing still."""

FAULT_WORDS = {
    "rupture": "lost {where} at {t} (rupture)",
    "leak": "got a leak in {where} at {t}",
    "blocked_inlet": "lost {where} at {t} (blocked inlet)",
    "stuck_open": "had the valve of {where} stick open at {t}",
    "stuck_closed": "lost {where} at {t} (valve stuck closed)",
    "sensor_offset": "had the pressure sensor of {where} drift off at {t}",
    "sensor_stuck": "had the pressure sensor of {where} freeze at {t}",
}

ANSWER_WORDS = {
    "curvature_reversal": "reversed its curvature",
    "momentum": "went by momentum",
    "rock_free": "tried to rock free",
}


def headline(recording: Recording) -> str:
    """One sentence on the run, and one each for a pressure over the limit, false alarms and an early end, if any."""
    if recording.summary.get("equilibrium"):
        return f"Comes to rest bent by {math.degrees(recording.columns['bend_rad'][-1]):.1f}°."
    end_s = float(recording.t_s[-1])
    faults = [fault for fault in recording.events("faults") if fault["t_s"] <= end_s]
    first_fault_s = float(faults[0]["t_s"]) if faults else end_s
    clauses = _before(recording, first_fault_s)
    for index, fault in enumerate(faults):
        until_s = float(faults[index + 1]["t_s"]) if index + 1 < len(faults) else end_s
        clauses += _after(recording, fault, until_s, first_fault_s)
    sentence = _joined(clauses)
    sentences = [sentence[0].upper() + sentence[1:] + "."]
    sentences += _left(recording) + _over_limit(recording) + _false_alarms(recording)
    sentences += _early_end(recording, end_s)
    return " ".join(sentences)


def turned_rev(recording: Recording, start_s: float, end_s: float) -> float:
    """Signed roll between two times [revolutions]."""
    start, end = np.interp([start_s, end_s], recording.t_s, recording.roll_rev)
    return float(end - start)


def spoken_kind(kind: object) -> str:
    """A fault kind or a strategy in words: `blocked_inlet` -> "blocked inlet"."""
    return str(kind).replace("_", " ").replace("-", " ")


def spoken_time(t_s: float) -> str:
    """A time as people say it: two figures below ten seconds, one decimal above."""
    return f"{t_s:.2g} s" if 0 < abs(t_s) < 1 else f"{t_s:.1f} s"


def _before(recording: Recording, until_s: float) -> list[str]:
    start_s = float(recording.t_s[0])
    turned = turned_rev(recording, start_s, until_s)
    if not recording.has_ground:
        return [f"floating without ground, turned {_revolutions(abs(turned))} about its own axis"]
    if abs(turned) < STILL_REV:
        return [f"did not roll for {spoken_time(until_s - start_s)}"]
    clauses = [f"rolled {_revolutions(abs(turned))}{_way(recording, turned)}"]
    if not recording.events("faults"):
        moved_m = _moved_m(recording)
        far = f"{100.0 * moved_m:.3g} cm" if moved_m < 9.995 else f"{moved_m:.1f} m"
        clauses.append(f"moved {far} across the floor")
    return clauses


def _way(recording: Recording, turned: float) -> str:
    """The way that it really turned, where a way was ordered: " left", " right against the order"."""
    if recording.drive_kind != "sequencer":
        return ""
    way = "left" if turned < 0.0 else "right"
    return f" {way}" if _as_ordered(recording, turned) else f" {way} against the order"


def _as_ordered(recording: Recording, turned: float) -> bool:
    """Whether it turned the way of the order, or nobody ordered one; right is positive."""
    turn = {"left": -1.0, "right": 1.0, "stop": 0.0}.get(str(recording.table("sequencer").get("command", "left")))
    return recording.drive_kind != "sequencer" or turn is None or turn * turned > 0.0


def _moved_m(recording: Recording) -> float:
    """Distance on the floor between the first and the last recorded centre of mass [m]."""
    ends = []
    for axis in "xy":
        values = recording.columns[f"com_{axis}_m"]
        values = values[np.isfinite(values)]
        ends.append(float(values[-1] - values[0]))
    return math.hypot(*ends)


def _after(recording: Recording, fault: dict[str, Any], until_s: float, first_fault_s: float) -> list[str]:
    t_s, chamber = float(fault["t_s"]), fault.get("chamber")
    words = FAULT_WORDS.get(str(fault.get("kind")), "met a fault of {where} at {t} ({kind})")
    kind, where = spoken_kind(fault.get("kind", "not said")), spoken_where(chamber)
    clauses = [words.format(where=where, kind=kind, t=spoken_time(t_s))]
    timed: list[tuple[float, int, str]] = []  # the number orders what happens at the same time

    end_s = float(recording.t_s[-1])  # the next fault may strike before this one is found
    struck = _within(recording, "faults", float(recording.t_s[0]), end_s)
    named = _verdict_on(fault, struck, _within(recording, "detections", t_s, end_s))
    if named is not None:
        timed.append((float(named["t_s"]), 1, _naming(named, fault)))
    elif recording.drive_kind == "sequencer":
        clauses.append("did not notice")

    answers = _within(recording, "recoveries", t_s, until_s)
    safe_stop = any(answer.get("strategy") == "safe_stop" for answer in answers)
    turned = next((answer for answer in answers if answer.get("strategy") == "other_way"), None)
    recoveries = [answer for answer in answers if answer.get("strategy") not in ("safe_stop", "other_way")]
    stalls = _within(recording, "stalls", t_s, until_s)
    standing = _stands_at_end(recording, t_s, until_s)
    if recoveries:
        timed += _answered(recoveries)
    if stalls and (recoveries or not standing):
        timed.append((float(stalls[0]["t_s"]), 0, "stopped"))
    clauses += [clause for *_, clause in sorted(timed)]

    before = turned_rev(recording, float(recording.t_s[0]), first_fault_s)
    more = turned_rev(recording, t_s, until_s)
    if safe_stop:
        clauses.append("went into the safe state")
        if turned is not None:
            clauses.append("turned back")
            back = turned_rev(recording, float(turned["t_s"]), until_s)
            clauses.append(f"rolled {_revolutions(abs(back))} that way" if abs(back) >= STILL_REV else "got no further")
        elif abs(more) >= STILL_REV:
            against = "" if _as_ordered(recording, more) else _way(recording, more)
            clauses.append(f"coasted another {_revolutions(abs(more))}{against}")
    elif recoveries:
        clauses.append(_more(recording, more, before) if abs(more) >= STILL_REV else "got no further")
    elif standing:
        if abs(more) >= STILL_REV:
            clauses.append(_more(recording, more, before))
        clauses.append("stopped and stayed")
    else:
        clauses.append(_more(recording, more, before))
    return clauses


def _answered(recoveries: list[dict[str, Any]]) -> list[tuple[float, int, str]]:
    """When it first answered in each way, and how often."""
    found = []
    for order, (strategy, words) in enumerate(ANSWER_WORDS.items()):
        times_s = [float(one["t_s"]) for one in recoveries if one.get("strategy") == strategy]
        if times_s:
            found.append((times_s[0], 2 + order, words + (f" {len(times_s)} times" if len(times_s) > 1 else "")))
    return found


def _verdict_on(
    fault: dict[str, Any], struck: list[dict[str, Any]], since: list[dict[str, Any]]
) -> dict[str, Any] | None:
    """The first verdict on where a fault is, or else the first that it alone gave reason for, under another name."""
    there = [one for one in since if one.get("chamber") == fault.get("chamber")]
    others = [_told(one) for one in struck if one != fault]
    elsewhere = [
        one
        for one in since
        if one.get("judgement") == Judgement.MISNAMED
        and gives_reason(_told(fault), _told(one))
        and not any(other.chamber == _told(one).chamber and other.t_s <= _told(one).t_s for other in others)
    ]
    return next(iter(there + elsewhere), None)


def _told(event: dict[str, Any]) -> Told:
    chamber = event.get("chamber")
    return Told(float(event["t_s"]), NO_CHAMBER if chamber is None else int(chamber), str(event.get("kind")))


def _naming(detection: dict[str, Any], fault: dict[str, Any]) -> str:
    delay = detection.get("delay_s")
    delay_s = float(delay) if isinstance(delay, int | float) else float(detection["t_s"]) - float(fault["t_s"])
    same_place = detection.get("chamber") == fault.get("chamber")
    if same_place and detection.get("kind") in (None, fault.get("kind")):
        return f"named it {spoken_time(delay_s)} later"
    where = "" if same_place else f" of {spoken_where(detection.get('chamber'))}"
    return f"took it for {_article(spoken_kind(detection['kind']))}{where} {spoken_time(delay_s)} later"


def _stands_at_end(recording: Recording, start_s: float, end_s: float) -> bool:
    """Whether the robot stood still over the last fifth of a span (and at least the last half second of it)."""
    late_s = min(end_s - 0.5, end_s - 0.2 * (end_s - start_s))
    if late_s <= start_s:
        return False
    late = (recording.t_s >= late_s) & (recording.t_s <= end_s)
    return bool(late.any() and np.ptp(recording.roll_rev[late]) < STILL_REV)


def _within(recording: Recording, key: str, start_s: float, end_s: float) -> list[dict[str, Any]]:
    return [event for event in recording.events(key) if start_s <= event["t_s"] <= end_s]


def _more(recording: Recording, more: float, before: float) -> str:
    """How far it rolled on; the direction is compared where it had one before."""
    if abs(more) < STILL_REV:
        return "hardly turned"
    if abs(before) < STILL_REV:
        return f"rolled {abs(more):.1f} more{_way(recording, more)}"
    way = "in the same direction" if more * before > 0 else "back the other way"
    return f"rolled {abs(more):.1f} more {way}"


def _revolutions(turned: float) -> str:
    return "1.0 revolution" if f"{turned:.1f}" == "1.0" else f"{turned:.1f} revolutions"


def _article(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def _joined(clauses: list[str]) -> str:
    if len(clauses) == 1 or " and " in clauses[-1]:
        return ", ".join(clauses)
    return ", ".join(clauses[:-1]) + " and " + clauses[-1]


def _left(recording: Recording) -> list[str]:
    """What is left after the last safe stop, unless the robot rolled the other way then."""
    answers = recording.events("recoveries")
    if not answers or not isinstance(answers[-1].get("offer"), dict):
        return []
    words = spoken_offer(answers[-1]["offer"])
    return [words[0].upper() + words[1:] + "."]


def _over_limit(recording: Recording) -> list[str]:
    """Which chamber went over the limit of its pressure, and how far."""
    share = recording.summary.get("highest_pressure_share")
    if not isinstance(share, int | float) or share <= 1.0:
        return []
    highest_Pa = [
        float(np.nanmax(recording.columns[name])) if recording.has(name) else -math.inf
        for name in (f"pressure_{i}_Pa" for i in range(CHAMBER_COUNT))
    ]
    return [f"Chamber {int(np.argmax(highest_Pa))} went to {100.0 * share:.1f} % of the limit of its pressure."]


def _false_alarms(recording: Recording) -> list[str]:
    alarms = recording.summary.get("false_alarms")
    count = len(alarms) if isinstance(alarms, list) else alarms if isinstance(alarms, int) else 0
    if not count:
        return []
    return [f"There {'was 1 false alarm' if count == 1 else f'were {count} false alarms'}."]


def _early_end(recording: Recording, end_s: float) -> list[str]:
    planned = recording.table("solver").get("duration_s")
    if not isinstance(planned, int | float) or end_s >= 0.98 * planned:
        return []
    return [f"The recording ends at {spoken_time(end_s)} of {spoken_time(float(planned))}."]
