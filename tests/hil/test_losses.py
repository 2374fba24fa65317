"""Either side stopped or killed, the link down, the bus silent: every chamber vents in time, every time.

The plant is the real one (board, pressure loop, rod twin); the sequencer's end is `light_sequencer`. Times are of the
machine's monotonic clock, from the loss to the board's cycle that sets every valve to exhaust and shuts the supply. A
board that is itself stopped or killed serves its valves no more, and they fall into their safe state when the watchdog
of their driver runs out (docs/hardware.md); that driver is played here, and the sequencer's answer is measured besides.
A trial that fails is repeated, and said so, if the machine itself stood still in it.
"""

from __future__ import annotations

import contextlib
import fcntl
import gc
import math
import mmap
import multiprocessing
import os
import random
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers.pressure_loop import PressureLoopGains
from firmware_protocol.bus import drain, open_bus
from firmware_protocol.codec import decode
from firmware_protocol.enumerations import BoardMode
from sim.scene import Scene
from softbot.nodes import wall_clock
from softbot.nodes.plant_node import PlantNode
from softbot.nodes.wall_clock import OUTPUT_WATCHDOG_S, run_plant

TRIALS = int(os.environ.get("SOFTBOT_TRIALS", "25"))
TIMEOUT_S = 0.1
MARGIN_S = 0.02
STOOD_STILL_S = 0.008
"""A gap in a loop that only sleeps and looks, at the highest priority: it is the machine that was away."""
PRIORITY = 30

_forking = multiprocessing.get_context("fork")
_STATE = struct.Struct("<dd?BxxxxxxI")


@dataclass(frozen=True)
class Valves:
    """What the board last told its valves, and when."""

    served_s: float
    most_open: float
    supply_open: bool
    mode: BoardMode
    moved_unarmed: int

    @property
    def venting(self) -> bool:
        return self.most_open == -1.0 and not self.supply_open


class SharedValves:
    """The valves' lines between the board's process and this one."""

    def __init__(self) -> None:
        self._memory = mmap.mmap(-1, mmap.PAGESIZE)
        self._moved_unarmed = 0

    def serve(self, node: PlantNode) -> None:
        opening, supply_open = node.valves
        mode = node.rules.state.mode
        if mode is not BoardMode.ARMED and (supply_open or (opening != -1.0).any()):
            self._moved_unarmed += 1
        # In one piece: pack_into clears the place first, and a reader may come in between.
        self._memory[: _STATE.size] = _STATE.pack(
            time.monotonic(), float(opening.max()), supply_open, mode, self._moved_unarmed
        )

    def look(self) -> Valves:
        served_s, most_open, supply_open, mode, moved = _STATE.unpack_from(self._memory, 0)
        return Valves(served_s, most_open, supply_open, BoardMode(mode), moved)


@dataclass
class Outcome:
    """The trials of one kind of loss."""

    vented_s: list[float] = field(default_factory=list)
    answered_s: list[float] = field(default_factory=list)
    repeated: int = 0


