"""`softbot calibrate`: the robot file it writes, what it prints, and the shipped robot it makes again."""

import json
from importlib import resources
from pathlib import Path

import pytest

import calib
from softbot.cli.calibrate import calibrate
from softbot.errors import InputError
from softbot.robot import Robot, load_robot
from softbot.toml_file import check, read_toml

DATA = Path(calib.__file__).parent / "data"
ARM = DATA / "asu_four_chamber_arm" / "table.csv"
REQUIRED = (
    "law",
    "parameters",
    "rms_bend_deg",
    "rms_bend_percent",
    "loo_bend_percent",
    "rms_length_percent",
    "warnings",
)


def test_shipped_robot_is_what_the_command_makes_of_the_shipped_table(tmp_path: Path) -> None:
    calibrate(ARM, out=tmp_path / "robot.toml", length_mm=134.0, json=True)
    made = read_toml(tmp_path / "robot.toml")
    with resources.as_file(resources.files("softbot") / "data" / "default_robot.toml") as path:
        shipped = read_toml(path)
    assert set(made) == set(shipped)
    for key in ("length_m", "radius_m", "mass_kg", "damping_time_s"):
        assert made[key] == pytest.approx(shipped[key], rel=1e-3)
    assert made["actuator"].pop("law") == shipped["actuator"].pop("law")
    for key, value in made["actuator"].items():
        assert value == pytest.approx(shipped["actuator"][key], rel=1e-3), key
    assert set(made["provenance"]) == set(shipped["provenance"])
    for key, value in made["provenance"].items():
        if key.startswith(("source", "assumption", "law")):
            assert value == shipped["provenance"][key]


def test_shipped_robot_loads_and_bends_as_the_table_says() -> None:
    robot = load_robot("default")
    bent = robot.actuator_law().equilibrium([103e3, 7e3, 7e3, 7e3])
    assert 0.55 < robot.length_m * abs(bent.curvature_1_m[0]) < 0.78  # 33 to 43 degrees
    assert robot.max_pressure_Pa == pytest.approx(120e3)


def test_json_is_one_object_and_nothing_else(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    calibrate(
        ARM, out=tmp_path / "robot.toml", plot=tmp_path / "fit.png", length_mm=134.0, law="neo-hookean", json=True
    )
    printed = capfd.readouterr()
    assert printed.err == ""
    report = json.loads(printed.out)
    assert set(REQUIRED) <= set(report)
    for one in report["parameters"].values():
        assert {"value", "low", "high", "unit"} <= set(one)
        assert one["low"] <= one["value"] <= one["high"]
    assert (tmp_path / "fit.png").exists()
    assert report["robot"] == str(tmp_path / "robot.toml")


def test_table_for_people_shows_errors_beside_repeats(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    calibrate(ARM, out=tmp_path / "robot.toml", length_mm=134.0, law="neo-hookean")
    printed = capsys.readouterr().out
    for words in ("modulus_Pa", "between repeats", "42.8 deg", "warning: 4 unloading rows", "robot.toml"):
        assert words in printed


def test_geometry_name_and_columns_reach_the_robot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "mine.csv"
    table.write_text("P (kPa),angle disp\n10,4\n20,8.1\n30,12.2\n", encoding="utf-8")
    calibrate(
        table,
        out=tmp_path / "robot.toml",
        length_mm=150.0,
        radius_mm=10.0,
        mass_g=52.0,
        columns="bend=angle disp:deg",
        law="linear",
    )
    robot = check(Robot, read_toml(tmp_path / "robot.toml"), "robot.toml")
    assert (robot.name, robot.length_m, robot.radius_m, robot.mass_kg) == ("mine", 0.15, 0.01, 0.052)
    assert any("150" in text or "0.15" in text for text in robot.provenance.values())
    capsys.readouterr()
    calibrate(table, length_mm=150.0, columns="bend=angle disp:deg", law="linear", name="other")
    assert "robot:" not in capsys.readouterr().out  # nothing was asked to be written


def test_bad_table_writes_nothing(tmp_path: Path) -> None:
    table = tmp_path / "bad.csv"
    table.write_text("pressure_kPa,bend_deg\n10,four\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"line 2, column 'bend_deg'"):
        calibrate(table, out=tmp_path / "robot.toml")
    assert not (tmp_path / "robot.toml").exists()


def test_the_table_is_never_overwritten(tmp_path):
    from softbot.cli.calibrate import calibrate
    from softbot.errors import InputError

    table = tmp_path / "t.csv"
    text = "pressure_kPa,bend_deg\n0,0\n10,5\n20,11\n30,17\n40,24\n"
    table.write_text(text)
    for option in ({"out": table}, {"plot": table}):
        with pytest.raises(InputError, match="is the table itself"):
            calibrate(table, length_mm=150.0, **option)
    assert table.read_text() == text
    with pytest.raises(InputError, match="millimetres"):
        calibrate(table, length_mm=0.15)


def test_page_is_written_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    calibrate(ARM, length_mm=134.0, law="neo-hookean", report=tmp_path / "arm.html")
    assert "page: " in capsys.readouterr().out
    assert "What to measure next" in (tmp_path / "arm.html").read_text(encoding="utf-8")


def test_two_files_of_one_name_are_refused(tmp_path: Path) -> None:
    one = tmp_path / "one.html"
    with pytest.raises(InputError, match="two things"):
        calibrate(ARM, out=one, report=tmp_path / "." / "one.html")
    assert not one.exists()


def test_known_robots_are_counted_without_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    calibrate(self_test=2, json=True)
    report = json.loads(capsys.readouterr().out)
    assert report["tables of holds"]["robots"] == 2
    assert report["recordings"]["robots"] == 2
    assert 0.0 < report["tables of holds"]["share_percent"] <= 100.0
    inside, of = report["recordings"]["parameters"]["creep_time_s"]
    assert 0 <= inside <= of == 2


def test_a_table_is_needed_and_one_thing_at_a_time() -> None:
    with pytest.raises(InputError, match="no table"):
        calibrate()
    with pytest.raises(InputError, match="leave one of the two out"):
        calibrate(ARM, self_test=2)
