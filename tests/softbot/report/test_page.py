"""What the page of a run says and holds."""

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

from softbot.report import write_report
from softbot.report.page import MAX_SAMPLES, embedded_json
from softbot.report.recording import read_recording
from softbot.report.tables import event_list, number, summary_table


def page_and_data(run_dir: Path) -> tuple[str, dict[str, Any]]:
    page = write_report(run_dir).read_text(encoding="utf-8")
    match = re.search(r'<script type="application/json" id="run">(.*?)</script>', page, re.DOTALL)
    assert match
    return page, json.loads(match[1], parse_constant=lambda token: pytest.fail(f"{token} in the page's JSON"))


def floats(text: str) -> Any:
    return np.frombuffer(base64.b64decode(text), dtype="<f4")


def test_the_page_is_written_whole_into_the_run_directory(runs: Any, tmp_path: Path) -> None:
    run_dir = runs.write_run(tmp_path / "run")
    assert write_report(run_dir) == run_dir / "report.html"
    assert (run_dir / "report.html").read_text(encoding="utf-8").rstrip().endswith("</html>")
    assert sorted(path.name for path in run_dir.iterdir()) == [
        "report.html", "scene.toml", "shape.parquet", "summary.json", "telemetry.parquet",
    ]  # fmt: skip


def test_a_page_of_the_same_run_is_the_same_page(runs: Any, tmp_path: Path) -> None:
    run_dir = runs.write_run(tmp_path / "run")
    first = write_report(run_dir).read_bytes()
    assert write_report(run_dir).read_bytes() == first


