"""What a twin is given of a robot, and what it tells of its motion: the contract that every twin keeps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from softbot.errors import SimulationError
from softbot.robot import Robot

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Body:
    """The mechanical robot: a uniform round tube with the stiffnesses of its unloaded section."""

    length_m: float
    radius_m: float
    mass_kg: float
    bending_stiffness_N_m2: float
    twisting_stiffness_N_m2: float
    axial_stiffness_N: float
    damping_time_s: float
    ovalisation_m2: float = 0.0
    """a of the bending moment EI(κ − aκ³) of a section that ovalises; 0: it keeps its shape."""

    @classmethod
    def of(cls, robot: Robot) -> Body:
        """The body of a robot file."""
        return cls(
            robot.length_m,
            robot.radius_m,
            robot.mass_kg,
            robot.bending_stiffness,
            robot.twisting_stiffness,
            robot.axial_stiffness,
            robot.damping_time_s,
            robot.ovalisation_m2,
        )

    def rest_stiffness(self) -> FloatArray:
        """Section stiffness for strains (ℓ, k1, k2) of the unloaded section, shape (3, 3)."""
        return np.diag([self.axial_stiffness_N, self.bending_stiffness_N_m2, self.bending_stiffness_N_m2])


@dataclass(frozen=True)
class World:
    """What surrounds the robot. `friction` is a coefficient (coulomb) or N s/m² (viscous).

    Axes are those of the floor: on a slope gravity is tilted, not the floor.
    """

    gravity_m_s2: float
    ground: str
    """ "plane", "step", "pipe" or "none"."""
    friction: float
    friction_law: str
    slope_rad: float = 0.0
    slope_heading_rad: float = math.pi / 2
    step_height_m: float = 0.0
    step_distance_m: float = 0.0
    pipe_radius_m: float = 0.0
    pipe_axis: str = "across"
    rolling_resistance_N_m: float = 0.0

    @property
    def gravity_vector_m_s2(self) -> FloatArray:
        """Gravity in the axes of the floor, shape (3,)."""
        downhill = self.gravity_m_s2 * math.sin(self.slope_rad)
        return np.array(
            [
                downhill * math.cos(self.slope_heading_rad),
                downhill * math.sin(self.slope_heading_rad),
                -self.gravity_m_s2 * math.cos(self.slope_rad),
            ]
        )


@dataclass(frozen=True)
class Motion:
    """The robot at one instant; world axes unless the name says body."""

    rotation: FloatArray
    """Mid cross-section: columns e1, e2, t in world axes, shape (3, 3)."""
    angular_velocity_rad_s: FloatArray
    """Of the mid cross-section, shape (3,)."""
    mid_velocity_m_s: FloatArray
    """Of the mid cross-section's centre, shape (3,)."""
    centre_of_mass_m: FloatArray
    """Of the whole robot, shape (3,)."""
    stretch: float
    """Mean axial stretch [-]."""
    curvature_1_m: FloatArray
    """Mean curvature vector in the body frame per reference length, shape (2,) [1/m]."""
    chord: FloatArray
    """Unit vector from the first end to the last, shape (3,)."""
    angular_momentum_kg_m2_s: FloatArray
    """About the centre of mass, shape (3,)."""


class BrokenOff(SimulationError):
    """A twin left its range while it played; `rows` of motion are what it played before, shape (n, ROW_SIZE).

    seen: where it was at them and before the first, of a twin that tells (`sim.rod.RodTwin.play_seen`).
    """

    def __init__(self, message: str, rows: FloatArray) -> None:
        super().__init__(message)
        self.rows = rows
        self.seen = np.empty((0, 0))


class Twin(Protocol):
    """A mechanical twin: rest strains and stiffness in, motion out."""

    @property
    def step_s(self) -> float:
        """Step of the integration [s]."""

    def set_rest(self, strain: FloatArray, stiffness: FloatArray) -> None:
        """Rest strains (ℓ, k1, k2) and section stiffness (3, 3), held until the next call."""

    def step(self) -> None:
        """Advance by one step. Raises SimulationError when the state is no longer finite."""

    def strain(self) -> FloatArray:
        """Mean strains (ℓ, k1, k2) now, shape (3,): cheap, for every step."""

    def motion(self) -> Motion:
        """The robot now."""

    def shape(self) -> tuple[FloatArray, FloatArray]:
        """Centre line (n, 3) [m] and section axis e1 (n, 3) along the robot now."""

    def close(self) -> None:
        """Release what the engine holds."""
