"""The two ends of the bus as processes of their own, in wall-clock time, on any bus that python-can knows.

Each end is one loop at the control period; what it sends, heartbeats included, comes from that loop itself, so a
process that hangs falls silent and the other end sees it. A stop that is asked for (`stop`, set by a signal) vents the
robot before the bus is closed: the plant latches its safe state and shows it, the sequencer disarms the board.
In slow motion a second of the robot lasts several of the clock, for both ends and all their time-outs alike: what a
machine that is too slow, or away too often, can keep up with.
"""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Union, cast

from controllers.interface import Detection, Recovery, SequencerState
from controllers.pressure_loop import PressureLoopGains
from firmware_protocol.bus import drain, opened, send
from firmware_protocol.controller_state import ControllerState
from firmware_protocol.enumerations import SafeReason
from firmware_protocol.errors import BusError
from firmware_protocol.frame import Frame
from firmware_protocol.sequencer_link import LinkFailure
from firmware_protocol.trace import TraceWriter
from sim.recorder import Recorder, samples_of
from sim.run import Progress, RunResult, quiet
from sim.scene import CONTROL_PERIOD_S, Scene
from sim.twins import make_twin, steps_per_period
from softbot.errors import InputError, SimulationError
from softbot.nodes.deciding_board import DecidingBoard
from softbot.nodes.fixed_rate import FixedRate, LoopTiming
from softbot.nodes.lockstep import BUS_LOG
from softbot.nodes.message_meter import MessageMeter, MessageTiming
from softbot.nodes.plant_node import PlantNode, board_limits
from softbot.nodes.real_time import Granted, real_time
from softbot.nodes.rehearsal import rehearse_plant, rehearse_sequencer
from softbot.nodes.sequencer_node import LAST_MEASUREMENT, ChamberSequencer, SequencerNode
from softbot.nodes.warm_up import warm_up

if TYPE_CHECKING:
    import can

    from firmware_protocol.bus_faults import BusFault, FaultFile, FaultyBus

BusFaults = Union[Path, "tuple[BusFault, ...]"]
"""Faults of the bus at this end: given, or a file of them."""

VENTING_S = 0.3
"""How long the plant goes on, vented, after it was told to stop."""
OUTPUT_WATCHDOG_S = 0.1
"""A board that does not serve its valves for so long loses them: they fall into their safe state by themselves."""
LONGEST_CATCH_UP = 100
"""Periods that the robot moves on at once when its process was held up; of a longer stop the rest did not happen."""
BUS_LOST_S = 2.0
"""How long the plant, vented, waits for a bus that failed."""
_POLL_FAULTS_EVERY = 20  # cycles
MOST_SLOW_MOTION = 1000.0
DISARMING_S = 0.1
"""How long the sequencer says disarm before it falls silent: five frames of it."""


def silent(_sentence: str) -> None:
    """Nobody is told."""


@dataclass(frozen=True)
class RealTime:
    """How a node kept time, by the clock: its loop, and the message that it answers, from its arrival to the answer.

    The plant answers setpoints by its valves, the sequencer measurements by setpoints.
    """

    loop: LoopTiming
    link: MessageTiming

    def __str__(self) -> str:
        return f"{self.loop}\n{self.link}"


@dataclass(frozen=True)
class PlantRun:
    """A plant's recording, and how it kept time."""

    result: RunResult
    timing: RealTime


