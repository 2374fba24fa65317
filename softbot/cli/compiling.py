"""Says what a first run waits for: the compiler, once on this machine."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Iterator
from typing import Any

from softbot.cli.streams import messages

OWN = ("softbot", "sim", "controllers")
"""Packages with kernels."""


@contextlib.contextmanager
def told_of_compiling(waiting: str, compiling: str) -> Iterator[None]:
    """Show `waiting` on a terminal while the inside runs, and `compiling` from when numba really compiles something,
    with the module that it has come to.

    numba tells of a compilation only when nothing usable is on disk. Where there is no terminal a plain line on
    standard error says it. From then on the inside runs without garbage collection, which took 6 % of the compiler's
    time to find next to nothing.
    """
    from numba.core import event

    console, collects = messages(), gc.isenabled()
    with console.status(waiting) as status:

        class Listener(event.Listener):
            """Speaks up once, and on a terminal says where it is."""

            def __init__(self) -> None:
                self.told = False

            def on_start(self, event: Any) -> None:
                module = event.data["dispatcher"].py_func.__module__
                if module.partition(".")[0] in OWN:  # and not numba's own
                    status.update(f"{compiling} ({module})")
                if self.told:
                    return
                self.told = True
                gc.disable()
                if console.quiet:
                    import typer

                    typer.echo(f"softbot: {compiling}", err=True)

            def on_end(self, event: Any) -> None:
                pass

        try:
            with event.install_listener("numba:compile", Listener()):
                yield
        finally:
            if collects:
                gc.enable()
