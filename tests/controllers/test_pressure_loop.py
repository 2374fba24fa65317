"""The pressure loop on the real (nonlinear) pneumatics, and its margins against independent reckoning."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from controllers import pressure_loop
from controllers.pressure_loop import PressureLoop, PressureLoopGains
from controllers.pressure_loop_design import analyse_pressure_loop, design_pressure_loop
from controllers.proof import FILLED_WITHIN, NEAR, TEST_SHARE, VENTED_WITHIN
from controllers.robot_model import USE_OF_LIMIT, pressure_lag_s
from softbot.errors import InputError
from softbot.faults import Fault, FaultKind, PneumaticConditions
from softbot.nodes.valve_loop import nominal_volumes_m3
from softbot.plant_conditions import PlantConditions
from softbot.pneumatics import PneumaticsParameters, initial_state, step_in_place
from softbot.robot import robot_from

SAMPLE_s = 5e-3
PLANT_STEP_s = 1e-3
VOLUME_m3 = 4e-4 * 0.134
PARAMETERS = PneumaticsParameters()


@pytest.fixture(scope="module")
def design():
    return design_pressure_loop(PARAMETERS, VOLUME_m3, SAMPLE_s)


@dataclasses.dataclass
class Run:
    t_s: np.ndarray
    pressure_Pa: np.ndarray  # [n, 4] true gauge pressures at every plant step
    opening: np.ndarray  # [n, 4] openings commanded
    loop: PressureLoop


def simulate(
    gains,
    setpoint_Pa,
    duration_s,
    *,
    start_Pa=(0.0, 0.0, 0.0, 0.0),
    conditions_at=lambda t_s: PneumaticConditions(),
    noise_Pa=0.0,
    growth=0.0,
    volume_ratio=1.0,
    parameters=PARAMETERS,
    volume_m3=VOLUME_m3,
):
    """The loop on the twin's pneumatics; what a sample asks for reaches the valves one sample later."""
    rest_m3 = np.full(4, volume_m3 * volume_ratio)
    packed = parameters.as_arrays()
    state = initial_state(parameters, rest_m3 * (1 + growth * np.array(start_Pa) / 100e3), start_Pa)
    pressure_Pa = np.append(np.array(start_Pa, dtype=float), parameters.supply_pressure_Pa)
    loop = PressureLoop(gains, parameters, volume_m3)
    loop.reset(start_Pa)
    random = np.random.default_rng(0)
    applied = np.zeros(4)
    t, p, u = [], [], []
    for k in range(round(duration_s / gains.sample_s)):
        t_s = k * gains.sample_s
        measured = pressure_Pa[:4] + noise_Pa * random.standard_normal(4)
        wanted = loop.step(setpoint_Pa(t_s), measured, pressure_Pa[4])
        conditions = conditions_at(t_s).packed
        for j in range(round(gains.sample_s / PLANT_STEP_s)):
            volume = rest_m3 * (1 + growth * pressure_Pa[:4] / 100e3)
            assert not step_in_place(state, pressure_Pa, applied, True, volume, PLANT_STEP_s, conditions, packed)
            t.append(t_s + (j + 1) * PLANT_STEP_s)
            p.append(pressure_Pa[:4].copy())
            u.append(applied)
        applied = wanted
    return Run(np.array(t), np.array(p), np.array(u), loop)


def constant(*setpoint_Pa):
    return lambda t_s: np.array(setpoint_Pa)


def settling_s(t_s, pressure_Pa, target_Pa, within_Pa):
    outside = np.nonzero(np.abs(pressure_Pa - target_Pa) > within_Pa)[0]
    return t_s[outside[-1]] if outside.size else 0.0


# ---------------------------------------------------------------------------------------------- the design


def test_every_operating_point_keeps_the_margins_asked_for(design):
    assert design.stable
    assert design.gain_margin_dB >= 8
    assert design.phase_margin_deg >= 55
    assert {point.opening for point in design.points} == {-0.5, 0.0, 0.5}
    assert design.worst.phase_margin_deg == design.phase_margin_deg
    assert design.bandwidth_rad_s > 15


