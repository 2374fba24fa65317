"""Cross-section of the four-chamber tube: a disc of wall with four round chambers, as quadrature points.

Section axes e1, e2; chamber i lies at the body angle α_i = i·90° from e1 towards e2 (plus its misalignment, if
any), its centroid on the circle of radius `chamber_centroid_radius_m`. The wall is the disc of the outer radius less
the chambers; integrals over it are Gauss sums over the disc minus Gauss sums over the chambers, exact for polynomials
up to degree 5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from softbot.errors import InputError

CHAMBERS = 4
CHAMBER_ANGLES_RAD: tuple[float, float, float, float] = (0.0, 0.5 * math.pi, math.pi, 1.5 * math.pi)

MISALIGNMENT_LIMIT_RAD = math.pi / 6.0  # beyond it a chamber would be nearer to its neighbour than to its place

# Without a drawing of the robot: chambers that fill a little over half of the disc, centroids at 0.55 R.
DEFAULT_CHAMBER_AREA_RATIO = 0.12  # of the disc πR², each
DEFAULT_CENTROID_RATIO = 0.55  # of R


@dataclass(frozen=True)
class CrossSection:
    """Geometry of the section, all lengths in metres.

    The chambers are taken as round; only their area and centroid matter to the actuator law, so what they leave of the
    wall is asked for and not whether round ones of that area would touch. Raises InputError when they leave too little.
    """

    radius_m: float
    chamber_area_m2: float
    chamber_centroid_radius_m: float
    misalignment_rad: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """By how much each chamber lies off its nominal angle, from e1 towards e2."""

    def __post_init__(self) -> None:
        for name in ("radius_m", "chamber_area_m2", "chamber_centroid_radius_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name} = {value!r}: give a positive, finite number")
        if len(self.misalignment_rad) != CHAMBERS or not all(
            abs(angle) <= MISALIGNMENT_LIMIT_RAD for angle in self.misalignment_rad
        ):
            raise InputError(
                f"misalignment_rad = {self.misalignment_rad!r}: give {CHAMBERS} angles within "
                f"±{MISALIGNMENT_LIMIT_RAD:.3g} rad, one a chamber"
            )
        if self.chamber_centroid_radius_m >= self.radius_m:
            raise InputError(
                f"chamber_centroid_radius_m = {self.chamber_centroid_radius_m:g} is not inside radius_m = "
                f"{self.radius_m:g}: the chamber centroids lie inside the tube"
            )
        if CHAMBERS * self.chamber_area_m2 >= 0.9 * math.pi * self.radius_m**2:
            raise InputError(
                f"chamber_area_m2 = {self.chamber_area_m2:g}: four chambers fill "
                f"{CHAMBERS * self.chamber_area_m2 / (math.pi * self.radius_m**2):.0%} of the section; "
                "leave at least 10 % wall"
            )
        if self.bending_area_moment_m4 <= 0.0:
            raise InputError("the chambers leave no wall that resists bending: make them smaller")

    @property
    def wall_area_m2(self) -> float:
        """Area of the wall [m²]."""
        return math.pi * self.radius_m**2 - CHAMBERS * self.chamber_area_m2

    @property
    def bending_area_moment_m4(self) -> float:
        """Second moment of the wall's area about a diameter [m⁴]; of misaligned chambers the mean over all diameters.

        Equal for every diameter where the chambers lie at their nominal angles.
        """
        disc = 0.25 * math.pi * self.radius_m**4
        own = self.chamber_area_m2**2 / (4.0 * math.pi)  # a round chamber about its own centroid
        return disc - CHAMBERS * own - 0.5 * CHAMBERS * self.chamber_area_m2 * self.chamber_centroid_radius_m**2

    def chamber_centroids_m(self) -> NDArray[np.float64]:
        """Chamber centroids in the section axes, shape (4, 2) [m]."""
        angles = np.array(CHAMBER_ANGLES_RAD) + np.array(self.misalignment_rad)
        return self.chamber_centroid_radius_m * np.column_stack([np.cos(angles), np.sin(angles)])

    def wall_points(self) -> NDArray[np.float64]:
        """Quadrature of the wall, shape (n, 3): position x1, x2 [m] and area weight [m²].

        The chambers enter with negative weights, so that every moment of the area up to degree 5 is exact.
        """
        radius_m = self.radius_m
        centroid, area = self.chamber_centroid_radius_m / radius_m, self.chamber_area_m2 / radius_m**2
        return _unit_wall_points(area, centroid, self.misalignment_rad) * np.array([radius_m, radius_m, radius_m**2])


def default_cross_section(radius_m: float) -> CrossSection:
    """The section assumed for a robot whose drawing is not given: only its outer radius [m] is known."""
    return CrossSection(
        radius_m=radius_m,
        chamber_area_m2=DEFAULT_CHAMBER_AREA_RATIO * math.pi * radius_m**2,
        chamber_centroid_radius_m=DEFAULT_CENTROID_RATIO * radius_m,
    )


@lru_cache(maxsize=64)  # a calibration builds thousands of sections of the same proportions
def _unit_wall_points(
    chamber_area: float, centroid_radius: float, misalignment_rad: tuple[float, ...]
) -> NDArray[np.float64]:
    """Quadrature of the wall of a section of radius 1, shape (n, 3), with Gauss–Legendre in r² and equal angles."""
    points = [_unit_disc_points(radial=4, angular=8)]
    chamber_radius = math.sqrt(chamber_area / math.pi)
    scale = np.array([chamber_radius, chamber_radius, -(chamber_radius**2)])
    for angle in np.array(CHAMBER_ANGLES_RAD) + np.array(misalignment_rad):
        inner = _unit_disc_points(radial=2, angular=6) * scale
        inner[:, :2] += centroid_radius * np.array([math.cos(angle), math.sin(angle)])
        points.append(inner)
    return np.ascontiguousarray(np.vstack(points))


@lru_cache(maxsize=8)
def _unit_disc_points(radial: int, angular: int) -> NDArray[np.float64]:
    node, weight = np.polynomial.legendre.leggauss(radial)
    r = np.sqrt(0.5 * (node + 1.0))
    angle = 2.0 * math.pi * (np.arange(angular) + 0.5) / angular
    x1 = np.outer(r, np.cos(angle))
    x2 = np.outer(r, np.sin(angle))
    area = np.outer(0.5 * math.pi * weight, np.full(angular, 1.0 / angular))
    return np.column_stack([x1.ravel(), x2.ravel(), area.ravel()])
