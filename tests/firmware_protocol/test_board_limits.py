"""The board's limits hold, and limits that protect nothing are refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.board import BoardLimits, BoardRules, measured_hPa
from firmware_protocol.enumerations import Parameter
from firmware_protocol.errors import LimitsError
from firmware_protocol.safety import SENSOR_INVALID_hPa

NewBench = Callable[..., Any]


@given(st.lists(st.floats(0, 819.1), min_size=4, max_size=4))
@settings(deadline=None, max_examples=60)
def test_no_setpoint_above_the_limit_ever_acts(new_bench: NewBench, wanted_kPa: list[float]) -> None:
    bench = new_bench().running()
    bench.put(bench.peer.send("SequencerSetpoints", {f"Setpoint{each}": wanted_kPa[each] for each in range(4)}))
    acting_Pa = bench.tick().setpoints_Pa
    for wanted, acting in zip(wanted_kPa, acting_Pa, strict=True):
        assert acting == pytest.approx(min(wanted * 1e3, 200e3), abs=51)
        assert acting <= 200e3
    clamped = bench.rules.parameters.values[Parameter.SETPOINTS_CLAMPED]
    assert clamped == sum(round(wanted, 1) > 200.0 for wanted in wanted_kPa)


@pytest.mark.parametrize(
    ("bad", "complaint"),
    [
        ({"max_setpoint_Pa": 0.0}, "0 < max_setpoint_Pa < over_pressure_Pa"),
        ({"max_setpoint_Pa": 250e3}, "0 < max_setpoint_Pa < over_pressure_Pa"),
        ({"over_pressure_Pa": 810e3}, "<= 809100"),
        ({"max_setpoint_Pa": math.nan}, "max_setpoint_Pa = nan"),
        ({"max_setpoint_Pa": 99.9}, "at least 100 Pa"),
        ({"max_setpoint_Pa": 0.5}, "at least 100 Pa"),
        ({"max_setpoint_Pa": 200.01e3, "over_pressure_Pa": 200.09e3}, "differ by as much"),
        ({"command_timeout_s": 0.0}, "command_timeout_s = 0.0"),
        ({"heartbeat_timeout_s": 11.0}, "heartbeat_timeout_s = 11.0"),
        ({"arming_timeout_s": math.nan}, "arming_timeout_s = nan"),
    ],
)
def test_limits_that_protect_nothing_are_refused(bad: dict[str, float], complaint: str) -> None:
    with pytest.raises(LimitsError, match=complaint):
        BoardLimits(**({"max_setpoint_Pa": 200e3, "over_pressure_Pa": 250e3} | bad))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "edge",
    [
        {"over_pressure_Pa": 809.1e3},
        {"max_setpoint_Pa": 100.0, "over_pressure_Pa": 200.0},
        {"command_timeout_s": 0.001, "heartbeat_timeout_s": 0.001, "arming_timeout_s": 0.001},
        {"command_timeout_s": 10.0, "heartbeat_timeout_s": 10.0, "arming_timeout_s": 10.0},
    ],
)
def test_limits_at_their_edges_are_taken(edge: dict[str, float]) -> None:
    BoardLimits(**({"max_setpoint_Pa": 99e3, "over_pressure_Pa": 250e3} | edge))  # type: ignore[arg-type]


def test_pressures_saturate_at_32_bits_and_what_is_not_finite_has_a_count_of_its_own() -> None:
    assert measured_hPa(1e300) == (1 << 31) - 1
    assert measured_hPa(-1e300) == -((1 << 31) - 1)
    assert measured_hPa(math.nan) == SENSOR_INVALID_hPa == -(1 << 31)


def test_limits_are_rounded_to_the_strict_side() -> None:
    limits = BoardLimits(199.99e3, 250.09e3, 0.0999999999999, 0.2004, 0.3)
    assert (limits.max_setpoint_hPa, limits.over_pressure_hPa) == (1999, 2500)
    assert (limits.command_timeout_ms, limits.heartbeat_timeout_ms, limits.arming_timeout_ms) == (100, 200, 300)
    longest = BoardLimits(200e3, 250e3, 10.0, 9.0, 8.0)
    assert (longest.command_timeout_ms, longest.heartbeat_timeout_ms, longest.arming_timeout_ms) == (10000, 9000, 8000)


@given(st.one_of(st.floats(allow_nan=True), st.integers(-1000, 6_000_000).map(lambda each: each / 16)))
@settings(deadline=None, max_examples=300)
def test_a_measured_pressure_is_above_a_limit_in_counts_exactly_if_it_is_in_pascal(pressure_Pa: float) -> None:
    counts = measured_hPa(pressure_Pa)
    assert -(1 << 31) <= counts < 1 << 31
    for limit_hPa in (1, 2, 2000, 2500):
        assert (counts > limit_hPa) == (math.isfinite(pressure_Pa) and pressure_Pa > 100.0 * limit_hPa)
    assert (counts == SENSOR_INVALID_hPa) == (not math.isfinite(pressure_Pa))


@pytest.mark.parametrize("seed", [1, 65535])
def test_challenges_follow_from_their_seed(seed: int) -> None:
    rules = BoardRules(BoardLimits(200e3, 250e3), challenge_seed=seed)
    assert rules.state.challenge_seed == seed
    assert rules.state.challenge == 0
    assert BoardRules(BoardLimits(200e3, 250e3)).state.challenge_seed == 1


@pytest.mark.parametrize("seed", [0, 65536])
def test_a_challenge_seed_that_does_not_fit_is_refused(seed: int) -> None:
    with pytest.raises(LimitsError, match="challenge_seed"):
        BoardRules(BoardLimits(200e3, 250e3), challenge_seed=seed)
