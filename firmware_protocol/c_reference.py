"""The portable C11 reference as a folder of files, and as a shared library for tests and for `softbot plant`.

    python -m firmware_protocol.c_reference FOLDER

writes the whole folder: the sources of `firmware_protocol/c`, and those that `c_codec` makes from the DBC.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

from firmware_protocol.c_codec import c_codec
from firmware_protocol.c_parameter_table import c_parameter_table
from firmware_protocol.errors import CompilerError
from firmware_protocol.spec import spec

STRICT = ("-std=c11", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror", "-pedantic")
"""How the reference is always built."""

_COMPILERS = ("cc", "gcc", "clang")


def write_c_reference(folder: Path) -> list[Path]:
    """Writes all files of the reference into `folder`, which is made if need be; returns them in order of name.

    Raises CompilerError when the folder cannot be written.
    """
    texts = c_codec(spec()) | c_parameter_table()
    for source in (resources.files("firmware_protocol") / "c").iterdir():
        if source.name.endswith((".c", ".h")):
            texts[source.name] = source.read_text(encoding="utf-8")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise CompilerError(f"{folder}: the C reference cannot be written there ({error.strerror})") from None
    return [folder / name for name in sorted(texts)]


def c_compiler() -> tuple[str, ...]:
    """The command of a C compiler: $CC, else cc, gcc or clang, else the one of the PyPI package ziglang.

    Raises CompilerError when there is none.
    """
    wanted = os.environ.get("CC", "").split()
    if wanted:
        if shutil.which(wanted[0]) is None:
            raise CompilerError(f"CC = {' '.join(wanted)}: there is no such command; unset CC, or name a C compiler")
        return tuple(wanted)
    for name in _COMPILERS:
        if shutil.which(name) is not None:
            return (name,)
    if importlib.util.find_spec("ziglang") is not None:
        return (sys.executable, "-m", "ziglang", "cc")
    raise CompilerError(
        "no C compiler is here (cc, gcc, clang), and the C reference has to be compiled: "
        f"apt install gcc libc6-dev, or {Path(sys.executable).name} -m pip install ziglang"
    )


def compile_c(
    sources: Sequence[Path], output: Path, options: Sequence[str] = (), compiler: Sequence[str] | None = None
) -> Path:
    """Compiles `sources` into the shared library or, with `-c` among the `options`, object `output`; returns it.

    With the warnings of STRICT as errors. Raises CompilerError with what the compiler said.
    """
    command = [*(compiler or c_compiler()), *STRICT, *options, "-o", str(output), *map(str, sources)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise CompilerError(f"the C reference did not compile ({' '.join(command[:3])} …):\n{done.stderr.strip()}")
    return output


def compile_c_reference(
    folder: Path,
    options: Sequence[str] = ("-O2",),
    more_sources: Sequence[Path] = (),
    compiler: Sequence[str] | None = None,
) -> Path:
    """Writes the reference into `folder`, compiles it there with its host side, and returns the shared library.

    The host side, `c/host`, is what a process on this machine calls; `more_sources` are compiled with it.
    """
    sources = [path for path in write_c_reference(folder) if path.suffix == ".c"]
    host = resources.files("firmware_protocol") / "c" / "host" / "softbot_host.c"
    (folder / host.name).write_text(host.read_text(encoding="utf-8"), encoding="utf-8")
    sources += [folder / host.name, *more_sources]
    return compile_c(sources, folder / "softbot.so", (*options, "-fPIC", "-shared", f"-I{folder}"), compiler)


def load_c_reference() -> ctypes.CDLL:
    """The reference compiled for this machine and loaded. Raises CompilerError."""
    with tempfile.TemporaryDirectory(prefix="softbot-c-") as folder:
        return ctypes.CDLL(str(compile_c_reference(Path(folder))))  # stays mapped when its file is gone


def main(arguments: Sequence[str]) -> int:
    """Writes the folder named in `arguments`; returns the exit status."""
    if len(arguments) != 1:
        print("usage: python -m firmware_protocol.c_reference FOLDER", file=sys.stderr)
        return 2
    try:
        written = write_c_reference(Path(arguments[0]))
    except CompilerError as error:
        print(f"softbot: {error}", file=sys.stderr)
        return 2
    print(f"{arguments[0]}: {', '.join(path.name for path in written)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
