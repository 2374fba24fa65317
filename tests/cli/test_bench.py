"""`softbot bench`: choosing, printing, writing, drawing."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

import sim.benchmark
from sim.benchmark import Growth, Result
from softbot.cli.bench import bench
from softbot.errors import InputError

ROW = Result("cantilever", "rod", "8 modes", 0.33, 0.331, "elastica", 0.01, 0.004, 250.0, 3)


@pytest.fixture
def measured(monkeypatch):
    """What `measure` is called with; it answers with one row for each case."""
    calls = []

    def measure(cases, engines, **options):
        calls.append(([case.name for case in cases], [engine.name for engine in engines], options))
        return iter([ROW for _ in cases])

    monkeypatch.setattr(sim.benchmark, "measure", measure)
    monkeypatch.setattr("sim.benchmark.scaling.growth", lambda **options: iter([Growth("modes", 3, 0.002, 500.0)]))
    return calls


def test_the_answer_is_one_json_object_with_machine_and_results(measured, capsys):
    bench(case=["cantilever"], engine=["rod", "mujoco"], repeats=2, json=True)
    answer = json.loads(capsys.readouterr().out)
    assert {"machine", "results"} == set(answer)
    assert answer["results"] == [ROW.row()]
    assert {"softbot", "engines", "libraries", "source_sha256", "date"} <= set(answer["machine"])
    assert set(answer["machine"]["engines"]) == {"rod", "mujoco"}
    ((cases, engines, options),) = measured
    assert (cases, engines) == (["cantilever"], ["rod", "mujoco"])
    assert options["repeats"] == 2


def test_quick_runs_one_setting_once(measured, capsys):
    bench(repeats=9, quick=True)
    ((cases, engines, options),) = measured
    assert len(cases) == 6
    assert len(engines) == 4
    assert (options["repeats"], options["settings_each"]) == (1, 1)
    assert "| cantilever | rod | 8 modes |" in capsys.readouterr().out


def test_growth_is_measured_when_asked(measured, capsys):
    bench(case=["cantilever"], scaling=True, repeats=1, json=True)
    assert json.loads(capsys.readouterr().out)["scaling"] == [Growth("modes", 3, 0.002, 500.0).row()]
    bench(case=["cantilever"], scaling=True, repeats=1)
    assert "| modes | 3 | 2 | 500 |" in capsys.readouterr().out


def test_tables_json_and_pictures_are_written(measured, tmp_path, capsys):
    bench(case=["cantilever"], repeats=1, out=tmp_path / "twins.md", figure=tmp_path / "twins.svg")
    page = (tmp_path / "twins.md").read_text(encoding="utf-8")
    assert page.startswith("# Run time against error\n\n`softbot bench`: softbot ")
    assert "| cantilever | rod | 8 modes | 0.33 | 0.331 | +0.010 | 4 | 250 |" in page
    assert "<svg" in (tmp_path / "twins.svg").read_text(encoding="utf-8")
    bench(case=["cantilever"], repeats=1, out=tmp_path / "twins.json")
    assert json.loads((tmp_path / "twins.json").read_text(encoding="utf-8"))["results"] == [ROW.row()]
    capsys.readouterr()


def test_unknown_names_and_places_are_refused(measured, tmp_path, capsys):
    with pytest.raises(InputError, match=r"--case hovering: choose from floating, rolling"):
        bench(case=["hovering"], repeats=1)
    with pytest.raises(InputError, match=r"--engine gazebo: choose from rod, bullet, mujoco, pyelastica"):
        bench(engine=["gazebo"], repeats=1)
    with pytest.raises(InputError, match="cannot be written"):
        bench(repeats=1, out=tmp_path / "no" / "x.md")
    with pytest.raises(InputError, match=r"x\.tune: the name ends in \.png"):
        bench(repeats=1, figure=tmp_path / "x.tune")
    capsys.readouterr()


def test_a_place_that_cannot_be_written_is_refused_before_anything_is_measured(monkeypatch, tmp_path):
    monkeypatch.setattr(sim.benchmark, "measure", lambda *arguments, **options: pytest.fail("measured"))
    with pytest.raises(InputError, match=r"--out .*: there is no folder .*no; choose another --out"):
        bench(out=tmp_path / "no" / "x.md")
    with pytest.raises(InputError, match=r"--figure .*: is a folder; name a file in it"):
        bench(figure=tmp_path)


def test_scenes_are_run_by_the_nodes_and_companies_over_processes(monkeypatch, scene_table):
    import softbot.nodes.run
    from sim.run_many import run_many
    from sim.scene import scene_from
    from softbot.cli.bench import _run, _run_many

    assert callable(run_many)

    scene = scene_from(scene_table, "x", Path())
    monkeypatch.setattr(
        softbot.nodes.run, "run_scene", lambda given: type("Run", (), {"summary": {"of": given.name}})()
    )
    assert _run(scene) == {"of": "x"}
    seen = []
    monkeypatch.setattr(sys.modules["sim.run_many"], "run_many", lambda scenes: seen.append(len(scenes)))
    _run_many([scene, scene])
    assert seen == [2]
