"""Durations are counted, not kept."""

from __future__ import annotations

import pytest

from softbot.nodes.durations import Durations


def test_none_are_all_zero() -> None:
    none = Durations()
    assert (none.count, none.mean_s, none.max_s, none.percentile_s(0.99)) == (0, 0.0, 0.0, 0.0)


def test_mean_worst_and_percentile() -> None:
    durations = Durations()
    for _ in range(99):
        durations.add(0.001)
    durations.add(0.03)
    assert durations.mean_s == pytest.approx((99 * 0.001 + 0.03) / 100)
    assert durations.max_s == 0.03
    assert durations.percentile_s(0.98) == pytest.approx(0.001, abs=1.01e-4)
    assert durations.percentile_s(1.0) == pytest.approx(0.03, abs=1.01e-4)


def test_a_percentile_never_exceeds_the_worst() -> None:
    durations = Durations()
    durations.add(0.00001)
    assert durations.percentile_s(0.99) == 0.00001


def test_beyond_the_last_bin_the_percentile_is_a_lower_bound() -> None:
    durations = Durations()
    durations.add(3.0)
    assert durations.percentile_s(0.5) == pytest.approx(0.05)
    assert durations.max_s == 3.0
