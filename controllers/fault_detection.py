"""Fault detection: a chamber is watched by its own model, and what surprises the model is named from the library.

Five things stand side by side, each of them compiled, over records:

- A filter for each chamber (`controllers.chamber_observer`) follows pressure, sensor offset and conductances. Its
  innovation over its own deviation feeds a two-sided CUSUM (Page): a chamber is suspected at `alarm_at`. Below that the
  filter learns, so that a robot whose valves pass 20 % more than its file says is soon no surprise; while a chamber is
  suspected it does not; what it knew well before is `trusted`.
- A suspected chamber is explained by playing the fault library over its last second (`controllers.fault_naming`). The
  verdict is given when the best explanation beats a healthy chamber by `evidence` and every other kind by `lead`, or
  when patience ends. Without such an explanation the suspicion is dropped, and the filter learns on.
  A chamber that runs to its limit is looked into at once: a valve that is clearly stuck open cannot wait.
- Faults that no gas can make are told by the readings alone: one that repeats to the last bit, one below vacuum, one
  that jumps to and fro.
- A named chamber is followed (`controllers.fault_following`): what it does later may tell the kinds apart, also while
  the robot rests in its safe state.
- What the chambers share (supply, inertial unit) has tests of its own, and names no chamber.

Judgement is held while readings are late or missing: over an interval that is not the control period the model is
trusted the less, and after one in which a sampling was lost a filter takes the reading for the pressure, keeps what it
has learnt of the valves, and judges nothing for a few cycles.

Left out: gyro's bias, wall, floor and load, which the pressures do not show: `controllers.roll_observer`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.chamber_gas import lagged_opening
from controllers.chamber_observer import (
    INLET,
    OUTLET,
    PRESSURE,
    STATES,
    begin_observing,
    between,
    observe,
    resume_observing,
)
from controllers.detector_parts import (
    MOST_FOUND,
    DetectorMemory,
    DetectorParts,
    DetectorTuning,
    detector_memory,
    parts_of_detector,
)
from controllers.fault_following import begin_following, follow, give_up, likeliest, resume_following, severity_of
from controllers.fault_naming import name_fault
from controllers.fault_simulation import swelled_by
from controllers.fault_window import KEPT
from controllers.interface import Detection
from controllers.supply_observer import begin_supply, drawn_kg_s, observe_supply, weigh_supply
from softbot.faults import CHAMBER_COUNT, KIND_CODES, KINDS, NO_CHAMBER, FaultKind
from softbot.kernel_compiler import kernel, part, unit
from softbot.pneumatics import PneumaticsParameters
from softbot.sensing import READINGS, LEAST_READING_Pa, Readings, SensorParameters

FloatArray = NDArray[np.float64]

_WILDEST = 4.0  # deviations: one reading, however wild, is no proof
_LONGEST_STEP = 1.5  # periods: beyond, a sampling was lost
_FORGETTING_STEP = 10.0  # periods: beyond, suspicions are dropped
_HELD_CYCLES = 4  # after a lost sampling, while the valves' lag is made up
_SECOND_DIFFERENCE = 6.0  # variance of x(k) − 2 x(k−1) + x(k−2) over that of white x
_SENSOR_STUCK, _SENSOR_NOISE = KIND_CODES[FaultKind.SENSOR_STUCK], KIND_CODES[FaultKind.SENSOR_NOISE]
_SENSOR_DROPOUT = KIND_CODES[FaultKind.SENSOR_DROPOUT]
_LINES_SWAPPED = KIND_CODES[FaultKind.LINES_SWAPPED]
_BLOCKED_EXHAUST, _KINKED_LINE = KIND_CODES[FaultKind.BLOCKED_EXHAUST], KIND_CODES[FaultKind.KINKED_LINE]
_LEAK, _STUCK_CLOSED = KIND_CODES[FaultKind.LEAK], KIND_CODES[FaultKind.STUCK_CLOSED]
_STUCK_OPEN = KIND_CODES[FaultKind.STUCK_OPEN]
_HOLDS_BACK, _LEAST_PROBED_Pa = 0.3, 5e3  # opening of an exhaust and pressure behind it that make a test pulse tell
_SUPPLY_SAG, _SUPPLY_LOSS = KIND_CODES[FaultKind.SUPPLY_SAG], KIND_CODES[FaultKind.SUPPLY_LOSS]
_IMU_STUCK, _IMU_DROPOUT = KIND_CODES[FaultKind.IMU_STUCK], KIND_CODES[FaultKind.IMU_DROPOUT]
_LEARNS_BELOW, _TRUSTS_BELOW = 6.0, 3.0  # of the CUSUM: what may be a fault is not to be learnt as a valve's nature
_TRUST_SHARE = 0.02  # of what was learnt, taken over in a cycle
_COST_OF_DOUBT = 300.0  # evidence asked for above the usual, for each unit of deviation of the conductances learnt
_COST_OF_YOUTH, _GROWN_UP, _FILLS = 80.0, 120.0, 0.05  # … of a chamber seen filling for less than so many cycles
_COST_OF_LEAK = 20.0  # … for a leak, which any error of the volume looks like a little
_COST_OF_COMPANY = 60.0  # … beside another that is suspected or broken: it bends the robot otherwise than is believed
_UNDECIDED, _TOO_NOISY = 0.3, 0.4  # of the CUSUM of the noise: a sensor may be noisy; no hurried verdict from there on
_LEAST_PACE_Pa = 2e3  # in a cycle, twice in a row: four deviations of a reading
_AGAINST, _FILLS_Pa = 6, 4e3  # cycles of venting in which a chamber that rises by so much is fed by something
_REFILLS = 20  # cycles, for which a manifold that was shut off may stand low
_VARIED = 20  # readings that differed from the one before, so that a sensor is known to be alive


class FaultDetector:
    """Watches the four chambers and what they share. One `update` a cycle; each is named once, until `forget`."""

    def __init__(
        self,
        parameters: PneumaticsParameters,
        sensors: SensorParameters,
        tuning: DetectorTuning | None = None,
    ) -> None:
        self.parts = parts_of_detector(parameters, sensors, tuning)
        self.memory = detector_memory()
        self._reading = np.zeros(1, READINGS).view(np.recarray)

    @property
    def named(self) -> dict[int, FaultKind]:
        """What each named chamber was found to have."""
        codes = self.memory.own[0]["named"].tolist()
        return {chamber: KINDS[code - 1] for chamber, code in enumerate(codes) if code}

    def update(self, readings: Readings, chamber_volume_m3: FloatArray) -> tuple[Detection, ...]:
        """Faults that these readings decide. `chamber_volume_m3` (4,): by the law, dead volume not counted."""
        readings.write(self._reading[0])
        detect(self.parts, self.memory, self._reading, np.ascontiguousarray(chamber_volume_m3))
        return detections_of(self.memory, readings.t_s)

    def forget(self, chamber: int) -> None:
        """Take a chamber's verdict back, after a repair."""
        forget_chamber(self.memory, chamber)