class Rig:
    """A plant and, for each trial, a sequencer, each a process of its own on vcan0."""

    def __init__(self, scene: Scene, gains: PressureLoopGains) -> None:
        self.scene, self.gains = scene, gains
        self.valves = SharedValves()
        self.listener = open_bus("socketcan", "vcan0")
        self.plant: Any = None
        self.sequencer = 0
        self._zygote = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("light_sequencer.py")), "vcan0"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._said() == ["ready"]
        self.stood_still_s = 0.0
        self.last_command_s = 0.0
        self.zeroed_s = math.inf
        self._last_look_s = 0.0
        self._offset_s = 0.0

    def _said(self) -> list[str]:
        assert self._zygote.stdout is not None
        return self._zygote.stdout.readline().split()

    def start_sequencer(self, silent_after_s: float = math.inf) -> None:
        """… and wait until it has armed the board and pressures are up."""
        moved = self.valves.look().moved_unarmed
        assert self._zygote.stdin is not None
        self._zygote.stdin.write(f"{silent_after_s}\n")
        self._zygote.stdin.flush()
        self.sequencer = int(self._said()[0])
        assert self.until(lambda: self.valves.look().supply_open, 20.0), "the board was not armed"
        assert self.valves.look().moved_unarmed == moved
        self.wait(random.uniform(0.1, 0.2))

    def end_sequencer(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.sequencer, signal.SIGKILL)
        assert self.until(self._sequencer_is_gone, 5.0)

    def _sequencer_is_gone(self) -> bool:
        try:
            os.kill(self.sequencer, 0)
        except ProcessLookupError:
            return True
        return False

    def start_plant(self) -> None:
        """… as a forked process, and wait for its first cycle."""

        def run() -> None:
            run_plant(self.scene, "socketcan", "vcan0", gains=self.gains, urgent=True, watch=self.valves.serve)

        gc.collect()
        gc.freeze()
        self.plant = _forking.Process(target=run)
        self.plant.start()
        started_s = time.monotonic()
        assert self.until(lambda: self.valves.look().served_s > started_s, 20.0), "the plant did not start"
        self.wait(0.2)

    def end_plant(self) -> None:
        self.plant.kill()
        self.plant.join(10.0)
        self.plant.close()

    def close(self) -> None:
        self._zygote.kill()
        self._zygote.communicate()
        self.end_plant()
        self.listener.shutdown()

    def look(self) -> None:
        """A millisecond on: what was on the bus, and whether the machine was away."""
        time.sleep(0.001)
        now_s = time.monotonic()
        if self._last_look_s:
            self.stood_still_s = max(self.stood_still_s, now_s - self._last_look_s)
        self._last_look_s = now_s
        offset_s = now_s - time.time()
        for frame, stamp_s in drain(self.listener):
            if frame.frame_id >= 0x200:
                continue
            name, signals = decode(frame.frame_id, frame.data)
            if name == "SequencerSetpoints":
                self.last_command_s = stamp_s + offset_s
                if signals["Setpoint0"] == 0.0:
                    self.zeroed_s = min(self.zeroed_s, stamp_s + offset_s)

    def until(self, holds: Callable[[], bool], wait_s: float) -> bool:
        deadline_s = time.monotonic() + wait_s
        while not holds():
            if time.monotonic() > deadline_s:
                return False
            with contextlib.suppress(Exception):  # the link may be down
                self.look()
        return True

    def wait(self, duration_s: float) -> None:
        self.until(lambda: False, duration_s)

    def lose(self, how: Callable[[], None]) -> float:
        """Bring about a loss; when it was."""
        self.stood_still_s = self._last_look_s = 0.0
        self.zeroed_s = math.inf
        lost_s = time.monotonic()
        how()
        return lost_s

    def stay_vented(self, duration_s: float = 0.1) -> None:
        """Nothing moves until it is armed again. (That the machine stands still here is not what is measured.)"""
        moved, stood_still_s = self.valves.look().moved_unarmed, self.stood_still_s
        self.wait(duration_s)
        self.stood_still_s = stood_still_s
        assert self.valves.look().venting
        assert self.valves.look().moved_unarmed == moved


def link(up: bool) -> None:
    """`ip link set vcan0 up | down`, by the system call."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        request = struct.pack("16sH22x", b"vcan0", 0)
        flags = struct.unpack_from("16sH", fcntl.ioctl(control, 0x8913, request))[1]  # SIOCGIFFLAGS
        flags = flags | 1 if up else flags & ~1  # IFF_UP
        fcntl.ioctl(control, 0x8914, struct.pack("16sH22x", b"vcan0", flags))  # SIOCSIFFLAGS


@pytest.fixture(scope="module")
def rig(damaged_scene: Callable[..., Scene], gains: PressureLoopGains) -> Iterator[Rig]:
    scene = damaged_scene("fault=[]", "solver.duration_s=100000", "sequencer.start_s=0")
    wall_clock.warm_up(scene)
    wall_clock.rehearse_plant(scene, gains)
    patch = pytest.MonkeyPatch()
    patch.setattr(wall_clock, "warm_up", lambda *_: None)  # done, for all processes that are forked from here
    patch.setattr(wall_clock, "rehearse_plant", lambda *_: None)
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    made = Rig(scene, gains)
    made.start_plant()
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
    yield made
    os.sched_setscheduler(0, *before)
    made.close()
    patch.undo()
    gc.unfreeze()


def campaign(rig: Rig, trial: Callable[[], tuple[float, float]], limit_s: float) -> Outcome:
    """`TRIALS` trials; a trial gives the times to venting and to the sequencer's answer (nan: it is not alive)."""
    outcome = Outcome()
    while len(outcome.vented_s) < TRIALS:
        vented_s, answered_s = trial()
        if (
            max(vented_s, answered_s if math.isfinite(answered_s) else 0.0) > limit_s
            and rig.stood_still_s > STOOD_STILL_S
        ):
            outcome.repeated += 1
            assert outcome.repeated <= max(10, TRIALS), "this machine is too busy to measure anything on"
            continue
        outcome.vented_s.append(vented_s)
        outcome.answered_s.append(answered_s)
    return outcome


