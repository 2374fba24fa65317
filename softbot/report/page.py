"""The HTML report of a run: one self-contained page with an animation, linked plots, the path and the numbers.

The page is a template, a style sheet and a few scripts that stand beside this file; the run is put into it as JSON,
with its arrays as base64 of little-endian float32 or int16. It refers to nothing outside itself.
"""

from __future__ import annotations

import base64
import json
import math
import os
import re
from collections.abc import Mapping
from html import escape
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import softbot
from softbot.errors import InputError
from softbot.report.headline import headline
from softbot.report.recording import CHAMBER_COUNT, Floats, Recording, Shapes, read_recording
from softbot.report.tables import event_list, event_table, summary_table

REPORT_NAME = "report.html"
MAX_SAMPLES = 3000
"""Telemetry samples in the page; a plot is about a thousand pixels wide."""
MAX_FRAMES = 4000
"""Shapes in the page: 160 s at 25 a second; longer runs are thinned out."""
NODES = 33
"""Nodes of the drawn tube, laid through the recorded ones by a cubic spline."""
SCRIPTS = ("recording.js", "robot_view.js", "plots.js", "floor_path.js", "player.js")


def write_report(run_dir: Path) -> Path:
    """Write `report.html` into a run directory, whole or not at all, and return its path.

    Reads the run directory only. Raises InputError where a file of the run is missing or damaged, or where the
    page cannot be written.
    """
    run_dir = Path(run_dir)
    recording = read_recording(run_dir)
    page = render(recording, (run_dir / "scene.toml").read_text(encoding="utf-8-sig"))
    path = run_dir / REPORT_NAME
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_text(page, encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}; choose another place") from None
    return path


def render(recording: Recording, scene_text: str) -> str:
    """The page of a recording as text."""
    summary = recording.summary
    told = {
        "title": escape(recording.name),
        "headline": escape(headline(recording)),
        "facts": _facts(recording),
        "summary_rows": summary_table(summary),
        "event_rows": event_table(recording),
        "scene": escape(scene_text),
        "version": escape(softbot.__version__),
        "style": _part("report.css"),
        "script": "\n".join(_part(name) for name in SCRIPTS),
        "run": embedded_json(payload(recording)),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda match: told[match[1]], _part("report.html"))


def payload(recording: Recording) -> dict[str, Any]:
    """What the page's scripts read: arrays as base64, everything else plain JSON without NaN."""
    keep = _kept(recording.t_s.size, MAX_SAMPLES)
    columns = _columns(recording)
    pressures = [columns[f"pressure_{i}_kPa"] for i in range(CHAMBER_COUNT) if f"pressure_{i}_kPa" in columns]
    highest_kPa = max((float(np.nanmax(pressure)) for pressure in pressures), default=0.0)
    return {
        "name": recording.name,
        "ground": recording.has_ground,
        "samples": int(keep.size),
        "columns": {name: _float32(values[keep]) for name, values in columns.items()},
        "shapes": _shapes(recording.shapes),
        "bands": _bands(recording),
        "events": event_list(recording),
        "dead_from_s": recording.dead_from_s(),
        "highest_kPa": highest_kPa if len(pressures) == CHAMBER_COUNT and highest_kPa > 0 else None,
        "plots": _plots(columns),
    }


