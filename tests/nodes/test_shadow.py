"""A robot watched by its twin: what is learnt, what is found, and what is kept from one session to the next."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.pressure_loop import PressureLoopGains
from firmware_protocol.frame import Frame
from sim.scene import Scene, scene_from
from softbot.errors import InputError
from softbot.nodes.chamber_health import (
    Health,
    Learnt,
    Session,
    concern_in_words,
    concerns,
    days_left,
    read_health,
    write_health,
)
from softbot.nodes.lockstep import BUS_LOG, run_lockstep
from softbot.nodes.shadow import Shadow, trace_frames, watch
from softbot.robot import load_robot

GAINS = PressureLoopGains(proportional_1_s=18.0, integral_1_s2=16.0, sample_s=0.01, model_lag_s=0.03)
BEGAN = datetime(2026, 3, 1, tzinfo=UTC)


def recorded(folder: Path, duration_s: float, *faults: dict[str, Any]) -> Scene:
    table = {
        "robot": "default",
        "drive": {"kind": "sequencer"},
        "sequencer": {"start_s": 0.1, "speed_rev_s": 0.5},
        "fault": list(faults),
        "solver": {"twin": "rod", "accuracy": "fast", "duration_s": duration_s},
    }
    scene = scene_from(table, "watched.toml", Path())
    run_lockstep(scene, folder, gains=GAINS)
    return scene


@pytest.fixture(scope="module")
def leaking(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight seconds of a robot with a leak too small to be found."""
    folder = tmp_path_factory.mktemp("leaking")
    recorded(folder, 8.0, {"t_s": 0.0, "chamber": 2, "kind": "leak", "severity": 0.06})
    return folder / BUS_LOG


def watched(trace: Path, health: Health | None = None, every_s: float = 1.0) -> tuple[Shadow, list[dict[str, Any]]]:
    shadow, told = Shadow(load_robot("default"), health), list[dict[str, Any]]()
    watch(shadow, trace_frames(trace), told.append, every_s)
    return shadow, told


def test_a_small_leak_is_learnt_and_not_found(leaking: Path) -> None:
    shadow, told = watched(leaking)
    assert shadow.detections == []
    last = told[-1]["chambers"]
    leaks = [one["learnt"]["leak"] for one in last]
    assert max(range(4), key=lambda i: leaks[i]) == 2
    assert leaks[2] > 0.015 > max(leaks[i] for i in (0, 1, 3))
    assert all(abs(one["learnt"]["supply_path"] - 1.0) < 0.1 for one in last)
    assert [one["event"] for one in told] == ["estimate"] * 7
    assert told[-1]["roll_rev"] == pytest.approx(-3.0, abs=0.6)
    assert (told[-1]["board_mode"], told[-1]["sequencer_state"]) == ("armed", "rolling")
    roll = told[-1]["roll"]
    assert roll["grip"] == pytest.approx(0.9, abs=0.25)
    assert abs(roll["gyro_bias_rad_s"]) < 0.05
    assert sum(roll["gains"]) == pytest.approx(0.0, abs=1e-9)


def test_a_biased_gyro_of_a_robot_that_another_rolls_is_found_and_learnt(tmp_path: Path) -> None:
    recorded(tmp_path, 7.0, {"t_s": 4.0, "kind": "imu_bias", "severity": 0.6})
    shadow, told = watched(tmp_path / BUS_LOG)
    assert [(found.chamber, found.kind) for found in shadow.detections] == [(-1, "imu_bias")]
    assert told[-1]["roll"]["gyro_bias_rad_s"] == pytest.approx(0.3, abs=0.05)


def test_what_was_learnt_is_carried_on_and_the_leak_is_seen_in_the_end(leaking: Path) -> None:
    health, seen = Health(robot="default"), list[float]()
    for _ in range(4):
        session = watched(leaking, health)[0].session()
        assert session is not None
        health = health.after(session)
        seen.append(session.chambers[2].leak)
    assert seen == sorted(seen)
    assert seen[-1] == pytest.approx(0.06, abs=0.02)
    found = concerns(health)
    assert [(one["chamber"], one["what"]) for one in found] == [(2, "leak")]
    assert "chamber 2 leaks" in concern_in_words(found[0])


def test_a_session_begins_where_the_last_one_ended(leaking: Path) -> None:
    session = watched(leaking)[0].session()
    assert session is not None
    again = Shadow(load_robot("default"), Health(robot="default", sessions=(session,)))
    for count, (stamp_s, frames) in enumerate(trace_frames(leaking)):
        again.see(stamp_s, frames)
        if count == 3:
            break
    for now, before in zip(again.estimate().chambers, session.chambers, strict=True):
        assert now.learnt.leak == pytest.approx(before.leak, abs=2e-3)
        assert now.learnt.supply_path == pytest.approx(before.supply_path, abs=5e-3)
        assert now.learnt.supply_path_deviation >= before.supply_path_deviation


