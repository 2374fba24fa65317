"""How a run starts: what is imported for it, and what is said while the compiler works."""

from __future__ import annotations

import subprocess
import sys

import pytest
from numba import njit

from softbot.cli.compiling import told_of_compiling

# until the first step of a given curvature on the rod
START = """
import sys
from pathlib import Path
from softbot.cli.app import app
from sim.scene import scene_from
from softbot.cli.perform import prepare
robot = {"length_m": 0.15, "radius_m": 0.01, "mass_kg": 0.05, "bending_stiffness_N_m2": 4e-3}
drive = {"kind": "curvature", "curvature_1_m": 12.0}
prepare(scene_from({"robot": robot, "drive": drive}, "roll", Path()))
from softbot.nodes.run import run_scene
print("IMPORTED", *sys.modules)
"""
NOT_FOR_A_ROLL = {
    "matplotlib",
    "control",
    "pybullet",
    "can",
    "cantools",
    "fastcrc",
    "coverage",
    "scipy.linalg",
    "numba.np.arraymath",  # for compiling
    "pyarrow.dataset",
    "calib",
    "controllers",
    "firmware_protocol.board",
    "softbot.report.page",
}


def test_a_given_curvature_imports_only_what_it_needs() -> None:
    for _ in range(2):  # the first may compile
        done = subprocess.run([sys.executable, "-c", START], capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, done.stderr
    imported = set(done.stdout.rpartition("IMPORTED ")[2].split())
    assert "sim.rod" in imported
    assert sorted(imported & NOT_FOR_A_ROLL) == []


def test_the_compiler_is_announced_once_and_only_when_it_works(capsys: pytest.CaptureFixture[str]) -> None:
    @njit
    def twice(value):  # type: ignore[no-untyped-def]
        return value + value

    with told_of_compiling("preparing", "compiling"):
        assert twice(1) == 2
        assert twice(1.0) == 2.0
    assert capsys.readouterr().err.count("compiling") == 1
    with told_of_compiling("preparing", "compiling"):
        assert twice(2) == 4
    assert "compiling" not in capsys.readouterr().err
