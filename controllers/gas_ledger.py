"""The gas that went into each chamber, and the pressure that it makes: what bounds a chamber whose sensor lies.

A sensor that shows too little lets the pressure loop fill a chamber beyond its limit in a quarter of a second, sooner
than the fault is named. What flowed in is known all the same, from supply pressure, valve opening and the conductances
that `controllers.chamber_observer` had learnt before anything was suspected. So each chamber has an account
(`controllers.chamber_gas` over every period). A reading above it is believed soon. One below it is believed slowly, for
the account's own errors are a few per cent of a filling, and not at all while the chamber is suspected or said to
balloon, which looks like a wrong scale: so a chamber that balloons gets no more gas than a sound one at its limit.
Venting settles every account: an open chamber comes to the pressure of the air.

A chamber that by its account holds more than `FULL` of the robot's pressure limit is vented, whatever it was to have.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.chamber_gas import next_pressure
from controllers.chamber_observer import HOLE, INLET, OUTLET
from controllers.detector_parts import DetectorMemory, DetectorParts
from controllers.fault_window import KEPT
from softbot.faults import CHAMBER_COUNT, KIND_CODES, FaultKind
from softbot.kernel_compiler import kernel

FloatArray = NDArray[np.float64]

FULL = 1.05
"""Over the robot's pressure limit; no sound chamber comes there, but for the loop's overshoot."""
BELIEVES_MORE, BELIEVES_LESS = 0.3, 0.01
"""Share of what a reading is above the account, or below it, that is taken over in a cycle."""
_SUSPECTED = 6.0  # of the CUSUM: the filter does not learn from there on either
_BALLOONING = KIND_CODES[FaultKind.BALLOONING]

LEDGER = np.dtype([("pressure_Pa", np.float64, CHAMBER_COUNT)], align=True)
"""Absolute pressure of each chamber by its account, as a record; NaN before the first reading."""


def ledger_memory() -> Any:
    """Accounts that are not opened yet, shape (1,) of LEDGER."""
    memory = np.zeros(1, LEDGER).view(np.recarray)
    memory[0]["pressure_Pa"] = math.nan
    return memory


@kernel(cache=False)
def keep_ledger(parts: DetectorParts, memory: DetectorMemory, ledger: Any, reading: Any) -> None:
    """Move the accounts (LEDGER) on by the period that the detector has just followed."""
    own, window = memory.own[0], memory.window[0]
    if own.last_t_s != reading.t_s:
        return  # readings that were no numbers: nothing was followed
    at, gas = own.cycle % KEPT, parts.gas
    step_s = window.step_s[at]
    for c in range(CHAMBER_COUNT):
        shown = reading.pressure_Pa[c] + gas.atmosphere_Pa
        account = ledger.pressure_Pa[c]
        if math.isnan(account):
            account = shown
        elif step_s > 0.0:
            x = window.x[at, c]
            account = next_pressure(
                gas,
                c,
                account,
                window.supply[at],
                window.opening[at, c],
                window.volume_m3[at, c],
                window.swelling[at, c],
                x[INLET],
                x[OUTLET],
                x[HOLE],
                step_s,
            )[0]
        doubted = own.alarm[c] >= 0 or max(own.rising[c], own.falling[c]) >= _SUSPECTED or own.named[c] == _BALLOONING
        less = 0.0 if doubted else BELIEVES_LESS
        account += (BELIEVES_MORE if shown > account else less) * (shown - account)
        ledger.pressure_Pa[c] = max(account, gas.atmosphere_Pa)


@kernel(cache=False)
def vent_full(parts: DetectorParts, ledger: Any, limit_Pa: float, setpoint_Pa: FloatArray) -> None:
    """setpoint_Pa (4,) ← 0 for chambers that by their account hold too much. limit_Pa: of the robot, gauge."""
    for c in range(CHAMBER_COUNT):
        if ledger.pressure_Pa[c] - parts.gas.atmosphere_Pa > FULL * limit_Pa:
            setpoint_Pa[c] = 0.0
