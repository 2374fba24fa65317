"""What the benchmark asks of an engine, and the engines it knows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from sim.benchmark.case import Case, RunScene
from sim.benchmark.play import Measured


class Setting(Protocol):
    """How finely an engine solves a case."""

    @property
    def label(self) -> str:
        """For a table."""


class Engine(Protocol):
    """An engine. Its methods raise `sim.benchmark.play.Unable` for what it cannot do, with the reason."""

    name: str

    def version(self) -> str:
        """Name and version of what computes."""

    def settings(self, case: Case) -> Sequence[Any]:
        """Settings that are worth measuring on a case, the most typical one first."""

    def warm_up(self, case: Case, setting: Any, run: RunScene) -> None:
        """Whatever is done once only: compiling, caches."""

    def measure(self, case: Case, setting: Any, run: RunScene) -> Measured:
        """One run from the start; the wall time is that of the solver alone."""


def engines() -> tuple[Engine, ...]:
    """All engines, in the order in which they are reported."""
    from sim.benchmark.bullet_engine import BulletEngine
    from sim.benchmark.elastica_rod import ElasticaRod
    from sim.benchmark.mujoco_chain import MujocoChain
    from sim.benchmark.rod_engine import RodEngine

    return (RodEngine(), BulletEngine(), MujocoChain(), ElasticaRod())