def test_margins_agree_with_the_frequency_response_written_out(design):
    """Holding a pressure the plant is an integrator behind lag and delay: exact zero-order-hold response by
    hand."""
    gains, T, tau = design.gains, SAMPLE_s, PARAMETERS.valve_lag_s
    omega = np.geomspace(0.1, math.pi / T, 400_000)
    z = np.exp(1j * omega * T)
    a = math.exp(-T / tau)
    # 1/(s (tau s + 1)) = 1/s - tau/(tau s + 1), each sampled behind a hold
    plant = T / (z - 1) - tau * (1 - a) / (z - a)
    law = gains.proportional_1_s + gains.integral_1_s2 * T * z / (z - 1)
    for point in (point for point in design.points if point.opening == 0):
        response = law * plant / z / point.volume_ratio
        phase = np.unwrap(np.angle(response))
        crossover = np.argmin(np.abs(np.abs(response) - 1))
        assert point.phase_margin_deg == pytest.approx(180 + math.degrees(phase[crossover]), abs=0.1)
        assert point.crossover_rad_s == pytest.approx(omega[crossover], rel=1e-3)
        turn = np.argmin(np.abs(phase + math.pi))
        assert point.gain_margin_dB == pytest.approx(-20 * math.log10(abs(response[turn])), abs=0.1)
        closed = np.abs(response / (1 + response))
        bandwidth = omega[np.argmax(closed < math.sqrt(0.5))]
        assert point.bandwidth_rad_s == pytest.approx(bandwidth, rel=0.02)


def test_gain_margin_is_where_the_real_loop_starts_to_swing(design):
    """The linear margin against the nonlinear plant: gains a sixth below it decay, a sixth above it do
    not."""
    point = next(p for p in design.points if p.opening == 0 and p.volume_ratio == 1.0)
    swings = []
    for share in (1 / 1.15, 1.15):
        factor = 10 ** (point.gain_margin_dB / 20) * share
        gains = dataclasses.replace(
            design.gains,
            proportional_1_s=design.gains.proportional_1_s * factor,
            integral_1_s2=design.gains.integral_1_s2 * factor,
            dead_zone_opening=0.0,
            dead_zone_Pa=0.0,
        )
        run = simulate(gains, constant(*[60.2e3] * 4), 1.5, start_Pa=(60e3,) * 4)
        swings.append(np.ptp(run.pressure_Pa[run.t_s > 1.2, 0]))
    assert swings[0] < 20 < 1000 < swings[1]


@pytest.mark.parametrize(
    ("lag_s", "volume_m3", "sample_s"),
    [(0.2, 20e-6, 10e-3), (0.04, 10e-6, 10e-3), (0.01, 6e-6, 10e-3), (0.1, 60e-6, 1e-3)],
)
def test_valves_too_slow_or_large_for_their_chambers_are_moved_slowly(lag_s, volume_m3, sample_s):
    parameters = dataclasses.replace(PARAMETERS, valve_lag_s=lag_s)
    found = design_pressure_loop(parameters, volume_m3, sample_s)
    assert found.stable
    assert found.gain_margin_dB >= 8
    assert found.phase_margin_deg >= 55
    assert found.gains.setpoint_rate_Pa_s < 600e3
    duration_s = 100e3 / found.gains.setpoint_rate_Pa_s + 20.0 * (lag_s + sample_s)

    def up_and_down(t_s):
        return np.full(4, 80e3 if t_s < duration_s else 5e3)

    run = simulate(found.gains, up_and_down, 2.0 * duration_s, parameters=parameters, volume_m3=volume_m3)
    up, down = run.pressure_Pa[run.t_s < duration_s, 0], run.pressure_Pa[run.t_s > duration_s, 0]
    assert up.max() < 1.05 * 80e3
    assert down.min() > 1e3
    assert up[-1] == pytest.approx(80e3, abs=1e3)
    assert down[-1] == pytest.approx(5e3, abs=1e3)


