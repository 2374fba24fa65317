"""All parts of the chambers' memory add at most 30 % to a step of plant and rod."""

from __future__ import annotations

import pytest

from sim.benchmark.memory_cost import memory_cost


@pytest.mark.slow
def test_memory_adds_at_most_thirty_per_cent_to_a_step() -> None:
    without_s, with_s = memory_cost(rounds=100)
    assert with_s <= 1.3 * without_s
