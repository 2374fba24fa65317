"""Ctrl-C, SIGTERM and a terminal that hangs up, heard even where a library swallows them.

Each raises in whatever the main thread happens to be doing, and that may be Python code which C code has called and
whose error it takes for a "no": numba's dispatcher does, when it asks a record for its type. So what was asked for is
remembered until the command ends, and the loop of a long run asks for it (`raise_if_asked`). Commands that keep time
with the wall clock are not broken off but asked to stop (`stopped_by_signals`).
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

Handler = Callable[[int, FrameType | None], None]


class Terminated(KeyboardInterrupt):
    """SIGTERM came."""


class HungUp(KeyboardInterrupt):
    """SIGHUP came: the terminal was closed, the connection to it lost."""


_RAISES: dict[signal.Signals, type[KeyboardInterrupt]] = {
    signal.SIGINT: KeyboardInterrupt,
    signal.SIGTERM: Terminated,
    signal.SIGHUP: HungUp,
}
_asked: type[KeyboardInterrupt] | None = None
_terminal_is_gone = False


def terminal_is_gone() -> bool:
    """Whether SIGHUP has come since the command began: what was a terminal is nowhere now."""
    return _terminal_is_gone


def interruption_asked() -> type[KeyboardInterrupt] | None:
    """What a signal has raised since the command began, whether it was heard or not."""
    return _asked


def raise_if_asked() -> None:
    """Raise again what a signal has raised and nobody has heard, or the loop that asks would not go on."""
    if _asked is not None:
        raise _asked


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """SIGINT raises KeyboardInterrupt here, as ever, SIGTERM Terminated and SIGHUP HungUp.

    Ctrl-C interrupts as often as it is pressed. Of SIGTERM and SIGHUP only the first raises, if nothing has before it:
    a shell that is closed sends several, and what is being brought to an end must not be broken off. The second SIGTERM
    ends the process. A process that was started deaf to a signal stays so (`nohup`, a script's background), and off the
    main thread, where no signal is handled, nothing changes.
    """

    def ask(number: int, frame: FrameType | None) -> None:
        global _asked
        before, _asked = _asked, _asked or _RAISES[signal.Signals(number)]
        if number == signal.SIGTERM:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
        if number == signal.SIGINT or before is None:
            raise _RAISES[signal.Signals(number)]

    global _asked, _terminal_is_gone
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    try:
        with _handled(ask, [one for one in _RAISES if signal.getsignal(one) is not signal.SIG_IGN]):
            yield
    finally:
        _asked, _terminal_is_gone = None, False


@contextlib.contextmanager
def stopped_by_signals() -> Iterator[threading.Event]:
    """An event that the same signals set; the next SIGINT or SIGTERM then does what it did before.

    SIGHUP leaves those as they are, as a shell that is closed sends several signals. SIGINT sets the event even in a
    script's background: there it is how the script says that it is over.
    """
    stop, asked = threading.Event(), False
    deaf = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    signals = [one for one in _RAISES if not (deaf and one == signal.SIGHUP)]
    before: dict[signal.Signals, Any] = {one: signal.getsignal(one) for one in signals}

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if number != signal.SIGHUP:
            for one in (signal.SIGINT, signal.SIGTERM):
                signal.signal(one, before[one])
        if not asked:  # the event's lock is held while it is set, and a second signal may come there
            asked = True
            stop.set()

    with _handled(ask, signals):
        yield stop


def left_to_the_parent() -> None:
    """For a process that works for another: the other hears the signal, which comes to the whole group, and ends it.

    Else it would die first, and its death be taken for the outcome of what it was at.
    """
    for one in _RAISES:
        signal.signal(one, signal.SIG_IGN)


@contextlib.contextmanager
def _handled(handler: Handler, signals: list[signal.Signals]) -> Iterator[None]:
    terminals = [number for number in (0, 1, 2) if _is_terminal(number)]

    def handle(number: int, frame: FrameType | None) -> None:
        global _terminal_is_gone
        if number == signal.SIGHUP:  # what is still to be said must not fail for want of one who hears it
            signal.signal(signal.SIGHUP, signal.SIG_IGN)
            _terminal_is_gone = True
            nowhere = os.open(os.devnull, os.O_RDWR)
            for terminal in terminals:
                os.dup2(nowhere, terminal)
            os.close(nowhere)
        handler(number, frame)

    before: dict[signal.Signals, Any] = {one: signal.signal(one, handle) for one in signals}
    try:
        yield
    finally:
        for one, was in before.items():
            signal.signal(one, was if was is not None else signal.SIG_DFL)


def _is_terminal(number: int) -> bool:
    try:
        return os.isatty(number)
    except OSError:  # closed by the caller
        return False
