"""The row of a run says what its trace and its events say."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from controllers.interface import STATES, Detection, SequencerState
from sim.scene import Scene, scene_from
from softbot.campaign.outcome import OUTCOME_SCHEMA, Seen, longest_still_s, mean_rate, outcome
from softbot.campaign.statistics import lines, statistics
from softbot.nodes.direct import TRACE

STEP_S = 0.01


def scene_of(*faults: dict[str, Any], command: str = "left") -> Scene:
    table = {
        "robot": "default",
        "drive": {"kind": "sequencer"},
        "sequencer": {"command": command, "speed_rev_s": 0.5},
        "fault": list(faults),
    }
    return scene_from(table, "seen.toml", Path())


def trace_of(rate_rev_s: Any, duration_s: float = 20.0, sign: float = -1.0) -> np.ndarray:
    """A trace whose roll goes at rate_rev_s(t), to the left with sign −1."""
    t_s = STEP_S * (1 + np.arange(round(duration_s / STEP_S)))
    trace = np.zeros((len(t_s), len(TRACE)))
    trace[:, 0] = t_s
    rate = np.array([rate_rev_s(t) for t in t_s])
    trace[:, TRACE.index("roll_rad")] = sign * 2.0 * math.pi * np.cumsum(rate) * STEP_S
    trace[:, TRACE.index("state")] = STATES.index(SequencerState.ROLLING)
    trace[:, TRACE.index("pressure_2_Pa")] = 90e3
    return trace


RUPTURE = {"t_s": 10.0, "chamber": 2, "kind": "rupture"}


def test_speed_before_and_after_a_fault() -> None:
    trace = trace_of(lambda t: 0.5 if t < 10.0 else 0.3)
    row = outcome(Seen(scene_of(RUPTURE), trace, [], [], 150e3))
    assert row["rate_before_rev_s"] == pytest.approx(0.5, rel=2e-3)
    assert row["rate_after_rev_s"] == pytest.approx(0.3, rel=2e-3)
    assert row["highest_pressure_share"] == pytest.approx(0.6)
    assert set(row) <= set(OUTCOME_SCHEMA.names)


@pytest.mark.parametrize(("command", "sign"), [("left", 1.0), ("right", -1.0)])
def test_rolling_the_wrong_way_is_a_negative_rate(command: str, sign: float) -> None:
    row = outcome(Seen(scene_of(command=command), trace_of(lambda t: 0.4, sign=sign), [], [], 150e3))
    assert row["rate_before_rev_s"] == pytest.approx(-0.4, rel=2e-3)
    assert row["rate_after_rev_s"] is None


def test_a_rate_that_ripples_is_taken_over_whole_revolutions() -> None:
    t_s = STEP_S * np.arange(2000)
    rolled = 0.31 * t_s + 0.2 * np.sin(2 * math.pi * 0.31 * t_s)  # a ripple once a revolution
    assert mean_rate(t_s, rolled, 3.0, math.inf) == pytest.approx(0.31, rel=0.003)
    plain = (rolled[-1] - rolled[300]) / (t_s[-1] - t_s[300])
    assert abs(plain - 0.31) > 0.003


def test_the_longest_stand_still_is_found() -> None:
    trace = trace_of(lambda t: 0.0 if 11.0 < t < 13.5 else 0.5)
    t_s, rolled = trace[:, 0], -trace[:, TRACE.index("roll_rad")] / (2 * math.pi)
    assert longest_still_s(t_s, rolled, 10.0) == pytest.approx(2.5, abs=0.25)
    assert longest_still_s(t_s, rolled, 14.0) == 0.0


def found(*verdicts: tuple[float, int, str]) -> list[Detection]:
    return [Detection(t_s, chamber, kind, 0.9) for t_s, chamber, kind in verdicts]


@pytest.mark.parametrize(
    ("verdicts", "expected"),
    [
        ((), {"fault_0_detected": False, "false_alarms": 0}),
        (((10.2, 2, "rupture"),), {"fault_0_delay_s": 0.2, "fault_0_named_right": True, "false_alarms": 0}),
        (((10.2, 2, "leak"), (10.6, 2, "rupture")), {"fault_0_delay_s": 0.2, "fault_0_named_right": True}),
        (((10.2, 2, "leak"),), {"fault_0_detected": True, "fault_0_named_right": False, "false_alarms": 0}),
        (((10.2, 1, "rupture"),), {"fault_0_named_right": False, "false_alarms": 1, "false_alarms_beside": 1}),
        (((9.0, 2, "rupture"),), {"fault_0_detected": False, "false_alarms": 1, "false_alarms_beside": 0}),
    ],
)
def test_verdicts_are_matched_to_the_fault(verdicts: Any, expected: dict[str, Any]) -> None:
    row = outcome(Seen(scene_of(RUPTURE), trace_of(lambda t: 0.5), found(*verdicts), [], 150e3))
    for name, value in expected.items():
        assert row[name] == pytest.approx(value), name


def test_of_two_faults_each_has_its_own_verdicts() -> None:
    second = {"t_s": 12.0, "chamber": 0, "kind": "leak"}
    verdicts = found((10.3, 2, "rupture"), (12.5, 0, "leak"))
    row = outcome(Seen(scene_of(RUPTURE, second), trace_of(lambda t: 0.5), verdicts, [], 150e3))
    assert row["fault_0_delay_s"] == pytest.approx(0.3)
    assert row["fault_1_delay_s"] == pytest.approx(0.5)
    assert (row["fault_0_named_right"], row["fault_1_named_right"], row["false_alarms"]) == (True, True, 0)


def test_a_fault_that_is_not_one_chambers_is_found_by_a_verdict_without_one() -> None:
    supply = {"t_s": 10.0, "kind": "supply_loss"}
    row = outcome(Seen(scene_of(supply), trace_of(lambda t: 0.5), found((10.5, -1, "supply_loss")), [], 150e3))
    assert (row["fault_0_named_right"], row["false_alarms"]) == (True, 0)


def test_exchanged_lines_concern_two_chambers() -> None:
    swapped = {"t_s": 10.0, "chamber": 3, "kind": "lines_swapped"}
    for chamber, false_alarms in ((3, 0), (0, 0), (1, 1), (2, 1)):
        found = [Detection(10.2, chamber, "sensor_offset", 1.0)]
        row = outcome(Seen(scene_of(swapped), trace_of(lambda t: 0.5), found, [], 150e3))
        assert row["false_alarms"] == false_alarms


def test_time_counts_as_rolling_while_nothing_is_wrong_and_the_robot_is_under_way() -> None:
    trace = trace_of(lambda t: 0.5)
    trace[:200, TRACE.index("state")] = STATES.index(SequencerState.PRIMING)
    assert outcome(Seen(scene_of(RUPTURE), trace, [], [], 150e3))["rolling_s"] == pytest.approx(8.0, abs=0.02)
    trace[1500:, TRACE.index("state")] = STATES.index(SequencerState.SAFE)  # after a false alarm, say
    assert outcome(Seen(scene_of(), trace, [], [], 150e3))["rolling_s"] == pytest.approx(13.0, abs=0.02)


def test_false_alarms_are_counted_over_healthy_runs_and_the_time_before_faults() -> None:
    healthy, early = scene_of(), found((9.0, 2, "leak"))
    seen = [
        Seen(healthy, trace_of(lambda t: 0.5), early, [], 150e3),
        Seen(scene_of(RUPTURE), trace_of(lambda t: 0.5), early + found((10.2, 2, "rupture")), [], 150e3),
        Seen(scene_of(RUPTURE), trace_of(lambda t: 0.5), found((10.2, 2, "rupture"), (11.0, 1, "leak")), [], 150e3),
    ]
    rows = [{"run": n, "case": "c", **outcome(one)} for n, one in enumerate(seen)]
    columns = {field.name: pa.array([row.get(field.name) for row in rows], field.type) for field in OUTCOME_SCHEMA}
    counted = statistics(pa.table(columns))
    assert counted["hours_without_fault"] == pytest.approx(40.0 / 3600.0, rel=2e-3)
    assert counted["hours_of_healthy_runs"] == pytest.approx(20.0 / 3600.0, rel=2e-3)
    assert (counted["false_alarms"], counted["false_alarms_beside_a_fault"]) == (2, 1)
    assert counted["false_alarms_per_hour"] == pytest.approx(180.0, rel=2e-3)
    told = lines(counted)
    assert told[1][0] == "false alarms"
    assert told[1][1].startswith("2 in 0.01 h of rolling with nothing wrong")
    assert told[2] == ("false beside a fault", "1 on chambers that had none")


def test_a_robot_that_was_stopped_and_coasts_on_does_not_roll_on() -> None:
    stopped = trace_of(lambda t: 0.5)
    stopped[1100:, TRACE.index("state")] = STATES.index(SequencerState.SAFE)
    rows = [
        {"run": n, "case": "c", **outcome(Seen(scene_of(RUPTURE), trace, found((10.3, 2, "rupture")), [], 150e3))}
        for n, trace in enumerate((stopped, trace_of(lambda t: 0.5)))
    ]
    columns = {field.name: pa.array([row.get(field.name) for row in rows], field.type) for field in OUTCOME_SCHEMA}
    single = statistics(pa.table(columns))["single"]
    assert (single["rolls_on"], single["ended_safe"]) == (0.5, 0.5)
