"""Tensile tests: known walls are found again, the shipped library is what the shipped tests give, their moduli hold."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib import fit_materials, reduce_marechal
from calib.fit_materials import law_spread, library, spread_between_tests, tensile_tests
from calib.tensile_figure import save_figures
from calib.tensile_test import TensileTest, fit_law, fit_laws, read_tensile_test
from softbot.errors import InputError
from softbot.material import uniaxial_stress_Pa
from softbot.silicone import silicones
from softbot.toml_file import read_toml

# Slopes between 3 and 20 % strain of the source's own rows [kPa], as the data's description states them.
EXPECTED_kPa = {
    "Ecoflex 00-30": 45.0,
    "Ecoflex 00-50": 71.0,
    "Dragon Skin 10": 127.0,
    "Dragon Skin 20": 312.0,
    "Dragon Skin 30": 468.0,
}
STRAIN = np.linspace(0.04, 1.4, 62)


def pulled(law: str, values: dict[str, float], offset_Pa: float = 0.0) -> TensileTest:
    return TensileTest("made up", STRAIN, uniaxial_stress_Pa(law, values, 1.0 + STRAIN) + offset_Pa)


@pytest.mark.parametrize("name", EXPECTED_kPa)
def test_small_strain_modulus_of_the_fitted_law_is_that_of_the_test(name: str) -> None:
    assert silicones()[name].measured_small_strain_modulus_Pa / 1e3 == pytest.approx(EXPECTED_kPa[name], rel=0.01)
    assert silicones()[name].small_strain_modulus_Pa / 1e3 == pytest.approx(EXPECTED_kPa[name], rel=0.1)
    assert silicones()[name].rms_percent < 3.0


def test_shipped_library_is_what_the_script_makes_of_the_shipped_tests(tmp_path: Path) -> None:
    assert fit_materials.main([str(tmp_path / "made.toml")]) == 0
    made = read_toml(tmp_path / "made.toml")["silicone"]
    for one in made:
        shipped = silicones()[one["name"]]
        assert shipped.law == one["law"]
        assert shipped.parameters == pytest.approx({key: one[key] for key in shipped.parameters}, rel=1e-3, abs=1.0)
        assert shipped.stiffness_log_sd == pytest.approx(one["stiffness_log_sd"], rel=1e-2)
    assert [one["name"] for one in made] == list(silicones())
    assert "Open Database License" in library()["licence"]


@settings(max_examples=20)
@given(
    modulus_Pa=st.floats(5e3, 5e5),
    beyond=st.floats(0.02, 0.1),
    offset=st.floats(-0.03, 0.03),
    law=st.sampled_from(["neo-hookean", "yeoh", "gent", "mooney-rivlin"]),
)
def test_known_wall_is_found_again(modulus_Pa: float, beyond: float, offset: float, law: str) -> None:
    values = {"modulus_Pa": modulus_Pa} | {
        "neo-hookean": {},
        "yeoh": {"stiffening_Pa": beyond * modulus_Pa, "stiffening_2_Pa": 0.1 * beyond * modulus_Pa},
        "gent": {"limit_invariant": 0.5 / beyond},
        "mooney-rivlin": {"second_share": 5.0 * beyond},
    }[law]
    fit = fit_law(pulled(law, values, offset * modulus_Pa), law)
    assert fit.values == pytest.approx(values, rel=0.02, abs=1e-3 * modulus_Pa)
    assert fit.offset_Pa == pytest.approx(offset * modulus_Pa, abs=1e-3 * modulus_Pa)
    assert fit.rms_percent < 0.1


def test_the_simplest_law_that_fits_is_taken_and_one_that_cannot_is_last() -> None:
    assert fit_laws(pulled("neo-hookean", {"modulus_Pa": 3e4}))[0].law == "neo-hookean"
    fits = fit_laws(pulled("gent", {"modulus_Pa": 2e5, "limit_invariant": 6.0}))
    assert fits[0].law == "gent"
    assert {fit.law for fit in fits[2:]} == {"neo-hookean", "mooney-rivlin"}


def test_band_has_the_three_parts_it_names() -> None:
    tests = tensile_tests()
    assert 0.1 < spread_between_tests(tests) < 0.3  # three moduli of one silicone
    fits = fit_laws(next(test for test in tests if test.name == "Dragon Skin 20"))
    assert law_spread(fits[:1]) == 0.0
    assert 0.0 < law_spread(fits) < 0.05  # neo-Hookean leaves over 5 % and has no say
    for one in silicones().values():
        parts = one.stiffness_log_sd_parts
        assert set(parts) == {"test", "law", "tests_and_batches"}
        assert one.stiffness_log_sd == pytest.approx(math.hypot(*parts.values()), rel=1e-3)


def test_every_silicone_has_a_picture(tmp_path: Path) -> None:
    pictures = save_figures(tmp_path / "new")
    assert [path.stem.replace("_", " ") for path in pictures] == list(silicones())
    assert all(path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 10_000 for path in pictures)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        save_figures(tmp_path / "file")


# --- reading and reducing ------------------------------------------------------------

SOURCE = """PARAMETER;INFO;URL;;
Specimen Thickness (mm);3;;;
Specimen Width (mm);6;;;
Specimen Length (mm);33;;;
Standard;ASTM D412;;;
Speed (mm/min);450;;;
;;;;
Time (s);True Strain;True Stress (MPa);Engineering Strain;Engineering Stress (MPa)
0.2;0.0436;0.0181;0.0446;0.01736
0.3;0.0657;0.0316;0.0679533333333333;0.0296412345
9.9;1.1;9.9;2.0;0.9
"""


def test_source_is_reduced_to_what_is_shipped(tmp_path: Path) -> None:
    for stem in reduce_marechal.NAMES:
        (tmp_path / f"{stem}.csv").write_text(SOURCE)
    out = tmp_path / "out"
    out.mkdir()
    assert reduce_marechal.main([str(tmp_path), str(out)]) == 0
    test = read_tensile_test(out / "Dragon_Skin_30.csv")
    assert test.name == "Dragon Skin 30"
    np.testing.assert_allclose(test.strain, [0.0446, 0.0679533])
    np.testing.assert_allclose(test.stress_Pa, [17360.0, 29641.2])
    assert "450 mm/min" in test.comments[0]


def test_what_cannot_be_reduced_or_read_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert reduce_marechal.main([str(tmp_path)]) == 2
    assert "no such file" in capsys.readouterr().err
    assert reduce_marechal.main([]) == 2
    assert fit_materials.main(["a", "b"]) == 2
    assert fit_materials.main([str(tmp_path / "no" / "where.toml")]) == 2
    wrong = tmp_path / "Dragon_Skin_30.csv"
    for text, says in (
        ("a;b\n", "no column 'Engineering Strain'"),
        ("# x: y\nstrain,stress\n1,2\n", "not a reduced tensile test"),
        ("# x: y\nengineering_strain,engineering_stress_MPa\n1,b\n", "two numbers"),
    ):
        wrong.write_text(text)
        with pytest.raises(InputError, match=says):
            reduce_marechal.reduced(wrong) if ";" in text else read_tensile_test(wrong)
    with pytest.raises(InputError, match="cannot be read"):
        read_tensile_test(tmp_path / "none.csv")
    with pytest.raises(InputError, match="fewer than three rows"):
        TensileTest("x", np.array([0.5, 0.6]), np.array([1.0, 2.0])).small_strain_modulus_Pa()
