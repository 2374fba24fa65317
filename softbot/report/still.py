"""A stroboscopic picture of a run: the rolling tube at several times, its stripes, its path and what it lost.

Earlier poses are paler, so that the eye follows the robot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from softbot.errors import InputError
from softbot.report.headline import spoken_kind, spoken_time
from softbot.report.recording import Floats, Recording, read_recording
from softbot.report.tube_picture import AROUND, BACKGROUND, Camera, fill, surface
from softbot.spoken_fault import spoken_where

MAX_POSES = 12
CLEARANCE_RADII = 2.5
"""How near the middle lines of two poses may come; at 2 the tubes touch."""

PATH = "#1769aa"
GRID = "#c3d0d6"
INK = "#1c2329"
FAULT = "#d42c2c"
RECOVERY = "#0a8a5c"


def write_still(run_dir: Path, path_png: Path, times_s: Sequence[float] | None = None) -> Path:
    """Draw the robot at `times_s` (default: evenly along its path) into a PNG file and return its path.

    Reads the run directory only. Raises InputError where a file of the run is missing or damaged, where a time lies
    outside the recording, or where the picture cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    recording = read_recording(Path(run_dir))
    shown_s = _default_times(recording) if times_s is None else np.asarray(times_s, dtype=np.float64)
    first_s, last_s = float(recording.shapes.t_s[0]), float(recording.shapes.t_s[-1])
    if shown_s.size == 0 or not ((shown_s >= first_s - 1e-9) & (shown_s <= last_s + 1e-9)).all():
        raise InputError(f"times_s: give one or more times between {first_s:g} s and {last_s:g} s, as recorded")
    figure = Figure(figsize=(10.0, 4.6), dpi=150, facecolor=BACKGROUND)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    _draw(axes, recording, np.sort(shown_s))
    try:
        figure.savefig(path_png, facecolor=BACKGROUND, metadata={"Software": None})
    except OSError as error:
        raise InputError(f"{path_png}: cannot be written: {error.strerror}; choose another place") from None
    return Path(path_png)


def _draw(axes: Any, recording: Recording, shown_s: Floats) -> None:
    path_m = np.stack([recording.columns[f"com_{axis}_m"] for axis in "xyz"], axis=1)
    path_m = path_m[np.isfinite(path_m).all(axis=1)]
    if recording.has_ground:
        path_m[:, 2] = 0.0
    camera = Camera.looking(_heading(recording, path_m) - 1.0, 0.62)
    meshes = [surface(recording, t_s) for t_s in shown_s]
    # Only the part of the path between the first and the last pose is in the picture.
    corners = camera.flat(np.concatenate([mesh[0].reshape(-1, 3) for mesh in meshes]))
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = 2.2 * recording.shapes.radius_m
    _fit(axes, low - margin, high + margin * np.array([1.0, 1.6]))

    if recording.has_ground:
        _draw_floor(axes, camera, recording)
        for mesh in meshes:
            _draw_shadow(axes, camera, mesh[0], recording.shapes.radius_m)
    axes.plot(*camera.flat(path_m).T, color=PATH, linewidth=2.2, solid_capstyle="round", zorder=3, alpha=0.85)

    fill(axes, camera, meshes, [0.5 * (1.0 - (index + 1) / len(meshes)) for index in range(len(meshes))])
    _label(axes, camera, recording, shown_s, meshes)


