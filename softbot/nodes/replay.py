"""The sequencer's estimation and detection over a recorded bus: what would it have found in what the board said?

The board's frames of a trace go, in order and at their times, into a node as it stands on a bus; what the node says
goes nowhere. The board's own account of itself (armed, or not) is followed, so that estimates and verdicts are those of
a sequencer that listened along; the setpoints it would have sent are compared with nothing, since the recorded robot
answered others.
"""

from __future__ import annotations

import contextlib
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path

from controllers.interface import Detection
from firmware_protocol.codec import decode
from firmware_protocol.enumerations import BoardMode
from firmware_protocol.errors import ProtocolError, TraceError
from firmware_protocol.sequencer_link import SequencerLink
from firmware_protocol.spec import BOARD, spec
from firmware_protocol.trace import read_trace
from sim.scene import Scene
from softbot.errors import SimulationError
from softbot.nodes.heard import Heard
from softbot.nodes.sequencer_node import LAST_MEASUREMENT, SequencerNode


@dataclass(frozen=True)
class Replay:
    """What was found in a trace, and what the sequencer of the recorded run had said of itself.

    `accepted` and `refused` count the board's frames; `samplings` those that the sequencer was updated with.
    """

    duration_s: float
    accepted: int
    refused: int
    samplings: int
    armed_s: float
    detections: tuple[Detection, ...]
    recorded: tuple[dict[str, object], ...]

    def report(self) -> dict[str, object]:
        """As the JSON object of `softbot replay --json`."""
        return asdict(self)


class ListeningLink(SequencerLink):
    """A link that asks for nothing: it counts as armed while the board says that it is."""

    @property
    def armed(self) -> bool:
        """Whether the recorded board says that it is armed."""
        return self.readings.board_mode is BoardMode.ARMED


def replay_trace(path: Path, scene: Scene) -> Replay:
    """Run the scene's sequencer over a trace. Times are those of the trace, from its first frame.

    Raises TraceError for one that cannot be read or has no board in it, SimulationError when the sequencer fails.
    """
    of_the_board = {message.frame_id for message in spec().messages if message.sender == BOARD}
    node = SequencerNode(scene)
    node.link = ListeningLink()
    heard = Heard()
    armed_s, t_s = 0.0, 0.0
    first_s: float | None = None
    for stamp_s, records in groupby(read_trace(path), key=lambda record: record.t_s):
        frames = [record.frame for record in records]
        first_s = stamp_s if first_s is None else first_s
        before_s, t_s = t_s, max(t_s, round(stamp_s - first_s, 6))
        armed_s += (t_s - before_s) * node.link.armed
        node.cycle(t_s, [frame for frame in frames if frame.frame_id in of_the_board])
        for frame in frames:
            with contextlib.suppress(ProtocolError):  # not of this protocol, or damaged
                heard.listen(*decode(*frame), t_s)
        if node.failure is not None:
            raise SimulationError(
                f"the sequencer failed at t = {t_s:.2f} s of {path}: {node.failure}"
            ) from node.failure
    received = node.link.reception.messages
    counts = [(status, count) for entry in received.values() for status, count in entry.counts.items()]
    accepted = sum(count for status, count in counts if status.accepted)
    if accepted == 0:
        raise TraceError(f"{path}: holds no valid frame of a valve board; is it a trace of this bus (softbot.dbc)?")
    return Replay(
        duration_s=t_s,
        accepted=accepted,
        refused=sum(count for _, count in counts) - accepted,
        samplings=sum(count for status, count in received[LAST_MEASUREMENT].counts.items() if status.accepted),
        armed_s=round(armed_s, 6),
        detections=tuple(node.detections),
        recorded=tuple(heard.detections),
    )
