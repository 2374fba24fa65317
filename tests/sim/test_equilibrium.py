"""Where a bent robot comes to rest: against the elastica, against motion, and where there is no rest."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim import motion_rows
from sim.body import Body, World
from sim.equilibrium import Equilibrium, equilibrium, rest_strains, run_equilibrium
from sim.recorder import Recorder
from sim.rod import RodTwin
from sim.scene import Scene, scene_from
from sim.twins import make_twin
from softbot.elastica import heavy_cantilever
from softbot.errors import SimulationError

FLOOR = World(gravity_m_s2=9.81, ground="plane", friction=0.6, friction_law="coulomb")


@pytest.fixture
def table(scene_table: dict[str, Any]) -> dict[str, Any]:
    """A bend on the floor, whose rest is asked for."""
    scene_table["solver"] = {"twin": "rod", "question": "equilibrium", "duration_s": 9.0}
    return scene_table


def solved(table: dict[str, Any]) -> tuple[Scene, RodTwin, Equilibrium]:
    asked = scene_from(table, "s.toml", Path())
    rod = make_twin(asked)
    assert isinstance(rod, RodTwin)
    held = asked.world.ground != "none"
    return asked, rod, equilibrium(rod, rest_strains(asked), Body.of(asked.robot), held=held)


def bend_rad(found: Equilibrium, scene: Scene) -> float:
    return float(np.linalg.norm(found.row[motion_rows.CURVATURE])) * scene.robot.length_m


def test_a_robot_at_rest_is_still_at_rest_when_time_goes_on(table: dict[str, Any]) -> None:
    asked, rod, found = solved(table)
    moving = RodTwin(
        Body.of(asked.robot), FLOOR, modes=3, contact_points=12, step_s=0.005, stretches=False, symmetric=True
    )
    for part in range(1, 401):
        moving.set_rest(*rest_strains(asked)(min(part / 200, 1.0)))
        moving.advance(2)
    row = moving.row()
    assert bend_rad(found, asked) == pytest.approx(
        float(np.linalg.norm(row[motion_rows.CURVATURE])) * asked.robot.length_m, rel=0.005
    )
    assert found.row[motion_rows.ENERGY] == pytest.approx(row[motion_rows.ENERGY], rel=0.005)
    before = rod.row()[motion_rows.CENTRE_OF_MASS]
    rod.advance(50)
    np.testing.assert_allclose(rod.row()[motion_rows.CENTRE_OF_MASS], before, atol=1e-6)


def test_a_hanging_rod_is_the_elastica() -> None:
    """Two cantilevers under their own weight, clamped in the middle."""
    body = Body(0.15, 0.002, 0.0051, 8e-5, 6e-5, 300.0, 0.02)
    aloft = World(gravity_m_s2=9.81, ground="none", friction=0.0, friction_law="coulomb")
    rod = RodTwin(body, aloft, modes=7, contact_points=24, step_s=0.2, stretches=False, symmetric=True, clamped=True)
    straight = np.array([1.0, 0.0, 0.0])
    found = equilibrium(rod, lambda _: (straight, body.rest_stiffness()), body, held=True, tolerance=1e-9, parts=1)
    line_N_m = body.mass_kg / body.length_m * 9.81
    tip = heavy_cantilever(0.5 * body.length_m, body.bending_stiffness_N_m2, line_N_m)
    np.testing.assert_allclose(rod.shape()[0][-1, [0, 2]], [tip.reach_m, -tip.drop_m], atol=1e-4 * 0.5 * body.length_m)
    assert found.iterations < 60


def test_a_bend_afloat_is_the_one_that_is_asked_for(table: dict[str, Any]) -> None:
    table["world"] = {"ground": "none"}
    asked, _, found = solved(table)
    assert bend_rad(found, asked) == pytest.approx(12.0 * 0.15, rel=1e-4)
    assert found.residual <= 1e-5


def test_friction_keeps_a_part_of_the_bend_and_a_dead_chamber_more(table: dict[str, Any]) -> None:
    asked, _, found = solved(table)
    assert 0.9 * 1.8 < bend_rad(found, asked) < 1.8
    table["fault"] = [{"t_s": 1.0, "chamber": 2, "kind": "rupture", "severity": 0.5}]
    asked, _, less = solved(table)
    assert bend_rad(less, asked) == pytest.approx(0.5 * bend_rad(found, asked), rel=0.05)


def test_pressures_elongate_the_robot_and_bend_it(table: dict[str, Any]) -> None:
    table["robot"], table["drive"] = "default", {"kind": "pressure", "peak_pressure_Pa": 60e3}
    asked, rod, found = solved(table)
    assert found.row[motion_rows.STRETCH] > 1.01
    law = asked.robot.actuator_law().equilibrium([0.0, 0.0, 60e3, 0.0])
    wanted = math.hypot(*law.curvature_1_m) * asked.robot.length_m
    assert bend_rad(found, asked) == pytest.approx(wanted, rel=0.02)
    assert rod.strain()[0] == pytest.approx(law.stretch, rel=0.01)


def test_a_robot_that_slides_for_ever_has_no_rest(table: dict[str, Any]) -> None:
    table["world"] = {"slope_rad": 0.5, "friction": 0.1, "slope_heading_rad": 0.0}
    with pytest.raises(SimulationError, match="slide or roll on for ever"):
        solved(table)


def test_a_rest_is_recorded_as_a_run_of_one_sample(table: dict[str, Any], tmp_path: Path) -> None:
    asked = scene_from(table, "s.toml", Path())
    rod = make_twin(asked)
    assert isinstance(rod, RodTwin)
    summary, telemetry = run_equilibrium(asked, rod, Recorder(asked, tmp_path / "run"), tmp_path / "run")
    assert telemetry.num_rows == 1
    assert telemetry.column("state")[0].as_py() == "resting"
    assert telemetry.column("t_s")[0].as_py() == 0.0
    assert summary["outcome"] == "done"
    assert summary["sim_time_s"] == 0.0
    assert summary["equilibrium"]["iterations"] == summary["steps"] > 3
    assert summary["equilibrium"]["residual"] <= 1e-5
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["equilibrium"] == summary["equilibrium"]


def test_a_search_that_fails_is_recorded_as_failed(table: dict[str, Any], tmp_path: Path) -> None:
    table["world"] = {"slope_rad": 0.5, "friction": 0.1, "slope_heading_rad": 0.0}
    asked = scene_from(table, "s.toml", Path())
    rod = make_twin(asked)
    assert isinstance(rod, RodTwin)
    with pytest.raises(SimulationError):
        run_equilibrium(asked, rod, Recorder(asked, tmp_path / "run"))
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["outcome"].startswith("failed: no rest")


def test_the_way_in_parts_matters_only_where_friction_holds() -> None:
    body = Body(0.15, 0.01, 0.0518, 3.93e-3, 2.62e-3, 157.0, 0.02)
    energy = []
    for friction in (0.0, 0.6):
        for parts in (1, 8):
            rod = RodTwin(
                body,
                replace(FLOOR, friction=friction),
                modes=3,
                contact_points=12,
                step_s=0.2,
                stretches=False,
                symmetric=True,
            )
            found = equilibrium(
                rod,
                lambda share: (np.array([1.0, 12.0 * share, 0.0]), body.rest_stiffness()),
                body,
                held=friction > 0.0,
                parts=parts,
            )
            energy.append(float(found.row[motion_rows.ENERGY]))
    assert energy[0] == pytest.approx(energy[1], abs=1e-9)
    assert energy[2] == pytest.approx(energy[3], rel=0.02)
    assert energy[2] != pytest.approx(energy[3], rel=1e-6)
