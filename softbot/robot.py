"""Robot file: everything about one robot, checked field by field.

The same keys stand in a scene's `[robot]` table and in a robot file written by `softbot calibrate`. A robot is either
mechanical only (length, radius, mass, bending stiffness: enough for given curvatures) or has an `[actuator]`, from
which its bending stiffness follows. A mechanical robot that is driven by pressure gets the default section, with the
modulus that gives its bending stiffness.

In place of its bending stiffness a mechanical robot may state a `[tube]`: a thin wall under internal pressure that
ovalises as it bends and kinks in the end (the paper's law of the larva, `softbot.tube`). `actuation` says whether what
drives it elongates its side (chambers) or contracts it (muscles).
"""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path
from typing import Any, Literal, Self

import pydantic
from pydantic import Field

from softbot.actuator import PRE_STRETCH_BOUNDS, ActuatorLaw
from softbot.cross_section import CHAMBERS, CrossSection, default_cross_section
from softbot.errors import InputError
from softbot.material import MATERIALS, OPTIONAL_PARAMETERS, MaterialName
from softbot.memory.chain import Memory, MemoryParts
from softbot.pneumatics import PneumaticsParameters
from softbot.sensing import SensorParameters
from softbot.silicone import silicone, wall_of
from softbot.toml_file import STRICT, Table, check, read_toml, write_toml
from softbot.tube import Tube, scaled_pressure

ROBOT_SCHEMA = "softbot-robot-1"
SHIPPED_ROBOTS = {"default": "default_robot.toml", "larva": "larva.toml"}
"""Robots that a scene may name without a file of its own → their file in the package's data."""

Actuation = Literal["chamber", "muscle"]

OneEach = tuple[float, float, float, float]


class Actuator(pydantic.BaseModel):
    """The `[actuator]` table: section, wall material, chamber gains and the pressure limit."""

    model_config = STRICT

    law: MaterialName = Field("neo-hookean", description=f"wall material: {', '.join(MATERIALS)}")
    modulus_Pa: float = Field(gt=0, le=1e12, description="first parameter of the wall material, in pascals")
    stiffening_Pa: float = Field(0.0, ge=0, le=1e12, description="factor of (I1 - 3)^2 (yeoh), in pascals")
    stiffening_2_Pa: float | None = Field(
        None, ge=0, le=1e12, description="factor of (I1 - 3)^3 (yeoh), in pascals; default 0"
    )
    limit_invariant: float | None = Field(
        None, ge=0.05, le=1e9, description="I1 - 3 of the fully drawn chains (gent), without unit; default 30"
    )
    second_share: float | None = Field(
        None, ge=0, le=1, description="share of the modulus that goes with I2 (mooney-rivlin), without unit; default 0"
    )
    pre_stretch: float = Field(
        1.0, ge=PRE_STRETCH_BOUNDS[0], le=PRE_STRETCH_BOUNDS[1], description="stretch of the wall at rest, without unit"
    )
    chamber_area_m2: float = Field(gt=0, description="area of one chamber, in square metres")
    chamber_centroid_radius_m: float = Field(
        gt=0, description="distance of a chamber's centroid from the axis, in metres"
    )
    misalignment_rad: OneEach = Field(
        (0.0, 0.0, 0.0, 0.0), description="angle of each chamber off its nominal one, from e1 towards e2, in radians"
    )
    gains: OneEach = Field((1.0, 1.0, 1.0, 1.0), description="load of each chamber over its nominal load")
    dead_band_Pa: float = Field(
        0.0, ge=0, description="pressure that opens a chamber before it loads the wall, in pascals"
    )
    max_pressure_Pa: float = Field(120e3, gt=0, le=1e8, description="highest gauge pressure of a chamber, in pascals")


