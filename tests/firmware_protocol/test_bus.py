"""Buses open by name or say what to do; two nodes of one process exchange frames on the virtual one."""

from __future__ import annotations

import logging
from typing import Any

import can
import pytest

from firmware_protocol.bus import drain, open_bus, opened, send, to_frame
from firmware_protocol.errors import BusError
from firmware_protocol.frame import Frame

FRAMES = [Frame(0x110, bytes(range(8))), Frame(0x010, b"\x01\x02"), Frame(0x7FF, b"")]


def test_two_nodes_on_a_virtual_bus_exchange_frames_with_simulated_time() -> None:
    with opened("virtual", "two-nodes") as sequencer, opened("virtual", "two-nodes") as board:
        send(sequencer, FRAMES, 1.25)
        assert list(drain(board)) == [(frame, 1.25) for frame in FRAMES]
        assert list(drain(board)) == []
        assert list(drain(sequencer)) == []
        send(board, FRAMES[:1], 2.5)
        assert list(drain(sequencer)) == [(FRAMES[0], 2.5)]


def test_own_frames_come_back_on_request() -> None:
    with opened("virtual", "own-frames", receive_own_messages=True) as bus:
        send(bus, FRAMES, 0.5)
        assert [frame for frame, _ in drain(bus)] == FRAMES


def test_what_is_no_classic_data_frame_is_left_out() -> None:
    with opened("virtual", "strange") as sender, opened("virtual", "strange") as receiver:
        for strange in (
            can.Message(arbitration_id=0x110, is_extended_id=True, data=b"1"),
            can.Message(arbitration_id=0x110, is_extended_id=False, is_remote_frame=True),
            can.Message(is_error_frame=True),
            can.Message(arbitration_id=0x110, is_extended_id=False, is_fd=True, data=bytes(12)),
        ):
            assert to_frame(strange) is None
            sender.send(strange)
        send(sender, FRAMES[:1], 1.0)
        assert list(drain(receiver)) == [(FRAMES[0], 1.0)]


def test_an_unknown_interface_is_named_with_those_there_are() -> None:
    with pytest.raises(BusError, match=r"'carrier-pigeon' \(channel 'roof'\) is unknown.*socketcan.*virtual"):
        open_bus("carrier-pigeon", "roof")


def test_a_missing_socketcan_channel_says_how_to_make_it(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL)
    with pytest.raises(BusError, match=r"'socketcan', channel 'nocan7'.*ip link add dev nocan7 type vcan"):
        open_bus("socketcan", "nocan7")


def test_a_missing_adapter_says_what_to_check(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL)
    with pytest.raises(BusError, match=r"'slcan', channel '/no/such/port'.*check that the adapter"):
        open_bus("slcan", "/no/such/port")


def test_the_bit_rate_goes_to_interfaces_that_set_one(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[dict[str, Any]] = []
    monkeypatch.setattr(can, "Bus", lambda channel, interface, **options: seen.append(options))
    open_bus("slcan", "port")
    open_bus("socketcan", "can0")
    open_bus("pcan", "usb", bitrate=250_000)
    assert [options.get("bitrate") for options in seen] == [500_000, None, 250_000]
    assert all(options["ignore_config"] for options in seen)


def test_a_bus_that_is_gone_says_so() -> None:
    bus = open_bus("virtual", "gone")
    bus.shutdown()
    with pytest.raises(BusError, match="cannot send on Virtual bus channel gone"):
        send(bus, FRAMES, 0.0)
    with pytest.raises(BusError, match="cannot receive on Virtual bus channel gone"):
        list(drain(bus))


def test_a_bus_is_shut_down_when_its_block_fails() -> None:
    with pytest.raises(RuntimeError), opened("virtual", "failing") as bus:
        raise RuntimeError
    with pytest.raises(BusError):
        send(bus, FRAMES, 0.0)
