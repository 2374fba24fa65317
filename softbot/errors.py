"""The one family of exceptions that a user of softbot can meet.

The command line turns each into one message without a traceback: `InputError` ends with exit status 2,
`SimulationError` with 3 (what was recorded is kept).
"""

from __future__ import annotations

from typing import ClassVar


class SoftbotError(Exception):
    """Any failure that softbot foresees. `exit_status` is what the command line ends with."""

    exit_status: ClassVar[int] = 1


class InputError(SoftbotError):
    """Bad input: a file, a key, a value. The message names it and the mend."""

    exit_status: ClassVar[int] = 2


class KinkError(InputError):
    """A curvature, a strain or a moment beyond the stable branch of the tube: the tube would kink."""


class UnreachableError(InputError):
    """A wanted bend that no permitted chamber pressure can give."""


class SimulationError(SoftbotError):
    """The simulation left the region where it means anything (not finite, not converging)."""

    exit_status: ClassVar[int] = 3
