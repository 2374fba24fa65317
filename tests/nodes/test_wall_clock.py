"""The two ends as loops of their own in wall-clock time, joined by nothing but a bus."""

from __future__ import annotations

import itertools
import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from controllers.pressure_loop import PressureLoopGains
from firmware_protocol.bus import drain, opened
from firmware_protocol.bus_faults import BusFault, BusFaultKind
from firmware_protocol.codec import decode
from firmware_protocol.enumerations import SafeReason
from firmware_protocol.errors import BusError
from firmware_protocol.sequencer_link import LinkFailure
from firmware_protocol.trace import read_trace
from sim.plant import Plant
from sim.scene import Scene
from sim.telemetry import read_telemetry
from softbot.errors import SimulationError
from softbot.nodes import wall_clock
from softbot.nodes.wall_clock import run_plant, run_sequencer, sequencer_report

MakeScene = Callable[..., Scene]

SLOW_MOTION = 8.0
"""Of the runs in which something has to come in time: other tests have the machine as well."""


class Thread(threading.Thread):
    """A thread whose result or error is handed on by `finish`."""

    def __init__(self, work: Callable[[], Any]) -> None:
        super().__init__()
        self._work = work
        self._result: Any = None
        self._error: BaseException | None = None

    def run(self) -> None:
        try:
            self._result = self._work()
        except BaseException as error:
            self._error = error

    def finish(self) -> Any:
        self.join(timeout=60.0)
        assert not self.is_alive()
        if self._error is not None:
            raise self._error
        return self._result


def test_both_ends_meet_on_a_bus_and_stop_when_told(
    make_scene: MakeScene, scripted: Any, gains: PressureLoopGains, tmp_path: Path
) -> None:
    scene = make_scene("solver.duration_s=30")
    stop_plant, stop_sequencer = threading.Event(), threading.Event()
    sequencer = scripted((50e3, 0.0, 0.0, 0.0), script={0.5: (2, "leak")})
    channel = "wall-clock-both"
    plant = Thread(
        lambda: run_plant(scene, "virtual", channel, tmp_path, stop=stop_plant, gains=gains, slow_motion=SLOW_MOTION)
    )
    other = Thread(
        lambda: run_sequencer(
            scene, "virtual", channel, stop=stop_sequencer, sequencer=sequencer, slow_motion=SLOW_MOTION
        )
    )
    plant.start()
    other.start()
    deadline_s = time.monotonic() + 40.0
    while (sequencer.armed_since_s is None or sequencer.script) and time.monotonic() < deadline_s:
        time.sleep(0.05)
    time.sleep(0.3 * SLOW_MOTION)
    stop_sequencer.set()
    sequenced = other.finish()
    stop_plant.set()
    planted = plant.finish()

    assert sequencer.armed_since_s is not None
    assert sequenced.link_failure is LinkFailure.NONE
    assert [found.chamber for found in sequenced.detections] == [2]
    telemetry = read_telemetry(tmp_path)
    pressure = telemetry.column("pressure_0_Pa").to_numpy()
    assert pressure.max() > 20e3
    assert pressure[-1] < 0.5 * pressure.max()  # vented before the files were closed
    assert planted.result.summary["outcome"] == "interrupted"
    assert [found["chamber"] for found in planted.result.summary["detections"]] == [2]
    assert "rolling" in telemetry.column("state").to_pylist()
    assert np.diff(telemetry.column("t_s").to_numpy()) == pytest.approx(0.01)
    senders = {frame.frame_id < 0x200 for _, frame in read_trace(tmp_path / "bus.log")}
    assert senders == {True, False}  # both ends' frames are in the plant's log
    for timing in (planted.timing, sequenced.timing):
        assert timing.loop.cycles > 10
        assert 0.0 <= timing.loop.mean_lateness_s <= timing.loop.max_lateness_s
        assert (timing.link.lost, timing.link.refused) == (0, 0)
        assert timing.link.received > 10  # the machine may be busy
        assert 0.0 < timing.link.mean_latency_s <= timing.link.max_latency_s
    loop = json.loads(json.dumps(sequencer_report(sequenced)))["timing"]["loop"]
    assert loop["cycles"] == sequenced.timing.loop.cycles


