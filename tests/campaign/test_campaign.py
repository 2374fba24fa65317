"""A campaign file becomes runs: each from its number alone, mismatch on the simulated robot only, errors by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softbot.campaign.campaign import Draws, load_campaign
from softbot.errors import InputError

Make = Callable[..., Draws]
SHIPPED = sorted((Path(__file__).parents[2] / "campaigns").glob("*.toml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_a_shipped_campaign_draws_runs(path: Path) -> None:
    draws = load_campaign(path)
    kinds = {fault.kind for n in range(40) for fault in draws.run(n).scene.fault}
    assert draws.campaign.name == path.stem
    assert (len(kinds) == 0) == (path.stem == "healthy")


def test_a_run_follows_from_its_number_alone(make_draws: Make) -> None:
    forwards, backwards = make_draws(), make_draws()
    first = [forwards.run(number) for number in range(6)]
    again = [backwards.run(number) for number in reversed(range(6))][::-1]
    assert [run.scene for run in first] == [run.scene for run in again]
    assert [run.values for run in first] == [run.values for run in again]
    assert len({run.scene.solver.seed for run in first}) == 6


def test_another_seed_gives_other_runs(make_draws: Make) -> None:
    assert make_draws().run(0).scene != make_draws("seed=4").run(0).scene


def test_what_varies_is_known_to_the_controller_and_a_mismatch_is_not(make_draws: Make) -> None:
    draws = make_draws(vary={"robot.length_m": {"low": 0.1, "high": 0.2}})
    run = draws.run(1)
    assert run.known.length_m == run.scene.robot.length_m == run.values["robot.length_m"]
    factor = run.values["mismatch.robot.actuator.modulus_Pa"]
    assert run.scene.robot.actuator is not None
    assert run.known.actuator is not None
    assert run.scene.robot.actuator.modulus_Pa == pytest.approx(factor * run.known.actuator.modulus_Pa)
    four = run.values["mismatch.robot.pneumatics.supply_valve_conductance_m3_s_Pa"]
    known, real = (
        np.array(robot.pneumatics.supply_valve_conductance_m3_s_Pa) for robot in (run.known, run.scene.robot)
    )
    np.testing.assert_allclose(real, known * four)
    assert len(set(four)) == 4


def test_cases_come_in_their_weights_and_bring_their_faults(make_draws: Make) -> None:
    runs = [make_draws().run(number) for number in range(200)]
    ruptured = [run for run in runs if run.case == "rupture"]
    assert len(ruptured) == pytest.approx(150, abs=20)
    assert all(len(run.scene.fault) == 1 for run in ruptured)
    assert {run.scene.fault[0].chamber for run in ruptured} == {0, 1, 2, 3}
    assert all(not run.scene.fault for run in runs if run.case == "healthy")


def test_a_case_may_vary_what_others_do_not(make_draws: Make) -> None:
    draws = make_draws(case=[{"name": "slow", "vary": {"sequencer.speed_rev_s": {"low": 0.1, "high": 0.2}}}])
    assert 0.1 <= (draws.run(0).scene.sequencer.speed_rev_s or 0.0) <= 0.2
    assert "sequencer.speed_rev_s" in draws.keys


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"runs": 0}, "runs = 0"),
        ({"mismatch": {"robot.actuator.law": {"low": 1.0, "high": 1.0}}}, "is no number"),
        ({"mismatch": {"robot.engine.power_W": {"low": 1.0, "high": 1.0}}}, "no such key"),
        ({"vary": {"world.fraction": 0.5}}, "fraction: unknown key; did you mean friction"),
        ({"vary": {"world.friction": {"low": 2.0, "high": 1.0}}}, "exchange them"),
        ({"case": [{"name": "a"}, {"name": "a"}]}, "two are called 'a'"),
        ({"case": [{"name": "a", "fault": [{"kind": "explosion", "chamber": 0, "t_s": 1.0}]}]}, "explosion"),
        ({"case": [{"name": "a", "fault": [{"kind": "rupture", "t_s": 1.0}]}]}, "chamber: missing"),
        ({"scene": {"robot": "default", "drive": {"kind": "pressure", "peak_pressure_Pa": 1e4}}}, "runs the sequencer"),
    ],
)
def test_a_campaign_that_makes_no_sense_is_refused_by_name(make_draws: Make, changes: Any, message: str) -> None:
    with pytest.raises(InputError, match=message) as refused:
        make_draws(**changes)
    assert "short.toml" in str(refused.value)