@dataclass(frozen=True)
class SequencerRun:
    """What a sequencer found and did, and how it kept time. `link_failure`: why it ended, NONE if stopped."""

    state: SequencerState
    link_failure: LinkFailure
    detections: tuple[Detection, ...]
    recoveries: tuple[Recovery, ...]
    timing: RealTime


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
    urgent: bool = False,
    asked: threading.Event | None = None,
    tell: Callable[[str], None] = silent,
    watch: Callable[[PlantNode], None] = lambda node: None,
    board: DecidingBoard = DecidingBoard.PYTHON,
    bus_faults: BusFaults = (),
    slow_motion: float = 1.0,
) -> PlantRun:
    """Valve board and robot on a bus, for the scene's duration or until `stop` is set.

    Records what the plant alone can know: the truth of the robot, and of the sequencer what it said on the bus. When
    the bus fails (link down, bus-off) the board vents and stays latched; a bus that does not come back within 2 s ends
    the run. `urgent` asks for real-time priority. Whenever `asked` is set, `tell` is given how the loop keeps time;
    `watch` is shown the node in each cycle once the valves are set. `board` is the implementation of the board's rules
    that decides. `bus_faults` strike this end of the bus: given, or a file of them, which may be edited in the run.
    `slow_motion`: seconds of the clock that a second of the robot lasts, the same at both ends.
    Raises InputError for a scene that cannot be run, BusError when the bus cannot be opened, SimulationError when the
    simulation or the bus fails in the run; what was recorded is kept.
    """
    stop = stop or threading.Event()
    check_drive(scene, "plant")
    check_slow_motion(slow_motion)
    board_limits(scene.robot)
    warm_up(scene)
    rehearse_plant(scene, gains, board)
    with contextlib.ExitStack() as stack:
        tell_granted(stack.enter_context(real_time(urgent)), tell)
        bus = stack.enter_context(open_live(interface, channel, bus_faults, scene.solver.seed, slow_motion))
        twin = make_twin(scene, gui=gui)
        stack.callback(twin.close)
        recorder = Recorder(scene, run_dir)
        node = PlantNode(scene, twin, recorder, gains, board)
        trace = stack.enter_context(TraceWriter(run_dir / BUS_LOG)) if run_dir is not None else None
        outcome = "done"
        failure: SimulationError | None = None
        lost: LostBus | None = None
        end = BusEnd(bus, "SequencerSetpoints", trace, bus_faults, tell, slow_motion)
        last = samples_of(scene)
        done = 0
        while done < last:
            if stop.is_set() and outcome == "done":
                outcome, last = "interrupted", min(last, done + round(VENTING_S / CONTROL_PERIOD_S))
                node.vent()
            t_s = end.wait()
            try:
                done += catch_up(node, min(end.loop.missed_now, last - 1 - done))
                lost = exchange_or_vent(end, node, t_s, lost)
                watch(node)
                node.advance()
            except SimulationError as error:
                failure = error
                break
            done += 1
            recorder.events.detections = list(node.heard.detections)
            recorder.events.recoveries = list(node.heard.recoveries)
            progress(node.plant.t_s)
            end.answer(asked, tell)
        failure = failure or (None if lost is None else lost.failure)
        if failure is not None:
            outcome = f"failed: {failure}"
        result = RunResult(*recorder.finish(done * steps_per_period(twin.step_s), done * CONTROL_PERIOD_S, outcome))
        if failure is not None:
            raise failure
        return PlantRun(result, end.timing())


