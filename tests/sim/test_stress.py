"""Random scenes over everything that a user can set: each keeps its invariants or is refused before it starts."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from sim.figures.step_margin import rolling_trial
from sim.stress import DEPTH, judge, judge_seed, random_segment_trial, random_trial

CHUNK = 250
FOUND = (
    853,
    896,
    995,
    1691,
    1707,
    1874,
    1886,
    2748,
    3161,
    3442,
    4129,
    4177,
    4497,
    4738,
    4943,
    7114,
    7235,
    7388,
    8964,
    9055,
    9468,
)
"""Trials that failed once: energy made, strains out of range, sunk at rest."""


def judged(seeds: range) -> Counter[str]:
    """Outcomes of some trials; those that failed are named."""
    verdicts = {seed: judge_seed(seed) for seed in seeds}
    assert {seed: verdict.words for seed, verdict in verdicts.items() if verdict.failed} == {}
    return Counter(verdict.outcome for verdict in verdicts.values())


@pytest.mark.parametrize("first", [0, 10, 20])
def test_some_random_scenes_keep_their_invariants_or_are_refused(first: int) -> None:
    assert judged(range(first, first + 10))["kept"] >= 5


@pytest.mark.parametrize("seed", FOUND)
def test_a_scene_that_failed_once_is_kept_or_refused(seed: int) -> None:
    assert not judge_seed(seed).failed


@pytest.mark.stress
@pytest.mark.parametrize("ground", ["plane", "none"])
def test_ten_hours_of_rolling_and_of_floating_keep_their_invariants(ground: str) -> None:
    step_s = 0.02
    trial = rolling_trial(4e-3, step_s, {"modes": 3, "contact_points": 12}, 36_000.0)
    table = trial.table | {"world": {"friction": 0.6, "ground": ground}}
    verdict = judge(replace(trial, table=table), time_limit_s=3600.0)
    assert verdict.outcome == "kept", verdict.words


@pytest.mark.stress
def test_three_hundred_scenes_of_the_segment_twin_keep_their_invariants() -> None:
    verdicts = {seed: judge(random_segment_trial(seed)) for seed in range(300)}
    failed = {seed: verdict.words for seed, verdict in verdicts.items() if verdict.failed}
    assert not failed
    assert sum(verdict.outcome == "kept" for verdict in verdicts.values()) >= 250


@pytest.mark.parametrize("seed", [58, 139, 141])
def test_a_scene_in_which_long_steps_of_the_segment_twin_made_energy_is_kept(seed: int) -> None:
    """Its steps are divided now."""
    assert judge(random_segment_trial(seed)).outcome == "kept"


@pytest.mark.stress
@pytest.mark.parametrize("first", range(0, 10_000, CHUNK))
def test_ten_thousand_random_scenes_keep_their_invariants_or_are_refused(first: int) -> None:
    assert judged(range(first, first + CHUNK))["kept"] >= CHUNK // 2


def test_a_seed_is_always_the_same_trial() -> None:
    assert random_trial(3) == random_trial(3)
    assert random_trial(3) != random_trial(4)


def test_a_kept_trial_says_what_was_measured() -> None:
    verdict = next(v for v in map(judge_seed, range(20)) if v.outcome == "kept")
    assert verdict.measures["rotation"] < 1e-9
    assert np.isfinite(list(verdict.measures.values())).all()
    assert verdict.measures.get("depth", 0.0) <= DEPTH
