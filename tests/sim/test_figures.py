"""The figures: found by their files, drawn from nothing, and true in the numbers that they return."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from sim.figures import draw, figures
from softbot.errors import InputError

PNG = b"\x89PNG"


def test_every_figure_is_named_after_its_module_and_says_what_it_shows() -> None:
    known = figures()
    assert {"moments", "curvature-contraction"} <= set(known)
    assert all(line.endswith(".") for line in known.values())


def test_moments_are_drawn_with_dots_on_the_lines(tmp_path: Path) -> None:
    drawn = draw("moments", tmp_path / "m.png", {"half_bend_rad": 1, "segments": [1, 4], "half_bends_rad": [0.5]})
    assert (tmp_path / "m.png").read_bytes().startswith(PNG)
    assert {dot["segments"] for dot in drawn["dots"]} == {1, 4}
    assert drawn["largest_difference"] < 1e-12
    strongest = max(abs(dot["rolling_summed"]) for dot in drawn["dots"] if dot["half_bend_rad"] == 1)
    assert strongest == pytest.approx(8.0 * math.sin(0.25))  # N = 4 at θ = 90°


def test_curvature_is_drawn_to_the_kink_with_the_rod_at_rest_on_the_line(tmp_path: Path) -> None:
    drawn = draw("curvature-contraction", tmp_path / "c.png", {"scaled_pressures": [1, 3.3]})
    assert (tmp_path / "c.png").read_bytes().startswith(PNG)
    assert [one["kink"][1] for one in drawn["pressures"]] == pytest.approx([math.sqrt(8 / 9), 1.7127], abs=1e-4)
    assert all(len(one["crosses"]) == 8 for one in drawn["pressures"])
    assert drawn["largest_relative_difference"] < 1e-4
    alone = draw("curvature-contraction", tmp_path / "alone.png", {"twin": False})
    assert alone["largest_relative_difference"] is None


@pytest.mark.parametrize(
    ("name", "file", "options", "says"),
    [
        ("nothing", "m.png", {}, "'nothing' is no figure; there are:\n"),
        ("_canvas", "m.png", {}, "is no figure"),
        ("moments", "m.gif", {}, r"a picture ends in \.png"),
        ("moments", "nowhere/m.png", {}, "cannot be written"),
        ("moments", "m.png", {"colour": 1}, "colour: no option of the figure moments; it has half_bend_rad"),
        ("moments", "m.png", {"half_bend_rad": "wide"}, "half_bend_rad = 'wide': must be of the kind of 0.9"),
        ("moments", "m.png", {"half_bend_rad": True}, "half_bend_rad = True"),
        ("moments", "m.png", {"half_bend_rad": 4.0}, "half bend 4 rad"),
        ("moments", "m.png", {"segments": 3}, "segments = 3: must be a list such as"),
        ("moments", "m.png", {"segments": []}, "must be a list"),
        ("moments", "m.png", {"segments": [1.5]}, "segments = 1.5: must be of the kind of 1"),
        ("moments", "m.png", {"segments": [0]}, "segments must be a whole number"),
        ("curvature-contraction", "m.png", {"scaled_pressures": [1.0, -1.0]}, "scaled pressure must be above zero"),
        ("curvature-contraction", "m.png", {"scaled_pressures": [1.0] * 7}, "at most 6"),
        ("curvature-contraction", "m.png", {"poisson_ratio": 0.7, "twin": False}, "poisson_ratio"),
        ("moments", "m.png", {"segments": [1, 2, 3, 4, 5, 6, 7]}, "at most 6 curves"),
    ],
)
def test_wrong_figure_option_or_place_is_refused(
    tmp_path: Path, name: str, file: str, options: dict[str, object], says: str
) -> None:
    with pytest.raises(InputError, match=says):
        draw(name, tmp_path / file, options)


def test_the_rod_has_the_larger_margin_of_the_step(tmp_path: Path) -> None:
    few = {"stiffnesses": 2, "lowest_N_m2": 4e-3, "highest_N_m2": 0.04, "duration_s": 0.5, "shortest_step_s": 4e-3}
    drawn = draw("step-margin", tmp_path / "s.png", few)
    assert (tmp_path / "s.png").read_bytes().startswith(PNG)
    assert drawn["rod_largest_step_s"] == [drawn["largest_step_tried_s"]] * 2
    for rod_s, bullet_s in zip(drawn["rod_largest_step_s"], drawn["bullet_largest_step_s"], strict=True):
        assert bullet_s is None or bullet_s <= rod_s


def test_a_margin_over_one_stiffness_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at least 2"):
        draw("step-margin", tmp_path / "s.png", {"stiffnesses": 1})
