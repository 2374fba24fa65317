"""Reading a bending-angle–pressure table: every spelling that is right, one clear message for what is not."""

import math
from pathlib import Path

import numpy as np
import pytest

from calib.plausibility import ATMOSPHERE_PA
from calib.table import parse_columns, read_table
from softbot.errors import InputError

PRESSURE_KPA = (20.0, 40.0, 60.0, 80.0)
BEND_DEG = (8.0, 16.5, 25.5, 35.0)


def write(folder: Path, text: str, encoding: str = "utf-8") -> Path:
    path = folder / "bends.csv"
    path.write_bytes(text.encode(encoding))
    return path


def rows(pressures: tuple[float, ...] = PRESSURE_KPA, bends: tuple[float, ...] = BEND_DEG, mark: str = ",") -> str:
    return "".join(f"{p:g}{mark}{b:g}\n" for p, b in zip(pressures, bends, strict=True))


def scaled(pressure: float, bend: float) -> str:
    return rows(tuple(pressure * p for p in PRESSURE_KPA), tuple(bend * b for b in BEND_DEG))


GOOD = {
    "plain": "pressure_kPa,bend_deg\n" + rows(),
    "semicolons": "pressure_kPa;bend_deg\n" + rows(mark=";"),
    "tabs": "pressure_kPa\tbend_deg\n" + rows(mark="\t"),
    "decimal commas": "pressure_kPa;bend_deg\n20,0;8,0\n40,0;16,5\n60,0;25,5\n80,0;35,0\n",
    "quoted decimal commas": 'pressure_kPa,bend_deg\n"20,0",8\n40,"16,5"\n60,"25,5"\n80,35\n',
    "quoted headers": '"pressure_kPa","bend_deg"\n' + rows(),
    "comments and blank lines": "# measured on a Monday\n\npressure_kPa,bend_deg\n# halfway\n" + rows() + "\n\n;;\n",
    "windows line ends": ("pressure_kPa,bend_deg\n" + rows()).replace("\n", "\r\n"),
    "units in brackets": "Pressure (kPa),Bending angle [deg]\n" + rows(),
    "a second header line of units": "pressure,bend\nkPa,deg\n" + rows(),
    "Pa and rad": "pressure_Pa,bend_rad\n" + scaled(1e3, math.pi / 180.0),
    "MPa": "pressure_MPa,bend_deg\n" + scaled(1e-3, 1.0),
    "N/mm2": "pressure [N/mm2],bend_deg\n" + scaled(1e-3, 1.0),
    "bar": "pressure_bar,bend_deg\n" + scaled(1e-2, 1.0),
    "psi": "pressure_psi,bend_deg\n"
    + "".join(f"{p / 6.894757293168:.12g},{b:g}\n" for p, b in zip(PRESSURE_KPA, BEND_DEG, strict=True)),
    "unused columns": "operator,pressure_kPa,bend_deg,weather\n"
    + "".join(f"Ann,{p:g},{b:g},fine\n" for p, b in zip(PRESSURE_KPA, BEND_DEG, strict=True)),
    "copied rows": "pressure_kPa,bend_deg\n" + rows() + rows(),
    "trailing separators": "pressure_kPa,bend_deg,\n" + rows().replace("\n", ",\n"),
    "absolute pressure": "pressure_absolute_kPa,bend_deg\n"
    + rows(tuple(p + ATMOSPHERE_PA / 1e3 for p in PRESSURE_KPA)),
    "one of four chambers": "pressure_0_kPa,pressure_1_kPa,bend_deg\n"
    + "".join(f"{p:g},0,{b:g}\n" for p, b in zip(PRESSURE_KPA, BEND_DEG, strict=True)),
    "a chamber column": "pressure_kPa,chamber,bend_deg\n"
    + "".join(f"{p:g},0,{b:g}\n" for p, b in zip(PRESSURE_KPA, BEND_DEG, strict=True)),
    "all bends negative": "pressure_kPa,bend_deg\n" + scaled(1.0, -1.0),
    "time and branch": "t_s,pressure_kPa,bend_deg,branch\n"
    + "".join(f"{p:g},{p:g},{b:g},loading\n" for p, b in zip(PRESSURE_KPA, BEND_DEG, strict=True)),
}


