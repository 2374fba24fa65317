"""`softbot hub`: a CAN bus for the programs of this machine, where the kernel has none."""

from __future__ import annotations

from typing import Annotated

import typer


def hub(
    channel: Annotated[
        str, typer.Option(help="Its name, the path of a socket, or localhost:PORT; as nodes name it.")
    ] = "softbot",
    paced: Annotated[
        bool, typer.Option("--paced", help="No faster than the protocol's bit rate: each frame takes its time.")
    ] = False,
) -> None:
    """Be a CAN bus for the programs of this machine.

    Nodes join with --interface hub --channel NAME; without a hub the first of them starts one. Goes on until stopped.
    """
    from firmware_protocol.hub import address_of, run_hub
    from firmware_protocol.spec import spec
    from softbot.cli.streams import say
    from softbot.interruption import stopped_by_signals

    address = address_of(channel)
    with stopped_by_signals() as stop:
        done = run_hub(
            channel,
            spec().bitrate_bit_s if paced else None,
            stop=stop.is_set,
            ready=lambda: say(f"hub on {address}; join it with --interface hub --channel {channel}"),
        )
    say(f"carried {done.carried} frames; {done.dropped} were lost at clients that did not read")
