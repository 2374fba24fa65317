"""What listening to a bus tells."""

from __future__ import annotations

import json
import math

import pytest

from firmware_protocol.bus_watch import BusWatch
from firmware_protocol.e2e import Sender
from firmware_protocol.enumerations import BoardMode, SafeReason
from firmware_protocol.frame import Frame


def setpoints(sender: Sender, value: float = 5.0) -> Frame:
    return sender.send("SequencerSetpoints", {f"Setpoint{chamber}": value for chamber in range(4)})


def test_rate_age_jitter_and_content_of_a_message() -> None:
    watch, sender = BusWatch(), Sender()
    for number in range(101):
        watch.see(setpoints(sender), 10.0 + 0.01 * number + (0.003 if number == 50 else 0.0))
    one = watch.messages["SequencerSetpoints"]
    assert one.rate_Hz(11.0) == pytest.approx(100.0, rel=0.01)
    assert one.age_s(11.25) == pytest.approx(0.25)
    assert one.jitter_s() == pytest.approx(0.003, abs=1e-6)
    assert one.signals["Setpoint2"] == pytest.approx(5.0)
    assert (one.frames, one.lost, one.errors) == (101, 0, 0)
    assert not one.overdue(11.02)
    assert one.overdue(11.04)
    assert one.rate_Hz(20.0) == 0.0
    assert watch.load(11.0) == pytest.approx(101 * 135 / 2.0 / 500_000, rel=0.01)


def test_what_is_older_than_the_moments_looked_at_is_forgotten() -> None:
    watch, sender = BusWatch(), Sender()
    for number in range(500):
        watch.see(setpoints(sender), 0.01 * number)
    one = watch.messages["SequencerSetpoints"]
    assert one.rate_Hz(4.99) == pytest.approx(100.0, rel=0.01)
    assert watch.load(4.99) == pytest.approx(201 * 135 / 2.0 / 500_000, rel=0.01)
    assert len(one.recent_s) == 201


def test_losses_repeats_and_damage_are_counted() -> None:
    watch, sender = BusWatch(), Sender()
    frames = [setpoints(sender) for _ in range(6)]
    bad = Frame(frames[5].frame_id, bytes([frames[5].data[0] ^ 1]) + frames[5].data[1:])
    for frame in (frames[0], frames[0], frames[4], bad, Frame(frames[0].frame_id, b"12")):
        watch.see(frame, 1.0)
    one = watch.messages["SequencerSetpoints"]
    assert (one.frames, one.lost, one.errors) == (5, 3, 3)
    assert one.signals["Setpoint0"] == pytest.approx(5.0)  # what was valid stays


def test_a_value_out_of_its_range_under_a_right_crc_is_an_error() -> None:
    from firmware_protocol.e2e import protect

    watch = BusWatch()
    watch.see(Frame(0x250, protect("BoardHeartbeat", bytes([0, 0xF0, 0, 0, 0, 0, 0, 0]), 0)), 1.0)
    assert watch.messages["BoardHeartbeat"].errors == 1
    assert watch.named("BoardHeartbeat", "BoardMode") is None


def test_states_are_told_by_name_and_strangers_by_number() -> None:
    watch, sender = BusWatch(), Sender()
    watch.see(
        sender.send(
            "BoardHeartbeat",
            {
                "BoardMode": BoardMode.SAFE_LATCHED,
                "SafeReason": SafeReason.COMMAND_TIMEOUT,
                "Health": 0,
                "ArmChallenge": 0,
                "UptimeS": 12,
            },
        ),
        1.0,
    )
    watch.see(Frame(0x7FF, b""), 1.0)
    watch.see(Frame(0x7FF, b""), 1.1)
    report = json.loads(json.dumps(watch.report(1.2)))
    assert (report["board_mode"], report["safe_reason"]) == ("safe_latched", "command_timeout")
    assert (report["sequencer_state"], report["health"]) == (None, None)
    assert report["unknown"] == {"0x7FF": 2}
    assert report["messages"]["BoardHeartbeat"]["age_s"] == pytest.approx(0.2)
    assert report["messages"]["ImuGyro"]["age_s"] is None


def test_before_anything_came_there_is_nothing() -> None:
    watch = BusWatch()
    one = watch.messages["BoardPressures"]
    assert math.isinf(one.age_s(5.0))
    assert math.isnan(one.jitter_s())
    assert (one.rate_Hz(5.0), one.overdue(5.0), watch.load(5.0)) == (0.0, False, 0.0)


def test_time_that_goes_back_harms_nothing() -> None:
    watch, sender = BusWatch(), Sender()
    for t_s in (5.0, 4.0, 5.01):
        watch.see(setpoints(sender), t_s)
    one = watch.messages["SequencerSetpoints"]
    assert one.age_s(5.0) == 0.0
    assert one.frames == 3
