"""A chamber that was given up proves itself: at rest, before the robot rolls again, it is filled and vented twice.

Only what its pressure can prove is proved: a chamber that could not be filled or emptied. One whose sensor lied stays
out of use, because the proof would rest on that sensor. While a chamber is tried the others are vented, it is asked for
less than half of its limit, and it has to follow as the model's time constant says: there within a few lags, held for
two, empty again within a few. The first step that it does not follow ends the proof, until the next order to roll.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from softbot.cross_section import CHAMBERS
from softbot.kernel_compiler import kernel

FILLS = 2
"""Times that a chamber is filled and vented."""
TEST_SHARE = 0.4
"""Of the pressure limit that it is asked for."""
NEAR = 0.12
"""Of what it is asked for: so near it has to come, held or vented."""
FILLED_WITHIN, HELD_FOR, VENTED_WITHIN = 5.0, 2.0, 8.0
"""Lags of the pressures."""
NOT_ANY = -1
UNDER_WAY, PROVED, FAILED = range(3)

PROOF = np.dtype(
    [
        ("owed", np.int64, CHAMBERS),
        ("chamber", np.int64),
        ("filling", np.bool_),
        ("fills", np.int64),
        ("since_s", np.float64),
        ("there_since_s", np.float64),
    ],
    align=True,
)
"""Which chambers are still to be tried (1), and the one that is, as a record: whether it is being filled, how often it
has been, since when, and since when it has been where it should be (NaN: it is not)."""


@kernel(cache=False)
def begin_proof(proof: Any, chamber: int, t_s: float) -> None:
    """Try a chamber from now on. It is vented first: a chamber that holds its pressure is no sound one."""
    proof.chamber, proof.owed[chamber] = chamber, 0
    proof.fills, proof.filling = 0, False
    proof.since_s, proof.there_since_s = t_s, math.nan


@kernel(cache=False)
def follow_proof(proof: Any, pressure_Pa: float, test_Pa: float, t_s: float, lag_s: float) -> int:
    """One cycle of the proof: UNDER_WAY, PROVED or FAILED. While `filling` the chamber is to be asked for test_Pa."""
    wanted_Pa = test_Pa if proof.filling else 0.0
    within_s = lag_s * (FILLED_WITHIN if proof.filling else VENTED_WITHIN)
    if abs(pressure_Pa - wanted_Pa) <= NEAR * test_Pa:
        if math.isnan(proof.there_since_s):
            proof.there_since_s = t_s
        if t_s - proof.there_since_s >= HELD_FOR * lag_s:
            if not proof.filling and proof.fills == FILLS:
                proof.chamber = NOT_ANY
                return PROVED
            proof.fills += 0 if proof.filling else 1
            proof.filling = not proof.filling
            proof.since_s, proof.there_since_s = t_s, math.nan
        return UNDER_WAY
    late = t_s - proof.since_s > within_s
    if late or not math.isnan(proof.there_since_s) or not math.isfinite(pressure_Pa):
        proof.chamber = NOT_ANY
        return FAILED
    return UNDER_WAY


def proof_memory() -> Any:
    """No chamber is tried, and none owes a proof: shape (1,) of PROOF."""
    memory = np.zeros(1, PROOF).view(np.recarray)
    memory[0]["chamber"] = NOT_ANY
    memory[0]["there_since_s"] = math.nan
    return memory