@pytest.mark.parametrize(("radius_m", "lag_s"), [(8e-3, 0.01), (12e-3, 0.2)])
def test_a_sound_chamber_passes_its_proof_where_setpoints_move_slowly(radius_m, lag_s):
    table = {"length_m": 0.15, "radius_m": radius_m, "material": "Dragon Skin 30", "pneumatics": {"valve_lag_s": lag_s}}
    robot = robot_from(table, "small.toml")
    volume_m3 = float(nominal_volumes_m3(robot).mean())
    gains = design_pressure_loop(robot.pneumatics, volume_m3, 10e-3).gains
    working_Pa = USE_OF_LIMIT * robot.max_pressure_Pa
    test_Pa = TEST_SHARE * robot.max_pressure_Pa
    up, down = (
        simulate(
            gains,
            constant(*[to_Pa] * 4),
            10.0,
            start_Pa=(from_Pa,) * 4,
            parameters=robot.pneumatics,
            volume_m3=volume_m3,
        )
        for from_Pa, to_Pa in ((0.0, test_Pa), (test_Pa, 0.0))
    )
    filled_s = settling_s(up.t_s, up.pressure_Pa[:, 0], test_Pa, NEAR * test_Pa)
    vented_s = settling_s(down.t_s, down.pressure_Pa[:, 0], 0.0, NEAR * test_Pa)
    known_s = pressure_lag_s(robot, working_Pa, gains.setpoint_rate_Pa_s)
    assert filled_s < FILLED_WITHIN * known_s
    assert vented_s < VENTED_WITHIN * known_s
    assert filled_s > FILLED_WITHIN * pressure_lag_s(robot, working_Pa)  # as if its setpoint stepped


def test_slower_sampling_costs_bandwidth_and_not_margin(design):
    slow = design_pressure_loop(PARAMETERS, VOLUME_m3, 20e-3)
    assert slow.gains.proportional_1_s < 0.6 * design.gains.proportional_1_s
    assert slow.bandwidth_rad_s < design.bandwidth_rad_s
    assert slow.phase_margin_deg >= 55
    assert slow.gain_margin_dB >= 8


def test_gains_that_are_too_high_are_seen_to_be_unstable(design):
    wild = dataclasses.replace(design.gains, proportional_1_s=10 * design.gains.proportional_1_s)
    analysis = analyse_pressure_loop(PARAMETERS, VOLUME_m3, wild, pressures_Pa=(50e3,), openings=(0.0,))
    assert not analysis.stable


def test_proportional_loop_alone_can_be_designed():
    assert design_pressure_loop(PARAMETERS, VOLUME_m3, SAMPLE_s, integral_ratio=0.0).gains.integral_1_s2 == 0


def test_unlike_chambers_are_each_analysed(design):
    volumes = VOLUME_m3 * np.array([1.0, 1.0, 1.0, 0.5])
    both = analyse_pressure_loop(PARAMETERS, volumes, design.gains, pressures_Pa=(50e3,), openings=(0.5,))
    alike = analyse_pressure_loop(PARAMETERS, VOLUME_m3, design.gains, pressures_Pa=(50e3,), openings=(0.5,))
    assert len(both.points) == 2 * len(alike.points)


def test_table_shows_every_operating_point_and_marks_the_worst(design):
    lines = design.table().splitlines()
    assert len(lines) == 2 + len(design.points)
    assert sum(line.endswith("worst") for line in lines) == 1
    assert f"{design.phase_margin_deg:.1f}" in next(line for line in lines if line.endswith("worst"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"sample_s": 0.0}, r"sample_s = 0\.0"),
        ({"phase_margin_deg": 120.0}, r"phase_margin_deg = 120\.0"),
        ({"gain_margin_dB": -1.0}, r"gain_margin_dB = -1\.0"),
        ({"integral_ratio": 1.0}, r"integral_ratio = 1\.0"),
        ({"chamber_volume_m3": -1e-6}, "chamber_volume_m3"),
        ({"chamber_volume_m3": (1e-6, 1e-6)}, "chamber_volume_m3"),
        ({"phase_margin_deg": 88.0}, "no pressure loop keeps 88 deg"),
    ],
)
def test_design_that_makes_no_sense_is_refused_by_name(arguments, message):
    given = {"parameters": PARAMETERS, "chamber_volume_m3": VOLUME_m3, "sample_s": SAMPLE_s} | arguments
    with pytest.raises(InputError, match=message):
        design_pressure_loop(**given)


