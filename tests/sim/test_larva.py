"""The larva as a robot of a scene: what it is asked, what it does, and what an ablated muscle takes from it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim.body import Body, World
from sim.drive import without_chamber
from sim.rod import RodTwin
from sim.run import RunResult, simulate
from sim.scene import Scene, load_scene, scene_from
from softbot.errors import InputError
from softbot.muscle import linear_rest_curvature_1_m
from softbot.robot import Actuation, load_robot
from softbot.rolling import coulomb_advance_ratio, rolling_direction
from softbot.toml_file import write_toml
from softbot.tube import curvature_from_strain_difference, max_strain_difference

SCENE = Path(__file__).parents[2] / "scenes" / "larva.toml"
WALL = {"wall_thickness_m": 30e-6, "youngs_modulus_Pa": 2.5e6, "scaled_pressure": 3.3}
LARVA: dict[str, Any] = {
    "robot": "larva",
    "drive": {"kind": "contraction", "contraction": 0.25, "lead_rad": 0.8, "lag_s": 0.2},
    "solver": {"twin": "rod", "duration_s": 5.0},
}


def make(table: dict[str, Any], *assignments: str) -> Scene:
    return scene_from(table, "scene.toml", Path(), assignments)


def test_body_of_the_larva_ovalises_and_that_of_a_plain_robot_does_not(robot_table: dict[str, Any]) -> None:
    larva = load_robot("larva")
    body = Body.of(larva)
    assert body.bending_stiffness_N_m2 == larva.bending_stiffness
    assert 1.0 / math.sqrt(3.0 * body.ovalisation_m2) == pytest.approx(math.sqrt(8 * 3.3 / 9) / larva.radius_m)
    plain = make({"robot": robot_table, "drive": {"kind": "curvature", "curvature_1_m": 1.0}})
    assert Body.of(plain.robot).ovalisation_m2 == 0.0


def test_scene_of_the_larva_survives_the_way_through_a_file(tmp_path: Path) -> None:
    scene = make(LARVA)
    path = tmp_path / "scene.toml"
    write_toml(path, scene.table())
    assert make({**LARVA, "robot": scene.table()["robot"]}) == scene
    assert scene.robot == load_robot("larva")


@pytest.mark.parametrize(
    ("assignment", "says"),
    [
        ('drive={kind="pressure", peak_pressure_Pa=1e3}', 'drive.kind = "pressure": presses chambers'),
        ('drive={kind="sequencer"}', 'drive.kind = "sequencer": presses chambers'),
        ('solver.twin="bullet"', "its segments do not ovalise"),
        ("drive.contraction=0.9", "more than a full circle, or folds its inner side; stay below 0.756"),
        ('drive={kind="contraction"}', "contraction: missing"),
    ],
)
def test_what_muscles_cannot_do_is_refused_with_the_mend(assignment: str, says: str) -> None:
    with pytest.raises(InputError) as refusal:
        make(LARVA, assignment)
    assert str(refusal.value).startswith("scene.toml: ")
    assert says in str(refusal.value)


def test_a_contraction_needs_a_wall_and_chambers_may_have_one(robot_table: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"follows from the wall; give the robot a \[tube\]"):
        make({**LARVA, "robot": robot_table})
    walled = {**robot_table, "tube": WALL}
    del walled["bending_stiffness_N_m2"]
    assert make({**LARVA, "robot": walled}).robot.actuation == "chamber"


def test_a_tube_that_kinks_before_it_closes_may_be_driven_past_its_kink() -> None:
    slack = make(LARVA, "robot.tube.scaled_pressure=0.1", "drive.contraction=5.0")
    assert slack.robot.kink_curvature_1_m < 2.0 * math.pi / slack.robot.length_m


def test_largest_contraction_of_a_scene_closes_the_circle() -> None:
    make(LARVA, "drive.contraction=0.7551")
    closed = curvature_from_strain_difference(0.7556, 3.3, 0.5) / 300e-6 * 4e-3
    assert closed == pytest.approx(2.0 * math.pi, rel=1e-3)
    with pytest.raises(InputError, match=r"stay below 1\.46"):  # of a stubby tube it folds the inner side
        make(LARVA, "robot.radius_m=1e-3", "drive.contraction=1.47")


@pytest.mark.parametrize("chamber", range(4))
def test_an_ablated_muscle_takes_what_bends_towards_it_and_a_dead_chamber_what_bends_away(chamber: int) -> None:
    towards = np.array([math.cos(0.5 * math.pi * chamber), math.sin(0.5 * math.pi * chamber)])
    across = np.array([-towards[1], towards[0]])
    wanted = 3.0 * towards + 2.0 * across
    np.testing.assert_allclose(without_chamber(wanted, chamber, 1.0, "muscle"), 2.0 * across, atol=1e-12)
    np.testing.assert_allclose(without_chamber(wanted, chamber, 1.0, "chamber"), wanted, atol=1e-12)
    np.testing.assert_allclose(without_chamber(-wanted, chamber, 1.0, "muscle"), -wanted, atol=1e-12)
    np.testing.assert_allclose(without_chamber(-wanted, chamber, 0.5), -1.5 * towards - 2.0 * across, atol=1e-12)


# --- what it does, on the rod ------------------------------------------------------------


def run(*assignments: str) -> RunResult:
    return simulate(load_scene(SCENE, assignments))


def steady(result: RunResult, name: str) -> np.ndarray:
    column: np.ndarray = result.telemetry.column(name).to_numpy()
    return column[result.telemetry.column("t_s").to_numpy() > 1.5]


@pytest.fixture(scope="module")
def rolls() -> dict[tuple[str, float], RunResult]:
    """The larva and a robot of the same tube with chambers, the bend led to either side."""
    return {
        (actuation, lead): run(f"robot.actuation={actuation}", f"drive.lead_rad={lead}")
        for actuation in ("muscle", "chamber")
        for lead in (0.8, -0.8)
    }


def test_larva_rolls_towards_and_away_from_the_opening_of_its_c(rolls: dict[tuple[str, float], RunResult]) -> None:
    for lead, sign in ((0.8, 1), (-0.8, -1)):
        summary = rolls["muscle", lead].summary
        assert set(steady(rolls["muscle", lead], "c_bend_side")) == {1}  # open to its left all the while
        assert sign * summary["displacement_m"][1] > 10 * 300e-6 * 0.8  # to its left: towards the opening
        assert sign * summary["revolutions"] < -1.5


def test_larva_and_robot_roll_opposite_ways_for_the_same_side_of_their_active_element(
    rolls: dict[tuple[str, float], RunResult],
) -> None:
    """θ of what is active, from the inner side: the same sign of its sine, opposite revolutions, as Eq. (1) has it."""
    ways: dict[tuple[Actuation, int], float] = {}
    for (actuation, _), result in rolls.items():
        theta = steady(result, "theta_rad")
        assert np.ptp(theta) < 1e-6
        kind: Actuation = "muscle" if actuation == "muscle" else "chamber"
        turned = result.summary["revolutions"]
        assert math.copysign(1, turned) == rolling_direction(0.5 * result.summary["bend_rad"], float(theta[0]), kind)
        ways[kind, round(math.copysign(1, math.sin(theta[0])))] = turned
    for side in (1, -1):
        assert ways["muscle", side] * ways["chamber", side] < 0.0


@pytest.mark.parametrize(("accuracy", "target"), [("standard", 5e-3), ("reference", 5e-4)])
def test_larva_is_light_and_stiff_so_it_gets_on_as_the_friction_balance_says(accuracy: str, target: float) -> None:
    summary = run(f"solver.accuracy={accuracy}").summary
    ratio = summary["advance_per_revolution_m"] / (2.0 * math.pi * 300e-6)
    assert ratio == pytest.approx(coulomb_advance_ratio(0.5 * summary["bend_rad"]), rel=target)


def test_larva_rolls_as_fast_as_the_lag_of_its_muscles_and_the_damping_of_its_wall_let_it() -> None:
    """Where inertia is nothing, ω τ = tan(lead − arctan(ω τ_d)): the bend trails the pull, the pull the command."""
    lag_s, damping_s, tangent = 0.2, 0.02, math.tan(0.8)
    square, linear = tangent * lag_s * damping_s, lag_s + damping_s
    rate_rad_s = (math.sqrt(linear**2 + 4.0 * square * tangent) - linear) / (2.0 * square)
    summary = run("solver.step_s=0.001").summary
    assert -2.0 * math.pi * summary["revolutions"] / summary["steady_span_s"] == pytest.approx(rate_rad_s, rel=5e-3)
    size_1_m = linear_rest_curvature_1_m(load_robot("larva").thin_tube(), 0.25)  # type: ignore[arg-type]
    trailing = math.atan(rate_rad_s * damping_s)
    linear_bend_rad = size_1_m * 4e-3 * math.cos(0.8 - trailing) * math.cos(trailing)
    assert summary["bend_rad"] == pytest.approx(linear_bend_rad, rel=5e-3)  # ovalisation adds 0.15 %


@pytest.mark.parametrize(("lead", "side"), [(0.8, 2), (0.8, 3), (-0.8, 2), (-0.8, 1)])
def test_larva_stops_when_its_ablated_muscles_come_to_a_right_angle_from_the_inner_side(lead: float, side: int) -> None:
    right_angle = math.copysign(0.5 * math.pi, lead)
    result = run(
        f"drive.lead_rad={lead}", f"fault=[{{t_s=2.0, chamber={side}, kind='rupture'}}]", "solver.duration_s=6"
    )
    assert np.ptp(steady(result, "roll_rad")[-50:]) < 1e-4
    theta = 0.5 * math.pi * side - steady(result, "bend_direction_rad")[-1]
    assert math.remainder(theta - right_angle, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-3)
    assert steady(result, "bend_rad")[-1] == pytest.approx(2.03 * math.cos(0.8), abs=0.01)  # bent still
    (stall,) = result.summary["stalls"]
    assert stall["chamber"] == side
    assert stall["theta_rad"] == pytest.approx(right_angle, abs=0.02)


@pytest.mark.parametrize(("share", "kinks"), [(0.95, False), (1.05, True)])
def test_rod_kinks_where_the_contraction_passes_the_papers_limit(share: float, kinks: bool) -> None:
    larva = load_robot("larva").model_copy(update={"length_m": 1e-3})
    tube = larva.thin_tube()
    assert tube is not None
    body = Body.of(larva)
    rod = RodTwin(body, World(0.0, "none", 0.0, "coulomb"), modes=1, contact_points=4, step_s=1e-3, stretches=False)
    contraction = share * max_strain_difference(3.3, 0.5)
    rod.set_rest(np.array([1.0, linear_rest_curvature_1_m(tube, contraction), 0.0]), body.rest_stiffness())
    rod.advance(1000)
    assert (rod.kinked_at_s is not None) == kinks
    if not kinks:
        kappa = curvature_from_strain_difference(contraction, 3.3, 0.5)
        assert rod.strain()[1] * larva.radius_m == pytest.approx(kappa, rel=1e-4)
