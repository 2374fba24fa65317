"""The board's clock is measured to within half a round trip."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.time_sync import CLOCK_CYCLE_US, ClockMeasurement, ClockSync


def answer(request: dict[str, float], came_us: int, hold_us: int) -> dict[str, int]:
    return {"SyncId": int(request["SyncId"]), "ReceiveUs": came_us % CLOCK_CYCLE_US, "HoldUs": hold_us}


@given(
    st.integers(0, 3 * CLOCK_CYCLE_US),
    st.integers(-(CLOCK_CYCLE_US // 2), CLOCK_CYCLE_US // 2 - 1),
    st.integers(0, 20_000),
    st.integers(0, 20_000),
    st.integers(0, 60_000),
)
@settings(deadline=None, max_examples=200)
def test_the_offset_is_right_within_half_the_round_trip(
    sent_us: int, offset_us: int, there_us: int, back_us: int, hold_us: int
) -> None:
    clock = ClockSync()
    request = clock.request(sent_us)
    assert request["SendUs"] == sent_us % CLOCK_CYCLE_US
    clock.take(answer(request, sent_us + there_us + offset_us, hold_us), sent_us + there_us + hold_us + back_us)
    assert clock.best is not None
    assert clock.best.round_trip_us == there_us + back_us
    error_us = (clock.best.offset_us - offset_us + CLOCK_CYCLE_US // 2) % CLOCK_CYCLE_US - CLOCK_CYCLE_US // 2
    assert abs(error_us) <= (there_us + back_us + 1) // 2
    assert -(CLOCK_CYCLE_US // 2) <= clock.best.offset_us < CLOCK_CYCLE_US // 2


def test_the_shortest_of_the_last_round_trips_counts() -> None:
    clock = ClockSync()
    assert clock.best is None
    for cycle, delay_us in enumerate((900, 100, 500)):
        request = clock.request(cycle * 100_000)
        clock.take(answer(request, cycle * 100_000 + delay_us + 7, 0), cycle * 100_000 + delay_us)
    assert clock.best == ClockMeasurement(7 + 50, 100)
    for cycle in range(3, 11):
        request = clock.request(cycle * 100_000)
        clock.take(answer(request, cycle * 100_000 + 300, 0), cycle * 100_000 + 600)
    assert clock.best == ClockMeasurement(0, 600)  # the old one has been forgotten
    assert len(clock.measurements) == 8
    clock.forget()
    assert clock.best is None


def test_ids_count_modulo_sixteen() -> None:
    clock = ClockSync()
    assert [clock.request(0)["SyncId"] for _ in range(17)] == [*range(1, 16), 0, 1]


@pytest.mark.parametrize("case", ["nothing asked", "other id", "twice", "held too long", "clock jumped", "forgotten"])
def test_answers_that_prove_nothing_are_let_pass(case: str) -> None:
    clock = ClockSync()
    request = {"SyncId": 0.0} if case == "nothing asked" else clock.request(1000)
    good = answer(request, 5000, 10)
    now_us = 1200
    if case == "other id":
        good["SyncId"] += 1
    elif case == "twice":
        clock.take(good, now_us)
        clock.measurements.clear()
    elif case == "held too long":
        good["HoldUs"] = 0xFFFF
        now_us = 1_000_000
    elif case == "clock jumped":
        now_us = 1009  # before the hold was over
    elif case == "forgotten":
        clock.forget()
    clock.take(good, now_us)
    assert clock.best is None


def test_a_round_trip_of_nothing_counts() -> None:
    clock = ClockSync()
    clock.take(answer(clock.request(1000), 5000, 10), 1010)
    assert clock.best == ClockMeasurement(4000, 0)
