"""The two ends of the bus as processes of their own, in wall-clock time, on any bus that python-can knows.

Each end is one loop at the control period; what it sends, heartbeats included, comes from that loop itself, so a
process that hangs falls silent and the other end sees it. A stop that is asked for (`stop`, set by a signal) vents the
robot before the bus is closed: the plant latches its safe state and shows it, the sequencer disarms the board.
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from controllers.interface import Detection, Recovery, SequencerState
from controllers.pressure_loop import PressureLoopGains
from firmware_protocol.bus import drain, opened, send
from firmware_protocol.enumerations import SafeReason
from firmware_protocol.errors import BusError
from firmware_protocol.sequencer_link import LinkFailure
from firmware_protocol.trace import TraceWriter
from sim.recorder import Recorder, samples_of
from sim.run import Progress, RunResult, quiet
from sim.scene import CONTROL_PERIOD_S, Scene
from sim.twins import make_twin, steps_per_period
from softbot.errors import SimulationError
from softbot.nodes.fixed_rate import FixedRate, LoopTiming
from softbot.nodes.lockstep import BUS_LOG
from softbot.nodes.plant_node import PlantNode, board_limits
from softbot.nodes.sequencer_node import ChamberSequencer, SequencerNode
from softbot.nodes.warm_up import warm_up

if TYPE_CHECKING:
    import can

VENTING_S = 0.3
"""How long the plant goes on, vented, after it was told to stop."""
DISARMING_S = 0.1
"""How long the sequencer says disarm before it falls silent: five frames of it."""


@dataclass(frozen=True)
class PlantRun:
    """A plant's recording, and how its loop kept time."""

    result: RunResult
    timing: LoopTiming


@dataclass(frozen=True)
class SequencerRun:
    """What a sequencer found and did, and how its loop kept time. `link_failure`: why it ended, NONE if stopped."""

    state: SequencerState
    link_failure: LinkFailure
    detections: tuple[Detection, ...]
    recoveries: tuple[Recovery, ...]
    timing: LoopTiming


def run_plant(
    scene: Scene,
    interface: str,
    channel: str,
    run_dir: Path | None = None,
    *,
    stop: threading.Event | None = None,
    progress: Progress = quiet,
    gui: bool = False,
    gains: PressureLoopGains | None = None,
) -> PlantRun:
    """Valve board and robot on a bus, for the scene's duration or until `stop` is set.

    Records what the plant alone can know: the truth of the robot, and of the sequencer what it said on the bus.
    Raises InputError for a scene that cannot be run, BusError when the bus cannot be opened, SimulationError when the
    simulation or the bus fails in the run; what was recorded is kept.
    """
    stop = stop or threading.Event()
    board_limits(scene.robot)
    warm_up(scene)
    with contextlib.ExitStack() as stack:
        bus = stack.enter_context(opened(interface, channel))
        twin = make_twin(scene, gui=gui)
        stack.callback(twin.close)
        recorder = Recorder(scene, run_dir)
        node = PlantNode(scene, twin, recorder, gains)
        trace = stack.enter_context(TraceWriter(run_dir / BUS_LOG)) if run_dir is not None else None
        outcome, failure = "done", None
        loop = FixedRate(CONTROL_PERIOD_S)
        last = samples_of(scene)
        done = 0
        while done < last:
            if stop.is_set() and outcome == "done":
                outcome, last = "interrupted", min(last, done + round(VENTING_S / CONTROL_PERIOD_S))
                node.vent()
            try:
                _exchange(bus, trace, loop.wait(), node.cycle)
                node.advance()
            except BusError as error:
                failure = SimulationError(f"the bus failed at t = {node.plant.t_s:.2f} s: {error}")
                node.vent(SafeReason.BUS_OFF)
            except SimulationError as error:
                failure = error
            if failure is not None:
                outcome = f"failed: {failure}"
                break
            done += 1
            recorder.events.detections = list(node.heard.detections)
            recorder.events.recoveries = list(node.heard.recoveries)
            progress(node.plant.t_s)
        result = RunResult(*recorder.finish(done * steps_per_period(twin.step_s), done * CONTROL_PERIOD_S, outcome))
        if failure is not None:
            raise failure
        return PlantRun(result, loop.timing())


def run_sequencer(
    scene: Scene,
    interface: str,
    channel: str,
    *,
    stop: threading.Event | None = None,
    duration_s: float | None = None,
    sequencer: ChamberSequencer | None = None,
    report: Callable[[SequencerNode], None] = lambda node: None,
) -> SequencerRun:
    """The sequencer on a bus, until `stop` is set, `duration_s` is over or the link fails after it was armed.

    `report` is shown the node after each cycle. Raises BusError when the bus cannot be opened, SimulationError when
    the sequencer or the bus fails on the way (the board is told to stop first, where that is possible).
    """
    stop = stop or threading.Event()
    node = SequencerNode(scene, sequencer)
    with opened(interface, channel) as bus:
        loop = FixedRate(CONTROL_PERIOD_S)
        ends_s: float | None = None
        while True:
            t_s = loop.wait()
            try:
                _exchange(bus, None, t_s, node.cycle)
            except BusError as error:
                raise SimulationError(f"the bus failed at t = {t_s:.2f} s: {error}") from error
            report(node)
            if ends_s is None and (stop.is_set() or _over(node, t_s, duration_s)):
                ends_s = t_s + DISARMING_S
                link_failure = node.link_failure
                if node.failure is None:
                    node.stop()
            if ends_s is not None and t_s >= ends_s:
                break
        if node.failure is not None:
            raise SimulationError(f"the sequencer failed: {node.failure}") from node.failure
        return SequencerRun(node.state, link_failure, tuple(node.detections), tuple(node.recoveries), loop.timing())


@contextlib.contextmanager
def stopped_by_signals() -> Iterator[threading.Event]:
    """An event that SIGINT and SIGTERM set; the second one of them ends the process as usual."""
    stop = threading.Event()
    before: dict[signal.Signals, object] = {}

    def ask(number: int, frame: FrameType | None) -> None:
        stop.set()
        for one, handler in before.items():
            signal.signal(one, handler)  # type: ignore[arg-type]

    for one in (signal.SIGINT, signal.SIGTERM):
        before[one] = signal.signal(one, ask)
    try:
        yield stop
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)  # type: ignore[arg-type]


def sequencer_report(run: SequencerRun) -> dict[str, object]:
    """A sequencer's run as the JSON object of `softbot sequence --json`."""
    return {
        "state": str(run.state),
        "link_failure": str(run.link_failure),
        "detections": [asdict(found) for found in run.detections],
        "recoveries": [asdict(answer) for answer in run.recoveries],
        "timing": asdict(run.timing),
    }


def _exchange(
    bus: can.BusABC,
    trace: TraceWriter | None,
    t_s: float,
    cycle: Callable[[float, list], list],
) -> None:
    """One cycle of a node on a bus: all that has come in, all that is due out."""
    came = [frame for frame, _ in drain(bus)]
    out = cycle(t_s, came)
    send(bus, out, t_s)
    if trace is not None:
        trace.write([*came, *out], t_s)


def _over(node: SequencerNode, t_s: float, duration_s: float | None) -> bool:
    ended = duration_s is not None and t_s >= duration_s
    return ended or node.failure is not None or node.link_failure is not LinkFailure.NONE
