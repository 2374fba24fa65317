"""The process that compiles the controller beside this one."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest

from sim.scene import Scene, scene_from
from softbot.kernel_compiler import kernel
from softbot.nodes import compiling_aside
from softbot.nodes.compiling_aside import SEQUENCER, compiled_aside

# says the scene's name in a file, then does what the test asks of it
CHILD = """
import pickle, sys, time, pathlib
scene = pickle.load(sys.stdin.buffer)
pathlib.Path({!r}).write_text(scene.name)
{}
"""


@pytest.fixture
def scene() -> Scene:
    return scene_from({"robot": "default", "drive": {"kind": "sequencer"}}, "aside", Path())


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    processes: list[Any] = []

    class Watched(subprocess.Popen):  # type: ignore[type-arg]
        def __init__(self, *arguments: Any, **keywords: Any) -> None:
            super().__init__(*arguments, **keywords)
            processes.append(self)

    monkeypatch.setattr(compiling_aside.subprocess, "Popen", Watched)
    return processes


def compile_something() -> int:
    @kernel(cache=False)
    def twice(value: int) -> int:
        return value + value

    return int(twice(2))


def test_nothing_is_started_where_nothing_is_compiled(scene: Scene, started: list[Any]) -> None:
    with compiled_aside(scene, SEQUENCER):
        pass
    assert started == []


def test_one_process_is_given_the_scene_and_waited_for(
    scene: Scene, started: list[Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(compiling_aside, "_CHILD", CHILD.format(str(tmp_path / "name"), "time.sleep(0.2)"))
    with compiled_aside(scene, SEQUENCER):
        assert compile_something() == 4
        assert compile_something() == 4
    assert [process.poll() for process in started] == [0]
    assert (tmp_path / "name").read_text() == "aside"


def test_one_that_fails_is_no_matter(
    scene: Scene, started: list[Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(compiling_aside, "_CHILD", "import sys; sys.exit(3)")
    with compiled_aside(scene, SEQUENCER):
        assert compile_something() == 4
    assert [process.poll() for process in started] == [3]


def test_it_ends_with_an_error_here(
    scene: Scene, started: list[Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(compiling_aside, "_CHILD", CHILD.format(str(tmp_path / "name"), "time.sleep(600)"))

    def interrupted() -> None:
        with compiled_aside(scene, SEQUENCER):
            compile_something()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert started[0].poll() is not None
