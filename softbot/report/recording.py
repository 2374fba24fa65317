"""A run directory read back: what was recorded, checked, with the units of its columns kept.

Reads `summary.json`, `scene.toml`, `telemetry.parquet` and `shape.parquet`. A run that stopped early has fewer rows
and is read like any other; a file that is missing, empty or half-written is an InputError that names it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softbot.errors import InputError
from softbot.toml_file import read_toml

CHAMBER_COUNT = 4

REQUIRED_COLUMNS = ("t_s", "roll_rad", "com_x_m", "com_y_m", "com_z_m")
"""Telemetry columns without which there is nothing to show; the others are shown where they are recorded."""

VALVE_KINDS = frozenset({"rupture", "blocked_inlet", "stuck_open", "stuck_closed"})
"""Faults after which the chamber does not follow its command, whatever the sequencer knows."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Shapes:
    """The tube over time: `centreline_m` and unit `director` are (frames, nodes, 3), `t_s` is (frames,)."""

    t_s: Floats
    centreline_m: Floats
    director: Floats
    radius_m: float


@dataclass(frozen=True, slots=True)
class Recording:
    """One run: its summary, its scene, telemetry columns (NaN where nothing was recorded) and shapes."""

    name: str
    summary: dict[str, Any]
    scene: dict[str, Any]
    columns: dict[str, Floats]
    states: tuple[str, ...]
    shapes: Shapes

    @property
    def t_s(self) -> Floats:
        """Sample times [s], increasing."""
        return self.columns["t_s"]

    @property
    def roll_rev(self) -> Floats:
        """Roll since the first sample [revolutions], unwrapped, right-handed about the tangent."""
        roll_rad = np.unwrap(_filled(self.columns["roll_rad"]))
        return (roll_rad - roll_rad[0]) / (2.0 * math.pi)

    @property
    def drive_kind(self) -> str:
        """`drive.kind` of the scene, or "" where the scene does not say."""
        return str(self.table("drive").get("kind", ""))

    @property
    def has_ground(self) -> bool:
        """Whether there is a floor, at z = 0."""
        return self.table("world").get("ground", "plane") != "none"

    def table(self, key: str) -> Mapping[str, Any]:
        """A table of the scene, empty where the scene has none."""
        value = self.scene.get(key)
        return value if isinstance(value, dict) else {}

    def has(self, *names: str) -> bool:
        """Whether every one of these columns holds a finite value somewhere."""
        return all(name in self.columns and bool(np.isfinite(self.columns[name]).any()) for name in names)

    def events(self, key: str) -> list[dict[str, Any]]:
        """`faults`, `detections`, `recoveries` or `stalls` of the summary, those with a time, in order of time."""
        listed = self.summary.get(key)
        entries = [e for e in listed if isinstance(e, dict)] if isinstance(listed, list) else []
        timed = [e for e in entries if isinstance(e.get("t_s"), int | float) and math.isfinite(e["t_s"])]
        return sorted(timed, key=lambda entry: float(entry["t_s"]))

    def dead_from_s(self) -> list[float | None]:
        """For each chamber the time from which it is out of use, None if it never is.

        A chamber with a torn wall or a broken valve is out of use at once; one that leaks or whose sensor is wrong
        still works, and is out of use once the sequencer has named it.
        """
        result: list[float | None] = [None] * CHAMBER_COUNT
        broken = [fault for fault in self.events("faults") if fault.get("kind") in VALVE_KINDS]
        for event in broken + self.events("detections"):
            chamber, t_s = event.get("chamber"), float(event["t_s"])
            if isinstance(chamber, int) and 0 <= chamber < CHAMBER_COUNT:
                known = result[chamber]
                result[chamber] = t_s if known is None else min(known, t_s)
        return result

    def state_spans(self) -> list[tuple[float, float, str]]:
        """(start [s], end [s], state) of each stretch in one state; empty where no state was recorded."""
        if not any(self.states):
            return []
        spans: list[tuple[float, float, str]] = []
        start = 0
        for index in range(1, len(self.states) + 1):
            if index == len(self.states) or self.states[index] != self.states[start]:
                end = min(index, len(self.states) - 1)
                spans.append((float(self.t_s[start]), float(self.t_s[end]), self.states[start] or "unknown"))
                start = index
        return spans


def read_recording(run_dir: Path) -> Recording:
    """Read a run directory. Raises InputError naming the file that is missing or damaged, and the mend."""
    if not run_dir.is_dir():
        raise InputError(f"{run_dir}: no such run directory; name a folder written by `softbot run`")
    summary = _read_summary(run_dir / "summary.json")
    scene = read_toml(_existing(run_dir / "scene.toml"))
    columns, states = _read_telemetry(run_dir / "telemetry.parquet")
    shapes = _read_shapes(run_dir / "shape.parquet")
    return Recording(_name(summary, run_dir), summary, scene, columns, states, shapes)


