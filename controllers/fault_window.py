"""What naming a fault looks at and what it says: the last cycles of all chambers, a verdict, scratch; as records."""

from __future__ import annotations

import numpy as np

from controllers.chamber_observer import STATES
from controllers.fault_candidates import COUNT
from softbot.faults import CHAMBER_COUNT, KINDS

KEPT = 128
"""Cycles that are kept."""
KIND_COUNT = len(KINDS) + 1

WINDOW = np.dtype(
    [
        ("step_s", np.float64, KEPT),
        ("reading_Pa", np.float64, (KEPT, CHAMBER_COUNT)),
        ("supply", np.float64, KEPT),
        ("commanded", np.float64, (KEPT, CHAMBER_COUNT)),
        ("opening", np.float64, (KEPT, CHAMBER_COUNT)),
        ("lagged", np.float64, (KEPT, CHAMBER_COUNT)),
        ("volume_m3", np.float64, (KEPT, CHAMBER_COUNT)),
        ("swelling", np.float64, (KEPT, CHAMBER_COUNT)),
        ("felt", np.float64, (KEPT, CHAMBER_COUNT)),
        ("x", np.float64, (KEPT, CHAMBER_COUNT, STATES)),
        ("timing_Pa", np.float64, (KEPT, CHAMBER_COUNT)),
        ("doubt", np.float64, (KEPT, CHAMBER_COUNT)),
        ("innovation_Pa", np.float64, (KEPT, CHAMBER_COUNT)),
        ("deviation_Pa", np.float64, (KEPT, CHAMBER_COUNT)),
    ],
    align=True,
)
"""What is kept of the last cycles, a place each in turn: readings, absolute supply that acted until then, openings
(commanded, mean and lagged), volumes, and what the filters believed after each; `felt`: share of a reading that the
shape was reckoned with; `doubt`: deviation of the conductances that they had learnt."""

VERDICT = np.dtype(
    [
        ("kind", np.int64),
        ("candidate", np.int64),
        ("chamber", np.int64),
        ("severity", np.float64),
        ("evidence", np.float64),
        ("lead", np.float64),
        ("confidence", np.float64),
        ("since", np.int64),
        ("growth_m3_Pa", np.float64),
        ("best", np.float64, KIND_COUNT),
        ("onset", np.int64, COUNT),
        ("fitted", np.float64, COUNT),
        ("where", np.int64, COUNT),
    ],
    align=True,
)
"""What explains a chamber best, as a record: kind by number, severity, evidence against a healthy robot, lead over the
next kind (both logarithms of likelihood ratios), posterior of the kind, cycles since the onset; by how much the chamber
grows with each pascal on its wall, as it was before anything was named; `best` evidence of each kind; of each candidate
where it was best: cycle of the onset, severity, chamber."""

MOST_TERMS = 6
"""Terms that are fitted to the readings."""
SCRATCH = np.dtype(
    [
        ("simulated_Pa", np.float64, KEPT),
        ("deviation_Pa", np.float64, KEPT),
        ("filled_Pa", np.float64, KEPT),
        ("vented_Pa", np.float64, KEPT),
        ("swelled_Pa", np.float64, KEPT),
        ("start", np.float64, KEPT),
        ("terms", np.float64, MOST_TERMS),
        ("known", np.float64, MOST_TERMS),
        ("normal", np.float64, (MOST_TERMS, MOST_TERMS + 1)),
        ("healthy", np.float64, KEPT),
        ("best", np.float64, COUNT),
        ("severity", np.float64, COUNT),
        ("since", np.int64, COUNT),
        ("where", np.int64, COUNT),
        ("growth_m3_Pa", np.float64),
    ],
    align=True,
)
"""Scratch of a look, as a record. What was simulated last: gauge pressures, how far each may be off, the ways that it
has come while it was filled and while it was vented (as far as the pressure still depends on them), of these what the
chamber's swelling did, and how much of an error at the start is still in it. What is fitted: its terms for a reading,
the deviations that are known of it before, and its normal equations. Then the cost of a healthy chamber by cycles since
the onset, and of each candidate what explains best so far."""
