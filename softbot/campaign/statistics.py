"""The numbers that a campaign's table comes to: found, named, how late, how often for nothing, how fast it rolls on."""

from __future__ import annotations

import time
from collections import Counter
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
HOUR_S = 3600.0

SENSOR_KINDS = frozenset(
    {
        "sensor_offset",
        "sensor_drift",
        "sensor_noise",
        "sensor_stuck",
        "sensor_dropout",
        "sensor_scale",
        "lines_swapped",
        "imu_bias",
        "imu_stuck",
        "imu_dropout",
    }
)
WORST = 5
"""Runs that the report names of each kind of failing."""


class Tally:
    """What a campaign has found so far, for those who watch it."""

    def __init__(self) -> None:
        self._since_s = time.monotonic()
        self._counts: Counter[str] = Counter()

    def add(self, row: dict[str, Any]) -> None:
        """Count a run that has ended."""
        self._counts["runs"] += 1
        self._counts["failed"] += row["outcome"] != "done"
        self._counts["false alarms"] += row.get("false_alarms") or 0
        for n in range(row.get("faults") or 0):
            if f"fault_{n}_kind" in row:
                self._counts["faults"] += 1
                self._counts["found"] += bool(row.get(f"fault_{n}_detected"))
                self._counts["named right"] += bool(row.get(f"fault_{n}_named_right"))

    def rate(self) -> float:
        """Runs for each second of the clock."""
        return self._counts["runs"] / max(time.monotonic() - self._since_s, 1e-9)

    def words(self) -> str:
        """What was found, in a few words."""
        count = self._counts
        parts = [f"{count['found']}/{count['faults']} faults found, {count['named right']} named right"]
        parts += [f"{count[name]} {name}" for name in ("false alarms", "failed") if count[name]]
        return ", ".join(parts)


def statistics(table: pa.Table) -> dict[str, Any]:
    """The campaign's numbers from its table, as plain values (null where there is nothing to count)."""
    columns = {name: table.column(name).to_pylist() for name in table.column_names}
    done = [outcome == "done" for outcome in columns["outcome"]]
    rolling_h = sum(value or 0.0 for value in columns["rolling_s"]) / HOUR_S
    beside = sum(value or 0 for value in columns["false_alarms_beside"])
    false_alarms = sum(value or 0 for value in columns["false_alarms"]) - beside
    healthy = [
        value or 0.0 for value, faults in zip(columns["rolling_s"], columns["faults"], strict=True) if faults == 0
    ]
    single = [i for i in range(table.num_rows) if done[i] and columns["faults"][i] == 1]
    double = [i for i in range(table.num_rows) if done[i] and (columns["faults"][i] or 0) > 1]
    kinds = sorted({columns["fault_0_kind"][i] for i in single})
    judged = [i for i in single if columns["matters"][i] is not None]
    matter = [i for i in judged if columns["matters"][i]]
    return {
        "runs": table.num_rows,
        "failed_runs": done.count(False),
        "hours_without_fault": rolling_h,
        "hours_of_healthy_runs": sum(healthy) / HOUR_S,
        "false_alarms": false_alarms,
        "false_alarms_per_hour": false_alarms / rolling_h if rolling_h > 0.0 else None,
        "false_alarms_beside_a_fault": beside,
        "single": _group(columns, single),
        "by_kind": {kind: _group(columns, [i for i in single if columns["fault_0_kind"][i] == kind]) for kind in kinds},
        "by_case": {
            case: _rolling(columns, [i for i in range(table.num_rows) if done[i] and columns["case"][i] == case])
            for case in sorted(set(columns["case"]))
        },
        "that_matter": {
            "judged": len(judged),
            "single": _group(columns, matter),
            "by_kind": {
                kind: _group(columns, [i for i in matter if columns["fault_0_kind"][i] == kind]) for kind in kinds
            },
            "sensor_told_from_chamber": _sensor_told(columns, matter),
            "confusion": confusion(columns, matter),
        },
        "two_faults": _group(columns, double),
        "sensor_told_from_chamber": _sensor_told(columns, single),
        "confusion": confusion(columns, single),
        "highest_pressure_share": max((value or 0.0 for value in columns["highest_pressure_share"]), default=None),
        "worst": _worst(columns, single, done),
    }


