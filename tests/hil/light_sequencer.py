"""A sequencer's end of the link and nothing more, in processes that are forked in no time: for tests that lose many.

Started with a channel of SocketCAN, it forks a process for each line on standard input (the time [s] from arming after
which it falls silent though it goes on, or `inf`) and answers with its number. The process arms the board, commands
40 kPa, and ends when its link fails. A big process would be no use: its forking and its end hold up a small kernel for
as long as the timeouts that are to be measured.
"""

from __future__ import annotations

import contextlib
import gc
import math
import os
import signal
import sys

from firmware_protocol.bus import drain, opened, send
from firmware_protocol.enumerations import SequencerState
from firmware_protocol.errors import BusError
from firmware_protocol.sequencer_link import LinkState, SequencerLink
from softbot.nodes.fixed_rate import FixedRate

PERIOD_S = 0.01
SETPOINT_PA = 40e3
PRIORITY = 20


def sequence(channel: str, silent_after_s: float) -> None:
    """Arm, however often it takes, and command until the link fails; then disarm for five cycles."""
    link = SequencerLink()
    link.arm()
    loop = FixedRate(PERIOD_S)
    cycles_left, armed_s = 5, math.inf
    with opened("socketcan", channel) as bus:
        while cycles_left > 0:
            t_s = loop.wait()
            for frame, _ in drain(bus):
                link.receive(frame.frame_id, frame.data, t_s)
            frames = link.outgoing(t_s, [SETPOINT_PA] * 4, SequencerState.ROLLING)
            if link.armed:
                armed_s = min(armed_s, t_s)
            if t_s - armed_s < silent_after_s:
                send(bus, frames, t_s)
            if link.state is LinkState.FAILED:
                if armed_s == math.inf:
                    link.arm()
                else:
                    cycles_left -= 1


def main() -> None:
    """The zygote."""
    channel = sys.argv[1]
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # who ends is buried
    with opened("virtual", "warm") as bus:  # all is imported before the first fork
        send(bus, SequencerLink().outgoing(0.0, [0.0] * 4), 0.0)
        list(drain(bus))
    print("ready", flush=True)
    gc.collect()
    gc.freeze()
    for line in sys.stdin:
        number = os.fork()
        if number == 0:
            with contextlib.suppress(PermissionError):
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
            with contextlib.suppress(BusError):
                sequence(channel, float(line))
            os._exit(0)
        print(number, flush=True)


if __name__ == "__main__":
    main()
