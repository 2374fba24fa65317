"""The board's parameters over the bus, read and lowered by the sequencer's end of the link while no sequencer runs."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from firmware_protocol.bus import drain, send
from firmware_protocol.enumerations import AbortCode, BoardMode, Parameter
from firmware_protocol.parameter_client import ParameterOutcome
from firmware_protocol.parameters import PARAMETERS
from firmware_protocol.sequencer_link import SequencerLink
from firmware_protocol.spec import SEQUENCER, spec
from sim.scene import CONTROL_PERIOD_S
from softbot.errors import InputError, SimulationError
from softbot.nodes.fixed_rate import FixedRate
from softbot.nodes.wall_clock import DISARMING_S, open_live

if TYPE_CHECKING:
    import can

LISTENED_S = 0.5
"""How long nobody else may speak as the sequencer before this end does: five cycles of its slowest heartbeat."""
BOARD_WAIT_S = 2.0

_WHY = {
    AbortCode.UNKNOWN_PARAMETER: "this board has no such parameter",
    AbortCode.READ_ONLY: "it can only be read",
    AbortCode.WOULD_RAISE: "limits are lowered over the bus and never raised; power the board up again for its own",
    AbortCode.TOO_LOW: "that is below the least value that can be written",
    AbortCode.CONTRADICTS: "the over-pressure limit must stay above the highest setpoint; lower MAX_SETPOINT first",
    AbortCode.WRONG_MODE: "the board is armed; disarm it first",
}


@dataclass(frozen=True)
class BoardParameters:
    """`values` by parameter, in the units of `firmware_protocol.parameters`; `refused`: writes, and why."""

    mode: BoardMode
    values: dict[Parameter, int]
    refused: dict[Parameter, str]


def board_parameters(interface: str, channel: str, wanted: Mapping[Parameter, int] | None = None) -> BoardParameters:
    """Write the `wanted` values to the board, then read all.

    Raises InputError where a sequencer is on the bus already (two of them would break each other's counters) and for a
    value that no frame carries, SimulationError when no board answers, BusError when the bus cannot be used.
    """
    with open_live(interface, channel) as bus:
        _refuse_a_second_sequencer(bus, f"{interface} {channel}")
        link = SequencerLink()
        for parameter, value in (wanted or {}).items():
            link.parameters.write(parameter, value)
        for each in PARAMETERS:
            link.parameters.read(each.parameter)
        asked = len(wanted or {}) + len(PARAMETERS)
        loop, ends_s, heard_s = FixedRate(CONTROL_PERIOD_S), None, 0.0
        while ends_s is None or heard_s < ends_s:
            heard_s = loop.wait()
            for frame, _ in drain(bus):
                link.receive(frame.frame_id, frame.data, heard_s)
            if link.readings.board_mode is None and heard_s > BOARD_WAIT_S:
                raise SimulationError(f"no board is heard on {interface} {channel}; check its supply and the bus")
            send(bus, link.outgoing(heard_s, [0.0] * 4), heard_s)
            if ends_s is None and len(link.parameters.outcomes) == asked:
                ends_s = heard_s + DISARMING_S
        return _told(link, list(wanted or {}))


def _refuse_a_second_sequencer(bus: can.BusABC, where: str) -> None:
    theirs = {message.frame_id for message in spec().messages if message.sender == SEQUENCER}
    until_s = time.monotonic() + LISTENED_S
    while time.monotonic() < until_s:
        if any(frame.frame_id in theirs for frame, _ in drain(bus)):
            raise InputError(f"a sequencer is on {where} already; stop it first, a board follows one sequencer only")
        time.sleep(CONTROL_PERIOD_S)


def _told(link: SequencerLink, written: list[Parameter]) -> BoardParameters:
    outcomes = list(link.parameters.outcomes)
    unanswered = [each for each in outcomes if each.abort_code is None]
    if unanswered or link.readings.board_mode is None:
        names = ", ".join(_name(each) for each in unanswered)
        raise SimulationError(f"the board did not answer ({names}); is its firmware of this version?")
    refused = {
        parameter: _WHY[outcome.abort_code]
        for parameter, outcome in zip(written, outcomes, strict=False)
        if outcome.abort_code is not None and outcome.abort_code is not AbortCode.DONE
    }
    values = {Parameter(number): value for number, value in link.parameters.values.items()}
    return BoardParameters(link.readings.board_mode, values, refused)


def _name(outcome: ParameterOutcome) -> str:
    return Parameter(outcome.parameter).name