def _group(columns: dict[str, list[Any]], rows: list[int]) -> dict[str, Any]:
    delays = np.array([columns["fault_0_delay_s"][i] for i in rows if columns["fault_0_detected"][i]], dtype=float)
    return {
        "runs": len(rows),
        "detected": _share([bool(columns["fault_0_detected"][i]) for i in rows]),
        "named_right": _share([bool(columns["fault_0_named_right"][i]) for i in rows]),
        "chamber_right": _share([columns["fault_0_named_chamber"][i] == columns["fault_0_chamber"][i] for i in rows]),
        **{f"delay_{name}_s": _quantile(delays, q) for name, q in (("median", 0.5), ("90", 0.9), ("99", 0.99))},
        **_rolling(columns, rows),
    }


def _sensor_told(columns: dict[str, list[Any]], rows: list[int]) -> float | None:
    """Share of the faults found that were taken for a sensor's when they were one, and for none when not."""
    return _share(
        [
            (columns["fault_0_kind"][i] in SENSOR_KINDS) == (columns["fault_0_named_kind"][i] in SENSOR_KINDS)
            for i in rows
            if columns["fault_0_detected"][i]
        ]
    )


def _rolling(columns: dict[str, list[Any]], rows: list[int]) -> dict[str, Any]:
    before = [columns["rate_before_rev_s"][i] for i in rows]
    after = [_own_rate(columns, i) for i in rows]
    kept = [b / a for a, b in zip(before, after, strict=True) if a and b is not None and a > 0.02]
    ordered = [columns["ordered_rev_s"][i] for i in rows]
    held = [abs(b - o) <= 0.1 * o for o, b in zip(ordered, after, strict=True) if o and b is not None]
    still = [columns["longest_still_s"][i] for i in rows if columns["longest_still_s"][i] is not None]
    drift = [abs(columns["heading_drift_rad"][i]) for i in rows]
    return {
        "rolls_on": _share([value > 0.02 for value in after if value is not None]),
        "speed_kept_median": _quantile(np.array(kept), 0.5),
        "speed_kept_10": _quantile(np.array(kept), 0.1),
        "ordered_speed_held": _share(held),
        "longest_still_median_s": _quantile(np.array(still), 0.5),
        "heading_drift_median_rad": _quantile(np.array(drift), 0.5),
        "ended_safe": _share([columns["final_state"][i] == "safe" for i in rows]),
    }


def _own_rate(columns: dict[str, list[Any]], i: int) -> float | None:
    """Rate after a run's faults [rev/s]: a robot that was stopped and coasts on does not roll on."""
    rate: float | None = columns["rate_after_rev_s"][i]
    return rate if rate is None or columns["final_state"][i] != "safe" else 0.0


def confusion(columns: dict[str, list[Any]], rows: list[int]) -> dict[str, dict[str, int]]:
    """Of each kind that struck, how often it was given which name; a kind on a wrong chamber has its own entry."""
    table: dict[str, Counter[str]] = {}
    for i in rows:
        name = columns["fault_0_named_kind"][i] if columns["fault_0_detected"][i] else "(missed)"
        if columns["fault_0_detected"][i] and columns["fault_0_named_chamber"][i] != columns["fault_0_chamber"][i]:
            name = f"{name} elsewhere"
        table.setdefault(columns["fault_0_kind"][i], Counter())[name] += 1
    return {kind: dict(sorted(names.items())) for kind, names in sorted(table.items())}


