"""Finish the run directory of a run that was killed: its telemetry stream into Parquet, and a summary.

What the sequencer found and did was in the killed process; what it said of that is read back from the bus log. The
streams are left in place, so that nothing is lost if the run was alive after all, and finishing again does no harm.
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from firmware_protocol.codec import decode
from firmware_protocol.errors import ProtocolError
from firmware_protocol.trace import read_trace
from sim.scene import Scene, load_scene
from sim.summary import Cost, Events, summarise, write_summary
from sim.telemetry import SHAPE_SCHEMA, TELEMETRY_SCHEMA, read_table
from sim.twins import chosen_step_s
from softbot.errors import InputError
from softbot.nodes.heard import Heard
from softbot.nodes.lockstep import BUS_LOG

KILLED = "killed"


def was_killed(run_dir: Path) -> bool:
    """Whether a run directory holds a run that never ended (or one that still runs)."""
    if not (run_dir / "telemetry.arrow").exists():
        return False
    try:
        summary = json.loads((run_dir / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return True
    return isinstance(summary, dict) and summary.get("outcome") == KILLED


def finish_killed_run(run_dir: Path) -> dict[str, Any]:
    """Make Parquet files and `summary.json` of what a killed run recorded; returns the summary.

    Raises InputError when the directory holds no row or cannot be written.
    """
    scene = load_scene(run_dir / "scene.toml")
    radius = {b"radius_m": f"{scene.robot.radius_m:.9g}".encode()}
    telemetry = _to_parquet(run_dir, "telemetry", TELEMETRY_SCHEMA)
    _to_parquet(run_dir, "shape", SHAPE_SCHEMA.with_metadata(radius))
    if telemetry.num_rows == 0:
        raise InputError(f"{run_dir}: the run was killed before its first half second was on disk; run it again")
    end_s = float(telemetry.column("t_s")[-1].as_py())
    step_s = chosen_step_s(scene)
    cost = Cost(round(end_s / step_s), end_s, math.nan)
    summary = summarise(scene, telemetry, _events(run_dir / BUS_LOG, scene, end_s), cost, KILLED)
    try:
        write_summary(run_dir, summary)
    except OSError as error:
        raise InputError(f"{run_dir}: cannot be written: {error.strerror}") from None
    return summary


def _to_parquet(run_dir: Path, name: str, schema: pa.Schema) -> pa.Table:
    path = run_dir / f"{name}.parquet"
    partial = path.with_suffix(".partial")
    try:
        path.unlink(missing_ok=True)  # of an earlier finishing
        table = read_table(run_dir, name, schema)
        pq.write_table(table, partial, compression="zstd")
        os.replace(partial, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None
    return table


def _events(path: Path, scene: Scene, end_s: float) -> Events:
    faults = sorted(scene.fault, key=lambda fault: fault.t_s)
    heard = Heard()
    try:
        for t_s, frame in read_trace(path):
            heard.listen(*decode(frame.frame_id, frame.data), t_s)
    except ProtocolError:
        pass  # no bus in this run, or its log is damaged: what came before counts
    return Events(
        faults=[{"t_s": f.t_s, "chamber": f.chamber, "kind": str(f.kind)} for f in faults if f.t_s <= end_s],
        detections=heard.detections,
        recoveries=heard.recoveries,
    )
