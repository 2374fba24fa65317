"""Whether a fault matters follows from two runs that differ in nothing but the fault, and answer nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim.recorder import samples_of
from sim.scene import Scene, scene_from
from softbot.campaign.campaign import Draws
from softbot.campaign.consequence import compared, consequence
from softbot.campaign.execution import carry_out, read_results, run_row
from softbot.campaign.outcome import ordered_turns
from softbot.campaign.page import page
from softbot.campaign.statistics import lines, statistics
from softbot.nodes.direct import TRACE, DirectRun

Make = Callable[..., Draws]
LIMIT_Pa = 150e3
AT_S = 3.0


def scene_of(*faults: dict[str, Any], command: str = "left", duration_s: float = 7.0, **sequencer: Any) -> Scene:
    table = {
        "robot": "default",
        "drive": {"kind": "sequencer"},
        "sequencer": {"command": command, "speed_rev_s": 0.5, "start_s": 0.1, **sequencer},
        "fault": list(faults),
        "solver": {"twin": "rod", "accuracy": "fast", "duration_s": duration_s},
    }
    return scene_from(table, "consequence.toml", Path())


def trace_of(rate_rev_s: float, pressure_Pa: float = 90e3, before_rev_s: float = 0.5) -> Any:
    """Rolls to the left at one rate and, from AT_S on, at another."""
    t_s = 0.01 * (1 + np.arange(1000))
    trace = np.zeros((len(t_s), len(TRACE)))
    trace[:, 0] = t_s
    rate = np.where(t_s < AT_S, before_rev_s, rate_rev_s)
    trace[:, TRACE.index("roll_rad")] = -2.0 * math.pi * np.cumsum(rate) * 0.01
    trace[:, TRACE.index("pressure_1_Pa")] = np.where(t_s < AT_S, 2.0 * LIMIT_Pa, pressure_Pa)
    return trace


@pytest.mark.parametrize(
    ("rate_rev_s", "pressure_Pa", "matters"),
    [
        (0.5, 90e3, False),
        (0.46, 90e3, False),
        (0.44, 90e3, True),
        (0.0, 90e3, True),
        (-0.5, 90e3, True),
        (0.6, 90e3, False),
        (0.5, 0.99 * LIMIT_Pa, False),
        (0.5, 1.01 * LIMIT_Pa, True),
    ],
)
def test_a_fault_matters_that_costs_a_tenth_of_the_speed_or_takes_a_chamber_over_its_limit(
    rate_rev_s: float, pressure_Pa: float, matters: bool
) -> None:
    row = compared(scene_of(), trace_of(0.5), trace_of(rate_rev_s, pressure_Pa), AT_S, LIMIT_Pa)
    assert row["matters"] is matters
    assert row["rate_without_fault_rev_s"] == pytest.approx(0.5)
    assert row["rate_unanswered_rev_s"] == pytest.approx(rate_rev_s, abs=1e-9)
    assert row["pressure_unanswered_share"] == pytest.approx(pressure_Pa / LIMIT_Pa)


def test_a_pressure_that_is_there_without_the_fault_is_not_its_doing() -> None:
    high = trace_of(0.5, 1.2 * LIMIT_Pa)
    assert compared(scene_of(), high, high, AT_S, LIMIT_Pa)["matters"] is False


def test_a_fault_after_the_end_is_not_decided() -> None:
    assert compared(scene_of(), trace_of(0.5), trace_of(0.5), 60.0, LIMIT_Pa)["matters"] is None


def test_only_single_faults_are_judged() -> None:
    one = {"t_s": 1.0, "chamber": 0, "kind": "leak"}
    assert consequence(scene_of()) == {}
    assert consequence(scene_of(one, one | {"chamber": 1})) == {}


@pytest.mark.parametrize(
    "fault",
    [
        {"kind": "rupture", "chamber": 1},
        {"kind": "stuck_closed", "chamber": 2},
        {"kind": "sensor_noise", "chamber": 0},
        {"kind": "sensor_stuck", "chamber": 3},
        {"kind": "sensor_dropout", "chamber": 1},
        {"kind": "imu_dropout"},
        {"kind": "supply_loss"},
    ],
)
def test_a_sequencer_without_detection_names_and_answers_nothing(fault: dict[str, Any]) -> None:
    scene = scene_of({"t_s": AT_S} | fault, duration_s=6.0, detection=False)
    run = DirectRun(scene)
    run.advance(samples_of(scene))
    assert (run.detections(), run.recoveries()) == ([], [])
    answered = DirectRun(scene_of({"t_s": AT_S} | fault, duration_s=6.0))
    answered.advance(samples_of(scene))
    assert answered.detections()


def test_both_runs_are_the_same_to_the_last_bit_until_the_fault_strikes() -> None:
    torn = {"t_s": AT_S, "chamber": 1, "kind": "rupture"}
    scenes = (scene_of(detection=False), scene_of(torn, detection=False))
    traces = [DirectRun(scene).advance(samples_of(scene)).trace for scene in scenes]
    before = traces[0][:, 0] < AT_S
    np.testing.assert_array_equal(traces[0][before], traces[1][before])
    assert not np.array_equal(traces[0], traces[1])


def test_a_torn_chamber_matters_and_a_slight_drift_does_not() -> None:
    torn = consequence(scene_of({"t_s": AT_S, "chamber": 1, "kind": "rupture"}))
    drifts = consequence(scene_of({"t_s": AT_S, "chamber": 1, "kind": "sensor_drift", "severity": 0.1}))
    assert torn["matters"] is True
    assert torn["rate_unanswered_rev_s"] < 0.5 * torn["rate_without_fault_rev_s"]
    assert drifts["matters"] is False
    assert torn["rate_without_fault_rev_s"] == drifts["rate_without_fault_rev_s"]


@pytest.mark.parametrize("command", ["left", "right"])
def test_a_chamber_filled_to_the_supplys_pressure_is_endangered(command: str) -> None:
    row = consequence(scene_of({"t_s": AT_S, "chamber": 0, "kind": "stuck_open"}, command=command))
    assert row["pressure_unanswered_share"] > 1.0 > row["pressure_without_fault_share"]
    assert row["matters"] is True


def test_the_reference_rolls_as_the_run_does_before_its_fault() -> None:
    scene = scene_of(command="right")
    trace = DirectRun(scene).advance(samples_of(scene)).trace
    after = trace[:, 0] >= AT_S
    turns = ordered_turns(scene, trace)[after]
    row = consequence(scene_of({"t_s": AT_S, "chamber": 0, "kind": "leak", "severity": 0.1}, command="right"))
    assert row["rate_without_fault_rev_s"] == pytest.approx((turns[-1] - turns[0]) / 4.0, rel=0.01)


def test_a_campaign_tells_the_rates_of_those_that_matter(make_draws: Make, tmp_path: Path) -> None:
    drawn = make_draws("matters=true", runs=6)
    table = carry_out(drawn, tmp_path / "judged", processes=1)
    columns = {name: table.column(name).to_pylist() for name in table.column_names}
    single = [n for n, faults in enumerate(columns["faults"]) if faults == 1]
    assert single
    assert all((columns["matters"][n] is not None) == (n in single) for n in range(6))
    found = statistics(table)["that_matter"]
    assert found["judged"] == len(single)
    assert found["single"]["runs"] == sum(bool(columns["matters"][n]) for n in single)
    assert "that matter" in [name.strip() for name, _ in lines(statistics(table))]
    assert "Of these, those that matter" in page(drawn, table, statistics(table), tmp_path)
    again = run_row(make_draws("matters=true", runs=6), single[0])  # it follows from the number alone
    assert again["rate_unanswered_rev_s"] == columns["rate_unanswered_rev_s"][single[0]]
    plain = statistics(carry_out(make_draws(runs=6), tmp_path / "plain", processes=1))
    assert plain["that_matter"]["judged"] == 0
    assert plain["single"]["named_right"] == statistics(table)["single"]["named_right"]
    assert "that matter" not in [name.strip() for name, _ in lines(plain)]
    assert read_results(tmp_path / "plain").column("matters").null_count == 6
