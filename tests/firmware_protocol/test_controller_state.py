"""Fault confinement as the kernel's error frames tell it; frames written after linux/can/error.h."""

from __future__ import annotations

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.bus import drain, opened
from firmware_protocol.controller_state import ControllerState
from firmware_protocol.enumerations import BusState
from firmware_protocol.frame import Frame

WARNING = (0x004, bytes([0, 0x08, 0, 0, 0, 0, 0, 0]))
PASSIVE = (0x204, bytes([0, 0x20, 0, 0, 0, 0, 136, 3]))
ACTIVE = (0x204, bytes([0, 0x40, 0, 0, 0, 0, 95, 0]))
COUNTERS = (0x200, bytes([0, 0, 0, 0, 0, 0, 12, 130]))
NO_ACKNOWLEDGEMENT = (0x020, bytes(8))
BUS_OFF = (0x040, bytes(8))
RESTARTED = (0x100, bytes(8))


@pytest.mark.parametrize(
    ("frames", "state", "errors"),
    [
        ([], BusState.ERROR_ACTIVE, (0, 0)),
        ([WARNING], BusState.ERROR_ACTIVE, (0, 0)),
        ([NO_ACKNOWLEDGEMENT], BusState.ERROR_ACTIVE, (0, 0)),
        ([PASSIVE], BusState.ERROR_PASSIVE, (136, 3)),
        ([PASSIVE, WARNING], BusState.ERROR_PASSIVE, (136, 3)),
        ([PASSIVE, ACTIVE], BusState.ERROR_ACTIVE, (95, 0)),
        ([COUNTERS], BusState.ERROR_PASSIVE, (12, 130)),
        ([PASSIVE, BUS_OFF], BusState.BUS_OFF, (136, 3)),
        ([BUS_OFF, RESTARTED], BusState.ERROR_ACTIVE, (0, 0)),
        ([(0x040, b"")], BusState.BUS_OFF, (0, 0)),
    ],
)
def test_the_last_word_of_the_controller_holds(
    frames: list[tuple[int, bytes]], state: BusState, errors: tuple[int, int]
) -> None:
    controller = ControllerState()
    for error_class, data in frames:
        controller.take(error_class, data)
    assert controller.bus_state is state
    assert (controller.transmit_errors, controller.receive_errors) == errors


@given(st.integers(0, (1 << 29) - 1), st.binary(max_size=8))
def test_no_error_frame_is_too_strange(error_class: int, data: bytes) -> None:
    controller = ControllerState()
    controller.take(error_class, data)
    assert 0 <= controller.transmit_errors <= 255
    assert 0 <= controller.receive_errors <= 255


def test_error_frames_are_told_apart_from_what_nodes_say() -> None:
    controller = ControllerState()
    with opened("virtual", "controller-state") as near, opened("virtual", "controller-state") as far:
        far.send(can.Message(is_error_frame=True, arbitration_id=PASSIVE[0], data=PASSIVE[1]))
        far.send(can.Message(arbitration_id=0x100, data=b"\x01", is_extended_id=False))
        assert [frame for frame, _ in drain(near, controller)] == [Frame(0x100, b"\x01")]
    assert controller.bus_state is BusState.ERROR_PASSIVE