def embedded_json(value: Any) -> str:
    """JSON that can stand inside a script element: no NaN, no infinity, no character that HTML reads."""
    text = json.dumps(_finite(value), allow_nan=False, ensure_ascii=True, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value


def _part(name: str) -> str:
    return resources.files("softbot.report").joinpath(name).read_text(encoding="utf-8")


def _facts(recording: Recording) -> str:
    """The line under the headline: which twin, how exact, how long, how fast."""
    summary = recording.summary
    facts = [f"{summary[key]} {word}" for key, word in (("twin", "twin"), ("accuracy", "accuracy")) if summary.get(key)]
    if recording.drive_kind:
        facts.append(f"drive: {recording.drive_kind}")
    facts.append(f"{recording.t_s[-1] - recording.t_s[0]:.1f} s recorded")
    factor = summary.get("real_time_factor")
    if isinstance(factor, int | float) and math.isfinite(factor):
        facts.append(f"{factor:.3g} × real time")
    return "".join(f"<li>{escape(fact)}</li>" for fact in facts)


def _columns(recording: Recording) -> dict[str, Floats]:
    """The columns of the page, in the units in which it shows them; what was not recorded is left out."""
    told = recording.columns
    columns = {
        "t_s": told["t_s"],
        "roll_rev": recording.roll_rev,
        "x_cm": 100.0 * told["com_x_m"],
        "y_cm": 100.0 * told["com_y_m"],
        "z_cm": 100.0 * told["com_z_m"],
    }
    for axis in "xy":
        values = columns[f"{axis}_cm"]
        columns[f"moved_{axis}_cm"] = values - values[np.isfinite(values)][0]
    if recording.has(*(f"pressure_{i}_Pa" for i in range(CHAMBER_COUNT))):
        for i in range(CHAMBER_COUNT):
            columns[f"pressure_{i}_kPa"] = told[f"pressure_{i}_Pa"] / 1e3
            if recording.has(f"command_{i}_Pa"):
                columns[f"command_{i}_kPa"] = told[f"command_{i}_Pa"] / 1e3
    if recording.has("bend_rad"):
        columns["bend_deg"] = np.degrees(told["bend_rad"])
    if recording.has("theta_rad"):
        # an elongating chamber is active near 180°: counted from 0 to 360° the curve does not jump there
        columns["theta_deg"] = np.mod(np.degrees(told["theta_rad"]), 360.0)
    if recording.has("length_m"):
        columns["length_mm"] = 1e3 * told["length_m"]
    return columns


def _plots(columns: Mapping[str, Floats]) -> list[dict[str, Any]]:
    """The plots that these columns allow, from top to bottom; `colour` names a colour of the style sheet."""
    plots: list[dict[str, Any]] = []
    for i in range(CHAMBER_COUNT):
        if f"pressure_{i}_kPa" in columns:
            colour = f"chamber-{i}"
            series: list[dict[str, Any]] = []
            if f"command_{i}_kPa" in columns:
                series.append({"column": f"command_{i}_kPa", "label": "commanded", "colour": colour, "area": True})
            series.append({"column": f"pressure_{i}_kPa", "label": "measured", "colour": colour})
            plots.append({"title": f"chamber {i}", "unit": "kPa", "group": "pressure", "short": True, "series": series})
    plots.append(
        {"title": "roll", "unit": "rev", "series": [{"column": "roll_rev", "label": "roll", "colour": "accent"}]}
    )
    moved = [
        {"column": "moved_x_cm", "label": "x", "colour": "accent"},
        {"column": "moved_y_cm", "label": "y", "colour": "second"},
    ]
    plots.append({"title": "displacement", "unit": "cm", "series": moved})
    if "bend_deg" in columns:
        bend = {"column": "bend_deg", "label": "bend", "colour": "accent"}
        plots.append({"title": "bend", "unit": "°", "short": True, "zero": True, "series": [bend]})
    if "length_mm" in columns:
        length = {"column": "length_mm", "label": "length", "colour": "accent"}
        plots.append({"title": "length", "unit": "mm", "short": True, "series": [length]})
    if "theta_deg" in columns:
        theta = {"column": "theta_deg", "label": "θ", "colour": "accent", "wrap": 360}
        plots.append({"title": "θ of the active side", "unit": "°", "range": [0, 360], "series": [theta]})
    return plots


def _bands(recording: Recording) -> list[dict[str, Any]]:
    """Rows of coloured stretches over time: the sequencer's state, and the side of the C it commands."""
    bands: list[dict[str, Any]] = []
    spans = recording.state_spans()
    if spans:
        told = [[start, end, name.lower().replace("_", " ").replace("-", " ")] for start, end, name in spans]
        bands.append({"title": "state", "spans": told})
    if recording.has("c_bend_side"):
        side = np.nan_to_num(np.sign(recording.columns["c_bend_side"])).astype(int)
        if side.any():
            edges = [0, *(np.flatnonzero(np.diff(side)) + 1).tolist(), side.size]
            names = {1: "side +", -1: "side −", 0: "straight"}
            sides = [
                [float(recording.t_s[a]), float(recording.t_s[min(b, side.size - 1)]), names[int(side[a])]]
                for a, b in pairwise(edges)
            ]
            bands.append({"title": "C side", "spans": sides})
    return bands


def _shapes(shapes: Shapes) -> dict[str, Any]:
    """The tube's frames: positions as int16 steps from each frame's centre, directors as int16 of unit vectors."""
    keep = _kept(shapes.t_s.size, MAX_FRAMES)
    centreline_m = _resampled(shapes.centreline_m[keep])
    director = _resampled(shapes.director[keep])
    director /= np.maximum(np.linalg.norm(director, axis=2, keepdims=True), 1e-9)
    centre_m = centreline_m.mean(axis=1)
    offset_m = centreline_m - centre_m[:, None, :]
    step_m = max(float(np.abs(offset_m).max()), 1e-9) / 32767.0
    return {
        "frames": int(keep.size),
        "nodes": NODES,
        "radius_m": shapes.radius_m,
        "step_m": step_m,
        "t_s": _float32(shapes.t_s[keep]),
        "centre_m": _float32(centre_m),
        "offset": _int16(offset_m / step_m),
        "director": _int16(director * 32767.0),
    }


def _resampled(frames: Floats) -> Floats:
    """(frames, nodes, 3) with any number of nodes → NODES, evenly spaced in the node number."""
    from scipy.interpolate import make_interp_spline

    nodes = frames.shape[1]
    spline = make_interp_spline(np.arange(nodes), frames, k=min(3, nodes - 1), axis=1)
    return np.asarray(spline(np.linspace(0, nodes - 1, NODES)), dtype=np.float64)


def _kept(count: int, most: int) -> NDArray[np.int64]:
    """Which of `count` rows to keep so that at most `most` and the last one stand: every n-th."""
    if count <= most:
        return np.arange(count)
    return np.unique(np.linspace(0, count - 1, most).round().astype(np.int64))


def _float32(values: ArrayLike) -> str:
    return base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode("ascii")


def _int16(values: ArrayLike) -> str:
    return base64.b64encode(np.rint(np.asarray(values)).clip(-32767, 32767).astype("<i2").tobytes()).decode("ascii")
