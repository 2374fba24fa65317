"""The picture of a run."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softbot.errors import InputError
from softbot.report import write_still


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


def test_the_picture_shows_stripes_and_a_dead_chamber_black(runs: Any, tmp_path: Path) -> None:
    from softbot.report.tube_picture import CHAMBERS

    healthy = runs.write_run(tmp_path / "healthy")
    damaged = runs.write_run(tmp_path / "damaged", faults=[runs.RUPTURE], recoveries=[runs.REVERSAL])
    # A revolution is 2 s, so each of these poses turns another chamber to the camera.
    times_s = [4.5, 6.0, 7.5, 9.0]
    first = colours_of(write_still(healthy, tmp_path / "healthy.png", times_s))
    second = colours_of(write_still(damaged, tmp_path / "damaged.png", times_s))
    assert min(share_near(first, colour) for colour in CHAMBERS) > 0.005
    assert share_near(second, CHAMBERS[2]) < 0.2 * share_near(first, CHAMBERS[2])
    black_first, black_second = ((image.max(axis=2) < 0.45).mean() for image in (first, second))
    assert black_second > black_first + 0.005


@pytest.mark.parametrize(("ground", "stops_s"), [("plane", math.inf), ("plane", 0.0), ("none", 0.0)])
def test_the_picture_chooses_poses_for_itself(runs: Any, tmp_path: Path, ground: str, stops_s: float) -> None:
    run_dir = runs.write_run(
        tmp_path / "run", ground=ground, stops_s=stops_s, faults=[runs.RUPTURE], recoveries=[runs.REVERSAL]
    )
    image = colours_of(write_still(run_dir, tmp_path / "still.png"))
    assert image.shape[0] > 400
    assert image.shape[1] > 1000
    assert np.ptp(image) > 0.5


@pytest.mark.parametrize("times_s", [[], [-1.0], [3.0, 99.0], [math.nan]])
def test_the_picture_refuses_times_outside_the_recording(runs: Any, tmp_path: Path, times_s: list[float]) -> None:
    run_dir = runs.write_run(tmp_path / "run")
    with pytest.raises(InputError, match="between 0 s and 10 s"):
        write_still(run_dir, tmp_path / "still.png", times_s)


def test_a_picture_that_cannot_be_written_is_an_input_error(runs: Any, tmp_path: Path) -> None:
    run_dir = runs.write_run(tmp_path / "run")
    with pytest.raises(InputError, match="cannot be written"):
        write_still(run_dir, tmp_path / "no" / "such" / "still.png", [1.0])
