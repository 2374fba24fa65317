"""What a process does to keep a rate on a general-purpose kernel, and what it was granted.

The garbage collector is told to leave alone what was there before the loop began: a full collection walks through all
of it, tens of milliseconds in this program. On request (`urgent`) the process also asks for a real-time priority and
to have its memory kept in; both need rights that a user may not have, so refusals are told, not raised.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

PRIORITY = 20
"""Of SCHED_FIFO (1 … 99): above everything ordinary, below a kernel's own threads (50)."""

_KEEP_WHAT_IS_USED = 7  # MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT: not what is only reserved, which is gigabytes


class Granted(NamedTuple):
    """What was granted, and in `refused` what was not and why, as a sentence each."""

    priority: bool
    memory_kept: bool
    refused: tuple[str, ...]


def swaps(table: Path = Path("/proc/swaps")) -> bool:
    """Whether this machine has somewhere to swap to; without it there is nothing to keep from it."""
    try:
        return len(table.read_text(encoding="ascii").splitlines()) > 1
    except OSError:
        return True


@contextlib.contextmanager
def real_time(urgent: bool = False) -> Iterator[Granted]:
    """For the time of a loop; everything is put back at the end (memory that is kept in stays so)."""
    gc.collect()
    gc.freeze()
    before: tuple[int, os.sched_param] | None = None
    memory_kept = False
    refused: list[str] = []
    try:
        if urgent:
            policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
            try:
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
                before = (policy, parameter)
            except OSError as error:
                refused.append(
                    f"no real-time priority: {error.strerror} (needs root, CAP_SYS_NICE, or "
                    f"`@softbot - rtprio {PRIORITY}` in /etc/security/limits.conf)"
                )
            memory_kept = not swaps() or ctypes.CDLL(None, use_errno=True).mlockall(_KEEP_WHAT_IS_USED) == 0
            if not memory_kept:
                refused.append(
                    f"memory may be swapped out: {os.strerror(ctypes.get_errno())} (needs root, CAP_IPC_LOCK, or "
                    "`@softbot - memlock unlimited` in /etc/security/limits.conf)"
                )
        yield Granted(before is not None, memory_kept, tuple(refused))
    finally:
        if before is not None:
            os.sched_setscheduler(0, *before)
        gc.unfreeze()
