"""Standard output kept for the answer: what libraries print goes to standard error, and progress is shown there too."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from softbot.interruption import terminal_is_gone

if TYPE_CHECKING:
    from rich.console import Console

Advance = Callable[[float], None]


@contextlib.contextmanager
def nothing_printed(quiet: bool = True) -> Iterator[None]:
    """Send what C libraries write to the process's own standard output elsewhere: to standard error, or nowhere.

    PyBullet greets and its window talks, past `sys.stdout`; a JSON object has to stand alone.
    """
    if sys.stdout is None or sys.stderr is None:  # closed by the caller: there is nothing to keep clean
        yield
        return
    sys.stdout.flush()
    saved = [os.dup(number) for number in (1, 2)]
    terminals = [os.isatty(number) for number in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere if quiet else 2, 1)
        if quiet:
            os.dup2(nowhere, 2)
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for number, kept, terminal in zip((1, 2), saved, terminals, strict=True):
            os.dup2(nowhere if terminal and terminal_is_gone() else kept, number)
            os.close(kept)
        os.close(nowhere)


def say(text: str) -> None:
    """Lines on standard error, each with the program's name."""
    import typer

    for line in text.splitlines():
        typer.echo(f"softbot: {line}", err=True)


def messages() -> Console:
    """The console for progress, on standard error; silent when that is no terminal."""
    from rich.console import Console

    console = Console(stderr=True)
    console.quiet = not console.is_terminal
    return console


@contextlib.contextmanager
def progress_bar(title: str, total_s: float) -> Iterator[Advance]:
    """A bar over simulated time on standard error; call it with the time reached [s]. Silent without a terminal."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = messages()
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.1f} of {task.total:.1f} s"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True, disable=console.quiet) as bar:
        task = bar.add_task(title, total=total_s)
        yield lambda t_s: bar.update(task, completed=t_s)
