"""Release holds: the share that stays is found again, with an interval, and stands in the lack-of-fit test."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.bend_table import BendTable
from calib.fit import calibrate_table
from calib.model_choice import Geometry
from calib.table import read_table

TABLE = Path(calib.__file__).parent / "data" / "asu_four_chamber_arm" / "table.csv"
ARM = Geometry(length_m=0.134)


@pytest.fixture(scope="module")
def table() -> BendTable:
    return read_table(TABLE)


def test_shipped_loads_and_releases_differ_no_more_than_repeats(table: BendTable) -> None:
    found = calibrate_table(table, ARM)
    assert found.release is not None
    assert len(found.release.rows) == 4
    assert 0.1 < found.release.share < 0.35
    assert found.release.low < found.release.share < found.release.high
    report = found.report()
    assert report["lack_of_fit_p"] > 0.05
    assert report["release_rms_bend_percent"] < 1.5 * report["repeat_bend_percent"]
    assert report["release_rms_length_percent"] < 1.5 * report["repeat_length_percent"]


def test_releases_do_not_move_the_law(table: BendTable) -> None:
    with_them, without = (calibrate_table(one, ARM) for one in (table, table.rows(table.loading)))
    assert without.release is None
    for name, one in without.parameters.items():
        assert with_them.parameters[name] == one


def test_a_known_share_is_found_again(table: BendTable) -> None:
    found = calibrate_table(table, ARM)
    assert found.release is not None
    lost = found.release.rows
    before = {
        row.trial[0]: row.pressure_Pa[0]
        for row in (table.rows(np.array([n])) for n in range(len(table)))
        if row.loading[0]
    }
    felt = np.array(
        [p + 0.3 * np.maximum(before[name] - p, 0.0) for p, name in zip(lost.pressure_Pa, lost.trial, strict=True)]
    )
    bend, length = found.bend_and_length(felt)
    made = replace(lost, bend_rad=np.hypot(*bend.T), direction_rad=np.arctan2(bend[:, 1], bend[:, 0]), length_m=length)
    changed = replace(
        table,
        **{
            name: np.where(table.loading, getattr(table, name), np.nan)
            for name in ("bend_rad", "direction_rad", "length_m")
        },
    )
    for name in ("bend_rad", "direction_rad", "length_m"):
        getattr(changed, name)[~table.loading] = getattr(made, name)
    again = calibrate_table(changed, ARM)
    assert again.release is not None
    assert again.release.share == pytest.approx(0.3, abs=1e-3)


def test_releases_without_their_hold_are_reported_only(table: BendTable) -> None:
    lonely = replace(table, trial=np.where(table.loading, table.trial, ""))
    found = calibrate_table(lonely, ARM)
    assert found.release is None
    assert any("are not fitted: give each row the trial of the hold before it" in text for text in found.warnings)


def test_robot_file_has_the_residual_strain_where_asked(table: BendTable) -> None:
    found = calibrate_table(table, ARM)
    assert "memory" not in found.robot_table("arm")
    residual = found.robot_table("arm", memory=True)["memory"]["residual"]
    assert residual["share"] == pytest.approx(found.release.share, rel=1e-4)
