"""Ctrl-C and SIGTERM, heard even where a library swallows them.

Either raises in whatever the main thread happens to be doing, and that may be Python code which C code has called and
whose error it takes for a "no": numba's dispatcher does, when it asks a record for its type. So what was asked for is
remembered until the command ends, and the loop of a long run asks for it (`raise_if_asked`).
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType


class Terminated(KeyboardInterrupt):
    """SIGTERM came."""


_asked: type[KeyboardInterrupt] | None = None


def interruption_asked() -> type[KeyboardInterrupt] | None:
    """What a signal has raised since the command began, whether it was heard or not."""
    return _asked


def raise_if_asked() -> None:
    """Raise again what a signal has raised and nobody has heard, or the loop that asks would not go on."""
    if _asked is not None:
        raise _asked


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """SIGINT raises KeyboardInterrupt here, as ever; SIGTERM raises Terminated, and the next one ends the process.

    Who was started deaf to SIGINT stays so, and off the main thread, where no signal is handled, nothing changes.
    """

    def ask(number: int, frame: FrameType | None) -> None:
        global _asked
        if number == signal.SIGINT:
            _asked = KeyboardInterrupt
        else:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            _asked = Terminated
        raise _asked

    global _asked
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {one: signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)}
    if before[signal.SIGINT] is not signal.default_int_handler:
        del before[signal.SIGINT]
    for one in before:
        signal.signal(one, ask)
    try:
        yield
    finally:
        _asked = None
        for one, handler in before.items():
            signal.signal(one, handler if handler is not None else signal.SIG_DFL)
