"""Which twin a scene gets, and steps that fit the control period."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim.body import Body
from sim.bullet import BulletTwin
from sim.plan import BULLET, make_plan
from sim.rod import RodTwin
from sim.rod_among_bodies import RodAmongBodies
from sim.scene import CONTROL_PERIOD_S, scene_from, steps_per_period
from sim.twins import chosen_step_s, make_twin
from softbot.errors import InputError


@pytest.mark.parametrize("step_s", [0.01, 0.005, 0.0025, 0.002, 0.001, 0.01 / 3, 1e-4])
def test_step_that_divides_the_control_period_is_taken(step_s: float) -> None:
    assert steps_per_period(step_s) * step_s == pytest.approx(CONTROL_PERIOD_S)


@pytest.mark.parametrize("step_s", [0.025, 0.011, 0.004, 0.003, 0.0024])
def test_step_that_does_not_is_refused_with_some_that_do(step_s: float) -> None:
    with pytest.raises(InputError, match=r"solver\.step_s = .*must divide the control period of 0\.01 s; take 0\.01"):
        steps_per_period(step_s)


def test_every_accuracy_of_the_segment_twin_has_a_step_that_fits_and_refines() -> None:
    steps = [steps_per_period(BULLET[accuracy][0]) for accuracy in ("fast", "standard", "reference")]
    assert steps == sorted(steps)


@pytest.mark.parametrize(("accuracy", "kind"), [("fast", "curvature"), ("standard", "pressure")])
def test_accuracy_chooses_step_and_segments_and_stretch_follows_the_drive(
    scene_table: dict[str, Any], accuracy: str, kind: str
) -> None:
    scene_table["drive"] = {"kind": kind, "curvature_1_m": 5.0, "peak_pressure_Pa": 1e3}
    scene_table["solver"]["accuracy"] = accuracy
    twin = make_twin(scene_from(scene_table, "s.toml", Path()))
    step_s, segments = BULLET[accuracy]
    assert isinstance(twin, BulletTwin)
    assert twin.step_s == step_s
    joints = segments - 1 if kind == "curvature" else 2 * segments - 1
    assert len(twin.shape()[0]) == joints + 2
    twin.close()


@pytest.mark.parametrize(("accuracy", "kind"), [("fast", "curvature"), ("standard", "pressure")])
def test_scene_for_the_rod_gets_a_rod_of_that_accuracy(scene_table: dict[str, Any], accuracy: str, kind: str) -> None:
    scene_table["drive"] = {"kind": kind, "curvature_1_m": 5.0, "peak_pressure_Pa": 1e3}
    scene_table["solver"] = {"twin": "rod", "accuracy": accuracy}
    twin = make_twin(scene_from(scene_table, "s.toml", Path()))
    assert isinstance(twin, RodTwin)
    plan = make_plan(scene_from(scene_table, "s.toml", Path()))
    assert plan.resolution is not None
    assert twin.step_s == plan.step_s == chosen_step_s(plan.scene)
    assert len(twin.points()[0]) == plan.resolution.contact_points // 2  # of one half: the other is its mirror image
    twin.close()
    scene_table["solver"]["step_s"] = 0.003
    with pytest.raises(InputError, match="must divide"):
        make_twin(scene_from(scene_table, "s.toml", Path()))


def test_solver_keys_override_what_accuracy_chooses(scene_table: dict[str, Any]) -> None:
    scene_table["solver"].update(step_s=0.002, segments=6)
    twin = make_twin(scene_from(scene_table, "s.toml", Path()))
    assert twin.step_s == 0.002
    assert len(twin.shape()[0]) == 7
    twin.close()
    scene_table["solver"]["step_s"] = 0.003
    with pytest.raises(InputError, match="must divide"):
        make_twin(scene_from(scene_table, "s.toml", Path()))


def test_window_is_for_the_segment_twin_alone(scene_table: dict[str, Any]) -> None:
    scene_table["solver"]["twin"] = "rod"
    with pytest.raises(InputError, match=r'add --set solver\.twin="bullet"'):
        make_twin(scene_from(scene_table, "s.toml", Path()), gui=True)


def test_body_takes_its_stiffness_from_the_robot(scene_table: dict[str, Any]) -> None:
    robot = scene_from(scene_table, "s.toml", Path()).robot
    body = Body.of(robot)
    np.testing.assert_array_equal(
        body.rest_stiffness(), np.diag([robot.axial_stiffness, robot.bending_stiffness, robot.bending_stiffness])
    )
    assert (body.length_m, body.radius_m, body.mass_kg) == (robot.length_m, robot.radius_m, robot.mass_kg)


def test_a_window_without_a_screen_is_refused(scene_table: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(InputError, match="no screen"):
        make_twin(scene_from(scene_table, "s.toml", Path()), gui=True)
    scene_table["solver"]["twin"] = "rod"
    with pytest.raises(InputError, match="only the segment twin has a window"):
        make_twin(scene_from(scene_table, "s.toml", Path()), gui=True)


def test_a_drive_too_fast_for_the_step_is_refused(scene_table: dict[str, Any]) -> None:
    scene_table["drive"]["period_s"] = 0.02
    with pytest.raises(InputError, match=r"drive\.period_s = 0\.02: .* fewer than 20 steps"):
        make_twin(scene_from(scene_table, "s.toml", Path()))
    scene_table["solver"]["step_s"] = 0.001
    make_twin(scene_from(scene_table, "s.toml", Path())).close()


def test_a_rod_with_other_bodies_is_whole_and_among_them(scene_table: dict[str, Any]) -> None:
    box = {"kind": "box", "size_m": [0.03, 0.03, 0.03], "mass_kg": 0.05, "position_m": [0.0, 0.2]}
    scene_table.update(solver={"twin": "rod"}, body=[box])
    twin = make_twin(scene_from(scene_table, "s.toml", Path()))
    assert isinstance(twin, RodAmongBodies)
    centre, _, _ = twin.rod.points()
    assert centre[:, 0].min() < 0.0 < centre[:, 0].max()
    twin.close()


def test_a_rule_can_be_switched_off(scene_table: dict[str, Any]) -> None:
    scene_table["solver"]["twin"] = "rod"
    scene = scene_from(scene_table, "s.toml", Path())
    half, whole = make_twin(scene), make_twin(scene, keep=("mirror",))
    assert isinstance(half, RodTwin)
    assert isinstance(whole, RodTwin)
    assert 2 * len(half.points()[0]) == len(whole.points()[0])
