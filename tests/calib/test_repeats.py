"""The table's own repeat error, against its definition."""

from pathlib import Path

import numpy as np
import pytest

from calib import repeats
from calib.repeats import joined, repeat_error, repeat_groups
from calib.table import read_table


def test_pooled_error_is_the_standard_deviation_within_groups() -> None:
    values = np.array([1.0, 3.0, 10.0, 10.0, 13.0, 99.0])
    found = repeat_error(values, np.array([0, 0, 1, 1, 1, 2]))
    assert found is not None
    assert found.degrees_of_freedom == 3
    assert found.value == pytest.approx(np.sqrt((1 + 1 + 1 + 1 + 4) / 3))


def test_vectors_pool_both_components_and_unmeasured_rows_are_left_out() -> None:
    vectors = np.array([[1.0, 0.0], [1.0, 2.0], [np.nan, 0.0]])
    found = repeat_error(vectors, np.array([0, 0, 0]))
    assert found is not None
    assert found.value == pytest.approx(np.sqrt(2.0))


def test_without_repeats_there_is_no_error() -> None:
    assert repeat_error(np.array([1.0, 2.0]), np.array([0, 1])) is None
    assert repeat_error(np.array([np.nan, np.nan]), np.array([0, 0])) is None


def table(folder: Path, text: str) -> Path:
    path = folder / "t.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_close_pressures_of_one_branch_are_repeats(tmp_path: Path) -> None:
    text = "pressure_kPa,bend_deg,branch\n100,30,\n99.5,31,\n99.4,34,unloading\n50,15,\n100.2,32,\n"
    groups = repeat_groups(read_table(table(tmp_path, text)))
    assert groups[0] == groups[1] == groups[4]
    assert len({*groups[[0, 2, 3]]}) == 3


def test_labels_of_setpoints_stand_before_pressures(tmp_path: Path) -> None:
    text = "pressure_kPa,bend_deg,setpoint\n100,30,high\n93,31,high\n50,15,\n50,16,\n"
    groups = repeat_groups(read_table(table(tmp_path, text)))
    assert groups[0] == groups[1]
    assert groups[2] != groups[3]


def cycles(labels: bool) -> str:
    """Two chambers loaded to two pressures and released, each twice."""
    text = "trial,branch,pressure_0_kPa,pressure_1_kPa,bend_deg" + (",setpoint\n" if labels else "\n")
    for run in range(2):
        for chamber in range(2):
            for load in (60, 90):
                for branch, p in (("loading", 0), ("loading", load), ("unloading", 0)):
                    pressures = f"{p},0" if chamber == 0 else f"0,{p}"
                    label = f",{pressures.replace(',', '-')}" if labels else ""
                    text += f"{run}-{chamber}-{load},{branch},{pressures},{p / 3 + chamber + run / 10}{label}\n"
    return text


@pytest.mark.parametrize("labels", [False, True])
@pytest.mark.parametrize("long", [False, True])
def test_releases_are_repeats_after_the_same_load_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, labels: bool, long: bool
) -> None:
    if long:
        monkeypatch.setattr(repeats, "_MOST_COMPARED", 5)
    read = read_table(table(tmp_path, cycles(labels)))
    groups = repeat_groups(read)
    start, loaded, released = groups[0::3], groups[1::3], groups[2::3]
    assert len(set(start)) == 1  # each trial begins afresh
    for kind in (loaded, released):
        assert len(set(kind)) == 4  # chamber and load
        np.testing.assert_array_equal(kind[:4], kind[4:])
    assert len({*start, *loaded, *released}) == 9


def test_rests_between_loads_of_one_trial_remember_what_was_driven(tmp_path: Path) -> None:
    text = "pressure_0_kPa,pressure_1_kPa,bend_deg\n0,0,0\n90,0,30\n0,0,4\n0,90,31\n0,0,3.9\n90,0,30.5\n0,0,4.1\n"
    groups = repeat_groups(read_table(table(tmp_path, text)))
    assert groups[1] == groups[5]
    assert groups[2] == groups[6]
    assert len({*groups[[0, 1, 2, 3, 4]]}) == 5


def test_an_unloading_row_without_its_load_repeats_nothing(tmp_path: Path) -> None:
    text = "pressure_kPa,bend_deg,branch\n50,18,unloading\n50,19,unloading\n90,30,loading\n50,21,unloading\n"
    assert len(set(repeat_groups(read_table(table(tmp_path, text))))) == 4


def test_long_tables_are_grouped_alike(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "pressure_kPa,bend_deg\n" + "".join(
        f"{level},{level / 3 + n}\n" for level in (30, 60, 100) for n in range(4)
    )
    read = read_table(table(tmp_path, text))
    slow = repeat_error(read.bend_rad, repeat_groups(read))
    monkeypatch.setattr(repeats, "_MOST_COMPARED", 5)
    assert repeat_error(read.bend_rad, repeat_groups(read)) == slow


def test_rows_are_joined_where_all_keys_agree() -> None:
    number = joined([np.array([1, 1, 2, 1]), np.array([5, 6, 5, 5])])
    assert number[0] == number[3]
    assert len(set(number.tolist())) == 3
