"""Runs of a campaign over a real vcan: the sequencer's verdicts are the campaign's."""

from __future__ import annotations

from pathlib import Path

from softbot.campaign.campaign import load_campaign
from softbot.campaign.comparison import compare

SMOKE = Path(__file__).parents[2] / "campaigns" / "smoke.toml"
RUNS = 3


def test_over_vcan_the_verdicts_are_the_campaigns() -> None:
    assert Path("/sys/class/net/vcan0").exists(), "no vcan0 here: run this with `make test-vcan-timing`"
    found = compare(load_campaign(SMOKE), range(RUNS), transport=("socketcan", "vcan0"))
    assert [one for one in found if not one.same] == []
    assert any(one.campaign.named for one in found)
