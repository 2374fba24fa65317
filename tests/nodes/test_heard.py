"""What a listener makes of the sequencer's frames."""

from __future__ import annotations

from controllers.interface import SequencerState
from firmware_protocol import enumerations
from firmware_protocol.enumerations import NO_CHAMBER, FaultKind
from softbot.nodes.heard import Heard


def _say(heard: Heard, state: SequencerState, t_s: float) -> None:
    code = enumerations.SequencerState[state.name]
    heard.listen("SequencerHeartbeat", {"State": code, "Health": 0, "UptimeS": 0}, t_s)


def test_every_state_of_the_sequencer_has_its_name_on_the_bus() -> None:
    heard = Heard()
    for state in SequencerState:
        _say(heard, state, 0.0)
        assert heard.state is state


def test_a_change_of_strategy_is_noted_once() -> None:
    heard = Heard()
    for t_s, state in enumerate(
        (SequencerState.ROLLING, SequencerState.DEGRADED, SequencerState.REVERSING, SequencerState.DEGRADED)
    ):
        _say(heard, state, float(t_s))
    assert heard.recoveries == [{"t_s": 1.0, "strategy": "curvature_reversal"}]
    _say(heard, SequencerState.SAFE, 4.0)
    assert heard.recoveries[1:] == [{"t_s": 4.0, "strategy": "safe_stop"}]


def test_named_faults_are_entries_of_the_summary() -> None:
    heard = Heard()
    heard.listen("SequencerFault", {"Chamber": 3, "Kind": FaultKind.BLOCKED_INLET, "Confidence": 0.9}, 1.5)
    heard.listen("SequencerFault", {"Chamber": NO_CHAMBER, "Kind": FaultKind.SUPPLY_LOSS, "Confidence": 1.0}, 2.0)
    assert heard.detections == [
        {"t_s": 1.5, "chamber": 3, "kind": "blocked_inlet", "confidence": 0.9},
        {"t_s": 2.0, "chamber": -1, "kind": "supply_loss", "confidence": 1.0},
    ]


def test_other_messages_are_let_pass() -> None:
    heard = Heard()
    heard.listen("SequencerSetpoints", {"Setpoint0": 1.0}, 0.0)
    assert heard == Heard()
