"""`softbot monitor`: what goes on on a CAN bus, live. It listens and never sends."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated

import typer

from softbot.cli.options import Channel, Interface, Json

if TYPE_CHECKING:
    from rich.console import RenderableType

    from firmware_protocol.bus_watch import BusWatch, MessageWatch

_SHOWN_S = 0.25
_SILENT_S = 1.0
_WIDTH = 160  # characters, in a file


def monitor(
    interface: Interface = "socketcan",
    channel: Channel = "vcan0",
    duration_s: Annotated[
        float | None, typer.Option("--duration-s", help="Stop after this time; default: until stopped.")
    ] = None,
    json: Json = False,
) -> None:
    """Show a CAN bus live: messages, rates, ages, counters, states, protection errors.

    Listens only. With --json, or where standard output is no terminal, shows the bus once, at the end.
    """
    import contextlib
    import json as json_format
    import math

    from rich.console import Console
    from rich.live import Live

    from firmware_protocol.bus_watch import BusWatch
    from softbot.errors import InputError
    from softbot.interruption import stopped_by_signals
    from softbot.nodes.listening import arrived
    from softbot.nodes.wall_clock import open_live

    if duration_s is not None and not 0.0 < duration_s < math.inf:
        raise InputError(f"--duration-s {duration_s:g}: give a positive number of seconds")
    watch, console = BusWatch(), Console()
    title = f"{interface} {channel}"
    live = Live(console=console, auto_refresh=False, screen=True) if console.is_terminal and not json else None
    with stopped_by_signals() as stop, open_live(interface, channel) as bus, live or contextlib.nullcontext():
        started_s = time.monotonic()
        shown_s = -math.inf
        while not stop.is_set() and (duration_s is None or time.monotonic() - started_s < duration_s):
            for frame, stamp_s in arrived(bus, 0.05):
                watch.see(frame, stamp_s)
            if live is not None and time.monotonic() - shown_s >= _SHOWN_S:
                shown_s = time.monotonic()
                live.update(picture(watch, time.time(), title), refresh=True)
    if json:
        typer.echo(json_format.dumps(watch.report(time.time())))
    else:
        wide = Console(width=max(console.width, _WIDTH)) if not console.is_terminal else console
        wide.print(picture(watch, time.time(), title))


def picture(watch: BusWatch, now_s: float, title: str) -> RenderableType:
    """The bus as a table under a line of states."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    silent = all(each.age_s(now_s) > _SILENT_S for each in watch.messages.values())
    states = Text.assemble(
        (title, "bold"),
        f"   {watch.frames} frames, bus load {100.0 * watch.load(now_s):.1f} %",
        ("   silent" if silent else "", "bold red"),
    )
    ends = Text.assemble("board ", *_board(watch), "   sequencer ", *_sequencer(watch))
    table = Table(box=None, pad_edge=False)
    for name, width in (("id", 3), ("message", max(len(name) for name in watch.messages))):
        table.add_column(name, min_width=width, no_wrap=True)
    for name, width in (("rate", 8), ("jitter", 8), ("age", 7), ("counter", 7), ("lost", 4), ("errors", 6)):
        table.add_column(name, justify="right", min_width=width, no_wrap=True)
    table.add_column("content", no_wrap=True, overflow="ellipsis")
    for one in watch.messages.values():
        table.add_row(*_row(one, now_s), style="red" if one.overdue(now_s) else ("dim" if one.frames == 0 else ""))
    for frame_id, count in sorted(watch.unknown.items()):
        table.add_row(f"{frame_id:03X}", "unknown", "", "", "", "", "", "", f"{count} frames", style="yellow")
    return Group(states, ends, Text(), table)


def _board(watch: BusWatch) -> list[tuple[str, str]]:
    mode = watch.named("BoardHeartbeat", "BoardMode")
    if mode is None:
        return [("not heard", "dim")]
    reason = watch.named("BoardHeartbeat", "SafeReason")
    uptime = f" for {watch.messages['BoardHeartbeat'].signals['UptimeS']:.0f} s up"
    style = {"armed": "bold green", "safe_latched": "bold red"}.get(mode, "bold")
    why = f" ({reason.replace('_', ' ')})" if reason not in (None, "none") else ""
    return [(mode.replace("_", " ") + why, style), (uptime, "dim")]


def _sequencer(watch: BusWatch) -> list[tuple[str, str]]:
    state = watch.named("SequencerHeartbeat", "State")
    if state is None:
        return [("not heard", "dim")]
    health = watch.named("SequencerHeartbeat", "Health")
    return [(state, "bold"), (f", health {health}", "red" if health == "failed" else "dim")]


def _row(one: MessageWatch, now_s: float) -> list[str]:
    import math

    jitter_s, age_s = one.jitter_s(), one.age_s(now_s)
    age = "" if math.isinf(age_s) else (f"{1e3 * age_s:.0f} ms" if age_s < 10.0 else f"{age_s:.0f} s")
    return [
        f"{one.message.frame_id:03X}",
        one.message.name,
        f"{one.rate_Hz(now_s):.1f} Hz" if one.frames else "",
        "" if math.isnan(jitter_s) else f"{1e3 * jitter_s:.1f} ms",
        age,
        "" if one.receiver.last_counter is None else str(one.receiver.last_counter),
        str(one.lost) if one.frames else "",
        str(one.errors) if one.frames else "",
        _content(one),
    ]


def _content(one: MessageWatch) -> str:
    units = {signal.name: signal.unit if signal.unit != "1" else "" for signal in one.message.signals}
    choices = {signal.name: signal.choices if signal.kind == "Enumeration" else {} for signal in one.message.signals}
    words = []
    for name, value in one.signals.items():
        if name in ("Crc", "Counter"):
            continue
        told = choices[name].get(int(value)) if choices[name] else None
        words.append(
            f"{name} {told.replace('_', ' ') if told else f'{value:.6g}'}{' ' * bool(units[name])}{units[name]}"
        )
    return ", ".join(words)
