"""The rod twin against closed forms: kinematics, inertia, floating, rolling, resting, energy, stability."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.core.runtime import _nrt_python, rtsys
from numpy.typing import NDArray

from sim.body import Body, Twin, World
from sim.motion_rows import CURVATURE, ENERGY, WORK
from sim.rod import RodTwin
from sim.rod_drive import hold
from softbot.errors import InputError, SimulationError
from softbot.rolling import coulomb_advance_ratio, floating_ratio, viscous_advance_ratio

FloatArray = NDArray[np.float64]

LENGTH_M, RADIUS_M = 0.15, 0.01
BENDING_N_M2 = 3.93e-3
BODY = Body(
    length_m=LENGTH_M,
    radius_m=RADIUS_M,
    mass_kg=1100.0 * math.pi * RADIUS_M**2 * LENGTH_M,
    bending_stiffness_N_m2=BENDING_N_M2,
    twisting_stiffness_N_m2=BENDING_N_M2 * 2.0 / 3.0,
    axial_stiffness_N=4.0 * BENDING_N_M2 / RADIUS_M**2,
    damping_time_s=0.02,
)
FLOATING = World(gravity_m_s2=0.0, ground="none", friction=0.0, friction_law="coulomb")
FLOOR = World(gravity_m_s2=9.81, ground="plane", friction=0.6, friction_law="coulomb")
STRAIGHT = np.array([1.0, 0.0, 0.0])


def stiffer(factor: float) -> Body:
    return replace(
        BODY,
        bending_stiffness_N_m2=factor * BODY.bending_stiffness_N_m2,
        twisting_stiffness_N_m2=factor * BODY.twisting_stiffness_N_m2,
        axial_stiffness_N=factor * BODY.axial_stiffness_N,
    )


def rod(
    body: Body = BODY,
    world: World = FLOATING,
    *,
    modes: int = 3,
    contact_points: int = 16,
    step_s: float = 0.004,
    stretches: bool = False,
) -> RodTwin:
    return RodTwin(body, world, modes=modes, contact_points=contact_points, step_s=step_s, stretches=stretches)


@dataclass
class Roll:
    revolutions: float
    displacement_m: FloatArray
    plane_rotation_rad: float
    turned_rad: float
    angular_momentum_max_kg_m2_s: float
    half_bend_rad: float

    @property
    def advance_ratio(self) -> float:
        return float(np.linalg.norm(self.displacement_m)) / (2 * math.pi * RADIUS_M * abs(self.revolutions))


def roll(twin: Twin, body: Body, curvature_1_m: float, period_s: float, cycles: float, settle: float = 1.0) -> Roll:
    """Bend within 0.5 s, then turn the curvature direction; measured over `cycles` after `settle` cycles."""
    stiffness, h, start_s = body.rest_stiffness(), twin.step_s, 1.0
    from_s = start_s + settle * period_s
    steps = round((from_s + cycles * period_s) / h)
    first = round(from_s / h)
    before = None
    roll_rad: list[float] = []
    place: list[FloatArray] = []
    plane_rad, momentum = 0.0, 0.0
    for i in range(1, steps + 1):
        t = i * h
        bend = curvature_1_m * min(t / 0.5, 1.0)
        phase = 2.0 * math.pi * max(t - start_s, 0.0) / period_s
        twin.set_rest(np.array([1.0, bend * math.cos(phase), bend * math.sin(phase)]), stiffness)
        twin.step()
        if i < first or ((i - first) % 20 and i != steps):
            continue
        motion = twin.motion()
        tangent = motion.rotation[:, 2]
        side = np.cross([0.0, 0.0, 1.0], tangent)
        side /= np.linalg.norm(side)
        first_axis = motion.rotation[:, 0]
        roll_rad.append(math.atan2(first_axis @ np.cross(tangent, side), first_axis @ side))
        place.append(motion.centre_of_mass_m)
        momentum = max(momentum, float(np.linalg.norm(motion.angular_momentum_kg_m2_s)))
        inside = motion.rotation[:, :2] @ motion.curvature_1_m
        inside -= motion.chord * (motion.chord @ inside)
        if before is not None:
            plane_rad += math.atan2(motion.chord @ np.cross(before, inside), before @ inside)
        before = inside
    turns = np.unwrap(roll_rad)
    return Roll(
        float(turns[-1] - turns[0]) / (2.0 * math.pi),
        (place[-1] - place[0])[:2],
        plane_rad,
        2.0 * math.pi * (steps - first) * h / period_s,
        momentum,
        0.5 * body.length_m * float(np.linalg.norm(motion.curvature_1_m)),
    )


def shaken(twin: RodTwin, seed: int, size: float = 1.0) -> None:
    """Give a rod some bent and twisted shape, and some velocity."""
    random = np.random.default_rng(seed)
    state = twin._state
    modes = twin._modes
    state.strain[: 3 * modes] += size * random.normal(0.0, 6.0, 3 * modes)
    state.velocity[:3] = 0.3 * random.normal(size=3)
    state.velocity[3:6] = 5.0 * random.normal(size=3)
    state.velocity[6 : 6 + 3 * modes] = 30.0 * random.normal(size=3 * modes)
    if state.strain.shape[0] > 3 * modes:
        state.strain[-1], state.velocity[-1] = 1.1, 0.7


# --- kinematics ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("direction_rad", [0.0, 0.7, 2.0, -1.5])
def test_a_uniform_bend_is_an_arc_towards_its_centre_of_curvature(direction_rad: float) -> None:
    twin, curvature = rod(), 12.0
    k = curvature * np.array([math.cos(direction_rad), math.sin(direction_rad)])
    twin._state.strain[:2] = -k[1], k[0]
    points, axes = twin.shape()
    motion = twin.motion()
    np.testing.assert_allclose(motion.curvature_1_m, k)
    inwards = motion.rotation[:, :2] @ k / curvature
    centre = points[len(points) // 2] + inwards / curvature
    np.testing.assert_allclose(np.linalg.norm(points - centre, axis=1), 1.0 / curvature, rtol=1e-9)
    chord_m = 2.0 / curvature * math.sin(0.5 * curvature * LENGTH_M)
    assert np.linalg.norm(points[-1] - points[0]) == pytest.approx(chord_m, rel=1e-9)
    np.testing.assert_allclose(motion.chord, [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0)
    np.testing.assert_allclose(np.sum(np.gradient(points, axis=0)[1:-1] * axes[1:-1], axis=1), 0.0, atol=1e-7)


def test_a_rod_starts_straight_on_the_floor_with_its_first_axis_to_the_left() -> None:
    twin = rod(world=FLOOR)
    points, axes = twin.shape()
    np.testing.assert_allclose(points[[0, -1]], [[-0.075, 0.0, RADIUS_M], [0.075, 0.0, RADIUS_M]], atol=1e-12)
    np.testing.assert_allclose(axes, np.tile([0.0, 1.0, 0.0], (len(axes), 1)), atol=1e-12)


def test_a_helix_is_placed_to_the_accuracy_of_its_quadrature() -> None:
    twin, w = rod(), np.array([-3.0, 9.0, 20.0])
    twin._state.strain[:3] = w
    points, _ = twin.shape()
    frame = twin.motion().rotation
    s = np.linspace(-0.5, 0.5, len(points)) * LENGTH_M
    rate = float(np.linalg.norm(w))
    axis = w / rate
    across = np.array([0.0, 0.0, 1.0]) - axis * axis[2]
    exact = (
        np.outer(s * axis[2], axis)
        + np.outer(np.sin(rate * s) / rate, across)
        + np.outer((1.0 - np.cos(rate * s)) / rate, np.cross(axis, [0.0, 0.0, 1.0]))
    )
    np.testing.assert_allclose(points, exact @ frame.T, atol=1e-8)


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 10**6), modes=st.integers(1, 4), stretches=st.booleans())
def test_velocities_are_the_rates_of_the_placed_points(seed: int, modes: int, stretches: bool) -> None:
    twin = rod(modes=modes, stretches=stretches, contact_points=24)
    shaken(twin, seed, 0.5)
    state, work, rule = twin._state, twin._work, twin._rule
    twin.motion()
    root = rule.root_mass
    velocity = work.rate[:3] / root
    spin = work.rate[3:6] / (0.5 * RADIUS_M * root)
    about_tangent = work.rate[6] / (0.5 * RADIUS_M * root)
    u, strain, rotation = state.velocity.copy(), state.strain.copy(), state.rotation.copy()
    section = work.section.copy()
    small, moved = 1e-6, []
    for sign in (-1.0, 1.0):
        state.strain[:] = strain + sign * small * u[6:]
        state.rotation[:] = scipy.linalg.expm(sign * small * np.cross(np.eye(3), u[3:6])) @ rotation
        twin.motion()
        moved.append((work.place_m + sign * small * u[:3, None], work.section.copy()))
    rates = (moved[1][0] - moved[0][0]) / (2.0 * small)
    np.testing.assert_allclose(velocity, rates, atol=1e-4 * np.abs(rates).max())
    turning = (moved[1][1] - moved[0][1]) / (2.0 * small)
    for column in range(3):
        turned = np.cross(spin, section[column], axis=0)
        np.testing.assert_allclose(turned, turning[column], atol=1e-4 * np.abs(turning).max())
    np.testing.assert_allclose(about_tangent, np.sum(spin * section[2], axis=0), rtol=1e-9, atol=1e-9)


# --- inertia ------------------------------------------------------------------------------------------


def test_a_straight_rod_has_the_inertia_of_a_solid_cylinder() -> None:
    twin = rod()
    m = BODY.mass_kg
    for axis, inertia in ((0, 0.5 * m * RADIUS_M**2), (1, m * (LENGTH_M**2 / 12 + RADIUS_M**2 / 4))):
        twin._state.velocity[:] = 0.0
        twin._state.velocity[3 + axis] = 2.0
        expected = np.zeros(3)
        expected[axis] = 2.0 * inertia
        np.testing.assert_allclose(twin.motion().angular_momentum_kg_m2_s, expected, rtol=1e-9, atol=1e-15)
        assert twin.energy_J() == pytest.approx(2.0 * inertia)


def test_the_first_free_frequencies_are_those_of_a_free_beam() -> None:
    slender = replace(BODY, radius_m=5e-4)
    twin = rod(slender, modes=6)
    twin.motion()
    rows = twin._work.rows.reshape(len(twin._work.rows), -1)
    stiffness = np.zeros((len(rows), len(rows)))
    stiffness[6:, 6:] = twin._state.stiffness
    omega = np.sqrt(np.abs(scipy.linalg.eigh(stiffness, rows @ rows.T, eigvals_only=True)))
    bending = np.sqrt(BENDING_N_M2 * LENGTH_M / slender.mass_kg) / LENGTH_M**2
    expected = np.repeat([22.3733, 61.6728], 2) * bending  # each in two planes
    np.testing.assert_allclose(omega[6:10], expected, rtol=1e-3)


# --- floating -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("curvature_1_m", "check"), [(12.0, 0.3238), (8.0, 0.5231)])
@pytest.mark.parametrize("stretches", [False, True])
def test_a_floating_rod_turns_as_its_angular_momentum_asks(curvature_1_m: float, check: float, stretches: bool) -> None:
    body = stiffer(10.0)
    done = roll(rod(body, step_s=0.008, stretches=stretches), body, curvature_1_m, 6.0, 1.0, settle=0.1)
    ratio = done.plane_rotation_rad / done.turned_rad
    assert ratio == pytest.approx(floating_ratio(LENGTH_M, RADIUS_M, curvature_1_m), rel=1e-3)
    assert ratio == pytest.approx(check, rel=5e-3)
    assert done.revolutions < 0.0
    assert done.angular_momentum_max_kg_m2_s < 1e-12


def test_the_floating_ratio_converges_with_the_square_of_the_step() -> None:
    body, errors = stiffer(10.0), []
    for step_s in (0.08, 0.04):
        done = roll(rod(body, step_s=step_s), body, 12.0, 8.0, 0.5, settle=0.5)
        bend_1_m = 2.0 * done.half_bend_rad / LENGTH_M  # a lagging bend is not the kinematics' error
        ratio = done.plane_rotation_rad / done.turned_rad
        errors.append(abs(ratio / floating_ratio(LENGTH_M, RADIUS_M, bend_1_m) - 1.0))
    assert errors[1] < errors[0] / 3.0 < 1e-3


def test_a_thrown_rod_keeps_its_momentum_and_falls_on_a_parabola() -> None:
    twin = rod(world=replace(FLOATING, gravity_m_s2=9.81), step_s=0.002)
    twin._state.velocity[:] = 0.0
    twin._state.velocity[3:6] = 3.0, 20.0, -4.0
    twin.set_rest(np.array([1.0, 9.0, 4.0]), BODY.rest_stiffness())
    twin.step()
    momentum = twin.motion().angular_momentum_kg_m2_s
    centre = []
    for _ in range(3):
        twin.advance(50)
        motion = twin.motion()
        centre.append(motion.centre_of_mass_m)
        np.testing.assert_allclose(motion.angular_momentum_kg_m2_s, momentum, rtol=1e-11, atol=1e-18)
    second_difference = centre[2] - 2.0 * centre[1] + centre[0]
    np.testing.assert_allclose(second_difference, [0.0, 0.0, -9.81 * 0.1**2], atol=2e-5)


# --- rolling ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("half_bend_rad", [0.5, 0.9, 1.2])
def test_slow_rolling_advances_as_coulomb_friction_asks(half_bend_rad: float) -> None:
    body = replace(stiffer(100.0), mass_kg=0.0052)
    done = roll(rod(body, FLOOR), body, 2.0 * half_bend_rad / LENGTH_M, 8.0, 0.5, settle=0.25)
    assert done.half_bend_rad == pytest.approx(half_bend_rad, rel=1e-3)
    assert done.advance_ratio == pytest.approx(coulomb_advance_ratio(half_bend_rad), rel=1e-3)


def test_slow_rolling_advances_as_viscous_friction_asks() -> None:
    body = replace(stiffer(100.0), mass_kg=0.0052)
    world = replace(FLOOR, friction=0.05, friction_law="viscous")
    done = roll(rod(body, world), body, 12.0, 8.0, 0.5, settle=0.5)
    assert done.advance_ratio == pytest.approx(viscous_advance_ratio(0.9), rel=1e-3)


def test_rolling_is_one_backward_revolution_a_cycle_and_hardly_depends_on_the_step() -> None:
    fine = roll(rod(world=FLOOR, step_s=0.002), BODY, 12.0, 2.0, 1.0)
    coarse = roll(rod(world=FLOOR, step_s=0.02), BODY, 12.0, 2.0, 1.0)
    for done in (fine, coarse):
        assert done.revolutions == pytest.approx(-1.0, abs=1e-3)
        assert done.displacement_m[1] > 0.05  # turning about −x on a floor goes to +y
        assert abs(done.displacement_m[0]) < 1e-6
    assert coarse.advance_ratio == pytest.approx(fine.advance_ratio, rel=2e-3)


def test_a_fast_sequence_unlocks() -> None:
    slow = roll(rod(world=FLOOR), BODY, 6.0, 0.25, 6.0, settle=4.0)
    fast = roll(rod(world=FLOOR, step_s=0.002), BODY, 6.0, 0.1, 10.0, settle=10.0)
    assert slow.revolutions == pytest.approx(-6.0, abs=0.05)
    assert abs(fast.revolutions) < 9.5


@pytest.mark.slow
def test_rod_and_segment_twin_agree_on_rolling() -> None:
    from sim.bullet import BulletTwin

    segments = BulletTwin(BODY, FLOOR, segments=20, step_s=0.001, stretches=False)
    chain = roll(segments, BODY, 12.0, 2.0, 1.0)
    segments.close()
    smooth = roll(rod(world=FLOOR), BODY, 12.0, 2.0, 1.0)
    assert smooth.advance_ratio == pytest.approx(chain.advance_ratio, rel=5e-3)
    assert smooth.revolutions == pytest.approx(chain.revolutions, rel=5e-3)


# --- resting, stretching ------------------------------------------------------------------------------


@pytest.mark.parametrize("step_s", [5e-4, 0.004, 0.01, 0.02])
def test_a_resting_rod_carries_its_weight_evenly_and_sinks_by_a_hundredth_of_its_radius(step_s: float) -> None:
    twin = rod(world=FLOOR, step_s=step_s)
    twin.advance(round(1.0 / step_s))
    np.testing.assert_allclose(twin._contacts.load_m_s2[0], 9.81, rtol=1e-6)
    assert twin.motion().centre_of_mass_m[2] == pytest.approx(0.99 * RADIUS_M, rel=1e-6)
    assert np.linalg.norm(twin.motion().mid_velocity_m_s) < 1e-9


@pytest.mark.parametrize("contact_points", [12, 24, 48])
def test_the_pressed_ends_of_a_limp_tube_sink_by_less_than_a_fiftieth_of_its_radius(contact_points: int) -> None:
    """Asked to arch, too heavy to do so: its weight rests near its tips. λgL³/EI = 70."""
    limp = replace(BODY, mass_kg=1.25, radius_m=0.0147)
    tube = RodTwin(
        limp,
        replace(FLOOR, friction=3.0),
        modes=5,
        contact_points=contact_points,
        step_s=0.02,
        stretches=False,
        symmetric=True,
        twists=False,
    )
    tube.set_rest(np.array([1.0, 0.0, -4.4 / LENGTH_M]), limp.rest_stiffness())
    for _ in range(300):
        tube.step()
        tube.halt()
    assert 0.002 * 0.0147 < tube.penetration_m < 0.02 * 0.0147


def test_a_kinked_tube_bends_no_further_than_till_its_ends_meet() -> None:
    """Without damping and far past the kink: what it swings past a full circle by is little."""
    kink_1_m = 5.0
    soft = replace(BODY, ovalisation_m2=1.0 / (3.0 * kink_1_m**2), damping_time_s=0.0)
    tube = rod(soft, step_s=0.001)
    tube.set_rest(np.array([1.0, 12.0, 0.0]), soft.rest_stiffness())
    rows = tube.play(hold(), 600, 1)
    assert 2.0 * math.pi < LENGTH_M * np.linalg.norm(rows[:, CURVATURE], axis=1).max() < 4.0 * math.pi
    assert (rows[:, ENERGY] - rows[:, WORK]).max() < 1e-2 * tube.work_J


def test_the_first_step_makes_no_energy() -> None:
    """A slow throw into the ground, with a step far longer than the blow."""
    thrown = rod(replace(BODY, mass_kg=1.4), replace(FLOOR, friction=0.2), step_s=0.02)
    thrown.throw(0.0, np.array([0.0, -0.01, 0.05, 2.0, 0.0, 0.0]))
    before_J = thrown.energy_J()
    kinetic_J = 0.5 * 1.4 * (0.01**2 + 0.05**2)
    thrown.step()
    assert thrown.energy_J() <= before_J + 0.05 * kinetic_J


def test_a_dropped_rod_comes_to_rest() -> None:
    twin = rod(world=FLOOR)
    twin._state.position_m[2] = 0.1
    twin.set_rest(np.array([1.0, 8.0, 0.0]), BODY.rest_stiffness())
    twin.advance(500)
    motion = twin.motion()
    assert motion.centre_of_mass_m[2] == pytest.approx(0.99 * RADIUS_M, rel=1e-2)
    assert np.linalg.norm(motion.mid_velocity_m_s) < 1e-3


@pytest.mark.parametrize("stretches", [False, True])
def test_a_coupled_section_settles_at_its_rest_strains(stretches: bool) -> None:
    coupled = BODY.rest_stiffness()
    coupled[0, 1] = coupled[1, 0] = 0.3 * math.sqrt(coupled[0, 0] * coupled[1, 1])
    coupled[0, 2] = coupled[2, 0] = -0.2 * math.sqrt(coupled[0, 0] * coupled[2, 2])
    coupled[1, 2] = coupled[2, 1] = 0.1 * coupled[1, 1]
    twin = rod(stretches=stretches)
    twin.set_rest(np.array([1.1, 5.0, -7.0]), coupled)
    twin.advance(500)
    motion = twin.motion()
    np.testing.assert_allclose(motion.curvature_1_m, [5.0, -7.0], rtol=1e-6)
    assert motion.stretch == pytest.approx(1.1 if stretches else 1.0, rel=1e-7)
    points, _ = twin.shape()
    arc_m = np.sum(np.linalg.norm(np.diff(points, axis=0), axis=1))
    assert arc_m == pytest.approx(motion.stretch * LENGTH_M, rel=1e-3)


# --- energy, stability --------------------------------------------------------------------------------


@pytest.mark.parametrize("damping_time_s", [0.0, 0.02])
@pytest.mark.parametrize("step_s", [2.5e-4, 0.004])
def test_a_free_vibration_never_gains_energy(damping_time_s: float, step_s: float) -> None:
    twin = rod(replace(BODY, damping_time_s=damping_time_s), step_s=step_s, stretches=True)
    twin.set_rest(np.array([1.05, 10.0, -6.0]), BODY.rest_stiffness())
    energy = [twin.energy_J()]
    for _ in range(300):
        twin.advance(2)
        energy.append(twin.energy_J())
    assert np.diff(energy).max() < 0.02 * energy[0]  # of a step that does not resolve it: to and fro
    assert max(energy) <= energy[0]
    if damping_time_s > 0.0:
        assert energy[-1] < 0.9 * energy[0]


def test_an_undamped_vibration_loses_less_energy_the_smaller_the_step() -> None:
    lost = []
    for step_s in (4e-5, 1e-5):
        twin = rod(replace(BODY, damping_time_s=0.0), step_s=step_s)
        twin.set_rest(np.array([1.0, 10.0, -6.0]), BODY.rest_stiffness())
        energy_J = twin.energy_J()
        twin.advance(round(0.01 / step_s))
        lost.append(1.0 - twin.energy_J() / energy_J)
    assert 0.0 < lost[1] < 0.35 * lost[0] < 0.35


@pytest.mark.parametrize("stretches", [False, True])
def test_a_limp_rod_in_free_motion_keeps_its_energy(stretches: bool) -> None:
    """Nothing but inertia: centrifugal, Coriolis and gyroscopic terms do no work, or one of them is wrong."""
    twin = rod(stiffer(1e-12), step_s=1e-6, stretches=stretches)
    shaken(twin, 5)
    twin.step()
    velocity, energy_J = twin._state.velocity.copy(), twin.energy_J()
    twin.advance(3000)
    changed = np.linalg.norm(twin._state.velocity - velocity) / np.linalg.norm(velocity)
    assert changed > 0.02
    assert twin.energy_J() == pytest.approx(energy_J, rel=2e-7)


@pytest.mark.parametrize("factor", [0.01, 0.1, 1.0, 10.0, 100.0])
@pytest.mark.parametrize("world", [FLOATING, FLOOR])
def test_four_decades_of_stiffness_stay_bounded_at_four_milliseconds(factor: float, world: World) -> None:
    body = stiffer(factor)
    twin = rod(body, world, stretches=True)
    for i in range(500):
        phase = 2.0 * math.pi * i * 0.004
        twin.set_rest(np.array([1.1, 12.0 * math.cos(phase), 12.0 * math.sin(phase)]), body.rest_stiffness())
        twin.step()
    motion = twin.motion()
    assert np.linalg.norm(motion.curvature_1_m) < 15.0
    assert np.linalg.norm(motion.mid_velocity_m_s) < 0.5
    assert np.linalg.norm(motion.angular_velocity_rad_s) < 30.0
    assert 0.9 < motion.stretch < 1.2
    np.testing.assert_allclose(motion.rotation.T @ motion.rotation, np.eye(3), atol=1e-12)
    if world.ground != "none":
        assert motion.centre_of_mass_m[2] == pytest.approx(RADIUS_M, rel=0.02)


# --- use ----------------------------------------------------------------------------------------------


def test_many_steps_at_once_are_the_same_as_one_by_one() -> None:
    one, many = rod(world=FLOOR), rod(world=FLOOR)
    for twin in (one, many):
        twin.set_rest(np.array([1.0, 6.0, 9.0]), BODY.rest_stiffness())
    for _ in range(40):
        one.step()
        one.motion()  # looking changes nothing
    many.advance(40)
    np.testing.assert_array_equal(one._state.velocity, many._state.velocity)
    np.testing.assert_array_equal(one._state.position_m, many._state.position_m)


def test_stepping_allocates_nothing() -> None:
    twin = rod(world=FLOOR, stretches=True)
    counts = []
    _nrt_python.memsys_enable_stats()
    try:
        for count in (10, 1000):
            before = rtsys.get_allocation_stats()
            twin.advance(count)
            after = rtsys.get_allocation_stats()
            counts.append((after.alloc - before.alloc, after.mi_alloc - before.mi_alloc))
    finally:
        _nrt_python.memsys_disable_stats()
    assert counts[0] == counts[1]


@pytest.mark.parametrize("where", [0, 1, 2])
def test_a_state_that_is_not_finite_is_refused(where: int) -> None:
    twin = rod(world=FLOOR, stretches=True)
    twin.step()
    strain = STRAIGHT.copy()
    strain[where] = math.nan
    twin.set_rest(strain, BODY.rest_stiffness())
    with pytest.raises(SimulationError, match="left its range"):
        twin.step()


def test_a_rod_that_shrinks_to_nothing_is_refused() -> None:
    twin = rod(stretches=True)
    twin.set_rest(np.array([-3.0, 0.0, 0.0]), BODY.rest_stiffness())
    with pytest.raises(SimulationError, match="shrank"):
        twin.advance(1000)


@pytest.mark.parametrize(
    ("key", "value"),
    [("modes", 0), ("contact_points", 2), ("contact_points", 15), ("step_s", 0.0), ("step_s", math.nan)],
)
def test_settings_out_of_range_are_refused_by_name(key: str, value: float) -> None:
    given_settings = {"modes": 3, "contact_points": 16, "step_s": 0.004, "stretches": False, key: value}
    with pytest.raises(InputError, match=key):
        RodTwin(BODY, FLOOR, **given_settings)  # type: ignore[arg-type]