@pytest.mark.parametrize("text", GOOD.values(), ids=GOOD.keys())
def test_every_spelling_gives_the_same_numbers(tmp_path: Path, text: str) -> None:
    table = read_table(write(tmp_path, text))
    np.testing.assert_allclose(table.pressure_Pa[:, 0], 1e3 * np.array(PRESSURE_KPA), rtol=1e-9, atol=1e-6)
    assert np.all(table.pressure_Pa[:, 1:] == 0.0)
    np.testing.assert_allclose(np.degrees(table.bend_rad), BEND_DEG, rtol=1e-5)
    assert np.all(table.loading)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_encodings_of_spreadsheets_are_read(tmp_path: Path, encoding: str) -> None:
    table = read_table(write(tmp_path, "pressure_kPa,bend [°]\n" + rows(), encoding))
    np.testing.assert_allclose(np.degrees(table.bend_rad), BEND_DEG)


def test_columns_are_mapped_by_name_and_by_number(tmp_path: Path) -> None:
    named = write(tmp_path, "Pressure(KPa), Angular Disp.(Degrees)\n" + rows())
    by_name = read_table(named, columns="pressure=Pressure(KPa):kPa,bend=angular disp.(degrees):deg")
    bare = write(tmp_path, rows())
    by_number = read_table(bare, columns="pressure=1:kPa,bend=2:deg")
    np.testing.assert_allclose(by_name.bend_rad, by_number.bend_rad)
    np.testing.assert_allclose(np.degrees(by_name.bend_rad), BEND_DEG)


