"""A run's end on the terminal: what happened in a sentence, the numbers that matter, and where everything is."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from softbot.spoken_fault import spoken_where
from softbot.spoken_offer import spoken_offer

FILES = (("report", "report.html"), ("telemetry", "telemetry.parquet"), ("bus log", "bus.log"))
"""What a reader looks for in a run folder."""


def show(folder: Path) -> None:
    """Print the outcome of the run in a folder on standard output."""
    from rich.console import Console
    from rich.table import Table

    from softbot.errors import InputError
    from softbot.report.headline import headline
    from softbot.report.recording import read_recording

    recording = read_recording(folder)
    console = Console()
    console.print(headline(recording), style="bold", highlight=False)
    table = Table(show_header=False, box=None, pad_edge=False)
    try:
        found = rows(recording.summary)
    except KeyError as error:
        path = folder / "summary.json"
        raise InputError(f"{path}: {error.args[0]}: missing; run the scene again with this version") from None
    for name, value in found:
        table.add_row(f"{name:11}", value)
    console.print(table)
    for label, name in FILES:
        if (folder / name).exists():
            console.print(f"{label:12} {folder / name}", soft_wrap=True, highlight=False)


def rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Names and values with units of the summary's main numbers; what a run does not have is left out."""
    rest = summary.get("equilibrium")
    if rest:
        known = f"found in {rest['iterations']} steps, to {rest['residual']:.1g} of the radius a step"
        return [("bend", f"{math.degrees(summary['bend_rad']):.2f}°"), ("rest", known)]
    advance_m = summary.get("advance_per_revolution_m")
    factor = summary.get("real_time_factor")
    x_m, y_m = summary["displacement_m"]
    found = []
    if summary["revolutions"] is None:
        found.append(("revolutions", f"{summary['total_revolutions']:+.2f} in all; it ended before it was steady"))
    else:
        found.append(("revolutions", f"{summary['revolutions']:+.2f} in the last {summary['steady_span_s']:.1f} s"))
        found.append(("moved", f"{100.0 * x_m:+.1f} cm along, {100.0 * y_m:+.1f} cm to the left"))
    if advance_m is not None:
        found.append(("advance", f"{1e3 * advance_m:.1f} mm per revolution"))
    share = summary.get("highest_pressure_share")
    if share is not None:
        found.append(("pressure", f"at most {100.0 * share:.1f} % of the chambers' limit"))
    for fault in summary["faults"]:
        found.append(("fault", f"{fault['t_s']:.2f} s: {_words(fault)}"))
    for one in summary["detections"]:
        delay_s = one.get("delay_s")
        worth = {"right": "again"}.get(one.get("judgement", ""), one.get("judgement", "false alarm"))
        late = worth if delay_s is None else f"{1e3 * delay_s:.0f} ms after it struck"
        found.append(("detected", f"{one['t_s']:.2f} s: {_words(one)} ({late})"))
    for answer in summary["recoveries"]:
        found.append(("answered", f"{answer['t_s']:.2f} s: {str(answer['strategy']).replace('_', ' ')}"))
        if isinstance(answer.get("offer"), dict):
            found.append(("left", spoken_offer(answer["offer"])))
    if factor is not None:
        found.append(("speed", f"{factor:.1f} x real time ({summary['twin']} twin, {summary['accuracy']})"))
    return found


def _words(event: dict[str, Any]) -> str:
    return f"{spoken_where(event['chamber'])}, {str(event['kind']).replace('_', ' ')}"