def detections_of(memory: DetectorMemory, t_s: float) -> tuple[Detection, ...]:
    """The verdicts of a cycle at t_s that stand in a detector's memory."""
    own = memory.own[0]
    return tuple(
        Detection(
            float(t_s),
            int(own["found_chamber"][n]),
            str(KINDS[int(own["found_kind"][n]) - 1]),
            float(own["found_confidence"][n]),
        )
        for n in range(int(own["found"]))
    )


@kernel(cache=False)
def forget_chamber(memory: DetectorMemory, chamber: int) -> None:
    """Take a chamber's verdict back: its filter begins anew with the next reading."""
    own = memory.own[0]
    own.named[chamber] = 0
    own.severity[chamber] = 0.0
    own.oldest = own.cycle
    _drop(own, chamber)
    own.repeats[chamber] = own.below[chamber] = own.probe[chamber] = 0
    own.noise[chamber] = own.owed_Pa[chamber] = 0.0
    memory.follower[chamber].busy = False
    memory.observer[chamber].deviation_Pa = 0.0  # tells `detect` to begin with it anew


@part()
def _drop(own: Any, chamber: int) -> None:
    own.rising[chamber] = own.falling[chamber] = 0.0
    own.alarm[chamber] = -1


@part()
def _resume(parts: DetectorParts, memory: DetectorMemory, reading: Any, begins: bool, forgets: bool) -> None:
    """The first reading, or the first after one was lost."""
    own = memory.own[0]
    own.oldest = own.cycle
    own.held = parts.settle if begins else max(own.held, _HELD_CYCLES)
    for c in range(CHAMBER_COUNT):
        if begins:
            begin_observing(memory.observer[c], parts.gas, reading.pressure_Pa[c], parts.noise_Pa)
        else:
            resume_observing(memory.observer[c], parts.gas, reading.pressure_Pa[c], parts.noise_Pa)
        if begins or forgets or own.alarm[c] >= 0:
            _drop(own, c)
        follower = memory.follower[c]
        if follower.busy:
            resume_following(
                follower, parts.candidates, parts.gas.atmosphere_Pa, reading.pressure_Pa[c], parts.noise_Pa
            )
        own.lagged[c] = reading.opening[c]
        own.last_Pa[c] = reading.pressure_Pa[c]
        own.repeats[c] = own.below[c] = 0
        own.noise[c] = own.owed_Pa[c] = 0.0
    _keep(parts, memory, reading, own.lagged, own.lagged, 0.0)