def test_the_page_refers_to_nothing_outside_itself(runs: Any, tmp_path: Path) -> None:
    references: list[str] = []

    class Parser(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            assert tag not in ("link", "iframe", "object", "embed", "base"), tag
            references.extend(str(value) for key, value in attrs if key in ("src", "href", "srcset", "data", "action"))

    page, _ = page_and_data(runs.write_run(tmp_path / "run"))
    Parser().feed(page)
    assert not [reference for reference in references if not reference.startswith("#")]
    assert not re.search(r"https?://(?!www\.w3\.org/)|@import|url\(|fetch\(|XMLHttpRequest|import\(", page)
    assert "{{" not in page


def test_a_40_second_run_makes_a_light_page(runs: Any, tmp_path: Path) -> None:
    run_dir = runs.write_run(tmp_path / "run", duration_s=40.0, rows_per_s=100.0)
    assert write_report(run_dir).stat().st_size < 3e6


def test_the_page_holds_every_sample_of_a_short_run(runs: Any, tmp_path: Path) -> None:
    _, data = page_and_data(runs.write_run(tmp_path / "run", duration_s=6.0, rows_per_s=50.0))
    assert data["samples"] == 301
    for name, text in data["columns"].items():
        assert floats(text).size == 301, name
    np.testing.assert_allclose(floats(data["columns"]["t_s"]), np.arange(301) / 50.0, rtol=1e-6)
    assert floats(data["columns"]["roll_rev"])[-1] == pytest.approx(-3.0)
    assert floats(data["columns"]["moved_y_cm"])[-1] == pytest.approx(94.0 * runs.RADIUS_m * 6.0 * math.pi, rel=1e-5)
    assert floats(data["columns"]["pressure_0_kPa"])[0] == pytest.approx(60.0)


def test_a_long_run_is_thinned_out_and_keeps_its_ends(runs: Any, tmp_path: Path) -> None:
    _, data = page_and_data(runs.write_run(tmp_path / "run", duration_s=60.0, rows_per_s=100.0))
    t_s = floats(data["columns"]["t_s"])
    assert t_s.size == data["samples"] == MAX_SAMPLES
    assert (t_s[0], t_s[-1]) == (0.0, 60.0)


@pytest.mark.parametrize("nodes", [2, 3, 11, 60])
def test_shapes_come_back_within_a_thousandth_of_the_radius(runs: Any, tmp_path: Path, nodes: int) -> None:
    run_dir = runs.write_run(tmp_path / "run", nodes=nodes)
    recorded = read_recording(run_dir).shapes
    _, data = page_and_data(run_dir)
    shapes = data["shapes"]
    assert shapes["frames"] == recorded.t_s.size == 251
    assert shapes["radius_m"] == runs.RADIUS_m
    whole = (shapes["frames"], shapes["nodes"], 3)
    offset = np.frombuffer(base64.b64decode(shapes["offset"]), dtype="<i2").reshape(whole)
    director = np.frombuffer(base64.b64decode(shapes["director"]), dtype="<i2").reshape(whole) / 32767.0
    line_m = floats(shapes["centre_m"]).reshape(-1, 1, 3) + shapes["step_m"] * offset
    for place in (0, -1):
        np.testing.assert_allclose(line_m[:, place], recorded.centreline_m[:, place], atol=1e-3 * runs.RADIUS_m)
        np.testing.assert_allclose(director[:, place], recorded.director[:, place], atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(director, axis=2), 1.0, atol=1e-4)


@pytest.mark.parametrize("absent", [False, True])
def test_a_run_without_pressures_has_no_pressure_plots(runs: Any, tmp_path: Path, absent: bool) -> None:
    run_dir = runs.write_run(tmp_path / "run", kind="curvature", with_pressures=False)
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


def test_plots_use_only_columns_that_are_there(runs: Any, tmp_path: Path) -> None:
    _, data = page_and_data(runs.write_run(tmp_path / "run"))
    used = {series["column"] for plot in data["plots"] for series in plot["series"]}
    assert used <= set(data["columns"])
    assert {f"{what}_{i}_kPa" for what in ("pressure", "command") for i in range(4)} <= used


def test_state_bands_follow_the_telemetry(runs: Any, tmp_path: Path) -> None:
    _, data = page_and_data(runs.write_run(tmp_path / "run"))
    state, side = data["bands"]
    assert [name for *_, name in state["spans"]] == ["priming", "rolling", "degraded rolling"]
    assert state["spans"][1][:2] == pytest.approx([1.0, 4.52])
    assert [name for *_, name in side["spans"]] == ["straight", "side +", "side −"]
    assert state["spans"][-1][1] == side["spans"][-1][1] == 10.0


def test_a_run_without_states_has_no_bands(runs: Any, tmp_path: Path) -> None:
    _, data = page_and_data(runs.write_run(tmp_path / "run", with_states=False))
    assert data["bands"] == []


def test_events_are_in_order_of_time_in_the_page_and_in_its_table(runs: Any, tmp_path: Path) -> None:
    events = {
        "faults": [runs.RUPTURE],
        "detections": [runs.NAMED],
        "stalls": [runs.STALL],
        "recoveries": [runs.REVERSAL],
    }
    page, data = page_and_data(runs.write_run(tmp_path / "run", **events))
    assert [(event["t_s"], event["type"]) for event in data["events"]] == [
        (4.0, "fault"), (4.12, "detection"), (4.4, "stall"), (4.5, "recovery"),
    ]  # fmt: skip
    assert re.findall(r"data-t='([\d.]+)'", page) == ["4", "4.12", "4.4", "4.5"]
    assert "chamber 2, rupture, after 0.12 s" in page
    assert "chamber 2, θ = 85.9°" in page


def test_events_of_what_the_chambers_share_name_no_chamber(runs: Any, tmp_path: Path) -> None:
    lost = {"t_s": 4.0, "chamber": -1, "kind": "supply_loss"}
    stall = {"t_s": 6.0, "chamber": -1, "theta_rad": None}
    sag = {"t_s": 4.5, "chamber": -1, "kind": "supply_sag", "delay_s": None, "judgement": "misnamed"}
    run = runs.write_run(tmp_path / "run", faults=[lost], detections=[sag], stalls=[stall])
    assert [event["text"] for event in event_list(read_recording(run))] == [
        "the robot, supply loss",
        "the robot, supply sag (misnamed)",
        "stopped",
    ]


def test_a_broken_chamber_is_dead_at_once_and_a_leaking_one_when_it_is_named(runs: Any, tmp_path: Path) -> None:
    faults = [
        runs.RUPTURE,
        {"t_s": 5.0, "chamber": 0, "kind": "leak"},
        {"t_s": 6.0, "chamber": 1, "kind": "sensor_stuck"},
    ]
    detections = [runs.NAMED, {"t_s": 5.7, "chamber": 0, "kind": "leak"}]
    _, data = page_and_data(runs.write_run(tmp_path / "run", faults=faults, detections=detections))
    assert data["dead_from_s"] == [5.7, None, 4.0, None]


def test_text_of_the_scene_cannot_become_markup(runs: Any, tmp_path: Path) -> None:
    evil = "</script><script>alert(1)</script><b onmouseover='x'>{{run}}"
    run_dir = runs.write_run(
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


def test_numbers_that_are_not_finite_show_as_a_dash(runs: Any, tmp_path: Path) -> None:
    page, _ = page_and_data(runs.write_run(tmp_path / "run", revolutions=math.nan, advance_per_revolution_m=None))
    assert "<td>—</td>" in page
    assert "nan" not in page.split("<script")[0].lower()


def test_the_table_of_numbers_has_units(runs: Any, tmp_path: Path) -> None:
    page, _ = page_and_data(runs.write_run(tmp_path / "run", false_alarms=[{"t_s": 1.0}], max_force_N=1.25))
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


def test_gaps_in_the_telemetry_are_kept_as_gaps(runs: Any, tmp_path: Path) -> None:
    run_dir = runs.write_run(tmp_path / "run")
    table = parquet.read_table(run_dir / "telemetry.parquet").to_pydict()
    for name in ("roll_rad", "com_x_m", "com_y_m", "bend_rad"):
        table[name][-5:] = [math.nan] * 4 + [None]
    parquet.write_table(pa.table(table), run_dir / "telemetry.parquet")
    _, data = page_and_data(run_dir)
    assert np.isnan(floats(data["columns"]["bend_deg"])[-5:]).all()
    assert np.isfinite(floats(data["columns"]["roll_rev"])).all()


def test_frames_without_positions_are_left_out(runs: Any, tmp_path: Path) -> None:
    run_dir = runs.write_run(tmp_path / "run")
    shapes = read_recording(run_dir).shapes
    lines_m = shapes.centreline_m.copy()
    lines_m[-3:, 0] = np.nan
    runs.write_shapes(run_dir / "shape.parquet", shapes.t_s, list(lines_m), list(shapes.director))
    _, data = page_and_data(run_dir)
    assert data["shapes"]["frames"] == shapes.t_s.size - 3


def test_every_number_of_a_summary_is_called_in_words() -> None:
    shown = summary_table(
        {"total_revolutions": -2.5, "energy_gain_J": 1e-6, "asleep_s": 0.1, "highest_pressure_share": 1.41}
    )
    assert "revolutions in all" in shown
    assert "of the chambers&#x27; limit</th><td>141</td><td class='unit'>%" in shown
    assert "_" not in shown
