"""Reduction of the four-chamber arm: a made-up arm whose bend, direction and length are known comes out as it is."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.reduce_asu import arc_length, main
from calib.table import read_table

CHANNELS = ("r", "l", "m")
COLUMNS = [f"{kind}_{segment}_{c}" for segment in "ab" for kind in ("pd", "pm") for c in CHANNELS]


def quaternion(vector_deg: tuple[float, float, float]) -> np.ndarray:
    """(x, y, z, w) of a rotation vector."""
    vector = np.radians(vector_deg)
    angle = float(np.linalg.norm(vector))
    return np.array([*(math.sin(angle / 2) * vector / max(angle, 1e-12)), math.cos(angle / 2)])


def write_rows(path: Path, rows: list[dict[str, object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """Three trials: chamber 0 alone and its release, chamber 2 with an invalid angle, the other segment."""
    holds: list[dict[str, object]] = []

    def hold(trial: str, start_s: float, r: float, left: float, angle_deg: float, chord_mm: float) -> None:
        values = dict.fromkeys(COLUMNS, 1.0) | {"pd_b_r": r, "pm_b_r": r, "pd_b_l": left, "pm_b_l": left}
        holds.append(
            {"file": trial, "t_start_s": start_s, "hold_s": 20.0, **values}
            | {"angle_rb1_rb2_deg": angle_deg, "dist_rb1_rb2_mm": chord_mm}
        )

    hold("one.csv", 0.0, 15.0, 1.0, 40.0, 140.0)
    hold("one.csv", 20.0, 1.0, 1.0, 6.0, 134.0)
    hold("two.csv", 0.0, 1.0, 15.0, math.nan, 140.0)
    hold("three.csv", 0.0, 1.0, 1.0, 4.0, 134.0)
    write_rows(tmp_path / "steady_holds.csv", holds)
    base = quaternion((0.0, 0.0, 180.0))
    for trial in ("one", "two", "three"):
        samples = []
        for t in np.linspace(0.0, 40.0, 400):
            y_deg = 0.0 if t < 2.5 else -40.0 if t < 20.0 else -6.0
            flipped = -1.0 if int(10 * t) % 3 == 0 else 1.0  # a quaternion and its negative are the same turn
            second = multiply(base, quaternion((0.0, y_deg, 0.0))) * flipped
            samples.append(
                {"t_s": t, "flag_rb1_rb2_ok": 0 if 13.0 < t < 13.5 else 1}
                | {f"rb1_q{axis}": value for axis, value in zip("xyzw", base, strict=True)}
                | {f"rb2_q{axis}": value for axis, value in zip("xyzw", second, strict=True)}
            )
        write_rows(tmp_path / f"{trial}.csv", samples)
    return tmp_path


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.array([*(a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])), a[3] * b[3] - a[:3] @ b[:3]])


def test_known_arm_is_reduced_to_what_it_is(arm: Path) -> None:
    out = arm / "table.csv"
    assert main([str(arm), str(out)]) == 0
    table = read_table(out)
    assert list(table.trial) == ["one", "one"]
    assert list(table.loading) == [True, False]
    np.testing.assert_allclose(table.pressure_Pa[0], np.array([15.0, 1.0, 1.0, 1.0]) * 6894.757, rtol=1e-3)
    np.testing.assert_allclose(np.degrees(table.bend_rad), [40.0, 6.0])
    # chamber 0 lies at -x and bends the link away from itself, to +x: direction 180 degrees in the section's axes
    np.testing.assert_allclose(np.degrees(table.direction_rad), [180.0, 180.0], atol=0.2)
    assert table.length_m[0] == pytest.approx(0.140 * math.radians(20.0) / math.sin(math.radians(20.0)), rel=1e-4)


def test_arc_of_a_half_circle_and_of_nothing() -> None:
    assert arc_length(2.0, math.pi) == pytest.approx(math.pi)
    assert arc_length(2.0, 0.0) == 2.0


def test_wrong_use_ends_with_a_message(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["only one"]) == 2
    assert "usage" in capsys.readouterr().err
    assert main([str(tmp_path), str(tmp_path / "out.csv")]) == 2
    assert "steady_holds.csv" in capsys.readouterr().err


def test_shipped_table_is_consistent_with_its_sources_figures() -> None:
    """33-43 degrees at 103 kPa by chamber, and 134 mm to 193 mm with all channels (the data's own summary)."""
    table = read_table(Path(calib.__file__).parent / "data" / "asu_four_chamber_arm" / "table.csv")
    alone = table.loading & (np.sum(table.pressure_Pa > 5e4, axis=1) == 1)
    together = table.loading & np.all(table.pressure_Pa > 5e4, axis=1)
    assert np.degrees(np.min(table.bend_rad[alone])) == pytest.approx(33.0, abs=0.1)
    assert np.degrees(np.max(table.bend_rad[alone])) == pytest.approx(42.8, abs=0.1)
    assert np.mean(table.length_m[together]) == pytest.approx(0.193, abs=5e-4)
    assert np.sum(alone) == 4
    assert np.sum(together) == 2
