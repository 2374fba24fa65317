"""Calibration: known robots are found again, measured tables are fitted as well as they repeat, nonsense is refused."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import calib
from calib.bend_table import BendTable
from calib.calibration import Calibration
from calib.fit import calibrate_table
from calib.model_choice import Geometry, gain_groups
from calib.robust_fit import EXACT_LEAVE_ONE_OUT
from calib.table import read_table
from softbot.actuator import ActuatorLaw
from softbot.cross_section import default_cross_section
from softbot.errors import InputError

DATA = Path(calib.__file__).parent / "data"
FOUR = np.random.default_rng(5).uniform(0.0, 8e4, (40, 4)) * (np.random.default_rng(6).uniform(size=(40, 4)) < 0.6)
RAMP = np.linspace(5e3, 9e4, 12)


@pytest.fixture(scope="module")
def shipped() -> Calibration:
    return calibrate_table(read_table(DATA / "asu_four_chamber_arm" / "table.csv"), Geometry(length_m=0.134))


# --- measured tables --------------------------------------------------------------------------------------


def test_shipped_table_is_fitted_no_worse_than_it_repeats(shipped: Calibration) -> None:
    report = shipped.report()
    assert report["rows"] == 6
    assert report["unloading_rows"] == 4
    assert report["rms_bend_percent"] <= report["repeat_bend_percent"]
    assert report["rms_length_percent"] <= report["repeat_length_percent"]
    assert 5.0 < report["repeat_bend_percent"] < 10.0
    assert report["rms_bend_percent"] < report["loo_bend_percent"] < 12.0
    assert report["lack_of_fit_p"] > 0.05
    assert report["unloading_rms_bend_percent"] > 10.0


def test_shipped_arm_bends_more_by_its_stronger_chamber(shipped: Calibration) -> None:
    gains = shipped.parameters
    assert gains["gain_0"].low > gains["gain_2"].high
    assert "gain_1" not in gains  # its two feeders never part, so the table cannot tell
    assert any("chambers 1 and 3 always had the same pressure" in text for text in shipped.warnings)


def test_published_means_are_fitted_within_three_percent() -> None:
    found = calibrate_table(read_table(DATA / "published_three_chamber" / "means.csv"))
    assert found.report()["rms_bend_percent"] <= 3.0
    assert found.parameters["dead_band_Pa"].value > 5e3
    assert not any("lack of fit" in text for text in found.warnings)


def test_snap_through_is_called_a_lack_of_fit() -> None:
    found = calibrate_table(read_table(DATA / "epfl_ecoflex_bending" / "stepwise.csv"))
    assert found.report()["rms_bend_percent"] > 5.0
    assert any(
        "no fibre-reinforced law here explains this table" in text and "35 kPa" in text for text in found.warnings
    )


# --- known robots -----------------------------------------------------------------------------------------


def test_known_four_chamber_robot_is_found_again(make_table) -> None:
    gains = (1.1, 0.9, 1.05, 0.95)
    path = make_table(FOUR, gains=gains, dead_band_Pa=6e3, noise_deg=0.3, noise_mm=0.3, columns=("direction", "length"))
    found = calibrate_table(read_table(path))
    assert found.law == "neo-hookean"
    truth = {"modulus_Pa": 5e4, "radius_m": 0.02, "length_m": 0.2, "dead_band_Pa": 6e3}
    truth |= {f"gain_{i}": gain for i, gain in enumerate(gains)}
    assert set(found.parameters) == set(truth)
    for name, value in truth.items():
        one = found.parameters[name]
        assert one.value == pytest.approx(value, rel=0.05), name
        assert one.identified
        assert one.low < one.value < one.high
    robot = found.robot("known")
    assert robot.length_m == pytest.approx(0.2, rel=0.01)
    assert robot.actuator_law().gains == pytest.approx(gains, rel=0.02)


def test_intervals_hold_the_truth_as_often_as_they_say(make_table) -> None:
    """24 synthetic tables, 95 % intervals of the modulus: fewer than 19 hits have a chance of 1 in 3000."""
    hits = 0
    for seed in range(24):
        path = make_table(RAMP, material="linear", modulus_Pa=2e5, noise_deg=0.5, seed=seed)
        found = calibrate_table(read_table(path), Geometry(length_m=0.2, radius_m=0.02), law="linear")
        one = found.parameters["modulus_Pa"]
        hits += one.low <= 2e5 <= one.high
    assert hits >= 19


@pytest.mark.parametrize(("material", "modulus_Pa"), [("linear", 2e5), ("neo-hookean", 4e4)])
def test_wall_material_is_told_by_prediction(make_table, material: str, modulus_Pa: float) -> None:
    path = make_table(FOUR, material=material, modulus_Pa=modulus_Pa, noise_deg=0.2, noise_mm=0.2, columns=("length",))
    found = calibrate_table(read_table(path), Geometry(length_m=0.2))
    assert found.law == material
    assert found.parameters["radius_m"].value == pytest.approx(0.02, rel=0.05)


def test_centroid_radius_is_fitted_where_the_radius_is_given(make_table) -> None:
    path = make_table(FOUR, noise_deg=0.2, noise_mm=0.2, columns=("length",))
    found = calibrate_table(read_table(path), Geometry(radius_m=0.02), law="neo-hookean")
    assert found.parameters["chamber_centroid_radius_m"].value == pytest.approx(0.011, rel=0.03)
    assert "radius_m" not in found.parameters
    # a radius twice too large makes the arm that bends like this an absurd share of it
    wide = calibrate_table(read_table(path), Geometry(radius_m=0.045), law="neo-hookean")
    assert any("effective arm" in text for text in wide.warnings)


def test_one_wild_row_moves_the_fit_little(make_table) -> None:
    path = make_table(RAMP, noise_deg=0.3, columns=("length",))
    clean = read_table(path)
    wild = replace(clean, bend_rad=np.where(np.arange(len(clean)) == 6, 3.0 * clean.bend_rad, clean.bend_rad))
    geometry = Geometry(length_m=0.2, radius_m=0.02)
    straight, robust = (calibrate_table(t, geometry, law="neo-hookean") for t in (clean, wild))
    middle = {name: one.value for name, one in straight.parameters.items()}
    assert robust.parameters["modulus_Pa"].value == pytest.approx(middle["modulus_Pa"], rel=0.01)


@given(order=st.permutations(range(10)))
@settings(deadline=None, max_examples=4)
def test_order_of_rows_does_not_matter(order: list[int]) -> None:
    table = read_table(DATA / "asu_four_chamber_arm" / "table.csv")
    straight, shuffled = (
        calibrate_table(t, Geometry(length_m=0.134), law="neo-hookean").report()
        for t in (table, table.rows(np.array(order)))
    )
    for name, one in straight["parameters"].items():
        assert shuffled["parameters"][name]["value"] == pytest.approx(one["value"], rel=1e-6)
    assert shuffled["loo_bend_percent"] == pytest.approx(straight["loo_bend_percent"], rel=1e-5)


def test_leave_one_out_by_leverage_agrees_with_fitting_again(make_table, monkeypatch: pytest.MonkeyPatch) -> None:
    pressure = np.linspace(5e3, 9e4, EXACT_LEAVE_ONE_OUT - 2)
    path = make_table(pressure, noise_deg=0.5, noise_mm=0.5, columns=("direction", "length"))
    table = read_table(path)
    exact = calibrate_table(table, Geometry(length_m=0.2), law="neo-hookean").report()
    monkeypatch.setattr("calib.robust_fit.EXACT_LEAVE_ONE_OUT", 5)
    linear = calibrate_table(table, Geometry(length_m=0.2), law="neo-hookean").report()
    for key in ("loo_bend_percent", "loo_length_percent"):
        assert linear[key] == pytest.approx(exact[key], rel=0.05)
        assert linear[key] > exact[key.replace("loo", "rms")]


@pytest.mark.parametrize("refitted", [True, False])
def test_trials_are_left_out_whole_where_another_drives_the_same_chamber(
    make_table, monkeypatch: pytest.MonkeyPatch, refitted: bool
) -> None:
    if not refitted:
        monkeypatch.setattr("calib.robust_fit.EXACT_LEAVE_ONE_OUT", 1)
    table = read_table(make_table(np.linspace(1e4, 9e4, 10), columns=("direction",)))
    second = np.arange(10) % 2 == 1
    table = replace(table, bend_rad=np.where(second, 1.2, 1.0) * table.bend_rad)  # a trial that bends further
    geometry = Geometry(length_m=0.2, radius_m=0.02)

    def left_out_percent(trial: np.ndarray) -> float:
        return calibrate_table(replace(table, trial=trial), geometry, law="neo-hookean").report()["loo_bend_percent"]

    by_row = left_out_percent(np.full(10, ""))
    assert left_out_percent(np.where(second, "second", "first")) > 1.5 * by_row
    # The only trial of a chamber cannot be left out: nothing would be known of it.
    assert left_out_percent(np.full(10, "only")) == pytest.approx(by_row)


def test_long_tables_are_averaged_and_said(make_table) -> None:
    pressure = np.random.default_rng(2).uniform(1e3, 9e4, 7000)
    path = make_table(pressure, noise_deg=1.0, columns=("direction",))
    found = calibrate_table(read_table(path), Geometry(length_m=0.2, radius_m=0.02), law="neo-hookean")
    assert found.parameters["modulus_Pa"].value == pytest.approx(5e4, rel=0.02)
    assert any("7000 loading rows averaged to" in text for text in found.warnings)
    assert found.report()["rms_bend_deg"] == pytest.approx(math.sqrt(2.0), rel=0.05)


def test_long_tables_of_four_chambers_are_thinned(make_table) -> None:
    pressure = np.random.default_rng(3).uniform(0.0, 8e4, (600, 4))
    path = make_table(pressure, noise_deg=0.5, columns=("direction",))
    found = calibrate_table(read_table(path), Geometry(length_m=0.2, radius_m=0.02), law="neo-hookean")
    assert found.parameters["modulus_Pa"].value == pytest.approx(5e4, rel=0.02)
    assert any("600 loading rows averaged to 150" in text for text in found.warnings)


# --- what a table cannot tell -----------------------------------------------------------------------------


def rows_of(pressure_kPa: list[float], bend_deg: list[float]) -> BendTable:
    n = len(bend_deg)
    pressure = np.zeros((n, 4))
    pressure[:, 0] = 1e3 * np.array(pressure_kPa)
    nothing = np.full(n, np.nan)
    empty = np.full(n, "")
    return BendTable(
        "made.csv",
        (),
        (),
        pressure,
        np.radians(bend_deg),
        nothing,
        nothing,
        np.ones(n, dtype=bool),
        empty,
        empty,
        np.arange(n),
        nothing,
        np.ones(n, dtype=bool),
    )


def test_two_rows_give_a_modulus_and_a_word_of_caution() -> None:
    found = calibrate_table(rows_of([30.0, 60.0], [10.0, 20.0]))
    assert set(found.parameters) == {"modulus_Pa"}
    assert any("only 2 measured numbers" in text for text in found.warnings)
    assert any("never driven" in text for text in found.warnings)
    assert any("assumed: the table has no lengths" in text for text in found.assumptions)
    assert "gain 1 of chambers 1, 2 and 3: never driven" in found.assumptions
    assert "largest pressure 66 kPa: assumed, 1.1 times the table's highest, rounded up" in found.assumptions


def test_more_parameters_than_numbers_are_called_undetermined() -> None:
    table = rows_of([50.0, 50.0], [20.0, 21.0])
    alone = replace(table, pressure_Pa=np.array([[5e4, 0, 0, 0], [0, 5e4, 0, 0]]))
    found = calibrate_table(alone, law="linear")
    assert not found.parameters["modulus_Pa"].identified
    assert found.parameters["gain_0"].low == 0.0
    assert any("cannot tell modulus_Pa from gain_0" in text for text in found.warnings)
    json.dumps(found.report(), allow_nan=False)


def test_lengths_that_are_too_few_leave_the_rest_length_assumed() -> None:
    table = rows_of([30.0, 60.0], [10.0, 20.0])
    short = replace(table, length_m=np.array([0.15, np.nan]))
    found = calibrate_table(short, law="linear")
    assert "length_m" not in found.parameters
    assert any("the length at the lowest pressures" in text for text in found.assumptions)


def test_gains_follow_what_was_driven_apart(make_table) -> None:
    def groups(*rows: tuple[float, float, float, float]) -> tuple[tuple[int, ...], ...]:
        table = rows_of([1.0] * len(rows), [10.0] * len(rows))
        return gain_groups(replace(table, pressure_Pa=1e3 * np.array(rows)))

    assert groups((50, 0, 0, 0), (90, 0, 0, 0)) == ((0,),)
    assert groups((90, 7, 7, 7), (7, 7, 90, 7), (90, 90, 90, 90)) == ((0,), (2,))
    assert groups((90, 90, 0, 0), (0, 0, 90, 90)) == ((0, 1), (2, 3))
    assert groups((90, 0, 90, 0), (50, 0, 50, 0)) == ((0, 2),)
    assert groups((90, 90, 1, 2), (90, 80, 2, 1)) == ((1,),)


def test_zero_residuals_do_not_break_the_intervals(make_table) -> None:
    found = calibrate_table(read_table(make_table(RAMP)), Geometry(length_m=0.2, radius_m=0.02), law="neo-hookean")
    one = found.parameters["modulus_Pa"]
    assert one.value == pytest.approx(5e4, rel=1e-4)
    assert one.low <= one.value <= one.high


# --- nonsense ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pressure_kPa", "bend_deg"),
    [([20, 40, 60, 80], [40, 30, 20, 10]), ([20, 40, 60, 80], [30, 30, 30, 30]), ([80, 20], [5, 9])],
    ids=["falling", "constant", "two rows falling"],
)
def test_bends_that_do_not_rise_with_pressure_are_refused(pressure_kPa: list[float], bend_deg: list[float]) -> None:
    with pytest.raises(InputError, match="does not rise with the pressure"):
        calibrate_table(rows_of(pressure_kPa, bend_deg))


@pytest.mark.parametrize(
    ("turn", "message"),
    [
        (lambda d: d + math.pi, "turned by -?180° against the chambers"),
        (lambda d: d + math.pi / 2, "turned by 90° against the chambers"),
        (lambda d: -d, "are mirrored against the chambers"),
        (lambda d: 7.0 * d + np.arange(len(d)), "do not follow the chambers"),
    ],
)
def test_directions_of_another_convention_are_refused(make_table, turn, message: str) -> None:
    table = read_table(make_table(FOUR, columns=("direction",)))
    with pytest.raises(InputError, match=message):
        calibrate_table(replace(table, direction_rad=turn(table.direction_rad)))


def test_a_small_turn_of_the_directions_is_said(make_table) -> None:
    table = read_table(make_table(FOUR, columns=("direction",)))
    found = calibrate_table(replace(table, direction_rad=table.direction_rad + 0.15), Geometry(length_m=0.2), "linear")
    assert any("turned by 8.6° against the chambers" in text for text in found.warnings)


@pytest.mark.parametrize(
    ("geometry", "message"),
    [
        ({"length_m": -0.1}, "length_m"),
        ({"radius_m": math.nan}, "radius_m"),
        ({"mass_kg": math.inf}, "mass_kg"),
        ({"length_m": 0.1, "radius_m": 0.06}, "no slender tube"),
    ],
)
def test_impossible_geometry_is_refused(geometry: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Geometry(**geometry)


def test_unknown_law_is_refused() -> None:
    with pytest.raises(InputError, match="choose one of auto, linear, neo-hookean, yeoh, gent, mooney-rivlin"):
        calibrate_table(rows_of([30.0, 60.0], [10.0, 20.0]), law="ogden")


def test_mooney_rivlin_bends_as_neo_hookean_and_says_so() -> None:
    table = read_table(DATA / "asu_four_chamber_arm" / "table.csv")
    one, other = (calibrate_table(table, Geometry(length_m=0.134), law) for law in ("mooney-rivlin", "neo-hookean"))
    assert one.parameters["modulus_Pa"].value == pytest.approx(other.parameters["modulus_Pa"].value, rel=1e-6)
    assert any("second invariant" in text for text in one.assumptions)
    assert one.robot("arm").actuator_law().material == "mooney-rivlin"


def test_a_wall_that_stiffens_is_found_with_its_limit(make_table) -> None:
    pressure_Pa = np.linspace(1e4, 12e4, 14)
    table = read_table(make_table(pressure_Pa, noise_deg=0.0, noise_mm=0.0, columns=("length",)))
    law = ActuatorLaw(default_cross_section(0.015), "gent", 6e4, limit_invariant=0.4)
    strain, _ = law.equilibria(table.pressure_Pa)
    stiff = replace(table, bend_rad=0.2 * np.hypot(*strain[:, 1:].T), length_m=0.2 * strain[:, 0])
    found = calibrate_table(stiff, Geometry(length_m=0.2))
    assert found.law == "gent"
    assert found.parameters["limit_invariant"].value == pytest.approx(0.4, rel=0.02)
    assert found.robot("stiff").actuator_law().limit_invariant == pytest.approx(0.4, rel=0.02)


def test_bands_hold_the_curve_and_widen_with_noise(make_table) -> None:
    path_Pa = np.zeros((5, 4))
    path_Pa[:, 0] = np.linspace(2e4, 9e4, 5)
    halves = []
    for seed, noise in enumerate((0.2, 2.0)):
        table = read_table(make_table(RAMP, noise_deg=noise, noise_mm=noise, columns=("length",), seed=seed))
        found = calibrate_table(table, Geometry(length_m=0.2), law="neo-hookean")
        bend, length = found.half_bands(path_Pa)
        assert np.all(bend > 0.0)
        assert np.all(length > 0.0)
        halves.append(bend)
    assert np.all(halves[1] > 3.0 * halves[0])


def test_a_law_that_residuals_contradict_is_said_to_lack_fit(make_table) -> None:
    """Three repeats at each pressure with little noise, and a linear law forced on a softening wall with dead band."""
    pressure = np.repeat(np.linspace(1e4, 9e4, 9), 3)
    path = make_table(pressure, modulus_Pa=2.5e4, dead_band_Pa=8e3, noise_deg=0.3)
    geometry = Geometry(length_m=0.2, radius_m=0.02)
    found = calibrate_table(read_table(path), geometry, law="linear")
    assert found.errors.lack_of_fit_p is not None
    assert found.errors.lack_of_fit_p < 1e-6
    assert any("the residuals exceed the repeats" in text for text in found.warnings)
    right = calibrate_table(read_table(path), geometry, law="neo-hookean")
    assert right.errors.lack_of_fit_p is not None
    assert right.errors.lack_of_fit_p > 0.01
    assert right.parameters["dead_band_Pa"].value == pytest.approx(8e3, rel=0.1)


def test_chambers_that_sit_askew_are_found(make_table) -> None:
    pressure_Pa = np.kron(np.eye(4), np.array([30e3, 60e3, 90e3, 30e3, 60e3, 90e3])[:, None])
    table = read_table(make_table(pressure_Pa, columns=("direction",)))
    askew_rad = (0.2, 0.0, 0.0, -0.1)
    law = ActuatorLaw(replace(default_cross_section(0.02), misalignment_rad=askew_rad), "neo-hookean", 5e4)
    noise_rad = math.radians(0.3) * np.random.default_rng(4).standard_normal((len(table), 2))
    bend = 0.2 * law.equilibria(table.pressure_Pa)[0][:, 1:] + noise_rad
    askew = replace(table, bend_rad=np.hypot(*bend.T), direction_rad=np.arctan2(bend[:, 1], bend[:, 0]))
    found = calibrate_table(askew, Geometry(0.2, 0.02), "neo-hookean")
    assert "misalignment" in found.candidates[0].name
    for i, angle in enumerate(askew_rad):
        one = found.parameters[f"misalignment_{i}_rad"]
        assert one.value == pytest.approx(angle, abs=0.02)
        assert one.low - 0.005 < angle < one.high + 0.005
    section = found.robot("askew").actuator_law().section
    assert section.misalignment_rad == pytest.approx(askew_rad, abs=0.03)


@pytest.mark.parametrize(("lowest_Pa", "said"), [(60e3, True), (10e3, False)])
def test_a_dead_band_that_a_table_cannot_tell_is_said_with_its_mend(make_table, lowest_Pa: float, said: bool) -> None:
    for seed in range(3):
        pressure_Pa = np.linspace(lowest_Pa, 8e4, 5)
        path = make_table(pressure_Pa, dead_band_Pa=8e3, noise_deg=3.0, columns=("direction",), seed=seed)
        found = calibrate_table(read_table(path), Geometry(0.2, 0.02), "neo-hookean")
        words = [text for text in found.warnings if "cannot tell" in text and "dead band" in text]
        assert bool(words) == said
        assert all("add points under 60 kPa" in text for text in words)
