"""Recordings fitted: exact slopes, known robots found again, shipped trials predicted from each other."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.assumptions import one_gain_assumed
from calib.model_choice import Geometry
from calib.recording import Trial, trials_of
from calib.series_calibration import (
    MATERIALS_TRIED,
    PLAIN,
    REMEDY,
    autocorrelation_time,
    calibrate_recording,
    materials_of,
    transfers,
)
from calib.series_choice import LADDER, USUAL, choose_series, scaled_error
from calib.series_fit import fit_series, relative_error, starts_of
from calib.series_model import PARTS, SeriesModel
from calib.series_prediction import SeriesPrediction
from calib.table import read_rows
from softbot.errors import InputError
from softbot.robot import robot_from

SERIES = Path(calib.__file__).parent / "data" / "asu_four_chamber_arm" / "series.csv"
ARM = Geometry(length_m=0.134, radius_m=0.029)
FULL = LADDER[-1]


@pytest.fixture(scope="module")
def trials() -> list[Trial]:
    return trials_of(read_rows(SERIES))[0]


def model(parts: tuple[str, ...] = FULL, material: str = "gent", groups=((2,),)) -> SeriesModel:
    return SeriesModel(material, parts, groups, 0.134, 0.029, 1.04e5)


def made(trial: Trial, one: SeriesModel, theta: np.ndarray, noise_deg: float = 0.0, seed: int = 0) -> Trial:
    """The trial's pressures with the bends of a known robot."""
    noise = math.radians(noise_deg) * np.random.default_rng(seed).standard_normal(len(trial.t_s))
    return replace(trial, bend_rad=SeriesPrediction(one, theta).bend_rad(trial) + noise)


@pytest.mark.parametrize("material", [*MATERIALS_TRIED, "mooney-rivlin"])
def test_every_coordinate_has_words_and_a_remedy(material: str) -> None:
    for name in model(tuple(PARTS), material, groups=((0,), (2,))).coordinates:
        assert PLAIN[name]
        assert REMEDY[name]


@pytest.mark.parametrize("material", ["gent", "yeoh", "neo-hookean"])
def test_slopes_are_those_of_differences(trials: list[Trial], material: str) -> None:
    one = model(material=material, groups=((0,), (2,)))
    theta = one.start(modulus=4e4) + 0.02 * np.arange(len(one.coordinates))
    for trial in (trials[2], trials[3]):  # one that starts bent towards its chamber, one away from it
        _, slopes = SeriesPrediction(one, theta).bend_and_slopes(trial)
        for n, name in enumerate(one.coordinates):
            step = np.zeros(len(theta))
            step[n] = 2e-4
            ahead, behind = (
                SeriesPrediction(one, theta + step).bend_rad(trial),
                SeriesPrediction(one, theta - step).bend_rad(trial),
            )
            difference = (ahead - behind) / 4e-4
            scale = max(float(np.max(np.abs(difference))), 1e-3)
            assert np.median(np.abs(slopes[:, n] - difference)) < 0.01 * scale, name
            assert np.mean(np.abs(slopes[:, n] - difference)) < 0.05 * scale, name


def test_known_robot_is_predicted_again(trials: list[Trial]) -> None:
    one = model(LADDER[USUAL])
    truth = one.start(modulus=4e4, filling_time=0.5, venting_time=1.1, hysteresis_share=0.45, creep_share=0.3)
    first, second = (made(trial, one, truth, 0.1, n) for n, trial in enumerate((trials[2], trials[1])))
    fit = fit_series(one, [first], starts_of(one, [first])[:1], most=40)
    assert fit.rms[0] < 0.006
    assert relative_error(SeriesPrediction(one, fit.theta).bend_rad(second), second) < 0.015


def test_a_robot_that_starts_bent_still_feels_its_last_load(trials: list[Trial]) -> None:
    one = model()
    theta = one.start(modulus=4e4)
    straight = replace(trials[2], start_bend_rad=np.zeros(2))
    bent = replace(straight, start_bend_rad=np.array([math.radians(5.0), 0.0]))
    away = replace(straight, start_bend_rad=np.array([-math.radians(5.0), 0.0]))
    ends = [SeriesPrediction(one, theta).bend_rad(trial)[-1] for trial in (straight, bent, away)]
    assert ends[1] < ends[0] - math.radians(1.0)  # what it had kept of the last load it does not keep again
    assert ends[2] == pytest.approx(ends[0])


def test_memory_of_one_part_at_a_time_is_off_or_on(trials: list[Trial]) -> None:
    for parts in ((), ("line",), ("creep",)):
        one = model(parts)
        theta = one.start(modulus=4e4)
        memory = one.memory_parts(theta)
        assert memory.on == bool(parts)
        assert np.all(np.isfinite(SeriesPrediction(one, theta).bend_rad(trials[2])))


