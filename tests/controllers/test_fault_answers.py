"""What a fault leaves of a chamber: by kind and severity, and never more than there was."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.fault_answers import BLIND, DEAD_FROM, FORBIDS_FROM, answers, strength_left
from softbot.faults import KIND_CODES, SHARED_KINDS, FaultKind

TABLE = answers()


@pytest.mark.parametrize(
    ("kind", "severity", "left"),
    [
        (FaultKind.RUPTURE, 0.3, 0.0),
        (FaultKind.LEAK, 1.0, 1.0),
        (FaultKind.BLOCKED_INLET, 0.5, 1.0),
        (FaultKind.BLOCKED_INLET, 1.0, 0.0),
        (FaultKind.BALLOONING, 1.0, 0.3),
        (FaultKind.SENSOR_STUCK, 1.0, 0.0),
    ],
)
def test_a_chamber_is_used_for_what_it_can_still_do(kind, severity, left):
    assert strength_left(TABLE, KIND_CODES[kind], severity) == pytest.approx(left)


@given(kind=st.sampled_from(FaultKind), severity=st.floats(0.0, 1.0), more=st.floats(0.0, 1.0))
@settings(deadline=None, max_examples=60)
def test_a_worse_fault_never_leaves_more(kind, severity, more):
    code = KIND_CODES[kind]
    assert 0.0 <= strength_left(TABLE, code, severity + more) <= strength_left(TABLE, code, severity) <= 1.0


def test_a_chamber_whose_sensor_is_not_believed_is_not_used():
    for kind in FaultKind:
        row = TABLE[KIND_CODES[kind]]
        if row[BLIND] > 0.0:
            assert row[DEAD_FROM] < 0.0, kind


def test_what_is_shared_kills_no_chamber_and_nothing_wrong_takes_nothing():
    for kind in SHARED_KINDS:
        assert TABLE[KIND_CODES[kind], DEAD_FROM] == float("inf")
    assert strength_left(TABLE, 0, 1.0) == 1.0
    assert not TABLE[0, FORBIDS_FROM] <= 1.0
