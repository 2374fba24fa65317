"""Telemetry of a run: one row a sample, safe against a killed process.

Rows go into `telemetry.arrow` (an Arrow stream, a record batch every 50 rows, readable at any time); when the run
ends it becomes `telemetry.parquet` and the stream is removed. `read_telemetry` reads whichever is there, a stream that
ends in the middle of a row group included. `shape.parquet` (centre line and section axis, for pictures) likewise.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from softbot.errors import InputError, SimulationError

FLUSH_ROWS = 50

_CHAMBERS = range(4)
TELEMETRY_SCHEMA = pa.schema(
    [
        ("t_s", pa.float64()),
        *[(f"pressure_{i}_Pa", pa.float64()) for i in _CHAMBERS],
        *[(f"command_{i}_Pa", pa.float64()) for i in _CHAMBERS],
        ("roll_rad", pa.float64()),
        *[(f"com_{axis}_m", pa.float64()) for axis in "xyz"],
        ("bend_rad", pa.float64()),
        ("bend_direction_rad", pa.float64()),
        ("length_m", pa.float64()),
        ("theta_rad", pa.float64()),
        ("state", pa.string()),
        ("c_bend_side", pa.int8()),
        ("plane_rotation_rad", pa.float64()),
        ("angular_momentum_kg_m2_s", pa.float64()),
        ("supply_Pa", pa.float64()),
        ("energy_J", pa.float64()),
        ("work_J", pa.float64()),
        ("sharpest_curvature_1_m", pa.float64()),
        ("penetration_m", pa.float64()),
        ("asleep", pa.float64()),
    ]
)
NULLABLE = frozenset({"energy_J", "work_J", "sharpest_curvature_1_m", "penetration_m", "asleep"})
"""Columns that are null where a twin does not tell them of itself; in the others that is NaN."""
SHAPE_SCHEMA = pa.schema(
    [("t_s", pa.float64()), ("centreline_m", pa.list_(pa.float32())), ("director", pa.list_(pa.float32()))]
)


class TableWriter:
    """Rows of one schema into `DIR/NAME.arrow` while running, `DIR/NAME.parquet` when closed."""

    def __init__(self, run_dir: Path, name: str, schema: pa.Schema, flush_rows: int = FLUSH_ROWS) -> None:
        self._flush_rows = flush_rows
        self._stream_path, self._path = run_dir / f"{name}.arrow", run_dir / f"{name}.parquet"
        self._schema = schema
        self._rows: list[dict[str, Any]] = []
        try:
            self._path.unlink(missing_ok=True)  # of an earlier run in this folder
            self._file = open(self._stream_path, "wb")  # noqa: SIM115
        except OSError as error:
            raise InputError(f"{run_dir}: cannot be written: {error.strerror}; choose another --out") from None
        self._stream = pa.ipc.new_stream(self._file, schema)

    def add(self, row: dict[str, Any]) -> None:
        """One more row; on disk within `flush_rows` rows. Raises SimulationError when the disk is full."""
        self._rows.append(row)
        if len(self._rows) >= self._flush_rows:
            self._flush()

    def add_batch(self, batch: pa.RecordBatch) -> None:
        """Many rows, on disk at once. Raises SimulationError when the disk is full."""
        self._flush()
        self._write(batch)

    def _flush(self) -> None:
        if not self._rows:
            return
        self._write(pa.RecordBatch.from_pylist(self._rows, schema=self._schema))
        self._rows.clear()

    def _write(self, batch: pa.RecordBatch) -> None:
        try:
            self._stream.write_batch(batch)
            self._file.flush()
        except OSError as error:
            raise SimulationError(
                f"{self._stream_path}: cannot be written: {error.strerror or error}; free some space. "
                "What was recorded before is kept"
            ) from None

    def close(self) -> None:
        """Finish the stream and turn it into Parquet; the stream goes only when the Parquet file stands."""
        self._flush()
        self._stream.close()
        self._file.close()
        partial = self._path.with_suffix(".partial")
        try:
            pq.write_table(_read_stream(self._stream_path, self._schema), partial, compression="zstd")
            os.replace(partial, self._path)
        except OSError as error:
            partial.unlink(missing_ok=True)
            raise SimulationError(
                f"{self._path}: cannot be written: {error.strerror or error}; free some space. "
                f"The rows are kept in {self._stream_path.name}"
            ) from None
        self._stream_path.unlink()


def read_telemetry(run_dir: Path) -> pa.Table:
    """The telemetry of a run, finished or killed. Raises InputError when there is none."""
    return read_table(run_dir, "telemetry", TELEMETRY_SCHEMA)


def read_table(run_dir: Path, name: str, schema: pa.Schema) -> pa.Table:
    """`NAME.parquet` of a run directory, or the rows of `NAME.arrow` if the run was killed."""
    path, stream = run_dir / f"{name}.parquet", run_dir / f"{name}.arrow"
    if stream.exists() and not path.exists():
        return _read_stream(stream, schema)
    try:
        return pq.read_table(path)
    except FileNotFoundError:
        raise InputError(f"{run_dir}: holds no {path.name}; is it a run directory?") from None
    except (OSError, pa.ArrowInvalid) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None


def _read_stream(path: Path, schema: pa.Schema) -> pa.Table:
    batches = []
    with pa.OSFile(str(path)) as source:
        try:
            for batch in pa.ipc.open_stream(source):
                batches.append(batch)
        except (pa.ArrowInvalid, OSError, EOFError):
            pass  # the writer was killed in the middle of a batch: what came before is whole
    return pa.Table.from_batches(batches, schema=schema)
