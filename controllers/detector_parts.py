"""What a fault detector is made of and remembers: thresholds, parts and records, as compiled code takes them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from controllers.chamber_gas import Gas, gas_of
from controllers.chamber_observer import OBSERVER, STATES
from controllers.fault_candidates import CANDIDATES, Candidates
from controllers.fault_following import FOLLOWER
from controllers.fault_window import SCRATCH, VERDICT, WINDOW
from controllers.supply_observer import SUPPLY
from softbot.faults import CHAMBER_COUNT, KINDS
from softbot.pneumatics import PneumaticsParameters
from softbot.sensing import SensorParameters

MOST_FOUND = 8
"""Verdicts of one cycle."""
_LEAST_NOISE_Pa = 100.0
_BUS_RESOLUTION_Pa = 100.0  # of a pressure, as the bus tells it


@dataclass(frozen=True)
class DetectorTuning:
    """Thresholds of the decision.

    `allowance` and `alarm_at` are those of the CUSUM, in deviations of the innovation. `evidence` and `lead` are
    logarithms of likelihood ratios. A suspicion is looked into every `look_every` cycles; from `confirm` cycles on a
    verdict may be given, for up to `patience` cycles one kind has to lead the others, after `patience_ends` it is
    dropped.
    """

    period_s: float = 0.01
    """Of the samplings."""
    allowance: float = 1.0
    alarm_at: float = 12.0
    evidence: float = 24.0
    lead: float = 3.0
    look_every: int = 4
    confirm: int = 2
    patience: int = 30
    patience_ends: int = 60
    review: int = 90
    lead_again: float = 6.0
    lead_later: float = 10.0
    """How long after the suspicion a name is looked at again, and the leads by which another one takes its place: then,
    and while the chamber is followed."""
    hurry: int = 7
    evidence_hurried: float = 14.0
    lead_hurried: float = 7.0
    """A chamber that would come to its limit within so many cycles is looked into at once, and its valve said to be
    stuck open on so much evidence and lead: those of two readings."""
    probe_cycles: int = 10
    """Length of a test pulse into a chamber that does not vent: whether it fills tells why."""
    repeats: int = 8
    """Equal readings in a row that make a sensor stuck."""
    below: int = 6
    """Readings in a row below vacuum that make a broken wire."""
    noise_allowance: float = 4.0
    noise_at: float = 100.0
    noise_wildest: float = 25.0
    """CUSUM of the squared second difference over its healthy mean, and what one cycle counts at most."""
    supply_low: float = 0.1
    """Share of its gauge pressure by which a supply is too low, over all that the valves can draw."""
    supply_cycles: int = 8
    supply_lead: float = 10.0
    """Evidence from which a low supply is called lost and no longer sagging, or the other way round."""
    settle: int = 20
    """Cycles at the start in which nothing is judged."""


_NEVER = 2**62
SILENT = DetectorTuning(
    alarm_at=math.inf,
    hurry=0,
    lead_hurried=math.inf,
    repeats=_NEVER,
    below=_NEVER,
    noise_at=math.inf,
    supply_cycles=_NEVER,
    supply_low=1.0,
)
"""Of a detector that follows everything and names nothing."""


class DetectorParts(NamedTuple):
    """What a detector is made of, as compiled code takes it."""

    gas: Gas
    candidates: Candidates
    noise_Pa: float
    """Of a pressure reading, its rounding included."""
    dithers: bool
    """Whether a pressure sensor has so much noise over its resolution that it never repeats itself for long."""
    sounds: bool
    """Whether the inertial unit has noise, so that a reading that repeats has stuck."""
    period_s: float
    limit_Pa: float
    """Of a chamber, gauge."""
    allowance: float
    alarm_at: float
    evidence: float
    lead: float
    look_every: int
    confirm: int
    patience: int
    patience_ends: int
    review: int
    lead_again: float
    lead_later: float
    hurry: int
    evidence_hurried: float
    lead_hurried: float
    probe_cycles: int
    repeats: int
    below: int
    noise_allowance: float
    noise_at: float
    noise_wildest: float
    supply_noise_Pa: float
    supply_low_Pa: float
    supply_cycles: int
    supply_lead: float
    settle: int


DETECTOR = np.dtype(
    [
        ("cycle", np.int64),
        ("oldest", np.int64),
        ("held", np.int64),
        ("rests", np.bool_),
        ("last_t_s", np.float64),
        ("last_supply_Pa", np.float64),
        ("volume_m3", np.float64, CHAMBER_COUNT),
        ("felt", np.float64, CHAMBER_COUNT),
        ("lagged", np.float64, CHAMBER_COUNT),
        ("trusted", np.float64, (CHAMBER_COUNT, STATES)),
        ("learnt", np.int64, CHAMBER_COUNT),
        ("filled", np.int64, CHAMBER_COUNT),
        ("rising", np.float64, CHAMBER_COUNT),
        ("falling", np.float64, CHAMBER_COUNT),
        ("alarm", np.int64, CHAMBER_COUNT),
        ("last_Pa", np.float64, CHAMBER_COUNT),
        ("before_Pa", np.float64, CHAMBER_COUNT),
        ("repeats", np.int64, CHAMBER_COUNT),
        ("owed_Pa", np.float64, CHAMBER_COUNT),
        ("varied", np.int64, CHAMBER_COUNT),
        ("below", np.int64, CHAMBER_COUNT),
        ("noise", np.float64, CHAMBER_COUNT),
        ("last_imu", np.float64, 6),
        ("imu_repeats", np.int64),
        ("imu_varied", np.int64),
        ("probe", np.int64, CHAMBER_COUNT),
        ("probed", np.int64, CHAMBER_COUNT),
        ("supply_low", np.int64),
        ("supply_drawn_kg_s", np.float64),
        ("named", np.int64, CHAMBER_COUNT),
        ("severity", np.float64, CHAMBER_COUNT),
        ("named_shared", np.int64, len(KINDS) + 1),
        ("found", np.int64),
        ("found_chamber", np.int64, MOST_FOUND),
        ("found_kind", np.int64, MOST_FOUND),
        ("found_severity", np.float64, MOST_FOUND),
        ("found_confidence", np.float64, MOST_FOUND),
    ],
    align=True,
)
"""What a detector remembers beside its filters, as a record. `rests`: the board vents all chambers, and only what was
named is looked at again; `felt`: share of each reading that the volumes were reckoned with; `rising` and `falling`: the
CUSUMs; `alarm`: cycle at which a chamber came to be suspected, −1 if it is not; `trusted`: the filters' states, slowly,
while nothing is suspected; `named`: the kind by number, 0 none, and its severity; `named_shared`: for each kind whether
it was found in what the chambers share; `probe`: cycles for which a test pulse into a chamber is still asked for;
`probed`: when one was asked for last; `found`: verdicts of this cycle, chamber −1 for none."""


class DetectorMemory(NamedTuple):
    """All that a detector remembers: records, of shapes (1,), (4,), (1,), (4,), (1,), (4,) and (1,)."""

    own: Any
    observer: Any
    window: Any
    verdict: Any
    supply: Any
    follower: Any
    scratch: Any


def detector_memory() -> DetectorMemory:
    """Memory of a detector that has seen nothing."""
    own = np.zeros(1, DETECTOR).view(np.recarray)
    own[0]["last_t_s"] = math.nan
    own[0]["alarm"] = own[0]["probed"] = -1
    own[0]["felt"] = 1.0
    return DetectorMemory(
        own,
        np.zeros(CHAMBER_COUNT, OBSERVER).view(np.recarray),
        np.zeros(1, WINDOW).view(np.recarray),
        np.zeros(CHAMBER_COUNT, VERDICT).view(np.recarray),
        np.zeros(1, SUPPLY).view(np.recarray),
        np.zeros(CHAMBER_COUNT, FOLLOWER).view(np.recarray),
        np.zeros(1, SCRATCH).view(np.recarray),
    )


def parts_of_detector(
    parameters: PneumaticsParameters, sensors: SensorParameters, tuning: DetectorTuning | None = None
) -> DetectorParts:
    """The parts of a detector of a robot with these pneumatics and sensors."""
    own = tuning or DetectorTuning()
    rounding_Pa = math.hypot(sensors.pressure_resolution_Pa, _BUS_RESOLUTION_Pa) / math.sqrt(12.0)
    return DetectorParts(
        gas_of(parameters),
        CANDIDATES,
        max(math.hypot(sensors.pressure_noise_Pa, rounding_Pa), _LEAST_NOISE_Pa),
        sensors.pressure_noise_Pa > 2.0 * max(sensors.pressure_resolution_Pa, _BUS_RESOLUTION_Pa),
        sensors.gyro_noise_rad_s > 0.0 or sensors.accelerometer_noise_m_s2 > 0.0,
        own.period_s,
        parameters.max_chamber_pressure_Pa,
        own.allowance,
        own.alarm_at,
        own.evidence,
        own.lead,
        own.look_every,
        own.confirm,
        own.patience,
        own.patience_ends,
        own.review,
        own.lead_again,
        own.lead_later,
        own.hurry,
        own.evidence_hurried,
        own.lead_hurried,
        own.probe_cycles,
        own.repeats,
        own.below,
        own.noise_allowance,
        own.noise_at,
        own.noise_wildest,
        max(math.hypot(sensors.supply_noise_Pa, rounding_Pa), _LEAST_NOISE_Pa),
        own.supply_low * parameters.supply_pressure_Pa + 4.0 * sensors.supply_noise_Pa,
        own.supply_cycles,
        own.supply_lead,
        own.settle,
    )