def test_shipped_trial_is_predicted_from_another_of_its_chamber(trials: list[Trial]) -> None:
    by_name = {one.name: one for one in trials}
    choice = choose_series([by_name["apr4_4"]], 0.134, 0.029, ("gent",))
    error, gain = scaled_error(choice.fit.prediction.bend_rad(by_name["apr4_1"]), by_name["apr4_1"])
    assert choice.fit.rms[0] < 0.012
    assert error < 0.022
    assert 0.85 < gain < 1.2


@pytest.mark.slow
def test_every_shipped_trial_predicts_its_partner() -> None:
    found = {(one.fitted, one.judged): one for one in transfers(read_rows(SERIES), ARM)}
    assert set(found) == {
        ("apr4_1", "apr4_4"),
        ("apr4_4", "apr4_1"),
        ("apr4_2", "apr4_3"),
        ("apr4_3", "apr4_2"),
    }
    for pair, most in ((("apr4_1", "apr4_4"), 0.03), (("apr4_3", "apr4_2"), 0.05)):
        for one in (found[pair], found[pair[::-1]]):
            assert one.rms_with_gain <= most
            assert one.rms_raw <= 1.25 * max(one.steady_difference, found[pair[::-1]].steady_difference)


@pytest.mark.slow
def test_shipped_trials_together_make_a_robot_with_memory() -> None:
    calibration = calibrate_recording(read_rows(SERIES), ARM)
    report = calibration.report()
    assert report["rms_bend_percent"] < 3.5
    assert report["loo_bend_percent"] < 5.0
    assert report["band_coverage_percent"] >= 90.0
    robot = robot_from(calibration.robot_table("arm"), "arm")
    assert robot.memory is not None
    assert robot.memory.line is not None
    assert robot.actuator_memory() is not None
    fit = calibration.fit
    for trial in calibration.trials:
        felt = robot.actuator_memory().run(trial.grid_s, trial.pressure_Pa)
        strain, _ = robot.actuator_law().equilibria(felt)
        path = robot.length_m * strain[:, 1:] @ trial.direction
        again = np.interp(trial.t_s, trial.grid_s, path) - path[0]
        straight = replace(trial, start_bend_rad=np.zeros(2))
        np.testing.assert_allclose(again, fit.prediction.bend_rad(straight), atol=math.radians(0.1))


def test_chambers_that_were_always_driven_alike_are_told_to_share_a_gain() -> None:
    assert one_gain_assumed(((0, 2), (1,))) == ["one gain for chambers 0 and 2: they always had the same pressure"]
    assert one_gain_assumed(((0,), (1,))) == []


def test_what_a_recording_does_not_tell_is_listed_as_assumed(tmp_path: Path) -> None:
    lines = SERIES.read_text(encoding="utf-8").splitlines()
    others = tuple(f"{name}," for name in ("apr4_1", "apr4_3", "apr4_4"))
    alone = tmp_path / "one.csv"
    alone.write_text("\n".join(line for line in lines if not line.startswith(others)), encoding="utf-8")
    calibration = calibrate_recording(read_rows(alone), ARM, law="linear", quick=True)
    assert {trial.driven for trial in calibration.trials} == {(2,)}
    table = calibration.robot_table("arm")
    said = [text for key, text in table["provenance"].items() if key.startswith("assumption")]
    assert said == list(calibration.assumptions)
    for text in (
        "gain 1 of chambers 0, 1 and 3: never driven",
        "each chamber has 0.12 of the section's area (no drawing of the section)",
        "the chambers' centroids lie at 0.55 of the radius",
        f"largest pressure {table['actuator']['max_pressure_Pa'] / 1e3:g} kPa: assumed, 1.1 times the table's highest, "
        "rounded up",
    ):
        assert text in said
    assert "chambers 0, 1 and 3 never driven: gain 1 assumed" in calibration.warnings


def test_rows_that_follow_each_other_count_for_less() -> None:
    rng = np.random.default_rng(1)
    white = rng.standard_normal(4000)
    assert autocorrelation_time(white) == pytest.approx(1.0, abs=0.3)
    slow = np.zeros(4000)
    for n in range(1, 4000):
        slow[n] = 0.9 * slow[n - 1] + white[n]
    assert autocorrelation_time(slow) == pytest.approx(19.0, rel=0.5)  # (1 + 0.9)/(1 − 0.9)
    assert autocorrelation_time(np.zeros(10)) == 1.0


def test_laws_and_pairs_that_are_none_are_refused(trials: list[Trial], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="choose one of auto, gent"):
        materials_of("ogden")
    assert materials_of("mooney-rivlin") == ("mooney-rivlin",)
    lines = SERIES.read_text(encoding="utf-8").splitlines()
    alone = tmp_path / "one.csv"
    alone.write_text("\n".join(line for line in lines if not line.startswith(("apr4_2", "apr4_3", "apr4_4"))))
    with pytest.raises(InputError, match="no two trials drive the same chambers"):
        transfers(read_rows(alone), ARM)
