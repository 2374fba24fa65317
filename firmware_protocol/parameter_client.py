"""The sequencer's end of the parameters: one request at a time, repeated when no answer comes, given up at last."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

from firmware_protocol.codec import encode
from firmware_protocol.enumerations import AbortCode, Parameter, ParameterOperation
from firmware_protocol.spec import message_spec, time_us

ANSWER_TIMEOUT_US = 100_000
TRIES = 3
_TRANSACTIONS = 256
_KEPT = 32


class ParameterOutcome(NamedTuple):
    """How a request ended. `abort_code` and `value` are None when the board never answered."""

    parameter: int
    abort_code: AbortCode | None
    value: int | None


class ParameterClient:
    """Requests wait in `waiting`; `outcomes` keeps the last ones, `values` the newest value of each parameter."""

    def __init__(self) -> None:
        self.waiting: deque[tuple[ParameterOperation, int, int]] = deque()
        self.outcomes: deque[ParameterOutcome] = deque(maxlen=_KEPT)
        self.values: dict[int, int] = {}
        self._asked: tuple[ParameterOperation, int, int] | None = None
        self._transaction = 0
        self._tries = 0
        self._sent_us = self._next_us = 0
        self._gap_us = time_us(message_spec("ParameterRequest").minimum_gap_s)

    def read(self, parameter: Parameter | int) -> None:
        """Asks for a value. Raises FrameError for a number that is not from 0 to 255."""
        self._ask(ParameterOperation.READ, int(parameter), 0)

    def write(self, parameter: Parameter | int, value: int) -> None:
        """Asks to lower a value, in the parameter's unit (`parameters.PARAMETERS`). Raises FrameError if it is not a
        whole number from 0 to 2^32 - 1."""
        self._ask(ParameterOperation.WRITE, int(parameter), value)

    def _ask(self, operation: ParameterOperation, parameter: int, value: int) -> None:
        signals = {"Operation": operation, "Parameter": parameter, "Transaction": 0, "Value": value}
        encode("ParameterRequest", signals)  # refused here, and not in the control loop
        self.waiting.append((operation, parameter, value))

    def due(self, now_us: int) -> dict[str, float] | None:
        """The signals of the ParameterRequest to be sent now, if there is one."""
        if now_us < self._next_us:
            return None
        if self._asked is not None and self._tries == TRIES:
            self.outcomes.append(ParameterOutcome(self._asked[1], None, None))
            self._asked = None
        if self._asked is None:
            if not self.waiting:
                return None
            self._asked, self._tries = self.waiting.popleft(), 0
            self._transaction = (self._transaction + 1) % _TRANSACTIONS
        self._tries += 1
        self._sent_us, self._next_us = now_us, now_us + ANSWER_TIMEOUT_US
        operation, parameter, value = self._asked
        return {"Operation": operation, "Parameter": parameter, "Transaction": self._transaction, "Value": value}

    def take(self, raw: Mapping[str, int]) -> None:
        """Takes an accepted ParameterResponse (its raw signals); an answer to something else is let pass."""
        if self._asked is None or (raw["Parameter"], raw["Transaction"]) != (self._asked[1], self._transaction):
            return
        self._asked = None
        self._next_us = self._sent_us + self._gap_us
        self.outcomes.append(ParameterOutcome(raw["Parameter"], AbortCode(raw["AbortCode"]), raw["Value"]))
        if raw["AbortCode"] != AbortCode.UNKNOWN_PARAMETER:
            self.values[raw["Parameter"]] = raw["Value"]

    def restart(self, now_us: int) -> None:
        """For a clock that went backwards: the answer that is waited for gets its whole time again."""
        self._next_us = min(self._next_us, now_us + ANSWER_TIMEOUT_US)
