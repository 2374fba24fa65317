"""Random scenes over everything that a user can set: each keeps its invariants or is refused before it starts."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from sim.stress import DEPTH, judge_seed, random_trial

CHUNK = 250


def judged(seeds: range) -> Counter[str]:
    """Outcomes of some trials; those that failed are named."""
    verdicts = {seed: judge_seed(seed) for seed in seeds}
    assert {seed: verdict.words for seed, verdict in verdicts.items() if verdict.failed} == {}
    return Counter(verdict.outcome for verdict in verdicts.values())


@pytest.mark.parametrize("first", [0, 10, 20])
def test_some_random_scenes_keep_their_invariants_or_are_refused(first: int) -> None:
    assert judged(range(first, first + 10))["kept"] >= 5


@pytest.mark.stress
@pytest.mark.parametrize("first", range(0, 10_000, CHUNK))
def test_ten_thousand_random_scenes_keep_their_invariants_or_are_refused(first: int) -> None:
    assert judged(range(first, first + CHUNK))["kept"] >= CHUNK // 2


def test_a_seed_is_always_the_same_trial() -> None:
    assert random_trial(3) == random_trial(3)
    assert random_trial(3) != random_trial(4)


def test_a_kept_trial_says_what_was_measured() -> None:
    verdict = next(v for v in map(judge_seed, range(20)) if v.outcome == "kept")
    assert verdict.measures["finite"] == 1.0
    assert np.isfinite(list(verdict.measures.values())).all()
    assert verdict.measures.get("depth", 0.0) <= DEPTH or verdict.measures.get("plane") == 0.0
