"""A campaign's results are the same bytes whatever happened on the way to them."""

from __future__ import annotations

import json
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from softbot.campaign.campaign import Draws
from softbot.campaign.execution import CAMPAIGN_FILE, ROWS_FILE, Rows, campaign_in, carry_out, read_results, run_row
from softbot.campaign.page import write_page
from softbot.campaign.statistics import Tally, lines, statistics
from softbot.errors import InputError

Make = Callable[..., Draws]
COMMAND = [sys.executable, "-c", "from softbot.cli import main; main()", "campaign"]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Filled by the first test that asks: the folder of the short campaign, carried out in one go."""
    return []


@pytest.fixture
def whole(make_draws: Make, undisturbed: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the short campaign, carried out in one go."""
    if not undisturbed:
        folder = tmp_path_factory.mktemp("whole")
        carry_out(make_draws(), folder, processes=1)
        undisturbed.append(folder)
    return undisturbed[0]


def results(folder: Path) -> bytes:
    return (folder / "results.parquet").read_bytes()


def test_a_row_follows_from_the_campaign_and_the_number(make_draws: Make, whole: Path) -> None:
    rows = [json.loads(line[9:]) for line in (whole / ROWS_FILE).read_text().splitlines()]
    kept = {row["run"]: row for row in rows}
    assert run_row(make_draws(), 5) == kept[5]


def test_results_hold_every_run_once_in_order(whole: Path) -> None:
    table = read_results(whole)
    assert table.column("run").to_pylist() == list(range(8))
    assert set(table.column("outcome").to_pylist()) == {"done"}
    assert {"drawn.world.friction", "drawn.mismatch.robot.actuator.modulus_Pa"} <= set(table.column_names)


class Enough(Exception):
    """Ends a campaign in the middle."""


def test_a_campaign_that_was_stopped_goes_on_and_ends_with_the_same_bytes(
    make_draws: Make, whole: Path, tmp_path: Path
) -> None:
    folder, made = tmp_path / "stopped", []

    def stop(row: dict[str, Any]) -> None:
        made.append(row["run"])
        if len(made) in (3, 5):
            raise Enough

    for _ in range(2):
        with pytest.raises(Enough):
            carry_out(make_draws(), folder, processes=1, told=stop)
    begun: list[int] = []
    carry_out(make_draws(), folder, processes=1, told=stop, begun=begun.append)
    assert begun == [5]
    assert sorted(made) == list(range(8))  # none twice, none lost
    assert results(folder) == results(whole)


@pytest.mark.parametrize("harm", ["torn", "garbled", "empty"])
def test_a_row_that_was_being_written_is_made_again(make_draws: Make, whole: Path, tmp_path: Path, harm: str) -> None:
    folder = tmp_path / "killed"
    shutil.copytree(whole, folder)
    (folder / "results.parquet").unlink()
    rows = (folder / ROWS_FILE).read_bytes().splitlines(keepends=True)
    last = {"torn": rows[6][:-20], "garbled": rows[6].replace(b"0", b"1", 3), "empty": b"\n"}[harm]
    (folder / ROWS_FILE).write_bytes(b"".join(rows[:6]) + last)
    made: list[int] = []
    carry_out(make_draws(), folder, processes=1, told=lambda row: made.append(row["run"]))
    assert len(made) == 2
    assert results(folder) == results(whole)


