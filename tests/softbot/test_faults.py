"""Faults say what they do, in order and repeatably, and refuse what they are not."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softbot.errors import InputError
from softbot.faults import (
    LEAK_CONDUCTANCE_RATIO,
    RUPTURE_CONDUCTANCE_RATIO,
    SHARED_KINDS,
    Fault,
    FaultKind,
    PneumaticConditions,
    SENSOR_DRIFT_Pa_s,
    SENSOR_FLOOR_Pa,
    SENSOR_OFFSET_Pa,
)
from softbot.plant_conditions import PlantConditions


@st.composite
def faults(draw: st.DrawFn) -> Fault:
    kind = draw(st.sampled_from(FaultKind))
    return Fault(
        t_s=draw(st.floats(0, 10)),
        chamber=None if kind in SHARED_KINDS else draw(st.integers(0, 3)),
        kind=kind,
        severity=draw(st.floats(0.01, 1)),
        ramp_s=draw(st.sampled_from([0.0, 0.5, 30.0])),
        period_s=draw(st.sampled_from([None, 0.3])),
        duty=draw(st.floats(0.1, 1)),
    )


def snapshot(conditions: PlantConditions) -> np.ndarray:
    return conditions.packed.copy()


def conditions_after(*listed: Fault, t_s: float = 100.0) -> PlantConditions:
    conditions = PlantConditions(listed)
    conditions.advance(t_s)
    return conditions


def test_healthy_plant_leaves_everything_as_it_is():
    conditions = PlantConditions()
    assert conditions.advance(1e9) == ()
    pneumatic = conditions.pneumatic
    assert np.all(pneumatic.leak_ratio == 0)
    assert np.all(pneumatic.inlet_factor == 1)
    assert np.all(pneumatic.exhaust_factor == 1)
    assert np.all(np.isnan(pneumatic.forced_opening))
    assert pneumatic.supply_factor == 1
    np.testing.assert_array_equal(conditions.sensor_reading_Pa([1, 2, 3, 4], [9, 9, 9, 9]), [1, 2, 3, 4])


@pytest.mark.parametrize(
    ("kind", "name", "healthy", "broken"),
    [
        ("rupture", "leak_ratio", 0.0, 0.5 * RUPTURE_CONDUCTANCE_RATIO),
        ("leak", "leak_ratio", 0.0, 0.5 * LEAK_CONDUCTANCE_RATIO),
        ("blocked_inlet", "inlet_factor", 1.0, 0.5),
        ("stuck_open", "forced_opening", math.nan, 0.5),
        ("stuck_closed", "forced_opening", math.nan, 0.0),
    ],
)
def test_pneumatic_fault_switches_its_own_condition_of_its_own_chamber_only(kind, name, healthy, broken):
    conditions = conditions_after(Fault(1.0, 2, kind, 0.5))
    expected = PneumaticConditions()
    getattr(expected, name)[2] = broken
    np.testing.assert_array_equal(conditions.pneumatic.packed, expected.packed)
    others = np.delete(getattr(conditions.pneumatic, name), 2)
    np.testing.assert_array_equal(others, [healthy] * 3)


def test_sensor_offset_and_stuck_sensor_change_readings_only():
    conditions = conditions_after(Fault(0.0, 0, FaultKind.SENSOR_OFFSET, 0.2), Fault(0.0, 3, FaultKind.SENSOR_STUCK))
    np.testing.assert_array_equal(conditions.pneumatic.packed, PneumaticConditions().packed)
    reading = conditions.sensor_reading_Pa([10e3, 20e3, 30e3, 40e3], [1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(reading, [10e3 + 0.2 * SENSOR_OFFSET_Pa, 20e3, 30e3, 4.0])


def test_fault_happens_at_its_time_and_is_told_once():
    early, late = Fault(1.0, 0, "leak"), Fault(2.0, 1, "rupture")
    conditions = PlantConditions([late, early])
    assert conditions.faults == (early, late)
    assert conditions.advance(0.999) == ()
    assert conditions.advance(1.0) == (early,)
    assert conditions.advance(1.5) == ()
    assert conditions.active == (early,)
    assert conditions.advance(5.0) == (late,)
    assert conditions.active == (early, late)


def test_faults_on_one_chamber_combine():
    conditions = conditions_after(
        Fault(0, 1, "leak", 0.3),
        Fault(0, 1, "rupture", 0.1),
        Fault(0, 1, "blocked_inlet", 0.5),
        Fault(0, 1, "blocked_inlet", 0.5),
        Fault(0, 1, "stuck_open", 1.0),
        Fault(1, 1, "stuck_closed", 1.0),
    )
    assert conditions.pneumatic.leak_ratio[1] == pytest.approx(0.3 * LEAK_CONDUCTANCE_RATIO + 1.0)
    assert conditions.pneumatic.inlet_factor[1] == 0.25
    assert conditions.pneumatic.forced_opening[1] == 0.0


@settings(deadline=None, max_examples=50)
@given(st.lists(faults(), max_size=6), st.lists(st.floats(0, 12), max_size=6))
def test_conditions_depend_on_the_time_and_not_on_the_steps_taken_to_it(listed, times):
    stepped, leapt = PlantConditions(listed), PlantConditions(listed)
    told = [fault for t_s in [*sorted(times), 12.0] for fault in stepped.advance(t_s)]
    leapt.advance(12.0)
    np.testing.assert_array_equal(snapshot(stepped), snapshot(leapt))
    assert tuple(told) == stepped.faults


def test_time_does_not_run_backwards():
    conditions = PlantConditions()
    conditions.advance(2.0)
    with pytest.raises(InputError, match=r"t_s = 1\.0: time must not run backwards"):
        conditions.advance(1.0)
    with pytest.raises(InputError, match="t_s = nan"):
        conditions.advance(math.nan)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"t_s": -1.0}, r"fault\.t_s = -1\.0"),
        ({"t_s": math.inf}, r"fault\.t_s = inf"),
        ({"t_s": "1"}, r"fault\.t_s = '1'"),
        ({"chamber": 4}, r"fault\.chamber = 4"),
        ({"chamber": -1}, r"fault\.chamber = -1"),
        ({"chamber": 1.0}, r"fault\.chamber = 1\.0"),
        ({"chamber": True}, r"fault\.chamber = True"),
        ({"kind": "explosion"}, r"fault\.kind = 'explosion': must be one of rupture, leak, blocked_inlet"),
        ({"severity": 0.0}, r"fault\.severity = 0\.0"),
        ({"severity": 1.5}, r"fault\.severity = 1\.5"),
        ({"severity": math.nan}, r"fault\.severity = nan"),
        ({"kind": None}, r"fault\.kind: missing; must be one of rupture, leak"),
        ({"chamber": None}, r"fault\.chamber: missing; leak is one chamber's"),
        ({"kind": "supply_loss"}, r"fault\.chamber = 0: supply_loss concerns all chambers; leave chamber out"),
        ({"ramp_s": -1.0}, r"fault\.ramp_s = -1\.0"),
        ({"ramp_s": math.inf}, r"fault\.ramp_s = inf"),
        ({"period_s": 0.0}, r"fault\.period_s = 0\.0"),
        ({"duty": 0.0}, r"fault\.duty = 0\.0"),
        ({"duty": 1.5}, r"fault\.duty = 1\.5"),
    ],
)
def test_fault_out_of_range_is_refused_by_name(change, message):
    with pytest.raises(InputError, match=message):
        Fault(**{"t_s": 1.0, "chamber": 0, "kind": "leak", "severity": 1.0} | change)


def test_a_fault_grows_over_its_ramp_and_stays():
    slow = Fault(2.0, 1, "leak", 0.8, ramp_s=4.0)
    shares = [conditions_after(slow, t_s=t_s).pneumatic.leak_ratio[1] for t_s in (1.0, 2.0, 3.0, 6.0, 60.0)]
    np.testing.assert_allclose(shares, [0.0, 0.0, 0.2, 0.8, 0.8])


def test_an_intermittent_fault_comes_and_goes():
    loose = Fault(1.0, 2, "sensor_dropout", period_s=0.5, duty=0.2)
    readings = [
        conditions_after(loose, t_s=t_s).sensor_reading_Pa([0.0] * 4, [0.0] * 4)[2]
        for t_s in (0.9, 1.05, 1.15, 1.45, 1.55, 1.65)
    ]
    np.testing.assert_allclose(readings, [0.0, SENSOR_FLOOR_Pa, 0.0, 0.0, SENSOR_FLOOR_Pa, 0.0])


@pytest.mark.parametrize("kind", FaultKind)
def test_every_kind_changes_the_plant(kind):
    chamber = None if kind in SHARED_KINDS else 1
    broken = conditions_after(Fault(1.0, chamber, kind, 0.5), t_s=3.0)
    healthy = conditions_after(t_s=3.0)
    assert not np.array_equal(snapshot(broken), snapshot(healthy), equal_nan=True)


def test_swapped_lines_show_each_others_pressures():
    shown = conditions_after(Fault(0.0, 3, "lines_swapped")).sensor_reading_Pa([1e3, 2e3, 3e3, 4e3], [0.0] * 4)
    np.testing.assert_allclose(shown, [4e3, 2e3, 3e3, 1e3])


def test_a_drift_ends_at_its_limit():
    drift = Fault(10.0, 0, "sensor_drift", 0.5)
    shown = [conditions_after(drift, t_s=t_s).sensor_reading_Pa([0.0] * 4, [0.0] * 4)[0] for t_s in (20.0, 1e4)]
    np.testing.assert_allclose(shown, [0.5 * SENSOR_DRIFT_Pa_s * 10.0, SENSOR_OFFSET_Pa])


def test_supply_factor_stays_between_nothing_and_all():
    conditions = PneumaticConditions()
    conditions.set_supply_factor(0.25)
    assert conditions.supply_factor == 0.25
    with pytest.raises(InputError, match="supply_factor"):
        conditions.set_supply_factor(1.1)


def test_reading_a_fault_loads_no_compiler():
    code = "import sys, softbot.faults; sys.exit(bool({'numba', 'scipy', 'pybullet'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
