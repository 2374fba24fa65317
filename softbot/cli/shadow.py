"""`softbot shadow`: a robot watched by its twin, on a live bus or in a recording. It listens and never sends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from softbot.cli.options import Json
from softbot.spoken_fault import spoken_where

if TYPE_CHECKING:
    import threading
    from contextlib import ExitStack

    from rich.console import Console, RenderableType

    from softbot.nodes.chamber_health import Health
    from softbot.nodes.shadow import Seen, Shadow
    from softbot.robot import Robot

_SHOWN_S = 0.25
_KEPT_EVERY_S = 60.0
_TABLE_WIDTH = 80


def shadow(
    source: Annotated[
        Path | None,
        typer.Argument(
            metavar="[RECORDING]", help="Trace (.log of candump -L, .asc, .blf) or run folder; without it a live bus."
        ),
    ] = None,
    interface: Annotated[str | None, typer.Option(help="Live bus: as for `softbot monitor`.")] = None,
    channel: Annotated[str | None, typer.Option(help="Live bus: channel of the interface.")] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            metavar="ROBOT.toml",
            help="Robot file that the robot was built by. Default: that of the run folder (or of the one in which the "
            "trace lies), else the shipped default; standard error says which.",
        ),
    ] = None,
    findings: Annotated[
        Path | None, typer.Option(metavar="FILE.jsonl", help="Write estimates and verdicts, one JSON object a line.")
    ] = None,
    health: Annotated[
        Path | None,
        typer.Option(metavar="FILE.json", help="What was learnt of the chambers: taken up from here, and kept here."),
    ] = None,
    every_s: Annotated[float, typer.Option("--every-s", help="Time from one estimate to the next.")] = 1.0,
    duration_s: Annotated[
        float | None, typer.Option("--duration-s", help="Stop a live watch after this time; default: until stopped.")
    ] = None,
    json: Json = False,
) -> None:
    """Watch a robot by its twin: what is learnt of its chambers, what is suspected, what is found.

    The sequencer's own fault detection over what the board says, live or recorded; nothing is sent. Ctrl-C ends it with
    the verdict. With --health a slow leak is followed from day to day.
    """
    import contextlib
    import json as json_format
    import math
    from dataclasses import asdict

    from softbot.cli.compiling import told_of_compiling
    from softbot.cli.streams import say
    from softbot.errors import InputError
    from softbot.interruption import stopped_by_signals
    from softbot.nodes.chamber_health import read_health
    from softbot.nodes.replay import account
    from softbot.nodes.shadow import Shadow, rehearse_shadow, watch

    for name, value in (("--duration-s", duration_s), ("--every-s", every_s)):
        if value is not None and not 0.0 < value < math.inf:
            raise InputError(f"{name} {value:g}: give a positive number of seconds")
    if source is not None and (interface is not None or channel is not None or duration_s is not None):
        raise InputError(f"{source}: a recording has no --interface, --channel and --duration-s; leave out one of them")
    watched, whose = _robot(source, robot)
    say(f"robot: {watched.name}, {whose}")
    known = None if health is None else read_health(health, watched.name)
    with told_of_compiling("preparing", "compiling the fault detection, once on this machine: about a minute"):
        rehearse_shadow(watched)
    twin = Shadow(watched, known)
    place = str(source) if source is not None else f"{interface or 'socketcan'} {channel or 'vcan0'}"
    with contextlib.ExitStack() as stack:
        lines = None if findings is None else stack.enter_context(_opened(findings))
        stop = stack.enter_context(stopped_by_signals())
        came = _came(source, interface or "socketcan", channel or "vcan0", stop, duration_s, stack)
        view = _View(twin, place, stack, shown=source is None and not json)

        def tell(finding: dict[str, Any]) -> None:
            if lines is not None:
                lines.write(json_format.dumps(_plain(finding), allow_nan=False) + "\n")
                lines.flush()
            if finding["event"] == "verdict" and not view.live:
                say(f"{finding['t_s']:.2f} s: {verdict_in_words(finding)}")

        try:
            watch(twin, _kept(view.over(came), twin, health, known), tell, every_s)
        finally:
            after = _keep(twin, health, known)
        found = account(twin, place)
        looks = _concerns(after)
        end = {**found.report(), "final": asdict(twin.estimate()), "concerns": looks}
        tell({"event": "end", **end})
    if json:
        typer.echo(json_format.dumps(_plain(end), allow_nan=False))
        return
    from softbot.cli.replay import in_words

    _console().print(_picture(twin, place))
    typer.echo(in_words(found))
    for one in looks:
        typer.echo(f"look at   {one['words']}")


def verdict_in_words(found: dict[str, Any]) -> str:
    """A verdict for people."""
    bad = "" if found["severity"] is None else f", severity {found['severity']:.2f}"
    where = spoken_where(found["chamber"])
    return f"{where}: {str(found['kind']).replace('_', ' ')}{bad} ({100.0 * found['confidence']:.0f} %)"


def _robot(source: Path | None, robot: str | None) -> tuple[Robot, str]:
    """The robot that was named, or that of the run folder (or the trace's folder), or the default one; and whose."""
    from softbot.robot import load_robot

    if robot is not None:
        return load_robot(robot), f"of --robot {robot}"
    if source is not None:
        scene = (source if source.is_dir() else source.parent) / "scene.toml"
        if source.is_dir() or (source.is_file() and scene.is_file()):
            from sim.scene import load_scene

            return load_scene(scene).robot, f"of {scene}"
    return load_robot("default"), "shipped with softbot; for another give --robot ROBOT.toml"


def _came(
    source: Path | None,
    interface: str,
    channel: str,
    stop: threading.Event,
    duration_s: float | None,
    stack: ExitStack,
) -> Iterable[Seen]:
    if source is None:
        from softbot.nodes.listening import bus_frames
        from softbot.nodes.wall_clock import open_live

        return bus_frames(stack.enter_context(open_live(interface, channel)), stop, duration_s)
    from itertools import takewhile

    from softbot.nodes.lockstep import BUS_LOG
    from softbot.nodes.shadow import trace_frames

    return takewhile(lambda _: not stop.is_set(), trace_frames(source / BUS_LOG if source.is_dir() else source))


def _opened(path: Path) -> Any:
    from softbot.errors import InputError

    try:
        return path.open("w", encoding="utf-8")
    except OSError as error:
        raise InputError(f"--findings {path}: cannot be written: {error.strerror}; choose another place") from None


def _kept(came: Iterable[Seen], twin: Shadow, path: Path | None, before: Health | None) -> Iterator[Seen]:
    """What came, while the health file is brought up to date now and then: a killed watch loses little."""
    due_s = _KEPT_EVERY_S
    for one in came:
        yield one
        if twin.t_s >= due_s:
            due_s = twin.t_s + _KEPT_EVERY_S
            _keep(twin, path, before)


def _keep(twin: Shadow, path: Path | None, before: Health | None) -> Health | None:
    """Write what was learnt so far as the last session of the health file, where something was; the health then."""
    from softbot.nodes.chamber_health import write_health

    session = twin.session()
    if path is None or before is None or session is None:
        return before
    after = before.after(session)
    write_health(path, after)
    return after


def _concerns(health: Health | None) -> list[dict[str, Any]]:
    from softbot.nodes.chamber_health import concern_in_words, concerns

    return [] if health is None else [{**one, "words": concern_in_words(one)} for one in concerns(health)]


def _plain(value: Any) -> Any:
    """As JSON has it: no numbers that are not finite, five digits after the point."""
    import math

    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float):
        return round(value, 5) if math.isfinite(value) else None
    return value


