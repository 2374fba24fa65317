"""A trace reads back, by python-can too, has the same bytes each time, and survives a kill."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import can
import pytest

from firmware_protocol.e2e import Sender
from firmware_protocol.errors import TraceError
from firmware_protocol.frame import Frame
from firmware_protocol.trace import TraceRecord, TraceWriter, read_trace


def record(path: Path) -> list[TraceRecord]:
    sender = Sender()
    records = []
    with TraceWriter(path, channel="vcan7") as writer:
        for cycle in range(20):
            t_s = cycle / 100
            setpoints = {f"Setpoint{chamber}": float(cycle) for chamber in range(4)}
            frames = [
                sender.send("SequencerSetpoints", setpoints),
                sender.send("EmergencyStop", {"Reason": 1}),
            ]
            writer.write(frames, t_s)
            records += [TraceRecord(t_s, frame) for frame in frames]
    return records


def test_a_trace_reads_back_as_written(tmp_path: Path) -> None:
    records = record(tmp_path / "bus.log")
    assert list(read_trace(tmp_path / "bus.log")) == records


def test_python_can_reads_a_trace(tmp_path: Path) -> None:
    records = record(tmp_path / "bus.log")
    with can.LogReader(tmp_path / "bus.log") as reader:
        messages = list(reader)
    assert [(each.timestamp, each.arbitration_id, bytes(each.data)) for each in messages] == [
        (t_s, frame.frame_id, frame.data) for t_s, frame in records
    ]
    assert {each.channel for each in messages} == {"vcan7"}


def test_the_same_run_gives_the_same_bytes_in_candumps_format(tmp_path: Path) -> None:
    record(tmp_path / "first.log")
    record(tmp_path / "second.log")
    first = (tmp_path / "first.log").read_bytes()
    assert first == (tmp_path / "second.log").read_bytes()
    with TraceWriter(tmp_path / "one.log") as writer:
        writer.write([Frame(0x010, b"\xab\x01")], 1.5)
    assert (tmp_path / "one.log").read_bytes() == b"(1.500000) vcan0 010#AB01 R\n"


def test_a_killed_writer_leaves_all_it_wrote(tmp_path: Path) -> None:
    path = tmp_path / "killed.log"
    code = (
        "import os, signal, sys\n"
        "from firmware_protocol.frame import Frame\n"
        "from firmware_protocol.trace import TraceWriter\n"
        "writer = TraceWriter(sys.argv[1])\n"
        "for cycle in range(100):\n"
        "    writer.write([Frame(0x110, bytes(8))], cycle / 100)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    process = subprocess.run([sys.executable, "-c", code, os.fspath(path)], check=False)
    assert process.returncode == -signal.SIGKILL
    assert [t_s for t_s, _ in read_trace(path)] == [cycle / 100 for cycle in range(100)]


def test_an_unfinished_last_line_is_left_out(tmp_path: Path) -> None:
    records = record(tmp_path / "bus.log")
    content = (tmp_path / "bus.log").read_bytes()
    (tmp_path / "cut.log").write_bytes(content[:-7])
    assert list(read_trace(tmp_path / "cut.log")) == records[:-1]


def test_traces_of_other_tools_read_with_their_strange_frames_left_out(tmp_path: Path) -> None:
    (tmp_path / "candump.log").write_text(
        "(1699.000001) can0 110#0011\n\n(1699.1) can0 00000110#0011\n(1699.2) can0 110#R\n"
        "(1699.3) can0 110##1AA\n(1699.4) can0 20000080#0000000000000000\n(1699.5) can0 7FF# T\n"
    )
    assert [record.frame for record in read_trace(tmp_path / "candump.log")] == [
        Frame(0x110, b"\x00\x11"),
        Frame(0x7FF, b""),
    ]


@pytest.mark.parametrize(
    "line",
    [
        "what is this",
        "(1.0) can0 110",
        "(x) can0 110#00",
        "(1.0) can0 110##",
        "(nan) can0 110#00",
        "(1e18) can0 110#00",
    ],
)
def test_a_line_that_is_none_is_named(tmp_path: Path, line: str) -> None:
    (tmp_path / "bad.log").write_text(f"(0.5) can0 110#00\n{line}\n")
    with pytest.raises(TraceError, match=r"bad\.log, line 2: .*is no candump record"):
        list(read_trace(tmp_path / "bad.log"))


def test_files_that_cannot_be_are_named(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match=r"cannot read the trace .*none\.log: No such file"):
        list(read_trace(tmp_path / "none.log"))
    with pytest.raises(TraceError, match=r"cannot write the trace .*No such file"):
        TraceWriter(tmp_path / "none" / "bus.log")
    (tmp_path / "binary.log").write_bytes(b"\xff\x00\xfe")
    with pytest.raises(TraceError, match="not text"):
        list(read_trace(tmp_path / "binary.log"))


def test_times_must_be_finite_and_go_forward(tmp_path: Path) -> None:
    with TraceWriter(tmp_path / "bus.log") as writer:
        writer.write([], 1.0)
        for t_s in (0.99, -1.0, float("nan")):
            with pytest.raises(TraceError, match=r"bus\.log"):
                writer.write([], t_s)
        writer.close()  # closing twice does no harm


@pytest.mark.parametrize("name", ["bus.asc", "bus.blf"])
def test_the_formats_of_other_tools_read_back_with_their_times(tmp_path: Path, name: str) -> None:
    records = record(tmp_path / name)
    assert [each.frame for each in read_trace(tmp_path / name)] == [each.frame for each in records]
    times = [each.t_s for each in read_trace(tmp_path / name)]
    assert times == pytest.approx([each.t_s for each in records], abs=1e-6)
    with can.LogReader(tmp_path / name) as reader:
        assert [message.arbitration_id for message in reader] == [each.frame.frame_id for each in records]


@pytest.mark.parametrize("name", ["bus.log", "bus.asc", "bus.blf"])
def test_python_can_plays_a_trace_onto_a_bus(tmp_path: Path, name: str) -> None:
    records = record(tmp_path / name)
    with can.LogReader(tmp_path / name) as reader, can.Bus(f"play-{name}", "virtual") as far:
        with can.Bus(f"play-{name}", "virtual") as near:
            for message in can.MessageSync(reader, timestamps=False):
                near.send(message)
        came = [far.recv(1.0) for _ in records]
    assert [(m.arbitration_id, bytes(m.data)) for m in came if m is not None] == [tuple(each.frame) for each in records]


def test_what_is_no_such_trace_is_named(tmp_path: Path) -> None:
    for name in ("bus.asc", "bus.blf"):
        (tmp_path / name).write_bytes(b"\x00 what is this \xff" * 20)
        with pytest.raises(TraceError, match=f"{name} is no .* trace"):
            list(read_trace(tmp_path / name))
        with pytest.raises(TraceError, match=r"cannot read the trace .*none"):
            list(read_trace(tmp_path / f"none{name}"))


def test_a_trace_of_an_unknown_format_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match=r"bus\.pcap: the name of a trace ends with \.log, \.asc, \.blf"):
        TraceWriter(tmp_path / "bus.pcap")


@pytest.mark.parametrize("name", ["bus.asc", "bus.blf"])
def test_frames_that_are_none_of_ours_are_left_out_of_the_formats_of_other_tools(tmp_path: Path, name: str) -> None:
    ours = can.Message(timestamp=1.0, arbitration_id=0x100, data=b"\x01", is_extended_id=False)
    remote = can.Message(timestamp=2.0, arbitration_id=0x101, is_remote_frame=True, is_extended_id=False)
    with can.Logger(tmp_path / name) as logger:
        for message in (ours, remote):
            logger(message)
    assert [each.frame for each in read_trace(tmp_path / name)] == [Frame(0x100, b"\x01")]
