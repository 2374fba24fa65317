"""Runs without a bus are the runs on a bus: the same telemetry but for round-off, and the same findings."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.pressure_loop import PressureLoopGains
from firmware_protocol.codec import decode, encode
from sim.scene import Scene, scene_from
from softbot.errors import InputError
from softbot.nodes.direct import TRACE, DirectRun, run_direct
from softbot.nodes.ideal_bus import bus_rules, told, told_Pa
from softbot.nodes.lockstep import run_lockstep
from softbot.nodes.plant_node import board_limits
from softbot.robot import load_robot

SAME = ["t_s", "roll_rad", "com_y_m", "bend_rad", "theta_rad", "supply_Pa", "state"]
SAME += [f"{name}_{i}_Pa" for name in ("pressure", "command") for i in range(4)]


def scene_of(*assignments: str, duration_s: float = 2.0) -> Scene:
    table: dict[str, Any] = {
        "robot": "default",
        "drive": {"kind": "sequencer"},
        "sequencer": {"start_s": 0.1},
        "solver": {"twin": "rod", "accuracy": "fast", "duration_s": duration_s},
        "metrics": {"steady_after_s": 0.2},
    }
    return scene_from(table, "short.toml", Path(), assignments)


@pytest.mark.parametrize(
    "assignments",
    [
        ("sequencer.start_s=0.0",),
        ("sequencer.start_s=0.53", "sequencer.speed_rev_s=0.5", 'sequencer.command="right"'),
        ('fault=[{t_s=1.0, chamber=1, kind="rupture"}]', "solver.duration_s=3.0", "solver.seed=4"),
        ('fault=[{t_s=1.0, chamber=0, kind="stuck_open"}]', "solver.duration_s=2.5"),  # the board latches
        ("sequencer.distance_m=0.1", "solver.duration_s=3.0"),
        ('fault=[{t_s=0.9, kind="friction_lost", severity=0.9, ramp_s=0.3}, {t_s=1.2, kind="payload"}]',),
        ('fault=[{t_s=0.9, kind="obstacle", severity=0.1}]', "solver.duration_s=3.0"),
        ('fault=[{t_s=0.9, chamber=2, kind="sensor_dropout", period_s=0.3}, {t_s=1.2, kind="imu_stuck"}]',),
    ],
)
def test_a_run_without_a_bus_is_the_run_on_the_bus(assignments: tuple[str, ...], gains: PressureLoopGains) -> None:
    scene = scene_of(*assignments)
    direct, on_bus = run_direct(scene, gains=gains), run_lockstep(scene, gains=gains)
    for name in SAME:  # compilers may order a sum in two ways: the same but for round-off
        ours, theirs = (run.telemetry.column(name).to_numpy() for run in (direct, on_bus))
        if ours.dtype == object:
            assert list(ours) == list(theirs), name
        else:
            np.testing.assert_allclose(ours, theirs, rtol=1e-7, atol=1e-9, err_msg=name)
    for name in ("detections", "recoveries", "faults", "false_alarms"):
        assert direct.summary[name] == on_bus.summary[name], name
    assert direct.summary["total_revolutions"] == pytest.approx(on_bus.summary["total_revolutions"], abs=1e-9)
    assert len(set(on_bus.telemetry.column("state").to_pylist())) > 1  # something did happen


def test_without_a_bus_it_stops_is_disarmed_and_turns_back_as_on_the_bus(gains: PressureLoopGains) -> None:
    """Vented in between, where the angle of what is left of the pressures is all round-off: states and answers."""
    kerb = 'fault=[{t_s=6.0, kind="obstacle", severity=0.25}]'
    scene = scene_of(kerb, "sequencer.speed_rev_s=0.4", "sequencer.turn_back=true", duration_s=10.5)
    direct, on_bus = run_direct(scene, gains=gains), run_lockstep(scene, gains=gains)
    assert [answer["strategy"] for answer in on_bus.summary["recoveries"]] == ["safe_stop", "other_way"]
    assert direct.summary["recoveries"] == on_bus.summary["recoveries"]
    states = [run.telemetry.column("state").to_pylist() for run in (direct, on_bus)]
    assert states[0] == states[1]
    assert states[0][-1] == "rolling"


def test_a_run_cut_into_parts_is_the_same_run(gains: PressureLoopGains) -> None:
    scene = scene_of('fault=[{t_s=0.7, chamber=3, kind="leak", ramp_s=0.5}]')
    whole, parts = DirectRun(scene, gains=gains), DirectRun(scene, gains=gains)
    expected = whole.advance(150).trace
    found = np.concatenate([parts.advance(n).trace for n in (7, 50, 1, 92)])
    np.testing.assert_array_equal(found, expected)


def test_compiled_code_keeps_no_hold_of_arrays(gains: PressureLoopGains) -> None:
    """The rod's kernel counts no owners, what calls it does: nothing may be left over."""
    run = DirectRun(scene_of(), gains=gains)
    run.advance(1)
    before = [sys.getrefcount(array) for array in (run.twin._memory, run.memory)]
    for _ in range(10):
        run.advance(1)
        run.twin.row()
    assert [sys.getrefcount(array) for array in (run.twin._memory, run.memory)] == before


def test_the_controller_may_believe_in_another_robot(gains: PressureLoopGains) -> None:
    scene = scene_of("robot.actuator.modulus_Pa=1.1e5")
    known = load_robot("default")
    mistaken = DirectRun(scene, known, gains=gains).advance(200).trace
    right = DirectRun(scene, gains=gains).advance(200).trace
    first = TRACE.index("setpoint_0_Pa")
    assert np.abs(mistaken[:, first : first + 4] - right[:, first : first + 4]).max() > 5e3
    softer = DirectRun(scene_of(), known, gains=gains).advance(200).trace
    bent = [np.hypot(*trace[120, 6:8]) for trace in (mistaken, softer)]
    assert bent[0] < 0.9 * bent[1]  # the same pressures bend the stiffer robot less


def test_other_twins_and_drives_are_refused() -> None:
    with pytest.raises(InputError, match="a run without a bus"):
        DirectRun(scene_of('solver.twin="bullet"'))


RULES = bus_rules(board_limits(load_robot("default")))


@settings(max_examples=60)
@given(st.floats(-20e3, 900e3))
def test_numbers_are_rounded_as_the_codec_rounds_them(pressure_Pa: float) -> None:
    names = [f"Pressure{i}" for i in range(4)]
    frame = encode("BoardPressures", dict.fromkeys(names, pressure_Pa / 1000.0))
    assert told_Pa(pressure_Pa, RULES.pressure) == decode(frame.frame_id, frame.data)[1]["Pressure0"] * 1000.0
    spin = pressure_Pa * 1e-4
    frame = encode("ImuGyro", dict.fromkeys("XYZ", spin))
    assert told(spin, RULES.gyro) == decode(frame.frame_id, frame.data)[1]["Y"]
    opening = pressure_Pa / 900e3
    frame = encode("BoardValves", {f"Opening{i}": opening for i in range(4)} | {"MainSupplyOpen": True, "BoardMode": 3})
    assert told(opening, RULES.opening) == decode(frame.frame_id, frame.data)[1]["Opening2"]