@part()
def _keep(
    parts: DetectorParts, memory: DetectorMemory, reading: Any, opening: FloatArray, swelling: FloatArray, step_s: float
) -> None:
    own, window = memory.own[0], memory.window[0]
    at = own.cycle % KEPT
    window.step_s[at] = step_s
    window.supply[at] = own.last_supply_Pa + parts.gas.atmosphere_Pa
    for c in range(CHAMBER_COUNT):
        observer = memory.observer[c]
        window.reading_Pa[at, c] = reading.pressure_Pa[c]
        window.commanded[at, c] = reading.opening[c]
        window.opening[at, c] = opening[c]
        window.lagged[at, c] = own.lagged[c]
        window.volume_m3[at, c] = own.volume_m3[c]
        window.swelling[at, c] = swelling[c]
        window.felt[at, c] = own.felt[c]
        window.x[at, c, PRESSURE] = observer.x[PRESSURE]
        for i in range(1, STATES):
            window.x[at, c, i] = own.trusted[c, i] if own.learnt[c] > 0 else observer.x[i]
        window.doubt[at, c] = math.sqrt(max(observer.covariance[INLET, INLET], observer.covariance[OUTLET, OUTLET]))
        window.timing_Pa[at, c] = observer.timing_Pa
        window.innovation_Pa[at, c] = observer.innovation_Pa
        window.deviation_Pa[at, c] = observer.deviation_Pa


@part()
def _follow(
    parts: DetectorParts, memory: DetectorMemory, reading: Any, chamber_volume_m3: FloatArray, step_s: float
) -> None:
    """Move the filters on by a reading, and keep what was seen."""
    own, gas = memory.own[0], parts.gas
    mean, swelling = np.empty(CHAMBER_COUNT), np.empty(CHAMBER_COUNT)
    own.supply_drawn_kg_s = 0.0
    supply = own.last_supply_Pa + gas.atmosphere_Pa
    off = abs(step_s - parts.period_s) / parts.period_s
    for c in range(CHAMBER_COUNT):
        volume = chamber_volume_m3[c] + gas.dead_volume_m3[c]
        swelling[c] = swelled_by(volume, own.volume_m3[c])
        own.volume_m3[c] = volume
        own.lagged[c], mean[c] = lagged_opening(gas.lag_s, step_s, own.lagged[c], reading.opening[c])
        observer = memory.observer[c]
        opened = between(mean[c], own.lagged[c])
        own.supply_drawn_kg_s += drawn_kg_s(gas, c, observer.x[INLET], opened, supply, observer.x[PRESSURE])
        if observer.deviation_Pa <= 0.0:
            begin_observing(observer, gas, reading.pressure_Pa[c], parts.noise_Pa)
            continue
        observe(
            observer,
            gas,
            c,
            reading.pressure_Pa[c],
            parts.noise_Pa,
            supply,
            mean[c],
            own.lagged[c],
            volume,
            swelling[c],
            step_s,
            off,
            own.alarm[c] < 0 and own.named[c] == 0 and max(own.rising[c], own.falling[c]) < _LEARNS_BELOW,
        )
        if max(own.rising[c], own.falling[c]) < _TRUSTS_BELOW and own.alarm[c] < 0 and own.named[c] == 0:
            own.learnt[c] += 1
            own.filled[c] += 1 if own.lagged[c] > _FILLS else 0
            share = max(_TRUST_SHARE, 1.0 / own.learnt[c])
            for i in range(STATES):
                own.trusted[c, i] += share * (observer.x[i] - own.trusted[c, i])
        mean[c] = between(mean[c], own.lagged[c])
    _keep(parts, memory, reading, mean, swelling, step_s)


