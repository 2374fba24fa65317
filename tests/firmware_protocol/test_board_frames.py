"""What the board sends, and when."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from firmware_protocol.codec import dbc_hash, decode
from firmware_protocol.enumerations import NO_CHAMBER, BoardMode, BusState, Health, SafeReason
from firmware_protocol.frame import Frame
from firmware_protocol.safety import BoardFaultRecord

NewBench = Callable[..., Any]
REST = (0.0, 0.0, 0.0, 0.0)


def test_heartbeat_and_boot_tell_mode_reason_challenge_version_and_hash(new_bench: NewBench) -> None:
    bench = new_bench(version=(1, 2, 3))
    frames = dict(decode(*frame) for frame in bench.rules.outgoing(0.0))
    assert frames["BoardHeartbeat"]["SafeReason"] == SafeReason.POWER_UP
    boot = frames["BoardBoot"]
    assert (boot["VersionMajor"], boot["VersionMinor"], boot["VersionPatch"]) == (1, 2, 3)
    assert boot["DbcHash"] == dbc_hash()
    bench.arming()
    frames = dict(decode(*frame) for frame in bench.rules.outgoing(2.05))
    heartbeat = frames["BoardHeartbeat"]
    assert heartbeat["BoardMode"] == BoardMode.ARMING
    assert heartbeat["ArmChallenge"] == bench.rules.state.challenge
    assert heartbeat["UptimeS"] == 2


def test_heartbeat_and_boot_keep_their_cycles(new_bench: NewBench) -> None:
    bench = new_bench()
    names = [decode(*f)[0] for cycle in range(100) for f in bench.rules.outgoing(cycle / 100)]
    assert names.count("BoardHeartbeat") == 20
    assert names.count("BoardBoot") == 5
    assert names.count("BoardErrors") == 1
    assert len(names) == 26


def test_faults_keep_their_minimum_gap_and_none_is_lost(new_bench: NewBench) -> None:
    bench = new_bench()
    for _ in range(3):
        bench.disarmed().stop()
    sent_s = []
    for cycle in range(30):
        bench.t_s = cycle / 100
        sent_s += [bench.t_s] * len(bench.faults())
    assert sent_s == [0.0, 0.05, 0.1]


def test_a_new_handshake_is_not_disturbed_by_reports_of_old_latches(new_bench: NewBench) -> None:
    bench = new_bench().disarmed()
    bench.stop()
    bench.arming()
    assert bench.faults() == []


def test_measurements_carry_si_values(new_bench: NewBench) -> None:
    bench = new_bench().running()
    frames = bench.rules.measurements(
        66.0,
        pressures_Pa=(0.0, 1e5, -500.0, 2e6),
        openings=(-1.0, 0.0, 0.5, 1.0),
        supply_pressure_Pa=6e5,
        main_supply_open=True,
        angular_velocity_rad_s=(1.0, -2.0, 0.0),
        specific_force_m_s2=(0.0, 0.0, 9.81),
    )
    content = dict(decode(*frame) for frame in frames)
    assert [frame.frame_id for frame in frames] == [0x200, 0x210, 0x220, 0x230, 0x231]
    assert [content["BoardPressures"][f"Pressure{each}"] for each in range(4)] == pytest.approx(
        [0.0, 100.0, -0.5, 809.1]
    )
    assert content["BoardValves"]["Opening2"] == pytest.approx(0.5)
    assert content["BoardValves"]["MainSupplyOpen"] == 1
    assert content["BoardValves"]["BoardMode"] == BoardMode.ARMED
    assert content["BoardSupply"]["SupplyPressure"] == pytest.approx(600.0)
    assert content["BoardSupply"]["SampleTimeMs"] == 66000 - 65536
    assert content["ImuGyro"]["Y"] == pytest.approx(-2.0)
    assert content["ImuAccelerometer"]["Z"] == pytest.approx(9.81)


def test_measurements_keep_their_cycle(new_bench: NewBench) -> None:
    bench = new_bench()
    content: dict[str, Any] = {
        "pressures_Pa": REST,
        "openings": REST,
        "supply_pressure_Pa": 0.0,
        "main_supply_open": False,
        "angular_velocity_rad_s": (0.0, 0.0, 0.0),
        "specific_force_m_s2": (0.0, 0.0, 0.0),
    }
    sent = [len(bench.rules.measurements(cycle / 1000, **content)) for cycle in range(21)]
    assert [cycle for cycle, count in enumerate(sent) if count == 5] == [0, 6, 16]  # at most 4 ms early
    assert sum(sent) == 15


def test_a_message_with_a_value_that_is_not_finite_is_left_out(new_bench: NewBench) -> None:
    bench = new_bench()
    frames = bench.rules.measurements(
        0.0,
        pressures_Pa=REST,
        openings=REST,
        supply_pressure_Pa=0.0,
        main_supply_open=False,
        angular_velocity_rad_s=(math.nan, 0.0, 0.0),
        specific_force_m_s2=(0.0, 0.0, 0.0),
    )
    assert [decode(*frame)[0] for frame in frames] == [
        "BoardPressures",
        "BoardValves",
        "BoardSupply",
        "ImuAccelerometer",
    ]


def test_the_board_in_python_remembers_why_a_message_was_left_out(python_bench: Any) -> None:
    python_bench.rules.measurements(
        0.0,
        pressures_Pa=REST,
        openings=REST,
        supply_pressure_Pa=0.0,
        main_supply_open=False,
        angular_velocity_rad_s=(math.nan, 0.0, 0.0),
        specific_force_m_s2=(0.0, 0.0, 0.0),
    )
    assert "ImuGyro.X = nan is not a finite number" in python_bench.rules.state.last_error


def test_an_exception_while_sending_ends_in_the_safe_state(new_bench: NewBench) -> None:
    bench = new_bench().running()
    frames = bench.rules.measurements(
        0.0,
        pressures_Pa=(0.0,) * 3,
        openings=REST,
        supply_pressure_Pa=0.0,
        main_supply_open=False,
        angular_velocity_rad_s=(0.0, 0.0, 0.0),
        specific_force_m_s2=(0.0, 0.0, 0.0),
    )
    assert frames == []
    bench.assert_latched(SafeReason.INTERNAL_ERROR)


def test_a_message_that_cannot_be_encoded_ends_in_the_safe_state(python_bench: Any) -> None:
    bench = python_bench.running()
    bench.rules.version = (99, 0, 0)  # no room for it in its four bits
    assert bench.rules.outgoing(bench.t_s) == []
    bench.assert_latched(SafeReason.INTERNAL_ERROR)


def heartbeat(bench: Any, t_s: float) -> dict[str, float]:
    frames: dict[str, dict[str, float]] = dict(decode(*frame) for frame in bench.rules.outgoing(t_s))
    return frames["BoardHeartbeat"]


def test_the_heartbeat_tells_the_boards_health(new_bench: NewBench) -> None:
    bench = new_bench().running()
    assert heartbeat(bench, 0.0)["Health"] == Health.OK
    bench.put(Frame(0x110, bytes(8)))
    assert heartbeat(bench, 0.1)["Health"] == Health.WARNING
    bench.rules.report_bus(BusState.ERROR_PASSIVE)
    assert heartbeat(bench, 0.2)["Health"] == Health.DEGRADED
    bench.stop()
    assert heartbeat(bench, 0.3)["Health"] == Health.DEGRADED  # a stop is no failure of the board
    for t_s, reason in enumerate(
        (SafeReason.SENSOR_INVALID, SafeReason.BUS_OFF, SafeReason.INTERNAL_ERROR, SafeReason.CLOCK_ERROR), start=1
    ):
        bench = new_bench().running()
        bench.rules.report_failure(reason)
        assert heartbeat(bench, t_s)["Health"] == Health.FAILED


def test_error_counters_tell_bus_protection_and_refusals(new_bench: NewBench) -> None:
    bench = new_bench()
    bench.stop()
    bench.rules.outgoing(0.0)
    repeated = bench.peer.send("EmergencyStop", {"Reason": 0})
    bench.put(repeated)
    bench.put(repeated)  # honoured all the same, and no error
    bench.heartbeat()
    frame = bench.peer.send("SequencerHeartbeat", {"State": 0, "Health": 0, "UptimeS": 0})
    bench.put(frame)
    bench.put(frame)  # repeated
    bench.put(frame)  # and again, so that no two kinds come to the same count
    bench.put(frame)
    bench.put(Frame(0x120, bytes(6)))  # CRC
    bench.peer.counters["SequencerHeartbeat"] = 9
    bench.heartbeat()  # jumped
    bench.put(Frame(0x120, bytes(5)))  # length
    bench.put(Frame(0x7FF, bytes(5)))  # unknown
    bench.put(Frame(0x200, bytes(8)))  # the board's own
    bench.rules.report_bus(BusState.ERROR_PASSIVE, transmit_errors=300, receive_errors=7)
    errors = dict(decode(*frame) for frame in bench.rules.outgoing(1.0))["BoardErrors"]
    assert errors | {"Crc": 0, "Counter": 0} == {
        "Crc": 0,
        "Counter": 0,
        "BusState": BusState.ERROR_PASSIVE,
        "TransmitErrors": 255,
        "ReceiveErrors": 7,
        "ProtectionErrors": 5,
        "RefusedFrames": 3,
    }


def test_a_clock_request_is_answered_with_the_boards_clock(new_bench: NewBench) -> None:
    bench = new_bench()
    bench.t_s = 4300.000001  # beyond 2^32 us
    bench.put(bench.peer.send("TimeSyncRequest", {"SyncId": 9, "SendUs": 5}))
    answer = dict(decode(*frame) for frame in bench.rules.outgoing(4300.002101))["TimeSyncResponse"]
    assert (answer["SyncId"], answer["ReceiveUs"], answer["HoldUs"]) == (9, 4_300_000_001 - (1 << 32), 2100)
    assert "TimeSyncResponse" not in dict(decode(*frame) for frame in bench.rules.outgoing(4301.0))
    for sync_id in (1, 2):
        bench.t_s += 2.0
        bench.put(bench.peer.send("TimeSyncRequest", {"SyncId": sync_id, "SendUs": 5}))
    answer = dict(decode(*frame) for frame in bench.rules.outgoing(bench.t_s + 1.0))["TimeSyncResponse"]
    assert (answer["SyncId"], answer["HoldUs"]) == (2, 0xFFFF)  # the last one counts, and it came too long ago
    bench.put(bench.peer.send("TimeSyncRequest", {"SyncId": 3, "SendUs": 5}))
    assert "TimeSyncResponse" not in dict(decode(*frame) for frame in bench.rules.outgoing(bench.t_s + 1.049))
    assert "TimeSyncResponse" in dict(decode(*frame) for frame in bench.rules.outgoing(bench.t_s + 1.05))


def test_after_a_clock_that_went_back_events_are_sent_at_once(new_bench: NewBench) -> None:
    bench = new_bench()
    bench.t_s = 100.0
    bench.disarmed().stop()
    assert bench.faults()
    bench.t_s = 1.0
    bench.disarmed().stop()
    assert bench.faults()


def test_uptime_counts_whole_seconds_from_the_first_cycle(new_bench: NewBench) -> None:
    bench = new_bench()
    bench.t_s = 10.0
    bench.tick()
    uptime_s = []
    for t_s in (10.0, 12.0, 13.999999):
        frames = dict(decode(*frame) for frame in bench.rules.outgoing(t_s))
        uptime_s.append(frames["BoardHeartbeat"]["UptimeS"])
    assert uptime_s == [0, 2, 3]


def test_a_bus_that_says_nothing_of_errors_has_none(python_bench: Any) -> None:
    rules = python_bench.rules
    assert (rules.transmit_errors, rules.receive_errors) == (0, 0)
    rules.report_bus(BusState.ERROR_PASSIVE, 128, 7)
    assert (rules.transmit_errors, rules.receive_errors) == (128, 7)
    rules.report_bus(BusState.ERROR_ACTIVE)
    assert (rules.transmit_errors, rules.receive_errors) == (0, 0)


def test_a_failure_of_another_part_is_reported_without_detail_unless_one_is_given(python_bench: Any) -> None:
    bench = python_bench.disarmed()
    bench.rules.report_failure(SafeReason.INTERNAL_ERROR)
    assert bench.rules.faults_to_send[-1] == BoardFaultRecord(SafeReason.INTERNAL_ERROR, NO_CHAMBER, 0)
