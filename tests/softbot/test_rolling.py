"""Rolling theory: check values, independent derivations of the rulers, directions, and dead chambers."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softbot import rolling, tube
from softbot.errors import InputError

angles = st.floats(-math.pi, math.pi)
half_bends = st.floats(0.01, 3.1)


# --- moments


def test_equation_1_at_a_known_point() -> None:
    moment = rolling.rolling_moment_N_m(3.0, 0.01, math.pi / 6, math.pi / 2)
    assert moment == pytest.approx(-0.03, rel=1e-14)


@given(phi0=half_bends, theta=angles)
@settings(deadline=None, max_examples=50)
def test_segments_go_from_equation_1_to_the_continuous_arc(phi0: float, theta: float) -> None:
    one = rolling.segmented_rolling_moment_N_m(2.0, 0.01, phi0, theta, 1)
    assert one == pytest.approx(-rolling.rolling_moment_N_m(2.0, 0.01, phi0, theta), rel=1e-14, abs=1e-18)
    eleven = rolling.segmented_rolling_moment_N_m(2.0, 0.01, phi0, theta, 11)
    each = 2 * 2.0 * 0.01 * math.sin(phi0 / 11) * math.sin(theta)
    assert eleven == pytest.approx(11 * each, rel=1e-13, abs=1e-18)
    many = rolling.segmented_rolling_moment_N_m(2.0, 0.01, phi0, theta, 100_000)
    assert many == pytest.approx(2 * 2.0 * 0.01 * phi0 * math.sin(theta), rel=1e-8, abs=1e-18)


def test_rotation_moment_at_a_known_point_and_against_the_rolling() -> None:
    rotation = rolling.rotation_moment_N_m(3.0, 0.01, 0.9, 0.4, 11)
    expected = 2 * 3.0 * 0.01 * math.cos(0.9 / 11) * math.sin(0.9) * math.sin(0.4)
    assert rotation == pytest.approx(expected, rel=1e-14)
    assert rotation * rolling.rolling_moment_N_m(3.0, 0.01, 0.9, 0.4) < 0


# --- direction


@given(phi0=half_bends, theta=angles)
@settings(deadline=None, max_examples=50)
def test_reversing_bend_and_angle_together_keeps_moment_and_direction(phi0: float, theta: float) -> None:
    forward = rolling.rolling_moment_N_m(1.0, 0.01, phi0, theta)
    assert rolling.rolling_moment_N_m(1.0, 0.01, -phi0, -theta) == forward
    assert rolling.rolling_moment_N_m(1.0, 0.01, -phi0, theta) == -forward
    for actuator in ("muscle", "chamber"):
        direction = rolling.rolling_direction(phi0, theta, actuator)  # type: ignore[arg-type]
        assert rolling.rolling_direction(-phi0, -theta, actuator) == direction  # type: ignore[arg-type]


@pytest.mark.parametrize("theta", [0.3, 1.0, 2.0, -0.3, -1.0, -2.0])
def test_a_chamber_rolls_the_other_way_from_a_muscle_at_the_same_angle(theta: float) -> None:
    muscle = rolling.rolling_direction(0.9, theta, "muscle")
    assert muscle == -math.copysign(1, theta)
    assert rolling.rolling_direction(0.9, theta, "chamber") == -muscle


@pytest.mark.parametrize("actuator", ["muscle", "chamber"])
@pytest.mark.parametrize("theta", [0.0, math.pi, -math.pi])
def test_an_element_in_the_plane_of_the_bend_drives_no_rolling(theta: float, actuator: rolling.Actuator) -> None:
    assert rolling.rolling_direction(0.9, theta, actuator) == 0


@pytest.mark.parametrize(
    ("theta", "muscle_reverses"),
    [(0.1, False), (1.5, False), (1.6, True), (-1.5, False), (-1.6, True), (3.0, True)],
)
def test_bend_reverses_beyond_a_quarter_turn_for_a_muscle_and_within_it_for_a_chamber(
    theta: float, muscle_reverses: bool
) -> None:
    assert rolling.bend_reverses(theta) is muscle_reverses
    assert rolling.bend_reverses(theta, "chamber") is not muscle_reverses


@given(heading=angles, opening=st.sampled_from([1.0, -1.0]), direction=st.sampled_from([1.0, -1.0]))
@settings(deadline=None, max_examples=50)
def test_direction_plus_one_rolls_with_negative_revolutions_to_the_left(
    heading: float, opening: float, direction: float
) -> None:
    """Turn the bend direction in the body, roll until the C lies flat again, see where the top goes."""
    up = np.array([0.0, 0.0, 1.0])
    tangent = np.array([math.cos(heading), math.sin(heading), 0.0])
    left = np.cross(up, tangent)
    e1 = opening * left  # the body is laid so that the C opens along e1, to the left or to the right
    e2 = np.cross(tangent, e1)
    assert np.allclose(np.cross(e1, e2), tangent)
    turned = math.cos(0.01 * direction) * e1 + math.sin(0.01 * direction) * e2

    def rolled(vector: np.ndarray, angle: float) -> np.ndarray:
        along = tangent * (tangent @ vector)
        return along + math.cos(angle) * (vector - along) + math.sin(angle) * np.cross(tangent, vector)

    roll = rolling.material_spin_rad_s(0.01 * direction)
    assert roll * direction < 0
    assert abs(rolled(turned, roll) @ up) < 1e-15  # flat again
    assert abs(rolled(turned, -roll) @ up) > 0.01  # and not by rolling the other way
    velocity = rolling.rolling_velocity_m_s(roll, 0.01, 3.0 * tangent)
    assert velocity @ left == pytest.approx(direction * 0.01 * 0.01, rel=1e-12)
    assert (rolled(up, roll) - up) @ left * direction > 0  # the top of the section leads the way
    contact = velocity + np.cross(roll * tangent, -0.01 * up)
    assert np.allclose(contact, 0.0, atol=1e-18)


# --- friction


def test_non_slip_friction_is_the_one_a_rolling_cylinder_needs() -> None:
    mass, radius, moment, threshold = 0.05, 0.01, 2e-3, 5e-4
    # m a = f and M − M_th − f R = (m R²/2)(a/R), solved as two linear equations for f and a.
    matrix = np.array([[1.0, -mass], [radius, mass * radius / 2]])
    friction, _ = np.linalg.solve(matrix, [0.0, moment - threshold])
    assert rolling.non_slip_friction_N(moment, threshold, radius) == pytest.approx(friction, rel=1e-12)
    assert rolling.non_slip_friction_N(-moment, threshold, radius) == pytest.approx(-friction, rel=1e-12)


@pytest.mark.parametrize("moment", [0.0, 4e-4, -4e-4, 5e-4])
def test_below_the_threshold_moment_nothing_rolls(moment: float) -> None:
    assert rolling.non_slip_friction_N(moment, 5e-4, 0.01) == 0.0


@given(phi0=st.floats(1e-3, math.pi), moment=st.floats(-1.0, 1.0), threshold=st.floats(0.0, 0.5))
@settings(deadline=None, max_examples=100)
def test_flat_floor_friction_leaves_no_residual_in_the_papers_balance(
    phi0: float, moment: float, threshold: float
) -> None:
    friction = rolling.flat_floor_friction(rolling.non_slip_friction_N(moment, threshold, 0.01), phi0)
    residual = rolling.flat_floor_balance_N(friction, phi0, moment, threshold, 0.01)
    assert residual == pytest.approx(0.0, abs=1e-14 * max(1.0, 10 * abs(friction.rolling_N)))
    s = math.sin(phi0) / phi0
    assert friction.translation_N == pytest.approx(s * friction.rolling_N, rel=1e-12)


def test_read_without_its_hidden_division_the_friction_misses_the_papers_balance() -> None:
    phi0, moment, threshold, radius = 0.9, 2e-3, 5e-4, 0.01
    f = rolling.non_slip_friction_N(moment, threshold, radius)
    s = math.sin(phi0) / phi0
    as_printed = rolling.FlatFloorFriction(1.5 * f * (1 - s * s), s * 1.5 * f * (1 - s * s))
    missed = rolling.flat_floor_balance_N(as_printed, phi0, moment, threshold, radius)
    assert abs(missed) > 0.9 * 1.5 * f
    divided = rolling.flat_floor_friction(f, phi0)
    assert divided.rolling_N == pytest.approx(3 * f / (2 * (1 - s * s)), rel=1e-12)
    met = rolling.flat_floor_balance_N(divided, phi0, moment, threshold, radius)
    assert abs(met) < 1e-14


def test_flat_floor_friction_keeps_its_digits_where_one_minus_s_squared_cancels() -> None:
    phi0 = 1e-5
    # 1 − s² = φ₀²/3 − 2φ₀⁴/45 + …
    expected = 1.5 / (phi0**2 / 3 - 2 * phi0**4 / 45)
    assert rolling.flat_floor_friction(1.0, phi0).rolling_N == pytest.approx(expected, rel=1e-14)
    below, above = (rolling.flat_floor_friction(1.0, 1.0 + e).rolling_N for e in (-1e-13, 1e-13))
    assert below == pytest.approx(above, rel=1e-12)


# --- floating


@pytest.mark.parametrize(("curvature", "ratio"), [(12.0, 0.3238), (8.0, 0.5231)])
def test_floating_ratio_check_values(curvature: float, ratio: float) -> None:
    assert rolling.floating_ratio(0.15, 0.01, curvature) == pytest.approx(ratio, abs=5e-5)
    assert rolling.floating_ratio(0.15, 0.01, -curvature) == rolling.floating_ratio(0.15, 0.01, curvature)


@pytest.mark.parametrize("curvature", [1e-3, 0.1, 1.0, 5.0, 12.0, 13.3, 13.4, 25.0, 40.0])
def test_floating_ratio_closed_form_is_the_integral_of_the_inertia(curvature: float) -> None:
    from scipy.integrate import quad

    length, radius = 0.15, 0.01
    phi0 = curvature * length / 2
    s = math.sin(phi0) / phi0
    j_p = radius**2 / 2  # per unit line density

    def per_length(x: float) -> float:
        # y − ȳ = (cosφ − s)/κ, written without the cancellation of cosφ against s for slight bends
        one_minus_s = 1 - s if phi0 > 0.1 else phi0**2 / 6 - phi0**4 / 120 + phi0**6 / 5040 - phi0**8 / 362880
        y = (one_minus_s - 2 * math.sin(curvature * x / 2) ** 2) / curvature
        return y * y + j_p * math.cos(curvature * x) ** 2 + j_p / 2 * math.sin(curvature * x) ** 2

    inertia, _ = quad(per_length, -length / 2, length / 2, epsabs=0, epsrel=1e-13)
    expected = j_p * length * s / inertia
    assert rolling.floating_ratio(length, radius, curvature) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("curvature", [8.0, 12.0, 30.0])
def test_floating_ratio_leaves_no_angular_momentum_in_a_cloud_of_mass_points(curvature: float) -> None:
    """A rod of point masses: the bend turns at +1 rad/s in the body, the whole turns about the chord."""
    length, radius, step = 0.15, 0.01, 1e-5
    nodes, weights = np.polynomial.legendre.leggauss(40)
    arc = nodes * length / 2
    ring = 2 * math.pi * np.arange(4) / 4
    mass = np.repeat(weights / 2, 4) / 4
    omega = rolling.floating_ratio(length, radius, curvature)

    def points(t: float) -> np.ndarray:
        # In the plane of the C the centre line lies still: chord x, opening towards −y, and z = x × y.
        phi = curvature * arc
        centre = np.stack([np.sin(phi), np.cos(phi), 0 * phi], axis=-1) / curvature
        inward = np.stack([-np.sin(phi), -np.cos(phi), 0 * phi], axis=-1)
        tangent = np.stack([np.cos(phi), -np.sin(phi), 0 * phi], axis=-1)
        side = np.cross(tangent, inward)  # right-handed about the tangent from the inner side
        # The bend direction gains t in the body, so material points lose t against the plane of the C. A ring
        # of R/√2 has the second moments of the disc.
        angle = ring - t
        a = radius / math.sqrt(2)
        place = (
            centre[:, None, :]
            + a * np.cos(angle)[None, :, None] * inward[:, None, :]
            + a * np.sin(angle)[None, :, None] * side[:, None, :]
        ).reshape(-1, 3)
        place = place - mass @ place
        c, w = math.cos(omega * t), math.sin(omega * t)
        return place @ np.array([[1, 0, 0], [0, c, -w], [0, w, c]]).T

    velocity = (points(step) - points(-step)) / (2 * step)
    momentum = mass @ np.cross(points(0.0), velocity)
    own = radius**2 / 2  # of the material's own rolling at 1 rad/s, per unit mass
    assert np.max(np.abs(momentum)) < 1e-7 * own


def test_floating_limits_straight_rod_and_closed_circle() -> None:
    assert rolling.floating_ratio(0.15, 0.01, 0.0) == 1.0
    assert rolling.floating_ratio(0.15, 0.01, 1e-9) == pytest.approx(1.0, abs=1e-14)
    assert rolling.floating_ratio(1.0, 0.01, 2 * math.pi) == pytest.approx(0.0, abs=1e-15)


# --- advance on a floor


@pytest.mark.parametrize(
    ("half_bend", "ratio", "tolerance"),
    [
        (0.5, 0.9853, 5e-5),
        (0.9, 0.9428, 5e-5),
        (1.2, 0.8879, 5e-5),
        (0.7, 0.96812, 5e-6),
        (1.1, 0.90856, 5e-6),
    ],
)
def test_coulomb_advance_check_values(half_bend: float, ratio: float, tolerance: float) -> None:
    assert rolling.coulomb_advance_ratio(half_bend) == pytest.approx(ratio, abs=tolerance)
    assert rolling.coulomb_advance_ratio(-half_bend) == rolling.coulomb_advance_ratio(half_bend)


@pytest.mark.parametrize("half_bend", [1e-6, 1e-3, 0.05, 0.5, 0.9, 1.5, 2.0, 2.9])
def test_coulomb_advance_is_the_root_of_the_elliptic_closed_form(half_bend: float) -> None:
    """The integral is [(1 − v)E − (1 + v)F]/v at amplitude φ₀/2 and parameter −4v/(1 − v)²."""
    from scipy.special import ellipeinc, ellipkinc

    slip = 1 - rolling.coulomb_advance_ratio(half_bend)
    parameter = -4 * (1 - slip) / slip**2
    second = slip * ellipeinc(half_bend / 2, parameter)
    first = (2 - slip) * ellipkinc(half_bend / 2, parameter)
    # 1 − v has few digits left for the slightest bends.
    assert second == pytest.approx(first, rel=1e-12 + 1e-15 / slip)


@given(slip=st.floats(0.01, 1.0), half_bend=half_bends)
@settings(deadline=None, max_examples=50)
def test_coulomb_balance_is_the_sum_of_friction_directions_along_the_floor(slip: float, half_bend: float) -> None:
    from scipy.integrate import quad

    # Each contact slides with the translation v along y minus the rolling of its section along its normal.
    def resisted(phi: float) -> float:
        sliding = np.array([0.0, 1 - slip]) - np.array([math.sin(phi), math.cos(phi)])
        return float(sliding[1] / math.hypot(*sliding))

    expected, _ = quad(resisted, 0, half_bend, epsabs=1e-12, epsrel=1e-12, limit=400)
    assert rolling.coulomb_force_balance(slip, half_bend) == pytest.approx(expected, abs=1e-11)


def test_viscous_advance_check_value_and_force_balance() -> None:
    assert rolling.viscous_advance_ratio(0.9) == pytest.approx(0.8704, abs=5e-5)
    phi = np.linspace(-0.9, 0.9, 20001)
    v = rolling.viscous_advance_ratio(0.9)
    assert np.trapezoid(v - np.cos(phi), phi) == pytest.approx(0.0, abs=1e-8)


@given(half_bend=st.floats(1e-4, 3.1))
@settings(deadline=None, max_examples=50)
def test_coulomb_friction_advances_more_than_viscous_and_less_than_a_straight_roller(
    half_bend: float,
) -> None:
    assert rolling.viscous_advance_ratio(half_bend) < rolling.coulomb_advance_ratio(half_bend) < 1.0


def test_a_straight_body_advances_its_whole_circumference() -> None:
    assert rolling.coulomb_advance_ratio(0.0) == 1.0
    assert rolling.coulomb_advance_ratio(1e-9) == 1.0
    assert rolling.viscous_advance_ratio(0.0) == 1.0
    # 1 − v at the half bend below which 1 is returned outright is already under rounding.
    assert rolling.coulomb_advance_ratio(1.01e-8) == 1.0


# --- chambers


def test_a_chamber_bends_the_body_away_from_its_own_side() -> None:
    for chamber in range(4):
        bend = rolling.chamber_bend_direction_rad(chamber)
        assert math.cos(bend - chamber * math.pi / 2) == pytest.approx(-1.0)
        # so it lies on the outer side of its own C
        assert abs(rolling.chamber_theta_rad(chamber, bend)) == pytest.approx(math.pi)


def _nonnegative_pressures_reach(direction: float, dead: set[int]) -> bool:
    """Is the unit vector a nonnegative sum of the live chambers' bend vectors (−cos αᵢ, −sin αᵢ)?"""
    from scipy.optimize import nnls

    live = [i for i in range(4) if i not in dead]
    if not live:
        return False
    columns = np.array([[-math.cos(i * math.pi / 2), -math.sin(i * math.pi / 2)] for i in live]).T
    _, residual = nnls(columns, np.array([math.cos(direction), math.sin(direction)]))
    return bool(residual < 1e-9)


