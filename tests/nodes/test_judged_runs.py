"""Runs of the reference campaign that were judged wrongly once, and what makes them hard."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import pytest

from controllers.interface import Detection
from softbot.campaign.campaign import Draws, load_campaign
from softbot.nodes.direct import DirectRun

CAMPAIGN = Path(__file__).parents[2] / "campaigns" / "reference.toml"


@lru_cache(maxsize=1)
def draws() -> Draws:
    return load_campaign(CAMPAIGN, ("seed=2026",))


def judged(number: int, until_s: float) -> list[Detection]:
    """What was found in a run until then."""
    run = draws().run(number)
    direct = DirectRun(run.scene, run.known)
    direct.advance(round(until_s * 100))
    return direct.detections()


@pytest.mark.parametrize("number", [2286, 11950, 12169, 16018])
def test_a_soft_robot_is_not_taken_for_broken_when_its_chambers_are_vented_for_the_first_time(number):
    """It bends a fifth more than is believed: its chambers are larger, and their inlets look narrow at first."""
    assert judged(number, 5.0) == []


@pytest.mark.parametrize(("number", "until_s"), [(1028, 5.2), (38, 12.6)])
def test_a_soft_robot_whose_chambers_swell_more_than_is_believed_does_not_leak(number, until_s):
    run = load_campaign(CAMPAIGN.with_name("healthy.toml"), ("seed=4711",)).run(number)
    direct = DirectRun(run.scene, run.known)
    direct.advance(round(until_s * 100))
    assert direct.detections() == []


@pytest.mark.parametrize("number", [1129, 14503, 17463])
def test_an_offset_is_no_drift_because_the_shape_was_reckoned_with_it(number):
    found = judged(number, 11.0)
    assert {one.kind for one in found} == {"sensor_offset"}


@pytest.mark.parametrize("number", [17441, 18975])
def test_valves_that_open_and_shut_in_turn_beside_a_broken_chamber_make_no_noise(number):
    assert not any(one.kind == "sensor_noise" for one in judged(number, 11.0))


def test_a_sensor_that_is_noisy_is_still_found_within_a_tenth_of_a_second():
    noisy = next(n for n in range(1000) if draws().run(n).case == "sensor_noise")
    fault = draws().run(noisy).scene.fault[0]
    found = judged(noisy, fault.t_s + 0.2)
    assert [(one.kind, one.chamber) for one in found] == [("sensor_noise", fault.chamber_number)]
    assert found[0].t_s - fault.t_s < 0.1
