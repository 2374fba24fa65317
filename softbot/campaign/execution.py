"""A campaign carried out: on this machine's cores or a Dask cluster, kept row by row, resumed after whatever ended it.

The folder of a campaign holds `campaign.toml`, as it was read; `rows.jsonl`, to which the row of every run is appended
as it ends, each with its checksum; and, once all are there, `results.parquet`, sorted by run. A run's row depends on
the campaign and its number alone, so a campaign that was killed and went on ends with the same bytes as any other.
"""

from __future__ import annotations

import fcntl
import functools
import hashlib
import json
import os
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from sim.run_many import run_many
from sim.scene import Scene
from softbot.campaign.campaign import Campaign, Draws
from softbot.campaign.outcome import OUTCOME_SCHEMA, Seen, outcome
from softbot.errors import InputError, SimulationError, SoftbotError
from softbot.interruption import raise_if_asked
from softbot.robot import Robot
from softbot.toml_file import check, read_toml, write_toml

CAMPAIGN_FILE, ROWS_FILE, RESULTS_FILE = "campaign.toml", "rows.jsonl", "results.parquet"

Told = Callable[[dict[str, Any]], None]
"""Told the row of each run as it ends."""


def run_row(draws: Draws, number: int) -> dict[str, Any]:
    """Make run `number` of a campaign: its row. A run that fails has a row too, with the reason as its outcome."""
    run = draws.run(number)
    row: dict[str, Any] = {"run": number, "case": run.case}
    try:
        row |= direct_row(run.scene, run.known)
        if draws.campaign.matters:
            from softbot.campaign.consequence import consequence

            row |= consequence(run.scene, run.known)
    except SimulationError as error:
        raise_if_asked()  # else what an interruption broke would count as a run that failed
        row["outcome"] = f"failed: {error}"
    row["drawn"] = json.dumps(run.values, sort_keys=True)
    return row


def direct_row(scene: Scene, known: Robot | None = None) -> dict[str, Any]:
    """Run a scene without a bus: what became of it. Raises SimulationError when it fails."""
    from sim.recorder import samples_of
    from softbot.nodes.direct import DirectRun

    direct = DirectRun(scene, known)
    trace = direct.advance(samples_of(scene)).trace
    limit_Pa = (known or scene.robot).pneumatics.max_chamber_pressure_Pa
    return outcome(Seen(scene, trace, direct.detections(), direct.recoveries(), limit_Pa))


def rows_here(campaign: Campaign, source: str, folder: str, number: int) -> dict[str, Any]:
    """`run_row` in a process that has only the campaign's tables: what a worker does."""
    return run_row(draws_here(campaign, source, folder), number)


def draws_here(campaign: Campaign, source: str, folder: str) -> Draws:
    """The draws of a campaign's tables, in a process that is asked for them again and again."""
    return _draws(campaign.model_dump_json(), source, folder)


@functools.lru_cache(maxsize=4)
def _draws(campaign: str, source: str, folder: str) -> Draws:
    return Draws(Campaign.model_validate_json(campaign), source, Path(folder))


