"""The fixed-rate loop, on a clock of our own."""

from __future__ import annotations

import pytest

from softbot.nodes.fixed_rate import FixedRate


class Clock:
    """Time that only passes when someone sleeps or works; sleeping may be `late_s` late."""

    def __init__(self, late_s: float = 0.0) -> None:
        self.now_s, self.late_s = 100.0, late_s

    def __call__(self) -> float:
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        assert duration_s > 0.0
        self.now_s += duration_s + self.late_s


def test_deadlines_are_absolute() -> None:
    clock = Clock()
    loop = FixedRate(0.01, clock=clock, sleep=clock.sleep)
    times = []
    for work_s in (0.001, 0.009, 0.004, 0.0):
        times.append(loop.wait())
        clock.now_s += work_s
    assert times == pytest.approx([0.0, 0.01, 0.02, 0.03])
    assert loop.timing().missed_deadlines == 0


def test_a_late_wake_up_is_measured_and_does_not_shift_the_rest() -> None:
    clock = Clock(late_s=0.002)
    loop = FixedRate(0.01, clock=clock, sleep=clock.sleep)
    times = [loop.wait() for _ in range(101)]
    assert times[100] == pytest.approx(1.0)  # when it was due
    timing = loop.timing()
    assert timing.max_lateness_s == pytest.approx(0.002)
    assert timing.mean_lateness_s == pytest.approx(0.002 * 100 / 101)  # the first cycle starts at once
    assert timing.p99_lateness_s == pytest.approx(0.002, abs=1.01e-4)


def test_a_cycle_that_takes_too_long_misses_the_deadlines_within_it() -> None:
    clock = Clock()
    loop = FixedRate(0.01, clock=clock, sleep=clock.sleep)
    loop.wait()
    clock.now_s += 0.035
    assert loop.wait() == pytest.approx(0.03)  # at once: it is late already …
    assert (loop.missed_now, clock.now_s) == (2, pytest.approx(100.035))
    assert loop.wait() == pytest.approx(0.04)  # … and then on the old grid, without a burst
    assert (loop.missed_now, clock.now_s) == (0, pytest.approx(100.04))
    timing = loop.timing()
    assert timing.missed_deadlines == 2
    assert timing.cycles == 3


def test_load_is_the_share_of_time_at_work() -> None:
    clock = Clock()
    loop = FixedRate(0.01, clock=clock, sleep=clock.sleep)
    for _ in range(200):
        loop.wait()
        clock.now_s += 0.003
    assert loop.timing().load == pytest.approx(0.3, abs=0.01)


def test_a_loop_that_never_ran_has_a_timing() -> None:
    timing = FixedRate(0.01).timing()
    assert (timing.cycles, timing.load, timing.max_lateness_s) == (0, 0.0, 0.0)


def test_lateness_beyond_the_histogram_is_still_reported() -> None:
    clock = Clock(late_s=0.2)
    loop = FixedRate(1.0, clock=clock, sleep=clock.sleep)
    for _ in range(10):
        loop.wait()
    timing = loop.timing()
    assert timing.p99_lateness_s == pytest.approx(0.05)
    assert timing.max_lateness_s == pytest.approx(0.2)
    assert "10 cycles of 1000 ms: 0 deadlines missed" in str(timing)
