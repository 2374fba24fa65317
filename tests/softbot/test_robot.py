"""Robot files: what follows from what, there and back through a file, and errors that name the mend."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softbot.cross_section import default_cross_section
from softbot.errors import InputError
from softbot.robot import Robot, load_robot, robot_from, robot_table
from softbot.toml_file import read_toml
from softbot.tube import bending_moment_N_m, kink_curvature_1_m, pressure_from_scaled_Pa

ACTUATOR = {"law": "yeoh", "modulus_Pa": 3e4, "stiffening_Pa": 500.0, "chamber_area_m2": 3e-5,
            "chamber_centroid_radius_m": 0.005, "gains": [1.0, 1.1, 0.9, 1.0], "dead_band_Pa": 1e3,
            "max_pressure_Pa": 5e4}  # fmt: skip
TUBE = {"length_m": 0.15, "radius_m": 0.01, "mass_kg": 0.0518}


def pressed() -> dict[str, Any]:
    return {**TUBE, "actuator": dict(ACTUATOR)}


def crooked() -> dict[str, Any]:
    wall = {"law": "gent", "stiffening_Pa": 0.0, "limit_invariant": 8.0, "pre_stretch": 1.1}
    return {**TUBE, "actuator": {**ACTUATOR, **wall, "misalignment_rad": [0.1, 0.0, -0.05, 0.0]}}


def remembering() -> dict[str, Any]:
    return {
        **pressed(),
        "memory": {
            "line": {"filling_conductance_m3_s_Pa": 2e-10, "venting_conductance_m3_s_Pa": 1e-10, "growth_1_Pa": 3e-6},
            "hysteresis": {"thresholds_Pa": [5e3, 2e4], "weights": [0.1, 0.2], "unloading_slope": 1.3},
            "creep": {"shares": [0.1], "times_s": [2.0]},
            "residual": {"share": 0.05, "growth_time_s": 10.0, "recovery_time_s": 60.0},
        },
    }


def bent() -> dict[str, Any]:
    return {**TUBE, "bending_stiffness_N_m2": 3.93e-3}


# --- what follows from what ------------------------------------------------------------


def test_mechanical_robot_gets_a_wall_of_its_own_bending_stiffness() -> None:
    robot = robot_from(bent(), "r.toml")
    assert robot.bending_stiffness == 3.93e-3
    assert robot.actuator_law().rest_bending_stiffness_N_m2 == pytest.approx(3.93e-3, rel=1e-12)
    assert robot.cross_section() == default_cross_section(0.01)
    stiffness = robot.actuator_law().forces(1.0, [0.0, 0.0])[1]
    assert robot.axial_stiffness == pytest.approx(stiffness[0, 0], rel=1e-9)


def test_twisting_and_axial_stiffness_follow_from_bending_unless_they_are_stated() -> None:
    robot = robot_from(bent(), "r.toml")
    # G = E/3 (incompressible) and J = 2 I: GJ = 2/3 EI
    assert robot.twisting_stiffness == pytest.approx(2.0 / 3.0 * 3.93e-3)
    section = robot.cross_section()
    modulus_Pa = 3.93e-3 / section.bending_area_moment_m4
    assert robot.axial_stiffness == pytest.approx(modulus_Pa * section.wall_area_m2)
    stated = robot_from({**bent(), "twisting_stiffness_N_m2": 1e-3, "axial_stiffness_N": 77.0}, "r.toml")
    assert (stated.twisting_stiffness, stated.axial_stiffness) == (1e-3, 77.0)


def test_robot_with_an_actuator_bends_as_stiffly_as_its_wall() -> None:
    robot = robot_from(pressed(), "r.toml")
    section = robot.cross_section()
    assert section.chamber_area_m2 == 3e-5
    assert robot.bending_stiffness == pytest.approx(4.0 * 3e4 * section.bending_area_moment_m4, rel=1e-12)
    assert robot.max_pressure_Pa == 5e4
    law = robot.actuator_law()
    assert (law.material, law.gains, law.dead_band_Pa) == ("yeoh", (1.0, 1.1, 0.9, 1.0), 1e3)


def test_memory_is_that_of_its_parts_and_chambers_and_absent_where_there_is_none() -> None:
    robot = robot_from(remembering(), "r.toml")
    memory = robot.actuator_memory()
    assert memory is not None
    assert memory.parts == robot.memory
    part = {**remembering(), "memory": {"creep": {"shares": [0.1], "times_s": [2.0]}}}
    creeping = robot_from(part, "r.toml").actuator_memory()
    assert creeping is not None
    assert creeping.parts.line is creeping.parts.hysteresis is creeping.parts.residual is None
    for none in (pressed(), {**pressed(), "memory": {}}):
        assert robot_from(none, "r.toml").actuator_memory() is None
    # a line fills a chamber of this robot's volume: twice the length, twice the time
    longer = robot_from({**remembering(), "length_m": 0.3}, "r.toml").actuator_memory()
    assert longer is not None
    felt = [of.step(of.rest(), [5e4] * 4, dt)[0][0, 0] for of, dt in ((memory, 1e-2), (longer, 2e-2))]
    assert felt[0] == pytest.approx(felt[1], rel=1e-9)


def test_every_key_of_the_wall_reaches_the_law() -> None:
    law = robot_from(crooked(), "r.toml").actuator_law()
    assert (law.material, law.limit_invariant, law.pre_stretch) == ("gent", 8.0, 1.1)
    assert law.section.misalignment_rad == (0.1, 0.0, -0.05, 0.0)
    yeoh = robot_from({**TUBE, "actuator": {**ACTUATOR, "stiffening_2_Pa": 7.0}}, "r.toml").actuator_law()
    assert (yeoh.stiffening_Pa, yeoh.stiffening_2_Pa) == (500.0, 7.0)
    mooney = {**ACTUATOR, "law": "mooney-rivlin", "stiffening_Pa": 0.0, "second_share": 0.25}
    assert robot_from({**TUBE, "actuator": mooney}, "r.toml").actuator_law().second_share == 0.25


@given(length_m=st.floats(0.05, 2.0), stiffness=st.floats(1e-5, 10.0))
def test_pressure_limit_without_an_actuator_bends_by_120_degrees_or_leaves_the_boards_limit_room(
    length_m: float, stiffness: float
) -> None:
    robot = robot_from({**TUBE, "length_m": length_m, "bending_stiffness_N_m2": stiffness}, "r.toml")
    gain = robot.actuator_law().equilibrium([0.0] * 4).jacobian[1, 0]
    bend_rad = robot.max_pressure_Pa * abs(gain) * length_m
    assert bend_rad <= math.radians(120.0) * (1.0 + 1e-4)
    if bend_rad < 0.999 * math.radians(120.0):
        assert robot.max_pressure_Pa == pytest.approx(0.8 * robot.pneumatics.max_chamber_pressure_Pa)


# --- the tube of the paper ------------------------------------------------------------


def thin(**changes: Any) -> dict[str, Any]:
    """A robot with a thin wall under pressure."""
    wall = {"wall_thickness_m": 0.001, "youngs_modulus_Pa": 5e5, "poisson_ratio": 0.4, "internal_pressure_Pa": 3e4}
    return {**TUBE, "tube": {key: value for key, value in {**wall, **changes}.items() if value is not None}}


@given(share=st.floats(-1.0, 1.0), pressure_Pa=st.floats(1e3, 1e6), poisson_ratio=st.floats(-0.5, 0.5))
def test_tube_states_the_stiffness_and_softening_of_the_papers_moment_up_to_its_kink(
    share: float, pressure_Pa: float, poisson_ratio: float
) -> None:
    robot = robot_from(thin(internal_pressure_Pa=pressure_Pa, poisson_ratio=poisson_ratio), "r.toml")
    tube = robot.thin_tube()
    assert tube is not None
    assert robot.kink_curvature_1_m == pytest.approx(kink_curvature_1_m(tube, pressure_Pa), rel=1e-12)
    kappa = share * robot.kink_curvature_1_m
    moment = robot.bending_stiffness * (kappa - robot.ovalisation_m2 * kappa**3)
    assert moment == pytest.approx(bending_moment_N_m(tube, kappa, pressure_Pa), rel=1e-9, abs=1e-15)


def test_tubes_pressure_may_be_stated_scaled_and_its_other_stiffnesses_follow_from_its_wall() -> None:
    robot = robot_from(thin(), "r.toml")
    scaled = robot_from(thin(internal_pressure_Pa=None, scaled_pressure=robot.scaled_pressure), "r.toml")
    assert scaled.scaled_pressure == robot.scaled_pressure
    assert scaled.ovalisation_m2 == robot.ovalisation_m2
    # G = E/(2(1 + ν)), J = 2πR³h; the axial strain pR/(2Eh) under the closed ends' thrust p πR²
    assert robot.twisting_stiffness == pytest.approx(5e5 / 2.8 * 2.0 * math.pi * 0.01**3 * 0.001)
    assert 3e4 * math.pi * 0.01**2 / robot.axial_stiffness == pytest.approx(3e4 * 0.01 / (2.0 * 5e5 * 0.001))
    stated = robot_from({**thin(), "twisting_stiffness_N_m2": 1e-3, "axial_stiffness_N": 77.0}, "r.toml")
    assert (stated.twisting_stiffness, stated.axial_stiffness) == (1e-3, 77.0)
    assert robot.actuator_law().rest_bending_stiffness_N_m2 == pytest.approx(robot.bending_stiffness)


def test_robot_without_a_tube_neither_ovalises_nor_kinks() -> None:
    robot = robot_from(bent(), "r.toml")
    assert (robot.thin_tube(), robot.scaled_pressure) == (None, None)
    assert (robot.ovalisation_m2, robot.kink_curvature_1_m) == (0.0, math.inf)
    assert (robot.actuation, robot.segments) == ("chamber", 1)


def test_larva_is_the_papers_animal(tmp_path: Path) -> None:
    larva = load_robot("larva")
    tube = larva.thin_tube()
    assert tube is not None
    assert (larva.actuation, larva.segments, larva.scaled_pressure) == ("muscle", 11, 3.3)
    assert tube.wall_thickness_m / tube.radius_m == pytest.approx(0.1)
    assert 1.8e6 <= tube.youngs_modulus_Pa <= 3.2e6
    assert 0.79e6 <= pressure_from_scaled_Pa(tube, 3.3) <= 1.41e6
    assert larva.kink_curvature_1_m * larva.radius_m == pytest.approx(1.7127, abs=1e-4)
    assert 9.81 * larva.mass_kg == pytest.approx(1e-5, rel=0.2)  # the paper: about 0.01 mN
    assert larva.mass_kg / (math.pi * larva.radius_m**2 * larva.length_m) == pytest.approx(1050.0, rel=1e-3)
    assert "not measured" in larva.provenance["length_m"]
    assert robot_from(larva.table(), "again") == larva
    robot_from(bent(), "r").save(tmp_path / "larva")
    assert robot_table("larva", tmp_path)[0]["bending_stiffness_N_m2"] == 3.93e-3


# --- there and back ------------------------------------------------------------


@given(
    length_m=st.floats(0.05, 1e2),
    mass_kg=st.floats(1e-6, 1e4),
    modulus_Pa=st.floats(1.0, 1e12),
    gains=st.tuples(*[st.floats(0.1, 10.0)] * 4),
    name=st.text(max_size=20).filter(lambda text: "\r" not in text),
)
def test_table_of_a_robot_makes_the_same_robot(
    length_m: float, mass_kg: float, modulus_Pa: float, gains: tuple[float, ...], name: str
) -> None:
    actuator = {**ACTUATOR, "modulus_Pa": modulus_Pa, "gains": list(gains)}
    robot = robot_from({**TUBE, "name": name, "length_m": length_m, "mass_kg": mass_kg, "actuator": actuator}, "r")
    assert robot_from(robot.table(), "again") == robot


@pytest.mark.parametrize("table", [bent(), pressed(), crooked(), remembering()])
def test_saved_robot_comes_back_the_same(tmp_path: Path, table: dict[str, Any]) -> None:
    table["provenance"] = {"table": 'a "quoted" naïve name', "licence": "CC-BY-4.0"}
    table["sensors"] = {"gyro_noise_rad_s": 1e-7}
    table["pneumatics"] = {"supply_pressure_Pa": 1.5e5, "dead_volume_m3": [1e-6, 2e-6, 3e-6, 4e-6]}
    robot = robot_from(table, "r.toml")
    path = tmp_path / "robot.toml"
    robot.save(path)
    assert load_robot(path) == robot
    assert read_toml(path)["schema"] == "softbot-robot-1"
    assert [entry.name for entry in tmp_path.iterdir()] == ["robot.toml"]


def test_shipped_robot_is_calibrated_and_can_bend_and_a_file_of_that_name_goes_before_it(tmp_path: Path) -> None:
    robot = load_robot("default")
    assert robot.actuator is not None
    assert robot.provenance
    law = robot.actuator_law()
    one = law.equilibrium([robot.max_pressure_Pa, 0.0, 0.0, 0.0])
    assert float(np.hypot(*one.curvature_1_m)) * robot.length_m > math.radians(30.0)
    robot_from(bent(), "r").save(tmp_path / "default")
    assert robot_table("default", tmp_path)[0]["bending_stiffness_N_m2"] == 3.93e-3


# --- what is refused ------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({**bent(), "length_mm": 150}, "r.toml: length_mm: unknown key; did you mean length_m? (mind the unit)"),
        ({**bent(), "lenght_m": 0.15}, "did you mean length_m?"),
        ({**bent(), "colour": "red"}, "colour: unknown key; known here: schema, name, length_m"),
        ({**TUBE}, "bending_stiffness_N_m2: missing; give it, or an [actuator]"),
        ({**pressed(), "bending_stiffness_N_m2": 1e-3}, "give one of the two"),
        ({**bent(), "radius_m": 0.08}, "radius_m = 0.08 is over half of length_m = 0.15"),
        ({**bent(), "mass_kg": -1}, "mass_kg = -1: input should be greater than 0 (mass of the whole robot"),
        ({**bent(), "mass_kg": "heavy"}, "mass_kg = 'heavy'"),
        ({**bent(), "mass_kg": math.nan}, "mass_kg = nan: input should be a finite number"),
        ({**bent(), "schema": "softbot-robot-9"}, "'softbot-robot-9' is not 'softbot-robot-1'"),
        ({**bent(), "actuator": 3}, "actuator = 3: input should be a table"),
        ({**TUBE, "actuator": {**ACTUATOR, "law": "granite"}}, "actuator.law = 'granite'"),
        ({**TUBE, "actuator": {**ACTUATOR, "modulus_kPa": 3}}, "actuator.modulus_kPa: unknown key; did you mean"),
        ({**TUBE, "actuator": {**ACTUATOR, "gains": [1, 1, 1, 0]}}, "actuator: gains"),
        ({**TUBE, "actuator": {**ACTUATOR, "gains": [1, 1, 1]}}, "actuator.gains.3: missing"),
        ({**TUBE, "actuator": {**ACTUATOR, "chamber_centroid_radius_m": 0.5}}, "inside radius_m"),
        (
            {**TUBE, "actuator": {**ACTUATOR, "limit_invariant": 3.0}},
            "yeoh has no such parameter; leave it out, or take",
        ),
        (
            {**TUBE, "actuator": {**ACTUATOR, "misalignment_rad": [1, 0, 0, 0]}},
            "misalignment_rad = (1.0, 0.0, 0.0, 0.0)",
        ),
        ({**TUBE, "actuator": {**ACTUATOR, "misalignment_deg": [1, 0, 0, 0]}}, "did you mean misalignment_rad?"),
        (
            {**bent(), "memory": {"creep": {"shares": [1.0], "times_s": [2.0]}}},
            "memory.creep.shares = [1.0]: each from",
        ),
        ({**bent(), "memory": {"creep": {"shares": [0.1]}}}, "memory.creep.times_s: missing; add it"),
        ({**bent(), "memory": {"crep": {}}}, "memory.crep: unknown key; did you mean creep?"),
        (
            {**bent(), "memory": {"hysteresis": {"thresholds_Pa": [2.0, 1.0], "weights": [0.1, 0.1]}}},
            "memory.hysteresis.thresholds_Pa = [2.0, 1.0]: give rising numbers",
        ),
        (
            {**bent(), "memory": {"residual": {"share": 0.1, "growth_time_s": 0, "recovery_time_s": 1}}},
            "memory.residual.growth_time_s = 0",
        ),
        (
            {**bent(), "memory": {"line": {"filling_conductance_m3_s_Pa": 1e-10, "venting_conductance_m3_s_Pa": -1}}},
            "memory.line.venting_conductance_m3_s_Pa = -1",
        ),
        (
            {**bent(), "memory": {"line": {"filling_conductance_m3_s_bar": 1e-10, "venting_conductance_m3_s_Pa": 1}}},
            "did you mean filling_conductance_m3_s_Pa? (mind the unit)",
        ),
        ({**bent(), "actuation": "muscle", "memory": {}}, "the [memory] table is about chambers"),
        ({**bent(), "actuation": "wind"}, "actuation = 'wind': input should be 'chamber' or 'muscle'"),
        ({**bent(), "segments": 0}, "segments = 0: input should be greater than or equal to 1"),
        (
            {**thin(), "bending_stiffness_N_m2": 1e-3},
            "bending_stiffness_N_m2: follows from the [tube]; give one of the",
        ),
        ({**thin(), "actuator": ACTUATOR}, "tube: its wall and that of the [actuator] are two laws of one section"),
        ({**pressed(), "actuation": "muscle"}, 'actuation = "muscle": the [actuator] table is about chambers'),
        (thin(internal_pressure_Pa=None), "tube: give one of internal_pressure_Pa and scaled_pressure"),
        (thin(scaled_pressure=3.3), "tube: give one of internal_pressure_Pa and scaled_pressure"),
        (thin(wall_thickness_m=0.02), "tube: wall_thickness_m must be below radius_m"),
        (thin(wall_thickness_mm=1), "tube.wall_thickness_mm: unknown key; did you mean wall_thickness_m? (mind the"),
        (thin(poisson_ratio=0.6), "tube.poisson_ratio = 0.6"),
        (thin(internal_pressure_Pa=0), "tube.internal_pressure_Pa = 0"),
        ({**bent(), "pneumatics": {"supply_pressure_kPa": 3}}, "did you mean supply_pressure_Pa? (mind the unit)"),
        ({**bent(), "pneumatics": {"supply_pressure_Pa": -3}}, "r.toml: pneumatics.supply_pressure_Pa = -3.0"),
        ({**bent(), "sensors": {"gyro_noise_rad_s": -1}}, "gyro_noise_rad_s must be zero or positive"),
    ],
)
def test_wrong_robot_is_refused_by_key_value_and_mend(table: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError) as refusal:
        robot_from(table, "r.toml")
    assert str(refusal.value).startswith("r.toml: ")
    assert says in str(refusal.value)


def test_robot_is_immutable() -> None:
    robot = Robot.model_validate(bent())
    with pytest.raises(ValueError, match="frozen"):
        robot.mass_kg = 2.0  # type: ignore[misc]