def run_sequencer(
    scene: Scene,
    interface: str,
    channel: str,
    *,
    stop: threading.Event | None = None,
    duration_s: float | None = None,
    sequencer: ChamberSequencer | None = None,
    report: Callable[[SequencerNode], None] = lambda node: None,
    urgent: bool = False,
    asked: threading.Event | None = None,
    tell: Callable[[str], None] = silent,
    bus_faults: BusFaults = (),
    slow_motion: float = 1.0,
) -> SequencerRun:
    """The sequencer on a bus, until `stop` is set, `duration_s` is over or the link fails after it was armed.

    `report` is shown the node after each cycle; `urgent`, `asked`, `tell`, `bus_faults` and `slow_motion` are
    as for the plant; `duration_s` is the robot's.
    Raises InputError for a scene that no sequencer drives, BusError when the bus cannot be opened, SimulationError when
    the sequencer or the bus fails on the way (the board is told to stop first, where that is possible).
    """
    stop = stop or threading.Event()
    check_drive(scene, "sequence")
    check_slow_motion(slow_motion)
    if sequencer is None:
        rehearse_sequencer(scene)
    node = SequencerNode(scene, sequencer)
    with (
        real_time(urgent) as granted,
        open_live(interface, channel, bus_faults, scene.solver.seed, slow_motion) as bus,
    ):
        tell_granted(granted, tell)
        end = BusEnd(bus, LAST_MEASUREMENT, None, bus_faults, tell, slow_motion)
        ends_s: float | None = None
        while True:
            t_s = end.wait()
            try:
                end.exchange(t_s, node.cycle, node.link.report_bus)
            except BusError as error:
                raise SimulationError(f"the bus failed at t = {t_s:.2f} s: {error}") from error
            report(node)
            end.answer(asked, tell)
            if ends_s is None and (stop.is_set() or _over(node, t_s, duration_s)):
                ends_s = t_s + DISARMING_S
                link_failure = node.link_failure
                if node.failure is None:
                    node.stop()
            if ends_s is not None and t_s >= ends_s:
                break
        if node.failure is not None:
            raise SimulationError(f"the sequencer failed: {node.failure}") from node.failure
        return SequencerRun(node.state, link_failure, tuple(node.detections), tuple(node.recoveries), end.timing())


@dataclass(frozen=True)
class LostBus:
    """A bus that failed at `since_s`, and how the run ends if it does not come back."""

    since_s: float
    failure: SimulationError


def exchange_or_vent(end: BusEnd, node: PlantNode, t_s: float, lost: LostBus | None) -> LostBus | None:
    """The board's cycle on the bus; on one that fails, with the robot vented. Raises SimulationError in the end."""
    try:
        end.exchange(t_s, node.cycle, node.rules.report_bus)
    except BusError as error:
        node.vent(SafeReason.BUS_OFF)
        node.cycle(t_s, ())
        if lost is None:
            lost = LostBus(t_s, SimulationError(f"the bus failed at t = {node.plant.t_s:.2f} s: {error}"))
        if t_s - lost.since_s >= BUS_LOST_S:
            raise lost.failure from error
        return lost
    return None


def catch_up(node: PlantNode, periods: int) -> int:
    """The robot moves on for the periods in which the board was held up; the number of them that were played.

    Its valves stand as they stood until the watchdog of their driver lets them fall into their safe state.
    """
    played = min(periods, LONGEST_CATCH_UP)
    for period in range(played):
        if period == round(OUTPUT_WATCHDOG_S / CONTROL_PERIOD_S):
            node.release_valves()
        node.advance()
    return played


class BusEnd:
    """A node's loop on a bus, and how it keeps time; `answered` is the message whose answer is timed."""

    def __init__(
        self,
        bus: can.BusABC,
        answered: str,
        trace: TraceWriter | None,
        bus_faults: BusFaults,
        tell: Callable[[str], None],
        slow_motion: float,
    ) -> None:
        self._faulty: FaultyBus | None = None
        self._fault_file: FaultFile | None = None
        if bus_faults:
            self._faulty = cast("FaultyBus", bus)
            self._faulty.faults = self._faulty.faults  # their time begins with the loop
            if isinstance(bus_faults, Path):
                from firmware_protocol.bus_faults import FaultFile

                self._fault_file = FaultFile(bus_faults, self._faulty, tell)
        self._slow_motion = slow_motion
        self.loop = FixedRate(CONTROL_PERIOD_S * slow_motion)
        self._bus, self._trace = bus, trace
        self._meter = MessageMeter(answered)
        self._controller = ControllerState()
        self._cycles = 0

    def wait(self) -> float:
        """Sleep until the next cycle; its time, the robot's [s]."""
        return self.loop.wait() / self._slow_motion

    def exchange(
        self, t_s: float, cycle: Callable[[float, list[Frame]], list[Frame]], report_bus: Callable[..., None]
    ) -> None:
        """One cycle: all that has come in, all that is due out. Raises BusError; the cycle may then not have been.

        `report_bus(bus_state, transmit_errors, receive_errors)` is told what this end's CAN controller says of itself.
        """
        self._cycles += 1
        if self._fault_file is not None and self._cycles % _POLL_FAULTS_EVERY == 0:
            self._fault_file.poll()
        controller = self._controller
        stamped = list(drain(self._bus, controller))
        report_bus(controller.bus_state, controller.transmit_errors, controller.receive_errors)
        came = [frame for frame, _ in stamped]
        self._meter.came(stamped)
        out = cycle(t_s if self._faulty is None else t_s + self._faulty.clock_offset_s(), came)
        send(self._bus, out, t_s)
        self._meter.acted()
        if self._trace is not None:
            self._trace.write([*came, *out], t_s)

    def answer(self, asked: threading.Event | None, tell: Callable[[str], None]) -> None:
        """Tell how time is kept, if it was asked for."""
        if asked is not None and asked.is_set():
            asked.clear()
            tell(str(self.timing()))

    def timing(self) -> RealTime:
        """What was measured so far."""
        return RealTime(self.loop.timing(), self._meter.timing())


