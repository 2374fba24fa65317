"""The numbers that a run ends with on the terminal."""

from __future__ import annotations

from typing import Any

from softbot.cli.outcome import rows

SUMMARY: dict[str, Any] = {
    "revolutions": -4.25,
    "steady_span_s": 17.5,
    "displacement_m": [0.012, -0.25],
    "advance_per_revolution_m": 0.0589,
    "real_time_factor": 2.5,
    "twin": "bullet",
    "accuracy": "fast",
    "faults": [{"t_s": 10.0, "chamber": 2, "kind": "blocked_inlet"}],
    "detections": [
        {"t_s": 10.1, "chamber": 2, "kind": "blocked_inlet", "delay_s": 0.1},
        {"t_s": 11.0, "chamber": 0, "kind": "leak", "delay_s": None},
    ],
    "recoveries": [{"t_s": 10.1, "strategy": "curvature_reversal"}],
}


def test_every_number_has_its_unit() -> None:
    assert rows(SUMMARY) == [
        ("revolutions", "-4.25 in the last 17.5 s"),
        ("moved", "+1.2 cm along, -25.0 cm to the left"),
        ("advance", "58.9 mm per revolution"),
        ("fault", "10.00 s: chamber 2, blocked inlet"),
        ("detected", "10.10 s: chamber 2, blocked inlet (100 ms after it struck)"),
        ("detected", "11.00 s: chamber 0, leak (false alarm)"),
        ("answered", "10.10 s: curvature reversal"),
        ("speed", "2.5 x real time (bullet twin, fast)"),
    ]


def test_a_misnamed_verdict_is_no_false_alarm() -> None:
    leak = {"t_s": 11.0, "chamber": 2, "kind": "leak", "delay_s": None}
    for judgement, told in (("misnamed", "misnamed"), ("false alarm", "false alarm"), ("right", "again")):
        assert ("detected", f"11.00 s: chamber 2, leak ({told})") in rows(
            SUMMARY | {"detections": [leak | {"judgement": judgement}]}
        )


def test_a_safe_stop_says_what_is_left() -> None:
    stop = {"t_s": 12.0, "strategy": "safe_stop", "offer": {"left_rad": 0.5, "right_rad": 1.0}}
    told = rows(SUMMARY | {"recoveries": [stop]})
    assert ("answered", "12.00 s: safe stop") in told
    assert ("left", "can still be rocked, 29° left and 57° right") in told


def test_the_highest_pressure_is_told_as_a_share_of_the_limit() -> None:
    told = rows(SUMMARY | {"highest_pressure_share": 1.4104})
    assert ("pressure", "at most 141.0 % of the chambers' limit") in told


def test_what_is_no_one_chambers_is_the_robots() -> None:
    lost = {"t_s": 6.0, "chamber": -1, "kind": "supply_loss"}
    told = rows(SUMMARY | {"faults": [lost], "detections": [lost | {"t_s": 6.2, "delay_s": 0.2}]})
    assert ("fault", "6.00 s: the robot, supply loss") in told
    assert ("detected", "6.20 s: the robot, supply loss (200 ms after it struck)") in told


def test_what_a_run_does_not_have_is_left_out() -> None:
    bare = SUMMARY | {"advance_per_revolution_m": None, "real_time_factor": None}
    bare |= {"faults": [], "detections": [], "recoveries": []}
    assert [name for name, _ in rows(bare)] == ["revolutions", "moved"]


def test_run_too_short_to_be_steady_says_so() -> None:
    short = {
        "revolutions": None,
        "displacement_m": [None, None],
        "advance_per_revolution_m": None,
        "steady_span_s": 0.0,
    }
    told = rows(SUMMARY | short | {"total_revolutions": -0.75})
    assert told[0] == ("revolutions", "-0.75 in all; it ended before it was steady")
    assert not {"moved", "advance"} & {name for name, _ in told}
