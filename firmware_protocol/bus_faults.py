"""Faults of the bus, injected at one node's end: `FaultyBus` stands between a node and any python-can bus.

What happens to a frame follows from the faults that are on at that time, in the order in which they are given, from the
seed, and from nothing else. Frames that are held back (delay, reorder) are passed on when the node next sends or reads:
a node's loop does so in every cycle, and there is no thread here.

    [[bus_fault]]
    kind = "drop"                      # see BusFaultKind
    direction = "send"                 # "send" | "receive" | "both" (default), as this node sees it
    message = "SequencerSetpoints"     # default: every message
    start_s = 4.0                      # from when the faults were read, default 0
    duration_s = 2.0                   # default: for ever
    probability = 0.2                  # that it strikes a frame, default 1
"""

from __future__ import annotations

import heapq
import itertools
import math
import random
import time
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from enum import StrEnum
from pathlib import Path
from typing import Any

import can

from firmware_protocol.codec import decode, encode
from firmware_protocol.e2e import protect
from firmware_protocol.errors import BusFaultError, ProtocolError
from firmware_protocol.frame import Frame
from firmware_protocol.spec import COUNTER_VALUES, spec


class BusFaultKind(StrEnum):
    """What can go wrong."""

    DROP = "drop"
    """Frames are lost."""
    DELAY = "delay"
    """Frames come `delay_s` late."""
    REORDER = "reorder"
    """A frame is overtaken by the next one."""
    DUPLICATE = "duplicate"
    """Frames come twice."""
    CORRUPT = "corrupt"
    """`bits` bits of the data are flipped, past the bus's own CRC."""
    BABBLE = "babble"
    """A node that does not stop: frames of `frame_id` with random data, one each `period_s`."""
    WRONG_VERSION = "wrong_version"
    """The DBC hash in the frames that carry one is another's; they are valid otherwise."""
    COUNTER_STUCK = "counter_stuck"
    """The counter of a message stays as it was; its CRC is right."""
    SLOW = "slow"
    """A message comes once in `period_s` at most, with its counter in sequence."""
    SILENCE = "silence"
    """Nothing passes, and no error tells of it."""
    BUS_OFF = "bus_off"
    """The bus refuses to send and to read."""
    CLOCK_JUMP = "clock_jump"
    """The node's clock is off by `jump_s`; see `FaultyBus.clock_offset_s`."""


class Direction(StrEnum):
    """Which frames a fault strikes, as the node with the faulty end sees them."""

    SEND = "send"
    RECEIVE = "receive"
    BOTH = "both"


@dataclass(frozen=True)
class BusFault:
    """One fault; see the module and `BusFaultKind` for its keys. Raises BusFaultError for values that cannot be."""

    kind: BusFaultKind
    direction: Direction = Direction.BOTH
    message: str | None = None
    start_s: float = 0.0
    duration_s: float = math.inf
    probability: float = 1.0
    delay_s: float = 0.05
    bits: int = 1
    frame_id: int = 0
    period_s: float = 0.001
    jump_s: float = -1.0

    def __post_init__(self) -> None:
        known = [message.name for message in spec().messages]
        if self.message is not None and self.message not in known:
            raise BusFaultError(
                f"message = {self.message!r}: no message of softbot.dbc; take one of {', '.join(known)}"
            )
        for name, lowest, highest in (
            ("start_s", 0.0, math.inf),
            ("duration_s", 0.0, math.inf),
            ("probability", 0.0, 1.0),
            ("delay_s", 0.0, 60.0),
            ("bits", 1, 64),
            ("frame_id", 0, 0x7FF),
            ("period_s", 1e-4, 60.0),
            ("jump_s", -1e6, 1e6),
        ):
            value = getattr(self, name)
            if not lowest <= value <= highest:
                raise BusFaultError(f"{name} = {value}: must be from {lowest:g} to {highest:g}")

    def strikes(self, t_s: float, sending: bool, name: str | None) -> bool:
        """Whether it is on at `t_s` for frames of message `name` (None: not in the DBC) in this direction."""
        here = self.direction is Direction.BOTH or (self.direction is Direction.SEND) == sending
        on = self.start_s <= t_s < self.start_s + self.duration_s
        return here and on and (self.message is None or self.message == name)


def read_bus_faults(path: str | Path) -> tuple[BusFault, ...]:
    """The `[[bus_fault]]` tables of a TOML file. Raises BusFaultError naming file, table and key."""
    try:
        tables = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise BusFaultError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:  # not TOML, or not text
        raise BusFaultError(f"{path}: is no TOML: {error}") from None
    unknown = sorted(set(tables) - {"bus_fault"})
    if unknown or not isinstance(tables.get("bus_fault", []), list):
        raise BusFaultError(
            f"{path}: holds {', '.join(unknown) or 'bus_fault'}; only [[bus_fault]] tables belong there"
        )
    found = []
    for number, table in enumerate(tables.get("bus_fault", [])):
        try:
            found.append(bus_fault_from(table))
        except BusFaultError as error:
            raise BusFaultError(f"{path}: bus_fault.{number}.{error}") from None
    return tuple(found)


