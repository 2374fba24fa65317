"""Both ends on vcan for an hour: no command is lost, memory and open files stay what they were.

Once in simulated time, every frame through the kernel's bus but none waited for (`make soak-simulated`, minutes), once
as two processes in wall-clock time (`make soak`).
"""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from controllers.pressure_loop import PressureLoopGains
from sim.scene import CONTROL_PERIOD_S, Scene
from softbot.nodes.lockstep import run_lockstep
from softbot.nodes.plant_node import PlantNode
from softbot.nodes.sequencer_node import SequencerNode

SOAK_S = float(os.environ.get("SOFTBOT_SOAK_S", "3600"))
SETTLE_S = 60.0
SCENE = Path(__file__).parents[2] / "scenes" / "damaged.toml"
SOFTBOT = "import sys; from softbot.cli import main; sys.argv = ['softbot', *sys.argv[1:]]; main()"


def softbot(command: str, *options: str) -> subprocess.Popen[str]:
    """`softbot COMMAND` on vcan0: a healthy robot that rolls for as long as it is let."""
    settings = ["--set", "fault=[]", "--set", f"solver.duration_s={SOAK_S + 600.0}"]
    bus = ["--interface", "socketcan", "--channel", "vcan0", "--real-time", "--json"]
    return subprocess.Popen(
        [sys.executable, "-c", SOFTBOT, command, str(SCENE), *settings, *bus, *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def resident_MB(process_id: int) -> float:
    pages = int(Path(f"/proc/{process_id}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def open_files(process_id: int) -> int:
    return len(os.listdir(f"/proc/{process_id}/fd"))


@pytest.mark.soak
def test_an_hour_of_simulated_time(
    damaged_scene: Callable[..., Scene], gains: PressureLoopGains, tmp_path: Path
) -> None:
    scene = damaged_scene("fault=[]", f"solver.duration_s={SOAK_S}")
    cycles = round(SOAK_S / CONTROL_PERIOD_S)
    settled, every = round(min(SETTLE_S, SOAK_S / 4.0) / CONTROL_PERIOD_S), max(cycles // 20, 1)
    seen: list[tuple[float, int]] = []
    nodes: list[tuple[PlantNode, SequencerNode]] = []
    done = itertools.count(1)

    def watch(plant: PlantNode, sequencer: SequencerNode) -> None:
        cycle = next(done)
        if cycle == settled or (cycle > settled and cycle % every == 0):
            seen.append((resident_MB(os.getpid()), open_files(os.getpid())))
            print(f"{cycle * CONTROL_PERIOD_S:7.0f} s: {seen[-1][0]:.1f} MB, {seen[-1][1]} files", flush=True)
        nodes[:] = [(plant, sequencer)]

    result = run_lockstep(scene, tmp_path / "run", gains=gains, transport=("socketcan", "vcan0"), watch=watch)
    assert (result.summary["outcome"], result.summary["sim_time_s"]) == ("done", SOAK_S)
    assert result.summary["detections"] == []
    ((plant, sequencer),) = nodes
    for reception, cyclic in (
        (plant.rules.reception, "SequencerSetpoints"),
        (sequencer.link.reception, "BoardPressures"),
    ):
        assert (reception.protection_errors, reception.refused_frames) == (0, 0)
        receiver = reception.messages[cyclic].receiver
        assert receiver.lost_frames == 0
        assert sum(receiver.counts.values()) >= cycles - 1
    assert {files for _, files in seen} == {seen[0][1]}
    assert seen[-1][0] - seen[0][0] < 5.0 + 5.0 * SOAK_S / 3600.0


@pytest.mark.soak
def test_an_hour_of_wall_clock_time(tmp_path: Path) -> None:
    sequencer = softbot("sequence")
    assert sequencer.stderr is not None
    assert "waiting for the board" in sequencer.stderr.readline()
    plant = softbot("plant", "--out", str(tmp_path / "run"))
    both = {"plant": plant, "sequencer": sequencer}
    started_s = time.monotonic()
    first: dict[str, tuple[float, int]] = {}
    last: dict[str, tuple[float, int]] = {}
    while (passed_s := time.monotonic() - started_s) < SOAK_S:
        time.sleep(min(30.0, SOAK_S / 10.0))
        for name, process in both.items():
            assert process.poll() is None, f"the {name} ended: {process.communicate()[1]}"
            last[name] = resident_MB(process.pid), open_files(process.pid)
            if passed_s >= min(SETTLE_S, SOAK_S / 4.0):
                first.setdefault(name, last[name])
        print(
            f"{passed_s:7.0f} s: " + ", ".join(f"{name} {mb:.1f} MB, {fds} files" for name, (mb, fds) in last.items())
        )
    sequencer.send_signal(signal.SIGTERM)
    said, told = sequencer.communicate(timeout=60)
    plant.send_signal(signal.SIGTERM)
    _, told_too = plant.communicate(timeout=300)
    print(told + told_too)
    sequenced = json.loads(said)
    assert sequenced["link_failure"] == "none"
    assert sequenced["detections"] == []
    timing = json.loads((tmp_path / "run" / "timing.json").read_text())
    for link in (timing["link"], sequenced["timing"]["link"]):
        assert (link["lost"], link["refused"]) == (0, 0)
        assert link["received"] >= 95 * (SOAK_S - SETTLE_S)
    for name, (memory_MB, files) in first.items():
        assert last[name][1] == files
        assert last[name][0] - memory_MB < 5.0 + 5.0 * SOAK_S / 3600.0, name
