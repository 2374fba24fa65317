"""The benchmark measures what it says: cases, rulers, errors, rows, a table, a picture, a stamp."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

from sim.benchmark import Result, cases, engines, measure, simulate_summary
from sim.benchmark.case import (
    BENDING_STIFFNESS_N_M2,
    DENSITY_KG_M3,
    FAULT_SCENE,
    LENGTH_M,
    RADIUS_M,
    Ruler,
    cantilever,
    fault_and_recovery,
    floating,
    rolling,
    rolling_limit,
    vibration,
)
from sim.benchmark.converged import COARSER_ROLL, FINE_ROLL, converged_advance
from sim.benchmark.figure import draw
from sim.benchmark.links import motion_of_links
from sim.benchmark.measurement import REPEAT_FOR_S
from sim.benchmark.natural_frequency import natural_frequency_rad_s
from sim.benchmark.play import Measured, Unable, play
from sim.benchmark.result import Growth
from sim.benchmark.rod_engine import RodEngine, RodSetting
from sim.benchmark.scaling import growth
from sim.benchmark.stamp import in_words, source_digest, stamp
from sim.benchmark.summary_value import quantity_of
from sim.benchmark.table import fastest, fastest_markdown, growth_markdown, markdown
from sim.body import Motion
from sim.scene import load_scene
from softbot.errors import InputError, SimulationError
from softbot.rolling import coulomb_advance_ratio, floating_ratio


def no_run(scene):
    raise AssertionError(f"{scene.name} needs no run")


# --- cases and rulers ---------------------------------------------------


def test_the_rod_is_the_same_in_every_case_of_it():
    for case in (floating(), rolling(), cantilever(), vibration()):
        assert (case.body.length_m, case.body.radius_m) == (LENGTH_M, RADIUS_M)
        assert case.body.bending_stiffness_N_m2 == pytest.approx(BENDING_STIFFNESS_N_M2)
        assert case.body.mass_kg == pytest.approx(DENSITY_KG_M3 * math.pi * RADIUS_M**2 * LENGTH_M)


def test_rulers_are_those_of_the_theory():
    assert floating().ruler(no_run).value == (floating_ratio(0.15, 0.01, 12.0),)
    assert rolling_limit().ruler(no_run).value == pytest.approx((coulomb_advance_ratio(0.9),), rel=1e-12)
    drop, reach = cantilever().ruler(no_run).value
    assert (drop, reach) == pytest.approx((0.33131, 0.93496), abs=1e-5)
    assert vibration().ruler(no_run).value == pytest.approx((16.431,), abs=1e-3)


def test_the_converged_ruler_states_its_own_distance():
    asked = []

    def run(scene):
        asked.append(scene.solver)
        radius = scene.robot.radius_m
        ratio = 0.93 if scene.solver.step_s == FINE_ROLL["step_s"] else 0.9393
        return {"advance_per_revolution_m": ratio * 2.0 * math.pi * radius}

    ruler = converged_advance(rolling(), run)
    assert ruler.value[0] == pytest.approx(0.93)
    assert "differs by 1 %" in ruler.source
    assert [(s.modes, s.contact_points, s.step_s) for s in asked] == [
        (solver["modes"], solver["contact_points"], solver["step_s"]) for solver in (FINE_ROLL, COARSER_ROLL)
    ]


def test_the_fault_case_is_the_shipped_scene():
    shipped = load_scene(Path(__file__).parents[2] / "scenes" / "damaged.toml")
    case = fault_and_recovery()
    made = case.scene({"twin": "rod"})
    assert made.model_copy(update={"name": shipped.name, "metrics": shipped.metrics}) == shipped
    assert FAULT_SCENE["fault"][0]["t_s"] == 6.0


def test_a_case_that_no_scene_file_can_say_is_no_scene():
    with pytest.raises(ValueError, match="no scene"):
        cantilever().scene({"twin": "rod"})


def test_errors_are_relative_and_those_of_a_point_are_distances():
    assert floating().error_percent([1.01], [1.0]) == pytest.approx(1.0)
    assert cantilever().error_percent([0.33, 0.94], [0.36, 0.90]) == pytest.approx(5.0)


# --- reading a motion ---------------------------------------------------


def test_a_row_of_links_on_an_arc_is_seen_as_that_arc():
    count, curvature, length = 40, 8.0, 0.15
    s = (np.arange(count) + 0.5) / count * length - 0.5 * length
    angle = curvature * s
    # in the plane of e1 and t: the centre of curvature towards +e1
    tangent = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    first = np.stack([-np.sin(angle), np.cos(angle), np.zeros(count)], axis=1)
    rotation = np.stack([first, np.cross(tangent, first), tangent], axis=2)
    centre = np.stack([np.sin(angle), 1.0 - np.cos(angle), np.zeros(count)], axis=1) / curvature
    motion = motion_of_links(rotation, centre, length)
    assert motion.curvature_1_m == pytest.approx([curvature, 0.0], abs=1e-9)
    assert motion.rotation[:, 2] == pytest.approx([1.0, 0.0, 0.0], abs=1e-12)
    assert motion.chord == pytest.approx([1.0, 0.0, 0.0], abs=1e-12)
    odd = motion_of_links(rotation[:39], centre[:39], length * 39 / 40)
    assert odd.rotation[:, 2] == pytest.approx(tangent[19])


@pytest.mark.parametrize("sample_s", [0.001, 0.005])
@pytest.mark.parametrize("ratio", [0.0, 0.03, 0.1])
def test_frequency_of_a_damped_ring_is_that_without_damping(sample_s, ratio):
    time = np.arange(0.0, 0.6, sample_s)
    ring = np.exp(-ratio * 103.0 * time) * np.cos(103.0 * math.sqrt(1.0 - ratio**2) * time + 0.7)
    faint = 0.05 * np.exp(-30.0 * time) * np.cos(270.0 * time)
    found = natural_frequency_rad_s(0.3 + ring + faint, sample_s)
    assert found == pytest.approx(103.0, rel=2e-3 if ratio == 0.1 else 2e-4)


@pytest.mark.parametrize("signal", [np.ones(100), np.linspace(0.0, 1.0, 100), np.full(100, np.nan)])
def test_a_signal_that_does_not_ring_has_no_frequency(signal):
    with pytest.raises(ArithmeticError, match="does not ring"):
        natural_frequency_rad_s(signal, 0.01)


class Perfect:
    """A player whose robot moves exactly as theory says: rolls at `ratio`, or turns about its chord."""

    def __init__(self, case, ratio):
        self.case, self.ratio, self.t_s, self.closed = case, ratio, 0.0, False

    def run(self, until_s):
        self.t_s = until_s
        return 0.25 * self.case.sample_s

    def motion(self):
        k1, k2 = self.case.rest(self.t_s)
        spun = math.atan2(k2, k1)
        turned = self.ratio * spun if self.case.quantity == "turning" else 0.0
        # the side towards the centre of curvature turns about the chord x by `turned`
        roll = turned - spun
        first = np.array([0.0, math.cos(roll), math.sin(roll)])
        tangent = np.array([1.0, 0.0, 0.0])
        unwrapped = math.pi * max(self.t_s - 1.0, 0.0)  # 2 s a cycle, the rolling case's drive
        y = self.ratio * self.case.body.radius_m * unwrapped
        return Motion(
            rotation=np.column_stack([first, np.cross(tangent, first), tangent]),
            angular_velocity_rad_s=np.zeros(3),
            mid_velocity_m_s=np.zeros(3),
            centre_of_mass_m=np.array([0.0, y, 0.0]),
            stretch=1.0,
            curvature_1_m=np.array([k1, k2]),
            chord=tangent,
            angular_momentum_kg_m2_s=np.zeros(3),
        )

    def tip_m(self):
        return 0.3 * self.case.body.length_m, 0.9 * self.case.body.length_m

    def close(self):
        self.closed = True


@pytest.mark.parametrize(("make", "ratio"), [(floating, 0.324), (rolling, 0.934)])
def test_a_perfect_motion_is_read_without_error(make, ratio):
    player = Perfect(make(), ratio)
    measured = play(player.case, player)
    assert measured.value == pytest.approx((ratio,), rel=1e-9)
    assert measured.sim_s / measured.wall_s == pytest.approx(4.0)
    assert player.closed


def test_a_tip_is_read_over_the_length():
    assert play(cantilever(), Perfect(cantilever(), 0.0)).value == pytest.approx((0.3, 0.9))


def test_a_warm_up_reads_nothing():
    measured = play(rolling(), Perfect(rolling(), 0.9), duration_s=0.02)
    assert measured.sim_s == pytest.approx(0.02)
    assert math.isnan(measured.value[0])


def test_a_motion_that_is_not_finite_or_does_not_roll_is_a_failure():
    broken = Perfect(rolling(), 0.9)
    broken.motion = lambda: dataclasses.replace(Perfect.motion(broken), rotation=np.full((3, 3), np.nan))
    with pytest.raises(ArithmeticError, match=r"no longer finite at 0\.01 s"):
        play(rolling(), broken)
    still = Perfect(rolling(), 0.9)
    still.case = dataclasses.replace(rolling(), rest=lambda _t: np.array([12.0, 0.0]))
    with pytest.raises(ArithmeticError, match="did not roll"):
        play(still.case, still)


def test_a_summary_is_read_as_the_case_asks():
    turning = {"plane_rotation_rad": 0.5, "steady_span_s": 5.0}
    assert quantity_of(floating(), turning) == pytest.approx(0.5 / (2.0 * math.pi / 4.0))
    assert quantity_of(fault_and_recovery(), {"revolutions": -3.5}) == -3.5
    with pytest.raises(ArithmeticError, match="did not roll"):
        quantity_of(rolling(), {"advance_per_revolution_m": None})


# --- the rod itself -----------------------------------------------------


@pytest.mark.parametrize(
    ("make", "setting", "within_percent"),
    [
        (floating, RodSetting(modes=1, points=10, step_s=0.01), 0.05),
        (rolling_limit, RodSetting(modes=3, points=16, step_s=0.01), 0.3),
        (cantilever, RodSetting(modes=4, points=12, step_s=0.02), 0.01),
        (vibration, RodSetting(modes=4, points=12, step_s=0.0025), 1.0),
    ],
)
def test_the_rod_meets_its_rulers(make, setting, within_percent):
    case = make()
    measured = RodEngine().measure(case, setting, simulate_summary)
    assert abs(case.error_percent(measured.value, case.ruler(no_run).value)) < within_percent
    assert measured.sim_s == pytest.approx(case.duration_s)
    assert measured.wall_s > 0.0


def test_a_setting_by_name_and_one_by_hand_become_a_scene():
    assert RodSetting("fast").solver() == {"twin": "rod", "accuracy": "fast"}
    assert RodSetting("fast").label == '"fast"'
    scene = rolling().scene(RodSetting(modes=5, points=12, step_s=0.005).solver())
    assert (scene.solver.modes, scene.solver.contact_points, scene.solver.step_s) == (5, 12, 0.005)


# --- measuring ----------------------------------------------------------


class Invented:
    """An engine whose answers are known."""

    name = "invented"

    def __init__(self, answers, settings=("a", "b")):
        self.answers, self.warmed = list(answers), 0
        self._settings = [type("Setting", (), {"label": label})() for label in settings]

    def version(self):
        return "invented 1"

    def settings(self, case):
        return self._settings

    def warm_up(self, case, setting, run):
        self.warmed += 1

    def measure(self, case, setting, run):
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


def a_case():
    return dataclasses.replace(floating(), ruler=lambda run: Ruler((2.0,), "somebody"))


def test_the_median_of_the_repeats_counts_and_the_warm_up_does_not():
    engine = Invented([Measured((2.02,), 4.0, wall_s) for wall_s in (1.0, 8.0, 2.0)], settings=("a",))
    (row,) = measure([a_case()], [engine], repeats=3)
    assert engine.warmed == 1
    assert row.wall_s_per_sim_s == pytest.approx(0.5)
    assert row.real_time_factor == pytest.approx(2.0)
    assert row.error_percent == pytest.approx(1.0)
    assert (row.case, row.engine, row.setting, row.expected_from, row.repeats) == (
        "floating", "invented", "a", "somebody", 3,
    )  # fmt: skip


def test_slow_settings_are_repeated_less(monkeypatch):
    clock = iter([0.0, REPEAT_FOR_S + 1.0])
    monkeypatch.setattr("sim.benchmark.measurement.time.perf_counter", lambda: next(clock))
    (row,) = measure([a_case()], [Invented([Measured((2.0,), 1.0, 1.0)], settings=("a",))], repeats=5)
    assert row.repeats == 1


def test_few_settings_are_measured_when_asked():
    rows = list(measure([a_case()], [Invented([Measured((2.0,), 1.0, 1.0)])], repeats=1, settings_each=1))
    assert [row.setting for row in rows] == ["a"]


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (SimulationError("it blew up"), "failed: it blew up"),
        (ArithmeticError("unstable"), "failed: unstable"),
        (Unable("no hands"), "no hands"),
        (Measured((math.nan,), 1.0, 1.0), "failed: the result is not finite"),
    ],
)
def test_what_fails_is_a_row_with_the_reason_and_the_rest_goes_on(answer, reason):
    failed, done = measure([a_case()], [Invented([answer, Measured((2.0,), 1.0, 1.0)])], repeats=1)
    assert failed.reason == reason
    assert failed.value is failed.error_percent is failed.real_time_factor is None
    assert done.value == 2.0


def test_an_engine_that_cannot_do_a_case_is_one_row():
    engine = Invented([])
    engine.settings = lambda case: (_ for _ in ()).throw(Unable("no clamp"))
    (row,) = measure([a_case()], [engine])
    assert (row.engine, row.setting, row.reason) == ("invented", "", "no clamp")


def test_a_ruler_that_cannot_be_had_is_said():
    """The sequencer's scene without softbot.nodes."""
    rows = list(measure([fault_and_recovery()], [RodEngine()]))
    assert len(rows) == 1
    assert "softbot.nodes" in rows[0].reason


