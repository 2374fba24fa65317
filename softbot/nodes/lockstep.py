"""Both ends of the bus in one process, in lock-step on simulated time: reproducible and faster than real time.

The two nodes meet on a python-can `virtual` bus (or on one that delivers as it sends, like vcan) and exchange nothing
but frames. In each control period the board cycles first, then the sequencer, then the robot moves; so a setpoint acts
one period after the readings it answers. No wall clock is read: the same scene gives the same frames and the same
telemetry, byte for byte. Everything that crossed the bus is in `bus.log`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path

from controllers.pressure_loop import PressureLoopGains
from firmware_protocol.bus import drain, opened, send
from firmware_protocol.errors import ProtocolError
from firmware_protocol.frame import Frame
from firmware_protocol.trace import TraceWriter
from sim.recorder import Record, Recorder
from sim.run import Progress, RunResult, quiet, run_samples
from sim.scene import CONTROL_PERIOD_S, Scene
from sim.twins import make_twin, steps_per_period
from softbot.errors import SimulationError
from softbot.nodes.deciding_board import DecidingBoard
from softbot.nodes.plant_node import PlantNode, board_limits
from softbot.nodes.sequencer_node import ChamberSequencer, SequencerNode, make_sequencer
from softbot.robot import Robot

BUS_LOG = "bus.log"

_channels = itertools.count()  # runs in one process must not hear each other


def run_lockstep(
    scene: Scene,
    run_dir: Path | None = None,
    *,
    record: Record = "all",
    progress: Progress = quiet,
    gui: bool = False,
    sequencer: ChamberSequencer | None = None,
    gains: PressureLoopGains | None = None,
    board: DecidingBoard = DecidingBoard.PYTHON,
    known: Robot | None = None,
    transport: tuple[str, str] | None = None,
    watch: Callable[[PlantNode, SequencerNode], None] = lambda plant, sequencer: None,
) -> RunResult:
    """Run a scene that a sequencer drives. Raises SimulationError when it fails; what was recorded is kept.

    `sequencer` and `gains` (of the pressure loop) stand in for those that follow from the scene; `board` is the
    implementation of the board's rules that decides. `known` is the robot that sequencer and board believe in, where it
    is another than the scene's. `transport`: interface and channel of another bus than a virtual one of the run's own.
    `watch` is shown both nodes once a period. Raises BusError when the bus cannot be opened.
    """
    board_limits(known or scene.robot)  # refuses before anything is written
    with ExitStack() as stack:
        twin = make_twin(scene, gui=gui)
        stack.callback(twin.close)
        own = SequencerNode(scene, sequencer or make_sequencer(scene, known, gains))
        recorder = Recorder(scene, run_dir, record=record)
        plant = PlantNode(scene, twin, recorder, gains, board, known)
        interface, channel = transport or ("virtual", f"softbot-lockstep-{next(_channels)}")
        board_bus = stack.enter_context(opened(interface, channel))
        sequencer_bus = stack.enter_context(opened(interface, channel))
        trace = stack.enter_context(TraceWriter(run_dir / BUS_LOG)) if run_dir is not None else None

        def keep(frames: list[Frame], t_s: float) -> None:
            if trace is not None:
                trace.write(frames, t_s)

        def advance(sample: int) -> None:
            t_s = round(sample * CONTROL_PERIOD_S, 6)
            frames = plant.cycle(t_s, (frame for frame, _ in drain(board_bus)))
            send(board_bus, frames, t_s)
            keep(frames, t_s)
            frames = own.cycle(t_s, (frame for frame, _ in drain(sequencer_bus)))
            send(sequencer_bus, frames, t_s)
            keep(frames, t_s)
            recorder.events.detections = [asdict(found) for found in own.detections]
            recorder.events.recoveries = [answer.entry() for answer in own.recoveries]
            if own.failure is not None:
                raise SimulationError(f"the sequencer failed at t = {t_s:.2f} s: {own.failure}") from own.failure
            plant.advance()
            watch(plant, own)

        return run_samples(scene, recorder, steps_per_period(twin.step_s), _foreseen(advance), progress)


def _foreseen(advance: Callable[[int], None]) -> Callable[[int], None]:
    """A failure of the protocol in the middle of a run is a failed run, like any other."""

    def guarded(sample: int) -> None:
        try:
            advance(sample)
        except ProtocolError as error:
            raise SimulationError(f"the bus failed at t = {sample * CONTROL_PERIOD_S:.2f} s: {error}") from error

    return guarded
