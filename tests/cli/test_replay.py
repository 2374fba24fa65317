"""What `softbot replay` says of a recording."""

from __future__ import annotations

from controllers.interface import Detection
from softbot.cli.replay import in_words
from softbot.nodes.replay import Replay


def test_what_is_one_chambers_and_what_all_share_is_told_apart() -> None:
    found = (Detection(5.3, 2, "rupture", 0.98), Detection(6.0, -1, "supply_loss", 1.0))
    said = ({"t_s": 5.31, "chamber": 2, "kind": "rupture"}, {"t_s": 6.01, "chamber": -1, "kind": "supply_loss"})
    text = in_words(Replay(7.0, 100, 3, 20, 6.5, found, said))
    assert text.splitlines() == [
        "7.00 s, armed for 6.50 s: 20 samplings in 100 frames of the board; 3 refused",
        "found     5.30 s: chamber 2, rupture (98 %)",
        "found     6.00 s: the robot, supply loss (100 %)",
        "recorded  5.31 s: chamber 2, rupture",
        "recorded  6.01 s: the robot, supply loss",
    ]


def test_nothing_found_is_said() -> None:
    assert "found     nothing" in in_words(Replay(1.0, 10, 0, 2, 0.0, (), ()))
