"""The report of a run: what its page says, holds and refuses, and the picture."""

from __future__ import annotations

import base64
import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from softbot.errors import InputError
from softbot.report import write_report, write_still
from softbot.report.headline import headline
from softbot.report.page import MAX_SAMPLES, embedded_json
from softbot.report.recording import read_recording
from softbot.report.tables import number

RADIUS_m = 0.01
LENGTH_m = 0.15
TURNING_RAD_S = math.pi  # half a revolution a second

SCENE = """[robot]
length_m = 0.15
[drive]
kind = "{kind}"
[world]
ground = "{ground}"
[sequencer]
command = "left"
[solver]
duration_s = {duration_s}
"""

RUPTURE = {"t_s": 4.0, "chamber": 2, "kind": "rupture"}
NAMED = {"t_s": 4.12, "chamber": 2, "kind": "rupture", "delay_s": 0.12}
STALL = {"t_s": 4.4, "chamber": 2, "theta_rad": 1.5}
REVERSAL = {"t_s": 4.5, "strategy": "curvature_reversal"}


def write_run(
    folder: Path,
    *,
    duration_s: float = 10.0,
    stops_s: float = math.inf,
    resumes_s: float = math.inf,
    resumed_sign: float = 1.0,
    rows_per_s: float = 50.0,
    planned_s: float | None = None,
    kind: str = "sequencer",
    ground: str = "plane",
    with_pressures: bool = True,
    with_states: bool = True,
    nodes: int = 11,
    scene_text: str = "",
    **summary: Any,
) -> Path:
    """A C-bent tube that rolls towards +y at half a revolution a second, but not from stops_s to resumes_s."""
    folder.mkdir(parents=True, exist_ok=True)
    t_s = np.arange(round(duration_s * rows_per_s) + 1) / rows_per_s
    rolling_s = np.minimum(t_s, stops_s) + resumed_sign * np.maximum(t_s - resumes_s, 0.0)
    roll_rad = -TURNING_RAD_S * rolling_s
    com_m = np.stack([np.zeros_like(t_s), -0.94 * RADIUS_m * roll_rad, np.full_like(t_s, RADIUS_m)], axis=1)
    columns: dict[str, Any] = {"t_s": t_s, "roll_rad": roll_rad}
    columns |= {f"com_{axis}_m": com_m[:, i] for i, axis in enumerate("xyz")}
    for i in range(4):
        wave_Pa = 60e3 * np.maximum(0.0, np.cos(roll_rad + i * math.pi / 2))
        columns[f"pressure_{i}_Pa"] = wave_Pa if with_pressures else np.full_like(t_s, np.nan)
        columns[f"command_{i}_Pa"] = wave_Pa if with_pressures else np.full_like(t_s, np.nan)
    columns |= {
        "bend_rad": np.full_like(t_s, 1.8),
        "bend_direction_rad": -roll_rad,
        "length_m": np.full_like(t_s, 0.155),
    }
    columns["theta_rad"] = np.where(t_s < 1.0, np.nan, 0.9)
    if with_states:
        columns["state"] = ["priming" if t < 1.0 else "degraded_rolling" if t > 4.5 else "rolling" for t in t_s]
        columns["c_bend_side"] = np.where(t_s < 1.0, 0, np.where(t_s < 4.5, 1, -1))
    parquet.write_table(pa.table(columns), folder / "telemetry.parquet")

    frames = np.arange(0, t_s.size, 2)
    along = np.linspace(-0.5, 0.5, nodes)
    shape_m = np.stack([LENGTH_m * np.sin(along), 0.5 * LENGTH_m * along**2, np.zeros(nodes)], axis=1)
    tangent = np.gradient(shape_m, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = np.stack([-tangent[:, 1], tangent[:, 0], np.zeros(nodes)], axis=1)
    upward = np.array([0.0, 0.0, 1.0])
    director = [np.cos(roll_rad[f]) * across + np.sin(roll_rad[f]) * upward for f in frames]
    write_shapes(folder / "shape.parquet", t_s[frames], [shape_m + com_m[f] for f in frames], director)

    scene = SCENE.format(kind=kind, ground=ground, duration_s=duration_s if planned_s is None else planned_s)
    (folder / "scene.toml").write_text(scene + scene_text, encoding="utf-8")
    told: dict[str, Any] = {
        "schema": "softbot-summary-1", "scene": "a scene", "twin": "bullet", "accuracy": "standard",
        "sim_time_s": duration_s, "wall_time_s": 2.5, "real_time_factor": 4.0, "steps": 2500, "revolutions": -3.5,
        "displacement_m": [0.0, 0.207], "advance_per_revolution_m": 0.0591, "plane_rotation_rad": 0.5, "bend_rad": 1.8,
        "stalls": [], "faults": [], "detections": [], "recoveries": [], "false_alarms": 0, "missed_faults": 0,
        "steady_span_s": 8.0,
    }  # fmt: skip
    (folder / "summary.json").write_text(json.dumps(told | summary), encoding="utf-8")
    return folder


def write_shapes(
    path: Path, t_s: Any, lines_m: list[Any], directors: list[Any], radius: bytes | None = b"0.01"
) -> None:
    schema = pa.schema(
        [("t_s", pa.float64()), ("centreline_m", pa.list_(pa.float32())), ("director", pa.list_(pa.float32()))],
        metadata={b"radius_m": radius} if radius is not None else None,
    )
    lists = [[np.asarray(v, dtype=np.float32).ravel() for v in vectors] for vectors in (lines_m, directors)]
    arrays = [pa.array(t_s), *(pa.array(v, pa.list_(pa.float32())) for v in lists)]
    parquet.write_table(pa.table(arrays, schema=schema), path)


def page_and_data(run_dir: Path) -> tuple[str, dict[str, Any]]:
    page = write_report(run_dir).read_text(encoding="utf-8")
    match = re.search(r'<script type="application/json" id="run">(.*?)</script>', page, re.DOTALL)
    assert match
    return page, json.loads(match[1], parse_constant=lambda token: pytest.fail(f"{token} in the page's JSON"))


def floats(text: str) -> Any:
    return np.frombuffer(base64.b64decode(text), dtype="<f4")


def told(tmp_path: Path, **options: Any) -> str:
    return headline(read_recording(write_run(tmp_path / "run", **options)))


# The page


def test_the_page_is_written_whole_into_the_run_directory(tmp_path: Path) -> None:
    run_dir = write_run(tmp_path / "run")
    assert write_report(run_dir) == run_dir / "report.html"
    assert (run_dir / "report.html").read_text(encoding="utf-8").rstrip().endswith("</html>")
    assert sorted(path.name for path in run_dir.iterdir()) == [
        "report.html", "scene.toml", "shape.parquet", "summary.json", "telemetry.parquet",
    ]  # fmt: skip


def test_a_page_of_the_same_run_is_the_same_page(tmp_path: Path) -> None:
    run_dir = write_run(tmp_path / "run")
    first = write_report(run_dir).read_bytes()
    assert write_report(run_dir).read_bytes() == first


def test_the_page_refers_to_nothing_outside_itself(tmp_path: Path) -> None:
    references: list[str] = []

    class Parser(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            assert tag not in ("link", "iframe", "object", "embed", "base"), tag
            references.extend(str(value) for key, value in attrs if key in ("src", "href", "srcset", "data", "action"))

    page, _ = page_and_data(write_run(tmp_path / "run"))
    Parser().feed(page)
    assert not [reference for reference in references if not reference.startswith("#")]
    assert not re.search(r"https?://(?!www\.w3\.org/)|@import|url\(|fetch\(|XMLHttpRequest|import\(", page)
    assert "{{" not in page


def test_a_40_second_run_makes_a_light_page(tmp_path: Path) -> None:
    run_dir = write_run(tmp_path / "run", duration_s=40.0, rows_per_s=100.0)
    assert write_report(run_dir).stat().st_size < 3e6


def test_the_page_holds_every_sample_of_a_short_run(tmp_path: Path) -> None:
    _, data = page_and_data(write_run(tmp_path / "run", duration_s=6.0, rows_per_s=50.0))
    assert data["samples"] == 301
    for name, text in data["columns"].items():
        assert floats(text).size == 301, name
    np.testing.assert_allclose(floats(data["columns"]["t_s"]), np.arange(301) / 50.0, rtol=1e-6)
    assert floats(data["columns"]["roll_rev"])[-1] == pytest.approx(-3.0)
    assert floats(data["columns"]["moved_y_cm"])[-1] == pytest.approx(94.0 * RADIUS_m * 6.0 * math.pi, rel=1e-5)
    assert floats(data["columns"]["pressure_0_kPa"])[0] == pytest.approx(60.0)


def test_a_long_run_is_thinned_out_and_keeps_its_ends(tmp_path: Path) -> None:
    _, data = page_and_data(write_run(tmp_path / "run", duration_s=60.0, rows_per_s=100.0))
    t_s = floats(data["columns"]["t_s"])
    assert t_s.size == data["samples"] == MAX_SAMPLES
    assert (t_s[0], t_s[-1]) == (0.0, 60.0)


@pytest.mark.parametrize("nodes", [2, 3, 11, 60])
def test_shapes_come_back_within_a_thousandth_of_the_radius(tmp_path: Path, nodes: int) -> None:
    run_dir = write_run(tmp_path / "run", nodes=nodes)
    recorded = read_recording(run_dir).shapes
    _, data = page_and_data(run_dir)
    shapes = data["shapes"]
    assert shapes["frames"] == recorded.t_s.size == 251
    assert shapes["radius_m"] == RADIUS_m
    whole = (shapes["frames"], shapes["nodes"], 3)
    offset = np.frombuffer(base64.b64decode(shapes["offset"]), dtype="<i2").reshape(whole)
    director = np.frombuffer(base64.b64decode(shapes["director"]), dtype="<i2").reshape(whole) / 32767.0
    line_m = floats(shapes["centre_m"]).reshape(-1, 1, 3) + shapes["step_m"] * offset
    for place in (0, -1):
        np.testing.assert_allclose(line_m[:, place], recorded.centreline_m[:, place], atol=1e-3 * RADIUS_m)
        np.testing.assert_allclose(director[:, place], recorded.director[:, place], atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(director, axis=2), 1.0, atol=1e-4)


@pytest.mark.parametrize("absent", [False, True])
def test_a_run_without_pressures_has_no_pressure_plots(tmp_path: Path, absent: bool) -> None:
    run_dir = write_run(tmp_path / "run", kind="curvature", with_pressures=False)
    if absent:
        table = parquet.read_table(run_dir / "telemetry.parquet")
        table = table.drop_columns([name for name in table.column_names if name.endswith("_Pa")])
        parquet.write_table(table, run_dir / "telemetry.parquet")
    _, data = page_and_data(run_dir)
    assert [plot["title"] for plot in data["plots"]] == [
        "roll",
        "displacement",
        "bend",
        "length",
        "θ of the active side",
    ]
    assert data["highest_kPa"] is None
    assert not [name for name in data["columns"] if "kPa" in name]


def test_plots_use_only_columns_that_are_there(tmp_path: Path) -> None:
    _, data = page_and_data(write_run(tmp_path / "run"))
    used = {series["column"] for plot in data["plots"] for series in plot["series"]}
    assert used <= set(data["columns"])
    assert {f"{what}_{i}_kPa" for what in ("pressure", "command") for i in range(4)} <= used


def test_state_bands_follow_the_telemetry(tmp_path: Path) -> None:
    _, data = page_and_data(write_run(tmp_path / "run"))
    state, side = data["bands"]
    assert [name for *_, name in state["spans"]] == ["priming", "rolling", "degraded rolling"]
    assert state["spans"][1][:2] == pytest.approx([1.0, 4.52])
    assert [name for *_, name in side["spans"]] == ["straight", "side +", "side −"]
    assert state["spans"][-1][1] == side["spans"][-1][1] == 10.0


def test_a_run_without_states_has_no_bands(tmp_path: Path) -> None:
    _, data = page_and_data(write_run(tmp_path / "run", with_states=False))
    assert data["bands"] == []


def test_events_are_in_order_of_time_in_the_page_and_in_its_table(tmp_path: Path) -> None:
    events = {"faults": [RUPTURE], "detections": [NAMED], "stalls": [STALL], "recoveries": [REVERSAL]}
    page, data = page_and_data(write_run(tmp_path / "run", **events))
    assert [(event["t_s"], event["type"]) for event in data["events"]] == [
        (4.0, "fault"), (4.12, "detection"), (4.4, "stall"), (4.5, "recovery"),
    ]  # fmt: skip
    assert re.findall(r"data-t='([\d.]+)'", page) == ["4", "4.12", "4.4", "4.5"]
    assert "chamber 2, rupture, after 0.12 s" in page
    assert "chamber 2, θ = 85.9°" in page


def test_a_broken_chamber_is_dead_at_once_and_a_leaking_one_when_it_is_named(tmp_path: Path) -> None:
    faults = [RUPTURE, {"t_s": 5.0, "chamber": 0, "kind": "leak"}, {"t_s": 6.0, "chamber": 1, "kind": "sensor_stuck"}]
    detections = [NAMED, {"t_s": 5.7, "chamber": 0, "kind": "leak"}]
    _, data = page_and_data(write_run(tmp_path / "run", faults=faults, detections=detections))
    assert data["dead_from_s"] == [5.7, None, 4.0, None]


def test_text_of_the_scene_cannot_become_markup(tmp_path: Path) -> None:
    evil = "</script><script>alert(1)</script><b onmouseover='x'>{{run}}"
    run_dir = write_run(
        tmp_path / "run",
        scene=evil,
        twin=evil,
        other=evil,
        scene_text=f"# {evil}\n",
        recoveries=[{"t_s": 4.5, "strategy": evil}],
    )
    page, data = page_and_data(run_dir)
    assert "<script>alert" not in page
    assert "<b onmouseover" not in page
    assert "&lt;b onmouseover" in page
    assert data["name"] == evil
    assert page.count("</script>") == 2


def test_embedded_json_has_no_nan_and_nothing_that_html_reads() -> None:
    text = embedded_json({"a": math.nan, "b": [math.inf, 1.0], "c": "</script>&<!--"})
    assert not set("<>&") & set(text)
    assert json.loads(text) == {"a": None, "b": [None, 1.0], "c": "</script>&<!--"}


def test_numbers_that_are_not_finite_show_as_a_dash(tmp_path: Path) -> None:
    page, _ = page_and_data(write_run(tmp_path / "run", revolutions=math.nan, advance_per_revolution_m=None))
    assert "<td>—</td>" in page
    assert "nan" not in page.split("<script")[0].lower()


def test_the_table_of_numbers_has_units(tmp_path: Path) -> None:
    page, _ = page_and_data(write_run(tmp_path / "run", false_alarms=[{"t_s": 1.0}], max_force_N=1.25))
    rows = dict(re.findall(r"<th scope='row'>(.*?)</th><td>(.*?)</td>", page))
    units = dict(re.findall(r"<th scope='row'>(.*?)</th><td>.*?</td><td class='unit'>(.*?)</td>", page))
    assert rows["displacement x, y"] == "0, 20.7"
    assert units["displacement x, y"] == "cm"
    assert (rows["bend"], units["bend"]) == ("103.1", "°")
    assert (rows["advance per revolution"], units["advance per revolution"]) == ("59.1", "mm")
    assert rows["false alarms"] == "1"
    assert rows["max_force_N"] == "1.25"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (-3.14159, "\N{MINUS SIGN}3.142"),
        (12500, "12\N{THIN SPACE}500"),
        (True, "—"),
        ("x", "—"),
        (None, "—"),
        (0.0, "0"),
    ],
)
def test_numbers_are_written_for_people(value: object, text: str) -> None:
    assert number(value) == text


