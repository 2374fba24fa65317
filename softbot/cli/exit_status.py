"""What the shell is told: 0 done, 2 bad input, 3 the simulation failed; one message, no traceback.

130 says interrupted (Ctrl-C) and 143 terminated (SIGTERM); both bring what the command was doing to an end, and what it
recorded is kept.
"""

from __future__ import annotations

import contextlib
import functools
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import ParamSpec

import typer

from firmware_protocol.errors import ProtocolError
from softbot.errors import InputError, SoftbotError

Options = ParamSpec("Options")

INTERRUPTED = 130
TERMINATED = 143


class Terminated(KeyboardInterrupt):
    """SIGTERM came."""


def with_exit_status(command: Callable[Options, None]) -> Callable[Options, None]:
    """The command with every foreseen failure turned into a message on standard error and an exit status."""

    @functools.wraps(command)
    def guarded(*args: Options.args, **options: Options.kwargs) -> None:
        try:
            with _terminable():
                command(*args, **options)
        except Terminated:
            _end("terminated", TERMINATED)
        except KeyboardInterrupt:
            _end("interrupted", INTERRUPTED)
        except SoftbotError as error:
            _end(str(error), error.exit_status)
        except ProtocolError as error:
            _end(str(error), InputError.exit_status)
        except OSError as error:  # a path that no file system takes, a stream that is full
            _end(in_words(error), InputError.exit_status)
        except Exception as error:  # Ctrl-C in the compiler, which then stumbles over what it left half-made
            interruption = _interruption(error)
            if interruption is None:
                raise
            what = f"in its wake {type(error).__name__}: {error}"
            if isinstance(interruption, Terminated):
                _end(f"terminated; {what}", TERMINATED)
            _end(f"interrupted; {what}", INTERRUPTED)

    return guarded


def in_words(error: OSError) -> str:
    """What the operating system refused, and of which file."""
    where = f"{error.filename}: " if error.filename else ""
    return f"{where}{error.strerror or error}"


def _interruption(error: BaseException | None) -> KeyboardInterrupt | None:
    """The interruption in whose wake an error came; None where it came by itself."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error


@contextlib.contextmanager
def _terminable() -> Iterator[None]:
    """SIGTERM raises Terminated here, once; the next one ends the process."""

    def end(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        raise Terminated

    if threading.current_thread() is not threading.main_thread():  # only there can signals be handled
        yield
        return
    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _end(message: str, status: int) -> None:
    typer.echo(f"softbot: {message}", err=True)
    raise typer.Exit(status)