def test_it_watches_on_after_a_fault_that_no_robot_rolls_on_with(tmp_path: Path) -> None:
    faults = ({"t_s": 1.5, "chamber": 0, "kind": "stuck_open"}, {"t_s": 3.0, "kind": "imu_stuck"})
    recorded(tmp_path, 4.0, *faults)
    shadow, told = watched(tmp_path / BUS_LOG)
    assert [(one.chamber, one.kind) for one in shadow.detections] == [(0, "stuck_open"), (-1, "imu_stuck")]
    verdicts = [one for one in told if one["event"] == "verdict"]
    assert verdicts[0]["severity"] > 0.5
    assert verdicts[1]["severity"] is None
    broken = shadow.estimate().chambers[0]
    assert (broken.named, broken.effectiveness) == ("stuck_open", 0.0)


def test_other_frames_teach_nothing() -> None:
    shadow = Shadow(load_robot("default"))
    for n in range(50):
        assert shadow.see(100.0 + 0.01 * n, [Frame(0x123, b"abc"), Frame(0x7FF, bytes(8))]) == []
    assert shadow.counts().accepted == 0
    assert shadow.session() is None
    assert shadow.estimate().board_mode is None


def learnt(leak: float = 0.0, supply_path: float = 1.0, deviation: float = 0.004) -> Learnt:
    return Learnt(0.0, supply_path, 1.0, leak, 0.02, 0.02, deviation, 500, 200)


def sessions(*leaks: float, each: timedelta = timedelta(days=1), **of_the_last: float) -> Health:
    last = learnt(leaks[-1], **of_the_last)
    return Health(
        robot="default",
        sessions=tuple(
            Session(
                ended=BEGAN + n * each,
                watched_s=60.0,
                chambers=(learnt(), last if n == len(leaks) - 1 else learnt(leak), learnt(), learnt()),
            )
            for n, leak in enumerate(leaks)
        ),
    )


def test_a_growing_leak_is_told_with_the_days_that_are_left() -> None:
    health = sessions(0.01, 0.03, 0.05, 0.07)  # 0.02 a day, 0.2 is worn
    assert days_left(health, 1) == pytest.approx(6.5)
    (found,) = concerns(health)
    assert concern_in_words(found) == (
        "chamber 1 leaks 7 % of what its supply valve passes; at this rate 20 % in 6.5 days"
    )


@pytest.mark.parametrize(
    ("health", "days"),
    [
        (sessions(0.05, 0.06), None),  # two are no trend
        (sessions(0.05, 0.06, 0.07, each=timedelta(minutes=5)), None),  # nor is a quarter of an hour
        (sessions(0.07, 0.06, 0.05), None),  # it heals
        (sessions(0.1, 0.2, 0.3), 0.0),
    ],
)
def test_no_days_are_told_without_a_trend(health: Health, days: float | None) -> None:
    assert days_left(health, 1) == days
    assert concerns(health)[0]["days_left"] == days


@settings(max_examples=30)
@given(st.floats(-0.02, 0.029), st.floats(0.8, 1.5))
def test_a_healthy_robot_gives_no_concern(leak: float, supply_path: float) -> None:
    assert concerns(sessions(0.0, leak, supply_path=supply_path)) == []
    assert concerns(sessions(0.05, 0.1, deviation=0.1)) == []  # not known well enough


def test_a_path_that_silts_up_is_told_against_the_first_session() -> None:
    (found,) = concerns(sessions(0.0, 0.0, supply_path=0.6))
    assert concern_in_words(found) == "the supply path of chamber 1 passes 40 % less than in the first session"


def test_a_health_file_is_read_as_it_was_written(tmp_path: Path) -> None:
    health = sessions(0.01, 0.02)
    write_health(tmp_path / "h.json", health)
    assert read_health(tmp_path / "h.json", "default") == health
    assert read_health(tmp_path / "none.json", "default") == Health(robot="default")
    assert list(tmp_path.iterdir()) == [tmp_path / "h.json"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is no health file"),
        ("{}", "is no health file"),
        ('{"schema": "softbot-health-2", "robot": "default"}', "is no health file"),
        (json.dumps({"schema": "softbot-health-1", "robot": "another"}), "'another'"),
        (sessions(0.0).model_dump_json(by_alias=True).replace('"leak":0.0', '"leak":NaN', 1), "is no health file"),
        ("\udcff", "cannot be read"),
    ],
)
def test_what_is_no_health_file_is_refused(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "h.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(InputError, match=says):
        read_health(tmp_path / "h.json", "default")


def test_a_health_file_without_a_place_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        write_health(tmp_path / "no" / "h.json", sessions(0.0))