class Gone(Exception):
    """The plant's process is no more."""


def test_a_plant_that_falls_silent_ends_the_sequencer(
    make_scene: MakeScene, scripted: Any, gains: PressureLoopGains
) -> None:
    scene, sequencer = make_scene("solver.duration_s=30"), scripted()

    def die_once_it_is_armed(_t_s: float) -> None:
        if sequencer.armed_since_s is not None:
            raise Gone

    other = Thread(
        lambda: run_sequencer(scene, "virtual", "wall-clock-silent", sequencer=sequencer, slow_motion=SLOW_MOTION)
    )
    other.start()
    with pytest.raises(Gone):
        run_plant(
            scene, "virtual", "wall-clock-silent", gains=gains, progress=die_once_it_is_armed, slow_motion=SLOW_MOTION
        )
    assert other.finish().link_failure in (LinkFailure.BOARD_SILENT, LinkFailure.MEASUREMENTS_MISSING)


def test_a_sequencer_may_end_by_itself(make_scene: MakeScene, scripted: Any) -> None:
    shown: list[Any] = []
    run = run_sequencer(
        make_scene(), "virtual", "wall-clock-alone", duration_s=0.1, sequencer=scripted(), report=shown.append
    )
    assert run.link_failure is LinkFailure.NONE
    assert len(shown) == run.timing.loop.cycles


def test_a_sequencer_that_fails_stops_the_board_and_says_why(
    make_scene: MakeScene, scripted: Any, gains: PressureLoopGains
) -> None:
    scene = make_scene("solver.duration_s=30")
    stop = threading.Event()
    plant = Thread(
        lambda: run_plant(scene, "virtual", "wall-clock-failing", stop=stop, gains=gains, slow_motion=SLOW_MOTION)
    )
    plant.start()
    with opened("virtual", "wall-clock-failing", preserve_timestamps=False) as listener:
        with pytest.raises(SimulationError, match="the sequencer failed: no bend"):
            run_sequencer(
                scene,
                "virtual",
                "wall-clock-failing",
                sequencer=scripted(script={0.2: ZeroDivisionError("no bend")}),
                slow_motion=SLOW_MOTION,
            )
        stop.set()
        plant.finish()
        ids = set()
        while (message := listener.recv(timeout=0)) is not None:
            ids.add(message.arbitration_id)
    assert 0x10 in ids  # EmergencyStop


def error_frame(error_class: int, counters: tuple[int, int] = (0, 0)) -> can.Message:
    """As SocketCAN delivers it (linux/can/error.h)."""
    return can.Message(is_error_frame=True, arbitration_id=error_class, data=bytes([0] * 6) + bytes(counters))


def test_the_sequencer_says_what_its_can_controller_says(make_scene: MakeScene, scripted: Any) -> None:
    with opened("virtual", "wall-clock-passive", preserve_timestamps=False) as far:
        far_end_spoke = False

        def speak(node: Any) -> None:
            nonlocal far_end_spoke
            if not far_end_spoke:
                far_end_spoke = True
                far.send(error_frame(0x200, (17, 130)))

        run_sequencer(make_scene(), "virtual", "wall-clock-passive", duration_s=1.2, sequencer=scripted(), report=speak)
        told = [decode(frame.frame_id, frame.data) for frame, _ in drain(far)]
    errors = [signals for name, signals in told if name == "SequencerErrors"]
    assert (errors[-1]["BusState"], errors[-1]["TransmitErrors"], errors[-1]["ReceiveErrors"]) == (1, 17, 130)


