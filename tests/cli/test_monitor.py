"""`softbot monitor` on a bus that is fed beside it: it shows, and says nothing itself."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from typing import Any

import can
import pytest
from rich.console import Console

from firmware_protocol.board import BoardLimits, BoardRules
from firmware_protocol.bus import drain
from firmware_protocol.bus_watch import BusWatch
from firmware_protocol.frame import Frame
from softbot.cli.monitor import picture

CHANNEL = "cli-monitor"


def board_frames(rules: BoardRules, t_s: float) -> list[Frame]:
    rules.tick(t_s, [1e3] * 4)
    return rules.outgoing(t_s) + rules.measurements(
        t_s,
        pressures_Pa=[1e3] * 4,
        openings=[-1.0] * 4,
        supply_pressure_Pa=250e3,
        main_supply_open=False,
        angular_velocity_rad_s=[0.0] * 3,
        specific_force_m_s2=[0.0, 9.81, 0.0],
    )


@pytest.fixture
def fed(fed_bus: Any) -> Iterator[can.BusABC]:
    with fed_bus(CHANNEL, board_frames) as bus:
        yield bus


def test_it_reports_the_bus_and_sends_nothing(softbot: Any, fed: can.BusABC) -> None:
    result = softbot("monitor", "--interface", "virtual", "--channel", CHANNEL, "--duration-s", "0.5", "--json")
    assert result.exit_code == 0, result.stderr
    report = json.loads(result.stdout)
    assert report["board_mode"] == "safe_latched"
    assert report["safe_reason"] == "power_up"
    assert report["messages"]["BoardPressures"]["frames"] > 10
    assert report["messages"]["BoardPressures"]["errors"] == 0
    assert list(drain(fed)) == []


def test_without_a_terminal_it_shows_the_bus_once(softbot: Any, fed: can.BusABC) -> None:
    result = softbot("monitor", "--interface", "virtual", "--channel", CHANNEL, "--duration-s", "0.3")
    assert result.exit_code == 0, result.stderr
    assert result.stdout.count("BoardHeartbeat") == 1
    assert "safe latched (power up)" in result.stdout


def test_a_bad_duration_and_a_bad_bus_end_with_2(softbot: Any) -> None:
    assert softbot("monitor", "--duration-s", "nan").exit_code == 2
    assert softbot("monitor", "--interface", "socketcan", "--channel", "no_such_can").exit_code == 2


def test_the_picture_tells_what_is_overdue_and_who_is_a_stranger() -> None:
    watch, rules = BusWatch(), BoardRules(BoardLimits(120e3, 150e3))
    for cycle in range(50):
        for frame in board_frames(rules, 0.01 * cycle):
            watch.see(frame, 0.01 * cycle)
    watch.see(Frame(0x7FF, b""), 0.5)

    def shown(now_s: float) -> str:
        console = Console(file=io.StringIO(), width=200)
        console.print(picture(watch, now_s, "socketcan vcan0"))
        return console.file.getvalue()  # type: ignore[attr-defined]

    text = shown(0.5)
    assert "socketcan vcan0" in text
    assert "100.0 Hz" in text
    assert "7FF unknown" in text.replace("  ", " ")
    assert "sequencer not heard" in text
    assert "SupplyPressure 250 kPa" in text
    assert "silent" not in text
    assert "silent" in shown(5.0)
