"""Everything that crossed the bus, in the format of `candump -L` (.log), which CAN tools open.

Timestamps are given by the caller (simulated time in lock-step), so that a run's trace is the same bytes
every time. Each call writes whole lines and hands them to the operating system at once: a killed run keeps
all it recorded.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from firmware_protocol.bus import to_frame, to_message
from firmware_protocol.errors import ProtocolError, TraceError
from firmware_protocol.frame import Frame
from firmware_protocol.spec import time_us


class TraceRecord(NamedTuple):
    """A frame and when it was on the bus [s]."""

    t_s: float
    frame: Frame


class TraceWriter:
    """Writes a trace; use it in a `with` statement or `close()` it.

    `channel`: the name of the bus inside the file. Raises TraceError if the file cannot be written.
    """

    def __init__(self, path: str | Path, channel: str = "vcan0") -> None:
        import can

        self.path = Path(path)
        try:
            self._file = self.path.open("w", encoding="ascii", newline="\n")
        except OSError as error:
            raise TraceError(f"cannot write the trace {self.path}: {error.strerror}") from error
        self._writer = can.CanutilsLogWriter(self._file, channel=channel)
        self._last_us = 0

    def write(self, frames: Iterable[Frame], t_s: float) -> None:
        """Records frames at `t_s`; TraceError for a time that is not finite, negative, or before the last."""
        try:
            now_us = time_us(t_s)
        except ProtocolError as error:
            raise TraceError(f"{self.path}: {error}") from error
        if now_us < self._last_us:
            raise TraceError(f"{self.path}: time {t_s} s is before the last one, {self._last_us / 1e6} s")
        self._last_us = now_us
        for frame in frames:
            self._writer.on_message_received(to_message(frame, now_us / 1e6))
        self._file.flush()

    def close(self) -> None:
        """Closes the file; more than once does no harm."""
        self._writer.stop()

    def __enter__(self) -> TraceWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def read_trace(path: str | Path) -> Iterator[TraceRecord]:
    """The frames of a candump log in order; error, remote, extended and CAN FD frames are left out.

    A last line that a killed writer left unfinished is left out too. Raises TraceError naming file and line
    for a file that cannot be read or a line that is no candump record.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="ascii")
    except OSError as error:
        raise TraceError(f"cannot read the trace {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise TraceError(f"{path} is no candump log: it is not text ({error.reason})") from error
    lines = text.split("\n")
    lines.pop()  # empty after a whole last line, else the unfinished one
    for number, line in enumerate(lines, start=1):
        yield from _read_line(path, number, line)


def _read_line(path: Path, number: int, line: str) -> Iterator[TraceRecord]:
    import io

    import can

    try:
        for message in can.CanutilsLogReader(io.StringIO(line)):
            frame = to_frame(message)
            if frame is not None:
                yield TraceRecord(message.timestamp, frame)
    except (ValueError, IndexError) as error:
        raise TraceError(f"{path}, line {number}: {line[:60]!r} is no candump record: {error}") from error
