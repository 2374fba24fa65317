"""Headers of a table: what people write, and what it means."""

import pytest

from calib.units import split_header, unit_name


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("pressure_kPa", "pressure", "kpa"),
        ("pressure_0_kPa", "pressure_0", "kpa"),
        ("Pressure (psi)", "pressure", "psi"),
        ("Pressure(KPa)", "pressure", "kpa"),
        ("pressure [N/mm2]", "pressure", "n/mm2"),
        ("pressure_N_mm2", "pressure", "n/mm2"),
        ("pressure / bar", "pressure", "bar"),
        ("bend deg", "bend", "deg"),
        ("bend [°]", "bend", "deg"),
        ("curvature_1_m", "curvature", "1/m"),
        ("length_mm", "length", "mm"),
        ("t_s", "t", "s"),
    ],
)
def test_header_gives_name_and_unit(header: str, name: str, unit: str) -> None:
    found, text = split_header(header)
    assert found == name
    assert text is not None
    assert unit_name(text) == unit


@pytest.mark.parametrize("header", ["trial", "branch", "Angular Disp.", "pressure"])
def test_header_without_a_unit_has_none(header: str) -> None:
    assert split_header(header)[1] is None


def test_unknown_units_are_not_guessed() -> None:
    assert unit_name("furlong") is None
    assert unit_name("") is None