def test_gaps_in_the_telemetry_are_kept_as_gaps(tmp_path: Path) -> None:
    run_dir = write_run(tmp_path / "run")
    table = parquet.read_table(run_dir / "telemetry.parquet").to_pydict()
    for name in ("roll_rad", "com_x_m", "com_y_m", "bend_rad"):
        table[name][-5:] = [math.nan] * 4 + [None]
    parquet.write_table(pa.table(table), run_dir / "telemetry.parquet")
    _, data = page_and_data(run_dir)
    assert np.isnan(floats(data["columns"]["bend_deg"])[-5:]).all()
    assert np.isfinite(floats(data["columns"]["roll_rev"])).all()


def test_frames_without_positions_are_left_out(tmp_path: Path) -> None:
    run_dir = write_run(tmp_path / "run")
    shapes = read_recording(run_dir).shapes
    lines_m = shapes.centreline_m.copy()
    lines_m[-3:, 0] = np.nan
    write_shapes(run_dir / "shape.parquet", shapes.t_s, list(lines_m), list(shapes.director))
    _, data = page_and_data(run_dir)
    assert data["shapes"]["frames"] == shapes.t_s.size - 3


# The headline


def test_headline_of_the_whole_experiment(tmp_path: Path) -> None:
    text = told(
        tmp_path,
        stops_s=4.4,
        resumes_s=4.8,
        faults=[RUPTURE],
        detections=[NAMED],
        stalls=[STALL],
        recoveries=[REVERSAL],
    )
    assert text == (
        "Rolled 2.0 revolutions left, lost chamber 2 at 4.0 s (rupture), named it 0.12 s later, stopped, "
        "reversed its curvature and rolled 2.8 more in the same direction."
    )


