"""How well the rod twin answers: orders of convergence, the rulers with closed forms, grounds, rest, ledgers."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from numpy.typing import NDArray
from scipy.integrate import solve_bvp

from sim.body import Body, World
from sim.motion_rows import ANGULAR_MOMENTUM, ASLEEP, CENTRE_OF_MASS, CHORD, CURVATURE, ENERGY, PENETRATION, ROTATION
from sim.motion_rows import WORK as WORK_DONE
from sim.rod import RodTwin
from sim.rod_drive import drive_array
from sim.scene import Drive
from softbot.rolling import floating_ratio

FloatArray = NDArray[np.float64]

LENGTH_M, RADIUS_M, BENDING_N_M2 = 0.15, 0.01, 3.93e-3
BODY = Body(
    length_m=LENGTH_M,
    radius_m=RADIUS_M,
    mass_kg=1100.0 * math.pi * RADIUS_M**2 * LENGTH_M,
    bending_stiffness_N_m2=BENDING_N_M2,
    twisting_stiffness_N_m2=BENDING_N_M2 * 2.0 / 3.0,
    axial_stiffness_N=4.0 * BENDING_N_M2 / RADIUS_M**2,
    damping_time_s=0.02,
)
AFLOAT = World(0.0, "none", 0.0, "coulomb")
FLOOR = World(9.81, "plane", 0.6, "coulomb")


def rod(
    body: Body = BODY,
    world: World = FLOOR,
    *,
    modes: int = 3,
    points: int = 16,
    step_s: float = 0.005,
    symmetric: bool = True,
    twists: bool = True,
    tolerance: float = 0.0,
) -> RodTwin:
    return RodTwin(
        body,
        world,
        modes=modes,
        contact_points=points,
        step_s=step_s,
        stretches=False,
        symmetric=symmetric,
        twists=twists,
        tolerance=tolerance,
    )


def turning(curvature_1_m: float = 12.0, period_s: float = 2.0, start_s: float = 1.0) -> FloatArray:
    return drive_array(Drive(kind="curvature", curvature_1_m=curvature_1_m, period_s=period_s, start_s=start_s))


def roll_rad(rows: FloatArray) -> FloatArray:
    frame = rows[:, ROTATION].reshape(-1, 3, 3)
    return np.unwrap(np.arctan2(frame[:, 2, 0], frame[:, 1, 0]))


def advance_ratio(rows: FloatArray) -> float:
    rolled = abs(roll_rad(rows)[-1] - roll_rad(rows)[0])
    return float(np.linalg.norm((rows[-1] - rows[0])[CENTRE_OF_MASS])) / (RADIUS_M * rolled)


def rolled(twin: RodTwin, *, from_s: float = 5.0, to_s: float = 9.0) -> FloatArray:
    """Rows of the slow rolling scene between two times."""
    twin.play(turning(), 1, round(from_s / twin.step_s))
    return twin.play(turning(), round((to_s - from_s) / twin.step_s) + 1, 1)


# --- orders of convergence ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("damping_time_s", [0.0, 0.002])
def test_free_motion_converges_with_the_square_of_the_step(damping_time_s: float) -> None:
    ends = []
    for step_s in (1e-3, 5e-4, 2.5e-4, 2.5e-5):
        body = replace(BODY, damping_time_s=damping_time_s, bending_stiffness_N_m2=BENDING_N_M2 / 4.0)
        twin = rod(body, AFLOAT, step_s=step_s, symmetric=False)
        twin.set_rest(np.array([1.0, 9.0, -5.0]), body.rest_stiffness())
        state = twin._state
        state.velocity[3:6], state.velocity[6:9] = (3.0, 6.0, -2.0), (5.0, -20.0, 15.0)
        twin.advance(round(0.04 / step_s))
        ends.append(np.concatenate([state.strain * LENGTH_M, state.rotation.ravel()]))
    errors = [float(np.linalg.norm(end - ends[-1])) for end in ends[:-1]]
    assert errors[2] < 0.1
    for coarse, fine in itertools.pairwise(errors):
        assert math.log2(coarse / fine) > 1.8


def test_rolling_hardly_depends_on_the_step() -> None:
    ratio = {step_s: advance_ratio(rolled(rod(step_s=step_s))) for step_s in (0.04, 0.02, 0.01, 0.001)}
    assert ratio[0.04] == pytest.approx(ratio[0.001], rel=2e-3)
    assert ratio[0.02] == pytest.approx(ratio[0.001], rel=1.5e-3)
    assert ratio[0.01] == pytest.approx(ratio[0.001], rel=1e-3)


def test_rolling_converges_with_modes_and_contact_points() -> None:
    finest = advance_ratio(rolled(rod(modes=8, points=48)))
    by_modes = [abs(advance_ratio(rolled(rod(modes=n, points=48))) - finest) for n in (1, 2, 4, 6)]
    assert by_modes[0] < 0.012
    assert by_modes[1] < 0.2 * by_modes[0]
    assert max(by_modes[2:]) < 3e-4
    four = advance_ratio(rolled(rod(modes=4, points=48)))
    by_points = [abs(advance_ratio(rolled(rod(modes=4, points=n))) - four) for n in (12, 24)]
    assert by_points[0] < 2e-3
    assert by_points[1] < 5e-4


def test_an_adaptive_step_is_as_good_as_its_tolerance() -> None:
    ends, steps = [], []
    for tolerance in (1e-3, 1e-5, 1e-7):
        twin = rod(world=AFLOAT, step_s=0.02, tolerance=tolerance)
        twin.set_rest(np.array([1.0, 9.0, -5.0]), BODY.rest_stiffness())
        twin.advance(5)
        ends.append(twin.row()[1:13])
        steps.append(twin._state.flag[6])
    errors = [float(np.abs(end - ends[-1]).max()) for end in ends[:-1]]
    assert errors[1] < 0.3 * errors[0]
    assert steps[0] < 0.5 * steps[1]


# --- the rulers -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bend_rad", [0.2, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("slenderness", [0.02, 0.07, 0.15])
def test_a_slowly_driven_floating_rod_turns_by_the_floating_ratio(bend_rad: float, slenderness: float) -> None:
    body, curvature = replace(BODY, radius_m=slenderness * LENGTH_M), bend_rad / LENGTH_M
    for step_s, points, within in ((0.01, 16, 1e-3), (0.005, 32, 1e-4)):
        twin = rod(body, AFLOAT, step_s=step_s, points=points)
        samples = round(3.0 / step_s)
        rows = np.vstack(
            [
                twin.play(turning(curvature, 32.0), 1, round(2.0 / step_s)),
                twin.play(turning(curvature, 32.0), samples, 1),
            ]
        )
        frame, bend = rows[:, ROTATION].reshape(-1, 3, 3), rows[:, CURVATURE]
        side = np.einsum("nij,nj->ni", frame[:, :, :2], bend)
        side /= np.linalg.norm(side, axis=1)[:, None]
        chord = rows[:-1, CHORD]
        turned = np.arctan2(
            np.einsum("ni,ni->n", chord, np.cross(side[:-1], side[1:])), np.einsum("ni,ni->n", side[:-1], side[1:])
        ).sum()
        driven = 2.0 * math.pi * samples * step_s / 32.0
        assert turned / driven == pytest.approx(floating_ratio(LENGTH_M, body.radius_m, curvature), rel=within)
        assert np.abs(rows[:, ANGULAR_MOMENTUM]).max() < 1e-12


def elastica_tip(load: float) -> tuple[float, float]:
    """Tip of a cantilever of unit length and stiffness under its own weight per length: EIθ'' = w (L − s) cosθ."""
    line = np.linspace(0.0, 1.0, 200)
    solution = solve_bvp(
        lambda s, y: np.vstack([y[1], load * (1.0 - s) * np.cos(y[0])]),
        lambda a, b: np.array([a[0], b[1]]),
        line,
        np.zeros((2, 200)),
        tol=1e-10,
        max_nodes=10**5,
    )
    s = np.linspace(0.0, 1.0, 20001)
    theta = solution.sol(s)[0]
    return float(np.trapezoid(np.cos(theta), s)), float(np.trapezoid(np.sin(theta), s))


@pytest.mark.parametrize(("length_m", "modes", "within"), [(0.15, 4, 1e-5), (0.3, 6, 1e-4), (0.3, 8, 2e-5)])
def test_a_cantilever_hangs_as_the_elastica_does(length_m: float, modes: int, within: float) -> None:
    line_kg_m = 0.3
    body = replace(BODY, length_m=2.0 * length_m, radius_m=1e-3, mass_kg=2.0 * length_m * line_kg_m, damping_time_s=0.2)
    twin = RodTwin(
        body,
        World(9.81, "none", 0.0, "coulomb"),
        modes=modes,
        contact_points=24,
        step_s=0.02,
        stretches=False,
        symmetric=True,
        clamped=True,
    )
    twin.advance(2000)
    tip = twin.shape()[0][-1] / length_m
    x, z = elastica_tip(line_kg_m * 9.81 * length_m**3 / BENDING_N_M2)
    assert math.hypot(tip[0] - x, tip[2] - z) < within


@pytest.mark.parametrize("modes", [6, 8])
def test_the_first_three_free_frequencies_are_those_of_a_free_beam(modes: int) -> None:
    slender = replace(BODY, radius_m=2e-4)
    twin = rod(slender, AFLOAT, modes=modes, points=24, symmetric=False)
    rows = twin._work.rows.reshape(twin._layout.columns, -1)
    stiffness = np.zeros((len(rows), len(rows)))
    stiffness[6:, 6:] = twin._state.stiffness
    omega = np.sqrt(np.abs(scipy.linalg.eigh(stiffness, rows @ rows.T, eigvals_only=True)))
    bending = math.sqrt(BENDING_N_M2 * LENGTH_M / slender.mass_kg) / LENGTH_M**2
    np.testing.assert_allclose(omega[6:12], np.repeat([22.37329, 61.67282, 120.90339], 2) * bending, rtol=1e-3)


# --- leaving out ----------------------------------------------------------------------------------------------------


def test_half_of_a_symmetric_tube_moves_as_the_whole() -> None:
    halves, whole = rod(), rod(symmetric=False)
    rows = [twin.play(turning(), 300, 1) for twin in (halves, whole)]
    np.testing.assert_allclose(rows[0][:, 1:35], rows[1][:, 1:35], rtol=1e-6, atol=1e-9)
    for mine, theirs in zip(halves.shape(), whole.shape(), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-9)


def test_a_resting_robot_sleeps_and_wakes_with_the_first_step_that_its_drive_changes() -> None:
    twin = rod(step_s=0.01)
    rows = twin.play(turning(start_s=2.0), 160, 1)  # it bends from 1.5 s on
    assert rows[140, ASLEEP] == 1.0
    assert rows[149, ASLEEP] == 1.0
    assert rows[150, ASLEEP] == 0.0
    assert np.hypot(*rows[151, CURVATURE]) > 0.0
    np.testing.assert_array_equal(rows[100, 1:35], rows[149, 1:35])


def test_a_sleeping_robot_wakes_when_its_rest_shape_is_changed_by_hand() -> None:
    twin = rod()
    twin.advance(300)
    assert twin.asleep
    twin.set_rest(np.array([1.0, 0.0, 0.0]), BODY.rest_stiffness())
    assert twin.asleep  # nothing new
    twin.set_rest(np.array([1.0, 1.0, 0.0]), BODY.rest_stiffness())
    twin.step()
    assert not twin.asleep
    assert np.hypot(*twin.motion().curvature_1_m) > 0.0


# --- grounds and friction -------------------------------------------------------------------------------------------


def slope(angle_deg: float, heading_rad: float, **more: float) -> World:
    return replace(FLOOR, slope_rad=math.radians(angle_deg), slope_heading_rad=heading_rad, **more)


@pytest.mark.parametrize("curvature_1_m", [0.0, 12.0, -12.0])
def test_a_robot_rests_on_a_slope_below_the_friction_angle_without_creeping(curvature_1_m: float) -> None:
    downhill_rad = 0.0 if curvature_1_m == 0.0 else math.pi / 2  # a straight one would roll sideways
    twin = rod(world=slope(20.0, downhill_rad), symmetric=False)
    twin.set_rest(np.array([1.0, curvature_1_m, 0.0]), BODY.rest_stiffness())
    for _ in range(4):  # asleep it is when it eases by less than 0.1 µm on
        twin.wake()
        twin.advance(400)
    place = twin.motion().centre_of_mass_m
    twin.wake()
    twin.advance(4000)
    np.testing.assert_allclose(twin.motion().centre_of_mass_m, place, atol=1e-9)


def test_a_robot_slides_down_a_slope_beyond_the_friction_angle_as_coulomb_says() -> None:
    angle = math.radians(40.0)
    twin = rod(world=slope(40.0, 0.0), symmetric=False)
    speeds = []
    for _ in range(2):
        twin.advance(40)
        speeds.append(twin.motion().mid_velocity_m_s[0])
    expected = 9.81 * (math.sin(angle) - 0.6 * math.cos(angle))
    assert (speeds[1] - speeds[0]) / 0.2 == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(("share", "rolls"), [(0.5, True), (1.5, False)])
def test_a_straight_robot_rolls_down_a_slope_once_it_overcomes_the_rolling_resistance(
    share: float, rolls: bool
) -> None:
    moment = share * BODY.mass_kg * 9.81 * math.sin(math.radians(10.0)) * RADIUS_M
    twin = rod(world=slope(10.0, math.pi / 2, rolling_resistance_N_m=moment))
    twin.advance(100)
    start = twin.motion().mid_velocity_m_s[1]
    twin.advance(100)
    gained = (twin.motion().mid_velocity_m_s[1] - start) / 0.5
    # a solid cylinder: 3/2 m a = m g sin α − M/R
    expected = 2.0 / 3.0 * 9.81 * math.sin(math.radians(10.0)) * (1.0 - share)
    assert gained == pytest.approx(expected if rolls else 0.0, rel=2e-3, abs=1e-6)


def test_a_robot_bent_over_a_pipe_rolls_along_it_without_slip() -> None:
    """The paper's curved surface: every cross-section moves the same way, so nothing has to slide."""
    twin = rod(world=replace(FLOOR, ground="pipe", pipe_radius_m=0.08, pipe_axis="across"), step_s=0.0025)
    twin.play(turning(10.0), 1, 2000)
    rows = twin.play(turning(10.0), 400, 4)
    assert advance_ratio(rows) == pytest.approx(1.0, abs=5e-3)
    assert rows[:, PENETRATION].max() < 0.05 * RADIUS_M