def _worst(columns: dict[str, list[Any]], single: list[int], done: list[bool]) -> dict[str, list[int]]:
    """Numbers of the runs to look at first, for each way in which a run can be bad."""
    run = columns["run"]

    def largest(name: str, rows: list[int]) -> list[int]:
        there = [i for i in rows if columns[name][i] is not None]
        return [run[i] for i in sorted(there, key=lambda i: -columns[name][i])[:WORST]]

    every = list(range(len(run)))
    return {
        "failed": [run[i] for i in every if not done[i]][:WORST],
        "false alarms": [run[i] for i in every if columns["false_alarms"][i]][:WORST],
        "missed": [run[i] for i in single if not columns["fault_0_detected"][i]][:WORST],
        "misnamed": [
            run[i] for i in single if columns["fault_0_detected"][i] and not columns["fault_0_named_right"][i]
        ][:WORST],
        "found latest": largest("fault_0_delay_s", single),
        "longest still": largest("longest_still_s", single),
        "rolled back": [
            run[i]
            for i in every
            if columns["rate_after_rev_s"][i] is not None and columns["rate_after_rev_s"][i] < -0.02
        ][:WORST],
        "highest pressure": largest("highest_pressure_share", every)[:1],
    }


def _share(those: list[bool]) -> float | None:
    return sum(those) / len(those) if those else None


def _quantile(values: FloatArray, q: float) -> float | None:
    return float(np.quantile(values, q)) if values.size else None


def lines(found: dict[str, Any]) -> list[tuple[str, str]]:
    """The main numbers in words, for a terminal."""
    single = found["single"]
    shown = [("runs", f"{found['runs']}" + (f", {found['failed_runs']} failed" if found["failed_runs"] else ""))]
    per_hour = found["false_alarms_per_hour"]
    if per_hour is not None:
        shown.append(("false alarms", false_alarm_words(found)))
    if found["false_alarms_beside_a_fault"]:
        shown.append(("false beside a fault", f"{found['false_alarms_beside_a_fault']} on chambers that had none"))
    if single["runs"]:
        shown.append(
            (
                "single faults",
                f"{single['runs']}: {percent(single['detected'])} found, {percent(single['named_right'])} named right",
            )
        )
    matter = found["that_matter"]
    if matter["judged"]:
        shown.append(("  that matter", matter_words(found)))
    for kind, group in found["by_kind"].items():
        delay = "" if group["delay_median_s"] is None else f", median delay {group['delay_median_s']:.2f} s"
        shown.append(
            (
                f"  {kind}",
                f"{group['runs']}: {percent(group['detected'])} found, {percent(group['named_right'])} named{delay}"
                f", rolls on {percent(group['rolls_on'])}, speed kept {percent(group['speed_kept_median'])}",
            )
        )
        if matter["judged"]:
            shown.append(("", _matter_of_kind(matter["by_kind"][kind])))
    for name, runs in found["worst"].items():
        if runs:
            shown.append((name, "runs " + ", ".join(str(run) for run in runs)))
    return shown


def matter_words(found: dict[str, Any]) -> str:
    """Rates of the single faults that matter, with how many were judged."""
    single, matter = found["single"], found["that_matter"]
    undecided = single["runs"] - matter["judged"]
    return f"{_matter_of_kind(matter['single'])}; sensors told {percent(matter['sensor_told_from_chamber'])}" + (
        f"; {undecided} undecided" if undecided else ""
    )


def _matter_of_kind(group: dict[str, Any]) -> str:
    if not group["runs"]:
        return "none matters"
    delay = "" if group["delay_median_s"] is None else f", median delay {group['delay_median_s']:.2f} s"
    found = f"{group['runs']} matter: {percent(group['detected'])} found"
    return f"{found}, {percent(group['named_right'])} named right{delay}"


def false_alarm_words(found: dict[str, Any]) -> str:
    """The false alarms with what they are counted over."""
    per_hour = found["false_alarms_per_hour"]
    if per_hour is None:
        return "nothing rolled without a fault"
    whole = found["hours_of_healthy_runs"]
    return (
        f"{found['false_alarms']} in {found['hours_without_fault']:.2f} h of rolling with nothing wrong "
        f"({per_hour:.2g} an hour): {whole:.2f} h of healthy runs, {found['hours_without_fault'] - whole:.2f} h before "
        "faults"
    )


def percent(share: float | None) -> str:
    """A share for people."""
    return "–" if share is None else f"{100.0 * share:.1f} %"