def test_headline_with_recovery_off_says_that_it_stopped_and_stayed(tmp_path: Path) -> None:
    text = told(tmp_path, stops_s=4.4, faults=[RUPTURE], detections=[NAMED], stalls=[STALL])
    assert text == (
        "Rolled 2.0 revolutions left, lost chamber 2 at 4.0 s (rupture), named it 0.12 s later, "
        "rolled 0.2 more in the same direction, stopped and stayed."
    )


def test_headline_does_not_call_a_robot_that_rolls_on_stopped(tmp_path: Path) -> None:
    text = told(tmp_path, faults=[RUPTURE], detections=[NAMED])
    assert "stopped" not in text
    assert text.endswith("named it 0.12 s later and rolled 3.0 more in the same direction.")


def test_headline_tells_when_a_fault_was_not_noticed(tmp_path: Path) -> None:
    text = told(tmp_path, stops_s=4.4, faults=[RUPTURE])
    assert "did not notice" in text
    assert "named" not in text


def test_headline_of_an_open_loop_run_expects_nobody_to_notice(tmp_path: Path) -> None:
    assert "notice" not in told(tmp_path, kind="pressure", stops_s=4.4, faults=[RUPTURE])


def test_headline_tells_a_wrong_name_and_false_alarms(tmp_path: Path) -> None:
    wrong = NAMED | {"kind": "leak"}
    text = told(tmp_path, faults=[RUPTURE], detections=[wrong], false_alarms=2)
    assert "took it for a leak 0.12 s later" in text
    assert text.endswith("There were 2 false alarms.")


