"""What a scene does without: each rule's condition, and that leaving out changes no result beyond the target."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim.convergence import relative_errors
from sim.motion_rows import ASLEEP, CENTRE_OF_MASS, ROTATION
from sim.plan import BULLET, RULES, Plan, make_plan, twist_error
from sim.resolution import TARGETS
from sim.rod import RodTwin
from sim.rod_drive import drive_array
from sim.run import simulate
from sim.scene import Scene, scene_from
from sim.twins import make_twin
from softbot.errors import InputError
from softbot.rolling import floating_ratio


@pytest.fixture
def table(scene_table: dict[str, Any]) -> dict[str, Any]:
    """A short roll on the rod."""
    scene_table["solver"] = {"twin": "rod", "duration_s": 2.0}
    scene_table["metrics"] = {"steady_after_s": 1.0}
    return scene_table


def scene(table: dict[str, Any], **changes: Any) -> Scene:
    """The scene with `world__ground = …` laid over it."""
    tables = {key: dict(value) if isinstance(value, dict) else value for key, value in table.items()}
    for key, value in changes.items():
        group, name = key.split("__")
        tables.setdefault(group, {})[name] = value
    return scene_from(tables, "s.toml", Path())


def left_out(plan: Plan) -> set[str]:
    return {decision.name for decision in plan.decisions if decision.left_out}


# --- conditions -------------------------------------------------------------------------------------------------------


def test_a_given_bend_on_a_floor_needs_neither_gas_nor_sensors_nor_length_nor_its_other_half(
    table: dict[str, Any],
) -> None:
    found = left_out(make_plan(scene(table)))
    assert {"mirror", "stretch", "sleep", "pneumatics", "sensors", "bodies"} <= found
    assert not {"contact", "dynamics", "logs"} & found


def test_a_robot_under_pressure_needs_gas_sensors_and_its_length(table: dict[str, Any]) -> None:
    table["drive"] = {"kind": "pressure", "peak_pressure_Pa": 1e3}
    table["metrics"] = {"steady_after_s": 1.9}
    found = left_out(make_plan(scene(table)))
    assert not {"stretch", "pneumatics", "sensors"} & found
    assert "mirror" in found  # chambers act alike along the tube


def test_a_floating_robot_needs_no_ground_and_does_not_sleep(table: dict[str, Any]) -> None:
    found = left_out(make_plan(scene(table, world__ground="none")))
    assert "contact" in found
    assert "sleep" not in found
    assert "sleep" not in left_out(make_plan(scene(table, robot__damping_time_s=0.0)))


@pytest.mark.parametrize(
    ("heading_rad", "mirrored"),
    [(math.pi / 2, True), (-math.pi / 2, True), (0.0, False), (math.pi, False), (1.2, False)],
)
def test_one_half_stands_for_the_tube_only_where_the_slope_is_across_it(
    table: dict[str, Any], heading_rad: float, mirrored: bool
) -> None:
    plan = make_plan(scene(table, world__slope_rad=0.1, world__slope_heading_rad=heading_rad))
    assert plan.leaves_out("mirror") is mirrored
    assert make_plan(scene(table, world__slope_rad=0.0, world__slope_heading_rad=heading_rad)).leaves_out("mirror")


@pytest.mark.parametrize(("ground", "axis"), [("step", "across"), ("pipe", "across"), ("pipe", "along")])
def test_steps_and_pipes_are_mirror_images_but_may_twist_the_tube(
    table: dict[str, Any], ground: str, axis: str
) -> None:
    plan = make_plan(scene(table, world__ground=ground, world__pipe_axis=axis))
    assert plan.leaves_out("mirror")
    assert not plan.leaves_out("twist")


def test_other_bodies_make_the_whole_tube_needed(table: dict[str, Any]) -> None:
    box = {"kind": "box", "size_m": [0.03, 0.03, 0.03], "mass_kg": 0.05, "position_m": [0.0, 0.2]}
    table["body"] = [box]
    found = left_out(make_plan(scene(table)))
    assert not {"mirror", "twist", "sleep", "bodies"} & found


def test_the_twist_is_kept_where_the_target_is_tight_or_the_tube_is_weak_in_twist(table: dict[str, Any]) -> None:
    assert make_plan(scene(table, solver__accuracy="fast")).leaves_out("twist")
    assert not make_plan(scene(table, solver__accuracy="reference")).leaves_out("twist")
    weak = make_plan(scene(table, solver__accuracy="fast", robot__twisting_stiffness_N_m2=2e-5))
    assert not weak.leaves_out("twist")


def test_every_rule_says_why_and_what_it_saves(table: dict[str, Any]) -> None:
    plan = make_plan(scene(table))
    assert [decision.name for decision in plan.decisions] == [rule.name for rule in RULES]
    assert all(decision.reason and decision.saves for decision in plan.decisions)
    assert len({rule.name for rule in RULES}) == len(RULES)


def test_a_rule_that_is_kept_is_not_applied_and_an_unknown_one_is_refused(table: dict[str, Any]) -> None:
    plan = make_plan(scene(table), keep=("mirror",))
    assert not plan.leaves_out("mirror")
    assert plan.leaves_out("stretch")
    with pytest.raises(InputError, match="mirth"):
        make_plan(scene(table), keep=("mirth",))


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"solver__twin": "bullet"}, "only the rod finds a rest"),
        ({"drive__kind": "sequencer"}, "rolls and does not rest"),
    ],
)
def test_a_rest_is_asked_of_robots_that_can_rest(table: dict[str, Any], changes: dict[str, Any], word: str) -> None:
    table["metrics"] = {}
    with pytest.raises(InputError, match=word):
        make_plan(scene(table, solver__question="equilibrium", solver__duration_s=9.0, **changes))
    assert make_plan(scene(table, solver__question="equilibrium", solver__duration_s=9.0)).leaves_out("dynamics")


def test_the_segment_twin_takes_its_step_from_a_table_and_leaves_nothing_out(table: dict[str, Any]) -> None:
    plan = make_plan(scene(table, solver__twin="bullet", solver__accuracy="fast"))
    assert (plan.step_s, plan.segments) == BULLET["fast"]
    assert plan.decisions == plan.choices() == ()
    assert plan.table()["resolution"] == {"step_s": BULLET["fast"][0], "segments": BULLET["fast"][1]}


def test_the_plan_as_data_holds_choices_with_their_errors(table: dict[str, Any]) -> None:
    found = make_plan(scene(table, solver__modes=5)).table()
    assert found["resolution"]["modes"] == {
        "value": 5,
        "estimated_error": found["resolution"]["modes"]["estimated_error"],
        "given": True,
    }
    assert 0.0 < found["resolution"]["estimated_error"] < found["resolution"]["target"] == TARGETS["standard"]


# --- leaving out changes nothing that counts --------------------------------------------------------------------------


@pytest.fixture
def difference(monkeypatch: pytest.MonkeyPatch) -> Callable[[Scene, tuple[str, ...]], float]:
    """Largest relative difference of a scene's results with all rules and with some not applied."""

    def compare(changed: Scene, keep: tuple[str, ...]) -> float:
        with_rules = simulate(changed).summary
        with monkeypatch.context() as patch:
            patch.setattr("sim.run.make_twin", functools.partial(make_twin, keep=keep))
            without = simulate(changed).summary
        return max(relative_errors(changed, with_rules, without).values())

    return compare