def test_operating_pressure_above_the_supply_is_refused(design):
    with pytest.raises(InputError, match="operating pressure"):
        analyse_pressure_loop(PARAMETERS, VOLUME_m3, design.gains, pressures_Pa=(300e3,))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"proportional_1_s": 0.0}, r"pressure_loop\.proportional_1_s = 0\.0"),
        ({"integral_1_s2": -1.0}, r"pressure_loop\.integral_1_s2 = -1\.0"),
        ({"sample_s": math.nan}, r"pressure_loop\.sample_s = nan"),
        ({"dead_zone_opening": 1.0}, r"pressure_loop\.dead_zone_opening = 1\.0"),
    ],
)
def test_gain_out_of_range_is_refused_by_name(change, message):
    with pytest.raises(InputError, match=message):
        PressureLoopGains(**{"proportional_1_s": 20.0, "integral_1_s2": 20.0, "sample_s": 5e-3} | change)


# ---------------------------------------------------------------------------------------------- closed loop


def test_step_to_working_pressure_is_fast_and_does_not_overshoot_and_rests(design):
    run = simulate(design.gains, constant(100e3, 50e3, 20e3, 140e3), 2.5)
    for i, target_Pa in enumerate((100e3, 50e3, 20e3, 140e3)):
        assert settling_s(run.t_s, run.pressure_Pa[:, i], target_Pa, 0.02 * target_Pa) < 0.35
        assert run.pressure_Pa[:, i].max() < 1.05 * target_Pa
    late = run.t_s > 0.75
    assert np.ptp(run.pressure_Pa[late], axis=0).max() < 500
    assert np.all(run.opening[run.t_s > 2.0] == 0)  # at rest the valves are shut


def test_vent_goes_to_atmosphere_and_stays_open_to_it(design):
    run = simulate(design.gains, constant(0.0, 0.0, 0.0, 40e3), 1.0, start_Pa=(100e3, 20e3, 140e3, 100e3))
    assert settling_s(run.t_s, run.pressure_Pa[:, 0], 0.0, 5e3) < 0.45
    assert run.pressure_Pa[:, :3].min() > -1
    assert run.pressure_Pa[-1, :3].max() < 100
    np.testing.assert_array_equal(run.opening[-1, :3], -1)
    assert settling_s(run.t_s, run.pressure_Pa[:, 3], 40e3, 1e3) < 0.35
    assert run.pressure_Pa[:, 3].min() > 40e3 - 0.05 * 60e3


@pytest.mark.parametrize(("start_Pa", "target_Pa"), [(10e3, 30e3), (60e3, 80e3), (120e3, 140e3)])
def test_one_design_moves_alike_at_every_pressure_up_and_down(design, start_Pa, target_Pa):
    up = simulate(design.gains, constant(*[target_Pa] * 4), 0.6, start_Pa=(start_Pa,) * 4)
    down = simulate(design.gains, constant(*[start_Pa] * 4), 0.6, start_Pa=(target_Pa,) * 4)
    step_Pa = target_Pa - start_Pa
    for run, end_Pa in ((up, target_Pa), (down, start_Pa)):
        assert settling_s(run.t_s, run.pressure_Pa[:, 0], end_Pa, 0.05 * step_Pa) < 0.25
        beyond = (run.pressure_Pa[:, 0] - end_Pa) * math.copysign(1, end_Pa - run.pressure_Pa[0, 0])
        assert beyond.max() < 0.05 * step_Pa


