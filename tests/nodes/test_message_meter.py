"""How a message reaches a node, on clocks of our own."""

from __future__ import annotations

import pytest

from firmware_protocol.e2e import Sender
from firmware_protocol.frame import Frame
from softbot.nodes.message_meter import MessageMeter


class Clocks:
    """A monotonic clock and a wall clock that go together; the wall clock can be set."""

    def __init__(self) -> None:
        self.now_s, self.offset_s = 50.0, 1.7e9

    def monotonic(self) -> float:
        return self.now_s

    def wall(self) -> float:
        return self.now_s + self.offset_s


class Bench:
    def __init__(self) -> None:
        self.clocks = Clocks()
        self.meter = MessageMeter("SequencerSetpoints", monotonic=self.clocks.monotonic, wall_clock=self.clocks.wall)
        self.sender = Sender()

    def setpoints(self) -> Frame:
        return self.sender.send("SequencerSetpoints", {f"Setpoint{chamber}": 1.0 for chamber in range(4)})


def test_latency_runs_from_arrival_to_the_end_of_the_cycle() -> None:
    bench = Bench()
    for waited_s, cycle_s in ((0.004, 0.001), (0.002, 0.001)):
        stamp_s = bench.clocks.wall()
        bench.clocks.now_s += waited_s
        bench.meter.came([(bench.setpoints(), stamp_s)])
        bench.clocks.now_s += cycle_s
        bench.meter.acted()
        bench.meter.acted()  # a cycle without a new one counts nothing
    timing = bench.meter.timing()
    assert timing.received == 2
    assert timing.mean_latency_s == pytest.approx(0.004, abs=1e-6)
    assert timing.max_latency_s == pytest.approx(0.005, abs=1e-6)
    assert "SequencerSetpoints: 2 came, 0 lost, 0 refused" in str(timing)


def test_other_messages_are_let_pass_and_bad_ones_counted() -> None:
    bench = Bench()
    other = bench.sender.send("EmergencyStop", {"Reason": 0})
    good = bench.setpoints()
    bad = Frame(good.frame_id, bytes([good.data[0] ^ 1]) + good.data[1:])
    bench.meter.came([(other, 0.0), (good, 0.0), (bad, 0.0), (good, 0.0)])
    timing = bench.meter.timing()
    assert (timing.received, timing.refused, timing.lost) == (1, 2, 0)


def test_a_gap_in_the_counter_is_frames_lost() -> None:
    bench = Bench()
    first = bench.setpoints()
    for _ in range(4):
        bench.setpoints()
    bench.meter.came([(first, 0.0), (bench.setpoints(), 0.0)])
    assert bench.meter.timing().lost == 4


@pytest.mark.parametrize("stamp_s", [0.0, 123.0, 1e12])
def test_a_stamp_of_another_clock_counts_as_read_now(stamp_s: float) -> None:
    bench = Bench()
    bench.meter.came([(bench.setpoints(), stamp_s)])
    bench.clocks.now_s += 0.003
    bench.meter.acted()
    assert bench.meter.timing().max_latency_s == pytest.approx(0.003, abs=1e-6)


def test_a_wall_clock_that_is_set_between_two_frames_makes_no_gap() -> None:
    bench = Bench()
    for _ in range(3):
        stamp_s = bench.clocks.wall()
        bench.meter.came([(bench.setpoints(), stamp_s)])
        bench.clocks.now_s += 0.01
        bench.clocks.offset_s += 3600.0
    assert bench.meter.timing().longest_gap_s == pytest.approx(0.01, abs=1e-6)
