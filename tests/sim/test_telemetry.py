"""Telemetry on disk: whole when finished, readable when killed, one file or the other."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from sim import telemetry
from sim.telemetry import FLUSH_ROWS, SHAPE_SCHEMA, TELEMETRY_SCHEMA, TableWriter, read_table, read_telemetry
from softbot.errors import InputError, SimulationError


def row(n: int) -> dict[str, Any]:
    values = {field.name: float(n) for field in TELEMETRY_SCHEMA if field.type == pa.float64()}
    return {**values, "state": f"state {n}", "c_bend_side": n % 3 - 1}


def write(folder: Path, rows: int, *, close: bool = True) -> TableWriter:
    writer = TableWriter(folder, "telemetry", TELEMETRY_SCHEMA)
    for n in range(rows):
        writer.add(row(n))
    if close:
        writer.close()
    return writer


@pytest.mark.parametrize("rows", [0, 1, FLUSH_ROWS - 1, FLUSH_ROWS, 3 * FLUSH_ROWS + 7])
def test_finished_run_leaves_every_row_in_parquet_and_no_stream(tmp_path: Path, rows: int) -> None:
    write(tmp_path, rows)
    assert [entry.name for entry in tmp_path.iterdir()] == ["telemetry.parquet"]
    table = read_telemetry(tmp_path)
    assert table.schema.equals(TELEMETRY_SCHEMA)
    assert table.to_pylist() == [row(n) for n in range(rows)]


def test_rows_are_on_disk_while_the_run_goes_on(tmp_path: Path) -> None:
    writer = write(tmp_path, 2 * FLUSH_ROWS + 3, close=False)
    assert not (tmp_path / "telemetry.parquet").exists()
    assert read_telemetry(tmp_path).num_rows == 2 * FLUSH_ROWS
    writer.close()
    assert read_telemetry(tmp_path).num_rows == 2 * FLUSH_ROWS + 3


def test_batches_are_on_disk_at_once_and_in_the_order_of_the_rows_before(tmp_path: Path) -> None:
    writer = write(tmp_path, 3, close=False)
    writer.add_batch(pa.RecordBatch.from_pylist([row(n) for n in range(3, 8)], schema=TELEMETRY_SCHEMA))
    assert read_telemetry(tmp_path).num_rows == 8
    writer.add(row(8))
    writer.close()
    assert read_telemetry(tmp_path).to_pylist() == [row(n) for n in range(9)]


@pytest.fixture(scope="module")
def stream_bytes(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    folder = tmp_path_factory.mktemp("stream")
    writer = write(folder, 3 * FLUSH_ROWS, close=False)
    whole = (folder / "telemetry.arrow").read_bytes()
    writer.close()
    return whole


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0.0, 1.0))
@example(share=0.0)
@example(share=1.0)
def test_stream_cut_at_any_byte_gives_the_rows_that_were_whole(
    tmp_path: Path, stream_bytes: bytes, share: float
) -> None:
    cut = round(share * len(stream_bytes))
    (tmp_path / "telemetry.arrow").write_bytes(stream_bytes[:cut])
    table = read_telemetry(tmp_path)
    assert table.schema.equals(TELEMETRY_SCHEMA)
    assert table.num_rows % FLUSH_ROWS == 0
    assert table.to_pylist() == [row(n) for n in range(table.num_rows)]
    if cut == len(stream_bytes):
        assert table.num_rows == 3 * FLUSH_ROWS
    if share > 0.75:
        assert table.num_rows >= FLUSH_ROWS


def test_new_run_in_a_folder_puts_the_old_rows_away_at_once(tmp_path: Path) -> None:
    write(tmp_path, 5)
    writer = write(tmp_path, 0, close=False)
    assert read_telemetry(tmp_path).num_rows == 0  # not the five of the run before
    writer.close()


def test_folder_without_a_run_and_file_that_is_no_parquet_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds no telemetry\.parquet; is it a run directory"):
        read_telemetry(tmp_path)
    (tmp_path / "telemetry.parquet").write_bytes(b"not parquet at all")
    with pytest.raises(InputError, match="cannot be read"):
        read_telemetry(tmp_path)


def test_folder_that_cannot_be_written_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot be written: .*; choose another --out"):
        TableWriter(tmp_path / "missing", "telemetry", TELEMETRY_SCHEMA)


def test_full_disk_is_said_and_keeps_what_was_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = write(tmp_path, 2 * FLUSH_ROWS, close=False)

    class FullDisk:
        def __init__(self, stream: Any) -> None:
            self._stream = stream

        def write_batch(self, _: pa.RecordBatch) -> None:
            raise OSError(28, "No space left on device")

        def close(self) -> None:
            self._stream.close()

    monkeypatch.setattr(writer, "_stream", FullDisk(writer._stream))
    for n in range(FLUSH_ROWS - 1):
        writer.add(row(n))
    with pytest.raises(SimulationError, match="No space left on device; free some space"):
        writer.add(row(FLUSH_ROWS))
    with pytest.raises(SimulationError, match="free some space"):
        writer.add_batch(pa.RecordBatch.from_pylist([row(0)], schema=TELEMETRY_SCHEMA))
    assert read_telemetry(tmp_path).num_rows == 2 * FLUSH_ROWS
    monkeypatch.undo()
    writer.close()


@pytest.mark.parametrize("fails", ["write_table", "replace"])
def test_parquet_that_cannot_be_written_leaves_the_stream(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    writer = write(tmp_path, FLUSH_ROWS + 4, close=False)

    def refuse(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq if fails == "write_table" else os, fails, refuse)
    with pytest.raises(SimulationError, match=r"the rows are kept in telemetry\.arrow|The rows are kept"):
        writer.close()
    assert [entry.name for entry in tmp_path.iterdir()] == ["telemetry.arrow"]
    assert read_telemetry(tmp_path).num_rows == FLUSH_ROWS + 4


def test_shapes_keep_their_lists_and_the_radius(tmp_path: Path) -> None:
    schema = SHAPE_SCHEMA.with_metadata({b"radius_m": b"0.01"})
    writer = TableWriter(tmp_path, "shape", schema)
    writer.add({"t_s": 0.5, "centreline_m": [0.0, 1.0, 2.0], "director": [0.0, 1.0, 0.0]})
    writer.close()
    table = read_table(tmp_path, "shape", SHAPE_SCHEMA)
    assert table.to_pylist() == [{"t_s": 0.5, "centreline_m": [0.0, 1.0, 2.0], "director": [0.0, 1.0, 0.0]}]
    assert table.schema.metadata[b"radius_m"] == b"0.01"


def test_columns_are_those_that_other_programs_rely_on() -> None:
    design = ["t_s", *(f"pressure_{i}_Pa" for i in range(4)), *(f"command_{i}_Pa" for i in range(4)), "roll_rad",
              "com_x_m", "com_y_m", "com_z_m", "bend_rad", "bend_direction_rad", "length_m", "theta_rad", "state",
              "c_bend_side"]  # fmt: skip
    assert telemetry.TELEMETRY_SCHEMA.names[: len(design)] == design
