"""Which implementation of the board's rules decides in a plant: the one in Python, or the C reference.

Both decide the same (docs/firmware.md); the C one is what a firmware team takes, put in the plant's place to be tried.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from firmware_protocol.board import BoardRules
    from firmware_protocol.board_limits import BoardLimits
    from firmware_protocol.c_board import CBoardRules


class DecidingBoard(StrEnum):
    """The implementations, by the names that commands take."""

    PYTHON = "python"
    C = "c"

    def rules(self, limits: BoardLimits, challenge_seed: int) -> BoardRules | CBoardRules:
        """A board with these limits. Raises CompilerError where the C one cannot be compiled."""
        if self is DecidingBoard.C:
            from firmware_protocol.c_board import CBoardRules

            return CBoardRules(limits, challenge_seed=challenge_seed)
        from firmware_protocol.board import BoardRules

        return BoardRules(limits, challenge_seed=challenge_seed)
