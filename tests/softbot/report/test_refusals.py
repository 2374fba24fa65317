"""Run folders that are damaged, missing or make no sense."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from softbot.errors import InputError
from softbot.report import write_report


@pytest.mark.parametrize("name", ["summary.json", "scene.toml", "telemetry.parquet", "shape.parquet"])
@pytest.mark.parametrize("damage", ["missing", "half", "empty", "noise"])
def test_a_missing_or_damaged_file_is_named(runs: Any, tmp_path: Path, name: str, damage: str) -> None:
    path = runs.write_run(tmp_path / "run") / name
    if damage == "missing":
        path.unlink()
    else:
        whole = path.read_bytes()
        # Half a line of TOML is cut inside a value: half of a whole file may still be valid.
        half = b"[robot]\nlength_m = " if name == "scene.toml" else whole[: len(whole) // 2]
        path.write_bytes({"half": half, "empty": b"", "noise": b"\xff\x00\xfe" * 50}[damage])
    with pytest.raises(InputError, match=re.escape(str(path))):
        write_report(path.parent)
    assert not (path.parent / "report.html").exists()


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such run directory"):
        write_report(tmp_path / "nowhere")


def test_a_summary_that_is_no_object_is_refused(runs: Any, tmp_path: Path) -> None:
    run_dir = runs.write_run(tmp_path / "run")
    (run_dir / "summary.json").write_text("[1, 2]", encoding="utf-8")
    with pytest.raises(InputError, match="no JSON object"):
        write_report(run_dir)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda table: table.drop_columns(["roll_rad"]), "column roll_rad missing"),
        (lambda table: table.slice(0, 0), "no rows"),
        (lambda table: table.take(list(range(table.num_rows))[::-1]), "t_s must be finite and increase"),
        (
            lambda table: table.set_column(
                table.schema.get_field_index("com_x_m"), "com_x_m", pa.array([math.nan] * table.num_rows)
            ),
            "com_x_m holds no numbers",
        ),
    ],
)
def test_telemetry_that_makes_no_sense_is_refused(runs: Any, tmp_path: Path, change: Any, message: str) -> None:
    path = runs.write_run(tmp_path / "run") / "telemetry.parquet"
    parquet.write_table(change(parquet.read_table(path)), path)
    with pytest.raises(InputError, match=message):
        write_report(path.parent)


LINE_m = np.linspace([0.0, 0.0, 0.01], [0.1, 0.0, 0.01], 5)
UP = np.tile([0.0, 0.0, 1.0], (5, 1))


@pytest.mark.parametrize(
    ("lines_m", "directors", "radius", "message"),
    [
        ([LINE_m] * 2, [UP] * 2, None, "radius_m"),
        ([LINE_m] * 2, [UP] * 2, b"thick", "radius_m"),
        ([LINE_m] * 2, [UP] * 2, b"-1", "radius_m"),
        ([LINE_m] * 2, [UP[:3]] * 2, b"0.01", "differ in nodes"),
        ([LINE_m, LINE_m[:3]], [UP] * 2, b"0.01", "centreline_m must list"),
        ([LINE_m[:1]] * 2, [UP[:1]] * 2, b"0.01", "two nodes or more"),
        ([LINE_m * math.nan] * 2, [UP] * 2, b"0.01", "no frame has finite positions"),
    ],
)
def test_shapes_that_make_no_sense_are_refused(
    runs: Any, tmp_path: Path, lines_m: list[Any], directors: list[Any], radius: bytes | None, message: str
) -> None:
    run_dir = runs.write_run(tmp_path / "run")
    runs.write_shapes(run_dir / "shape.parquet", [0.0, 0.1], lines_m, directors, radius)
    with pytest.raises(InputError, match=message):
        write_report(run_dir)


def test_shapes_of_another_kind_are_refused(runs: Any, tmp_path: Path) -> None:
    run_dir = runs.write_run(tmp_path / "run")
    for columns, message in (
        ({"t_s": [0.0, 0.1], "director": [[0.0] * 6] * 2}, "column centreline_m missing"),
        ({"t_s": [0.0, 0.1], "centreline_m": [1.0, 2.0], "director": [1.0, 2.0]}, "centreline_m must list"),
    ):
        table = pa.table(columns).replace_schema_metadata({b"radius_m": b"0.01"})
        parquet.write_table(table, run_dir / "shape.parquet")
        with pytest.raises(InputError, match=message):
            write_report(run_dir)


def test_a_page_that_cannot_be_written_is_an_input_error(runs: Any, tmp_path: Path) -> None:
    run_dir = runs.write_run(tmp_path / "run")
    (run_dir / "report.html").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        write_report(run_dir)
