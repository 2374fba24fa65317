"""A board on a bench, with a peer whose every frame the test decides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import pytest

from firmware_protocol.arming import arm_token
from firmware_protocol.board import VENTED, BoardDecision, BoardLimits, BoardRules
from firmware_protocol.c_board import CBoardRules
from firmware_protocol.codec import dbc_hash, decode
from firmware_protocol.e2e import FrameStatus, Sender
from firmware_protocol.enumerations import BoardMode, ControlMode, Health, SafeReason
from firmware_protocol.frame import Frame

LIMITS = BoardLimits(max_setpoint_Pa=200e3, over_pressure_Pa=250e3)
REST = (0.0, 0.0, 0.0, 0.0)
CYCLE_S = 0.01


class Bench:
    """A board with a peer whose every frame the test decides."""

    def __init__(
        self,
        limits: BoardLimits = LIMITS,
        version: tuple[int, int, int] = (0, 1, 0),
        make_rules: type[BoardRules] | type[CBoardRules] = BoardRules,
    ) -> None:
        self.rules = make_rules(limits, version=version)
        self.peer = Sender()
        self.t_s = 0.0
        self.measured_Pa: Sequence[float] = REST

    def put(self, frame: Frame) -> FrameStatus:
        return self.rules.receive(frame.frame_id, frame.data, self.t_s).status

    def control(self, mode: int, token: int = 0, peer_hash: int | None = None) -> FrameStatus:
        signals = {"Mode": mode, "ArmToken": token, "DbcHash": dbc_hash() if peer_hash is None else peer_hash}
        return self.put(self.peer.send("SequencerControl", signals))

    def setpoints(self, pressure_kPa: float = 100.0) -> FrameStatus:
        signals = {f"Setpoint{chamber}": pressure_kPa + chamber for chamber in range(4)}
        return self.put(self.peer.send("SequencerSetpoints", signals))

    def heartbeat(self, health: Health = Health.OK) -> FrameStatus:
        return self.put(self.peer.send("SequencerHeartbeat", {"State": 2, "Health": health, "UptimeS": 1}))

    def stop(self) -> FrameStatus:
        return self.put(self.peer.send("EmergencyStop", {"Reason": 3}))

    def tick(self) -> BoardDecision:
        return self.rules.tick(self.t_s, self.measured_Pa)

    def token(self) -> int:
        return arm_token(self.rules.state.challenge, dbc_hash())

    def disarmed(self) -> Bench:
        self.tick()
        self.control(ControlMode.DISARM)
        assert self.mode is BoardMode.DISARMED
        return self

    def arming(self) -> Bench:
        self.disarmed().heartbeat()
        self.control(ControlMode.ARM_REQUEST)
        assert self.mode is BoardMode.ARMING
        return self

    def armed(self) -> Bench:
        self.arming().control(ControlMode.ARM_CONFIRM, self.token())
        assert self.mode is BoardMode.ARMED
        return self

    def running(self) -> Bench:
        self.armed().control(ControlMode.RUN)
        self.setpoints()
        assert not self.tick().safe
        return self

    def wait(self, duration_s: float, *, without: str = "") -> BoardDecision:
        """Runs on with all commands but one for `duration_s` in cycles of 10 ms."""
        for _ in range(round(duration_s / CYCLE_S)):
            self.t_s = round(self.t_s + CYCLE_S, 6)
            if without != "SequencerControl":
                self.control(ControlMode.RUN)
            if without != "SequencerSetpoints":
                self.setpoints()
            if without != "SequencerHeartbeat":
                self.heartbeat()
            self.tick()
        return self.tick()

    @property
    def mode(self) -> BoardMode:
        return self.rules.state.mode

    @property
    def reason(self) -> SafeReason:
        return self.rules.state.reason

    def faults(self) -> list[dict[str, float]]:
        decoded = [decode(*frame) for frame in self.rules.outgoing(self.t_s)]
        return [signals for name, signals in decoded if name == "BoardFault"]

    def assert_latched(self, reason: SafeReason) -> None:
        decision = self.tick()
        assert decision == BoardDecision(BoardMode.SAFE_LATCHED, True, reason, VENTED, False)
        # Nothing but disarm leads out.
        for mode in (ControlMode.ARM_REQUEST, ControlMode.ARM_CONFIRM, ControlMode.RUN):
            self.control(mode, self.token())
            self.setpoints()
            self.heartbeat()
            assert self.tick() == decision


@pytest.fixture(scope="session", params=[BoardRules, CBoardRules], ids=["python", "compiled"])
def new_bench(request: pytest.FixtureRequest) -> Callable[..., Bench]:
    """Makes a bench; `Bench(limits, version)`. Once with the board in Python and once with the board in C."""
    return partial(Bench, make_rules=request.param)


@pytest.fixture
def python_bench() -> Bench:
    """A bench for what only the board in Python does."""
    return Bench()
