"""The protocol leaves the bus most of its time, at worst."""

from __future__ import annotations

import pytest

from firmware_protocol.bus_load import bus_load, worst_case_frame_bits
from firmware_protocol.errors import FrameError
from firmware_protocol.spec import spec


def test_frame_bits_are_those_of_the_literature() -> None:
    # Davis, Burns, Bril, Lukkien (2007): 55 + 10 n bit times for an 11-bit identifier
    assert [worst_case_frame_bits(length) for length in range(9)] == [55 + 10 * n for n in range(9)]
    for length in (-1, 9):
        with pytest.raises(FrameError, match="0 to 8"):
            worst_case_frame_bits(length)


def test_the_worst_case_load_is_under_thirty_percent() -> None:
    result = bus_load()
    assert {each.name for each in result.messages} == set(spec().by_name)
    assert 0.1 < result.load < 0.3
    by_name = {each.name: each for each in result.messages}
    assert by_name["SequencerSetpoints"].load == pytest.approx(135 / 0.01 / 500_000)
    assert by_name["BoardFault"].period_s == 0.05  # an event counts at its minimum gap
    assert result.load == pytest.approx(sum(each.load for each in result.messages))