def report(title: str, outcome: Outcome, capsys: pytest.CaptureFixture[str]) -> None:
    vented = 1e3 * np.array(outcome.vented_s)
    line = f"{title}: vented after {vented.mean():.1f} ms on average, {vented.max():.1f} ms at worst of {len(vented)}"
    if np.isfinite(outcome.answered_s).all():
        line += f"; the sequencer's setpoints were zero after {1e3 * max(outcome.answered_s):.1f} ms at worst"
    with capsys.disabled():
        print(f"\n{line} ({outcome.repeated} repeated: the machine stood still)")


@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_a_sequencer_that_is_stopped_or_killed(
    rig: Rig, number: signal.Signals, capsys: pytest.CaptureFixture[str]
) -> None:
    def trial() -> tuple[float, float]:
        rig.start_sequencer()
        lost_s = rig.lose(lambda: os.kill(rig.sequencer, number))
        assert rig.until(lambda: rig.valves.look().venting, 2.0)
        vented_s = rig.valves.look().served_s - lost_s
        if number == signal.SIGSTOP:
            os.kill(rig.sequencer, signal.SIGCONT)
        rig.stay_vented()
        rig.end_sequencer()
        return vented_s, math.nan

    outcome = campaign(rig, trial, TIMEOUT_S + MARGIN_S)
    report(f"sequencer {number.name}", outcome, capsys)
    assert max(outcome.vented_s) <= TIMEOUT_S + MARGIN_S


@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_a_plant_that_is_stopped_or_killed(
    rig: Rig, number: signal.Signals, capsys: pytest.CaptureFixture[str]
) -> None:
    def watchdog_ran_out() -> bool:
        return time.monotonic() - rig.valves.look().served_s >= OUTPUT_WATCHDOG_S

    def trial() -> tuple[float, float]:
        rig.start_sequencer()
        lost_s = rig.lose(lambda: os.kill(rig.plant.pid, number))
        assert rig.until(watchdog_ran_out, 2.0)
        vented_s = time.monotonic() - lost_s
        assert rig.until(lambda: rig.zeroed_s < math.inf, 2.0)
        answered_s = rig.zeroed_s - lost_s
        rig.end_sequencer()
        if number == signal.SIGSTOP:
            os.kill(rig.plant.pid, signal.SIGCONT)
            # The cycle that was cut through is finished; the driver's watchdog stays tripped until the valves are safe.
            assert rig.until(lambda: rig.valves.look().venting, 5.0)
        else:
            rig.end_plant()
            rig.start_plant()
        rig.stay_vented()
        return vented_s, answered_s

    outcome = campaign(rig, trial, TIMEOUT_S + MARGIN_S)
    report(f"plant {number.name}", outcome, capsys)
    assert max(outcome.vented_s) <= OUTPUT_WATCHDOG_S + MARGIN_S
    assert max(outcome.answered_s) <= TIMEOUT_S + MARGIN_S


def test_a_link_that_goes_down(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    def trial() -> tuple[float, float]:
        rig.start_sequencer()
        lost_s = rig.lose(lambda: link(up=False))
        try:
            assert rig.until(lambda: rig.valves.look().venting, 2.0)
            vented_s = rig.valves.look().served_s - lost_s
            rig.end_sequencer()
        finally:
            link(up=True)
        rig.stay_vented()
        return vented_s, math.nan

    outcome = campaign(rig, trial, TIMEOUT_S + MARGIN_S)
    report("link down", outcome, capsys)
    assert max(outcome.vented_s) <= TIMEOUT_S + MARGIN_S


def test_a_bus_that_falls_silent(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    def trial() -> tuple[float, float]:
        rig.start_sequencer(silent_after_s=random.uniform(0.3, 0.4))
        rig.lose(lambda: None)
        assert rig.until(lambda: rig.valves.look().venting, 2.0)
        vented_s = rig.valves.look().served_s - rig.last_command_s
        rig.stay_vented()
        rig.end_sequencer()
        return vented_s, math.nan

    outcome = campaign(rig, trial, TIMEOUT_S + MARGIN_S)
    report("silence", outcome, capsys)
    assert max(outcome.vented_s) <= TIMEOUT_S + MARGIN_S
