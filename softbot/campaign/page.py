"""A campaign's report: one HTML file that needs nothing else."""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from softbot.campaign.campaign import Draws
from softbot.campaign.statistics import false_alarm_words, matter_words, percent

REPORT_FILE = "report.html"
_MOST_BARS = 40

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1d2430; max-width: 68rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2.2rem; }
table { border-collapse: collapse; margin: .6rem 0; } td, th { padding: .2rem .7rem; border-bottom: 1px solid #dfe3ea; }
th { text-align: left; font-weight: 600; } td { text-align: right; font-variant-numeric: tabular-nums; }
td:first-child { text-align: left; } code { background: #f1f3f7; padding: .1rem .3rem; border-radius: 3px; }
.right { background: #d8efdc; } .wrong { background: #f8dcd6; } figure { margin: 1rem 0; } img { max-width: 100%; }
p.quiet { color: #626c7c; } .wide { overflow-x: auto; }
.wide th + th { writing-mode: vertical-rl; transform: rotate(180deg); } .wide td + td { padding: .2rem .3rem; }
"""


def write_page(draws: Draws, table: pa.Table, found: dict[str, Any], folder: Path) -> Path:
    """Write `report.html` into the campaign's folder; its path."""
    path = folder / REPORT_FILE
    partial = path.with_name(path.name + ".partial")
    partial.write_text(page(draws, table, found, folder), encoding="utf-8")
    os.replace(partial, path)
    return path


def page(draws: Draws, table: pa.Table, found: dict[str, Any], folder: Path) -> str:
    """The report as a text."""
    campaign = draws.campaign
    facts = [
        ("runs", f"{found['runs']} ({found['failed_runs']} failed)"),
        ("false alarms", false_alarm_words(found)),
        ("false verdicts beside a fault, on chambers that had none", str(found["false_alarms_beside_a_fault"])),
        ("single faults found", percent(found["single"]["detected"])),
        ("single faults named right", percent(found["single"]["named_right"])),
        ("sensor faults told from chamber faults", percent(found["sensor_told_from_chamber"])),
        *([("single faults that matter", matter_words(found))] if found["that_matter"]["judged"] else []),
        ("highest pressure, of the chambers' limit", percent(found["highest_pressure_share"])),
    ]
    parts = [
        f"<h1>{escape(campaign.name)}</h1>",
        f"<p class='quiet'>{campaign.runs} runs of seed {campaign.seed}; everything here can be made again from "
        "campaign.toml.</p>",
        _rows(("", ""), [(escape(name), escape(value)) for name, value in facts]),
        "<h2>By kind of fault</h2>",
        _kinds(found["by_kind"]),
        _kinds_that_matter(found["that_matter"]),
        "<h2>Delay of detection</h2>",
        _delays(table),
        "<h2>What was called what</h2>",
        _confusion(found["confusion"]),
        "<h2>By case</h2>",
        _cases(found["by_case"]),
        "<h2>Runs to look at</h2>",
        _worst(found["worst"], folder),
    ]
    title = escape(campaign.name)
    return (
        f"<!doctype html><html lang='en'><head><meta charset='utf-8'><title>{title}</title>"
        f"<style>{_STYLE}</style></head><body>{''.join(parts)}</body></html>\n"
    )


def _rows(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    top = "<tr>" + "".join(f"<th>{name}</th>" for name in head) + "</tr>" if any(head) else ""
    return (
        f"<table>{top}"
        + "".join("<tr>" + "".join(f"<td>{one}</td>" for one in row) + "</tr>" for row in rows)
        + "</table>"
    )


def _seconds(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f} s"


def _kinds(by_kind: dict[str, dict[str, Any]]) -> str:
    if not by_kind:
        return "<p class='quiet'>No run had a single fault.</p>"
    head = ("kind", "runs", "found", "named right", "median delay", "99 %", "rolls on", "speed kept", "longest still")
    return _rows(
        head,
        [
            (
                escape(kind),
                str(one["runs"]),
                percent(one["detected"]),
                percent(one["named_right"]),
                _seconds(one["delay_median_s"]),
                _seconds(one["delay_99_s"]),
                percent(one["rolls_on"]),
                percent(one["speed_kept_median"]),
                _seconds(one["longest_still_median_s"]),
            )
            for kind, one in by_kind.items()
        ],
    )


def _kinds_that_matter(matter: dict[str, Any]) -> str:
    if not matter["judged"]:
        return ""
    head = ("kind", "that matter", "found", "named right", "median delay", "90 %", "99 %")
    about = (
        "<p class='quiet'>Of these, those that matter: that cost more than a tenth of the speed, or take a chamber "
        "over its pressure limit, when nobody answers them.</p>"
    )
    return about + _rows(
        head,
        [
            (
                escape(kind),
                str(one["runs"]),
                percent(one["detected"]),
                percent(one["named_right"]),
                *(_seconds(one[f"delay_{name}_s"]) for name in ("median", "90", "99")),
            )
            for kind, one in matter["by_kind"].items()
        ],
    )


def _cases(by_case: dict[str, dict[str, Any]]) -> str:
    head = ("case", "rolls on", "speed kept", "worst tenth", "ordered speed held", "ended safe", "heading drift")
    return _rows(
        head,
        [
            (
                escape(case),
                percent(one["rolls_on"]),
                percent(one["speed_kept_median"]),
                percent(one["speed_kept_10"]),
                percent(one["ordered_speed_held"]),
                percent(one["ended_safe"]),
                "–" if one["heading_drift_median_rad"] is None else f"{one['heading_drift_median_rad']:.3g} rad",
            )
            for case, one in by_case.items()
        ],
    )


def _confusion(confusion: dict[str, dict[str, int]]) -> str:
    names = sorted({name for row in confusion.values() for name in row})
    if not names:
        return "<p class='quiet'>No run had a single fault.</p>"
    head = "<tr><th>struck</th>" + "".join(f"<th>{escape(name)}</th>" for name in names) + "</tr>"
    body = ""
    for kind, row in confusion.items():
        total = sum(row.values())
        body += f"<tr><td>{escape(kind)}</td>"
        for name in names:
            count = row.get(name, 0)
            look = "" if not count else " class='right'" if name == kind else " class='wrong'"
            body += f"<td{look}>{f'{100.0 * count / total:.0f} %' if count else ''}</td>"
        body += "</tr>"
    return f"<div class='wide'><table>{head}{body}</table></div>"


def _delays(table: pa.Table) -> str:
    kinds, delays = table.column("fault_0_kind").to_pylist(), table.column("fault_0_delay_s").to_pylist()
    by_kind: dict[str, list[float]] = {}
    for kind, delay in zip(kinds, delays, strict=True):
        if kind is not None and delay is not None:
            by_kind.setdefault(kind, []).append(delay)
    if not by_kind:
        return "<p class='quiet'>No fault was found.</p>"
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 0.6 + 0.34 * len(by_kind)), layout="constrained")
    axes = figure.subplots()
    names = sorted(by_kind, key=lambda kind: np.median(by_kind[kind]))
    axes.boxplot(
        [by_kind[name] for name in names], orientation="horizontal", tick_labels=names, whis=(1, 99), showfliers=False
    )
    axes.set_xscale("symlog", linthresh=0.1)
    axes.set_xlim(left=0.0)
    axes.set_xticks([0.0, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0], minor=False)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("from onset to the first verdict [s]; boxes: quartiles, whiskers: 1 % and 99 %")
    axes.grid(axis="x", alpha=0.3)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=110, metadata={"Software": None})
    data = base64.b64encode(picture.getvalue()).decode("ascii")
    return f"<figure><img alt='delays by kind' src='data:image/png;base64,{data}'></figure>"


def _worst(worst: dict[str, list[int]], folder: Path) -> str:
    rows = [
        (
            escape(name),
            "<br>".join(f"<code>softbot campaign {escape(str(folder))} --replay {run}</code>" for run in runs),
        )
        for name, runs in worst.items()
        if runs
    ]
    return _rows(("", "replay with"), rows) if rows else "<p class='quiet'>None.</p>"