def test_a_controller_that_is_off_the_bus_latches_the_board(make_scene: MakeScene, gains: PressureLoopGains) -> None:
    reasons = []
    with opened("virtual", "wall-clock-off", preserve_timestamps=False) as far:

        def watch(node: Any) -> None:
            if not reasons:
                far.send(error_frame(0x040))
            reasons.append(node.rules.state.reason)

        run_plant(make_scene(), "virtual", "wall-clock-off", gains=gains, watch=watch)
    assert reasons[0] is not SafeReason.BUS_OFF
    assert reasons[-1] is SafeReason.BUS_OFF


@pytest.fixture
def bus_that_breaks(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bus that takes no more frames after the twentieth cycle."""
    sent = 0

    def send(*_: Any) -> None:
        nonlocal sent
        sent += 1
        if sent > 20:
            raise BusError("cannot send on vcan0: network is down")

    monkeypatch.setattr(wall_clock, "send", send)


@pytest.mark.usefixtures("bus_that_breaks")
def test_a_bus_that_breaks_is_a_failed_run_that_keeps_its_recording(
    make_scene: MakeScene, gains: PressureLoopGains, tmp_path: Path
) -> None:
    openings = []
    with pytest.raises(SimulationError, match=r"the bus failed at t = 0\.[0-5]\d s.*network is down"):
        run_plant(
            make_scene(),
            "virtual",
            "wall-clock-broken",
            tmp_path,
            gains=gains,
            watch=lambda node: openings.append(node.valves),
            slow_motion=SLOW_MOTION,
        )
    assert read_telemetry(tmp_path).num_rows == 60  # the robot vents to the end of the scene
    assert all((opening == -1.0).all() and not supply for opening, supply in openings[21:])
    assert json.loads((tmp_path / "summary.json").read_text())["outcome"].startswith("failed: the bus failed")


def test_a_bus_that_comes_back_finds_the_board_latched(
    make_scene: MakeScene, gains: PressureLoopGains, monkeypatch: pytest.MonkeyPatch
) -> None:
    send = wall_clock.send

    def broken_for_a_while(bus: Any, frames: Any, t_s: float) -> None:
        if 0.2 <= t_s < 0.5:
            raise BusError("cannot send on vcan0: network is down")
        send(bus, frames, t_s)

    reasons = []
    monkeypatch.setattr(wall_clock, "send", broken_for_a_while)
    run = run_plant(
        make_scene("solver.duration_s=1.5"),
        "virtual",
        "wall-clock-back",
        gains=gains,
        slow_motion=SLOW_MOTION,
        watch=lambda node: reasons.append(node.rules.state.reason),
    )
    assert run.result.summary["outcome"] == "done"
    assert list(dict.fromkeys(reasons)) == [SafeReason.POWER_UP, SafeReason.BUS_OFF]


def test_a_plant_with_a_faulty_end_of_the_bus_latches_for_it(make_scene: MakeScene, gains: PressureLoopGains) -> None:
    faults = (
        BusFault(BusFaultKind.BUS_OFF, start_s=0.2, duration_s=0.1),
        BusFault(BusFaultKind.CLOCK_JUMP, start_s=0.3, jump_s=-5.0),
    )
    reasons = []
    run = run_plant(
        make_scene(),
        "virtual",
        "wall-clock-faulty",
        gains=gains,
        bus_faults=faults,
        slow_motion=SLOW_MOTION,
        watch=lambda node: reasons.append(node.rules.state.reason),
    )
    assert run.result.summary["outcome"] == "done"
    assert list(dict.fromkeys(reasons)) == [SafeReason.POWER_UP, SafeReason.BUS_OFF]  # the first reason stays


def test_the_sequencer_reads_its_faults_from_a_file_and_is_told_of_changes(
    make_scene: MakeScene, scripted: Any, tmp_path: Path
) -> None:
    path = tmp_path / "faults.toml"
    path.write_text("[[bus_fault]]\nkind = 'drop'\n")
    told: list[str] = []

    cycles = itertools.count()

    def edit(node: Any) -> None:
        if next(cycles) == 2:
            path.write_text("[[bus_fault]]\nkind = 'silence'\n")

    run_sequencer(
        make_scene(),
        "virtual",
        "wall-clock-fault-file",
        duration_s=0.4,
        sequencer=scripted(),
        bus_faults=path,
        tell=told.append,
        report=edit,
    )
    assert told == ["faults of the bus from now on: silence"]


def test_in_slow_motion_a_second_of_the_robot_lasts_several_of_the_clock(
    make_scene: MakeScene, scripted: Any, gains: PressureLoopGains
) -> None:
    times: list[float] = []
    start_s = time.monotonic()
    run = run_sequencer(
        make_scene(),
        "virtual",
        "wall-clock-slow",
        duration_s=0.2,
        sequencer=scripted(),
        report=lambda node: times.append(time.monotonic() - start_s),
        slow_motion=3.0,
    )
    assert times[-1] - times[0] >= 3.0 * 0.2  # and 0.1 s to disarm
    assert run.timing.loop.period_s == pytest.approx(0.03)
    plant = run_plant(make_scene("solver.duration_s=0.3"), "virtual", "wall-clock-slow", gains=gains, slow_motion=3.0)
    assert plant.result.summary["sim_time_s"] == pytest.approx(0.3)
    assert plant.timing.loop.period_s == pytest.approx(0.03)


def test_the_robot_moves_on_while_its_board_is_held_up(make_scene: MakeScene, gains: PressureLoopGains) -> None:
    held_up = False

    def hold_up(t_s: float) -> None:
        nonlocal held_up
        if t_s > 0.3 and not held_up:
            held_up = True
            time.sleep(0.15)

    cycles = []
    start_s = time.monotonic()
    run = run_plant(
        make_scene(), "virtual", "wall-clock-held", gains=gains, progress=hold_up, watch=lambda node: cycles.append(1)
    )
    assert run.result.telemetry.column("t_s").to_numpy() == pytest.approx(np.arange(1, 61) * 0.01)
    assert len(cycles) <= 60 - 14
    assert run.timing.loop.missed_deadlines >= 14
    assert time.monotonic() - start_s > 0.55


def test_a_board_that_stands_still_loses_its_valves() -> None:
    class Node:
        """As much of a plant node as catches up."""

        def __init__(self) -> None:
            self.open, self.periods_open, self.periods = True, 0, 0

        def release_valves(self) -> None:
            self.open = False

        def advance(self) -> None:
            self.periods += 1
            self.periods_open += self.open

    for missed, played, stood_open in ((0, 0, 0), (7, 7, 7), (30, 30, 10), (1000, 100, 10)):
        node = Node()
        assert wall_clock.catch_up(node, missed) == node.periods == played  # type: ignore[arg-type]
        assert node.periods_open == stood_open


@pytest.mark.usefixtures("bus_that_breaks")
def test_a_bus_that_breaks_ends_the_sequencer(make_scene: MakeScene, scripted: Any) -> None:
    with pytest.raises(SimulationError, match=r"the bus failed at t = 0\..*network is down"):
        run_sequencer(make_scene(), "virtual", "wall-clock-broken", sequencer=scripted())


def test_a_simulation_that_fails_keeps_its_recording(
    make_scene: MakeScene, gains: PressureLoopGains, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls, advance_plant = 0, Plant.advance

    def advance(*args: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls > 5:
            raise SimulationError("not finite")
        return advance_plant(*args)

    monkeypatch.setattr(wall_clock, "warm_up", lambda scene: None)
    monkeypatch.setattr(wall_clock, "rehearse_plant", lambda scene, gains, board: None)
    monkeypatch.setattr(Plant, "advance", advance)
    with pytest.raises(SimulationError, match="not finite"):
        run_plant(make_scene(), "virtual", "wall-clock-nan", tmp_path, gains=gains)
    assert read_telemetry(tmp_path).num_rows == 5
