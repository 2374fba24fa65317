"""Filling times agree with closed forms and with the gas balance, and the board's timeouts beat them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from firmware_protocol.board import BoardLimits
from firmware_protocol.spec import message_spec
from softbot.errors import InputError
from softbot.faults import CHAMBER_COUNT, PneumaticConditions
from softbot.filling import (
    fill_rate_Pa_s,
    fill_time_s,
    filling_table,
    pressure_after_Pa,
    smallest_volume_m3,
)
from softbot.pneumatics import PneumaticsParameters, initial_state, step_in_place
from softbot.robot import load_robot

BOARD_CYCLE_S = 0.01
VALVE_CLOSED_LAGS = 3.0


def test_choked_filling_is_a_straight_line() -> None:
    pneumatics = PneumaticsParameters(supply_pressure_Pa=900e3, critical_ratio=0.5, temperature_K=293.15)
    # q = C rho0 p1, as long as p2 <= b p1
    rate_Pa_s = 287.05 * 293.15 * 9e-10 * 1.185 * (900e3 + 101325.0) / 40e-6
    assert fill_rate_Pa_s(pneumatics, 40e-6, 300e3, exponent=1.0) == pytest.approx(rate_Pa_s, rel=1e-12)
    assert fill_time_s(pneumatics, 40e-6, 0.0, 350e3, exponent=1.0) == pytest.approx(350e3 / rate_Pa_s, rel=1e-9)
    assert fill_time_s(pneumatics, 40e-6, 0.0, 350e3) == pytest.approx(350e3 / rate_Pa_s / 1.4, rel=1e-9)


def test_time_and_pressure_are_inverse() -> None:
    pneumatics = PneumaticsParameters()
    for to_Pa in (20e3, 150e3, 240e3):
        duration_s = fill_time_s(pneumatics, 45e-6, 10e3, to_Pa)
        assert pressure_after_Pa(pneumatics, 45e-6, 10e3, duration_s) == pytest.approx(to_Pa, rel=1e-4)


def test_the_gas_balance_fills_no_faster_than_the_isothermal_bound() -> None:
    pneumatics = PneumaticsParameters(valve_lag_s=0.0)
    volumes_m3 = np.full(CHAMBER_COUNT, 41e-6)
    state = initial_state(pneumatics, volumes_m3)
    pressure_Pa = np.zeros(5)
    opening = np.array([1.0, 0.0, 0.0, 0.0])
    step_s, steps = 1e-4, 0
    while pressure_Pa[0] < 150e3:
        conditions = PneumaticConditions().packed
        assert (
            step_in_place(state, pressure_Pa, opening, True, volumes_m3, step_s, conditions, pneumatics.as_arrays())
            == 0
        )
        steps += 1
    bound_s = fill_time_s(pneumatics, 43e-6, 0.0, 150e3, exponent=1.0)
    assert bound_s <= steps * step_s + step_s
    assert steps * step_s < 1.25 * bound_s  # the manifold sags a little; else it is the same law


def test_what_cannot_be_filled_is_said() -> None:
    pneumatics = PneumaticsParameters()
    assert fill_time_s(pneumatics, 45e-6, 0.0, 250e3) == math.inf
    for volume_m3, to_Pa in ((45e-6, -1.0), (0.0, 1e3), (math.nan, 1e3)):
        with pytest.raises(InputError, match="filling"):
            fill_time_s(pneumatics, volume_m3, 0.0, to_Pa)


def test_the_command_timeout_vents_before_a_blind_chamber_reaches_the_limit() -> None:
    robot = load_robot("default")
    limits = BoardLimits(robot.max_pressure_Pa, robot.pneumatics.max_chamber_pressure_Pa)
    reaction_s = limits.command_timeout_s + BOARD_CYCLE_S + VALVE_CLOSED_LAGS * robot.pneumatics.valve_lag_s
    volume_m3 = smallest_volume_m3(robot)
    assert reaction_s < fill_time_s(robot.pneumatics, volume_m3, 0.0, limits.over_pressure_Pa)
    # and the next round number would not
    assert reaction_s + 0.05 > fill_time_s(robot.pneumatics, volume_m3, 0.0, limits.over_pressure_Pa)


def test_the_heartbeat_timeout_is_twice_that_and_outlasts_what_the_protection_tolerates() -> None:
    limits = BoardLimits(100e3, 150e3)
    assert limits.heartbeat_timeout_s == 2 * limits.command_timeout_s
    cycle_s = message_spec("SequencerHeartbeat").cycle_s
    assert cycle_s is not None
    assert limits.heartbeat_timeout_s >= (limits.reception.max_counter_delta + 1) * cycle_s


def test_the_page_shows_the_table_of_the_shipped_robot() -> None:
    page = (Path(__file__).parents[2] / "docs" / "safety.md").read_text(encoding="utf-8")
    assert filling_table(load_robot("default")) in page
