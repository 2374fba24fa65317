"""Everything that crossed the bus, in a file that CAN tools open; the format follows from the name.

    .log  `candump -L`: text, each call on disk at once; the same run gives the same bytes, a killed one keeps all of it
    .asc  Vector ASCII, times from the first frame
    .blf  Vector binary, compressed in blocks: a killed writer loses the last one

Timestamps are given by the caller (simulated time in lock-step).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import IO, Any, NamedTuple

from firmware_protocol.bus import to_frame, to_message
from firmware_protocol.errors import ProtocolError, TraceError
from firmware_protocol.frame import Frame
from firmware_protocol.spec import time_us

FORMATS = (".log", ".asc", ".blf")
LATEST_S = 253_402_300_799.0
"""The last second of the year 9999, since 1970: no recording is from later."""


class TraceRecord(NamedTuple):
    """A frame and when it was on the bus [s]."""

    t_s: float
    frame: Frame


class TraceWriter:
    """Writes a trace; use it in a `with` statement or `close()` it.

    `channel`: the name of the bus inside a .log. Raises TraceError if the file cannot be written or has another name.
    """

    def __init__(self, path: str | Path, channel: str = "vcan0") -> None:
        import can

        self.path = Path(path)
        kind = self.path.suffix.lower()
        if kind not in FORMATS:
            raise TraceError(f"{self.path}: the name of a trace ends with {', '.join(FORMATS)}")
        self._text: IO[str] | None = None
        try:
            if kind == ".log":
                self._text = self.path.open("w", encoding="ascii", newline="\n")
                self._writer: Any = can.CanutilsLogWriter(self._text, channel=channel)
            else:
                self._writer = can.ASCWriter(self.path) if kind == ".asc" else can.BLFWriter(self.path)
        except OSError as error:
            raise TraceError(f"cannot write the trace {self.path}: {error.strerror}") from error
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
        if self._text is not None:
            self._text.flush()

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
    """The frames of a trace in order; error, remote, extended and CAN FD frames are left out.

    A last line of a .log that a killed writer left unfinished is left out too; any name that is neither .asc nor .blf
    is taken for a .log. Raises TraceError naming the file (and line) for one that cannot be read or is no such trace.
    """
    path = Path(path)
    if path.suffix.lower() in (".asc", ".blf"):
        yield from _read_other(path)
        return
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


def _time_s(stamp_s: float) -> float:
    if not abs(stamp_s) <= LATEST_S:  # nor is NaN
        raise ValueError(f"{stamp_s} s is no time")
    return stamp_s


def _read_other(path: Path) -> Iterator[TraceRecord]:
    import can

    binary = path.suffix.lower() == ".blf"
    try:
        with path.open("rb" if binary else "r") as file:
            stream: Any = file
            reader: Iterable[can.Message] = can.BLFReader(stream) if binary else can.ASCReader(stream)
            for message in reader:
                frame = to_frame(message)
                if frame is not None:
                    yield TraceRecord(_time_s(message.timestamp), frame)
    except OSError as error:
        raise TraceError(f"cannot read the trace {path}: {error.strerror or error}") from error
    except Exception as error:  # python-can's readers raise what they stumble over
        raise TraceError(f"{path} is no {path.suffix} trace: {type(error).__name__}: {error}") from error


def _read_line(path: Path, number: int, line: str) -> Iterator[TraceRecord]:
    import io

    import can

    try:
        for message in can.CanutilsLogReader(io.StringIO(line)):
            frame = to_frame(message)
            if frame is not None:
                yield TraceRecord(_time_s(message.timestamp), frame)
    except (ValueError, IndexError) as error:
        raise TraceError(f"{path}, line {number}: {line[:60]!r} is no candump record: {error}") from error
