"""Fit the library of silicones to their tensile tests: `python -m calib.fit_materials [OUT.toml]`.

Reads the shipped tests (`calib/data/marechal_tensile`) and writes `softbot/data/materials.toml`: for each silicone the
law with the least score (`calib.tensile_test`), its parameters and how far its stiffness is to be trusted. That is a
standard deviation of the logarithm, from three things that add as squares:

- the scatter of the test itself: standard error of its slope between 3 and 20 % strain; - the choice of the law: spread
of the hoop-constrained stress at stretches of 1.1, 1.3 and 1.6 between the laws that leave at
  most 5 % of the test;
- tests and batches: each silicone was pulled once, so its spread is taken from the one that others have tested too. Of
  Ecoflex 00-30 there are a second tensile test and a relaxation test (`calib/data/epfl_ecoflex_bending`, MIT); the
  standard deviation of the three moduli's logarithms is used for all.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.tensile_test import FITTED_TO_STRAIN, TensileTest, WallFit, fit_laws, read_tensile_test
from softbot.errors import SoftbotError
from softbot.material import MATERIALS, material_parameters, nominal_stress, uniaxial_stress_Pa
from softbot.silicone import MATERIALS_SCHEMA
from softbot.toml_file import write_toml

DATA = Path(__file__).parent / "data"
TESTS = DATA / "marechal_tensile"
DENSITY_KG_M3 = 1070.0  # of all five, by their makers' data sheets
TESTED_BY_OTHERS = "Ecoflex 00-30"
_STRETCHES = (1.1, 1.3, 1.6)
_GOOD_FIT_PERCENT = 5.0


def tensile_tests() -> list[TensileTest]:
    """The shipped tests, softest first."""
    tests = [read_tensile_test(path) for path in sorted(TESTS.glob("*.csv"))]
    return sorted(tests, key=lambda test: test.small_strain_modulus_Pa()[0])


def moduli_of_others_Pa(strain: np.ndarray) -> list[float]:
    """Slopes at these strains of Ecoflex 00-30 by a second tensile test (Yeoh) and by a relaxation test (G₀) [Pa]."""
    folder = DATA / "epfl_ecoflex_bending"
    yeoh = _numbers(folder / "material_yeoh--Uniaxial.txt", "params")
    relaxation = _numbers(folder / "material_visco--large--2terms.txt", "G0")
    laws: list[tuple[str, dict[str, float]]] = [
        ("yeoh", dict(zip(MATERIALS["yeoh"].keys, (2e6 * yeoh[0], 0.0, 1e6 * yeoh[2]), strict=True))),
        ("neo-hookean", {"modulus_Pa": 1e6 * relaxation[0]}),
    ]
    # The source's second Yeoh coefficient is negative; it changes the slope here by less than 1 % and is left out.
    return [float(np.polyfit(strain, uniaxial_stress_Pa(law, values, 1.0 + strain), 1)[0]) for law, values in laws]


def spread_between_tests(tests: Sequence[TensileTest]) -> float:
    """Standard deviation of the logarithm of a silicone's modulus between tests and batches."""
    ours = next(test for test in tests if test.name == TESTED_BY_OTHERS)
    strain = ours.strain[ours.is_small()]
    moduli = [ours.small_strain_modulus_Pa()[0], *moduli_of_others_Pa(strain)]
    return float(np.std(np.log(moduli), ddof=1))


def law_spread(fits: Sequence[WallFit]) -> float:
    """Standard deviation of the logarithm of the hoop-constrained stress between the laws that fit a test."""
    good = [fit for fit in fits if fit.rms_percent <= _GOOD_FIT_PERCENT]
    if len(good) < 2:
        return 0.0
    stress = [
        [nominal_stress(MATERIALS[fit.law].code, material_parameters(fit.law, fit.values), at) for at in _STRETCHES]
        for fit in good
    ]
    return float(np.std(np.log(stress), axis=0, ddof=1).max())


def library() -> dict[str, Any]:
    """The tables of `softbot/data/materials.toml`."""
    tests = tensile_tests()
    spread = spread_between_tests(tests)
    silicones = []
    for test in tests:
        fits = fit_laws(test)
        best = fits[0]
        slope_Pa, error_Pa = test.small_strain_modulus_Pa()
        parts = {"test": error_Pa / slope_Pa, "law": law_spread(fits), "tests_and_batches": spread}
        silicones.append(
            {
                "name": test.name,
                "law": best.law,
                **{key: _rounded(value) for key, value in best.values.items()},
                "density_kg_m3": DENSITY_KG_M3,
                "small_strain_modulus_Pa": _rounded(best.modulus_Pa),
                "measured_small_strain_modulus_Pa": _rounded(slope_Pa),
                "offset_Pa": _rounded(best.offset_Pa),
                "rms_percent": _rounded(best.rms_percent),
                "fitted_to_strain": FITTED_TO_STRAIN,
                "stiffness_log_sd": _rounded(math.sqrt(sum(part**2 for part in parts.values()))),
                "stiffness_log_sd_parts": {key: _rounded(part) for key, part in parts.items()},
                "source": "; ".join(test.comments),
            }
        )
    return {
        "schema": MATERIALS_SCHEMA,
        "made_by": "python -m calib.fit_materials (its docstring says how)",
        "licence": "Contains information from the Soft-Robotics-Materials-Database of L. Marechal et al., which is "
        "made available under the Open Database License (ODbL 1.0), https://opendatacommons.org/licenses/odbl/1-0/",
        "silicone": silicones,
    }


def _numbers(path: Path, key: str) -> list[float]:
    line = next(line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith(f"{key}:"))
    return [float(word) for word in line.split()[1:]]


def _rounded(value: float) -> float:
    return float(f"{value:.5g}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the library into the package, or to the file that is named."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if len(given) > 1:
        print("usage: python -m calib.fit_materials [OUT.toml]", file=sys.stderr)
        return 2
    package = Path(__file__).parents[1] / "softbot" / "data" / "materials.toml"
    try:
        write_toml(Path(given[0]) if given else package, library())
    except SoftbotError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
