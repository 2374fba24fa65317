"""A node lets in its own listed messages only, and remembers what it had to refuse."""

from __future__ import annotations

import pytest

from firmware_protocol.codec import dbc_hash
from firmware_protocol.e2e import FrameStatus, Sender, protect
from firmware_protocol.errors import LimitsError
from firmware_protocol.reception import Reception, ReceptionLimits
from firmware_protocol.spec import spec

SETPOINTS = {f"Setpoint{chamber}": 100.0 for chamber in range(4)}


def test_the_whole_identifier_space_but_the_list_is_refused() -> None:
    for node, own in (("Board", "Sequencer"), ("Sequencer", "Board")):
        reception = Reception(node)
        listed = {each.frame_id: each.length_bytes for each in spec().messages if each.sender == own}
        for frame_id in range(2048):
            for length in range(9):
                received = reception.accept(frame_id, bytes(length), 0)
                assert not received.status.accepted
                assert received.signals == {}
                if frame_id not in listed:
                    assert received.status is FrameStatus.NOT_LISTED
                elif listed[frame_id] != length:
                    assert received.status is FrameStatus.MALFORMED
        assert reception.not_listed == (2048 - len(listed)) * 9


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