@part()
def tell(own: Any, chamber: int, kind: int, severity: float, confidence: float) -> None:
    """A verdict of this cycle, into the detector's own record; chamber NO_CHAMBER for what is shared."""
    if chamber >= 0:
        own.named[chamber], own.severity[chamber] = kind, severity
        if kind == _LINES_SWAPPED:
            other = (chamber + 1) % CHAMBER_COUNT
            own.named[other], own.severity[other] = kind, severity
            _drop(own, chamber)
            _drop(own, other)
    else:
        own.named_shared[kind] = 1
    report(own, chamber, kind, severity, confidence)


@part()
def report(own: Any, chamber: int, kind: int, severity: float, confidence: float) -> None:
    """A verdict of this cycle that leaves a chamber to be watched as before."""
    n = own.found
    if n < MOST_FOUND:
        own.found_chamber[n], own.found_kind[n] = chamber, kind
        own.found_severity[n], own.found_confidence[n] = severity, np.round(100.0 * confidence) / 100.0
        own.found = n + 1


@part()
def _judge(parts: DetectorParts, memory: DetectorMemory, reading: Any, decides: bool) -> None:
    own = memory.own[0]
    for c in range(CHAMBER_COUNT):
        own.probe[c] = max(own.probe[c] - 1, 0)
        if own.named[c] != 0:
            if own.alarm[c] >= 0:
                _review(parts, memory, reading, c, decides)
            elif memory.follower[c].busy:
                _go_on_following(parts, memory, c, decides)
            continue
        if own.rests:
            _drop(own, c)
            continue
        kind = _sensor_alone(parts, own, memory.observer[c], reading.pressure_Pa[c], c)
        if not decides:
            _drop(own, c)
            continue
        if kind != 0:
            tell(own, c, kind, 1.0, 1.0)
            _drop(own, c)
            continue
        observer = memory.observer[c]
        z = observer.innovation_Pa / observer.deviation_Pa
        z = min(max(z, -_WILDEST), _WILDEST)
        own.rising[c] = max(0.0, own.rising[c] + z - parts.allowance)
        own.falling[c] = max(0.0, own.falling[c] - z - parts.allowance)
        if _runs_full(parts, own, observer, reading.pressure_Pa[c], c) and _is_stuck_open(parts, memory, c):
            continue
        if own.alarm[c] < 0:
            if max(own.rising[c], own.falling[c]) < parts.alarm_at:
                continue
            own.alarm[c] = own.cycle
        _explain(parts, memory, c)


@part()
def _sensor_alone(parts: DetectorParts, own: Any, observer: Any, shown_Pa: float, c: int) -> int:
    """What a chamber's readings alone say of its sensor: a kind by number, 0 none."""
    if shown_Pa == own.last_Pa[c]:
        own.repeats[c] += 1
        own.owed_Pa[c] = max(own.owed_Pa[c], abs(observer.innovation_Pa))
        owes = own.owed_Pa[c] > 2.0 * parts.noise_Pa or (parts.dithers and own.varied[c] > _VARIED)
        if own.repeats[c] >= parts.repeats and owes:
            return _SENSOR_STUCK
    else:
        own.repeats[c] = 0
        own.owed_Pa[c] = 0.0
        own.varied[c] += 1
    own.below[c] = own.below[c] + 1 if shown_Pa < LEAST_READING_Pa else 0
    bend_Pa = shown_Pa - 2.0 * own.last_Pa[c] + own.before_Pa[c]
    surprise = observer.innovation_Pa / observer.deviation_Pa  # valves that open and shut make a sound one jump as well
    wild = min(bend_Pa * bend_Pa / (_SECOND_DIFFERENCE * parts.noise_Pa * parts.noise_Pa), surprise * surprise)
    own.noise[c] = max(0.0, own.noise[c] + min(wild, parts.noise_wildest) - parts.noise_allowance)
    if own.noise[c] > parts.noise_at:
        return _SENSOR_NOISE
    if own.below[c] >= parts.below and own.noise[c] < 0.6 * parts.noise_at:
        return _SENSOR_DROPOUT
    return 0


