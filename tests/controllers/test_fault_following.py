"""A chamber that was named is followed by every explanation that came near, until what it does tells them apart."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.chamber_gas import gas_of, next_pressure
from controllers.chamber_observer import INLET, OUTLET, STATES
from controllers.fault_candidates import CANDIDATES, COUNT
from controllers.fault_following import FOLLOWER, begin_following, follow, give_up, likeliest
from controllers.fault_window import KEPT, VERDICT, WINDOW
from softbot.faults import BALLOON_LOSS, KIND_CODES, BALLOON_VOLUME_1_Pa, FaultKind
from softbot.pneumatics import PneumaticsParameters

GAS = gas_of(PneumaticsParameters())
VOLUME_m3, NOISE_Pa = 50e-6, 500.0
PATHS = {FaultKind.BLOCKED_INLET: (1, 0), FaultKind.BLOCKED_EXHAUST: (0, 1), FaultKind.KINKED_LINE: (1, 1)}


def followed(truth: FaultKind, severity: float, openings, seed: int):
    """Follow a chamber whose paths are blocked so, from 60 kPa, through these openings (held for 0.2 s each)."""
    random = np.random.default_rng(seed)
    window, verdict, follower = (np.zeros(1, kind).view(np.recarray)[0] for kind in (WINDOW, VERDICT, FOLLOWER))
    sound = np.zeros(STATES)
    sound[INLET] = sound[OUTLET] = 1.0
    verdict.best[:] = -1e3
    window.felt[:] = 1.0
    for kind in PATHS:
        verdict.best[KIND_CODES[kind]] = 50.0
    for m in range(COUNT):
        verdict.onset[m], verdict.fitted[m] = 1, severity
    pressure = 60e3 + GAS.atmosphere_Pa
    begin_following(
        follower, CANDIDATES, verdict, sound, GAS.atmosphere_Pa, pressure - GAS.atmosphere_Pa, 0.0, NOISE_Pa
    )
    assert follower.follows.sum() == len(PATHS)
    inlet, outlet = (1.0 - severity * blocked for blocked in PATHS[truth])
    now = 1
    for opening in openings:
        for _ in range(20):
            at, now = now % KEPT, now + 1
            supply = GAS.regulated_Pa + GAS.atmosphere_Pa
            pressure = next_pressure(GAS, 0, pressure, supply, opening, VOLUME_m3, 0.0, inlet, outlet, 0.0, 0.01)[0]
            window.step_s[at], window.supply[at], window.volume_m3[at, 0] = 0.01, supply, VOLUME_m3
            window.opening[at, 0] = window.commanded[at, 0] = opening
            window.reading_Pa[at, 0] = pressure - GAS.atmosphere_Pa + NOISE_Pa * random.standard_normal()
            follow(follower, GAS, CANDIDATES, window, 0, now - 1, NOISE_Pa)
    return follower


@pytest.mark.parametrize("truth", list(PATHS))
@pytest.mark.parametrize("severity", [0.6, 0.85])
@pytest.mark.parametrize("seed", [0, 1])
def test_filling_and_venting_tell_which_path_is_blocked(truth, severity, seed):
    follower = followed(truth, severity, (-0.5, 0.3, -0.5, 0.3), seed)
    m, _ = likeliest(follower, CANDIDATES, KIND_CODES[FaultKind.LEAK])
    assert CANDIDATES.kind[m] == KIND_CODES[truth]
    assert follower.x[m, 1] == pytest.approx(severity, abs=0.08)
    give_up(follower)
    assert not follower.busy  # and the others are not followed any more


def test_venting_alone_does_not_tell_a_blocked_exhaust_from_a_kinked_line():
    follower = followed(FaultKind.BLOCKED_EXHAUST, 0.8, (-1.0, -1.0), 3)
    cost = {CANDIDATES.kind[m]: follower.cost[m] for m in range(COUNT) if follower.follows[m]}
    exhaust, line = (cost[KIND_CODES[kind]] for kind in (FaultKind.BLOCKED_EXHAUST, FaultKind.KINKED_LINE))
    assert abs(exhaust - line) < 3.0
    assert cost[KIND_CODES[FaultKind.BLOCKED_INLET]] > exhaust + 20.0


def test_an_empty_chamber_decides_nothing():
    follower = followed(FaultKind.BLOCKED_INLET, 0.8, (-1.0,) * 4, 4)
    before = follower.cost.copy()
    emptied = followed(FaultKind.BLOCKED_INLET, 0.8, (-1.0,) * 40, 4).cost
    np.testing.assert_array_equal(emptied, before)


GROWTH_m3_Pa = 1.5e-10


def filled(truth: FaultKind, severity: float, explanations: dict[FaultKind, float], seed: int):
    """Follow a chamber that is filled and vented in turn, from its own severity, under explanations with theirs.

    It grows with what its wall feels; a ballooning one gives way besides, and its wall feels the less.
    """
    random = np.random.default_rng(seed)
    window, verdict, follower = (np.zeros(1, kind).view(np.recarray)[0] for kind in (WINDOW, VERDICT, FOLLOWER))
    sound = np.zeros(STATES)
    sound[INLET] = sound[OUTLET] = 1.0
    window.felt[:] = 1.0
    verdict.best[:], verdict.growth_m3_Pa = -1e3, GROWTH_m3_Pa
    for m in range(COUNT):
        for kind, guess in explanations.items():
            if CANDIDATES.kind[m] == KIND_CODES[kind]:
                verdict.best[CANDIDATES.kind[m]], verdict.onset[m], verdict.fitted[m] = 50.0, 1, guess
    widening, wall, path = 0.0, 1.0, 1.0
    if truth is FaultKind.BALLOONING:
        widening, wall = severity * BALLOON_VOLUME_1_Pa, 1.0 - BALLOON_LOSS * severity
    else:
        path = 1.0 - severity
    pressure, gauge = GAS.atmosphere_Pa, 0.0
    begin_following(follower, CANDIDATES, verdict, sound, GAS.atmosphere_Pa, 0.0, 0.0, NOISE_Pa)
    before = VOLUME_m3
    for now in range(1, 301):
        at, opening = now % KEPT, 0.4 if (now // 25) % 2 == 0 else -0.6
        volume = VOLUME_m3 + GROWTH_m3_Pa * wall * gauge
        supply = GAS.regulated_Pa + GAS.atmosphere_Pa
        room = 1.0 + widening * (gauge + pressure)
        swelling = (volume - before) / volume * (1.0 + widening * gauge) / room
        pressure = next_pressure(GAS, 0, pressure, supply, opening, volume * room, swelling, path, path, 0.0, 0.01)[0]
        before, shown, gauge = volume, gauge, max(pressure - GAS.atmosphere_Pa, 0.0)
        window.step_s[at], window.supply[at] = 0.01, supply
        window.opening[at, 0] = window.commanded[at, 0] = opening
        window.reading_Pa[at, 0] = gauge + NOISE_Pa * random.standard_normal()
        window.volume_m3[at, 0] = VOLUME_m3 + GROWTH_m3_Pa * shown  # as if it were sound
        follow(follower, GAS, CANDIDATES, window, 0, now, NOISE_Pa)
    return follower


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    ("truth", "severity"), [(FaultKind.BALLOONING, 0.9), (FaultKind.BALLOONING, 0.6), (FaultKind.KINKED_LINE, 0.5)]
)
def test_a_chamber_that_balloons_is_told_from_a_kinked_line_whose_severity_was_guessed_better(truth, severity, seed):
    guesses = {FaultKind.BALLOONING: 0.7, FaultKind.KINKED_LINE: 0.45}
    follower = filled(truth, severity, guesses, seed)
    m, _ = likeliest(follower, CANDIDATES, KIND_CODES[FaultKind.LEAK])
    assert CANDIDATES.kind[m] == KIND_CODES[truth]
    assert follower.x[m, 1] == pytest.approx(severity, abs=0.12)  # its severity is followed too
