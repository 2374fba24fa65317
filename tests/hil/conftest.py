"""Hardware in the loop: the two nodes on a bus, in wall-clock time; the same tests on every kind of bus.

`virtual` joins threads of one process, `hub` a socket, `socketcan` is the kernel's vcan0. What they measure is the
machine as well as the program, so they want it for themselves: all carry the marker `vcan` and are run by
`make test-vcan`, inside `.ci/vcan.sh`, and by nothing else. Without vcan they fail; they are never skipped.
"""

from __future__ import annotations

import gc
import itertools
import multiprocessing
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from controllers.pressure_loop import PressureLoopGains
from sim.scene import Scene, load_scene
from softbot.nodes.deciding_board import DecidingBoard
from softbot.nodes.plant_node import board_limits

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
        if item.path.is_relative_to(Path(__file__).parent) and item.get_closest_marker("soak") is None:
            item.add_marker(pytest.mark.vcan)


@pytest.fixture(params=TRANSPORTS)
def transport(request: pytest.FixtureRequest) -> Transport:
    """Each kind of bus in turn."""
    return transport_named(request.param)


@pytest.fixture(scope="module", params=TRANSPORTS)
def shared_transport(request: pytest.FixtureRequest) -> Transport:
    """Each kind of bus in turn, for a run that several tests look at."""
    return transport_named(request.param)


@pytest.fixture(scope="module", params=list(DecidingBoard))
def deciding_board(request: pytest.FixtureRequest, damaged_scene: Callable[..., Scene]) -> DecidingBoard:
    """The board in Python and the board in C in turn; the latter compiled, before a bus is open."""
    request.param.rules(board_limits(damaged_scene().robot), 1)
    return request.param


class Beside:
    """Work done beside the test: in a forked process, or on the virtual bus, which ends there, in a thread.

    `result` waits for what it returned and raises what it raised. `stop` is handed to the work and set by the test.
    """

    def __init__(self, transport: Transport, work: Callable[[Any], Any]) -> None:
        forking = multiprocessing.get_context("fork")
        virtual = transport[0] == "virtual"
        self.stop = threading.Event() if virtual else forking.Event()
        self._receiver, sender = forking.Pipe(duplex=False)

        def run() -> None:
            try:
                sender.send((work(self.stop), None))
            except BaseException as error:
                sender.send((None, error))
            sender.close()

        self.worker: Any = threading.Thread(target=run) if virtual else forking.Process(target=run)
        gc.collect()
        gc.freeze()  # or the child's collector would touch, and thereby copy, all the memory that it shares
        self.worker.start()

    def result(self, wait_s: float = 30.0) -> Any:
        self.stop.set()
        assert self._receiver.poll(wait_s), "it did not end"
        value, error = self._receiver.recv()
        self._receiver.close()
        self.worker.join(wait_s)
        if error is not None:
            raise error
        return value


@pytest.fixture(scope="session")
def beside() -> type[Beside]:
    """Call it with a transport and the work to do."""
    return Beside


@pytest.fixture(scope="session")
def damaged_scene() -> Callable[..., Scene]:
    """The robot that loses a chamber, with `--set` assignments laid over it."""
    return lambda *assignments: load_scene(DAMAGED, assignments)


@pytest.fixture(scope="session")
def gains() -> PressureLoopGains:
    """Gains near those that the design finds for the default robot: designing takes seconds."""
    return GAINS