def test_headline_tells_a_recovery_that_goes_the_other_way(tmp_path: Path) -> None:
    text = told(
        tmp_path,
        stops_s=4.4,
        resumes_s=4.8,
        resumed_sign=-1.0,
        faults=[RUPTURE],
        detections=[NAMED],
        recoveries=[REVERSAL, REVERSAL | {"t_s": 6.0}],
    )
    assert text.endswith("reversed its curvature 2 times and rolled 2.4 more back the other way.")


def test_headline_tells_a_recovery_that_failed(tmp_path: Path) -> None:
    text = told(tmp_path, stops_s=4.0, faults=[RUPTURE], detections=[NAMED], stalls=[STALL], recoveries=[REVERSAL])
    assert text.endswith("stopped, reversed its curvature and got no further.")


def test_headline_tells_a_safe_stop_and_that_the_tube_coasted(tmp_path: Path) -> None:
    stop = {"t_s": 4.12, "strategy": "safe_stop"}
    text = told(tmp_path, faults=[RUPTURE], detections=[NAMED], recoveries=[stop])
    assert "reversed" not in text
    assert "named it 0.12 s later, went into the safe state and coasted another 3.0 revolutions" in text


def test_headline_finds_the_verdict_on_a_fault_that_another_one_followed(tmp_path: Path) -> None:
    at_once = RUPTURE | {"chamber": 0}
    text = told(tmp_path, faults=[RUPTURE, at_once], detections=[NAMED, NAMED | {"chamber": 0}])
    assert "did not notice" not in text


