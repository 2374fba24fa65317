"""`softbot shadow`: over a recording and on a live bus, to which it says nothing."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import can
import pytest

from firmware_protocol.board import BoardLimits, BoardRules
from firmware_protocol.bus import drain
from firmware_protocol.trace import TraceWriter

CHANNEL = "cli-shadow"
WAVE_Pa = 3e3


def board_frames(rules: BoardRules, t_s: float) -> list[Any]:
    """A board whose chambers are vented, with sensors that are alive."""
    noise_Pa = [WAVE_Pa * ((1.7 * i + 61.0 * t_s) % 1.0 - 0.5) / 10.0 for i in range(4)]
    rules.tick(t_s, noise_Pa)
    return rules.outgoing(t_s) + rules.measurements(
        t_s,
        pressures_Pa=noise_Pa,
        openings=[-1.0] * 4,
        supply_pressure_Pa=250e3,
        main_supply_open=True,
        angular_velocity_rad_s=[1e-3 * noise_Pa[0], 0.0, 0.0],
        specific_force_m_s2=[0.0, 9.81, 1e-3 * noise_Pa[1]],
    )


@pytest.fixture
def fed(fed_bus: Any) -> Iterator[can.BusABC]:
    with fed_bus(CHANNEL, board_frames) as bus:
        yield bus


@pytest.fixture
def trace(tmp_path: Path) -> Path:
    rules = BoardRules(BoardLimits(120e3, 150e3))
    with TraceWriter(tmp_path / "bus.log") as writer:
        for n in range(250):
            writer.write(board_frames(rules, 0.01 * n), 0.01 * n)
    return tmp_path / "bus.log"


def test_it_watches_a_live_bus_and_sends_nothing(softbot: Any, fed: can.BusABC, tmp_path: Path) -> None:
    result = softbot(
        "shadow", "--interface", "virtual", "--channel", CHANNEL, "--duration-s", "0.8", "--every-s", "0.2",
        "--findings", tmp_path / "found.jsonl", "--json",
    )  # fmt: skip
    assert result.exit_code == 0, result.stderr
    told = json.loads(result.stdout)
    assert told["samplings"] > 20
    assert told["refused"] == 0
    assert len(told["final"]["chambers"]) == 4
    lines = [json.loads(line) for line in (tmp_path / "found.jsonl").read_text().splitlines()]
    assert [one["event"] for one in lines][-1] == "end"
    assert "estimate" in {one["event"] for one in lines}
    assert list(drain(fed)) == []  # nobody else has spoken


def test_a_recording_is_told_in_words_and_health_is_kept(softbot: Any, trace: Path, tmp_path: Path) -> None:
    result = softbot("shadow", trace, "--robot", "default", "--health", tmp_path / "health.json")
    assert result.exit_code == 0, result.stderr
    assert "healthy" in result.stdout
    assert "250 samplings" in result.stdout
    assert not (tmp_path / "health.json").exists()  # vented throughout: there was nothing to learn


def test_a_trace_in_a_run_folder_is_of_the_robot_of_that_run(softbot: Any, trace: Path, tmp_path: Path) -> None:
    scene = 'robot = "another.toml"\n[drive]\nkind = "sequencer"\n'
    result = softbot("shadow", trace)
    assert "robot: asu_four_chamber_arm, shipped with softbot; for another give --robot" in result.stderr
    built = (files("softbot") / "data" / "default_robot.toml").read_text("utf-8")
    (tmp_path / "another.toml").write_text(built.replace("asu_four_chamber_arm", "another"), "utf-8")
    (tmp_path / "scene.toml").write_text(scene, encoding="utf-8")
    for source in (trace, tmp_path):
        result = softbot("shadow", source)
        assert result.exit_code == 0, result.stderr
        assert f"robot: another, of {tmp_path / 'scene.toml'}" in result.stderr
    assert "of --robot default" in softbot("shadow", trace, "--robot", "default").stderr


@pytest.mark.parametrize("columns", [50, 80])
def test_a_narrow_terminal_keeps_the_numbers_of_the_chambers(
    softbot: Any, trace: Path, monkeypatch: pytest.MonkeyPatch, columns: int
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    lines = softbot("shadow", trace).stdout.splitlines()
    rows = [line.split() for line in lines if "±" in line and "gyro" not in line]
    assert [row[0] for row in rows] == ["0", "1", "2", "3"]
    assert [row[-1] for row in rows] == ["healthy"] * 4
    assert not any("…" in line for line in lines)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("nowhere.log",), "cannot read the trace nowhere.log"),
        (("nowhere.log", "--channel", "vcan0"), "a recording has no --interface"),
        (("--every-s", "0"), "--every-s 0: give a positive number"),
        (("--interface", "virtual", "--channel", "x", "--duration-s", "nan"), "--duration-s nan"),
        (("--interface", "nothing"), "CAN interface 'nothing'"),
        (("--interface", "virtual", "--channel", "silent", "--duration-s", "0.1"), "no valid frame of a valve board"),
        (("--robot", "nowhere.toml"), "nowhere.toml"),
        (("--interface", "virtual", "--findings", "no/such/f.jsonl"), "--findings no/such/f.jsonl: cannot be written"),
    ],
)
def test_what_cannot_be_watched_is_refused(softbot: Any, arguments: tuple[str, ...], says: str) -> None:
    result = softbot("shadow", *arguments)
    assert result.exit_code == 2, result.stdout
    assert says in result.stderr
    assert "Traceback" not in result.stderr