def _existing(path: Path) -> Path:
    if not path.is_file():
        raise InputError(
            f"{path}: missing, so this is no complete run directory; run the scene again or name another folder"
        )
    return path


def _name(summary: Mapping[str, Any], run_dir: Path) -> str:
    scene = summary.get("scene")
    if isinstance(scene, dict):
        scene = scene.get("name")
    return scene if isinstance(scene, str) and scene else run_dir.resolve().name


def _read_summary(path: Path) -> dict[str, Any]:
    try:
        summary = json.loads(_existing(path).read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"{path}: half-written or no JSON ({error}); run the scene again") from None
    if not isinstance(summary, dict):
        raise InputError(f"{path}: holds no JSON object; run the scene again")
    return summary


def _read_parquet(path: Path) -> Any:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        table = parquet.read_table(_existing(path))
    except (pa.ArrowException, OSError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{path}: half-written or no Parquet file ({reason}); run the scene again") from None
    if table.num_rows == 0:
        raise InputError(f"{path}: holds no rows, so nothing was recorded; run the scene again")
    return table


def _check_times(t_s: Floats, path: Path) -> None:
    if not np.isfinite(t_s).all() or (np.diff(t_s) <= 0).any():
        raise InputError(f"{path}: t_s must be finite and increase from row to row; run the scene again")


def _read_telemetry(path: Path) -> tuple[dict[str, Floats], tuple[str, ...]]:
    import pyarrow as pa

    table = _read_parquet(path)
    missing = [name for name in REQUIRED_COLUMNS if name not in table.column_names]
    if missing:
        raise InputError(f"{path}: column {', '.join(missing)} missing; run the scene again with this version")
    columns: dict[str, Floats] = {}
    for name in table.column_names:
        kind = table.schema.field(name).type
        if pa.types.is_integer(kind) or pa.types.is_floating(kind):
            values = table.column(name).cast(pa.float64()).to_numpy(zero_copy_only=False)
            columns[name] = np.asarray(values, dtype=np.float64)
    for name in REQUIRED_COLUMNS:
        if name not in columns or not np.isfinite(columns[name]).any():
            raise InputError(f"{path}: column {name} holds no numbers; run the scene again")
    _check_times(columns["t_s"], path)
    states: tuple[str, ...] = ()
    if "state" in table.column_names:
        states = tuple("" if value is None else str(value) for value in table.column("state").to_pylist())
    return columns, states


def _read_shapes(path: Path) -> Shapes:
    table = _read_parquet(path)
    metadata = table.schema.metadata or {}
    try:
        radius_m = float(metadata[b"radius_m"])
    except (KeyError, ValueError):
        radius_m = math.nan
    if not (math.isfinite(radius_m) and radius_m > 0):
        raise InputError(f"{path}: metadata radius_m (metres, over 0) is missing; run the scene again")
    missing = [name for name in ("t_s", "centreline_m", "director") if name not in table.column_names]
    if missing:
        raise InputError(f"{path}: column {', '.join(missing)} missing; run the scene again with this version")
    t_s = np.asarray(table.column("t_s").to_numpy(), dtype=np.float64)
    _check_times(t_s, path)
    centreline_m = _node_vectors(table, "centreline_m", path)
    director = _node_vectors(table, "director", path)
    if centreline_m.shape != director.shape:
        raise InputError(f"{path}: centreline_m and director differ in nodes; run the scene again")
    # A simulation that blew up keeps what it recorded; its last frames may hold no position.
    whole = np.isfinite(centreline_m).all(axis=(1, 2)) & np.isfinite(director).all(axis=(1, 2))
    if not whole.any():
        raise InputError(f"{path}: no frame has finite positions; run the scene again")
    return Shapes(t_s[whole], centreline_m[whole], director[whole], radius_m)


def _node_vectors(table: Any, name: str, path: Path) -> Floats:
    """A list column of x, y, z of each node as (frames, nodes, 3)."""
    column = table.column(name).combine_chunks()
    try:
        if len(set(column.value_lengths().to_pylist())) != 1:
            raise ValueError("rows of different lengths")
        flat = np.asarray(column.flatten().to_numpy(zero_copy_only=False), dtype=np.float64)
        frames = flat.reshape(table.num_rows, -1, 3)
    except (AttributeError, TypeError, ValueError):
        raise InputError(
            f"{path}: {name} must list x, y, z of the same nodes in each row; run the scene again"
        ) from None
    if frames.shape[1] < 2:
        raise InputError(f"{path}: {name} needs two nodes or more in each row; run the scene again")
    return frames


def _filled(values: Floats) -> Floats:
    """The values with gaps (NaN) filled from the samples around them; at least one value is finite."""
    good = np.isfinite(values)
    if good.all():
        return values
    places = np.arange(values.size)
    return np.interp(places, places[good], values[good])
