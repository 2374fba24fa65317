"""What became of a run, as one row: detection, recovery, speed, drift, pressures. From its trace and events alone.

Rates count in the ordered direction, so that a robot that rolls the wrong way has a negative one. What a run does not
have (a delay without a fault) is null.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from controllers.interface import STATES, Detection, Recovery, SequencerState
from sim.scene import Scene
from sim.summary import highest_pressure_share
from softbot.faults import CHAMBER_COUNT, Fault
from softbot.nodes.direct import TRACE
from softbot.verdict import Judgement, Told, judge

FloatArray = NDArray[np.float64]
TURN_RAD = 2.0 * math.pi

SETTLED_AFTER_S = 3.0
"""After the last fault has struck the robot has this long to find it and to roll again; then its speed counts."""
STILL_RAD_S = 0.25
_STILL_WINDOW_S = 0.2
_STARTED_S = 1.0

_ROLL, _X, _HEADING, _STATE = (TRACE.index(name) for name in ("roll_rad", "x_m", "heading_rad", "state"))
_Y, _PRESSURES = TRACE.index("y_m"), slice(TRACE.index("pressure_0_Pa"), TRACE.index("pressure_0_Pa") + CHAMBER_COUNT)
_MOVING = [STATES.index(state) for state in (SequencerState.ROLLING, SequencerState.DEGRADED)]
_SAFE = STATES.index(SequencerState.SAFE)

FAULTS = 2
"""Of one run that get columns of their own."""

_FAULT_COLUMNS = (
    ("kind", pa.string()),
    ("chamber", pa.int8()),
    ("severity", pa.float64()),
    ("t_s", pa.float64()),
    ("detected", pa.bool_()),
    ("delay_s", pa.float64()),
    ("named_kind", pa.string()),
    ("named_chamber", pa.int8()),
    ("named_right", pa.bool_()),
    ("confidence", pa.float64()),
)
OUTCOME_SCHEMA = pa.schema(
    [
        ("run", pa.int64()),
        ("case", pa.string()),
        ("outcome", pa.string()),
        ("duration_s", pa.float64()),
        ("command", pa.string()),
        ("ordered_rev_s", pa.float64()),
        *[(f"fault_{n}_{name}", kind) for n in range(FAULTS) for name, kind in _FAULT_COLUMNS],
        ("faults", pa.int8()),
        ("false_alarms", pa.int32()),
        ("false_alarms_beside", pa.int32()),
        ("rolling_s", pa.float64()),
        ("rate_before_rev_s", pa.float64()),
        ("rate_after_rev_s", pa.float64()),
        ("rolled_rev", pa.float64()),
        ("longest_still_s", pa.float64()),
        ("heading_drift_rad", pa.float64()),
        ("moved_along_m", pa.float64()),
        ("moved_left_m", pa.float64()),
        ("highest_pressure_Pa", pa.float64()),
        ("highest_pressure_share", pa.float64()),
        ("final_state", pa.string()),
        ("safe_after_s", pa.float64()),
        ("strategies", pa.string()),
        ("rate_without_fault_rev_s", pa.float64()),
        ("rate_unanswered_rev_s", pa.float64()),
        ("pressure_without_fault_share", pa.float64()),
        ("pressure_unanswered_share", pa.float64()),
        ("matters", pa.bool_()),
        ("drawn", pa.string()),
    ]
)
"""Columns of a campaign's table that every campaign has."""


@dataclass(frozen=True)
class Seen:
    """What is known of a run when it is over. trace: a row a cycle (`softbot.nodes.direct.TRACE`)."""

    scene: Scene
    trace: FloatArray
    detections: list[Detection]
    recoveries: list[Recovery]
    pressure_limit_Pa: float
    """Of a chamber; the share of it that was reached is reported."""


def outcome(seen: Seen) -> dict[str, Any]:
    """The columns of OUTCOME_SCHEMA that follow from a run."""
    scene, trace = seen.scene, seen.trace
    t_s, faults = trace[:, 0], sorted(scene.fault, key=lambda fault: fault.t_s)
    rolled = ordered_turns(scene, trace)
    first_s = faults[0].t_s if faults else math.inf
    last_s = faults[-1].t_s + faults[-1].ramp_s if faults else math.inf
    moving = np.isin(trace[:, _STATE].astype(int), _MOVING)
    start_s = float(t_s[np.argmax(moving)]) + _STARTED_S if moving.any() else math.inf
    safe = trace[:, _STATE] == _SAFE
    row: dict[str, Any] = {
        "outcome": "done",
        "duration_s": float(t_s[-1]),
        "command": scene.sequencer.command,
        "ordered_rev_s": scene.sequencer.speed_rev_s,
        "faults": len(faults),
        "false_alarms": _false_alarms(faults, seen.detections),
        "false_alarms_beside": _false_alarms(faults, [one for one in seen.detections if one.t_s >= first_s]),
        "rolling_s": float((moving & (t_s < first_s)).sum() * (t_s[1] - t_s[0])),
        "rate_before_rev_s": mean_rate(t_s, rolled, start_s, first_s),
        "rate_after_rev_s": mean_rate(t_s, rolled, last_s + SETTLED_AFTER_S, math.inf) if faults else None,
        "rolled_rev": float(rolled[-1]),
        "longest_still_s": longest_still_s(t_s, rolled, last_s) if faults else None,
        "heading_drift_rad": float(trace[-1, _HEADING] - trace[0, _HEADING]),
        "moved_along_m": float(trace[-1, _X] - trace[0, _X]),
        "moved_left_m": float(trace[-1, _Y] - trace[0, _Y]),
        "highest_pressure_Pa": float(pressures_Pa(trace).max()),
        "highest_pressure_share": highest_pressure_share(pressures_Pa(trace), seen.pressure_limit_Pa),
        "final_state": str(STATES[int(trace[-1, _STATE])]),
        "safe_after_s": float(t_s[np.argmax(safe)]) - first_s if safe.any() and faults else None,
        "strategies": " ".join(dict.fromkeys(answer.strategy for answer in seen.recoveries)),
    }
    for n, fault in enumerate(faults[:FAULTS]):
        row |= {f"fault_{n}_{name}": value for name, value in _found(fault, faults, seen.detections).items()}
    return row


