"""Random robots are found again within their 95 % intervals as often as these say."""

import pytest

from calib.self_test import holds_coverage, recordings_coverage


def test_a_few_robots_are_found_again() -> None:
    """Twelve robots: over 100 parameters, of which fewer than 80 % inside has no chance at 90 % and more."""
    told: list[int] = []
    found = holds_coverage(12, seed=3, told=told.append)
    assert told == list(range(1, 13))
    assert sum(found.tries.values()) > 60
    assert found.share >= 0.8

    for name in ("bend, confidence", "bend, prediction", "length, confidence", "length, prediction"):
        assert found.band_hits[name] >= 0.75 * found.band_tries[name]


@pytest.mark.slow
def test_a_hundred_robots_are_found_again_within_their_intervals() -> None:
    found = holds_coverage()
    assert found.robots == 100
    assert 0.90 <= found.share <= 0.99
    for name, tries in found.tries.items():
        assert found.hits[name] >= 0.88 * tries, name
    for band, tries in found.band_tries.items():
        assert 0.88 <= found.band_hits[band] / tries <= 0.99, band


@pytest.mark.slow
def test_a_hundred_recorded_robots_are_found_again_within_their_intervals() -> None:
    found = recordings_coverage()
    assert found.robots == 100
    assert sum(found.tries.values()) > 800
    assert 0.90 <= found.share <= 0.99
    for name, tries in found.tries.items():
        assert found.hits[name] >= 0.85 * tries, name