class TubeWall(pydantic.BaseModel):
    """The `[tube]` table: a thin wall under internal pressure, whose section ovalises as it bends.

    The pressure is stated as it is or scaled, p̄ = pR(1 − ν²)/(E₀h): one of the two.
    """

    model_config = STRICT

    wall_thickness_m: float = Field(gt=0, le=10, description="thickness of the wall, in metres")
    youngs_modulus_Pa: float = Field(gt=0, le=1e12, description="Young's modulus of the wall, in pascals")
    poisson_ratio: float = Field(0.5, gt=-1, le=0.5, description="of the wall, without unit")
    internal_pressure_Pa: float | None = Field(None, gt=0, le=1e12, description="pressure inside, gauge, in pascals")
    scaled_pressure: float | None = Field(
        None, gt=0, le=1e6, description="pressure inside over E₀h/(R(1 − ν²)), without unit"
    )

    @pydantic.model_validator(mode="after")
    def _one_pressure(self) -> Self:
        if (self.internal_pressure_Pa is None) == (self.scaled_pressure is None):
            raise ValueError("give one of internal_pressure_Pa and scaled_pressure: without pressure a thin wall kinks")
        return self


class Robot(pydantic.BaseModel):
    """One robot. Units are in the names; pressures are gauge."""

    model_config = STRICT

    schema_: str = Field(ROBOT_SCHEMA, alias="schema", description="version of the file's format")
    name: str = "robot"
    length_m: float = Field(gt=0, le=100, description="length of the unloaded tube, in metres")
    radius_m: float = Field(gt=0, le=10, description="outer radius, in metres")
    mass_kg: float = Field(
        gt=0, le=1e4, description="mass of the whole robot, in kilograms; with a material that of its wall by default"
    )
    material: str | None = Field(
        None, description="silicone of the wall (softbot materials lists them); gives law and parameters of [actuator]"
    )
    bending_stiffness_N_m2: float | None = Field(
        None, gt=0, le=1e9, description="EI, in N m²; leave out with an [actuator] or a [tube]"
    )
    twisting_stiffness_N_m2: float | None = Field(
        None, gt=0, le=1e9, description="GJ, in N m²; default: EI·2/3 (incompressible), or that of the [tube]"
    )
    axial_stiffness_N: float | None = Field(
        None, gt=0, le=1e12, description="EA, in newtons; default: from EI and the section, or that of the [tube]"
    )
    damping_time_s: float = Field(
        0.02, ge=0, le=100, description="Kelvin–Voigt: damping = stiffness × this time, in seconds"
    )
    actuation: Actuation = Field("chamber", description="chamber: elongates its side; muscle: contracts it")
    segments: int = Field(
        1, ge=1, le=10_000, description="parts between whose ends the muscles span, for the moments in closed form"
    )
    actuator: Actuator | None = None
    memory: MemoryParts | None = Field(
        None, description="what the chambers do with their pressures before the wall feels them"
    )
    tube: TubeWall | None = None
    pneumatics: PneumaticsParameters = PneumaticsParameters()
    sensors: SensorParameters = SensorParameters()
    provenance: dict[str, str] = Field(default_factory=dict, description="where the numbers come from")

    @pydantic.model_validator(mode="before")
    @classmethod
    def _made_of(cls, table: Any) -> Any:
        """Lay what the silicone and the default section say under what is stated."""
        if not (isinstance(table, dict) and isinstance(table.get("material"), str)):
            return table
        one = silicone(table["material"])
        stated = table.get("actuator", {})
        if not isinstance(stated, dict):
            return table
        actuator = wall_of(one.name, stated) | stated
        filled = {**table, "material": one.name, "actuator": actuator}
        size = [table.get(key) for key in ("radius_m", "length_m")]
        if all(isinstance(value, int | float) and 0.0 < value < math.inf for value in size):
            radius_m, length_m = (float(value) for value in size if value is not None)
            assumed = default_cross_section(radius_m)
            for key in ("chamber_area_m2", "chamber_centroid_radius_m"):
                actuator.setdefault(key, getattr(assumed, key))
            if "mass_kg" not in table:
                chambers = actuator["chamber_area_m2"]
                area_m2 = math.pi * radius_m**2 - CHAMBERS * (chambers if isinstance(chambers, int | float) else 0.0)
                filled["mass_kg"] = one.density_kg_m3 * max(area_m2, 1e-12) * length_m
        return filled

    @pydantic.model_validator(mode="after")
    def _one_stiffness(self) -> Self:
        if self.schema_ != ROBOT_SCHEMA:
            raise ValueError(
                f"schema {self.schema_!r} is not {ROBOT_SCHEMA!r}: calibrate the robot again with this version"
            )
        if self.bending_stiffness_N_m2 is None and self.actuator is None and self.tube is None:
            raise ValueError(
                "bending_stiffness_N_m2: missing; give it, or an [actuator] or a [tube] that it follows from"
            )
        if self.actuator is not None and self.tube is not None:
            raise ValueError(
                "tube: its wall and that of the [actuator] are two laws of one section; give one of the two"
            )
        source = "[actuator]" if self.actuator is not None else "[tube]"
        if self.bending_stiffness_N_m2 is not None and (self.actuator is not None or self.tube is not None):
            raise ValueError(f"bending_stiffness_N_m2: follows from the {source}; give one of the two")
        if self.actuator is not None and self.actuation == "muscle":
            raise ValueError('actuation = "muscle": the [actuator] table is about chambers; leave one of the two out')
        if self.memory is not None and self.actuation == "muscle":
            raise ValueError('actuation = "muscle": the [memory] table is about chambers; leave one of the two out')
        if 2.0 * self.radius_m > self.length_m:
            raise ValueError(
                f"radius_m = {self.radius_m:g} is over half of length_m = {self.length_m:g}: this is no slender tube"
            )
        for table, law in (("actuator", self.actuator_law), ("tube", self.thin_tube)):
            if getattr(self, table) is not None:
                try:
                    law()
                except InputError as error:
                    raise ValueError(f"{table}: {error}") from None
        return self

    def thin_tube(self) -> Tube | None:
        """The thin-walled tube of `[tube]`; None for a robot without one."""
        if self.tube is None:
            return None
        wall = self.tube
        return Tube(self.radius_m, wall.wall_thickness_m, wall.youngs_modulus_Pa, wall.poisson_ratio)

    @property
    def scaled_pressure(self) -> float | None:
        """p̄ of the `[tube]`, without unit; None for a robot without one."""
        tube = self.thin_tube()
        if tube is None or self.tube is None:
            return None
        if self.tube.scaled_pressure is not None:
            return self.tube.scaled_pressure
        assert self.tube.internal_pressure_Pa is not None
        return scaled_pressure(tube, self.tube.internal_pressure_Pa)

    @property
    def ovalisation_m2(self) -> float:
        """a = 3R²/(8p̄) of the bending moment EI(κ − aκ³) [m²]; 0 for a section that keeps its shape (no `[tube]`)."""
        pressure = self.scaled_pressure
        return 0.0 if pressure is None else 3.0 * self.radius_m**2 / (8.0 * pressure)

    @property
    def kink_curvature_1_m(self) -> float:
        """Curvature 1/√(3a) at which the tube kinks [1/m]: κ̄c = √(8p̄/9); infinite without a `[tube]`."""
        softening = self.ovalisation_m2
        return 1.0 / math.sqrt(3.0 * softening) if softening else math.inf

    def cross_section(self) -> CrossSection:
        """The section of the actuator, or the default one of the same radius."""
        if self.actuator is None:
            return default_cross_section(self.radius_m)
        a = self.actuator
        return CrossSection(self.radius_m, a.chamber_area_m2, a.chamber_centroid_radius_m, a.misalignment_rad)

    def actuator_law(self) -> ActuatorLaw:
        """The actuator law; for a robot without an `[actuator]` a neo-Hookean wall of the same bending stiffness."""
        section = self.cross_section()
        if self.actuator is not None:
            a = self.actuator
            stated = {key: value for key in OPTIONAL_PARAMETERS if (value := getattr(a, key)) is not None}
            return ActuatorLaw(
                section,
                a.law,
                a.modulus_Pa,
                gains=a.gains,
                dead_band_Pa=a.dead_band_Pa,
                pre_stretch=a.pre_stretch,
                **stated,
            )
        modulus_Pa = self.bending_stiffness / (MATERIALS["neo-hookean"].modulus_ratio * section.bending_area_moment_m4)
        return ActuatorLaw(section, "neo-hookean", modulus_Pa)

    @property
    def stiffness_log_sd(self) -> float | None:
        """How far the stiffness of a predicted wall is to be trusted: standard deviation of its logarithm.

        None for a robot without a `material`, whose wall is stated or calibrated.
        """
        return None if self.material is None else silicone(self.material).stiffness_log_sd

    def actuator_memory(self) -> Memory | None:
        """The memory of its chambers; None for a robot without any part of it."""
        if self.memory is None or not self.memory.on:
            return None
        volume_m3 = self.actuator_law().chamber_volumes_m3(self.length_m, 1.0, [0.0, 0.0])
        return Memory(self.memory, volume_m3, self.pneumatics.atmospheric_pressure_absolute_Pa)

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
        """EI of the unloaded section [N m²], stated or from the tube or the actuator."""
        if self.bending_stiffness_N_m2 is not None:
            return self.bending_stiffness_N_m2
        tube = self.thin_tube()
        if tube is not None:
            return tube.bending_stiffness_N_m2
        return self.actuator_law().rest_bending_stiffness_N_m2

    @property
    def twisting_stiffness(self) -> float:
        """GJ [N m²]; default 2/3 EI: G = E/3 of an incompressible wall, and J = 2 I.

        Of a tube: G = E₀/(2(1 + ν)) and J = 2πR³h, so GJ = (1 − ν) EI, the wall's EI being πE₀R³h/(1 − ν²).
        """
        if self.twisting_stiffness_N_m2 is not None:
            return self.twisting_stiffness_N_m2
        return (2.0 / 3.0 if self.tube is None else 1.0 - self.tube.poisson_ratio) * self.bending_stiffness

    @property
    def axial_stiffness(self) -> float:
        """EA of the unloaded section [N]; of a tube 2πE₀Rh, as in its axial strain pR/(2E₀h)."""
        tube = self.thin_tube()
        if tube is not None and self.axial_stiffness_N is None:
            return 2.0 * math.pi * tube.youngs_modulus_Pa * tube.radius_m * tube.wall_thickness_m
        section = self.cross_section()
        return self.axial_stiffness_N or self.bending_stiffness * section.wall_area_m2 / section.bending_area_moment_m4

    def table(self) -> Table:
        """The robot as the tables of a robot file."""
        return self.model_dump(by_alias=True, exclude_none=True, mode="json")

    def save(self, path: Path) -> None:
        """Write the robot file."""
        write_toml(path, self.table())


def robot_table(name: str, folder: Path) -> tuple[Table, str]:
    """The tables of a robot named in a scene (a path from its folder, "default" or "larva") and their source."""
    path = folder / name
    if name in SHIPPED_ROBOTS and not path.exists():
        with resources.as_file(resources.files("softbot") / "data" / SHIPPED_ROBOTS[name]) as shipped:
            return read_toml(shipped), f"{name} robot"
    return read_toml(path), str(path)


def load_robot(path: Path | str) -> Robot:
    """A robot from its file, or a shipped one ("default", "larva"). Raises InputError that names file, key and mend."""
    table, source = robot_table(str(path), Path())
    return check(Robot, table, source)


def robot_from(table: dict[str, Any], source: str) -> Robot:
    """A robot from tables (a scene's `[robot]`)."""
    return check(Robot, table, source)
