"""A sequencer that does as it is told, a short scene for it, and gains that need no design."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers.interface import Command, Detection, Order, Recovery, SequencerOutput, SequencerState
from controllers.pressure_loop import PressureLoopGains
from sim.scene import Scene, scene_from
from softbot.sensing import Readings

GAINS = PressureLoopGains(proportional_1_s=18.0, integral_1_s2=16.0, sample_s=0.01, model_lag_s=0.03)


class ScriptedSequencer:
    """Test double: wants `setpoint_Pa` as long as it is ordered to move; finds and answers what `script` says.

    `script`: (time of the update [s], what it then raises or finds).
    """

    def __init__(self, setpoint_Pa: tuple[float, ...] = (40e3, 0.0, 0.0, 0.0), script: dict[float, Any] | None = None):
        self.setpoint_Pa = np.array(setpoint_Pa)
        self.script = dict(script or {})
        self.orders: list[tuple[float, Order]] = []
        self.armed_since_s: float | None = None
        self.readings: list[Readings] = []
        self._is_armed = False

    def order(self, order: Order, t_s: float) -> None:
        self.orders.append((t_s, order))

    def armed(self, is_armed: bool) -> None:
        self._is_armed = is_armed

    def update(self, t_s: float, readings: Readings) -> SequencerOutput:
        self.readings.append(readings)
        moving = bool(self.orders) and self.orders[-1][1].command is not Command.STOP
        if self._is_armed and self.armed_since_s is None:
            self.armed_since_s = t_s
        detections: tuple[Detection, ...] = ()
        recoveries: tuple[Recovery, ...] = ()
        for due_s in [due for due in self.script if due <= t_s + 1e-9]:
            what = self.script.pop(due_s)
            if isinstance(what, Exception):
                raise what
            if isinstance(what, Order):
                self.order(what, t_s)
                return SequencerOutput(np.zeros(4), SequencerState.DISARMED, False)
            chamber, kind = what
            detections += (Detection(t_s, chamber, kind, 0.9),)
            recoveries += (Recovery(t_s, "curvature_reversal"),)
        state = SequencerState.DISARMED
        if moving:
            state = SequencerState.ROLLING if self._is_armed else SequencerState.PRIMING
        return SequencerOutput(self.setpoint_Pa if moving else np.zeros(4), state, moving, detections, recoveries)


@pytest.fixture
def scripted() -> type[ScriptedSequencer]:
    """The scripted sequencer's class."""
    return ScriptedSequencer


@pytest.fixture
def gains() -> PressureLoopGains:
    """Gains near those that the design finds for the default robot."""
    return GAINS


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The tests' own cache folder: what the user's holds must not decide a test, nor tests fill it."""
    before = os.environ.get("XDG_CACHE_HOME")
    folder = tmp_path_factory.mktemp("cache")
    os.environ["XDG_CACHE_HOME"] = str(folder)
    yield folder
    if before is None:
        del os.environ["XDG_CACHE_HOME"]
    else:
        os.environ["XDG_CACHE_HOME"] = before


@pytest.fixture
def make_scene() -> Callable[..., Scene]:
    """A scene of the default robot that a sequencer drives, with `--set` assignments laid over it."""

    def make(*assignments: str) -> Scene:
        table = {
            "robot": "default",
            "drive": {"kind": "sequencer"},
            "sequencer": {"start_s": 0.1},
            "solver": {"twin": "bullet", "accuracy": "fast", "duration_s": 0.6, "segments": 4},
            "metrics": {"steady_after_s": 0.2},
        }
        return scene_from(table, "short.toml", Path(), assignments)

    return make
