"""Runs as a recorder leaves them behind, written without simulating, for the tests of what is made of them."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from softbot.report.headline import headline
from softbot.report.recording import read_recording

RADIUS_m = 0.01
LENGTH_m = 0.15
TURNING_RAD_S = math.pi  # half a revolution a second
SCENE = """[robot]
length_m = 0.15
[drive]
kind = "{kind}"
[world]
ground = "{ground}"
[sequencer]
command = "{command}"
[solver]
duration_s = {duration_s}
"""
RUPTURE = {"t_s": 4.0, "chamber": 2, "kind": "rupture"}
NAMED = {"t_s": 4.12, "chamber": 2, "kind": "rupture", "delay_s": 0.12}
STALL = {"t_s": 4.4, "chamber": 2, "theta_rad": 1.5}
REVERSAL = {"t_s": 4.5, "strategy": "curvature_reversal"}


def write_run(
    folder: Path,
    *,
    duration_s: float = 10.0,
    stops_s: float = math.inf,
    resumes_s: float = math.inf,
    resumed_sign: float = 1.0,
    rows_per_s: float = 50.0,
    planned_s: float | None = None,
    kind: str = "sequencer",
    command: str = "left",
    speed_m_s: float = 0.94 * RADIUS_m * TURNING_RAD_S,
    ground: str = "plane",
    opened_chamber: int | None = None,
    with_pressures: bool = True,
    with_states: bool = True,
    nodes: int = 11,
    scene_text: str = "",
    **summary: Any,
) -> Path:
    """A C-bent tube that rolls left, towards +y, at half a revolution a second, but not from stops_s to resumes_s."""
    folder.mkdir(parents=True, exist_ok=True)
    t_s = np.arange(round(duration_s * rows_per_s) + 1) / rows_per_s
    rolling_s = np.minimum(t_s, stops_s) + resumed_sign * np.maximum(t_s - resumes_s, 0.0)
    roll_rad = -TURNING_RAD_S * rolling_s
    com_m = np.stack([np.zeros_like(t_s), speed_m_s * rolling_s, np.full_like(t_s, RADIUS_m)], axis=1)
    columns: dict[str, Any] = {"t_s": t_s, "roll_rad": roll_rad}
    columns |= {f"com_{axis}_m": com_m[:, i] for i, axis in enumerate("xyz")}
    for i in range(4):
        wave_Pa = 60e3 * np.maximum(0.0, np.cos(roll_rad + i * math.pi / 2)) + (50e3 if i == opened_chamber else 0.0)
        columns[f"pressure_{i}_Pa"] = wave_Pa if with_pressures else np.full_like(t_s, np.nan)
        columns[f"command_{i}_Pa"] = wave_Pa if with_pressures else np.full_like(t_s, np.nan)
    columns |= {
        "bend_rad": np.full_like(t_s, 1.8),
        "bend_direction_rad": -roll_rad,
        "length_m": np.full_like(t_s, 0.155),
    }
    columns["theta_rad"] = np.where(t_s < 1.0, np.nan, 0.9)
    if with_states:
        columns["state"] = ["priming" if t < 1.0 else "degraded_rolling" if t > 4.5 else "rolling" for t in t_s]
        columns["c_bend_side"] = np.where(t_s < 1.0, 0, np.where(t_s < 4.5, 1, -1))
    parquet.write_table(pa.table(columns), folder / "telemetry.parquet")

    frames = np.arange(0, t_s.size, 2)
    along = np.linspace(-0.5, 0.5, nodes)
    shape_m = np.stack([LENGTH_m * np.sin(along), 0.5 * LENGTH_m * along**2, np.zeros(nodes)], axis=1)
    tangent = np.gradient(shape_m, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = np.stack([-tangent[:, 1], tangent[:, 0], np.zeros(nodes)], axis=1)
    upward = np.array([0.0, 0.0, 1.0])
    director = [np.cos(roll_rad[f]) * across + np.sin(roll_rad[f]) * upward for f in frames]
    write_shapes(folder / "shape.parquet", t_s[frames], [shape_m + com_m[f] for f in frames], director)

    scene = SCENE.format(
        kind=kind, ground=ground, command=command, duration_s=duration_s if planned_s is None else planned_s
    )
    (folder / "scene.toml").write_text(scene + scene_text, encoding="utf-8")
    told: dict[str, Any] = {
        "schema": "softbot-summary-1", "scene": "a scene", "twin": "bullet", "accuracy": "standard",
        "sim_time_s": duration_s, "wall_time_s": 2.5, "real_time_factor": 4.0, "steps": 2500, "revolutions": -3.5,
        "displacement_m": [0.0, 0.207], "advance_per_revolution_m": 0.0591, "plane_rotation_rad": 0.5, "bend_rad": 1.8,
        "stalls": [], "faults": [], "detections": [], "recoveries": [], "false_alarms": 0, "missed_faults": 0,
        "steady_span_s": 8.0,
    }  # fmt: skip
    (folder / "summary.json").write_text(json.dumps(told | summary), encoding="utf-8")
    return folder


def write_shapes(
    path: Path, t_s: Any, lines_m: list[Any], directors: list[Any], radius: bytes | None = b"0.01"
) -> None:
    schema = pa.schema(
        [("t_s", pa.float64()), ("centreline_m", pa.list_(pa.float32())), ("director", pa.list_(pa.float32()))],
        metadata={b"radius_m": radius} if radius is not None else None,
    )
    lists = [[np.asarray(v, dtype=np.float32).ravel() for v in vectors] for vectors in (lines_m, directors)]
    arrays = [pa.array(t_s), *(pa.array(v, pa.list_(pa.float32())) for v in lists)]
    parquet.write_table(pa.table(arrays, schema=schema), path)


def told(tmp_path: Path, **options: Any) -> str:
    return headline(read_recording(write_run(tmp_path / "run", **options)))


@pytest.fixture
def runs() -> ModuleType:
    """What is defined here: `write_run`, `write_shapes`, `told` and the events RUPTURE, NAMED, STALL, REVERSAL."""
    return sys.modules[__name__]