def test_every_case_and_engine_has_a_name_of_its_own():
    assert [case.name for case in cases()] == [
        "floating", "rolling", "rolling-limit", "cantilever", "vibration", "fault",
    ]  # fmt: skip
    assert [engine.name for engine in engines()] == ["rod", "bullet", "mujoco", "pyelastica"]


# --- growth -------------------------------------------------------------


def test_cost_grows_along_each_axis():
    asked, companies = [], []

    def run(scene):
        asked.append((scene.solver.modes, scene.solver.contact_points, scene.solver.duration_s))
        return {"real_time_factor": 50.0}

    rows = list(growth(repeats=1, run=run, run_many=lambda scenes: companies.append(len(scenes)), quick=True))
    assert {row.of for row in rows} == {"modes", "contact points", "simulated seconds", "robots"}
    assert len({solver[0] for solver in asked}) > 1
    assert len({solver[1] for solver in asked}) > 1
    assert len({solver[2] for solver in asked}) > 1
    assert companies == [1, 1, 4]  # the first warms up
    assert all(row.wall_s_per_sim_s == pytest.approx(0.02) for row in rows if row.of != "robots")


# --- answers ------------------------------------------------------------

DONE = Result("rolling", "rod", "3 modes", 0.94, 0.93, "somebody", 1.075, 0.002, 500.0, 3)
CANNOT = Result("rolling", "mujoco", "", reason="not installed")