class Rows:
    """The rows of a campaign that are on disk; further ones are appended. One process at a time holds them."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / ROWS_FILE
        self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._file)
            raise InputError(
                f"{folder}: another campaign is at work in it; wait for it, or name another --out"
            ) from None
        self.rows: dict[int, dict[str, Any]] = {}
        read = good = 0
        for line, row in _read(self._path):
            read += len(line)
            if row is not None:  # a line that was damaged since costs its own run only
                self.rows[row["run"]], good = row, read
        os.ftruncate(self._file, good)  # what a kill left half-written, and nothing else

    def append(self, row: dict[str, Any]) -> None:
        """Keep a row. It is on disk when this returns (but for a loss of power)."""
        text = json.dumps(row, sort_keys=True, allow_nan=False).encode()
        os.write(self._file, b"%08x %s\n" % (zlib.crc32(text), text))
        self.rows[row["run"]] = row

    def close(self) -> None:
        """Let another process have them."""
        os.close(self._file)

    def __enter__(self) -> Rows:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _read(path: Path) -> Iterator[tuple[bytes, dict[str, Any] | None]]:
    """Lines of a file of rows with their rows; None for one that is torn."""
    with path.open("rb") as lines:
        for line in lines:
            checksum, _, text = line.rstrip(b"\n").partition(b" ")
            whole = line.endswith(b"\n") and checksum == b"%08x" % zlib.crc32(text)
            yield line, json.loads(text) if whole else None


def open_campaign(draws: Draws, folder: Path) -> None:
    """Make the folder of a campaign, or see that it is this campaign's. Raises InputError when it is another's."""
    path = folder / CAMPAIGN_FILE
    table = campaign_table(draws.campaign)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--out {folder}: is a file; name a folder")
    if path.exists():
        before = read_toml(path)
        if _without_runs(before) != _without_runs(json.loads(json.dumps(table))):
            raise InputError(
                f"--out {folder}: holds the runs of another campaign (or of this one before it was changed); "
                "name another folder, or remove it"
            )
    elif folder.exists() and any(folder.iterdir()):
        raise InputError(
            f"--out {folder}: holds files and no campaign, so nothing is written there; name another folder"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}; choose another --out") from None
    write_toml(path, table)


def campaign_table(campaign: Campaign) -> dict[str, Any]:
    """A campaign as the tables of its file."""
    return campaign.model_dump(mode="json", exclude_none=True)


def _without_runs(table: dict[str, Any]) -> dict[str, Any]:
    """A campaign may be made longer: the runs that it has stay what they are."""
    return {key: value for key, value in table.items() if key != "runs"}


def carry_out(
    draws: Draws,
    folder: Path,
    *,
    processes: int | None = None,
    scheduler: str | None = None,
    told: Told = lambda row: None,
    begun: Callable[[int], None] = lambda done: None,
) -> pa.Table:
    """Make the runs of a campaign that are not there yet; its results, as they then stand in `results.parquet`.

    processes: default one a core. scheduler: address of a Dask scheduler, whose workers then make the runs. begun: told
    how many runs were there already. Raises InputError for a folder that is not this campaign's or is in use,
    SimulationError when a run ends in something unforeseen.
    """
    open_campaign(draws, folder)
    with Rows(folder) as rows:
        todo = [number for number in range(draws.campaign.runs) if number not in rows.rows]
        begun(draws.campaign.runs - len(todo))

        def keep(result: Any) -> None:
            if isinstance(result, SoftbotError):
                raise result
            rows.append(result)
            told(result)

        task = functools.partial(rows_here, draws.campaign, draws.source, str(draws.folder))
        if scheduler is not None:
            from softbot.campaign.dask_cluster import run_on_cluster

            run_on_cluster(scheduler, task, todo, keep)
        elif todo:
            run_many(todo, processes, run=task, each=keep)
        table = results_table(draws, [rows.rows[number] for number in range(draws.campaign.runs)])
        _write(table, folder / RESULTS_FILE)
    return table


def results_table(draws: Draws, rows: list[dict[str, Any]]) -> pa.Table:
    """Rows as a table: the columns that every campaign has, then one for each value that was drawn."""
    columns = {field.name: pa.array([row.get(field.name) for row in rows], field.type) for field in OUTCOME_SCHEMA}
    values = [json.loads(row["drawn"]) for row in rows]
    for key in draws.keys:
        columns[f"drawn.{key}"] = _column([value.get(key) for value in values])
    return pa.table(columns)


def _column(values: list[Any]) -> pa.Array:
    if all(isinstance(value, int | float | None) and not isinstance(value, bool) for value in values):
        return pa.array(values, pa.float64())
    if all(value is None or isinstance(value, list) for value in values):
        return pa.array(values, pa.list_(pa.float64()))
    return pa.array([None if value is None else str(value) for value in values], pa.string())


def _write(table: pa.Table, path: Path) -> None:
    partial = path.with_name(path.name + ".partial")
    pq.write_table(table, partial, compression="zstd")
    os.replace(partial, path)


def read_results(folder: Path) -> pa.Table:
    """The results of a campaign that has ended. Raises InputError when there are none."""
    path = folder / RESULTS_FILE
    try:
        return pq.read_table(path)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; the campaign has not ended: run it again to go on") from None
    except (OSError, pa.ArrowInvalid) as error:
        raise InputError(f"{path}: cannot be read as results of a campaign: {error}") from None


def results_digest(folder: Path) -> str:
    """SHA-256 of the results' file: the same for the same campaign, however it was carried out."""
    return hashlib.sha256((folder / RESULTS_FILE).read_bytes()).hexdigest()


def campaign_in(folder: Path) -> Draws:
    """The campaign whose folder this is."""
    path = folder / CAMPAIGN_FILE
    return Draws(check(Campaign, read_toml(path), str(path)), str(path), folder)
