"""What the shell is told: 0 done, 2 bad input, 3 the simulation failed, 130 interrupted; one message, no traceback."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec

import typer

from firmware_protocol.errors import ProtocolError
from softbot.errors import InputError, SoftbotError

Options = ParamSpec("Options")

INTERRUPTED = 130


def with_exit_status(command: Callable[Options, None]) -> Callable[Options, None]:
    """The command with every foreseen failure turned into a message on standard error and an exit status."""

    @functools.wraps(command)
    def guarded(*args: Options.args, **options: Options.kwargs) -> None:
        try:
            command(*args, **options)
        except KeyboardInterrupt:
            _end("interrupted", INTERRUPTED)
        except SoftbotError as error:
            _end(str(error), error.exit_status)
        except ProtocolError as error:
            _end(str(error), InputError.exit_status)
        except OSError as error:  # a path that no file system takes, a stream that is full
            where = f"{error.filename}: " if error.filename else ""
            _end(f"{where}{error.strerror or error}", InputError.exit_status)

    return guarded


def _end(message: str, status: int) -> None:
    typer.echo(f"softbot: {message}", err=True)
    raise typer.Exit(status)