def test_the_table_says_what_was_measured_and_what_could_not_be():
    text = markdown([DONE, CANNOT])
    assert "| rolling | rod | 3 modes | 0.94 | 0.93 | +1.075 | 2 | 500 |" in text
    assert "| rolling | mujoco |  | unable: not installed | | | | |" in text
    assert "| robots | 4 | 2 | 2e+03 |" in growth_markdown([Growth("robots", 4, 0.002, 2000.0)])


def test_the_fastest_within_a_percent_are_found():
    def row(engine, setting, error_percent, factor):
        return Result("rolling", engine, setting, 1.0, 1.0, "", error_percent, 1.0 / factor, factor, 1)

    rows = [
        row("rod", "coarse", 1.5, 3000.0),
        row("rod", "medium", -0.9, 1234.5),
        row("rod", "fine", 0.01, 10.0),
        row("bullet", "coarse", -5.0, 20.0),
        row("bullet", "fine", -2.0, 2.0),
        CANNOT,
    ]
    assert [r.setting for r in fastest(rows)] == ["medium", "fine", ""]
    assert "| rolling | 1,230 × at 0.9 % | 2 × at 2 % | unable |  |" in fastest_markdown(rows)


def test_rows_are_plain_data():
    row = json.loads(json.dumps(CANNOT.row()))
    assert (row["case"], row["engine"], row["error_percent"], row["reason"]) == (
        "rolling", "mujoco", None, "not installed",
    )  # fmt: skip