def test_mapped_columns_stand_before_found_ones(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        "bend_deg,true bend,pressure_kPa\n"
        + "".join(f"99,{b:g},{p:g}\n" for p, b in zip(PRESSURE_KPA, BEND_DEG, strict=True)),
    )
    table = read_table(path, columns="bend=true bend:deg")
    np.testing.assert_allclose(np.degrees(table.bend_rad), BEND_DEG)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("pressure", "write quantity=HEADER:UNIT"),
        ("pressure=:kPa", "write quantity=HEADER:UNIT"),
        ("voltage=U:V", "unknown quantity 'voltage'"),
        ("bend=a:deg,bend=b:deg", "mapped twice"),
    ],
)
def test_wrong_mappings_are_refused(option: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_columns(option)


def test_mapping_to_a_column_that_is_not_there_names_those_that_are(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no column 'P'; the table has 'pressure_kPa', 'bend_deg'"):
        read_table(write(tmp_path, GOOD["plain"]), columns="pressure=P:kPa")


def test_bend_follows_from_curvature_and_length(tmp_path: Path) -> None:
    with_length = write(tmp_path, "pressure_kPa,curvature_1_m,length_mm\n10,2,100\n20,4,110\n")
    np.testing.assert_allclose(read_table(with_length).bend_rad, [0.2, 0.44])
    bare = write(tmp_path, "pressure_kPa,curvature_1_m\n10,2\n20,4\n")
    np.testing.assert_allclose(read_table(bare, length_m=0.1).bend_rad, [0.2, 0.4])
    with pytest.raises(InputError, match="a curvature needs a length"):
        read_table(bare)


def test_chamber_column_puts_the_pressure_where_it_belongs(tmp_path: Path) -> None:
    table = read_table(write(tmp_path, "pressure_kPa,chamber,bend_deg\n30,0,10\n30,3,11\n"))
    np.testing.assert_allclose(table.pressure_Pa, [[30e3, 0, 0, 0], [0, 0, 0, 30e3]])


def test_optional_cells_may_be_empty(tmp_path: Path) -> None:
    text = (
        "pressure_kPa,bend_deg,length_mm,bend_direction_deg,branch\n10,5,,180,\n20,10,150,,loading\n5,4,,,unloading\n"
    )
    table = read_table(write(tmp_path, text))
    np.testing.assert_array_equal(np.isfinite(table.length_m), [False, True, False])
    np.testing.assert_array_equal(np.isfinite(table.direction_rad), [True, False, False])
    np.testing.assert_array_equal(table.loading, [True, True, False])
    assert table.has_length


def test_negative_bend_with_a_direction_is_a_bend_the_other_way(tmp_path: Path) -> None:
    text = "pressure_0_kPa,pressure_2_kPa,bend_deg,bend_direction_deg\n10,0,5,180\n0,20,-10,180\n"
    table = read_table(write(tmp_path, text))
    np.testing.assert_allclose(np.degrees(table.bend_rad), [5.0, 10.0])
    np.testing.assert_allclose(np.degrees(table.direction_rad), [180.0, 360.0])


def test_copied_rows_are_left_out_and_said(tmp_path: Path) -> None:
    table = read_table(write(tmp_path, GOOD["copied rows"]))
    assert len(table) == len(BEND_DEG)
    assert any("4 rows that repeat another" in note for note in table.notes)


def test_equal_numbers_of_two_trials_are_both_kept(tmp_path: Path) -> None:
    text = "pressure_kPa,bend_deg,trial\n20,8,a\n20,8,b\n40,16,a\n"
    assert len(read_table(write(tmp_path, text))) == 3


HEAD = "pressure_kPa,bend_deg\n"
BAD = {
    "empty file": ("", "the file has no rows"),
    "only comments": ("# nothing\n", "the file has no rows"),
    "header alone": (HEAD, "no rows; add measured rows"),
    "one row": (HEAD + "20,8\n", "one row is not enough"),
    "one row twice": (HEAD + "20,8\n20,8\n", "one row is not enough"),
    "no header": (rows(), r"line 1: no header; .*--columns pressure=1:kPa"),
    "text cell": (HEAD + "20,8\n40,about 16\n", r"line 3, column 'bend_deg': 'about 16' is no number"),
    "unit in the cell": (HEAD + "20 kPa,8\n40,16\n", r"line 2, column 'pressure_kPa': '20 kPa' is no number"),
    "NaN": (HEAD + "20,8\n40,nan\n", r"line 3, column 'bend_deg': 'nan' is no number"),
    "infinity": (HEAD + "20,8\ninf,16\n", r"'inf' is no number"),
    "too large": (HEAD + "20,8\n40,1e999\n", "too large"),
    "underscores": (HEAD + "20,8\n4_0,16\n", "'4_0' is no number"),
    "thousands separators": (HEAD.replace(",", ";") + "20;8\n1.234,5;16\n", "is no number"),
    "empty cell": (HEAD + "20,8\n,16\n", r"line 3, column 'pressure_kPa': the cell is empty"),
    "short line": (HEAD + "20,8\n40\n", r"line 3: 1 cells where the header has 2"),
    "unquoted decimal commas": (HEAD + "20,0,8,0\n40,0,16,5\n", "decimal commas need semicolons"),
    "open quotation": (HEAD + '20,"8\n40,16\n', "quoted cell runs over several lines"),
    "no pressure": ("force_N,bend_deg\n" + rows(), "no pressure column.*found: 'force_N', 'bend_deg'"),
    "no bend": ("pressure_kPa,height_mm\n" + rows(), "no bend column"),
    "bend and curvature": ("pressure_kPa,bend_deg,curvature_1_m\n20,8,1\n40,16,2\n", "both a bend and a curvature"),
    "no pressure unit": ("pressure,bend_deg\n" + rows(), "the unit is missing; name it pressure_kPa"),
    "no bend unit": ("pressure_kPa,bend\n" + rows(), "the unit is missing; name it bend_deg"),
    "unknown unit": ("pressure_torr,bend_deg\n" + rows(), "unknown unit 'torr'"),
    "unit of another quantity": ("pressure_mm,bend_deg\n" + rows(), "'mm' is no unit of pressure"),
    "pressures in two units": (
        "pressure_kPa,pressure_psi,bend_deg\n20,3,8\n40,6,16\n",
        "pressure stands in two columns",
    ),
    "one and four pressures": ("pressure_kPa,pressure_1_kPa,bend_deg\n20,3,8\n40,6,16\n", "stand side by side"),
    "gauge and absolute": (
        "pressure_0_kPa,pressure_absolute_0_kPa,bend_deg\n20,121,8\n40,141,16\n",
        "both a gauge and an absolute pressure",
    ),
    "a fifth chamber": ("pressure_0_kPa,pressure_4_kPa,bend_deg\n20,3,8\n40,6,16\n", r"pressure_0 … pressure_3"),
    "chamber column with four pressures": (
        "pressure_0_kPa,chamber,bend_deg\n20,0,8\n40,0,16\n",
        "a chamber column goes with one pressure column",
    ),
    "chamber 7": ("pressure_kPa,chamber,bend_deg\n20,0,8\n40,7,16\n", r"line 3, column 'chamber': '7' is no chamber"),
    "unknown branch": ("pressure_kPa,bend_deg,branch\n20,8,loading\n40,16,sideways\n", "'sideways' is no branch"),
    "only unloading": ("pressure_kPa,bend_deg,branch\n40,16,down\n20,8,down\n", "only unloading rows"),
    "text in the time": ("t_s,pressure_kPa,bend_deg\nnoon,20,8\n1,40,16\n", "'noon' is no number"),
    "psi called MPa": ("pressure_MPa,bend_deg\n" + rows(), "over|below 10 MPa"),
    "MPa called kPa": ("pressure_kPa,bend_deg\n" + scaled(1e-3, 1.0), "check the unit"),
    "degrees called radians": ("pressure_kPa,bend_rad\n" + rows(), "over two full turns"),
    "radians called degrees": ("pressure_kPa,bend_deg\n" + scaled(1.0, 1.0 / 57.3), "radians called degrees"),
    "constant pressure": (HEAD + "20,8\n20,9\n20,10\n", "the pressure never changes"),
    "gauge and absolute mixed": (HEAD + "20,8\n-81,16\n60,25\n", "mix of gauge and absolute"),
    "absolute called gauge": (HEAD + "101.3,0.1\n121,8\n141,16\n", "these look like absolute pressures"),
    "bends both ways without direction": (HEAD + "20,8\n40,-16\n60,25\n", "bends in two directions need"),
    "metres called millimetres": ("pressure_kPa,bend_deg,length_mm\n20,8,0.15\n40,16,0.16\n", "a length of 0.00015 m"),
    "lengths in two units": ("pressure_kPa,bend_deg,length_mm\n20,8,150\n40,16,16\n", "mixed units"),
}


@pytest.mark.parametrize(("text", "message"), BAD.values(), ids=BAD.keys())
def test_what_is_no_table_is_refused_in_one_clear_message(tmp_path: Path, text: str, message: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(InputError, match=message) as caught:
        read_table(path)
    assert "bends.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_are_no_text_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_table(tmp_path / "missing.csv")
    with pytest.raises(InputError, match="is a folder"):
        read_table(tmp_path)
    workbook = tmp_path / "book.xlsx"
    workbook.write_bytes(b"PK\x03\x04 and so on")
    with pytest.raises(InputError, match="a damaged workbook"):
        read_table(workbook)
    binary = tmp_path / "noise.csv"
    binary.write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match="not a text file"):
        read_table(binary)
    with pytest.raises(InputError, match="cannot be read"):
        read_table(tmp_path / ("x" * 400))


def test_a_cell_beyond_what_csv_holds_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not valid CSV"):
        read_table(write(tmp_path, "pressure_kPa,bend_deg\n20," + "8" * 200_000 + "\n"))
