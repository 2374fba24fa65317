"""The work-precision picture: wall time per simulated second against error, one panel a case."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sim.benchmark.case import Case
from sim.benchmark.result import Result

_STYLES = {
    "rod": ("#c1272d", "o", "rod twin"),
    "bullet": ("#3b7dd8", "s", "segment twin (PyBullet)"),
    "mujoco": ("#2e8b57", "^", "MuJoCo chain"),
    "pyelastica": ("#8a5a9e", "D", "PyElastica"),
}
_LEAST_ERROR_PERCENT = 1e-4
"""Smaller errors are drawn here: they are below the rulers' own."""
_COLUMNS = 3


def draw(path: Path, cases: Sequence[Case], results: Sequence[Result], caption: str = "") -> None:
    """Write the picture; its format follows the name. Raises OSError or ValueError where it cannot be written."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    shown = [case for case in cases if any(result.case == case.name for result in results)]
    columns = min(_COLUMNS, max(1, len(shown)))
    rows = math.ceil(len(shown) / columns)
    figure = Figure(figsize=(4.3 * columns, 3.6 * rows + 0.9), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis, case in zip(axes.flat, shown, strict=False):
        _panel(axis, case, [result for result in results if result.case == case.name])
    for axis in list(axes.flat)[len(shown) :]:
        axis.set_axis_off()
    handles: dict[str, Any] = {}
    for axis in axes.flat:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if handles:
        figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=len(handles), frameon=False)
    if caption:
        figure.supxlabel(caption, fontsize=6, color="0.4")
    figure.savefig(path, dpi=150)


def _panel(axis: Any, case: Case, results: Sequence[Result]) -> None:
    from matplotlib.ticker import NullFormatter

    for engine, (colour, marker, name) in _STYLES.items():
        points = [
            (max(abs(r.error_percent), _LEAST_ERROR_PERCENT), r.wall_s_per_sim_s)
            for r in results
            if r.engine == engine and r.error_percent is not None and r.wall_s_per_sim_s is not None
        ]
        if points:
            axis.plot(*zip(*points, strict=True), marker, color=colour, label=name, markersize=7, alpha=0.85)
    missing = sorted({f"{r.engine}: {r.reason}" for r in results if r.reason is not None and not r.setting})
    if missing:
        axis.text(
            0.02,
            0.02,
            "\n".join(_shortened(line) for line in missing),
            transform=axis.transAxes,
            fontsize=6,
            color="0.4",
        )
    axis.axhline(1.0, color="0.75", linewidth=0.8, zorder=0)  # real time
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.yaxis.set_minor_formatter(NullFormatter())
    axis.set_title(case.title, fontsize=10)
    axis.set_xlabel("error [% of the length]" if case.quantity == "tip" else "error [%]", fontsize=8)
    axis.set_ylabel("wall time per simulated second [s]", fontsize=8)
    axis.tick_params(labelsize=7)
    axis.grid(True, which="major", alpha=0.3)


def _shortened(text: str, most: int = 70) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"