def test_a_robot_rolls_onto_a_low_step_and_is_stopped_by_a_high_one() -> None:
    heights = []
    for height_m in (0.003, 0.02):
        world = replace(FLOOR, ground="step", step_height_m=height_m, step_distance_m=0.05)
        rows = rod(world=world, step_s=0.0025).play(turning(), 900, 4)
        heights.append(rows[-1, CENTRE_OF_MASS])
        assert rows[-1, PENETRATION] < 0.02 * RADIUS_M
    assert heights[0][2] == pytest.approx(RADIUS_M + 0.003, rel=0.02)
    assert heights[0][1] > 0.15
    assert heights[1][1] < 0.05
    assert heights[1][2] == pytest.approx(RADIUS_M, rel=0.02)


# --- ledgers --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step_s", [0.0025, 0.02])
def test_energy_is_never_more_than_the_actuators_put_in(step_s: float) -> None:
    rows = rod(step_s=step_s).play(turning(12.0, 1.0, 0.5), round(6.0 / step_s), 1)
    gained = rows[:, ENERGY] - rows[0, ENERGY] - (rows[:, WORK_DONE] - rows[0, WORK_DONE])
    assert gained.max() < 1e-6
    assert rows[-1, WORK_DONE] > 1e-3


def test_outside_forces_and_moments_give_the_momentum_that_they_ask_for() -> None:
    twin = rod(world=AFLOAT, symmetric=False)
    twin.push_N[...] = [[1e-3, 0.0, 2e-3]]
    twin.push_N_m[...] = [[2e-5, 0.0, 0.0]]
    twin.wake()
    twin.advance(100)
    force_N = 16 * np.array([1e-3, 0.0, 2e-3])
    np.testing.assert_allclose(twin._state.momentum[:3], 0.5 * force_N, rtol=1e-9, atol=1e-15)
    centre, velocity, spin = twin.points()
    masses = twin._rule.root_mass**2
    np.testing.assert_allclose(masses @ velocity, 0.5 * force_N, rtol=1e-6, atol=1e-12)
    assert twin.motion().angular_momentum_kg_m2_s[0] == pytest.approx(0.5 * 16 * 2e-5, rel=1e-4)
    assert spin[:, 0].min() > 0.0
    assert centre[:, 2].mean() == pytest.approx(0.5 * force_N[2] / BODY.mass_kg * 0.25, rel=0.02)


