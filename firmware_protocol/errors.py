"""The family of exceptions of the protocol; its own, because this package imports nothing of the project."""

from __future__ import annotations


class ProtocolError(Exception):
    """Any failure that the protocol package foresees."""


class FrameError(ProtocolError):
    """A frame or a signal that the DBC does not allow: unknown id, wrong length, value out of range."""


class SpecError(ProtocolError):
    """The DBC itself lacks something that the codec or the protection needs."""


class LimitsError(ProtocolError):
    """Limits of the board or of the link that contradict each other or the DBC."""


class BusError(ProtocolError):
    """A CAN bus that cannot be opened or used. The message names interface and channel, and the mend."""


class TraceError(ProtocolError):
    """A trace that cannot be written or is not one."""


class CompilerError(ProtocolError):
    """The C reference cannot be written or compiled. The message says what is missing, or what the compiler said."""


class BusFaultError(ProtocolError):
    """A fault of the bus that cannot be injected. The message names file, key and the mend."""
