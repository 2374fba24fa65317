"""The account of the gas in each chamber: right where a sensor lies, and no hindrance where none does."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.chamber_observer import HOLE, INLET, OUTLET
from controllers.detector_parts import detector_memory, parts_of_detector
from controllers.fault_window import KEPT
from controllers.gas_ledger import BELIEVES_LESS, FULL, keep_ledger, ledger_memory, vent_full
from softbot.faults import KIND_CODES, Fault, FaultKind, PneumaticConditions
from softbot.pneumatics import PneumaticsParameters, initial_state, pressures, step
from softbot.sensing import READINGS, SensorParameters

GAS = PneumaticsParameters()
VOLUME_m3 = 50e-6
PERIOD_s = 0.01
LIMIT_Pa = 120e3


class Account:
    """A ledger beside a plant of rigid chambers, told what a detector would tell it."""

    def __init__(self, start_Pa: float = 0.0) -> None:
        self.parts = parts_of_detector(GAS, SensorParameters())
        self.memory = detector_memory()
        self.ledger = ledger_memory()
        self._state = initial_state(GAS, [VOLUME_m3] * 4, [start_Pa] * 4)
        self._reading = np.zeros(1, READINGS).view(np.recarray)
        self._t_s = 0.0
        self.read(self.pressure_Pa[:4], self.pressure_Pa[4], np.zeros(4), 0.0)

    @property
    def pressure_Pa(self) -> np.ndarray:
        return pressures(self._state, [VOLUME_m3] * 4, GAS)

    @property
    def account_Pa(self) -> np.ndarray:
        return self.ledger[0]["pressure_Pa"] - GAS.atmospheric_pressure_absolute_Pa

    def read(self, shown_Pa: np.ndarray, supply_Pa: float, mean_opening: np.ndarray, step_s: float) -> None:
        own, window = self.memory.own[0], self.memory.window[0]
        own["cycle"] += 1
        at = own["cycle"] % KEPT
        window["step_s"][at] = step_s
        window["supply"][at] = supply_Pa + GAS.atmospheric_pressure_absolute_Pa
        window["opening"][at] = mean_opening
        window["volume_m3"][at] = VOLUME_m3 + np.array(GAS.dead_volume_m3)
        window["swelling"][at] = 0.0
        window["x"][at, :, INLET] = window["x"][at, :, OUTLET] = 1.0
        window["x"][at, :, HOLE] = 0.0
        own["last_t_s"] = self._reading[0]["t_s"] = self._t_s
        self._reading[0]["pressure_Pa"] = shown_Pa
        keep_ledger(self.parts, self.memory, self.ledger[0], self._reading[0])

    def move(self, command: float, cycles: int, shows: float = 1.0) -> None:
        """Command all valves, with sensors that show a share of the pressure."""
        for _ in range(cycles):
            supply_Pa, before = self.pressure_Pa[4], self._state[:4].copy()
            self._state, _ = step(
                self._state, [command] * 4, True, [VOLUME_m3] * 4, PERIOD_s, PneumaticConditions(), GAS
            )
            self._t_s += PERIOD_s
            kept = math.exp(-PERIOD_s / GAS.valve_lag_s)
            mean = command + (before - command) * (GAS.valve_lag_s / PERIOD_s) * (1.0 - kept)
            self.read(shows * self.pressure_Pa[:4], supply_Pa, 0.5 * (mean + self._state[:4]), PERIOD_s)


def suspect(account: Account) -> None:
    account.memory.own[0]["alarm"] = 0


def test_what_went_in_is_known_though_the_sensors_show_half():
    account = Account(40e3)
    suspect(account)
    account.move(1.0, 18, shows=0.5)
    assert account.pressure_Pa[:4].min() > 110e3
    np.testing.assert_allclose(account.account_Pa, account.pressure_Pa[:4], rtol=0.04)
    setpoint = np.full(4, 90e3)
    vent_full(account.parts, account.ledger[0], LIMIT_Pa, setpoint)
    assert np.all((setpoint == 0.0) == (account.account_Pa > FULL * LIMIT_Pa))


def test_venting_settles_the_account():
    account = Account(40e3)
    suspect(account)
    account.move(1.0, 18, shows=0.5)
    account.move(-1.0, 150, shows=0.5)
    np.testing.assert_allclose(account.account_Pa, 0.0, atol=500.0)
    setpoint = np.full(4, 90e3)
    vent_full(account.parts, account.ledger[0], LIMIT_Pa, setpoint)
    np.testing.assert_array_equal(setpoint, 90e3)


def test_a_reading_above_the_account_is_believed_soon_and_one_below_it_slowly():
    account = Account(60e3)
    account.move(0.0, 10, shows=1.5)
    np.testing.assert_allclose(account.account_Pa, 90e3, rtol=0.03)
    account.move(0.0, 10, shows=0.5)
    assert account.account_Pa.min() > 30e3 + (1.0 - BELIEVES_LESS) ** 10 * 55e3
    account.move(0.0, 600, shows=0.5)
    np.testing.assert_allclose(account.account_Pa, 30e3, rtol=0.01)


@pytest.mark.parametrize("what", ["suspected", "ballooning"])
def test_a_reading_below_the_account_of_a_doubtful_chamber_is_not_believed(what):
    account = Account(80e3)
    if what == "suspected":
        suspect(account)
    else:
        account.memory.own[0]["named"] = KIND_CODES[FaultKind.BALLOONING]
    account.move(0.0, 500, shows=0.5)
    np.testing.assert_allclose(account.account_Pa, 80e3, rtol=0.01)


def test_readings_that_the_detector_skipped_change_no_account():
    account = Account(50e3)
    account.move(0.0, 3)
    before = account.account_Pa.copy()
    account._reading[0]["t_s"] += PERIOD_s
    account._reading[0]["pressure_Pa"] = math.nan
    keep_ledger(account.parts, account.memory, account.ledger[0], account._reading[0])
    np.testing.assert_array_equal(account.account_Pa, before)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_no_chamber_of_a_healthy_robot_with_other_valves_is_taken_for_full(closed_loop, with_other_valves, seed):
    answered, silent = (
        closed_loop(6.0, speed_rev_s=None, seed=seed, real=with_other_valves(seed), detection=detection)
        for detection in (True, False)
    )
    assert answered.detections == []
    np.testing.assert_array_equal(answered.setpoint_Pa, silent.setpoint_Pa)  # `detection` off: nothing is held back


@pytest.mark.parametrize("chamber", [0, 2])
@pytest.mark.parametrize("t_s", [3.0, 3.4, 3.8, 4.2])
def test_a_sensor_that_shows_half_brings_no_chamber_over_its_limit(closed_loop, robot, chamber, t_s):
    fault = Fault(t_s, chamber, "sensor_scale")
    run = closed_loop(t_s + 2.0, faults=(fault,), speed_rev_s=0.4)
    assert np.array(run.pressure_Pa)[:, :4].max() < robot.pneumatics.max_chamber_pressure_Pa
    unanswered = closed_loop(t_s + 2.0, faults=(fault,), speed_rev_s=0.4, detection=False)
    assert np.array(unanswered.pressure_Pa)[:, :4].max() > robot.pneumatics.max_chamber_pressure_Pa