def test_a_tube_bent_beyond_its_stable_branch_kinks_and_says_when() -> None:
    kink_1_m = 15.0
    body = replace(BODY, ovalisation_m2=1.0 / (3.0 * kink_1_m**2))
    stable, beyond = rod(body, AFLOAT), rod(body, AFLOAT)
    moment_1_m = 2.0 / 3.0 * kink_1_m  # the greatest that the section bears, over EI
    stable.set_rest(np.array([1.0, 0.9 * moment_1_m, 0.0]), body.rest_stiffness())
    beyond.set_rest(np.array([1.0, 1.1 * moment_1_m, 0.0]), body.rest_stiffness())
    for twin in (stable, beyond):
        twin.advance(600)
    assert stable.kinked_at_s is None
    bend = float(stable.motion().curvature_1_m[0])
    assert bend - bend**3 / (3.0 * kink_1_m**2) == pytest.approx(0.9 * moment_1_m, rel=1e-6)
    assert beyond.kinked_at_s is not None
    assert 0.0 < beyond.kinked_at_s < 1.0
    assert float(beyond.motion().curvature_1_m[0]) > kink_1_m


def test_a_bent_robot_asleep_is_straightened_by_a_drive_that_has_not_started() -> None:
    twin = rod()
    twin.set_rest(np.array([1.0, 8.0, 0.0]), BODY.rest_stiffness())
    twin.advance(600)
    assert twin.asleep
    rows = twin.play(turning(start_s=1e4), 200, 1)
    assert np.hypot(*rows[-1, CURVATURE]) < 0.5
