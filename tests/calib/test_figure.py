"""The picture of a calibration: written, in each format, for few and for many combinations of chambers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.figure import draw_table, save_figure
from calib.fit import calibrate_table
from calib.model_choice import Geometry
from calib.table import read_table
from softbot.errors import InputError

SHIPPED = Path(calib.__file__).parent / "data" / "asu_four_chamber_arm" / "table.csv"


def test_shipped_table_is_drawn_with_its_curves(tmp_path: Path) -> None:
    found = calibrate_table(read_table(SHIPPED), Geometry(length_m=0.134), law="neo-hookean")
    save_figure(found, tmp_path / "fit.svg")
    assert "<svg" in (tmp_path / "fit.svg").read_text(encoding="utf-8")


def test_rows_at_rest_and_many_combinations_are_drawn(tmp_path: Path, make_table) -> None:
    ramp = calibrate_table(read_table(make_table(np.linspace(0.0, 9e4, 6), noise_deg=0.2)), law="linear")
    save_figure(ramp, tmp_path / "ramp.png")
    assert (tmp_path / "ramp.png").read_bytes().startswith(b"\x89PNG")
    mixed = np.random.default_rng(1).uniform(0.0, 8e4, (30, 4))
    table = read_table(make_table(mixed, noise_deg=0.2, columns=("direction", "length"), seed=1))
    save_figure(calibrate_table(table, law="linear"), tmp_path / "mixed.png")
    assert (tmp_path / "mixed.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("source", "title"),
    [
        ("psi.csv", "psi.csv"),
        ("./psi.csv", "psi.csv"),
        ("lab/psi.csv", "lab/psi.csv"),
        ("/a/lab/psi.csv", "lab/psi.csv"),
    ],
)
def test_title_is_the_table_with_the_folder_that_was_given(source: str, title: str) -> None:
    table = replace(read_table(SHIPPED), source=source)
    figure = draw_table(calibrate_table(table, Geometry(length_m=0.134), law="linear"))
    assert figure.get_suptitle().splitlines()[0] == title


def test_unknown_formats_and_places_are_refused(tmp_path: Path) -> None:
    found = calibrate_table(read_table(SHIPPED), Geometry(length_m=0.134), law="linear")
    with pytest.raises(InputError, match=r"ends in \.png"):
        save_figure(found, tmp_path / "fit.gif")
    with pytest.raises(InputError, match="cannot be written"):
        save_figure(found, tmp_path / "missing" / "fit.png")
