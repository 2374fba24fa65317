"""`softbot campaign --compare` and `--replay` refuse by name what they cannot do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

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
