"""A tensile test of a silicone, and the wall laws that fit it.

A law is fitted to the nominal stress of the test with a constant stress besides (load cells of these tests do not start
at zero), up to a strain of 100 %. Robust where it matters to a robot: relative errors count, and the slope between 3
and 20 % strain, in which walls of robots work most, is kept as a datum of its own. Neighbouring points of one pull are
not independent; together they count as `_INDEPENDENT` numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from softbot.errors import InputError
from softbot.material import MATERIALS, uniaxial_stress_Pa

FloatArray = NDArray[np.float64]

SMALL_STRAINS = (0.03, 0.20)
FITTED_TO_STRAIN = 1.0
LAWS = ("neo-hookean", "mooney-rivlin", "yeoh", "gent")
_INDEPENDENT = 10.0
_SLOPE_ERROR = 0.03
_RELATIVE_ERROR = 0.05
_NO_STIFFENING = 1e-6  # of the modulus: less of it is none
_CELL_ERROR_Pa = 300.0  # scatter of neighbouring points of the softest test

# Coordinates of the parameters beyond the modulus: (of the coordinate) start, low, high; the value is its exponential,
# of `second_share` the coordinate itself, of the stiffenings times the modulus.
_COORDINATES = {
    "second_share": (0.3, 0.0, 1.0),
    "stiffening_Pa": (math.log(0.05), math.log(1e-8), math.log(1e2)),
    "stiffening_2_Pa": (math.log(0.005), math.log(1e-8), math.log(1e2)),
    "limit_invariant": (math.log(30.0), math.log(2.5), math.log(1e6)),
}


@dataclass(frozen=True)
class TensileTest:
    """One pull: engineering strain and stress [Pa], shape (n,) each, rising strain; comments of its file."""

    name: str
    strain: FloatArray
    stress_Pa: FloatArray
    comments: tuple[str, ...] = ()

    def small_strain_modulus_Pa(self) -> tuple[float, float]:
        """Slope of the stress between 3 and 20 % strain by regression, and its standard error [Pa]."""
        near = self.is_small()
        if near.sum() < 3:
            raise InputError(f"{self.name}: fewer than three rows between 3 and 20 % strain")
        slope, offset = np.polyfit(self.strain[near], self.stress_Pa[near], 1)
        left = self.stress_Pa[near] - slope * self.strain[near] - offset
        spread = self.strain[near] - self.strain[near].mean()
        error = math.sqrt(left @ left / (near.sum() - 2) / (spread @ spread))
        return float(slope), error

    def is_small(self) -> NDArray[np.bool_]:
        """Rows between 3 and 20 % strain, shape (n,)."""
        low, high = SMALL_STRAINS
        return (self.strain >= low) & (self.strain <= high)


@dataclass(frozen=True)
class WallFit:
    """A law fitted to a test: parameters by key, constant stress, and how well it does."""

    law: str
    values: dict[str, float]
    offset_Pa: float
    modulus_Pa: float
    """Slope of the fitted curve between 3 and 20 % strain, as that of the test is taken."""
    rms_percent: float
    """Root mean square of the residuals, of the largest fitted stress."""
    score: float
    """Sum of squares plus twice the number of parameters: the least is the best (Akaike)."""

    def stress_Pa(self, strain: FloatArray) -> FloatArray:
        """The test's stress as the law and its offset have it [Pa]."""
        return uniaxial_stress_Pa(self.law, self.values, 1.0 + strain) + self.offset_Pa


def read_tensile_test(path: Path) -> TensileTest:
    """A shipped tensile test: comment lines, then engineering_strain,engineering_stress_MPa. Raises InputError."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    comments = tuple(line.lstrip("# ") for line in lines if line.startswith("#"))
    rows = [line for line in lines if line and not line.startswith("#")]
    if not rows or rows[0] != "engineering_strain,engineering_stress_MPa" or not comments:
        raise InputError(f"{path}: not a reduced tensile test; make it with python -m calib.reduce_marechal")
    try:
        numbers = np.array([[float(cell) for cell in row.split(",")] for row in rows[1:]])
        strain, stress_MPa = numbers.T
    except ValueError:
        raise InputError(f"{path}: a row does not hold two numbers") from None
    return TensileTest(comments[0].partition(":")[0], strain, 1e6 * stress_MPa, comments)


def fit_law(test: TensileTest, law: str) -> WallFit:
    """`law` fitted to a test up to a strain of 100 %. Raises InputError for a test without rows at small strains."""
    keys = MATERIALS[law].keys[1:]
    slope_Pa, _ = test.small_strain_modulus_Pa()
    small = test.strain[test.is_small()]
    used = test.strain <= FITTED_TO_STRAIN
    strain, stress = test.strain[used], test.stress_Pa[used]
    weight = math.sqrt(_INDEPENDENT / strain.size) / np.hypot(_CELL_ERROR_Pa, _RELATIVE_ERROR * stress)

    def values(theta: FloatArray) -> dict[str, float]:
        modulus_Pa = math.exp(theta[0])
        found = {"modulus_Pa": modulus_Pa}
        for key, coordinate in zip(keys, theta[2:], strict=True):
            value = float(coordinate) if key == "second_share" else math.exp(coordinate)
            if key.endswith("_Pa"):
                value = value * modulus_Pa if value > _NO_STIFFENING else 0.0
            found[key] = value
        return found

    def modulus_Pa(theta: FloatArray) -> float:
        return float(np.polyfit(small, uniaxial_stress_Pa(law, values(theta), 1.0 + small), 1)[0])

    def residuals(theta: FloatArray) -> FloatArray:
        curve = uniaxial_stress_Pa(law, values(theta), 1.0 + strain) + theta[1] * slope_Pa - stress
        return np.append(curve * weight, (modulus_Pa(theta) / slope_Pa - 1.0) / _SLOPE_ERROR)

    free = [_COORDINATES[key] for key in keys]
    start = np.array([math.log(slope_Pa / 2.5), 0.0, *(one[0] for one in free)])
    low = np.array([start[0] - 3.0, -0.5, *(one[1] for one in free)])
    high = np.array([start[0] + 3.0, 0.5, *(one[2] for one in free)])
    found = least_squares(residuals, start, bounds=(low, high), x_scale="jac")
    fitted = values(found.x)
    left = uniaxial_stress_Pa(law, fitted, 1.0 + strain) + found.x[1] * slope_Pa - stress
    return WallFit(
        law,
        fitted,
        float(found.x[1] * slope_Pa),
        modulus_Pa(found.x),
        float(100.0 * np.sqrt(np.mean(left**2)) / np.abs(stress).max()),
        float(2.0 * found.cost + 2.0 * (1 + len(keys))),
    )


def fit_laws(test: TensileTest) -> list[WallFit]:
    """All laws fitted to a test, the best first."""
    return sorted((fit_law(test, law) for law in LAWS), key=lambda fit: fit.score)
