"""Metrics of a run from its telemetry alone, and the `summary.json` they make.

Nothing here sees a twin or a sequencer: rolled revolutions, displacement, stalls and the rest follow from the recorded
trajectory, detections and recoveries from the events that were recorded beside it.

What is measured over the steady part of a run (`revolutions`, `displacement_m`, `advance_per_revolution_m`,
`plane_rotation_rad`) is null for a run that ended before it, whose `steady_span_s` is 0. `energy_gain_J` is null for a
twin that does not tell its energy, `highest_pressure_share` for a robot that nobody fills.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from sim.scene import Scene
from sim.trajectory import wrapped
from softbot.cross_section import CHAMBER_ANGLES_RAD
from softbot.faults import CHAMBER_COUNT, EMPTIES_CHAMBER
from softbot.verdict import Judgement, Told, judge

SUMMARY_SCHEMA = "softbot-summary-1"

PRESSURE_COLUMNS = tuple(f"pressure_{i}_Pa" for i in range(CHAMBER_COUNT))

SUMMARY_COLUMNS = frozenset(
    {
        "t_s",
        "roll_rad",
        "com_x_m",
        "com_y_m",
        "bend_rad",
        "bend_direction_rad",
        "plane_rotation_rad",
        "angular_momentum_kg_m2_s",
        "energy_J",
        "work_J",
        "sharpest_curvature_1_m",
        "penetration_m",
        "asleep",
        *PRESSURE_COLUMNS,
    }
)
"""Columns of the telemetry that the metrics read, and the deepest penetration for those who check it."""

STALL_WINDOW_S = 1.2
STALL_ROLL_RAD = 0.3
"""A robot whose roll spans less than this over the window has stalled: it may rock a little, but does not get on."""
_BENT_RAD = 0.15
_ROLLED_RAD = 0.5  # from its first place: it was rolling

Columns = dict[str, NDArray[np.float64]]


@dataclass
class Events:
    """What happened in a run, in the order of `summary.json`'s lists."""

    faults: list[dict[str, Any]] = field(default_factory=list)
    detections: list[dict[str, Any]] = field(default_factory=list)
    recoveries: list[dict[str, Any]] = field(default_factory=list)


@dataclass(frozen=True)
class Cost:
    """What the run took: steps, simulated time [s] and wall time of the solver loop alone [s]."""

    steps: int
    sim_time_s: float
    wall_time_s: float


def summarise(scene: Scene, telemetry: pa.Table, events: Events, cost: Cost, outcome: str) -> dict[str, Any]:
    """The run's summary (design part 5). `outcome`: "done", "interrupted" or "failed: why"."""
    column = _columns(telemetry)
    t_s, roll = column["t_s"], column["roll_rad"]
    steady = t_s >= scene.steady_after_s - 1e-9
    moved: dict[str, Any] = {
        "revolutions": None,
        "displacement_m": [None, None],
        "plane_rotation_rad": None,
        "steady_span_s": 0.0,
    }
    advance = None
    if steady.sum() >= 2:
        first, last = int(np.argmax(steady)), len(t_s) - 1
        revolutions = float(roll[last] - roll[first]) / (2.0 * math.pi)
        displacement = [float(column[f"com_{axis}_m"][last] - column[f"com_{axis}_m"][first]) for axis in "xy"]
        moved = {
            "revolutions": revolutions,
            "displacement_m": displacement,
            "plane_rotation_rad": float(column["plane_rotation_rad"][last] - column["plane_rotation_rad"][first]),
            "steady_span_s": float(t_s[last] - t_s[first]),
        }
        if abs(revolutions) > 0.01:
            advance = math.hypot(*displacement) / abs(revolutions)
    matched = _match(events)
    return {
        "schema": SUMMARY_SCHEMA,
        "scene": scene.name,
        "outcome": outcome,
        "twin": scene.solver.twin,
        "accuracy": scene.solver.accuracy,
        "sim_time_s": cost.sim_time_s,
        "wall_time_s": cost.wall_time_s,
        "real_time_factor": cost.sim_time_s / cost.wall_time_s if cost.wall_time_s > 0.0 else None,
        "steps": cost.steps,
        **moved,
        "advance_per_revolution_m": advance,
        "total_revolutions": float(roll[-1] - roll[0]) / (2.0 * math.pi) if len(roll) else 0.0,
        "bend_rad": float(column["bend_rad"][-1]) if len(t_s) else None,
        "angular_momentum_max_kg_m2_s": _largest(column["angular_momentum_kg_m2_s"]),
        "energy_gain_J": energy_gain_J(column),
        "asleep_s": asleep_s(column),
        "highest_pressure_share": highest_pressure_share(
            np.column_stack([column[name] for name in PRESSURE_COLUMNS]), scene.robot.pneumatics.max_chamber_pressure_Pa
        ),
        "kinks": find_kinks(column, scene.robot.kink_curvature_1_m),
        "stalls": [asdict(stall) for stall in find_stalls(column, events.faults)],
        "faults": events.faults,
        "detections": matched["detections"],
        "recoveries": events.recoveries,
        "false_alarms": matched["false_alarms"],
        "misnamed": matched["misnamed"],
        "missed_faults": matched["missed_faults"],
    }


def energy_gain_J(column: Columns) -> float | None:
    """The most by which energy ever stood above the first sample's and the actuators' work since [J].

    Energy is kinetic, elastic and that of the weight; a passive robot can only lose it, so this is at most what the
    integration and the floor's springs, which are left out of it, add. None where the twin does not tell its energy.
    """
    gained = column["energy_J"] - column["work_J"]
    gained = gained[np.isfinite(gained)]
    return float((gained - gained[0]).max()) if len(gained) else None