@part()
def _look(parts: DetectorParts, memory: DetectorMemory, c: int, afresh: bool) -> None:
    """Play the library over the last second of a chamber; its verdict is written anew."""
    own = memory.own[0]
    name_fault(
        parts.gas,
        memory.window[0],
        c,
        own.cycle,
        own.alarm[c],
        own.oldest,
        parts.noise_Pa,
        parts.candidates,
        afresh,
        memory.verdict[c],
        memory.scratch[0],
    )


@part()
def _asked(parts: DetectorParts, memory: DetectorMemory, c: int, kind: int) -> float:
    """Evidence that a verdict on a chamber needs above the usual."""
    own = memory.own[0]
    doubt = memory.window[0].doubt[own.cycle % KEPT, c]
    asked = _COST_OF_DOUBT * doubt + _COST_OF_YOUTH * max(0.0, 1.0 - own.filled[c] / _GROWN_UP) ** 2
    for other in range(CHAMBER_COUNT):
        if other != c and (own.named[other] != 0 or own.alarm[other] >= 0):
            asked += _COST_OF_COMPANY
    return asked + (_COST_OF_LEAK if kind == _LEAK else 0.0)


@part()
def _runs_full(parts: DetectorParts, own: Any, observer: Any, shown_Pa: float, c: int) -> bool:
    """Whether a chamber rises unexpectedly, and so fast that a name might come after it has passed its limit."""
    newest_Pa, before_Pa = shown_Pa - own.last_Pa[c], own.last_Pa[c] - own.before_Pa[c]
    surprises = observer.innovation_Pa > _WILDEST * observer.deviation_Pa
    fast = min(newest_Pa, before_Pa) > _LEAST_PACE_Pa
    return bool(surprises and fast and shown_Pa + parts.hurry * 0.5 * (newest_Pa + before_Pa) > parts.limit_Pa)


@part()
def _is_stuck_open(parts: DetectorParts, memory: DetectorMemory, c: int) -> bool:
    """Look into a chamber at once; whether its valve is so clearly stuck open that this was said."""
    own, verdict = memory.own[0], memory.verdict[c]
    if own.noise[c] > _TOO_NOISY * parts.noise_at or own.below[c] > 0:
        return False
    suspected, own.alarm[c] = own.alarm[c], own.cycle if own.alarm[c] < 0 else own.alarm[c]
    _look(parts, memory, c, True)
    noisy = max(own.noise[c] + parts.noise_allowance - parts.noise_wildest, 0.0)  # more than by one jump
    asked = parts.evidence_hurried + _asked(parts, memory, c, verdict.kind) + noisy
    if verdict.kind != _STUCK_OPEN or verdict.evidence < asked or verdict.lead < parts.lead_hurried:
        own.alarm[c] = suspected
        return False
    tell(own, verdict.chamber, verdict.kind, verdict.severity, verdict.confidence)
    return True


@part()
def _fills_against(own: Any, window: Any, c: int) -> bool:
    """Whether a chamber has been told to vent for some cycles, and fills."""
    for n in range(_AGAINST):
        if window.lagged[(own.cycle - n) % KEPT, c] > -_HOLDS_BACK:
            return False
    now, then = own.cycle % KEPT, (own.cycle - _AGAINST) % KEPT
    return bool(window.reading_Pa[now, c] - window.reading_Pa[then, c] > _FILLS_Pa)


