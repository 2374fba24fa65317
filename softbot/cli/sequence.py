"""`softbot sequence`: the sequencer on a CAN bus, in wall-clock time."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from softbot.cli.options import Assignments, BusFaultFile, Channel, Interface, Json, SceneFile, SlowMotion, Urgent
from softbot.spoken_fault import spoken_where
from softbot.spoken_offer import spoken_offer

if TYPE_CHECKING:
    from controllers.interface import Recovery
    from softbot.nodes.sequencer_node import SequencerNode


def sequence(
    scene: SceneFile,
    interface: Interface = "socketcan",
    channel: Channel = "vcan0",
    assignments: Assignments = None,
    duration_s: Annotated[
        float | None, typer.Option("--duration-s", help="Stop after this time; default: until stopped.")
    ] = None,
    json: Json = False,
    real_time: Urgent = False,
    bus_faults: BusFaultFile = None,
    slow_motion: SlowMotion = 1.0,
) -> None:
    """Be the sequencer on a CAN bus.

    Takes robot and orders from the scene, and goes on until stopped; Ctrl-C disarms the board. Says on standard
    error what it does, and at SIGUSR1 how it keeps time. Exit status 3 when the board vents or falls silent while it is
    armed.
    """
    import json as json_format
    import math

    from firmware_protocol.sequencer_link import LinkFailure
    from sim.scene import load_scene
    from softbot.cli.streams import say
    from softbot.errors import InputError, SimulationError
    from softbot.interruption import stopped_by_signals
    from softbot.nodes.wall_clock import asked_by_signal, run_sequencer, sequencer_report

    if duration_s is not None and not 0.0 < duration_s < math.inf:
        raise InputError(f"--duration-s {duration_s:g}: give a positive number of seconds")
    checked = load_scene(scene, tuple(assignments or ()))
    with stopped_by_signals() as stop, asked_by_signal() as asked:
        run = run_sequencer(
            checked,
            interface,
            channel,
            stop=stop,
            duration_s=duration_s,
            report=Narrator(f"{interface} {channel}"),
            urgent=real_time,
            asked=asked,
            tell=say,
            bus_faults=bus_faults or (),
            slow_motion=slow_motion,
        )
    say(str(run.timing))
    if json:
        typer.echo(json_format.dumps(sequencer_report(run)))
    if run.link_failure is not LinkFailure.NONE:
        raise SimulationError(f"the link to the board failed: {str(run.link_failure).replace('_', ' ')}")


class Narrator:
    """Says on standard error what changed in a sequencer since it was last shown."""

    def __init__(self, bus: str) -> None:
        self._bus = bus
        self._last = ""
        self._told, self._answers_told = 0, 0

    def __call__(self, node: SequencerNode) -> None:
        """Show the node after a cycle."""
        readings = node.link.readings
        link = f"link {str(node.link.state).replace('_', ' ')}, {node.state}"
        now = f"waiting for the board on {self._bus}" if readings.board_mode is None else link
        if now != self._last:
            self._last = now
            typer.echo(f"softbot: {now}", err=True)
        for found in node.detections[self._told :]:
            kind = str(found.kind).replace("_", " ")
            where = spoken_where(found.chamber)
            typer.echo(f"softbot: found: {where}, {kind} ({100.0 * found.confidence:.0f} %)", err=True)
        self._told = len(node.detections)
        for answer in node.recoveries[self._answers_told :]:
            typer.echo(f"softbot: {_answered(answer)}", err=True)
        self._answers_told = len(node.recoveries)


def _answered(answer: Recovery) -> str:
    strategy = answer.strategy.replace("_", " ")
    return strategy if answer.offer is None else f"{strategy}: {spoken_offer(asdict(answer.offer))}"