def test_chamber_that_grows_with_its_pressure_still_settles(design):
    run = simulate(design.gains, constant(*[80e3] * 4), 1.0, growth=0.3)
    assert settling_s(run.t_s, run.pressure_Pa[:, 0], 80e3, 0.03 * 80e3) < 0.5
    assert run.pressure_Pa[:, 0].max() < 1.05 * 80e3


def test_long_saturation_leaves_no_windup(design):
    """Three seconds behind a blocked inlet, then free: the rise looks like one that was never blocked."""
    blocked = PlantConditions([Fault(0.0, i, FaultKind.BLOCKED_INLET) for i in range(4)])
    blocked.advance(0.0)
    healthy = PneumaticConditions()
    run = simulate(
        design.gains,
        constant(*[100e3] * 4),
        4.0,
        conditions_at=lambda t_s: blocked.pneumatic if t_s < 3 else healthy,
    )
    assert abs(run.pressure_Pa[run.t_s < 3, 0]).max() < 1
    after = run.t_s > 3
    assert settling_s(run.t_s[after] - 3, run.pressure_Pa[after, 0], 100e3, 2e3) < 0.35
    assert run.pressure_Pa[:, 0].max() < 1.05 * 100e3


def test_leak_is_held_by_the_integral(design):
    leaking = PlantConditions([Fault(0.0, 1, FaultKind.LEAK, 0.3)])
    leaking.advance(0.0)
    run = simulate(design.gains, constant(*[80e3] * 4), 3.0, conditions_at=lambda t_s: leaking.pneumatic)
    assert run.pressure_Pa[-1, 1] == pytest.approx(80e3, abs=500)
    assert run.opening[-1, 1] > 0.1
    assert run.loop.integral_Pa_s[1] > 10 * abs(run.loop.integral_Pa_s[0])


def test_sensor_noise_does_not_make_a_resting_valve_chatter(design):
    quiet = simulate(design.gains, constant(*[60e3] * 4), 2.0, start_Pa=(60e3,) * 4, noise_Pa=20)
    assert np.mean(quiet.opening != 0) < 0.02
    without = dataclasses.replace(design.gains, dead_zone_opening=0.0, dead_zone_Pa=0.0)
    nervous = simulate(without, constant(*[60e3] * 4), 2.0, start_Pa=(60e3,) * 4, noise_Pa=20)
    assert np.mean(nervous.opening != 0) > 0.9


# ---------------------------------------------------------------------------------------------- the law


def test_setpoint_is_clamped_and_moves_at_its_limited_rate(design):
    loop = PressureLoop(design.gains, PARAMETERS, VOLUME_m3)
    reach_Pa = design.gains.setpoint_rate_Pa_s * SAMPLE_s
    seen = []
    for _ in range(200):
        loop.step([1e6, 100e3, reach_Pa / 2, -50e3], np.zeros(4), 250e3)
        seen.append(loop.reference_Pa.copy())
    assert np.diff(np.array(seen), axis=0).max() <= reach_Pa * (1 + 1e-12)
    np.testing.assert_allclose(seen[0], [reach_Pa, reach_Pa, reach_Pa / 2, 0])
    np.testing.assert_allclose(seen[-1], [PARAMETERS.max_chamber_pressure_Pa, 100e3, reach_Pa / 2, 0])


def test_expected_pressure_follows_a_ramp_by_the_lag_of_the_plant(design):
    assert design.gains.model_lag_s == pytest.approx(PARAMETERS.valve_lag_s + 2 * SAMPLE_s)
    gains = dataclasses.replace(design.gains, setpoint_rate_Pa_s=100e3)
    loop = PressureLoop(gains, PARAMETERS, VOLUME_m3)
    for _ in range(120):
        loop.step([100e3] * 4, loop.model_Pa, 250e3)
    np.testing.assert_allclose(loop.reference_Pa - loop.model_Pa, 100e3 * gains.model_lag_s, rtol=1e-3)


