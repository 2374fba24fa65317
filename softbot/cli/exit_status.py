"""What the shell is told: 0 done, 2 bad input, 3 the simulation failed; one message, no traceback.

129 says hung up (SIGHUP: the terminal is gone), 130 interrupted (Ctrl-C) and 143 terminated (SIGTERM); each brings what
the command was doing to an end, and what it recorded is kept.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec

import typer

from firmware_protocol.errors import ProtocolError
from softbot.errors import InputError, SoftbotError
from softbot.interruption import HungUp, Terminated, interruptible, interruption_asked

Options = ParamSpec("Options")

_INTERRUPTIONS: dict[type[KeyboardInterrupt], tuple[str, int]] = {
    KeyboardInterrupt: ("interrupted", 130),
    Terminated: ("terminated", 143),
    HungUp: ("hung up", 129),
}


def with_exit_status(command: Callable[Options, None]) -> Callable[Options, None]:
    """The command with every foreseen failure turned into a message on standard error and an exit status."""

    @functools.wraps(command)
    def guarded(*args: Options.args, **options: Options.kwargs) -> None:
        with interruptible():
            try:
                command(*args, **options)
            except KeyboardInterrupt as interruption:
                _end_interrupted(type(interruption))
            except SoftbotError as error:
                if (asked := interruption_asked()) is not None:
                    _end_interrupted(asked, f"; in its wake: {error}")
                _end(str(error), error.exit_status)
            except ProtocolError as error:
                _end(str(error), InputError.exit_status)
            except OSError as error:  # a path that no file system takes, a stream that is full
                _end(in_words(error), InputError.exit_status)
            except Exception as error:  # Ctrl-C in the compiler, which then stumbles over what it left half-made
                before = _interruption_before(error)
                if before is None:
                    raise
                _end_interrupted(before, f"; in its wake {type(error).__name__}: {error}")

    return guarded


def in_words(error: OSError) -> str:
    """What the operating system refused, and of which file."""
    where = f"{error.filename}: " if error.filename else ""
    return f"{where}{error.strerror or error}"


def _interruption_before(error: BaseException | None) -> type[KeyboardInterrupt] | None:
    """The interruption in whose wake an error came; None where it came by itself."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return type(error)
        error = error.__cause__ or error.__context__
    return interruption_asked()


def _end_interrupted(interruption: type[KeyboardInterrupt], what: str = "") -> None:
    said, status = _INTERRUPTIONS[interruption]
    _end(f"{said}{what}", status)


def _end(message: str, status: int) -> None:
    typer.echo(f"softbot: {message}", err=True)
    raise typer.Exit(status)