def _default_times(recording: Recording) -> Floats:
    """Times of poses that do not touch each other: the tightest row of at most `MAX_POSES`, from the first frame on."""
    shapes = recording.shapes
    every = max(1, shapes.centreline_m.shape[1] // 12)
    lines_m = shapes.centreline_m[:, ::every]
    clearance_m = CLEARANCE_RADII * shapes.radius_m
    while True:
        kept = [0]
        for frame in range(1, shapes.t_s.size):
            gap_m = np.linalg.norm(lines_m[kept][:, :, None] - lines_m[frame][None, None], axis=-1).min()
            if gap_m >= clearance_m:
                kept.append(frame)
            if len(kept) > MAX_POSES:
                break
        if len(kept) <= MAX_POSES:
            return shapes.t_s[kept]
        clearance_m *= 1.15


def _heading(recording: Recording, path_m: Floats) -> float:
    """The direction in which the robot went [rad], or across the tube where it went nowhere."""
    went_m = path_m[-1] - path_m[0]
    if math.hypot(went_m[0], went_m[1]) > recording.shapes.radius_m:
        return math.atan2(went_m[1], went_m[0])
    chord_m = recording.shapes.centreline_m[0, -1] - recording.shapes.centreline_m[0, 0]
    return math.atan2(chord_m[1], chord_m[0]) + math.pi / 2.0


def _fit(axes: Any, low_m: Floats, high_m: Floats) -> None:
    """Limits that hold a box with equal scales, whatever the picture's proportions."""
    axes.set_axis_off()
    width, height = axes.figure.get_size_inches()
    centre_m, size_m = (low_m + high_m) / 2.0, high_m - low_m
    scale = max(size_m[0] / width, size_m[1] / height)
    axes.set_xlim(centre_m[0] - scale * width / 2.0, centre_m[0] + scale * width / 2.0)
    axes.set_ylim(centre_m[1] - scale * height / 2.0, centre_m[1] + scale * height / 2.0)


def _draw_floor(axes: Any, camera: Camera, recording: Recording) -> None:
    """A grid of 5 radii under everything in the picture."""
    from matplotlib.collections import LineCollection

    step_m = 5.0 * recording.shapes.radius_m
    middle_m = recording.shapes.centreline_m.mean(axis=(0, 1))
    width_m = np.ptp(axes.get_xlim())
    ox, oy = step_m * np.round(middle_m[:2] / step_m)
    reach_m = step_m * math.ceil(1.6 * width_m / step_m)
    offsets_m = np.arange(-reach_m, reach_m + step_m / 2.0, step_m)
    lines = [[[ox + d, oy - reach_m, 0.0], [ox + d, oy + reach_m, 0.0]] for d in offsets_m]
    lines += [[[ox - reach_m, oy + d, 0.0], [ox + reach_m, oy + d, 0.0]] for d in offsets_m]
    axes.add_collection(LineCollection([*camera.flat(np.array(lines))], colors=GRID, linewidths=0.6, zorder=1))


def _draw_shadow(axes: Any, camera: Camera, corners_m: Floats, radius_m: float) -> None:
    """The tube's outline on the floor, soft: a few copies of its middle line, from wide to narrow."""
    rings_m = corners_m.reshape(-1, AROUND, 4, 3)[:, :, 0].mean(axis=1)
    rings_m[:, 2] = 0.0
    line = camera.flat(rings_m)
    points_per_m = 72.0 * axes.figure.get_size_inches()[0] / np.ptp(axes.get_xlim())
    for layer in range(6):
        size = (2.6 - 0.32 * layer) * radius_m * points_per_m
        axes.plot(*line.T, color="#24343d", alpha=0.045, linewidth=size, solid_capstyle="round", zorder=2)


def _label(
    axes: Any, camera: Camera, recording: Recording, shown_s: Floats, meshes: Sequence[tuple[Floats, Floats]]
) -> None:
    """The time beside each pose, and flags on the path where a chamber was lost and where the C was reversed first."""
    box_m = np.array([*axes.get_xlim(), *axes.get_ylim()])
    lift_m = 0.02 * (box_m[3] - box_m[2])
    for t_s, (corners_m, _) in zip(shown_s, meshes, strict=True):
        outline = camera.flat(corners_m.reshape(-1, 3))
        lowest = outline[outline[:, 1].argmin()]
        axes.text(
            *(lowest - [0.0, lift_m]), spoken_time(t_s), color="#66717b", fontsize=8, ha="center", va="top", zorder=6
        )
    flags = [
        (f, f"{spoken_where(f.get('chamber'))}: {spoken_kind(f.get('kind', 'fault'))}", FAULT)
        for f in recording.events("faults")
    ]
    flags += [(r, spoken_kind(r.get("strategy", "recovery")), RECOVERY) for r in recording.events("recoveries")[:1]]
    for event, text, colour in flags:
        if not shown_s[0] <= event["t_s"] <= shown_s[-1]:
            continue
        place_m = [np.interp(event["t_s"], recording.t_s, recording.columns[f"com_{axis}_m"]) for axis in "xyz"]
        foot = camera.flat(np.array([place_m[0], place_m[1], 0.0 if recording.has_ground else place_m[2]]))
        top_m = box_m[3] - (0.07 if colour == FAULT else 0.14) * (box_m[3] - box_m[2])
        axes.plot([foot[0], foot[0]], [foot[1], top_m], color=colour, linewidth=1.0, zorder=5)
        axes.plot(*foot, marker="o", markersize=4.5, color=colour, zorder=5)
        side = "left" if foot[0] < box_m[0] + 0.65 * (box_m[1] - box_m[0]) else "right"
        words = f" {text} at {spoken_time(event['t_s'])} "
        style = {"color": colour, "fontsize": 9, "fontweight": "bold", "va": "bottom", "ha": side, "zorder": 6}
        axes.text(foot[0], top_m, words, **style)
