"""What a compiler can find out about the C reference: undefined behaviour while it runs, faults without running it.

Needs gcc; says so, and fails, where there is none.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from firmware_protocol.c_reference import compile_c, write_c_reference

pytestmark = pytest.mark.slow

GCC_IS_NEEDED = "gcc is needed for this: apt install gcc libc6-dev"
SANITIZERS = "-O1 -g -fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer"
MORE_WARNINGS = (
    *("-Wfloat-equal", "-Wswitch-enum", "-Wundef", "-Wcast-qual", "-Wcast-align", "-Wstrict-prototypes"),
    *("-Wmissing-prototypes", "-Wdouble-promotion", "-Wformat=2", "-Wvla", "-Wnull-dereference", "-Wduplicated-cond"),
    *("-Wlogical-op", "-Wjump-misses-init", "-Wredundant-decls", "-Wbad-function-cast"),
)


def gcc_file(name: str) -> str:
    assert shutil.which("gcc"), GCC_IS_NEEDED
    asked = ["gcc", f"-print-file-name={name}"]
    return subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()


def run_sanitized(arguments: list[str]) -> subprocess.CompletedProcess[str]:
    """Python with the sanitizers' runtimes loaded before it, as a library compiled with them demands."""
    environment = os.environ | {
        "CC": "gcc",
        "C_REFERENCE_OPTIONS": SANITIZERS,
        "LD_PRELOAD": f"{gcc_file('libasan.so')} {gcc_file('libubsan.so')}",
        "ASAN_OPTIONS": "detect_leaks=0",  # Python keeps memory until its end
        "UBSAN_OPTIONS": "print_stacktrace=1",
    }
    command = [sys.executable, *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_random_frames_and_events_meet_no_undefined_behaviour() -> None:
    here = Path(__file__).parent
    tests = [str(here / name) for name in ("test_c_codec.py", "test_c_board.py")]
    done = run_sanitized(["-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", *tests])
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


def test_the_sanitizers_are_at_work(tmp_path: Path) -> None:
    source = tmp_path / "wrong.c"
    source.write_text("int shift(int by);\nint shift(int by) { return 1 << by; }\n")
    library = compile_c([source], tmp_path / "wrong.so", (*SANITIZERS.split(), "-fPIC", "-shared"), ("gcc",))
    done = run_sanitized(["-c", f"import ctypes; ctypes.CDLL({str(library)!r}).shift(40)"])
    assert done.returncode != 0
    assert "shift exponent 40 is too large" in done.stderr


@pytest.mark.parametrize("optimised", ["-O0", "-O2"])
def test_static_analysis_finds_nothing(tmp_path: Path, optimised: str) -> None:
    assert shutil.which("gcc"), GCC_IS_NEEDED
    for path in write_c_reference(tmp_path):
        if path.suffix == ".c":
            options = ("-c", optimised, "-fanalyzer", *MORE_WARNINGS)
            compile_c([path], path.with_suffix(".o"), options, ("gcc",))
