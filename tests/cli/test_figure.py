"""`softbot figure`: lists, draws, answers in JSON, and refuses by name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def test_without_a_name_the_figures_are_listed(softbot: Any) -> None:
    listed = softbot("figure")
    assert listed.exit_code == 0
    assert "moments" in listed.stdout
    assert "curvature-contraction" in json.loads(softbot("figure", "--json").stdout)["figures"]


def test_figure_is_written_where_asked_and_its_numbers_are_one_json_object(softbot: Any, tmp_path: Path) -> None:
    result = softbot("figure", "moments", "--out", tmp_path / "m.png", "--set", "segments=[2]", "--json")
    assert result.exit_code == 0, result.stderr
    drawn = json.loads(result.stdout)
    assert (drawn["figure"], drawn["path"]) == ("moments", str(tmp_path / "m.png"))
    assert {dot["segments"] for dot in drawn["dots"]} == {2}
    assert (tmp_path / "m.png").exists()


def test_figure_goes_into_this_folder_under_its_name(softbot: Any, tmp_path: Path) -> None:
    result = softbot("figure", "moments")
    assert result.exit_code == 0, result.stderr
    assert "largest_difference: " in result.stdout
    assert "figure: moments.png" in result.stdout
    assert (tmp_path / "moments.png").exists()


def test_unknown_figures_and_folders_are_refused(softbot: Any, tmp_path: Path) -> None:
    unknown = softbot("figure", "portrait")
    assert unknown.exit_code == 2
    assert "'portrait' is no figure; there are:" in unknown.stderr
    assert "moments" in unknown.stderr
    folder = softbot("figure", "moments", "--out", tmp_path)
    assert folder.exit_code == 2
    assert "is a folder" in folder.stderr
    format_ = softbot("figure", "lock-map", "--out", tmp_path / "map.gif")  # at once, not after minutes of drawing
    assert format_.exit_code == 2
    assert "map.gif: the name ends in .png, .svg, .pdf" in format_.stderr