@part()
def _ask_for_probe(parts: DetectorParts, own: Any, verdict: Any, c: int) -> None:
    """Where a chamber does not vent and only filling it a little would tell why, ask for that."""
    if own.probed[c] >= own.alarm[c] or verdict.evidence < parts.evidence or own.lagged[c] > -_HOLDS_BACK:
        return
    if verdict.kind not in (_BLOCKED_EXHAUST, _KINKED_LINE, _STUCK_CLOSED) or own.last_Pa[c] < _LEAST_PROBED_Pa:
        return
    for kind in (_BLOCKED_EXHAUST, _KINKED_LINE, _STUCK_CLOSED):
        if kind != verdict.kind and verdict.best[verdict.kind] - verdict.best[kind] < parts.lead_again:
            own.probed[c] = own.cycle
            own.probe[c] = parts.probe_cycles


@part()
def _explain(parts: DetectorParts, memory: DetectorMemory, c: int) -> None:
    """Look for what explains a suspected chamber, and say it when it is clear."""
    own = memory.own[0]
    waited = own.cycle - own.alarm[c]
    if waited > parts.patience_ends:
        _drop(own, c)
        return
    undecided = own.repeats[c] >= 4 or own.below[c] > 0 or own.noise[c] > _UNDECIDED * parts.noise_at
    if waited < parts.confirm or (waited - parts.confirm) % parts.look_every != 0 or undecided:
        return
    verdict = memory.verdict[c]
    _look(parts, memory, c, waited <= parts.confirm + 2 * parts.look_every)
    _ask_for_probe(parts, own, verdict, c)
    if own.probe[c] > 0:
        return
    if verdict.kind == 0 or verdict.evidence < parts.evidence + _asked(parts, memory, c, verdict.kind):
        return
    if verdict.lead < parts.lead and waited < parts.patience:
        return
    tell(own, verdict.chamber, verdict.kind, verdict.severity, verdict.confidence)


@part()
def _review(parts: DetectorParts, memory: DetectorMemory, reading: Any, c: int, decides: bool) -> None:
    """Look again at a chamber that was named: what it does since then may tell the kinds apart."""
    own = memory.own[0]
    waited = own.cycle - own.alarm[c]
    verdict = memory.verdict[c]
    slid_out = own.cycle - verdict.onset[verdict.candidate] > KEPT - 2  # what explained it best began before the window
    if not decides or waited > parts.review or slid_out:
        _drop(own, c)
        begin_following(
            memory.follower[c],
            parts.candidates,
            verdict,
            own.trusted[c],
            parts.gas.atmosphere_Pa,
            reading.pressure_Pa[c],
            own.lagged[c],
            parts.noise_Pa,
        )
        return
    missed = own.named[c] != _STUCK_OPEN and _fills_against(own, memory.window[0], c)
    if (waited - parts.confirm) % (parts.look_every if missed else 2 * parts.look_every) != 0:
        return
    _look(parts, memory, c, missed or waited <= parts.confirm)
    _ask_for_probe(parts, own, verdict, c)
    if verdict.kind == 0 or verdict.evidence < parts.evidence:
        return
    if verdict.kind == own.named[c]:
        own.severity[c] = verdict.severity
    elif verdict.lead >= parts.lead_again:
        tell(own, verdict.chamber, verdict.kind, verdict.severity, verdict.confidence)
        if verdict.chamber != c:
            _drop(own, c)


@part()
def _go_on_following(parts: DetectorParts, memory: DetectorMemory, c: int, decides: bool) -> None:
    """Let every explanation of a named chamber meet the next reading; another one takes its place when it leads."""
    own, follower = memory.own[0], memory.follower[c]
    follow(follower, parts.gas, parts.candidates, memory.window[0], c, own.cycle, parts.noise_Pa)
    m, lead = likeliest(follower, parts.candidates, own.named[c])
    if decides and lead >= parts.lead_later:
        severity = severity_of(follower, parts.candidates, m, memory.verdict[c].fitted[m])
        tell(own, c, parts.candidates.kind[m], severity, 1.0 / (1.0 + math.exp(-min(lead, 700.0))))
    give_up(follower)