@contextlib.contextmanager
def open_live(
    interface: str, channel: str, bus_faults: BusFaults = (), seed: int = 0, slow_motion: float = 1.0
) -> Iterator[can.BusABC]:
    """A bus, with its faults, whose time stamps are the machine's wall clock where it can be asked for that.

    The faults' time is the robot's.
    """
    given: tuple[BusFault, ...] = ()
    if bus_faults:
        from firmware_protocol.bus_faults import FaultyBus, read_bus_faults

        given = read_bus_faults(bus_faults) if isinstance(bus_faults, Path) else bus_faults
    stamps = {"preserve_timestamps": False} if interface == "virtual" else {}
    with opened(interface, channel, **stamps) as bus:
        if not bus_faults:
            yield bus
            return
        faulty = FaultyBus(bus, given, seed=seed, clock=lambda: time.monotonic() / slow_motion)
        try:
            yield faulty
        finally:
            faulty.shutdown()


def check_drive(scene: Scene, command: str) -> None:
    """Raises InputError for a scene that no sequencer drives: there is nothing for a bus to carry."""
    if scene.drive.kind != "sequencer":
        raise InputError(
            f'{scene.name}: drive.kind = "{scene.drive.kind}" has no sequencer, so `softbot {command}` has nothing to '
            'do; take a scene with drive.kind = "sequencer", or simulate this one with `softbot run`'
        )


def check_slow_motion(times: float) -> None:
    """Raises InputError for a time that does not pass, goes backwards, or is faster than the clock."""
    if not 1.0 <= times <= MOST_SLOW_MOTION:
        raise InputError(f"--slow-motion {times:g}: give a number from 1 (the clock's time) to {MOST_SLOW_MOTION:g}")


def tell_granted(granted: Granted, tell: Callable[[str], None]) -> None:
    """Say what a process that asked for it was refused."""
    for sentence in granted.refused:
        tell(sentence)


@contextlib.contextmanager
def asked_by_signal() -> Iterator[threading.Event]:
    """An event that SIGUSR1 sets: how is time kept?"""
    asked = threading.Event()
    before = signal.signal(signal.SIGUSR1, lambda number, frame: asked.set())
    try:
        yield asked
    finally:
        signal.signal(signal.SIGUSR1, before)


def sequencer_report(run: SequencerRun) -> dict[str, object]:
    """A sequencer's run as the JSON object of `softbot sequence --json`."""
    return {
        "state": str(run.state),
        "link_failure": str(run.link_failure),
        "detections": [asdict(found) for found in run.detections],
        "recoveries": [answer.entry() for answer in run.recoveries],
        "timing": asdict(run.timing),
    }


def _over(node: SequencerNode, t_s: float, duration_s: float | None) -> bool:
    ended = duration_s is not None and t_s >= duration_s
    return ended or node.failure is not None or node.link_failure is not LinkFailure.NONE