@pytest.mark.parametrize("mask", range(16))
def test_reachable_directions_are_those_of_nonnegative_pressures(mask: int) -> None:
    dead = {i for i in range(4) if mask >> i & 1}
    reachable = rolling.reachable_half_plane(dead)
    for direction in np.arange(-20, 21) * math.pi / 20:
        assert reachable.contains(float(direction)) == _nonnegative_pressures_reach(float(direction), dead)
    opposite = {(i + 2) % 4 for i in dead}
    kinds = {0: "plane", 1: "half plane", 3: "ray", 4: "none"}
    two = "line" if opposite == dead else "quarter plane"
    assert reachable.kind == kinds.get(len(dead), two)
    assert reachable.allows_rolling_by_reversal is (len(dead) < 2)


@pytest.mark.parametrize("dead", range(4))
def test_with_one_dead_chamber_the_roll_stops_at_a_quarter_turn_and_the_reversal_is_within_reach(
    dead: int,
) -> None:
    reachable = rolling.reachable_half_plane([dead, dead])
    edge = reachable.centre_rad + reachable.half_width_rad
    assert abs(rolling.chamber_theta_rad(dead, edge)) == pytest.approx(math.pi / 2)
    assert reachable.contains(edge)
    assert not reachable.contains(edge + 0.01)  # the sweep ends here
    assert reachable.contains(edge + math.pi)  # the exactly opposite C
    assert reachable.contains(edge + math.pi + 0.01)  # and from there the sweep goes on the same way