@part()
def _judge_supply(parts: DetectorParts, memory: DetectorMemory, reading: Any, step_s: float) -> None:
    """A supply that stands lower than the valves can draw it: it sags, or it is lost.

    A sag is the milder name, and taken while both explain it; afterwards the name follows the evidence.
    """
    own, supply = memory.own[0], memory.supply[0]
    if reading.main_supply_shut:
        own.supply_low, supply.begun = -_REFILLS, False
        return
    if supply.begun:
        observe_supply(supply, parts.gas, reading.supply_Pa, parts.supply_noise_Pa, own.supply_drawn_kg_s, step_s)
    if reading.supply_Pa > parts.gas.regulated_Pa - parts.supply_low_Pa:
        own.supply_low = 0
        known = own.named_shared[_SUPPLY_SAG] + own.named_shared[_SUPPLY_LOSS] > 0
        supply.begun = supply.begun and known
        return
    if not supply.begun:
        begin_supply(supply, parts.gas, reading.supply_Pa, parts.supply_noise_Pa)
    own.supply_low += 1
    if own.supply_low < parts.supply_cycles:
        return
    evidence, sag, loss = weigh_supply(supply)
    if evidence > parts.supply_lead:
        kind, severity = _SUPPLY_LOSS, loss
    elif evidence < -parts.supply_lead or own.named_shared[_SUPPLY_LOSS] == 0:
        kind, severity = _SUPPLY_SAG, sag
    else:
        return
    if own.named_shared[kind] == 0:
        own.named_shared[_SUPPLY_SAG] = own.named_shared[_SUPPLY_LOSS] = 0
        tell(own, NO_CHAMBER, kind, severity, 1.0 / (1.0 + math.exp(-min(abs(evidence), 700.0))))


@part()
def _judge_imu(parts: DetectorParts, own: Any, reading: Any) -> None:
    """An inertial unit that repeats itself to the last bit, or says zero throughout."""
    same, nothing = True, True
    for k in range(6):
        value = reading.gyro_rad_s[k] if k < 3 else reading.accelerometer_m_s2[k - 3]
        same = same and value == own.last_imu[k]
        nothing = nothing and value == 0.0
        own.last_imu[k] = value
    own.imu_repeats = own.imu_repeats + 1 if same else 0
    kind = _IMU_DROPOUT if nothing else _IMU_STUCK
    own.imu_varied += 0 if same else 1
    known = own.named_shared[_IMU_STUCK] + own.named_shared[_IMU_DROPOUT] > 0
    if own.imu_varied > _VARIED and own.imu_repeats >= parts.repeats and (nothing or parts.sounds) and not known:
        tell(own, NO_CHAMBER, kind, 1.0, 1.0)


@unit(from_python=True)
def detect(parts: DetectorParts, memory: DetectorMemory, reading_memory: Any, chamber_volume_m3: FloatArray) -> None:
    """One cycle of the detector; its verdicts stand in memory until the next. reading_memory: (1,) of READINGS.

    chamber_volume_m3 (4,): by the law, dead volume not counted.
    """
    own, reading = memory.own[0], reading_memory[0]
    own.found = 0
    whole = math.isfinite(reading.supply_Pa)
    for c in range(CHAMBER_COUNT):
        whole = whole and math.isfinite(reading.pressure_Pa[c]) and math.isfinite(reading.opening[c])
        whole = whole and chamber_volume_m3[c] + parts.gas.dead_volume_m3[c] > 0.0
    if not whole:
        return
    step_s = reading.t_s - own.last_t_s
    begins = math.isnan(own.last_t_s)
    lost = not begins and not 0.2 * parts.period_s < step_s < _LONGEST_STEP * parts.period_s
    own.cycle += 1
    if begins or lost:
        _resume(parts, memory, reading, begins, not 0.0 < step_s < _FORGETTING_STEP * parts.period_s)
        for c in range(CHAMBER_COUNT):
            own.volume_m3[c] = chamber_volume_m3[c] + parts.gas.dead_volume_m3[c]
    else:
        _follow(parts, memory, reading, chamber_volume_m3, step_s)
        if own.held > 0:
            own.held -= 1
        _judge(parts, memory, reading, own.held == 0)
        if not own.rests:
            _judge_supply(parts, memory, reading, step_s)
            _judge_imu(parts, own, reading)
    for c in range(CHAMBER_COUNT):
        own.before_Pa[c], own.last_Pa[c] = own.last_Pa[c], reading.pressure_Pa[c]
    own.last_supply_Pa, own.last_t_s = reading.supply_Pa, reading.t_s
