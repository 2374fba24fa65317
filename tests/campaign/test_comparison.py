"""Runs made again another way: what counts as the same verdict."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from softbot.campaign.campaign import Draws
from softbot.campaign.comparison import Compared, Verdict, compare, summary_of, verdict_of
from softbot.errors import InputError

Make = Callable[..., Draws]
TORN = {
    "name": "torn",
    "fault": [{"kind": "rupture", "chamber": {"choose": [0, 1, 2, 3]}, "t_s": {"low": 1.0, "high": 1.2}}],
}


def row(*named: tuple[str, int] | None, false_alarms: int = 0) -> dict[str, Any]:
    columns: dict[str, Any] = {"faults": len(named), "false_alarms": false_alarms}
    for n, name in enumerate(named):
        columns |= {f"fault_{n}_detected": name is not None}
        if name is not None:
            columns |= {f"fault_{n}_named_kind": name[0], f"fault_{n}_named_chamber": name[1]}
    return columns


def test_a_verdict_is_what_each_fault_was_named_and_whether_there_was_a_false_alarm() -> None:
    assert verdict_of(row()) == Verdict((), False)
    assert verdict_of(row(("leak", 2), None)) == Verdict(("leak, 2", "missed"), False)
    assert verdict_of(row(("leak", 2))) != verdict_of(row(("leak", 1)))
    assert verdict_of(row(false_alarms=2)) == Verdict((), True)


def test_runs_that_failed_are_never_the_same() -> None:
    failed = Verdict((), False, "blew up")
    assert not Compared(0, "c", failed, failed, None, None).same
    assert not Compared(0, "c", Verdict((), False), failed, None, None).same


def test_the_summary_counts_the_same_and_lists_the_others() -> None:
    leak, missed = Verdict(("leak, 2",), False), Verdict(("missed",), False)
    seen = [
        Compared(0, "a", leak, leak, 0.5, 0.7),
        Compared(1, "b", leak, missed, 0.5, None),
        Compared(2, "c", leak, leak, 1.0, 1.0),
    ]
    found = summary_of(seen)
    assert (found["runs"], found["same"], found["same_share"]) == (3, 2, pytest.approx(2 / 3))
    assert found["found_later_median_s"] == pytest.approx(0.1)
    assert [(one["run"], one["again"]["named"]) for one in found["others"]] == [(1, ("missed",))]
    assert summary_of([])["same_share"] is None


def test_over_a_bus_the_verdicts_are_the_campaigns(make_draws: Make) -> None:
    told: list[int] = []
    found = compare(make_draws(case=[TORN]), [0, 3], processes=1, told=lambda one: told.append(one.run))
    assert told == [0, 3]
    assert all(one.same for one in found)
    assert all(len(one.campaign.named) == 1 for one in found)
    assert summary_of(found)["found_later_median_s"] == pytest.approx(0.0, abs=1e-9)


def test_what_the_other_twin_cannot_run_is_refused(make_draws: Make) -> None:
    with pytest.raises(InputError, match="twin"):
        compare(make_draws(), [0], twin="mujoco")
    with pytest.raises(InputError, match="CAN interface 'nonsense'"):
        compare(make_draws(), [0], transport=("nonsense", "vcan0"))


def test_processes_share_the_runs_and_change_nothing(make_draws: Make) -> None:
    draws = make_draws(case=[TORN])
    assert compare(draws, range(3), processes=2) == compare(draws, range(3), processes=1)


@pytest.mark.slow
def test_torn_chambers_are_named_alike_on_the_segment_twin(make_draws: Make) -> None:
    solver = {"accuracy": "fast", "duration_s": 4.0}
    scene = {"robot": "default", "drive": {"kind": "sequencer"}, "sequencer": {"start_s": 0.1}, "solver": solver}
    found = compare(make_draws(case=[TORN], scene=scene), range(4), twin="bullet")
    assert [one.run for one in found if not one.same] == []
    assert all(one.again.named[0].startswith("rupture") for one in found)
