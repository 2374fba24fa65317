"""Cyclic messages leave at the DBC's rate from a loop that may jitter, stall or jump."""

from __future__ import annotations

import random

import pytest

from firmware_protocol.schedule import Schedule


@pytest.mark.parametrize(("node", "name"), [("Sequencer", "SequencerSetpoints"), ("Board", "BoardBoot")])
def test_everything_is_due_at_first_and_then_once_a_period(node: str, name: str) -> None:
    schedule = Schedule(node)
    period_us = schedule.period_us[name]
    sent_us = [t_us for t_us in range(7_000, 2_007_000, 10_000) if schedule.due(name, t_us)]
    assert sent_us == list(range(7_000, 2_007_000, period_us))


def test_event_messages_are_not_scheduled() -> None:
    assert "SequencerFault" not in Schedule("Sequencer").period_us
    assert "BoardPressures" not in Schedule("Sequencer").period_us


def test_a_jittering_loop_keeps_the_rate() -> None:
    schedule = Schedule("Sequencer")
    generator = random.Random(1)
    times_us = [cycle * 10_000 + generator.randrange(0, 4_000) for cycle in range(1000)]
    assert sum(schedule.due("SequencerSetpoints", t_us) for t_us in times_us) == 1000


def test_missed_cycles_are_left_out() -> None:
    schedule = Schedule("Sequencer")
    assert schedule.due("SequencerSetpoints", 0)
    assert schedule.due("SequencerSetpoints", 1_000_000)
    assert not schedule.due("SequencerSetpoints", 1_001_000)
    assert schedule.due("SequencerSetpoints", 1_010_000)


def test_a_clock_that_goes_back_starts_the_cycle_anew() -> None:
    schedule = Schedule("Sequencer")
    assert schedule.due("SequencerSetpoints", 50_000_000)
    assert schedule.due("SequencerSetpoints", 1_000_000)
    assert schedule.due("SequencerSetpoints", 1_010_000)
