"""What the figures share: a sheet to draw on without a screen, colours, and a file at the end."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from softbot.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Told apart by the colour-blind (Okabe and Ito)."""
FORMATS = (".png", ".svg", ".pdf")


def sheet(columns: int, rows: int = 1, *, width_in: float = 5.2, height_in: float = 4.2) -> tuple[Figure, Any]:
    """A figure and its axes (rows, columns), each of that size [inches]."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in * columns, height_in * rows), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis in axes.flat:
        axis.grid(alpha=0.25)
    return figure, axes


def write(figure: Figure, path: Path) -> None:
    """Write the figure as PNG, SVG or PDF, by the file's ending. Raises InputError where it cannot be written."""
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"{path}: a picture ends in {', '.join(FORMATS)}")
    try:
        figure.savefig(path, dpi=150)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}; choose another place") from None
