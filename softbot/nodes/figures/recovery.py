"""Recovery (the paper's Fig. 4(d)): roll, pressures and shape over time as a chamber dies and the robot rolls on.

Two runs of the rod twin with the sequencer on its bus: one that reverses its curvature, and, for comparison, the same
robot without recovery, which stops with the dead chamber at ±90° from the inner side of the C. Drawn are, of the first,
the tube from above, its section in the middle with the chambers as they are filled, and the pressures; of both the roll
and the angle of the dead chamber.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from controllers.interface import SequencerState
from sim.figures._canvas import write
from sim.scene import scene_from
from sim.trajectory import wrapped
from softbot.errors import InputError
from softbot.report.recording import CHAMBER_COUNT, Floats, Recording, read_recording
from softbot.report.tube_picture import BACKGROUND, CHAMBERS, DEAD, Camera, fill, surface
from softbot.rolling import chamber_angle_rad

if TYPE_CHECKING:
    from matplotlib.axes import Axes

POSES = 7
_INK, _QUIET, _FAULT, _REVERSING = "#1c2329", "#66717b", "#d42c2c", "#0a8a5c"
_LETTERS = "abcdefghijklmnop"


def draw(
    path: Path,
    *,
    robot: str = "default",
    chamber: int = 1,
    command: str = "left",
    speed_rev_s: float = 0.4,
    fault_s: float = 4.0,
    duration_s: float = 11.0,
    accuracy: str = "standard",
) -> dict[str, Any]:
    """Roll a robot whose `chamber` is torn at `fault_s`, with and without recovery, drawn over `duration_s`.

    Returns, of the run without recovery, where it stopped: `stall_t_s` and the dead chamber's angle from the inner side
    `stall_theta_rad` (None: it did not); of the run with recovery `named_after_s`, the number of `reversals`, and the
    revolutions rolled before and after the fault, positive in the commanded direction. Raises InputError for a fault
    outside the run and for what no scene can have, SimulationError when a run fails.
    """
    if not 2.0 <= fault_s <= duration_s - 2.0:
        raise InputError(f"fault_s = {fault_s:g}: give two seconds of rolling before it, and two after it")
    from softbot.nodes.run import run_scene

    recordings = []
    for recovery in (True, False):
        table = _scene_table(robot, chamber, command, speed_rev_s, fault_s, duration_s, accuracy, recovery)
        with tempfile.TemporaryDirectory() as folder:
            run_scene(scene_from(table, "figure recovery", Path()), Path(folder))
            recordings.append(read_recording(Path(folder)))
    rolled_on, stopped = recordings
    _paint(path, rolled_on, stopped, chamber, fault_s)
    named = [one for one in rolled_on.events("detections") if one["t_s"] >= fault_s]
    stalls = [one for one in stopped.events("stalls") if one["t_s"] >= fault_s]
    turn = {"left": -1.0, "right": 1.0}[command]
    at_fault, at_end = np.interp([fault_s, duration_s], rolled_on.t_s, turn * rolled_on.roll_rev)
    return {
        "stall_t_s": stalls[0]["t_s"] if stalls else None,
        "stall_theta_rad": stalls[0]["theta_rad"] if stalls else None,
        "named_after_s": named[0]["t_s"] - fault_s if named else None,
        "reversals": len(reversals(rolled_on)),
        "rolled_before_rev": float(at_fault),
        "rolled_after_rev": float(at_end - at_fault),
    }


def _scene_table(
    robot: str,
    chamber: int,
    command: str,
    speed_rev_s: float,
    fault_s: float,
    duration_s: float,
    accuracy: str,
    recovery: bool,
) -> dict[str, Any]:
    if command not in ("left", "right"):
        raise InputError(f'command = {command!r}: rolls "left" or "right"')
    return {
        "robot": robot,
        "drive": {"kind": "sequencer"},
        "sequencer": {"command": command, "speed_rev_s": speed_rev_s, "recovery": recovery},
        "fault": [{"t_s": fault_s, "chamber": chamber, "kind": "rupture"}],
        "solver": {"twin": "rod", "accuracy": accuracy, "duration_s": duration_s},
    }


def reversals(recording: Recording) -> list[tuple[float, float]]:
    """Start and end [s] of each time that the sequencer reversed the curvature."""
    return [(start, end) for start, end, state in recording.state_spans() if state == SequencerState.REVERSING]


def pose_times(recording: Recording, fault_s: float) -> Floats:
    """The times worth a picture [s], POSES of them: rolling, each stage of the first reversal, and on to the end."""
    end_s = float(recording.t_s[-1])
    spans = reversals(recording)
    times = [fault_s - 1.0]
    if spans:
        first, last = spans[0]
        within = (recording.t_s >= first) & (recording.t_s <= last)
        straightest = float(recording.t_s[within][np.argmin(recording.columns["bend_rad"][within])])
        times += [first, straightest, last + 0.2]
    if len(spans) > 1:
        times += [0.5 * (spans[0][1] + spans[1][0]), spans[1][0], spans[1][1] + 0.2]
    times = [t for t in times if t <= end_s]
    return np.array([*times, *np.linspace(times[-1], end_s, POSES - len(times) + 1)[1:]])


def dead_chamber_angle_rad(recording: Recording, chamber: int) -> Floats:
    """Angle of a chamber from the inner side of the C [rad], in −π … π; NaN where the robot is all but straight."""
    angle = wrapped(chamber_angle_rad(chamber) - recording.columns["bend_direction_rad"])
    return np.where(recording.columns["bend_rad"] > 0.15, angle, np.nan)


def _paint(path: Path, rolled_on: Recording, stopped: Recording, chamber: int, fault_s: float) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 9.8), facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        6, POSES, height_ratios=(1.6, 1.0, 0.12, 1.25, 1.0, 1.25), hspace=0.07, wspace=0.04,
        left=0.085, right=0.985, top=0.935, bottom=0.06,
    )  # fmt: skip
    times_s = pose_times(rolled_on, fault_s)
    for column, t_s in enumerate(times_s):
        above = figure.add_subplot(grid[0, column])
        _from_above(above, rolled_on, float(t_s))
        if column == 0:
            above.set_ylabel("from above", fontsize=9.5, color=_QUIET)
        above.set_title(f"{_LETTERS[column]}   {t_s:.2f} s", fontsize=9.5, color=_INK, pad=4)
        section = figure.add_subplot(grid[1, column])
        _section(section, rolled_on, float(t_s))
        if column == 0:
            section.set_ylabel("section", fontsize=9.5, color=_QUIET)
    charts = [figure.add_subplot(grid[row, :]) for row in (3, 4, 5)]
    _rolls(charts[0], rolled_on, stopped)
    _angles(charts[1], rolled_on, stopped, chamber)
    _pressures(charts[2], rolled_on, chamber)
    for chart in charts:
        chart.axvline(fault_s, color=_FAULT, linewidth=1.2)
        for start, end in reversals(rolled_on):
            chart.axvspan(start, end, color=_REVERSING, alpha=0.13, linewidth=0)
        for t_s in times_s:
            chart.axvline(t_s, color="0.55", linewidth=0.7, linestyle=(0, (1, 2)))
        chart.set_xlim(rolled_on.t_s[0], rolled_on.t_s[-1])
        chart.grid(axis="y", alpha=0.25)
        chart.tick_params(labelsize=9)
    for column, t_s in enumerate(times_s):
        charts[0].annotate(
            _LETTERS[column], (t_s, 1.0), xycoords=("data", "axes fraction"), xytext=(0, 2), fontsize=9.5, color=_INK,
            textcoords="offset points", ha="center", va="bottom",
        )  # fmt: skip
    for chart in charts[:2]:
        chart.tick_params(labelbottom=False)
    charts[2].set_xlabel("time [s]")
    rolls = {"left": "left", "right": "right"}[str(rolled_on.table("sequencer").get("command"))]
    figure.suptitle(
        f"Chamber {chamber} is torn at {fault_s:g} s: the robot reverses its curvature and rolls on to the {rolls}",
        fontsize=12, color=_INK, y=0.985,
    )  # fmt: skip
    write(figure, path)


def _frame_at(recording: Recording, t_s: float) -> int:
    return int(np.abs(recording.shapes.t_s - t_s).argmin())


def _from_above(axes: Axes, recording: Recording, t_s: float) -> None:
    """The tube from above and a little from its right end, its left to the right of the picture."""
    camera = Camera.looking(0.0, 1.2)
    corners_m, colours = surface(recording, t_s)
    fill(axes, camera, [(corners_m, colours)], [0.0])
    middle = camera.flat(corners_m.reshape(-1, 3)).mean(axis=0)
    reach_m = float(np.linalg.norm(np.ptp(recording.shapes.centreline_m[0], axis=0)))
    axes.set_xlim(middle[0] - 0.38 * reach_m, middle[0] + 0.38 * reach_m)
    axes.set_ylim(middle[1] - 0.68 * reach_m, middle[1] + 0.68 * reach_m)
    axes.set_aspect("equal")
    axes.set_facecolor(BACKGROUND)
    _bare(axes)


def _section(axes: Axes, recording: Recording, t_s: float) -> None:
    """The middle section as the tube above shows it, on the floor: chambers filled as their pressures are."""
    from matplotlib.patches import Circle, Wedge

    frame = _frame_at(recording, t_s)
    node = recording.shapes.centreline_m.shape[1] // 2
    line_m, e1 = recording.shapes.centreline_m[frame], recording.shapes.director[frame, node]
    tangent = line_m[node + 1] - line_m[node - 1]
    tangent /= np.linalg.norm(tangent)
    across = np.cross([0.0, 0.0, 1.0], tangent)  # the robot's left
    up = np.cross(tangent, across)
    start = math.atan2(e1 @ up, e1 @ across)  # the tangent points at who looks, so e2 is a quarter turn on
    shown_Pa = np.array(
        [np.interp(t_s, recording.t_s, recording.columns[f"pressure_{i}_Pa"]) for i in range(CHAMBER_COUNT)]
    )
    highest_Pa = max(float(np.nanmax(recording.columns[f"pressure_{i}_Pa"])) for i in range(CHAMBER_COUNT))
    dead_s = recording.dead_from_s()
    axes.add_patch(Circle((0.0, 0.0), 1.0, facecolor="#efe8dc", edgecolor=_QUIET, linewidth=1.0))
    for i in range(CHAMBER_COUNT):
        middle = math.degrees(start + chamber_angle_rad(i))
        from_s = dead_s[i]
        dead = from_s is not None and t_s >= from_s
        full = min(max(float(shown_Pa[i]) / highest_Pa, 0.0), 1.0)
        face = (*DEAD, 0.85) if dead else (*CHAMBERS[i], 0.12 + 0.88 * full)
        axes.add_patch(
            Wedge((0.0, 0.0), 0.9, middle - 33.0, middle + 33.0, width=0.5, facecolor=face, edgecolor=CHAMBERS[i])
        )
        x, y = 0.65 * math.cos(math.radians(middle)), 0.65 * math.sin(math.radians(middle))
        axes.text(x, y, str(i), fontsize=7.5, ha="center", va="center", color="white" if dead or full > 0.5 else _INK)
    bend_rad = float(np.interp(t_s, recording.t_s, recording.columns["bend_rad"]))
    if bend_rad > 0.15:
        nearest = int(np.abs(recording.t_s - t_s).argmin())
        inner = start + float(recording.columns["bend_direction_rad"][nearest])
        tip, tail = ((size * math.cos(inner), size * math.sin(inner)) for size in (1.75, 1.08))
        axes.annotate("", xy=tip, xytext=tail, arrowprops={"arrowstyle": "-|>", "color": _INK, "linewidth": 1.2})
    axes.axhline(-1.0, color=_QUIET, linewidth=1.0)
    axes.set_xlim(-1.85, 1.85)
    axes.set_ylim(-1.12, 1.3)
    axes.set_aspect("equal")
    _bare(axes)


def _bare(axes: Axes) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)


def _rolls(chart: Axes, rolled_on: Recording, stopped: Recording) -> None:
    turn = -1.0 if rolled_on.table("sequencer").get("command") == "left" else 1.0
    fault_s = float(rolled_on.events("faults")[0]["t_s"])
    chart.plot(stopped.t_s, turn * stopped.roll_rev, color="0.45", linestyle="--", label="without recovery: stops")
    chart.plot(rolled_on.t_s, turn * rolled_on.roll_rev, color="#1769aa", linewidth=2.0, label="with recovery")
    chart.set_ylabel("roll [rev]")
    chart.fill_between([], [], color=_REVERSING, alpha=0.13, label="reversing the curvature")
    chart.legend(fontsize=9, frameon=False, loc="upper left")
    chart.annotate(
        "torn", (fault_s, 0.04), xycoords=("data", "axes fraction"), xytext=(4, 0), textcoords="offset points",
        color=_FAULT, fontsize=9.5,
    )  # fmt: skip


def _angles(chart: Axes, rolled_on: Recording, stopped: Recording, chamber: int) -> None:
    for recording, colour, style, width in ((stopped, "0.45", "--", 1.5), (rolled_on, "#1769aa", "-", 1.5)):
        angle = np.degrees(dead_chamber_angle_rad(recording, chamber))
        jump = np.flatnonzero(np.abs(np.diff(angle)) > 180.0)
        angle[jump] = np.nan  # from +180° to −180°
        chart.plot(recording.t_s, angle, color=colour, linestyle=style, linewidth=width)
    for level in (-90.0, 90.0):
        chart.axhline(level, color=_FAULT, linewidth=0.9, linestyle=":")
    chart.set_ylim(-185.0, 185.0)
    chart.set_yticks(range(-180, 181, 90))
    chart.set_ylabel(f"chamber {chamber} from\nthe inner side θ [°]")


def _pressures(chart: Axes, rolled_on: Recording, chamber: int) -> None:
    for i in range(CHAMBER_COUNT):
        pressure_kPa = 1e-3 * rolled_on.columns[f"pressure_{i}_Pa"]
        name = f"chamber {i}" + (" (torn)" if i == chamber else "")
        chart.plot(rolled_on.t_s, pressure_kPa, color=CHAMBERS[i], linewidth=1.6, label=name)
    chart.set_ylabel("pressure [kPa]")
    chart.set_ylim(bottom=-4.0, top=1.25 * chart.get_ylim()[1])
    chart.legend(fontsize=9, frameon=False, ncols=4, loc="upper center")