def bus_fault_from(table: Mapping[str, Any]) -> BusFault:
    """A fault from its keys. Raises BusFaultError naming the key."""
    values = dict(table)
    names = {item.name for item in fields(BusFault)}
    for name in values:
        if name not in names:
            raise BusFaultError(f"{name}: unknown key; there are {', '.join(sorted(names))}")
    if "kind" not in values:
        raise BusFaultError(f"kind: missing; take one of {', '.join(BusFaultKind)}")
    for name, choices in (("kind", BusFaultKind), ("direction", Direction)):
        try:
            if name in values:
                values[name] = choices(values[name])
        except ValueError:
            raise BusFaultError(f"{name} = {values[name]!r}: take one of {', '.join(choices)}") from None
    for name, value in values.items():
        if name in ("kind", "direction"):
            continue
        wanted: tuple[type, ...] = (float, int)
        if name in ("bits", "frame_id"):
            wanted = (int,)
        elif name == "message":
            wanted = (str,)
        if not isinstance(value, wanted) or isinstance(value, bool) or value != value:
            raise BusFaultError(f"{name} = {value!r}: must be a {'word' if name == 'message' else 'number'}")
    return BusFault(**values)


class FaultyBus(can.BusABC):
    """A bus as a node sees it through its faults. `faults` may be set at any time; their time begins then.

    `clock` [s] is that of the faults, monotonic.
    """

    def __init__(
        self,
        bus: can.BusABC,
        faults: Iterable[BusFault] = (),
        *,
        seed: int = 0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._is_shutdown = True  # until it is whole
        self._bus, self._clock = bus, clock
        self._random = random.Random(seed)
        self._order = itertools.count()
        self.faults = tuple(faults)
        self.channel_info = f"{bus.channel_info} with faults"
        super().__init__(getattr(bus, "channel", ""))
        self._is_shutdown = False

    @property
    def faults(self) -> tuple[BusFault, ...]:
        """What goes wrong."""
        return self._faults

    @faults.setter
    def faults(self, faults: tuple[BusFault, ...]) -> None:
        self._faults = faults
        self._start_s = self._clock()
        self._held: tuple[list[_Held], list[_Held]] = ([], [])  # of frames received, of frames to send
        self._overtaken: list[can.Message | None] = [None, None]
        self._stuck: dict[tuple[int, bool, str], int] = {}
        self._slowed: dict[tuple[int, bool, str], tuple[float, int]] = {}
        self._babbled: dict[tuple[int, bool], float] = {}

    def clock_offset_s(self) -> float:
        """By how much the node's clock is off now."""
        now_s = self._now_s()
        return sum(
            fault.jump_s
            for fault in self._faults
            if fault.kind is BusFaultKind.CLOCK_JUMP and fault.strikes(now_s, True, None)
        )

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """As the bus does, but for the faults."""
        now_s = self._now_s()
        self._refuse_when_off(now_s, sending=True)
        self._pass_on(now_s)
        for frame in self._through(msg, now_s, sending=True):
            self._bus.send(frame, timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        deadline_s = None if timeout is None else self._clock() + timeout
        while True:
            now_s = self._now_s()
            self._refuse_when_off(now_s, sending=False)
            self._pass_on(now_s)
            self._babble(now_s, sending=False)
            if (held := self._due(now_s, sending=False)) is not None:
                return held, False
            left_s = 0.01 if deadline_s is None else max(0.0, deadline_s - self._clock())
            message = self._bus.recv(min(left_s, 0.01))
            if message is not None:
                for frame in self._through(message, now_s, sending=False):
                    self._hold(frame, now_s, sending=False)
            elif deadline_s is not None and left_s <= 0.0:
                return None, False

    def shutdown(self) -> None:
        """Shuts the bus itself down, too."""
        if not self._is_shutdown:
            super().shutdown()
            self._bus.shutdown()

    # ------------------------------------------------------------------ what the faults do

    def _now_s(self) -> float:
        return self._clock() - self._start_s

    def _on(self, now_s: float, sending: bool, kind: BusFaultKind) -> list[tuple[int, BusFault]]:
        return [
            (number, fault)
            for number, fault in enumerate(self._faults)
            if fault.kind is kind and fault.strikes(now_s, sending, fault.message)
        ]

    def _refuse_when_off(self, now_s: float, sending: bool) -> None:
        if self._on(now_s, sending, BusFaultKind.BUS_OFF):
            raise can.CanOperationError(f"{self.channel_info}: bus-off")

    def _pass_on(self, now_s: float) -> None:
        """What was held back and is due goes onto the bus, and what a babbling node adds."""
        self._babble(now_s, sending=True)
        while (held := self._due(now_s, sending=True)) is not None:
            self._bus.send(held)

    def _hold(self, message: can.Message, until_s: float, sending: bool) -> None:
        heapq.heappush(self._held[sending], _Held(until_s, next(self._order), message))

    def _due(self, now_s: float, sending: bool) -> can.Message | None:
        held = self._held[sending]
        return heapq.heappop(held).message if held and held[0].until_s <= now_s else None

    def _babble(self, now_s: float, sending: bool) -> None:
        for number, fault in self._on(now_s, sending, BusFaultKind.BABBLE):
            next_s = self._babbled.get((number, sending), max(fault.start_s, now_s))
            while next_s <= now_s:
                data = self._random.randbytes(8)
                self._hold(
                    can.Message(timestamp=time.time(), arbitration_id=fault.frame_id, data=data, is_extended_id=False),
                    now_s,
                    sending,
                )
                next_s += fault.period_s
            self._babbled[number, sending] = next_s

    def _through(self, message: can.Message, now_s: float, sending: bool) -> list[can.Message]:
        """What becomes of a frame: none, itself changed, or two."""
        known = spec().by_id.get(message.arbitration_id)
        name = None if known is None or message.is_extended_id or message.is_remote_frame else known.name
        out = [message]
        for number, fault in enumerate(self._faults):
            if not out or not fault.strikes(now_s, sending, name) or self._random.random() >= fault.probability:
                continue
            key = number, sending, name or ""
            match fault.kind:
                case BusFaultKind.DROP | BusFaultKind.SILENCE:
                    out = []
                case BusFaultKind.DELAY:
                    for each in out:
                        self._hold(each, now_s + fault.delay_s, sending)
                    out = []
                case BusFaultKind.DUPLICATE:
                    out = [*out, *out]
                case BusFaultKind.CORRUPT:
                    out = [self._corrupted(each, fault.bits) for each in out]
                case BusFaultKind.WRONG_VERSION:
                    out = [_of_another_version(each) for each in out]
                case BusFaultKind.COUNTER_STUCK if name is not None:
                    first = self._stuck.setdefault(key, out[0].data[1] & 0x0F if len(out[0].data) > 1 else 0)
                    out = [_counted(name, each, first) for each in out]
                case BusFaultKind.SLOW if name is not None:
                    next_s, counter = self._slowed.get(key, (now_s, 0))
                    if now_s < next_s:
                        out = []
                    else:
                        self._slowed[key] = now_s + fault.period_s, (counter + 1) % COUNTER_VALUES
                        out = [_counted(name, each, counter) for each in out]
                case BusFaultKind.REORDER:
                    if self._overtaken[sending] is None:
                        self._overtaken[sending] = out.pop(0)
        waiting = self._overtaken[sending]
        if out and waiting is not None:
            self._overtaken[sending] = None
            out.append(waiting)
        return out

    def _corrupted(self, message: can.Message, bits: int) -> can.Message:
        size = 8 * len(message.data)
        word = int.from_bytes(message.data, "little")
        for bit in self._random.sample(range(size), min(bits, size)):
            word ^= 1 << bit
        return _with_data(message, word.to_bytes(len(message.data), "little"))


@dataclass(frozen=True, order=True)
class _Held:
    """A message that is held back, first the one that is due first."""

    until_s: float
    order: int
    message: can.Message


def _with_data(message: can.Message, data: bytes) -> can.Message:
    return can.Message(
        timestamp=message.timestamp,
        arbitration_id=message.arbitration_id,
        is_extended_id=message.is_extended_id,
        is_remote_frame=message.is_remote_frame,
        dlc=message.dlc,
        data=data if not message.is_remote_frame else None,
        channel=message.channel,
        is_rx=message.is_rx,
    )


def _counted(name: str, message: can.Message, counter: int) -> can.Message:
    """The frame with another counter and the CRC that belongs to it."""
    try:
        return _with_data(message, protect(name, bytes(message.data), counter))
    except ProtocolError:
        return message  # not one of the protocol's own, whatever its identifier


def _of_another_version(message: can.Message) -> can.Message:
    frame = Frame(message.arbitration_id, bytes(message.data))
    try:
        name, signals = decode(*frame)
        if "DbcHash" not in signals:
            return message
        _, data = encode(name, signals | {"DbcHash": int(signals["DbcHash"]) ^ 1})
        return _with_data(message, protect(name, data, int(signals["Counter"])))
    except ProtocolError:
        return message


class FaultFile:
    """A file of faults that may be edited while a node runs: `poll` puts what it says now onto the bus.

    Raises BusFaultError for a file that is wrong at the start; later, `tell` is told and the faults stay as they were.
    """

    def __init__(self, path: str | Path, bus: FaultyBus, tell: Callable[[str], None]) -> None:
        self._path, self._bus, self._tell = Path(path), bus, tell
        self._stamp = self._stamp_now()
        bus.faults = read_bus_faults(path)

    def poll(self) -> None:
        """Look whether the file has changed."""
        stamp = self._stamp_now()
        if stamp == self._stamp:
            return
        self._stamp = stamp
        try:
            self._bus.faults = read_bus_faults(self._path)
        except BusFaultError as error:
            self._tell(f"{error}; the faults stay as they were")
        else:
            kinds = ", ".join(str(fault.kind) for fault in self._bus.faults) or "none"
            self._tell(f"faults of the bus from now on: {kinds}")

    def _stamp_now(self) -> tuple[int, int] | None:
        try:
            found = self._path.stat()
        except OSError:
            return None
        return found.st_mtime_ns, found.st_size