Difference = Callable[[Scene, tuple[str, ...]], float]


@pytest.mark.parametrize("accuracy", ["fast", "standard"])
def test_a_tube_that_cannot_twist_rolls_as_far(table: dict[str, Any], accuracy: str, difference: Difference) -> None:
    rolling = scene(table, solver__accuracy=accuracy, solver__modes=3)
    plan = make_plan(rolling)
    assert plan.leaves_out("twist")
    assert plan.resolution is not None
    assert difference(rolling, ("twist",)) <= twist_error(plan.resolution, rolling) <= TARGETS[accuracy]


@pytest.mark.parametrize("ground", ["plane", "none", "step", "pipe"])
def test_half_a_tube_gives_what_the_whole_gives(table: dict[str, Any], ground: str, difference: Difference) -> None:
    assert difference(scene(table, world__ground=ground, solver__modes=3), ("mirror",)) < 1e-7


def test_a_tube_without_a_length_of_its_own_rolls_as_far(table: dict[str, Any], difference: Difference) -> None:
    assert difference(scene(table), ("stretch",)) < TARGETS["standard"]


def test_without_ground_the_robot_turns_as_its_angular_momentum_asks(table: dict[str, Any]) -> None:
    table["drive"].update(period_s=8.0, start_s=0.2)
    table["metrics"] = {"steady_after_s": 1.0}
    afloat = scene(table, world__ground="none", solver__duration_s=9.0)
    assert make_plan(afloat).leaves_out("contact")
    turned = simulate(afloat).summary["plane_rotation_rad"] / (2.0 * math.pi)
    assert turned == pytest.approx(floating_ratio(0.15, 0.01, 12.0), rel=TARGETS["standard"])


def test_a_sleeping_robot_wakes_where_a_waking_one_would_lie(table: dict[str, Any]) -> None:
    table["drive"].update(start_s=3.0, ramp_s=0.5)
    table["metrics"] = {}
    later = scene(table, solver__duration_s=9.0, solver__step_s=0.0025)
    numbers = drive_array(later.drive)
    asleep, awake = make_twin(later), make_twin(later)
    assert isinstance(asleep, RodTwin)
    assert isinstance(awake, RodTwin)
    samples = round(4.0 / asleep.step_s)
    rows = asleep.play(numbers, samples, 1)
    for _ in range(samples):
        awake.wake()
        last = awake.play(numbers, 1, 1)[0]
    assert rows[round(2.0 / asleep.step_s), ASLEEP] == 1.0
    assert rows[-1, ASLEEP] == 0.0
    np.testing.assert_allclose(rows[-1, ROTATION], last[ROTATION], atol=2e-3)
    np.testing.assert_allclose(rows[-1, CENTRE_OF_MASS], last[CENTRE_OF_MASS], atol=1e-3 * later.robot.radius_m)