def ordered_turns(scene: Scene, trace: FloatArray) -> FloatArray:
    """Revolutions since the start of a trace, positive in the ordered direction; none where the order is to stop."""
    turn = {"left": -1.0, "right": 1.0}.get(scene.sequencer.command, 0.0)
    return turn * (trace[:, _ROLL] - trace[0, _ROLL]) / TURN_RAD


def pressures_Pa(trace: FloatArray) -> FloatArray:
    """True chamber pressures of a trace, shape (n, 4) [Pa]."""
    return trace[:, _PRESSURES]


def mean_rate(t_s: FloatArray, rolled_rev: FloatArray, from_s: float, to_s: float) -> float | None:
    """Mean rate between two times [rev/s], over whole revolutions before the end where there are any."""
    within = (t_s >= from_s) & (t_s <= to_s)
    if within.sum() < 2:
        return None
    t, rolled = t_s[within], rolled_rev[within]
    whole = math.floor(abs(rolled[-1] - rolled[0]))
    if whole >= 1:
        back = rolled[-1] - math.copysign(whole, rolled[-1] - rolled[0])
        since = np.flatnonzero(np.diff(np.sign(rolled - back)) != 0)
        if since.size:  # the last time that it was this many revolutions back
            k = int(since[-1])
            share = (back - rolled[k]) / (rolled[k + 1] - rolled[k]) if rolled[k + 1] != rolled[k] else 0.0
            from_t = t[k] + share * (t[k + 1] - t[k])
            return float((rolled[-1] - back) / (t[-1] - from_t))
    return float((rolled[-1] - rolled[0]) / (t[-1] - t[0]))


def longest_still_s(t_s: FloatArray, rolled_rev: FloatArray, from_s: float) -> float | None:
    """The longest that the robot stood still after a time [s]; a rate averaged over 0.2 s decides."""
    step_s = float(t_s[1] - t_s[0])
    width = max(1, round(_STILL_WINDOW_S / step_s))
    rate = TURN_RAD * (rolled_rev[width:] - rolled_rev[:-width]) / (width * step_s)
    still = (np.abs(rate) < STILL_RAD_S) & (t_s[width:] >= from_s)
    if t_s[-1] < from_s:
        return None
    edges = np.flatnonzero(np.diff(still, prepend=False, append=False))
    return float(max((b - a for a, b in zip(edges[::2], edges[1::2], strict=True)), default=0) * step_s)


def _found(fault: Fault, faults: list[Fault], detections: list[Detection]) -> dict[str, Any]:
    """How a fault was found: by the first verdict since it struck, named by the last one on it.

    With several faults a verdict counts for those of its own chamber.
    """
    since = [one for one in detections if one.t_s >= fault.t_s]
    if len(faults) > 1:
        since = [one for one in since if one.chamber == fault.chamber_number]
    row: dict[str, Any] = {
        "kind": str(fault.kind),
        "chamber": fault.chamber_number,
        "severity": fault.severity,
        "t_s": fault.t_s,
        "detected": bool(since),
    }
    if since:
        last = since[-1]
        row |= {
            "delay_s": since[0].t_s - fault.t_s,
            "named_kind": last.kind,
            "named_chamber": last.chamber,
            "named_right": (last.kind, last.chamber) == (str(fault.kind), fault.chamber_number),
            "confidence": last.confidence,
        }
    return row


def _false_alarms(faults: list[Fault], detections: list[Detection]) -> int:
    """Verdicts that no fault had given reason for: before any, or on a chamber that none concerns."""
    struck = [Told(fault.t_s, fault.chamber_number, str(fault.kind)) for fault in faults]
    verdicts = [Told(one.t_s, one.chamber, one.kind) for one in detections]
    return sum(judge(one, struck) is Judgement.FALSE_ALARM for one in verdicts)
