"""When a node's cyclic messages are due, from the DBC's cycle times. Pure: the caller's loop brings the time.

Sending from the control loop itself, and not from a periodic task of the kernel or a thread, is what makes a
stopped process fall silent.
"""

from __future__ import annotations

from firmware_protocol.spec import spec, time_us

_SLACK_US = 4_000
"""A loop of 10 ms that comes up to this much early still sends in the cycle it belongs to."""


class Schedule:
    """The cyclic messages that `node` sends. The first call finds all of them due."""

    def __init__(self, node: str) -> None:
        self.period_us: dict[str, int] = {
            message.name: time_us(message.cycle_s)
            for message in spec().messages
            if message.sender == node and message.cycle_s is not None
        }
        self.next_us: dict[str, int] = {}

    def due(self, name: str, t_us: int) -> bool:
        """Whether `name` is to be sent now; if so, the next time is one period after the one planned.

        Cycles that were missed are left out rather than sent in a burst, and a clock that went backwards
        starts the cycle anew.
        """
        period_us = self.period_us[name]
        next_us = self.next_us.get(name, t_us)
        if t_us + 2 * period_us < next_us:
            next_us = t_us
        if t_us + min(_SLACK_US, period_us // 2) < next_us:
            return False
        next_us += period_us
        self.next_us[name] = next_us if next_us > t_us else t_us + period_us
        return True
