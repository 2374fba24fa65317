"""A node lets in its own listed messages only, and remembers what it had to refuse."""

from __future__ import annotations

import pytest

from firmware_protocol.codec import dbc_hash
from firmware_protocol.e2e import FrameStatus, Sender, protect
from firmware_protocol.errors import LimitsError
from firmware_protocol.reception import Reception, ReceptionLimits

SETPOINTS = {f"Setpoint{chamber}": 100.0 for chamber in range(4)}


def test_accepted_frames_are_decoded_and_dated() -> None:
    reception = Reception("Board")
    assert reception.age_us("SequencerSetpoints", 5) is None
    received = reception.accept(*Sender().send("SequencerSetpoints", SETPOINTS), 1000)
    assert (received.status, received.name) == (FrameStatus.INITIAL, "SequencerSetpoints")
    assert received.signals["Setpoint2"] == pytest.approx(100.0)
    assert reception.age_us("SequencerSetpoints", 1500) == 500
    reception.forget_times()
    assert reception.age_us("SequencerSetpoints", 1500) is None


def test_values_out_of_range_under_a_right_crc_are_malformed() -> None:
    reception = Reception("Board")
    data = protect("SequencerControl", bytes([0, 0x70, 0, 0, 0, 0, 0, 0]), 0)  # Mode 7 has no meaning
    received = reception.accept(0x100, data, 0)
    assert received.status is FrameStatus.MALFORMED
    assert reception.messages["SequencerControl"].counts[FrameStatus.MALFORMED] == 1
    assert reception.messages["SequencerControl"].counts[FrameStatus.INITIAL] == 0
    assert reception.age_us("SequencerControl", 0) is None


def test_refusals_beyond_the_tolerance_are_reported_until_good_frames_push_them_out() -> None:
    reception = Reception("Board", ReceptionLimits(window_frames=8, tolerated_errors=2))
    sender = Sender()
    bad = bytes(8)
    verdicts = [reception.accept(0x110, bad, 0).beyond_tolerance for _ in range(4)]
    assert verdicts == [False, False, True, True]
    for _ in range(7):
        assert reception.accept(*sender.send("SequencerSetpoints", SETPOINTS), 0).status.accepted
    assert not reception.accept(0x110, bad, 0).beyond_tolerance
    reception.forgive()
    assert [reception.accept(0x110, bad, 0).beyond_tolerance for _ in range(3)] == [False, False, True]


def test_errors_of_one_message_do_not_count_for_another() -> None:
    reception = Reception("Board", ReceptionLimits(tolerated_errors=0))
    assert reception.accept(0x110, bytes(8), 0).beyond_tolerance
    control = {"Mode": 0, "ArmToken": 0, "DbcHash": dbc_hash()}
    assert reception.accept(*Sender().send("SequencerControl", control), 0).status.accepted


def test_exempt_messages_need_the_crc_but_not_the_counter() -> None:
    reception = Reception("Board", counter_exempt=frozenset({"EmergencyStop"}))
    stop = protect("EmergencyStop", bytes(2), 5)
    assert [reception.accept(0x010, stop, 0).status for _ in range(3)] == [FrameStatus.OK] * 3
    corrupt = bytes([stop[0] ^ 1, stop[1]])
    assert reception.accept(0x010, corrupt, 0).status is FrameStatus.WRONG_CRC


@pytest.mark.parametrize(
    "bad",
    [{"max_counter_delta": 0}, {"max_counter_delta": 15}, {"tolerated_errors": -1}, {"window_frames": 3}],
)
def test_limits_that_mean_nothing_are_refused(bad: dict[str, int]) -> None:
    with pytest.raises(LimitsError, match="must be from"):
        ReceptionLimits(**bad)


@pytest.mark.parametrize(("good_between", "beyond"), [(2, True), (3, False)])
def test_the_window_is_as_long_as_it_says(good_between: int, beyond: bool) -> None:
    reception = Reception("Board", ReceptionLimits(window_frames=4, tolerated_errors=1))
    sender = Sender()
    assert not reception.accept(0x110, bytes(8), 0).beyond_tolerance
    for _ in range(good_between):
        reception.accept(*sender.send("SequencerSetpoints", SETPOINTS), 0)
    assert reception.accept(0x110, bytes(8), 0).beyond_tolerance == beyond


def test_a_wrong_crc_is_named_so_whatever_the_frame_says() -> None:
    reception = Reception("Board")
    data = protect("SequencerControl", bytes([0, 0x70, 0, 0, 0, 0, 0, 0]), 0)
    received = reception.accept(0x100, bytes([data[0] ^ 1]) + data[1:], 0)
    assert (received.status, received.raw) == (FrameStatus.WRONG_CRC, {})


def test_limits_at_their_edges_are_taken() -> None:
    for limits in (ReceptionLimits(1, 1, 0), ReceptionLimits(14, 16, 15)):
        assert Reception("Board", limits).limits is limits