def asleep_s(column: Columns) -> float:
    """How long the robot slept [s]: nothing moved, and nothing was computed."""
    since_last = np.diff(column["t_s"], prepend=0.0)
    return float(since_last[column["asleep"] == 1].sum())


def highest_pressure_share(pressures_Pa: NDArray[np.float64], limit_Pa: float) -> float | None:
    """The highest true pressure of any chamber over the chambers' limit; None where none is known."""
    highest_Pa = _largest(pressures_Pa)
    return None if highest_Pa is None else highest_Pa / limit_Pa


def find_kinks(column: Columns, kink_curvature_1_m: float) -> list[dict[str, float]]:
    """Times from which the tube was bent beyond its kink, each with the sharpest curvature before it was not."""
    kinks = []
    for first, end in _stretches(column["sharpest_curvature_1_m"] > kink_curvature_1_m):
        sharpest = float(column["sharpest_curvature_1_m"][first:end].max())
        kinks.append({"t_s": float(column["t_s"][first]), "curvature_1_m": sharpest})
    return kinks


@dataclass(frozen=True)
class Stall:
    """Rolling stopped at `t_s` with `chamber` (the dead one; −1: none is dead) at the angle θ from the inner side."""

    t_s: float
    until_s: float
    chamber: int
    theta_rad: float


def find_stalls(column: Columns, faults: list[dict[str, Any]]) -> list[Stall]:
    """Times at which a bent robot that had rolled stopped rolling; `until_s` is when it went on (or the end)."""
    t_s, roll, bend = column["t_s"], column["roll_rad"], column["bend_rad"]
    if len(t_s) < 3:
        return []
    window = max(2, round(STALL_WINDOW_S / float(np.median(np.diff(t_s)))))
    if len(t_s) <= window:
        return []
    spans = np.lib.stride_tricks.sliding_window_view(roll, window)
    still = (spans.max(axis=1) - spans.min(axis=1) < STALL_ROLL_RAD) & (bend[: len(spans)] > _BENT_RAD)
    stalls: list[Stall] = []
    moved_on = np.flatnonzero(~still & (np.abs(roll[: len(still)] - roll[0]) > _ROLLED_RAD))
    for first, end in _stretches(still):
        if len(moved_on) == 0 or moved_on[0] > first:
            continue  # it has not rolled yet
        last = min(end - 1 + window - 1, len(t_s) - 1)
        rest = roll[(first + last) // 2 : (first + last) // 2 + window // 2]
        inside = np.abs(roll[first : last + 1] - 0.5 * (rest.min() + rest.max())) <= 0.5 * np.ptp(rest) + 0.02
        stopped, until = first + int(np.argmax(inside)), last - int(np.argmax(inside[::-1]))
        dead = [f for f in faults if f["t_s"] <= t_s[stopped] and f["kind"] in EMPTIES_CHAMBER]
        chamber, theta = -1, math.nan
        if dead:
            chamber = int(dead[-1]["chamber"])
            theta = wrapped(CHAMBER_ANGLES_RAD[chamber] - float(column["bend_direction_rad"][(stopped + until) // 2]))
        stalls.append(Stall(float(t_s[stopped]), float(t_s[until]), chamber, theta))
    return stalls


def write_summary(run_dir: Path, summary: dict[str, Any]) -> None:
    """Write `summary.json`, atomically; numbers that are not finite become null."""
    partial = run_dir / "summary.json.partial"
    partial.write_text(json.dumps(_plain(summary), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    os.replace(partial, run_dir / "summary.json")


def _match(events: Events) -> dict[str, Any]:
    """Each detection to the earliest fault of its chamber and kind before it, and what it is worth."""
    open_faults = list(events.faults)
    struck = [_told(fault) for fault in events.faults]
    detections = []
    for found in events.detections:
        cause = next(
            (
                f
                for f in open_faults
                if f["chamber"] == found["chamber"] and f["kind"] == found["kind"] and f["t_s"] <= found["t_s"]
            ),
            None,
        )
        delay_s = None if cause is None else found["t_s"] - cause["t_s"]
        if cause is not None:
            open_faults.remove(cause)
        detections.append({**found, "delay_s": delay_s, "judgement": str(judge(_told(found), struck))})
    # what strikes a chamber already known to be broken changes nothing that could be seen
    missed = [
        f
        for f in open_faults
        if not any(
            d["delay_s"] is not None and d["chamber"] == f["chamber"] and d["t_s"] <= f["t_s"] for d in detections
        )
    ]
    judged = [found["judgement"] for found in detections]
    return {
        "detections": detections,
        "false_alarms": judged.count(Judgement.FALSE_ALARM),
        "misnamed": judged.count(Judgement.MISNAMED),
        "missed_faults": len(missed),
    }


def _told(event: dict[str, Any]) -> Told:
    return Told(float(event["t_s"]), int(event["chamber"]), str(event["kind"]))


def _columns(telemetry: pa.Table) -> Columns:
    """The columns that the metrics read; NaN for what is null, and for those that an earlier version did not record."""
    columns = {name: np.full(telemetry.num_rows, np.nan) for name in SUMMARY_COLUMNS}
    for name in SUMMARY_COLUMNS.intersection(telemetry.column_names):
        columns[name] = telemetry.column(name).to_numpy().astype(np.float64, copy=False)
    return columns


def _stretches(holds: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and one past the last index of each unbroken stretch in which it holds."""
    edges = np.flatnonzero(np.diff(holds, prepend=False, append=False))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _largest(values: NDArray[np.float64]) -> float | None:
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else None


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value