@given(angle=st.floats(-100.0, 100.0))
@settings(deadline=None, max_examples=50)
def test_wrapped_angle_is_the_same_angle_in_one_turn(angle: float) -> None:
    wrapped = rolling.wrap_angle_rad(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-12)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-12)
    assert rolling.wrap_angle_rad(-math.pi) == math.pi


# --- what is refused


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: rolling.rolling_moment_N_m(math.nan, 0.01, 0.9, 0.4),
        lambda: rolling.rolling_moment_N_m(1.0, -0.01, 0.9, 0.4),
        lambda: rolling.rolling_moment_N_m(1.0, 0.01, math.inf, 0.4),
        lambda: rolling.segmented_rolling_moment_N_m(1.0, 0.01, 0.9, 0.4, 0),
        lambda: rolling.segmented_rolling_moment_N_m(1.0, 0.01, 0.9, 0.4, 1.5),  # type: ignore[arg-type]
        lambda: rolling.rotation_moment_N_m(1.0, 0.01, 0.9, 0.4, True),
        lambda: rolling.rolling_direction(0.9, 0.4, "spring"),  # type: ignore[arg-type]
        lambda: rolling.bend_reverses(math.nan),
        lambda: rolling.rolling_velocity_m_s(1.0, 0.01, [0.0, 0.0, 1.0]),
        lambda: rolling.rolling_velocity_m_s(1.0, 0.01, [0.0, 0.0, 0.0]),
        lambda: rolling.rolling_velocity_m_s(1.0, 0.01, [1.0, 0.0]),
        lambda: rolling.rolling_velocity_m_s(1.0, 0.01, ["x", "y", "z"]),
        lambda: rolling.non_slip_friction_N(1.0, -0.1, 0.01),
        lambda: rolling.non_slip_friction_N(1.0, 0.1, 0.0),
        lambda: rolling.flat_floor_friction(1.0, 0.0),
        lambda: rolling.flat_floor_friction(1.0, 1e-160),
        lambda: rolling.flat_floor_friction(1.0, 3.2),
        lambda: rolling.floating_ratio(0.0, 0.01, 12.0),
        lambda: rolling.floating_ratio(0.15, math.nan, 12.0),
        lambda: rolling.floating_ratio(0.15, 0.01, 42.0),
        lambda: rolling.viscous_advance_ratio(math.pi),
        lambda: rolling.coulomb_advance_ratio(math.pi),
        lambda: rolling.coulomb_advance_ratio(math.nan),
        lambda: rolling.coulomb_force_balance(0.0, 0.9),
        lambda: rolling.coulomb_force_balance(1.1, 0.9),
        lambda: rolling.reachable_half_plane([4]),
        lambda: rolling.reachable_half_plane([-1]),
        lambda: rolling.chamber_theta_rad(0, math.nan),
        lambda: rolling.chamber_angle_rad(1.0),  # type: ignore[arg-type]
    ],
)
def test_values_out_of_range_are_refused(wrong: Callable[[], object]) -> None:
    with pytest.raises(InputError):
        wrong()


# --- the page of the relations


def test_every_function_that_the_physics_page_names_exists() -> None:
    page = (Path(__file__).parents[2] / "docs" / "physics.md").read_text(encoding="utf-8")
    named = re.findall(r"`(tube|rolling)\.([A-Za-z_0-9]+)`", page)
    assert len(named) > 20
    missing = [
        f"{module}.{name}" for module, name in named if not hasattr({"tube": tube, "rolling": rolling}[module], name)
    ]
    assert missing == []
