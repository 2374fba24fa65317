"""`softbot materials` and `softbot predict`: what they list, draw, answer in JSON and refuse."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

NEW = 'name = "new"\nlength_m = 0.15\nradius_m = 0.012\nmaterial = "Dragon Skin 30"\n'


@pytest.fixture
def robot_file(tmp_path: Path) -> Path:
    path = tmp_path / "new.toml"
    path.write_text(NEW)
    return path


def test_silicones_are_listed_with_their_moduli_and_drawn(softbot: Any, tmp_path: Path) -> None:
    listed = softbot("materials")
    assert listed.exit_code == 0, listed.stderr
    assert "Dragon Skin 30" in listed.stdout
    assert "473.5" in listed.stdout
    result = softbot("materials", "--plot", tmp_path / "pictures", "--json")
    answer = json.loads(result.stdout)
    assert answer["silicones"][0]["name"] == "Ecoflex 00-30"
    assert len(answer["pictures"]) == 5
    assert all(Path(path).exists() for path in answer["pictures"])


def test_robot_of_a_silicone_is_predicted_with_a_band(softbot: Any, robot_file: Path, tmp_path: Path) -> None:
    result = softbot("predict", robot_file, "--max-pressure-kPa", 100, "--plot", tmp_path / "p.png", "--json")
    assert result.exit_code == 0, result.stderr
    answer = json.loads(result.stdout)
    assert answer["basis"] == "predicted from geometry and Dragon Skin 30"
    assert answer["pressure_kPa"][-1] == 100.0
    assert answer["bend_low_deg"][-1] < answer["bend_deg"][-1] < answer["bend_high_deg"][-1]
    assert (tmp_path / "p.png").exists()
    shown = softbot("predict", robot_file, "--chamber", 0, "--chamber", 2, "--set", 'material="Ecoflex 00-30"')
    assert "predicted from geometry and Ecoflex 00-30" in shown.stdout
    assert "bend high" in shown.stdout


def test_calibrated_robot_has_no_band(softbot: Any) -> None:
    answer = json.loads(softbot("predict", "default", "--json").stdout)
    assert "no band" in answer["basis"]
    assert "bend_low_deg" not in answer
    assert answer["full_circle_kPa"] is None


def test_prediction_says_where_the_arc_closes(softbot: Any) -> None:
    arguments = ("predict", "default", "--max-pressure-kPa", 95, "--set", "actuator.modulus_Pa=10000")
    answer = json.loads(softbot(*arguments, "--json").stdout)
    assert np.interp(answer["full_circle_kPa"], answer["pressure_kPa"], answer["bend_deg"]) == pytest.approx(
        360.0, 1e-3
    )
    assert answer["bend_deg"][-1] > 360.0
    assert (
        f"beyond {answer['full_circle_kPa']:.3g} kPa the arc is more than a full circle" in softbot(*arguments).stdout
    )


def test_prediction_of_a_robot_with_memory_says_so(softbot: Any) -> None:
    memory = "memory.creep={shares = [0.1], times_s = [2.0]}"
    answer = json.loads(softbot("predict", "default", "--set", memory, "--json").stdout)
    assert "through its memory" in answer["basis"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--chamber", 4), "name some of 0 to 3"),
        (("--max-pressure-kPa", 0), "give a pressure above zero"),
        (("--plot", "p.jpg"), "ends in .png, .svg or .pdf"),
        (("--plot", "no/where/p.png"), "cannot be written"),
        (("--set", "material=granite"), "is not in the library"),
    ],
)
def test_wrong_questions_are_refused(softbot: Any, robot_file: Path, arguments: tuple[Any, ...], says: str) -> None:
    result = softbot("predict", robot_file, *arguments)
    assert result.exit_code == 2
    assert says in result.stderr


@pytest.mark.parametrize("pressure_kPa", ["nan", "inf", "-1", "0"])
def test_a_largest_pressure_that_is_none_is_refused_by_its_option(softbot: Any, pressure_kPa: str) -> None:
    refused = softbot("predict", "default", "--max-pressure-kPa", pressure_kPa)
    assert refused.exit_code == 2
    assert f"--max-pressure-kPa {pressure_kPa}: give a pressure above zero" in refused.stderr
