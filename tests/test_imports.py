"""Imports point one way only, and `softbot --help` imports nothing heavy.

firmware_protocol       nothing of ours
softbot (the core)      the core
calib, sim, controllers themselves and the core
softbot.report          itself, the core, sim, calib
softbot.nodes           everything but softbot.campaign and softbot.cli
softbot.campaign        everything but softbot.cli
softbot.cli             everything
"""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("firmware_protocol", "softbot", "calib", "sim", "controllers")
HEAVY = ("numpy", "numba", "pybullet", "scipy", "matplotlib", "pyarrow", "pydantic", "control", "cantools", "can")

# house → houses that it may import besides itself
ALLOWED: dict[str, set[str]] = {
    "firmware_protocol": set(),
    "softbot": set(),
    "calib": {"softbot"},
    "sim": {"softbot"},
    "controllers": {"softbot"},
    "softbot.report": {"softbot", "sim", "calib"},
    "softbot.nodes": {"firmware_protocol", "softbot", "calib", "sim", "controllers", "softbot.report"},
    "softbot.campaign": {"firmware_protocol", "softbot", "sim", "controllers", "softbot.report", "softbot.nodes"},
    "softbot.cli": {
        "firmware_protocol",
        "softbot",
        "calib",
        "sim",
        "controllers",
        "softbot.report",
        "softbot.nodes",
        "softbot.campaign",
    },
}


def house_of(module: str) -> str | None:
    """The house that a module belongs to; None for what is not ours."""
    parts = module.split(".")
    if parts[0] not in PACKAGES:
        return None
    inner = ".".join(parts[:2])
    return inner if inner in ALLOWED else parts[0]


def imported(source: str, module: str) -> set[str]:
    """Every module that a source names in an import, wherever it stands; relative ones made absolute.

    `from softbot import nodes` names softbot.nodes too: a package's attribute may be a module.
    """
    package = module.rsplit(".", 1)[0]
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*above, *([node.module] if node.module else [])])
            found.add(base)
            found |= {f"{base}.{alias.name}" for alias in node.names}
    return found


def breaches(source: str, module: str) -> list[str]:
    """Imports of `module` that the arrows do not allow."""
    own = house_of(module)
    assert own is not None
    return sorted(
        f"{module} imports {target}"
        for target in imported(source, module)
        if (house := house_of(target)) is not None and house != own and house not in ALLOWED[own]
    )


def modules_of(package: str) -> dict[str, Path]:
    named = {}
    for path in sorted((ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        named[".".join(parts)] = path
    return named


@pytest.mark.parametrize("package", PACKAGES)
def test_every_module_imports_only_what_the_arrows_allow(package: str) -> None:
    modules = modules_of(package)
    assert modules, f"{package} has no modules"
    found = [breach for module, path in modules.items() for breach in breaches(path.read_text("utf-8"), module)]
    assert found == []


@pytest.mark.parametrize(
    ("module", "source", "expected"),
    [
        ("sim.plant", "from softbot.robot import Robot", []),
        ("sim.plant", "import sim.body, numpy", []),
        ("sim.plant", "def late():\n    from controllers import sequencer", ["controllers", "controllers.sequencer"]),
        ("sim.plant", "if TYPE_CHECKING:\n    import firmware_protocol.bus", ["firmware_protocol.bus"]),
        ("sim.plant", "from softbot import nodes", ["softbot.nodes"]),
        ("sim.plant", "import softbot.report.page", ["softbot.report.page"]),
        ("softbot.robot", "from . import cli", ["softbot.cli"]),
        ("softbot.robot", "from .material import MATERIALS", []),
        ("softbot.robot", "import sim", ["sim"]),
        ("softbot.report.page", "from ..nodes import run", ["softbot.nodes", "softbot.nodes.run"]),
        ("softbot.report.page", "from sim.telemetry import read_telemetry", []),
        ("softbot.nodes.run", "import sim.run, firmware_protocol.bus, controllers.sequencer", []),
        ("softbot.nodes.run", "from softbot.cli import main", ["softbot.cli", "softbot.cli.main"]),
        ("softbot.cli.run", "from softbot.nodes.run import run_scene", []),
        (
            "firmware_protocol.bus",
            "from softbot.errors import InputError",
            ["softbot.errors", "softbot.errors.InputEr"],
        ),
        ("controllers.sequencer", "import calib", ["calib"]),
    ],
)
def test_import_against_an_arrow_would_be_seen(module: str, source: str, expected: list[str]) -> None:
    found = breaches(source, module)
    assert len(found) == len(expected)
    for breach, target in zip(found, expected, strict=True):
        assert breach.startswith(f"{module} imports {target}")


HELP = """
import sys
from softbot.cli import main
sys.argv = ["softbot", "--help"]
try:
    main()
except SystemExit as stop:
    assert not stop.code, stop.code
print("IMPORTED", *sys.modules)
"""


def test_help_imports_nothing_heavy() -> None:
    done = subprocess.run([sys.executable, "-c", HELP], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    shown, _, names = done.stdout.rpartition("IMPORTED ")
    assert "demo" in shown
    assert sorted(set(names.split()) & set(HEAVY)) == []
