"""The benchmark measures what it says: rulers, errors, a table, a stamp."""

from __future__ import annotations

import json

import pytest

from sim.benchmark import Result, Setting, cases, markdown, run_benchmark, scene_of, segment_twin_at_4_ms, stamp
from softbot.rolling import coulomb_advance_ratio, floating_ratio


def test_the_rulers_are_those_of_the_theory():
    expected = [case.expected for case in cases()]
    assert expected == [floating_ratio(0.15, 0.01, 12.0), floating_ratio(0.15, 0.01, 8.0), coulomb_advance_ratio(0.9)]


def test_the_rod_meets_them_and_the_table_says_so():
    results = list(run_benchmark((Setting("rod", 0.005, modes=2),), repeats=1))
    assert [r.case for r in results] == [case.name for case in cases()]
    for result in results:
        assert abs(result.error_percent) < 2.0
        assert result.real_time_factor > 1.0
    assert markdown(results).count("rod, 2 modes, 5 ms") == 3


def test_a_setting_becomes_a_scene():
    scene = scene_of(cases()[0], Setting("bullet", 0.001, segments=7))
    assert (scene.solver.twin, scene.solver.step_s, scene.solver.segments) == ("bullet", 0.001, 7)
    assert scene.world.ground == "none"


def test_four_milliseconds_roll_once_a_cycle():
    result = segment_twin_at_4_ms(repeats=1, duration_s=7.0)
    assert result.value == pytest.approx(1.0, abs=0.02)


def test_the_stamp_names_program_and_machine():
    assert stamp().startswith("softbot ")
    assert "pybullet" in stamp()


def test_the_command_prints_and_writes_the_table(monkeypatch, tmp_path, capsys):
    import sim.benchmark
    from softbot.cli.bench import bench
    from softbot.errors import InputError

    one = Result("a case", "a setting", 1.01, 1.0, 1.0, 7.0)
    monkeypatch.setattr(sim.benchmark, "run_benchmark", lambda settings, repeats: iter([one]))
    monkeypatch.setattr(sim.benchmark, "segment_twin_at_4_ms", lambda repeats: one)
    bench(twin="all", repeats=1, out=tmp_path / "twins.md", json=True)
    printed = json.loads(capsys.readouterr().out)
    assert [r["case"] for r in printed["results"]] == ["a case", "a case"]
    assert "| a case | a setting | 1.0100 | 1.0000 | +1.00 | 7.0 |" in (tmp_path / "twins.md").read_text()
    bench(twin="rod", repeats=1, out=None, json=False)
    assert "a setting" in capsys.readouterr().out
    with pytest.raises(InputError, match="choose one of"):
        bench(twin="mujoco", repeats=1, out=None, json=False)
    with pytest.raises(InputError, match="cannot be written"):
        bench(twin="rod", repeats=1, out=tmp_path / "no" / "x.md", json=False)