def test_headline_counts_each_fault_of_several(tmp_path: Path) -> None:
    later = {"t_s": 7.0, "chamber": 0, "kind": "sensor_offset"}
    text = told(tmp_path, faults=[later, RUPTURE], detections=[NAMED])
    assert text == (
        "Rolled 2.0 revolutions left, lost chamber 2 at 4.0 s (rupture), named it 0.12 s later, "
        "rolled 1.5 more in the same direction, had the pressure sensor of chamber 0 drift off at 7.0 s, "
        "did not notice and rolled 1.5 more in the same direction."
    )


def test_headline_of_a_run_without_faults(tmp_path: Path) -> None:
    assert told(tmp_path, duration_s=2.0) == "Rolled 1.0 revolution left and moved 5.91 cm across the floor."


def test_headline_of_a_robot_that_does_not_roll(tmp_path: Path) -> None:
    assert told(tmp_path, stops_s=0.0) == "Did not roll for 10.0 s."


def test_headline_of_a_floating_robot_names_no_floor(tmp_path: Path) -> None:
    text = told(tmp_path, kind="curvature", ground="none")
    assert text == "Floating without ground, turned 5.0 revolutions about its own axis."


def test_headline_tells_a_recording_that_ends_early(tmp_path: Path) -> None:
    text = told(tmp_path, duration_s=3.0, planned_s=12.0, faults=[RUPTURE])
    assert "lost" not in text
    assert text.endswith("The recording ends at 3.0 s of 12.0 s.")


