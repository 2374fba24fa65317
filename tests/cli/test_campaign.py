"""`softbot campaign --compare` and `--replay` refuse by name what they cannot do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import softbot as softbot_package

SMOKE = Path(__file__).parents[2] / "campaigns" / "smoke.toml"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--compare", "0"), "--compare 0: the campaign has 60 runs"),
        (("--compare", "61"), "--compare 61: the campaign has 60 runs"),
        (("--compare", "1", "--twin", "segments"), "--twin segments: there are rod and bullet"),
        (("--replay", "60"), "--replay 60: the campaign has runs 0 to 59"),
        (("--replay", "1", "--compare", "1"), "--replay and --compare: give one of them"),
        (("--set", "name=../elsewhere"), "name = '../elsewhere': its folder in runs/ is called so"),
        (("--set", "name="), "name = '': its folder in runs/ is called so"),
        (("--set", "scene.solver.twin=bullet"), 'smoke.toml: scene.solver.twin = "bullet": a campaign runs "rod"'),
        (("--set", "case=[]"), "smoke.toml: case = []: input should be a list of 1 or more"),
        (("--set", "mismatch.x=1"), "smoke.toml: mismatch.x = 1: input should be {choose = […]}, {low = …, high"),
        (("--set", "mismatch.x={lo=1, high=2}"), "smoke.toml: mismatch.x.lo: unknown key; did you mean low?"),
        (("--set", "vary.x={low=nan, high=2}"), "smoke.toml: vary.x.low = nan: input should be a finite number (the"),
        (("--processes", "0"), "'--processes'"),
    ],
)
def test_runs_and_twins_that_are_not_there_are_refused(softbot: Any, arguments: tuple[str, ...], says: str) -> None:
    result = softbot("campaign", SMOKE, *arguments)
    assert result.exit_code == 2, result.stdout
    assert says in result.stderr


def test_an_interrupted_campaign_says_what_is_kept_and_how_to_go_on(
    softbot: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(draws: Any, folder: Path, *, told: Any, begun: Any, **_: Any) -> None:
        begun(5)
        told({"outcome": "done"})
        raise KeyboardInterrupt

    monkeypatch.setattr("softbot.campaign.execution.carry_out", interrupted)
    monkeypatch.setattr("softbot.nodes.direct.warm_up", lambda scene: None)
    result = softbot("campaign", SMOKE, "--out", tmp_path / "here")
    assert result.exit_code == 130
    assert f"6 of 60 runs are kept in {tmp_path / 'here'}; the same command makes the others" in result.stderr
    assert result.stderr.endswith("softbot: interrupted\n")


def test_a_campaign_that_is_refused_keeps_nothing(
    softbot: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("softbot.nodes.direct.warm_up", lambda scene: None)
    (tmp_path / "campaign.toml").write_text("runs = 1\n")
    result = softbot("campaign", SMOKE, "--out", tmp_path)
    assert result.exit_code == 2
    assert "kept" not in result.stderr


def test_a_replay_of_limits_without_room_leaves_no_folder(softbot: Any, tmp_path: Path) -> None:
    text = SMOKE.read_text().replace('robot = "default"', 'robot = "tight.toml"')
    own = (Path(softbot_package.__file__).parent / "data" / "default_robot.toml").read_text()
    (tmp_path / "tight.toml").write_text(f"{own}\n[pneumatics]\nmax_chamber_pressure_Pa = 100e3\n")
    (tmp_path / "tight_campaign.toml").write_text(text)
    result = softbot("campaign", tmp_path / "tight_campaign.toml", "--replay", "0", "--out", tmp_path / "here")
    assert result.exit_code == 2
    assert "pneumatics.max_chamber_pressure_Pa = 100000" in result.stderr
    assert not (tmp_path / "here").exists()
