"""What the sequencer said on the bus: its state, the faults it named, the change of strategy that answers them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from controllers.interface import SequencerState
from firmware_protocol import enumerations
from firmware_protocol.enumerations import NO_CHAMBER

STRATEGIES = {
    SequencerState.DEGRADED: "curvature_reversal",
    SequencerState.REVERSING: "curvature_reversal",
    SequencerState.SAFE: "safe_stop",
}
"""The strategy that a state shows; the bus has no message for it."""


@dataclass
class Heard:
    """A listener to the sequencer's frames. `detections` and `recoveries` are entries of the summary's lists."""

    state: SequencerState = SequencerState.DISARMED
    detections: list[dict[str, Any]] = field(default_factory=list)
    recoveries: list[dict[str, Any]] = field(default_factory=list)

    def listen(self, name: str, signals: Mapping[str, float], t_s: float) -> None:
        """Take over the signals of the message `name` that came at `t_s`; other messages are let pass."""
        if name == "SequencerHeartbeat":
            self.state = SequencerState(enumerations.SequencerState(int(signals["State"])).name.lower())
            strategy = STRATEGIES.get(self.state)
            if strategy is not None and strategy not in [known["strategy"] for known in self.recoveries]:
                self.recoveries.append({"t_s": t_s, "strategy": strategy})
        elif name == "SequencerFault":
            chamber = int(signals["Chamber"])
            self.detections.append(
                {
                    "t_s": t_s,
                    "chamber": -1 if chamber == NO_CHAMBER else chamber,
                    "kind": enumerations.FaultKind(int(signals["Kind"])).name.lower(),
                    "confidence": signals["Confidence"],
                }
            )