# What is refused


@pytest.mark.parametrize("name", ["summary.json", "scene.toml", "telemetry.parquet", "shape.parquet"])
@pytest.mark.parametrize("damage", ["missing", "half", "empty", "noise"])
def test_a_missing_or_damaged_file_is_named(tmp_path: Path, name: str, damage: str) -> None:
    path = write_run(tmp_path / "run") / name
    if damage == "missing":
        path.unlink()
    else:
        whole = path.read_bytes()
        # Half a line of TOML is cut inside a value: half of a whole file may still be valid.
        half = b"[robot]\nlength_m = " if name == "scene.toml" else whole[: len(whole) // 2]
        path.write_bytes({"half": half, "empty": b"", "noise": b"\xff\x00\xfe" * 50}[damage])
    with pytest.raises(InputError, match=re.escape(str(path))):
        write_report(path.parent)
    assert not (path.parent / "report.html").exists()


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such run directory"):
        write_report(tmp_path / "nowhere")


def test_a_summary_that_is_no_object_is_refused(tmp_path: Path) -> None:
    run_dir = write_run(tmp_path / "run")
    (run_dir / "summary.json").write_text("[1, 2]", encoding="utf-8")
    with pytest.raises(InputError, match="no JSON object"):
        write_report(run_dir)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda table: table.drop_columns(["roll_rad"]), "column roll_rad missing"),
        (lambda table: table.slice(0, 0), "no rows"),
        (lambda table: table.take(list(range(table.num_rows))[::-1]), "t_s must be finite and increase"),
        (
            lambda table: table.set_column(
                table.schema.get_field_index("com_x_m"), "com_x_m", pa.array([math.nan] * table.num_rows)
            ),
            "com_x_m holds no numbers",
        ),
    ],
)
def test_telemetry_that_makes_no_sense_is_refused(tmp_path: Path, change: Any, message: str) -> None:
    path = write_run(tmp_path / "run") / "telemetry.parquet"
    parquet.write_table(change(parquet.read_table(path)), path)
    with pytest.raises(InputError, match=message):
        write_report(path.parent)


LINE_m = np.linspace([0.0, 0.0, 0.01], [0.1, 0.0, 0.01], 5)
UP = np.tile([0.0, 0.0, 1.0], (5, 1))


@pytest.mark.parametrize(
    ("lines_m", "directors", "radius", "message"),
    [
        ([LINE_m] * 2, [UP] * 2, None, "radius_m"),
        ([LINE_m] * 2, [UP] * 2, b"thick", "radius_m"),
        ([LINE_m] * 2, [UP] * 2, b"-1", "radius_m"),
        ([LINE_m] * 2, [UP[:3]] * 2, b"0.01", "differ in nodes"),
        ([LINE_m, LINE_m[:3]], [UP] * 2, b"0.01", "centreline_m must list"),
        ([LINE_m[:1]] * 2, [UP[:1]] * 2, b"0.01", "two nodes or more"),
        ([LINE_m * math.nan] * 2, [UP] * 2, b"0.01", "no frame has finite positions"),
    ],
)
def test_shapes_that_make_no_sense_are_refused(
    tmp_path: Path, lines_m: list[Any], directors: list[Any], radius: bytes | None, message: str
) -> None:
    run_dir = write_run(tmp_path / "run")
    write_shapes(run_dir / "shape.parquet", [0.0, 0.1], lines_m, directors, radius)
    with pytest.raises(InputError, match=message):
        write_report(run_dir)


