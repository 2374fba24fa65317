"""Robot file: everything about one robot, checked field by field.

The same keys stand in a scene's `[robot]` table and in a robot file written by `softbot calibrate`. A robot is either
mechanical only (length, radius, mass, bending stiffness: enough for given curvatures) or has an `[actuator]`, from
which its bending stiffness follows. A mechanical robot that is driven by pressure gets the default section, with the
modulus that gives its bending stiffness.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any, Self

import pydantic
from pydantic import Field

from softbot.actuator import ActuatorLaw
from softbot.cross_section import CrossSection, default_cross_section
from softbot.errors import InputError
from softbot.material import MATERIALS, MaterialName
from softbot.pneumatics import PneumaticsParameters
from softbot.sensing import SensorParameters
from softbot.toml_file import STRICT, Table, check, read_toml, write_toml

ROBOT_SCHEMA = "softbot-robot-1"
DEFAULT_ROBOT = "default"

Gains = tuple[float, float, float, float]


class Actuator(pydantic.BaseModel):
    """The `[actuator]` table: section, wall material, chamber gains and the pressure limit."""

    model_config = STRICT

    law: MaterialName = Field("neo-hookean", description="wall material: linear, neo-hookean or yeoh")
    modulus_Pa: float = Field(gt=0, le=1e12, description="first parameter of the wall material, in pascals")
    stiffening_Pa: float = Field(0.0, ge=0, le=1e12, description="second parameter (yeoh), in pascals")
    chamber_area_m2: float = Field(gt=0, description="area of one chamber, in square metres")
    chamber_centroid_radius_m: float = Field(
        gt=0, description="distance of a chamber's centroid from the axis, in metres"
    )
    gains: Gains = Field((1.0, 1.0, 1.0, 1.0), description="load of each chamber over its nominal load")
    dead_band_Pa: float = Field(
        0.0, ge=0, description="pressure that opens a chamber before it loads the wall, in pascals"
    )
    max_pressure_Pa: float = Field(120e3, gt=0, le=1e8, description="highest gauge pressure of a chamber, in pascals")


class Robot(pydantic.BaseModel):
    """One robot. Units are in the names; pressures are gauge."""

    model_config = STRICT

    schema_: str = Field(ROBOT_SCHEMA, alias="schema", description="version of the file's format")
    name: str = "robot"
    length_m: float = Field(gt=0, le=100, description="length of the unloaded tube, in metres")
    radius_m: float = Field(gt=0, le=10, description="outer radius, in metres")
    mass_kg: float = Field(gt=0, le=1e4, description="mass of the whole robot, in kilograms")
    bending_stiffness_N_m2: float | None = Field(
        None, gt=0, le=1e9, description="EI, in N m²; leave out with an [actuator]"
    )
    twisting_stiffness_N_m2: float | None = Field(
        None, gt=0, le=1e9, description="GJ, in N m²; default: EI·2/3 (incompressible)"
    )
    axial_stiffness_N: float | None = Field(
        None, gt=0, le=1e12, description="EA, in newtons; default: from EI and the section"
    )
    damping_time_s: float = Field(
        0.02, ge=0, le=100, description="Kelvin–Voigt: damping = stiffness × this time, in seconds"
    )
    actuator: Actuator | None = None
    pneumatics: PneumaticsParameters = PneumaticsParameters()
    sensors: SensorParameters = SensorParameters()
    provenance: dict[str, str] = Field(default_factory=dict, description="where the numbers come from")

    @pydantic.model_validator(mode="after")
    def _one_stiffness(self) -> Self:
        if self.schema_ != ROBOT_SCHEMA:
            raise ValueError(
                f"schema {self.schema_!r} is not {ROBOT_SCHEMA!r}: calibrate the robot again with this version"
            )
        if self.bending_stiffness_N_m2 is None and self.actuator is None:
            raise ValueError("bending_stiffness_N_m2: missing; give it, or an [actuator] from which it follows")
        if self.bending_stiffness_N_m2 is not None and self.actuator is not None:
            raise ValueError("bending_stiffness_N_m2: follows from the [actuator]; give one of the two")
        if 2.0 * self.radius_m > self.length_m:
            raise ValueError(
                f"radius_m = {self.radius_m:g} is over half of length_m = {self.length_m:g}: this is no slender tube"
            )
        if self.actuator is not None:
            try:
                self.actuator_law()
            except InputError as error:
                raise ValueError(f"actuator: {error}") from None
        return self

    def cross_section(self) -> CrossSection:
        """The section of the actuator, or the default one of the same radius."""
        if self.actuator is None:
            return default_cross_section(self.radius_m)
        return CrossSection(self.radius_m, self.actuator.chamber_area_m2, self.actuator.chamber_centroid_radius_m)

    def actuator_law(self) -> ActuatorLaw:
        """The actuator law; for a robot without an `[actuator]` a neo-Hookean wall of the same bending stiffness."""
        section = self.cross_section()
        if self.actuator is not None:
            a = self.actuator
            return ActuatorLaw(section, a.law, a.modulus_Pa, a.stiffening_Pa, a.gains, a.dead_band_Pa)
        assert self.bending_stiffness_N_m2 is not None
        modulus_Pa = self.bending_stiffness_N_m2 / (
            MATERIALS["neo-hookean"].modulus_ratio * section.bending_area_moment_m4
        )
        return ActuatorLaw(section, "neo-hookean", modulus_Pa)

    @property
    def max_pressure_Pa(self) -> float:
        """Highest gauge pressure of a chamber [Pa]; without an `[actuator]` what bends the tube by 120°, if that
        leaves the board's own limit (`pneumatics.max_chamber_pressure_Pa`) some room.
        """
        if self.actuator is not None:
            return self.actuator.max_pressure_Pa
        law = self.actuator_law()
        gain_1_m_Pa = abs(float(law.equilibrium([0.0] * 4).jacobian[1, 0]))
        return min(2.0944 / (self.length_m * gain_1_m_Pa), 0.8 * self.pneumatics.max_chamber_pressure_Pa)

    @property
    def bending_stiffness(self) -> float:
        """EI of the unloaded section [N m²], stated or from the actuator."""
        if self.bending_stiffness_N_m2 is not None:
            return self.bending_stiffness_N_m2
        return self.actuator_law().rest_bending_stiffness_N_m2

    @property
    def twisting_stiffness(self) -> float:
        """GJ [N m²]; default 2/3 EI: G = E/3 of an incompressible wall, and J = 2 I."""
        return self.twisting_stiffness_N_m2 or 2.0 / 3.0 * self.bending_stiffness

    @property
    def axial_stiffness(self) -> float:
        """EA of the unloaded section [N]."""
        section = self.cross_section()
        return self.axial_stiffness_N or self.bending_stiffness * section.wall_area_m2 / section.bending_area_moment_m4

    def table(self) -> Table:
        """The robot as the tables of a robot file."""
        return self.model_dump(by_alias=True, exclude_none=True, mode="json")

    def save(self, path: Path) -> None:
        """Write the robot file."""
        write_toml(path, self.table())


def robot_table(name: str, folder: Path) -> tuple[Table, str]:
    """The tables of a robot named in a scene (a path from the scene's folder, or "default") and their source."""
    path = folder / name
    if name == DEFAULT_ROBOT and not path.exists():
        with resources.as_file(resources.files("softbot") / "data" / "default_robot.toml") as shipped:
            return read_toml(shipped), "default robot"
    return read_toml(path), str(path)


def load_robot(path: Path | str) -> Robot:
    """A robot from its file, or the shipped one for "default". Raises InputError that names file, key and mend."""
    table, source = robot_table(str(path), Path())
    return check(Robot, table, source)


def robot_from(table: dict[str, Any], source: str) -> Robot:
    """A robot from tables (a scene's `[robot]`)."""
    return check(Robot, table, source)
