"""Board and link as a lock-step run without frames needs them: arming, limits and rounding of the bus, compiled.

On a bus that loses nothing, of all the protocol these are left: which cycle the handshake gets to `armed` in, when
setpoints act, what latches the board, and to how many digits a signal is told. The numbers are read from the DBC;
`tests/nodes/test_direct.py` holds a run through this to the same run through frames. Left out: everything that a
sound bus never does (timeouts, wrong checksums, lost frames, another DBC).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.board import BoardLimits
from firmware_protocol.enumerations import BoardMode, ControlMode
from firmware_protocol.messages import PASCAL_PER_KILOPASCAL
from firmware_protocol.spec import message_spec
from sim.scene import CONTROL_PERIOD_S
from softbot.faults import CHAMBER_COUNT
from softbot.kernel_compiler import kernel, part

FloatArray = NDArray[np.float64]

_SAFE_LATCHED, _DISARMED_MODE, _ARMING, _ARMED_MODE = (int(mode) for mode in BoardMode)
_DISARM, _ARM_REQUEST, _ARM_CONFIRM, _RUN = (int(mode) for mode in ControlMode)
_NOTHING = -1
DISARMED, CLEARING, REQUESTING, CONFIRMING, ARMED, FAILED = range(6)
"""States of the link."""

RETRY_S = 1.0
"""Between two tries of the sequencer to arm the board."""

IDEAL_BUS = np.dtype(
    [
        ("link", np.int64),
        ("was_armed", np.bool_),
        ("heard_mode", np.int64),
        ("next_try_s", np.float64),
        ("since_s", np.float64),
        ("mode", np.int64),
        ("control", np.int64),
        ("pressures_valid", np.bool_),
        ("latched", np.bool_),
        ("setpoint_Pa", np.float64, CHAMBER_COUNT),
        ("sent_control", np.int64),
        ("said_control", np.int64),
        ("sent_setpoint_Pa", np.float64, CHAMBER_COUNT),
        ("sent_state", np.int64),
        ("heard_state", np.int64),
    ],
    align=True,
)
"""Both ends, as a record: link and what it heard of the board, the board and what it was last told; `sent_*` is under
way from the sequencer to the board's next cycle; `said_control` was sent last. `latched`: the board has latched a
failure in this cycle."""


class BusRules(NamedTuple):
    """Rounding, limits and periods, as compiled code takes them."""

    pressure: tuple[float, float, float, float]
    opening: tuple[float, float, float, float]
    supply: tuple[float, float, float, float]
    gyro: tuple[float, float, float, float]
    accelerometer: tuple[float, float, float, float]
    setpoint: tuple[float, float, float, float]
    """Scale, offset, lowest and highest raw number of a signal."""
    max_setpoint_Pa: float
    over_pressure_Pa: float
    board_heartbeat: int
    sequencer_heartbeat: int
    sequencer_control: int
    """Cycles from one of these messages to the next."""
    arming_timeout_s: float


def bus_rules(limits: BoardLimits, arming_timeout_s: float = 2.0) -> BusRules:
    """The rules of a board with these limits."""
    return BusRules(
        _rounding("BoardPressures", "Pressure0"),
        _rounding("BoardValves", "Opening0"),
        _rounding("BoardSupply", "SupplyPressure"),
        _rounding("ImuGyro", "X"),
        _rounding("ImuAccelerometer", "X"),
        _rounding("SequencerSetpoints", "Setpoint0"),
        float(limits.max_setpoint_Pa),
        float(limits.over_pressure_Pa),
        _cycles("BoardHeartbeat"),
        _cycles("SequencerHeartbeat"),
        _cycles("SequencerControl"),
        float(arming_timeout_s),
    )


def _rounding(message: str, signal: str) -> tuple[float, float, float, float]:
    own = next(each for each in message_spec(message).signals if each.name == signal)
    return float(own.scale), float(own.offset), float(own.raw_minimum), float(own.raw_maximum)


def _cycles(message: str) -> int:
    period_s = message_spec(message).cycle_s
    assert period_s is not None
    return round(period_s / CONTROL_PERIOD_S)


def bus_memory() -> Any:
    """Memory of a bus on which nobody has spoken yet, shape (1,) of IDEAL_BUS."""
    memory = np.zeros(1, IDEAL_BUS).view(np.recarray)
    own = memory[0]
    own["heard_mode"] = own["sent_control"] = _NOTHING
    own["next_try_s"] = -math.inf
    own["mode"] = _SAFE_LATCHED
    return memory


@kernel()
def told(value: float, rounding: tuple[float, float, float, float]) -> float:
    """A number as it arrives over the bus [the signal's unit]."""
    scale, offset, lowest, highest = rounding
    raw = np.round((value - offset) / scale)
    return min(max(raw, lowest), highest) * scale + offset


@kernel()
def told_Pa(pressure_Pa: float, rounding: tuple[float, float, float, float]) -> float:
    """A pressure as it arrives over the bus [Pa]."""
    return told(pressure_Pa / PASCAL_PER_KILOPASCAL, rounding) * PASCAL_PER_KILOPASCAL


@part()
def tell_readings(rules: BusRules, reading: Any, acted_opening: FloatArray, main_supply_shut: bool, out: Any) -> None:
    """What the sequencer hears of a reading. The valves: as told one cycle ago, so that they acted until now."""
    out.main_supply_shut = main_supply_shut
    out.t_s = reading.t_s
    out.supply_Pa = told_Pa(reading.supply_Pa, rules.supply)
    for i in range(CHAMBER_COUNT):
        out.pressure_Pa[i] = told_Pa(reading.pressure_Pa[i], rules.pressure)
        out.opening[i] = told(acted_opening[i], rules.opening)
    for k in range(3):
        out.gyro_rad_s[k] = told(reading.gyro_rad_s[k], rules.gyro)
        out.accelerometer_m_s2[k] = told(reading.accelerometer_m_s2[k], rules.accelerometer)


@part()
def _enter(own: Any, mode: int) -> None:
    if own.mode != mode:
        own.mode, own.control = mode, _DISARM
        for i in range(CHAMBER_COUNT):
            own.setpoint_Pa[i] = 0.0


@part()
def board_cycle(rules: BusRules, memory: Any, measured_Pa: FloatArray) -> bool:
    """The board's part of a cycle, after what was sent to it; whether its valves obey the setpoints (and not vent)."""
    own = memory[0]
    wanted, mode = own.sent_control, own.mode
    own.sent_control = _NOTHING
    if wanted == _DISARM:
        if mode != _SAFE_LATCHED or own.pressures_valid:
            _enter(own, _DISARMED_MODE)
    elif wanted != _NOTHING and mode != _SAFE_LATCHED:
        if mode == _DISARMED_MODE and wanted == _ARM_REQUEST:
            _enter(own, _ARMING)
        elif mode == _ARMING and wanted == _ARM_CONFIRM:
            _enter(own, _ARMED_MODE)
            own.control = _ARM_CONFIRM
        elif mode == _ARMED_MODE:
            own.control = wanted
    if own.mode == _ARMED_MODE:
        for i in range(CHAMBER_COUNT):
            own.setpoint_Pa[i] = min(own.sent_setpoint_Pa[i], rules.max_setpoint_Pa)
    own.heard_state = own.sent_state
    own.pressures_valid = True
    for i in range(CHAMBER_COUNT):
        if not measured_Pa[i] <= rules.over_pressure_Pa:
            own.pressures_valid = False
    own.latched = not own.pressures_valid and own.mode != _SAFE_LATCHED
    if own.latched:
        _enter(own, _SAFE_LATCHED)
    return own.mode == _ARMED_MODE and own.control == _RUN


@part()
def _follow(own: Any) -> None:
    mode, link = own.mode, own.link
    own.heard_mode = mode
    handshake = link in (REQUESTING, CONFIRMING, ARMED)
    if handshake and mode == _SAFE_LATCHED:
        own.link = FAILED
    elif link == REQUESTING and mode == _ARMING:
        own.link = CONFIRMING
    elif link == CONFIRMING and mode == _ARMED_MODE:
        own.link = ARMED
    elif (link == CONFIRMING and mode == _DISARMED_MODE) or (link == ARMED and mode != _ARMED_MODE):
        own.link = FAILED


@part()
def hear_board(rules: BusRules, memory: Any, cycle: int) -> bool:
    """The sequencer's end hears what the board says in this cycle; whether the link is armed."""
    own = memory[0]
    if own.latched or cycle % rules.board_heartbeat == 0:
        _follow(own)
    return own.link == ARMED


@part()
def answer_board(
    rules: BusRules, memory: Any, cycle: int, t_s: float, wants_armed: bool, setpoint_Pa: FloatArray, state: int
) -> None:
    """Arm or disarm, and send what is due: the sequencer's end of a cycle."""
    own = memory[0]
    own.was_armed = own.was_armed or own.link == ARMED
    if not wants_armed:
        if own.link != FAILED or not own.was_armed:
            own.link = DISARMED
    elif (own.link == DISARMED or (own.link == FAILED and not own.was_armed)) and t_s >= own.next_try_s:
        own.next_try_s = t_s + RETRY_S
        own.link, own.since_s = CLEARING, t_s
    if own.link in (CLEARING, REQUESTING, CONFIRMING) and t_s - own.since_s >= rules.arming_timeout_s:
        own.link = FAILED
    if own.link == CLEARING and own.heard_mode == _DISARMED_MODE:
        own.link = REQUESTING
    if cycle % rules.sequencer_control == 0 or (own.said_control == _RUN and own.link != ARMED):
        if own.link == REQUESTING:
            own.sent_control = _ARM_REQUEST
        elif own.link == CONFIRMING:
            own.sent_control = _ARM_CONFIRM
        elif own.link == ARMED:
            own.sent_control = _RUN
        else:
            own.sent_control = _DISARM
        own.said_control = own.sent_control
    for i in range(CHAMBER_COUNT):
        own.sent_setpoint_Pa[i] = told_Pa(setpoint_Pa[i], rules.setpoint) if own.link == ARMED else 0.0
    if cycle % rules.sequencer_heartbeat == 0:
        own.sent_state = state
