"""`softbot hub` as a process: it says where it is, carries frames, and stops when told."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from firmware_protocol.bus import opened, send
from firmware_protocol.frame import Frame

HUB = "import sys; from softbot.cli import main; sys.argv = ['softbot', 'hub', *sys.argv[1:]]; main()"


def test_it_carries_frames_until_it_is_stopped(tmp_path: Path) -> None:
    channel = str(tmp_path / "bench.sock")
    process = subprocess.Popen([sys.executable, "-c", HUB, "--channel", channel], stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    assert process.stderr.readline() == f"softbot: hub on {channel}; join it with --interface hub --channel {channel}\n"
    with (
        opened("hub", channel, start_hub=False, receive_own_messages=True) as one,
        opened("hub", channel, start_hub=False) as two,
    ):
        send(one, [Frame(0x100, b"")], 0.0)
        assert one.recv(5.0) is not None
        assert two.recv(5.0) is not None
        process.send_signal(signal.SIGTERM)
        assert process.wait(10.0) == 0
    assert process.stderr.read() == "softbot: carried 1 frames; 0 were lost at clients that did not read\n"
    process.stderr.close()
    assert not os.path.exists(channel)


def test_a_channel_elsewhere_ends_with_2(softbot: Any) -> None:
    result = softbot("hub", "--channel", "example.org:5000")
    assert result.exit_code == 2
    assert "on this machine only" in result.stderr
