"""Relief of the manifold, over readings that are given."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.manifold_relief import BEFOREHAND, LONGEST_TAKING, relief_memory, relieve_manifold

LIMIT_Pa = 150e3
SHUT = np.full(4, -1.0)


def memory_of_a_board():
    return relief_memory(0.01, 0.01)


def relieve(memory, pressure_Pa, *, supply_Pa=248e3, rests=True, opening=SHUT):
    """One cycle: whether a chamber is relieved, and the openings."""
    valves = np.array(opening, dtype=float)
    acts = relieve_manifold(memory, np.array(pressure_Pa, dtype=float), supply_Pa, LIMIT_Pa, rests, valves)
    return acts, valves


def rising(cycles, *, chamber=2, first_Pa=60e3, step_Pa=5e3):
    for k in range(cycles):
        pressure = np.full(4, 2e3)
        pressure[chamber] = first_Pa + k * step_Pa
        yield pressure


def test_a_chamber_that_fills_in_the_safe_state_is_relieved_through_the_others():
    memory = memory_of_a_board()
    done = [relieve(memory, pressure) for pressure in rising(8)]
    assert not done[0][0]
    assert done[-1][0]
    np.testing.assert_array_equal(done[-1][1], [1.0, 1.0, -1.0, 1.0])


@pytest.mark.parametrize("step_Pa", [0.0, -2e3])
def test_chambers_that_vent_or_hold_are_left_open_to_the_atmosphere(step_Pa):
    memory = memory_of_a_board()
    for pressure in rising(40, first_Pa=90e3, step_Pa=step_Pa):
        acts, valves = relieve(memory, pressure)
        assert not acts
        np.testing.assert_array_equal(valves, SHUT)


def test_a_chamber_that_was_told_to_fill_may_rise_until_its_valve_has_shut():
    memory = memory_of_a_board()
    filling = np.array([-1.0, -1.0, 1.0, -1.0])
    for pressure in rising(10, first_Pa=20e3):
        assert not relieve(memory, pressure, rests=False, opening=filling)[0]
    for pressure in rising(2, first_Pa=70e3):
        assert not relieve(memory, pressure)[0]


def test_a_valve_that_was_hardly_open_shuts_sooner_than_one_that_was_told_to_stay_as_it_is():
    fed = []
    for opening, then in ((0.2, -0.1), (1.0, 0.0)):
        memory = memory_of_a_board()
        for pressure in rising(5, first_Pa=20e3):
            relieve(memory, pressure, rests=False, opening=np.full(4, opening))
        fed.append([relieve(memory, pressure, opening=np.full(4, then))[0] for pressure in rising(6, first_Pa=45e3)])
    assert fed == [[False, False, True, True, True, True], [False, False, False, False, True, True]]


def test_a_chamber_that_rises_slowly_or_is_far_from_its_limit_is_left_alone_while_setpoints_are_obeyed():
    for first_Pa, step_Pa in ((60e3, 1.5e3), (10e3, 5e3)):
        memory = memory_of_a_board()
        for pressure in rising(17, first_Pa=first_Pa, step_Pa=step_Pa):
            acts, valves = relieve(memory, pressure, rests=False)
            assert not acts
            np.testing.assert_array_equal(valves, SHUT)
        assert relieve(memory, [2e3, 2e3, 160e3, 2e3])[0]  # in the safe state it is known at once


def obeyed(memory, pressures):
    return [relieve(memory, pressure, rests=False)[0] for pressure in pressures]


def test_one_that_would_soon_be_at_its_limit_is_relieved_beforehand_for_the_cycles_that_a_name_takes():
    memory = memory_of_a_board()
    (*_, pressure) = rising(3, first_Pa=110e3)
    assert obeyed(memory, rising(8, first_Pa=110e3)) == [False, False, *(BEFOREHAND * [True]), False]
    memory = memory_of_a_board()
    obeyed(memory, rising(2, first_Pa=110e3))
    np.testing.assert_array_equal(relieve(memory, pressure, rests=False)[1], [1.0, 1.0, -1.0, 1.0])


def test_who_was_relieved_beforehand_for_nothing_is_believed_again_after_a_rest():
    memory = memory_of_a_board()
    obeyed(memory, rising(8, first_Pa=110e3))
    assert not any(obeyed(memory, rising(8, first_Pa=110e3)))
    relieve(memory, np.full(4, 2e3))
    assert any(obeyed(memory, rising(8, first_Pa=110e3)))


def test_a_chamber_that_was_told_to_fill_may_come_near_its_limit_as_fast_as_it_likes():
    memory = memory_of_a_board()
    filling = np.array([-1.0, -1.0, 1.0, -1.0])
    for pressure in rising(8, first_Pa=110e3):
        acts, valves = relieve(memory, pressure, rests=False, opening=filling)
        assert not acts
        np.testing.assert_array_equal(valves, filling)


def test_the_others_take_turns_and_never_take_more_than_they_have_room_for():
    memory = memory_of_a_board()
    for pressure in rising(8):
        relieve(memory, pressure)
    full = [95e3, 20e3, 110e3, 20e3]
    acts, valves = relieve(memory, full)
    assert acts
    np.testing.assert_array_equal(valves, [-1.0, 1.0, -1.0, 1.0])
    assert relieve(memory, full, supply_Pa=15e3)[1].max() == -1.0  # nothing flows from where there is less


def test_a_chamber_whose_sensor_stands_still_takes_gas_for_a_turn_only():
    memory = memory_of_a_board()
    for pressure in rising(8):
        relieve(memory, pressure)
    openings = [relieve(memory, [2e3, 2e3, 110e3, 2e3])[1][0] for _ in range(2 * LONGEST_TAKING)]
    assert openings.count(-1.0) >= 5


def test_a_chamber_that_is_empty_again_is_no_longer_relieved():
    memory = memory_of_a_board()
    for pressure in rising(8):
        relieve(memory, pressure)
    acts, valves = relieve(memory, [30e3, 30e3, 14e3, 30e3])
    assert not acts
    np.testing.assert_array_equal(valves, SHUT)


@settings(max_examples=60, deadline=None)
@given(
    readings=st.lists(
        st.lists(
            st.one_of(st.floats(-1e6, 1e6), st.sampled_from([math.nan, math.inf, -math.inf])), min_size=5, max_size=5
        ),
        max_size=30,
    ),
    rests=st.booleans(),
)
def test_whatever_is_read_the_valves_are_told_a_number_and_a_fed_chamber_is_never_filled(readings, rests):
    memory = memory_of_a_board()
    for *pressure, supply in readings:
        acts, valves = relieve(memory, pressure, supply_Pa=supply, rests=rests)
        assert np.all(np.abs(valves) == 1.0)
        assert not acts or memory[0]["fed"].max() > 0
        assert np.all(valves[memory[0]["fed"] > 0] == -1.0)
        assert np.all(valves[np.isnan(pressure)] == -1.0)


def test_no_gas_is_taken_by_a_chamber_whose_wire_is_broken():
    memory = memory_of_a_board()
    for pressure in rising(8):
        relieve(memory, pressure)
    np.testing.assert_array_equal(relieve(memory, [2e3, -50e3, 110e3, 2e3])[1], [1.0, -1.0, -1.0, 1.0])


def test_a_slow_valve_is_given_the_time_that_it_takes_to_shut():
    fed = []
    for lag_s in (0.01, 0.05):
        memory = relief_memory(lag_s, 0.01)
        for pressure in rising(5, first_Pa=20e3):
            relieve(memory, pressure, rests=False, opening=np.full(4, 1.0))
        fed.append([relieve(memory, pressure)[0] for pressure in rising(12, first_Pa=45e3)].index(True))
    assert fed[1] >= fed[0] + 2
