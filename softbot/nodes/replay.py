"""What a sequencer that had listened along would have found in a recorded bus, beside what the recording's own said.

The setpoints that it would have sent are compared with nothing, since the recorded robot answered others.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from controllers.interface import Detection
from firmware_protocol.errors import TraceError
from softbot.nodes.shadow import Shadow, trace_frames
from softbot.robot import Robot


@dataclass(frozen=True)
class Replay:
    """What was found in a trace, and what the sequencer of the recorded run had said of itself.

    `accepted` and `refused` count the board's frames; `samplings` those that the detector was updated with.
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


def replay_trace(path: Path, robot: Robot) -> Replay:
    """Watch a robot through a trace. Times are those of the trace, from its first frame.

    Raises TraceError for one that cannot be read or has no board in it, SimulationError when the detector fails.
    """
    shadow = Shadow(robot)
    for stamp_s, frames in trace_frames(path):
        shadow.see(stamp_s, frames)
    return account(shadow, path)


def account(shadow: Shadow, source: Path | str) -> Replay:
    """What a shadow has seen and found. Raises TraceError when there was no board in `source`."""
    counts = shadow.counts()
    if counts.accepted == 0:
        raise TraceError(f"{source}: holds no valid frame of a valve board; is it a trace of this bus (softbot.dbc)?")
    return Replay(
        duration_s=shadow.t_s,
        accepted=counts.accepted,
        refused=counts.refused,
        samplings=counts.samplings,
        armed_s=round(shadow.armed_s, 6),
        detections=tuple(shadow.detections),
        recorded=tuple(shadow.heard.detections),
    )