def test_the_picture_has_a_panel_for_each_case_with_results(tmp_path, monkeypatch):
    from matplotlib.figure import Figure

    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda self, path, dpi: drawn.append(self))
    draw(tmp_path / "bench.png", [floating(), rolling()], [DONE, CANNOT], "made by a test")
    (figure,) = drawn
    (axis,) = figure.axes
    assert axis.get_title() == rolling().title
    (line,) = [line for line in axis.lines if line.get_label() == "rod twin"]
    assert line.get_xydata().tolist() == [[1.075, 0.002]]
    assert axis.texts[0].get_text() == "mujoco: not installed"
    assert figure.legends


def test_the_picture_reaches_the_disk(tmp_path):
    draw(tmp_path / "bench.png", list(cases())[:5], [dataclasses.replace(DONE, case=c.name) for c in cases()[:5]])
    assert (tmp_path / "bench.png").read_bytes().startswith(b"\x89PNG")


def test_the_stamp_names_program_source_engines_and_machine():
    machine = stamp([RodEngine(), Invented([])])
    assert machine["engines"]["invented"] == "invented 1"
    assert machine["libraries"]["numpy"] == np.__version__
    assert machine["source_sha256"] == source_digest()
    assert len(machine["source_sha256"]) == 64
    words = in_words({**machine, "git_commit": "0123456789abcdef+"})
    assert "commit 0123456789ab" in words
    assert machine["processor"] in words


def test_the_stamp_has_no_commit_outside_a_checkout(monkeypatch, tmp_path):
    monkeypatch.setattr("sim.benchmark.stamp._SOURCE", tmp_path)
    (tmp_path / "one.py").write_text("x = 1\n", encoding="utf-8")
    assert stamp()["git_commit"] is None
    first = source_digest()
    (tmp_path / "one.py").write_text("x = 2\n", encoding="utf-8")
    assert source_digest() != first


def test_an_unknown_solver_key_of_a_setting_is_refused():
    with pytest.raises(InputError, match="sgments"):
        rolling().scene({"twin": "bullet", "sgments": 3})
