"""Hardware in the loop: the two nodes on a bus, in wall-clock time; the same tests on every kind of bus.

`virtual` joins threads of one process, `hub` a socket, `socketcan` is the kernel's vcan0. What they measure is the
machine as well as the program, so they want it for themselves: all carry the marker `vcan` and are run by
`make test-vcan`, inside `.ci/vcan.sh`, and by nothing else. Without vcan they fail; they are never skipped.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import pytest

from controllers.pressure_loop import PressureLoopGains
from sim.scene import Scene, load_scene

GAINS = PressureLoopGains(proportional_1_s=18.0, integral_1_s2=16.0, sample_s=0.01, model_lag_s=0.03)
DAMAGED = Path(__file__).parents[2] / "scenes" / "damaged.toml"

_numbers = itertools.count()


Transport = tuple[str, str]
"""python-can's interface and channel."""


def transport_named(interface: str) -> Transport:
    """The bus of a kind of bus, unheard by other tests."""
    if interface == "socketcan":
        assert Path("/sys/class/net/vcan0").exists(), "no vcan0 here: run these tests with `make test-vcan`"
        return (interface, "vcan0")
    return (interface, f"hil-{next(_numbers)}")


TRANSPORTS = ["virtual", "hub", "socketcan"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.is_relative_to(Path(__file__).parent):
            item.add_marker(pytest.mark.vcan)


@pytest.fixture(params=TRANSPORTS)
def transport(request: pytest.FixtureRequest) -> Transport:
    """Each kind of bus in turn."""
    return transport_named(request.param)


@pytest.fixture(scope="module", params=TRANSPORTS)
def shared_transport(request: pytest.FixtureRequest) -> Transport:
    """Each kind of bus in turn, for a run that several tests look at."""
    return transport_named(request.param)


@pytest.fixture(scope="session")
def damaged_scene() -> Callable[..., Scene]:
    """The robot that loses a chamber, with `--set` assignments laid over it."""
    return lambda *assignments: load_scene(DAMAGED, assignments)


@pytest.fixture(scope="session")
def gains() -> PressureLoopGains:
    """Gains near those that the design finds for the default robot: designing takes seconds."""
    return GAINS
