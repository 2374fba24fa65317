"""What several tests need: one robot, one scene, an interpreter in place of the compiler."""

from __future__ import annotations

import os
from collections.abc import Callable
from types import ModuleType
from typing import Any

import hypothesis
import pytest
from numba.core.registry import CPUDispatcher

# Timing of one example says nothing on a shared machine; a gate must not change its mind from run to run.
hypothesis.settings.register_profile(
    "softbot",
    deadline=None,
    derandomize="CI" in os.environ,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],  # a busy machine is no fault of the test
)
hypothesis.settings.load_profile("softbot")


@pytest.fixture
def interpreted(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Call it with modules: until the end of the test their compiled kernels run as plain Python.

    A kernel that only means something compiled is one that no one can step through; and only so are its lines counted.
    """

    def switch(*modules: ModuleType) -> None:
        kernels = [
            (module, name, value)
            for module in modules
            for name, value in vars(module).items()
            if isinstance(value, CPUDispatcher)
        ]
        assert kernels, "these modules hold no compiled kernel"
        for module, name, value in kernels:
            monkeypatch.setattr(module, name, value.py_func)

    return switch


@pytest.fixture
def robot_table() -> dict[str, Any]:
    """The mechanical test robot of the scenes."""
    return {
        "length_m": 0.15,
        "radius_m": 0.01,
        "mass_kg": 0.0518,
        "bending_stiffness_N_m2": 3.93e-3,
        "damping_time_s": 0.02,
    }


@pytest.fixture
def scene_table(robot_table: dict[str, Any]) -> dict[str, Any]:
    """A short scene of given curvature on a floor, in the segment twin, coarse."""
    return {
        "robot": robot_table,
        "drive": {"kind": "curvature", "curvature_1_m": 12.0, "period_s": 1.0, "start_s": 0.2, "ramp_s": 0.2},
        "world": {"ground": "plane", "friction": 0.6},
        "solver": {"twin": "bullet", "accuracy": "fast", "duration_s": 0.5},
    }
