"""What a CAN controller says of itself, read from the error frames that SocketCAN delivers beside the data frames.

Classes and bytes are those of Linux's `linux/can/error.h`; fault confinement is that of ISO 11898-1. Controllers that
deliver no error frames (virtual buses, many adapters) stay error-active here with counters of zero.
"""

from __future__ import annotations

from firmware_protocol.enumerations import BusState

CLASS_CONTROLLER, CLASS_BUS_OFF, CLASS_RESTARTED, CLASS_COUNTERS = 0x004, 0x040, 0x100, 0x200
PASSIVE_BITS, ACTIVE_BIT = 0x30, 0x40
"""In data byte 1 of a frame of class controller: error-passive at either counter; active again."""
_CONTROLLER_BYTE, _TRANSMIT_BYTE, _RECEIVE_BYTE = 1, 6, 7
_PASSIVE_FROM = 128


class ControllerState:
    """`bus_state`, `transmit_errors` and `receive_errors` (0 to 255), as of the last error frame."""

    def __init__(self) -> None:
        self.bus_state = BusState.ERROR_ACTIVE
        self.transmit_errors = 0
        self.receive_errors = 0

    def take(self, error_class: int, data: bytes) -> None:
        """Take over an error frame: its class bits (the identifier without its flags) and its data, 8 bytes."""
        data = data.ljust(8, b"\0")
        if error_class & CLASS_RESTARTED:
            self.bus_state, self.transmit_errors, self.receive_errors = BusState.ERROR_ACTIVE, 0, 0
        if error_class & CLASS_COUNTERS:
            self.transmit_errors, self.receive_errors = data[_TRANSMIT_BYTE], data[_RECEIVE_BYTE]
            passive = max(self.transmit_errors, self.receive_errors) >= _PASSIVE_FROM
            self.bus_state = BusState.ERROR_PASSIVE if passive else BusState.ERROR_ACTIVE
        if error_class & CLASS_CONTROLLER:
            if data[_CONTROLLER_BYTE] & PASSIVE_BITS:
                self.bus_state = BusState.ERROR_PASSIVE
            elif data[_CONTROLLER_BYTE] & ACTIVE_BIT:
                self.bus_state = BusState.ERROR_ACTIVE
        if error_class & CLASS_BUS_OFF:
            self.bus_state = BusState.BUS_OFF