def test_opening_fills_when_low_vents_when_high_and_never_exceeds_full(design):
    loop = PressureLoop(design.gains, PARAMETERS, VOLUME_m3)
    loop.reset([60e3] * 4)
    opening = loop.step([60e3] * 4, [0.0, 140e3, 55e3, 60.05e3], 250e3)
    np.testing.assert_array_equal(opening[:2], [1, -1])
    assert 0 < opening[2] < 1
    assert opening[3] == 0


def test_reading_that_is_not_a_number_vents_its_chamber_only(design):
    loop = PressureLoop(design.gains, PARAMETERS, VOLUME_m3)
    opening = loop.step([50e3, 50e3, math.nan, 50e3], [0, math.nan, 0, 0], 250e3)
    np.testing.assert_array_equal(opening[1:3], [-1, -1])
    assert opening[0] > 0
    assert opening[3] > 0
    np.testing.assert_array_equal(loop.step([50e3] * 4, [0] * 4, math.inf), [-1] * 4)


def test_reading_below_vacuum_vents_its_chamber_only(design):
    """A broken wire: without this the loop fills the chamber with all it has."""
    loop = PressureLoop(design.gains, PARAMETERS, VOLUME_m3)
    for _ in range(40):
        opening = loop.step([60e3] * 4, [20e3, -10e3, 20e3, 20e3], 250e3)
    assert opening[1] == -1.0
    assert min(opening[0], opening[2], opening[3]) > 0.5


@pytest.mark.parametrize(("wanted_Pa", "shown_Pa"), [(0.0, 40e3), (50e3, 51e3), (0.0, 1e3)])
def test_a_reference_on_its_way_down_fills_no_chamber_that_is_there_already(design, wanted_Pa, shown_Pa):
    loop = PressureLoop(design.gains, PARAMETERS, VOLUME_m3)
    loop.reset([100e3] * 4)
    for _ in range(10):
        opening = loop.step([wanted_Pa] * 4, [shown_Pa] * 4, 250e3)
        assert loop.reference_Pa[0] > shown_Pa
        assert opening.max() <= 0.0


def test_broken_readings_of_any_size_give_finite_openings(design):
    loop = PressureLoop(design.gains, PARAMETERS, VOLUME_m3)
    for reading in (-1e9, -101325.0, 0.0, 250e3, 1e9):
        for supply in (-1e9, 0.0, 250e3, 1e9):
            opening = loop.step([50e3] * 4, [reading] * 4, supply)
            assert np.all(np.abs(opening) <= 1)


def test_compiled_law_does_what_its_source_says(design):
    packed = pressure_loop.pack_pressure_loop(design.gains, PARAMETERS, VOLUME_m3)
    setpoint = np.array([80e3, 20e3, 0.0, 60e3])
    measured = np.array([70e3, 30e3, 100.0, math.nan])
    memories = [[np.full(4, 50e3), np.full(4, 50e3), np.zeros(4), np.empty(4)] for _ in range(2)]
    for _ in range(30):
        pressure_loop.pressure_loop_step(*memories[0], setpoint, measured, 240e3, packed)
        pressure_loop.pressure_loop_step.py_func(*memories[1], setpoint, measured, 240e3, packed)
    for compiled, source in zip(*memories, strict=True):
        np.testing.assert_allclose(compiled, source, rtol=1e-12)
    arguments = (1e-9, 0.3, 3e5, 2.999e5, 293.15)
    assert pressure_loop.flow_to_invert.py_func(*arguments) == pressure_loop.flow_to_invert(*arguments)


def test_wrong_shape_is_refused_by_name(design):
    loop = PressureLoop(design.gains, PARAMETERS, VOLUME_m3)
    with pytest.raises(InputError, match="setpoint_Pa has shape"):
        loop.step([1, 2, 3], [0] * 4, 250e3)
    with pytest.raises(InputError, match="measured_Pa has shape"):
        loop.step([0] * 4, 0.0, 250e3)