def test_a_row_that_was_damaged_costs_its_own_run_only(make_draws: Make, whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "damaged"
    shutil.copytree(whole, folder)
    rows = (folder / ROWS_FILE).read_bytes().splitlines(keepends=True)
    rows[2] = rows[2].replace(b"0", b"1", 3)
    (folder / ROWS_FILE).write_bytes(b"".join(rows))
    for again in ([2], []):
        made: list[int] = []
        (folder / "results.parquet").unlink()
        carry_out(make_draws(), folder, processes=1, told=lambda row, made=made: made.append(row["run"]))  # type: ignore[misc]
        assert results(folder) == results(whole)
        assert made == again


def test_a_campaign_can_be_made_longer(make_draws: Make, whole: Path, tmp_path: Path) -> None:
    folder, made = tmp_path / "longer", []
    carry_out(make_draws("runs=6"), folder, processes=1)
    carry_out(make_draws(), folder, processes=1, told=lambda row: made.append(row["run"]))
    assert made == [6, 7]
    assert results(folder) == results(whole)


def test_the_folder_of_another_campaign_is_left_alone(make_draws: Make, whole: Path, tmp_path: Path) -> None:
    before = sorted((path.name, path.read_bytes()) for path in whole.iterdir())
    with pytest.raises(InputError, match="another campaign"):
        carry_out(make_draws("seed=4"), whole, processes=1)
    assert sorted((path.name, path.read_bytes()) for path in whole.iterdir()) == before
    (tmp_path / "diary").mkdir()
    (tmp_path / "diary" / "monday.txt").write_text("rain")
    with pytest.raises(InputError, match="is a file; name a folder"):
        carry_out(make_draws(), tmp_path / "diary" / "monday.txt", processes=1)
    with pytest.raises(InputError, match="no campaign"):
        carry_out(make_draws(), tmp_path / "diary", processes=1)


def test_two_at_once_in_one_folder_is_refused(make_draws: Make, whole: Path) -> None:
    with Rows(whole), pytest.raises(InputError, match="at work"):
        carry_out(make_draws(), whole, processes=1)


def test_a_folder_is_a_campaign_again(make_draws: Make, whole: Path) -> None:
    again = campaign_in(whole)
    assert again.run(3).scene == make_draws().run(3).scene
    assert (whole / CAMPAIGN_FILE).exists()


def test_a_run_that_fails_is_a_row_and_the_others_go_on(make_draws: Make, tmp_path: Path) -> None:
    weak = {"name": "crushed", "vary": {"robot.actuator.modulus_Pa": 2.0e3}}  # the wall cannot carry its pressure
    draws = make_draws(runs=2, case=[weak], mismatch={}, vary={})
    table = carry_out(draws, tmp_path / "failed", processes=1)
    assert table.num_rows == 2
    outcomes = table.column("outcome").to_pylist()
    assert all(outcome == "done" or outcome.startswith("failed: ") for outcome in outcomes)
    found = statistics(table)
    assert found["failed_runs"] == sum(outcome != "done" for outcome in outcomes)


def test_the_report_shows_what_the_table_holds(make_draws: Make, whole: Path, tmp_path: Path) -> None:
    table = read_results(whole)
    found = statistics(table)
    single = [i for i, faults in enumerate(table.column("faults").to_pylist()) if faults == 1]
    assert found["single"]["runs"] == len(single)
    detected = [bool(table.column("fault_0_detected")[i].as_py()) for i in single]
    assert found["single"]["detected"] == pytest.approx(sum(detected) / len(single))
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    page = write_page(make_draws(), table, found, tmp_path).read_text(encoding="utf-8")
    assert "rupture" in page
    assert "--replay" in page
    assert "http" not in page.replace("http://www.w3.org", "")  # needs nothing from elsewhere
    assert any(name == "runs" for name, _ in lines(found))
    tally = Tally()
    for row in table.to_pylist():
        tally.add(row)
    assert f"/{len(single)} faults found" in tally.words()


MANY = 120


@pytest.fixture
def many(make_draws: Make, tmp_path: Path) -> bytes:
    """What a campaign of many runs ends with when nothing disturbs it."""
    carry_out(make_draws(runs=MANY), tmp_path / "undisturbed")
    return results(tmp_path / "undisturbed")


def rows_in(folder: Path) -> int:
    path = folder / ROWS_FILE
    return path.read_bytes().count(b"\n") if path.exists() else 0


@pytest.mark.slow
def test_a_campaign_killed_ten_times_at_random_ends_with_the_same_bytes(
    make_draws: Make, many: bytes, tmp_path: Path
) -> None:
    make_draws(runs=MANY)  # writes short.toml
    folder, chance = tmp_path / "often-killed", random.Random(5)
    command = [*COMMAND, str(tmp_path / "short.toml"), "--out", str(folder), "--json"]
    kept = [0]
    for kill in range(10):
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        # now and then while it starts, else in the middle of its work: at a row of its choice, and a moment later
        wanted = -1 if kill in (2, 6) else kept[-1] + chance.randint(1, MANY // 12)
        deadline_s = time.monotonic() + 120.0
        while rows_in(folder) < wanted and process.poll() is None and time.monotonic() < deadline_s:
            time.sleep(0.002)
        time.sleep(chance.uniform(0.0, 0.1))
        process.send_signal(signal.SIGKILL)
        process.wait()
        kept.append(rows_in(folder))
    assert kept == sorted(kept)  # nothing is lost
    assert len(set(kept)) > 5  # they were killed at work
    assert kept[-1] < MANY
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert results(folder) == many
    assert json.loads(done.stdout)["runs"] == MANY


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_in_mid_run_gives_the_same_bytes(
    make_draws: Make, many: bytes, tmp_path: Path
) -> None:
    import distributed

    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        busy: list[int] = []

        def kill_one_at_work(row: dict[str, Any]) -> None:
            if not busy:
                at_work = [name for name, tasks in client.processing().items() if tasks]
                worker = next(one for one in cluster.workers.values() if one.worker_address in at_work)
                busy.append(len(at_work))
                worker.process.process.kill()

        carry_out(
            make_draws(runs=MANY), tmp_path / "cluster", scheduler=cluster.scheduler_address, told=kill_one_at_work
        )
    assert busy
    assert results(tmp_path / "cluster") == many
