"""Runs of the reference campaign in which a valve that sticks open took its chamber over the limit once."""

from __future__ import annotations

from pathlib import Path

import pytest

from softbot.campaign.campaign import Draws, load_campaign
from softbot.nodes.direct import TRACE, DirectRun

CAMPAIGN = Path(__file__).parents[2] / "campaigns" / "reference.toml"
_FIRST_PRESSURE = TRACE.index("pressure_0_Pa")


@pytest.fixture(scope="module")
def stuck_open(tmp_path_factory):
    """`stuck_open(seed)`: the reference campaign of nothing else."""
    head, *cases = CAMPAIGN.read_text(encoding="utf-8").split("[[case]]")
    path = tmp_path_factory.mktemp("campaign") / "stuck_open.toml"
    path.write_text("[[case]]".join([head, *(case for case in cases if 'name = "stuck_open"' in case)]))

    def draws(seed: int) -> Draws:
        return load_campaign(path, (f"seed={seed}",))

    return draws


def stays_below(run):
    """Assert it of a run, and that its valve is named."""
    fault = run.scene.fault[0]
    assert fault.kind == "stuck_open"
    direct = DirectRun(run.scene, run.known)
    pressure_Pa = direct.advance(round((fault.t_s + 2.0) * 100)).trace[:, _FIRST_PRESSURE : _FIRST_PRESSURE + 4]
    assert pressure_Pa.max() < run.known.pneumatics.max_chamber_pressure_Pa
    assert (direct.detections()[-1].kind, direct.detections()[-1].chamber) == ("stuck_open", fault.chamber_number)


@pytest.mark.parametrize(
    ("seed", "number"),
    [
        (5, 227),  # nearly fully open at 92 kPa, on an inlet that is wider than believed: 1.05 of the limit
        (901, 903),  # the same at 96 kPa: 1.02
        (904, 910),  # the same, its valve hardly open before, which the board's relief waited for
        (5, 247),  # at the opening that it was told to have: called a kinked line, then a slow valve, for 0.6 s
        (901, 593),  # the same, at an opening between those that are tried at first: a slow valve for 0.8 s
    ],
)
def test_a_valve_that_sticks_open_takes_no_chamber_over_its_limit(stuck_open, seed, number):
    stays_below(stuck_open(seed).run(number))


def test_nor_does_one_that_sticks_fully_open_where_the_chamber_is_fullest_and_its_inlet_widest():
    """1.05 of the limit while the board relieved the manifold in its safe state only."""
    stays_below(load_campaign(CAMPAIGN, ("seed=2026",)).run(14595))
