"""The folder that a firmware team takes, and the ways to a compiler."""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path

import pytest

from firmware_protocol import c_reference
from firmware_protocol.c_reference import c_compiler, compile_c, load_c_reference, main, write_c_reference
from firmware_protocol.errors import CompilerError

FREESTANDING = {"<stdint.h>", "<stdbool.h>", "<stddef.h>", "<string.h>", "<float.h>"}


def test_the_folder_holds_all_that_its_files_include_and_only_freestanding_headers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(tmp_path / "deep" / "reference")]) == 0
    files = {path.name: path.read_text() for path in (tmp_path / "deep" / "reference").iterdir()}
    assert {"softbot_messages.c", "softbot_e2e.h"} < set(files)
    assert "softbot_messages.c" in capsys.readouterr().out
    for name, text in files.items():
        included = {line.split()[1] for line in text.splitlines() if line.startswith("#include")}
        own = {each.strip('"') for each in included if each.startswith('"')}
        assert own <= set(files), name
        assert {each for each in included if each.startswith("<")} <= FREESTANDING, name


def test_nothing_but_the_scaling_uses_floating_point_and_nothing_uses_the_heap(tmp_path: Path) -> None:
    for path in write_c_reference(tmp_path):
        words = set(path.read_text().replace("(", " ").replace("*", " ").split())
        assert not words & {"malloc", "calloc", "realloc", "free", "goto", "setjmp"}, path.name
        if not path.name.startswith("softbot_physical"):
            assert not words & {"double", "float"}, path.name


def test_each_file_compiles_for_a_machine_without_an_operating_system(tmp_path: Path) -> None:
    for path in write_c_reference(tmp_path):
        if path.suffix == ".c":
            compile_c([path], path.with_suffix(".o"), ("-c", "-ffreestanding", "-O2"))


def test_the_example_of_the_documentation_compiles_as_it_stands(tmp_path: Path) -> None:
    page = (Path(__file__).parents[3] / "docs" / "firmware.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```c\n(.*?)```", page, flags=re.DOTALL)
    write_c_reference(tmp_path)
    (tmp_path / "example.c").write_text(example, encoding="utf-8")
    compile_c([tmp_path / "example.c"], tmp_path / "example.o", ("-c", "-ffreestanding", "-O2"))


def test_the_same_dbc_gives_the_same_folder(tmp_path: Path) -> None:
    first, second = write_c_reference(tmp_path / "a"), write_c_reference(tmp_path / "b")
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]


def test_a_folder_that_cannot_be_written_is_told_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "taken").write_text("a file")
    assert main([str(tmp_path / "taken")]) == 2
    assert "taken: the C reference cannot be written there" in capsys.readouterr().err
    assert main([]) == 2
    assert "usage" in capsys.readouterr().err


def test_the_module_runs_as_a_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["c_reference", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(c_reference.__file__), run_name="__main__")
    assert ended.value.code == 0
    assert (tmp_path / "out" / "softbot_messages.h").exists()


def test_a_warning_is_an_error_that_tells_what_the_compiler_said(tmp_path: Path) -> None:
    source = tmp_path / "narrow.c"
    source.write_text("#include <stdint.h>\nuint8_t low(uint32_t x);\nuint8_t low(uint32_t x) { return x; }\n")
    with pytest.raises(CompilerError, match=r"did not compile(.|\n)*conversion"):
        compile_c([source], tmp_path / "narrow.o", ("-c",))


def test_the_library_loads_after_its_folder_is_gone() -> None:
    assert load_c_reference().softbot_frame_accepted(2) & 1


# ---------------------------------------------------------------------- which compiler


def only_on_path(monkeypatch: pytest.MonkeyPatch, folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).write_text("#!/bin/sh\n")
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.delenv("CC", raising=False)


def test_a_compiler_is_found_by_its_usual_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    only_on_path(monkeypatch, tmp_path, "clang")
    assert c_compiler() == ("clang",)
    only_on_path(monkeypatch, tmp_path, "gcc")
    assert c_compiler() == ("gcc",)
    only_on_path(monkeypatch, tmp_path, "cc")
    assert c_compiler() == ("cc",)


def test_the_environment_may_name_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    only_on_path(monkeypatch, tmp_path, "gcc", "mycc")
    monkeypatch.setenv("CC", "mycc -m32")
    assert c_compiler() == ("mycc", "-m32")
    monkeypatch.setenv("CC", "nowhere")
    with pytest.raises(CompilerError, match="CC = nowhere: there is no such command"):
        c_compiler()


def test_without_one_ziglang_is_taken_and_without_that_the_message_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    only_on_path(monkeypatch, tmp_path)
    monkeypatch.setattr(c_reference.importlib.util, "find_spec", lambda name: object())
    assert c_compiler() == (sys.executable, "-m", "ziglang", "cc")
    monkeypatch.setattr(c_reference.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(CompilerError, match="apt install gcc libc6-dev"):
        c_compiler()
