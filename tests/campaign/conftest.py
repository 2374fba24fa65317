"""A short campaign of a robot that is small enough to be quick, and gains that need no design."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from softbot.campaign.campaign import Draws, load_campaign
from softbot.toml_file import write_toml


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What the user's cache folder holds must not decide a test, nor tests fill it."""
    before = os.environ.get("XDG_CACHE_HOME")
    os.environ["XDG_CACHE_HOME"] = str(tmp_path_factory.mktemp("cache"))
    yield
    if before is None:
        del os.environ["XDG_CACHE_HOME"]
    else:
        os.environ["XDG_CACHE_HOME"] = before


def campaign_table(**changes: Any) -> dict[str, Any]:
    """Tables of a campaign: two seconds, healthy or ruptured, on robots 20 % off what the controller believes."""
    return {
        "name": "short",
        "runs": 8,
        "seed": 3,
        "scene": {
            "robot": "default",
            "drive": {"kind": "sequencer"},
            "sequencer": {"start_s": 0.1},
            "solver": {"accuracy": "fast", "duration_s": 2.0},
            "metrics": {"steady_after_s": 0.5},
        },
        "vary": {"sequencer.command": {"choose": ["left", "right"]}, "world.friction": {"low": 0.4, "high": 0.9}},
        "mismatch": {
            "robot.actuator.modulus_Pa": {"low": 0.8, "high": 1.2},
            "robot.pneumatics.supply_valve_conductance_m3_s_Pa": {"low": 0.8, "high": 1.2},
        },
        "case": [
            {"name": "healthy"},
            {
                "name": "rupture",
                "weight": 3.0,
                "fault": [{"kind": "rupture", "chamber": {"choose": [0, 1, 2, 3]}, "t_s": {"low": 0.8, "high": 1.2}}],
            },
        ],
    } | changes


@pytest.fixture
def make_draws(tmp_path: Path) -> Callable[..., Draws]:
    """`make_draws(**tables that differ)`: the short campaign, read from a file."""

    def make(*assignments: str, **changes: Any) -> Draws:
        path = tmp_path / "short.toml"
        write_toml(path, campaign_table(**changes))
        return load_campaign(path, assignments)

    return make
