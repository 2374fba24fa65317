"""What sets under load and recovers after it."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softbot.errors import InputError
from softbot.memory.residual import Residual, residual_inverse, residual_step

parts = st.builds(Residual, st.floats(0.0, 0.9), st.floats(1e-3, 1e4), st.floats(1e-3, 1e4))


def numbers(part: Residual) -> tuple[float, float, float]:
    return part.share, part.growth_time_s, part.recovery_time_s


def test_residue_grows_to_its_share_of_the_load_and_recovers_at_another_pace() -> None:
    part = Residual(0.2, 5.0, 50.0)
    grown = residual_step(*numbers(part), 0.0, 10.0, 5.0)
    assert grown == pytest.approx(2.0 * (1.0 - math.exp(-1.0)), rel=1e-12)
    assert residual_step(*numbers(part), grown, 10.0, 1e4) == pytest.approx(2.0, rel=1e-12)
    assert residual_step(*numbers(part), 2.0, 0.0, 50.0) == pytest.approx(2.0 * math.exp(-1.0), rel=1e-12)


def test_with_a_very_long_recovery_it_is_a_permanent_set() -> None:
    assert residual_step(0.2, 1.0, 1e7, 2.0, 0.0, 60.0) == pytest.approx(2.0, rel=1e-5)


@given(part=parts, residue=st.floats(-10.0, 10.0), load=st.floats(-50.0, 50.0), dt=st.floats(0.0, 1e9))
def test_any_step_ends_between_the_residue_and_its_target(
    part: Residual, residue: float, load: float, dt: float
) -> None:
    ends = sorted([residue, part.share * load])
    assert ends[0] - 1e-12 <= residual_step(*numbers(part), residue, load, dt) <= ends[1] + 1e-12


@given(part=parts, residue=st.floats(-10.0, 10.0), load=st.floats(-50.0, 50.0), dt=st.floats(0.0, 100.0))
def test_steps_under_a_standing_load_add_up(part: Residual, residue: float, load: float, dt: float) -> None:
    once = residual_step(*numbers(part), residue, load, dt)
    half = residual_step(*numbers(part), residue, load, 0.4 * dt)
    assert residual_step(*numbers(part), half, load, 0.6 * dt) == pytest.approx(once, rel=1e-9, abs=1e-9)


@given(part=parts, residue=st.floats(-10.0, 10.0), wanted=st.floats(-50.0, 50.0), dt=st.floats(0.0, 1e6))
def test_inverse_is_exact(part: Residual, residue: float, wanted: float, dt: float) -> None:
    load = residual_inverse(*numbers(part), residue, wanted, dt)
    after = residual_step(*numbers(part), residue, load, dt)
    assert (1.0 - part.share) * load + after == pytest.approx(wanted, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ((1.0, 1.0, 1.0), "share = 1.0: give 0 to 0.9"),
        ((0.1, 0.0, 1.0), "growth_time_s = 0.0"),
        ((0.1, 1.0, math.inf), "recovery_time_s = inf"),
        ((math.nan, 1.0, 1.0), "share"),
    ],
)
def test_what_is_no_residual_is_refused(values: tuple[float, float, float], says: str) -> None:
    with pytest.raises(InputError, match=says):
        Residual(*values)
