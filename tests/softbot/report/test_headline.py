"""The sentence above a run: what happened, in words."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def test_headline_of_the_whole_experiment(runs: Any, tmp_path: Path) -> None:
    text = runs.told(
        tmp_path,
        stops_s=4.4,
        resumes_s=4.8,
        faults=[runs.RUPTURE],
        detections=[runs.NAMED],
        stalls=[runs.STALL],
        recoveries=[runs.REVERSAL],
    )
    assert text == (
        "Rolled 2.0 revolutions left, lost chamber 2 at 4.0 s (rupture), named it 0.12 s later, stopped, "
        "reversed its curvature and rolled 2.8 more in the same direction."
    )


def test_headline_with_recovery_off_says_that_it_stopped_and_stayed(runs: Any, tmp_path: Path) -> None:
    text = runs.told(tmp_path, stops_s=4.4, faults=[runs.RUPTURE], detections=[runs.NAMED], stalls=[runs.STALL])
    assert text == (
        "Rolled 2.0 revolutions left, lost chamber 2 at 4.0 s (rupture), named it 0.12 s later, "
        "rolled 0.2 more in the same direction, stopped and stayed."
    )


def test_headline_does_not_call_a_robot_that_rolls_on_stopped(runs: Any, tmp_path: Path) -> None:
    text = runs.told(tmp_path, faults=[runs.RUPTURE], detections=[runs.NAMED])
    assert "stopped" not in text
    assert text.endswith("named it 0.12 s later and rolled 3.0 more in the same direction.")


def test_headline_tells_when_a_fault_was_not_noticed(runs: Any, tmp_path: Path) -> None:
    text = runs.told(tmp_path, stops_s=4.4, faults=[runs.RUPTURE])
    assert "did not notice" in text
    assert "named" not in text


def test_headline_of_an_open_loop_run_expects_nobody_to_notice(runs: Any, tmp_path: Path) -> None:
    assert "notice" not in runs.told(tmp_path, kind="pressure", stops_s=4.4, faults=[runs.RUPTURE])


def test_headline_tells_a_wrong_name_and_false_alarms(runs: Any, tmp_path: Path) -> None:
    wrong = runs.NAMED | {"kind": "leak"}
    text = runs.told(tmp_path, faults=[runs.RUPTURE], detections=[wrong], false_alarms=2)
    assert "took it for a leak 0.12 s later" in text
    assert text.endswith("There were 2 false alarms.")


def test_headline_tells_a_recovery_that_goes_the_other_way(runs: Any, tmp_path: Path) -> None:
    text = runs.told(
        tmp_path,
        stops_s=4.4,
        resumes_s=4.8,
        resumed_sign=-1.0,
        faults=[runs.RUPTURE],
        detections=[runs.NAMED],
        recoveries=[runs.REVERSAL, runs.REVERSAL | {"t_s": 6.0}],
    )
    assert text.endswith("reversed its curvature 2 times and rolled 2.4 more back the other way.")


def test_headline_tells_a_recovery_that_failed(runs: Any, tmp_path: Path) -> None:
    text = runs.told(
        tmp_path,
        stops_s=4.0,
        faults=[runs.RUPTURE],
        detections=[runs.NAMED],
        stalls=[runs.STALL],
        recoveries=[runs.REVERSAL],
    )
    assert text.endswith("stopped, reversed its curvature and got no further.")


def test_headline_tells_a_safe_stop_and_that_the_tube_coasted(runs: Any, tmp_path: Path) -> None:
    stop = {"t_s": 4.12, "strategy": "safe_stop"}
    text = runs.told(tmp_path, faults=[runs.RUPTURE], detections=[runs.NAMED], recoveries=[stop])
    assert "reversed" not in text
    assert "named it 0.12 s later, went into the safe state and coasted another 3.0 revolutions" in text


def test_headline_tells_what_is_left_after_a_safe_stop(runs: Any, tmp_path: Path) -> None:
    rocked = {"t_s": 4.5, "strategy": "rock_free"}
    stop = {"t_s": 6.0, "strategy": "safe_stop", "offer": {"left_rad": 0.0, "right_rad": 1.4}}
    text = runs.told(tmp_path, stops_s=4.0, faults=[runs.RUPTURE], recoveries=[rocked, rocked | {"t_s": 5.0}, stop])
    assert "tried to rock free 2 times and went into the safe state. Can still be pushed 80° right, no further." in text


def test_headline_tells_that_it_turned_back_after_a_safe_stop(runs: Any, tmp_path: Path) -> None:
    stop = {"t_s": 5.0, "strategy": "safe_stop", "offer": {"left_rad": 0.0, "right_rad": 6.3}}
    back = {"t_s": 6.0, "strategy": "other_way"}
    text = runs.told(
        tmp_path, stops_s=4.0, resumes_s=6.0, resumed_sign=-1.0, faults=[runs.RUPTURE], recoveries=[stop, back]
    )
    assert text.endswith("went into the safe state, turned back and rolled 2.0 revolutions that way.")


def test_headline_finds_the_verdict_on_a_fault_that_another_one_followed(runs: Any, tmp_path: Path) -> None:
    at_once = runs.RUPTURE | {"chamber": 0}
    text = runs.told(tmp_path, faults=[runs.RUPTURE, at_once], detections=[runs.NAMED, runs.NAMED | {"chamber": 0}])
    assert "did not notice" not in text


def test_headline_counts_each_fault_of_several(runs: Any, tmp_path: Path) -> None:
    later = {"t_s": 7.0, "chamber": 0, "kind": "sensor_offset"}
    text = runs.told(tmp_path, faults=[later, runs.RUPTURE], detections=[runs.NAMED])
    assert text == (
        "Rolled 2.0 revolutions left, lost chamber 2 at 4.0 s (rupture), named it 0.12 s later, "
        "rolled 1.5 more in the same direction, had the pressure sensor of chamber 0 drift off at 7.0 s, "
        "did not notice and rolled 1.5 more in the same direction."
    )


def test_headline_of_a_run_without_faults(runs: Any, tmp_path: Path) -> None:
    assert runs.told(tmp_path, duration_s=2.0) == "Rolled 1.0 revolution left and moved 5.91 cm across the floor."


def test_headline_of_a_robot_that_does_not_roll(runs: Any, tmp_path: Path) -> None:
    assert runs.told(tmp_path, stops_s=0.0) == "Did not roll for 10.0 s."


def test_headline_of_a_floating_robot_names_no_floor(runs: Any, tmp_path: Path) -> None:
    text = runs.told(tmp_path, kind="curvature", ground="none")
    assert text == "Floating without ground, turned 5.0 revolutions about its own axis."


def test_headline_tells_a_recording_that_ends_early(runs: Any, tmp_path: Path) -> None:
    text = runs.told(tmp_path, duration_s=3.0, planned_s=12.0, faults=[runs.RUPTURE])
    assert "lost" not in text
    assert text.endswith("The recording ends at 3.0 s of 12.0 s.")


def test_headline_tells_the_way_that_it_really_went(runs: Any, tmp_path: Path) -> None:
    """The made-up robot rolls left."""
    right = {"duration_s": 2.0, "command": "right"}
    assert runs.told(tmp_path / "a", **right).startswith("Rolled 1.0 revolution left against the order and moved")
    text = runs.told(tmp_path / "b", duration_s=2.0, command="stop")
    assert text.startswith("Rolled 1.0 revolution left against the order and moved")
    assert "order" not in runs.told(tmp_path / "c", kind="pressure", **right)
    assert runs.told(tmp_path / "d", duration_s=2.0, speed_m_s=10.0).endswith("and moved 20.0 m across the floor.")


def test_headline_tells_that_it_coasted_against_the_order(runs: Any, tmp_path: Path) -> None:
    stop = {"t_s": 4.12, "strategy": "safe_stop"}
    broken = {"faults": [runs.RUPTURE], "recoveries": [stop]}
    text = runs.told(tmp_path / "a", command="right", **broken)
    assert text.endswith("coasted another 3.0 revolutions left against the order.")
    text = runs.told(tmp_path / "b", stops_s=0.0, resumes_s=4.5, faults=[runs.RUPTURE], resumed_sign=-1.0)
    assert text.endswith("did not notice and rolled 2.7 more right against the order.")


def test_headline_of_a_fault_of_what_the_chambers_share_names_no_chamber(runs: Any, tmp_path: Path) -> None:
    lost = {"t_s": 4.0, "chamber": -1, "kind": "supply_loss"}
    text = runs.told(tmp_path / "a", faults=[lost], detections=[lost | {"t_s": 4.5}])
    assert ", met a fault of the robot at 4.0 s (supply loss), named it 0.5 s later" in text
    text = runs.told(tmp_path / "b", faults=[runs.RUPTURE | {"kind": "kinked_line"}])
    assert ", met a fault of chamber 2 at 4.0 s (kinked line)," in text


def test_headline_tells_a_chamber_over_its_limit(runs: Any, tmp_path: Path) -> None:
    over = runs.told(tmp_path / "a", highest_pressure_share=1.4104, opened_chamber=2)
    assert over.endswith("across the floor. Chamber 2 went to 141.0 % of the limit of its pressure.")
    assert "limit" not in runs.told(tmp_path / "b", highest_pressure_share=1.0)
    assert "limit" not in runs.told(tmp_path / "c", highest_pressure_share=None)


def test_headline_tells_a_wrong_name_in_another_place(runs: Any, tmp_path: Path) -> None:
    lost = {"t_s": 4.0, "chamber": -1, "kind": "supply_loss"}
    taken = {"t_s": 5.0, "chamber": 1, "kind": "blocked_inlet", "delay_s": None}
    text = runs.told(tmp_path / "a", faults=[lost], detections=[taken | {"judgement": "misnamed"}])
    assert "took it for a blocked inlet of chamber 1 1.0 s later" in text
    text = runs.told(tmp_path / "b", faults=[runs.RUPTURE], detections=[taken | {"judgement": "false alarm"}])
    assert "did not notice" in text


def test_headline_leaves_a_verdict_to_the_fault_whose_chamber_it_is(runs: Any, tmp_path: Path) -> None:
    payload = {"t_s": 2.0, "chamber": -1, "kind": "payload"}
    leak = {"t_s": 4.0, "chamber": 2, "kind": "leak"}
    taken = {"t_s": 4.5, "chamber": 2, "kind": "rupture", "delay_s": None, "judgement": "misnamed"}
    text = runs.told(tmp_path / "a", faults=[payload, leak], detections=[taken])
    assert text.count("took it for") == 1
    assert "took it for a rupture 0.5 s later" in text
    assert "did not notice" in text