def test_shapes_of_another_kind_are_refused(tmp_path: Path) -> None:
    run_dir = write_run(tmp_path / "run")
    for columns, message in (
        ({"t_s": [0.0, 0.1], "director": [[0.0] * 6] * 2}, "column centreline_m missing"),
        ({"t_s": [0.0, 0.1], "centreline_m": [1.0, 2.0], "director": [1.0, 2.0]}, "centreline_m must list"),
    ):
        table = pa.table(columns).replace_schema_metadata({b"radius_m": b"0.01"})
        parquet.write_table(table, run_dir / "shape.parquet")
        with pytest.raises(InputError, match=message):
            write_report(run_dir)


def test_a_page_that_cannot_be_written_is_an_input_error(tmp_path: Path) -> None:
    run_dir = write_run(tmp_path / "run")
    (run_dir / "report.html").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        write_report(run_dir)


# The picture


def colours_of(path: Path) -> Any:
    from matplotlib.image import imread

    return imread(path)[..., :3]


def share_near(image: Any, colour: tuple[float, float, float]) -> float:
    """Share of the pixels that have the hue of this colour, paler or darker as they may be."""
    hue = image - image.min(axis=2, keepdims=True)
    strength = np.linalg.norm(hue, axis=2)
    wanted = np.array(colour) - min(colour)
    near = hue @ (wanted / np.linalg.norm(wanted)) > 0.98 * strength
    return float((near & (strength > 0.2)).mean())


def test_the_picture_shows_stripes_and_a_dead_chamber_black(tmp_path: Path) -> None:
    from softbot.report.still import CHAMBERS

    healthy = write_run(tmp_path / "healthy")
    damaged = write_run(tmp_path / "damaged", faults=[RUPTURE], recoveries=[REVERSAL])
    # A revolution is 2 s, so each of these poses turns another chamber to the camera.
    times_s = [4.5, 6.0, 7.5, 9.0]
    first = colours_of(write_still(healthy, tmp_path / "healthy.png", times_s))
    second = colours_of(write_still(damaged, tmp_path / "damaged.png", times_s))
    assert min(share_near(first, colour) for colour in CHAMBERS) > 0.005
    assert share_near(second, CHAMBERS[2]) < 0.2 * share_near(first, CHAMBERS[2])
    black_first, black_second = ((image.max(axis=2) < 0.45).mean() for image in (first, second))
    assert black_second > black_first + 0.005


@pytest.mark.parametrize(("ground", "stops_s"), [("plane", math.inf), ("plane", 0.0), ("none", 0.0)])
def test_the_picture_chooses_poses_for_itself(tmp_path: Path, ground: str, stops_s: float) -> None:
    run_dir = write_run(tmp_path / "run", ground=ground, stops_s=stops_s, faults=[RUPTURE], recoveries=[REVERSAL])
    image = colours_of(write_still(run_dir, tmp_path / "still.png"))
    assert image.shape[0] > 400
    assert image.shape[1] > 1000
    assert np.ptp(image) > 0.5


@pytest.mark.parametrize("times_s", [[], [-1.0], [3.0, 99.0], [math.nan]])
def test_the_picture_refuses_times_outside_the_recording(tmp_path: Path, times_s: list[float]) -> None:
    run_dir = write_run(tmp_path / "run")
    with pytest.raises(InputError, match="between 0 s and 10 s"):
        write_still(run_dir, tmp_path / "still.png", times_s)


def test_a_picture_that_cannot_be_written_is_an_input_error(tmp_path: Path) -> None:
    run_dir = write_run(tmp_path / "run")
    with pytest.raises(InputError, match="cannot be written"):
        write_still(run_dir, tmp_path / "no" / "such" / "still.png", [1.0])
