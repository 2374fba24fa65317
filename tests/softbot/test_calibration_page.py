"""The page of a calibration: whole, offline, and with what was found in it."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

import calib
from calib.calibration import Calibration
from calib.fit import calibrate_table
from calib.model_choice import Geometry
from calib.recording import trials_of
from calib.series_calibration import SeriesCalibration, calibrate_recording
from calib.table import read_rows, read_table
from softbot.errors import InputError
from softbot.report.calibration_page import render_calibration, write_calibration_page

DATA = Path(calib.__file__).parent / "data" / "asu_four_chamber_arm"


@pytest.fixture(scope="module")
def holds() -> Calibration:
    return calibrate_table(read_table(DATA / "table.csv"), Geometry(length_m=0.134))


@pytest.fixture(scope="module")
def recording() -> SeriesCalibration:
    rows = read_rows(DATA / "series.csv")
    return calibrate_recording(rows.rows(rows.trial == "apr4_4"), Geometry(0.134, 0.029), "gent")


def test_page_of_holds_says_what_was_found(holds: Calibration) -> None:
    page = render_calibration(holds)
    for words in ("neo-hookean", "residual_share", "lack-of-fit test p", "What to measure next", "apr4_2", "linear"):
        assert words in page
    assert page.count("<svg") == 2
    for kind in ("Curves", "Residuals", "Errors", "Parameters", "What was chosen, and why", "Assumed"):
        assert f"<h2>{kind}" in page


def test_page_of_a_recording_shows_steps_releases_and_loops(recording: SeriesCalibration) -> None:
    page = render_calibration(recording)
    for words in (
        "What to measure next",
        "One trial is followed to",
        "memory: hysteresis",
        "loop over the sensor",
        "residual",
        "apr4_4",
    ):
        assert words in page
    assert len(trials_of(recording.table)[0]) == 1


def test_page_refers_to_nothing_outside_itself(holds: Calibration, recording: SeriesCalibration) -> None:
    for one in (holds, recording):
        page = render_calibration(one)
        outside = [link for link in re.findall(r'(?:href|src)="([^"]*)"', page) if not link.startswith("#")]
        assert outside == []
        assert "<script" not in page
        assert "url(http" not in page


def test_names_from_a_table_are_text_on_the_page(holds: Calibration) -> None:
    hostile = replace(holds, table=replace(holds.table, source="<script>alert(1)</script>.csv"))
    assert "<script" not in render_calibration(hostile)


def test_page_is_written_whole_or_refused(holds: Calibration, tmp_path: Path) -> None:
    write_calibration_page(holds, tmp_path / "page.html")
    assert (tmp_path / "page.html").read_text(encoding="utf-8").rstrip().endswith("</html>")
    with pytest.raises(InputError, match=r"ends in \.html"):
        write_calibration_page(holds, tmp_path / "page.pdf")
    with pytest.raises(InputError, match="cannot be written"):
        write_calibration_page(holds, tmp_path / "nowhere" / "page.html")
