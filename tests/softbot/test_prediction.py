"""A robot predicted from geometry and silicone, and its band."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers.compensation import Compensator
from softbot.cross_section import default_cross_section
from softbot.errors import InputError
from softbot.prediction import predict
from softbot.robot import load_robot, robot_from
from softbot.silicone import silicone, silicones

NEW: dict[str, Any] = {"length_m": 0.15, "radius_m": 0.012, "material": "Dragon Skin 30"}


def test_silicone_and_geometry_make_a_robot() -> None:
    robot = robot_from(NEW, "r.toml")
    one, section = silicone("Dragon Skin 30"), default_cross_section(0.012)
    law = robot.actuator_law()
    assert (law.material, law.modulus_Pa, law.limit_invariant) == (one.law, one.modulus_Pa, one.limit_invariant)
    assert law.section == section
    assert robot.mass_kg == pytest.approx(1070.0 * section.wall_area_m2 * 0.15)
    assert robot.stiffness_log_sd == one.stiffness_log_sd
    drawn = {"chamber_area_m2": 2e-5, "chamber_centroid_radius_m": 0.008, "gains": [1.0, 1.1, 1.0, 1.0]}
    stated = robot_from({**NEW, "mass_kg": 0.1, "actuator": drawn}, "r.toml")
    assert (stated.mass_kg, stated.cross_section().chamber_area_m2) == (0.1, 2e-5)
    assert stated.actuator_law().gains == (1.0, 1.1, 1.0, 1.0)
    assert stated.actuator_law().modulus_Pa == one.modulus_Pa


@pytest.mark.parametrize("name", ["dragon skin 30", "Dragon_Skin_30", "DRAGONSKIN30"])
def test_names_are_taken_as_people_write_them(name: str) -> None:
    assert robot_from({**NEW, "material": name}, "r.toml").material == "Dragon Skin 30"


def test_every_silicone_makes_a_robot_that_comes_back_the_same(tmp_path: Path) -> None:
    for name in silicones():
        robot = robot_from({**NEW, "material": name}, "r.toml")
        robot.save(tmp_path / "r.toml")
        assert load_robot(tmp_path / "r.toml") == robot


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"material": "granite"}, "material = 'granite': is not in the library; known are Ecoflex 00-30"),
        ({"material": "Dragon Skin 31"}, "did you mean Dragon Skin 30?"),
        ({"material": 7}, "material = 7"),
        ({"actuator": {"modulus_Pa": 1e5}}, "actuator.modulus_Pa = 100000.0: material = 'Dragon Skin 30' says 1894"),
        ({"actuator": {"law": "linear"}}, "actuator.law = 'linear': material = 'Dragon Skin 30' says gent; leave one"),
        ({"actuator": {"stiffening_Pa": 5.0}}, "says nothing of it"),
        ({"actuator": 3}, "actuator = 3: input should be a table"),
        ({"bending_stiffness_N_m2": 1e-3}, "follows from the [actuator]"),
        ({"radius_m": -1}, "radius_m = -1: input should be greater than 0"),
        ({"radius_m": "thin"}, "radius_m = 'thin'"),
        ({"actuator": {"chamber_area_m2": 1.0}}, "four chambers fill"),
        ({"actuator": {"chamber_area_m2": "big"}}, "actuator.chamber_area_m2 = 'big'"),
    ],
)
def test_wrong_material_is_refused_by_key_and_mend(table: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError) as refusal:
        robot_from({**NEW, **table}, "r.toml")
    assert says in str(refusal.value)


@pytest.mark.parametrize("name", ["Ecoflex 00-30", "Dragon Skin 30"])
def test_band_is_that_of_walls_as_much_stiffer_and_softer_as_the_library_says(name: str) -> None:
    robot = robot_from({**NEW, "material": name}, "r.toml")
    largest_Pa = 10e3 if name.startswith("Eco") else 100e3
    found = predict(robot, (1,), largest_Pa, points=5)
    one = silicone(name)
    for sign, bend, length in (
        (1.0, found.bend_low_rad, found.length_low_m),
        (-1.0, found.bend_high_rad, found.length_high_m),
    ):
        assert bend is not None
        assert length is not None
        stiffer = math.exp(sign * 1.96 * one.stiffness_log_sd)
        actuator = {**robot.table()["actuator"], "modulus_Pa": one.modulus_Pa * stiffer}
        table = {key: value for key, value in robot.table().items() if key != "material"}
        other = predict(robot_from({**table, "actuator": actuator}, "r.toml"), (1,), largest_Pa, points=5)
        np.testing.assert_allclose(bend, other.bend_rad, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(length, other.length_m, rtol=1e-8)
        assert other.bend_low_rad is None
    assert np.all(np.diff(found.bend_rad) > 0.0)


def test_dead_band_is_no_matter_of_stiffness() -> None:
    table = {**NEW, "actuator": {"dead_band_Pa": 2e4, "max_pressure_Pa": 1e5}}
    found = predict(robot_from(table, "r.toml"), points=11)
    assert found.bend_low_rad is not None
    assert found.bend_high_rad is not None
    still = found.pressure_Pa <= 2e4
    for bend in (found.bend_rad, found.bend_low_rad, found.bend_high_rad):
        np.testing.assert_allclose(bend[still], 0.0, atol=1e-12)
        assert np.all(bend[~still] > 0.0)


MEMORY = {
    "hysteresis": {"thresholds_Pa": [5e3, 2e4], "weights": [0.2, 0.1]},
    "creep": {"shares": [0.1], "times_s": [2.0]},
}


def test_prediction_is_what_the_memory_lets_the_wall_feel_at_rest() -> None:
    robot = robot_from({**load_robot("default").table(), "memory": MEMORY}, "r.toml")
    memory = robot.actuator_memory()
    assert memory is not None
    found = predict(robot, (1,), 5e4, points=6)
    for n, most_Pa in enumerate(found.pressure_Pa):
        t_s = np.linspace(0.0, 300.0, 3001)
        slowly = np.zeros((len(t_s), 4))
        slowly[:, 1] = np.minimum(t_s / 10.0, 1.0) * most_Pa
        strain, _ = robot.actuator_law().equilibria(memory.run(t_s, slowly)[-1:])
        assert found.bend_rad[n] == pytest.approx(robot.length_m * math.hypot(*strain[0, 1:]), rel=1e-6, abs=1e-12)
    without = predict(load_robot("default"), (1,), 5e4, points=6)
    assert abs(found.bend_rad[-1] / without.bend_rad[-1] - 1.0) > 0.02


def test_prediction_and_inverse_agree_on_a_robot_with_memory() -> None:
    robot = robot_from({**load_robot("default").table(), "memory": MEMORY}, "r.toml")
    found = predict(robot, (2,), 5e4, points=2)
    compensator = Compensator(robot.actuator_law(), robot.actuator_memory())
    curvature = found.bend_rad[-1] / robot.length_m
    inverse = compensator.pressures([curvature, 0.0], dt_s=1e6, limit_Pa=1e5)
    np.testing.assert_allclose(inverse.pressure_Pa, [0.0, 0.0, 5e4, 0.0], atol=1.0)


def test_calibrated_robot_has_a_curve_without_a_band_and_wrong_questions_are_refused() -> None:
    robot = load_robot("default")
    found = predict(robot, (0, 1))
    assert found.pressure_Pa[-1] == robot.max_pressure_Pa
    assert found.bend_low_rad is found.length_high_m is None
    for arguments in ({"chambers": ()}, {"chambers": (4,)}, {"largest_Pa": 0.0}, {"points": 1}):
        with pytest.raises(InputError):
            predict(robot, **arguments)  # type: ignore[arg-type]
