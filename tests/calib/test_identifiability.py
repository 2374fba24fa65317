"""What a table cannot tell, in words; and what to measure next."""

from pathlib import Path

import numpy as np
import pytest

import calib
from calib.advice import COORDINATE_REMEDY, PLAIN
from calib.design import next_rows
from calib.fit import calibrate_table
from calib.identifiability import directions, sentences
from calib.model import BOUNDS
from calib.model_choice import Geometry
from calib.robust_fit import observations
from calib.table import read_table

DATA = Path(calib.__file__).parent / "data"


def test_a_direction_that_is_not_seen_is_named_with_its_parts() -> None:
    seen = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])  # only the sum of the first two, and the third
    found = directions(("dead_band", "gain", "modulus"), 1e4 * seen.T @ seen)
    vague = [one for one in found if one.is_vague]
    assert len(vague) == 1
    assert set(vague[0].names) == {"dead_band", "gain"}
    assert vague[0].signs[0] == -vague[0].signs[1]
    said = sentences(
        found, {"dead_band": "the dead band", "gain": "the gain"}, {"dead_band": "add points under 20 kPa"}
    )
    assert len(said) == 1
    assert "cannot tell" in said[0]
    assert "the dead band" in said[0]
    assert "the gain" in said[0]
    assert said[0].endswith("add points under 20 kPa")


def test_every_coordinate_has_words_and_a_remedy() -> None:
    assert set(PLAIN) == set(BOUNDS)
    assert {*COORDINATE_REMEDY, "dead_band"} == set(BOUNDS)  # the dead band's depends on the table


def test_what_is_seen_well_is_not_mentioned() -> None:
    assert sentences(directions(("a", "b"), 1e4 * np.eye(2)), {}, {}) == []
    assert directions(("a", "b"), 1e4 * np.eye(2))[0].standard_deviation == pytest.approx(0.01)


def test_laws_that_predict_alike_are_told_apart_first() -> None:
    found = calibrate_table(read_table(DATA / "asu_four_chamber_arm" / "table.csv"), Geometry(length_m=0.134))
    words = [one.words for one in found.measure_next]
    assert "differ by" in words[0]
    level_kPa = np.max(found.measure_next[0].pressure_Pa) / 1e3
    assert 40.0 < level_kPa < 90.0  # all its holds are at 103 kPa: the middle is where the laws part
    assert all("chamber" in text and "kPa" in text for text in words)


def test_the_next_row_narrows_the_band(make_table) -> None:
    path = make_table(np.linspace(6e4, 9e4, 6), noise_deg=0.5, noise_mm=0.5, columns=("length",))
    table = read_table(path)
    found = calibrate_table(table, Geometry(length_m=0.2), law="neo-hookean")
    rows = observations(table, np.radians(0.5), 5e-4)
    shares = [float(one.why.split("narrows to ")[1].split(" %")[0]) for one in next_rows(found.fit, rows)]
    assert shares[0] < 100.0
    assert shares == sorted(shares, reverse=True)


def test_no_advice_is_given_on_a_law_that_does_not_fit() -> None:
    found = calibrate_table(read_table(DATA / "epfl_ecoflex_bending" / "stepwise.csv"))
    assert found.measure_next == ()
    assert any("limit point" in text for text in found.warnings)