def _console() -> Console:
    """As wide as the table of chambers at least: a narrower terminal breaks its lines, and nothing is left out."""
    from rich.console import Console

    console = Console(highlight=False)
    console.width = max(console.width, _TABLE_WIDTH)
    return console


class _View:
    """The live picture on a terminal; without one nothing is shown until the end."""

    def __init__(self, twin: Shadow, title: str, stack: ExitStack, *, shown: bool) -> None:
        from rich.live import Live

        console = _console()
        self._twin, self._title = twin, title
        self.live = (
            stack.enter_context(Live(console=console, auto_refresh=False, screen=True))
            if shown and console.is_terminal
            else None
        )

    def over(self, came: Iterable[Seen]) -> Iterator[Seen]:
        """What came, and the picture kept up to date with it."""
        import time

        shown_s = 0.0
        for one in came:
            yield one
            if self.live is not None and time.monotonic() - shown_s >= _SHOWN_S:
                shown_s = time.monotonic()
                self.live.update(_picture(self._twin, self._title), refresh=True)


def _picture(twin: Shadow, title: str) -> RenderableType:
    """What the shadow believes: a line on the robot, a row for each chamber, and what was found."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    now = twin.estimate()
    roll = now.roll
    mode = "board not heard" if now.board_mode is None else f"board {now.board_mode.replace('_', ' ')}"
    head = Text.assemble(
        (title, "bold"),
        f"   {now.t_s:.1f} s   {mode}, sequencer {now.sequencer_state}\n"
        f"rolled {now.roll_rev:.2f} rev at {now.roll_rate_rev_s:.2f} rev/s, bent {now.bend_rad:.2f} rad\n"
        f"gyro off by {1e3 * roll.gyro_bias_rad_s:.0f}±{1e3 * roll.gyro_bias_deviation_rad_s:.0f} mrad/s, "
        f"grip {100.0 * roll.grip:.0f} %, resistance {100.0 * roll.resistance:.0f} %",
    )
    table = Table(box=None, pad_edge=False, collapse_padding=True)
    for name in ("", "pressure", "supply", "exhaust", "leak", "effect", "suspected", "bends", "verdict"):
        left = name in ("", "verdict")
        # where room is short a verdict takes two lines, and no number is cut
        table.add_column(name, justify="left" if left else "right", no_wrap=name != "verdict")
    for number, one in enumerate(now.chambers):
        learnt = one.learnt
        named = "" if one.named is None else f"{one.named.replace('_', ' ')} {one.severity or 0.0:.2f}"
        table.add_row(
            str(number),
            f"{1e-3 * one.pressure_Pa:.1f} kPa",
            f"{100.0 * learnt.supply_path:.0f}±{100.0 * learnt.supply_path_deviation:.0f} %",
            f"{100.0 * learnt.exhaust_path:.0f}±{100.0 * learnt.exhaust_path_deviation:.0f} %",
            f"{100.0 * learnt.leak:.1f}±{100.0 * learnt.leak_deviation:.1f} %",
            f"{100.0 * one.effectiveness:.0f} %",
            f"{100.0 * min(one.suspicion, 1.0):.0f} %",
            f"{100.0 * now.roll.gains[number]:+.0f} %",
            named or "healthy",
            style="red" if one.named else "yellow" if one.suspicion >= 1.0 else "",
        )
    shared = [one for one in twin.detections if one.chamber < 0]
    rest = [Text(f"{spoken_where(one.chamber)}: {one.kind.replace('_', ' ')}", style="red") for one in shared]
    return Group(head, table, *rest)
