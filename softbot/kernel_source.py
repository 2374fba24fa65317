"""What a compiled kernel is compiled from: a digest that changes with any of it.

numba keeps compiled code on disk and looks only at the file of the function that Python calls, not at what that
function calls in turn, nor at the constants of other files. Here all that a kernel names is followed: functions to
their code as it was imported and to what they name, constants to their values. A comment is nothing new.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Iterator
from enum import EnumMeta
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

OWN = frozenset({"softbot", "sim", "controllers", "calib", "firmware_protocol"})
"""Packages whose code is followed. Others change with their version, which numba looks at."""

_COMPILER = tuple(
    hashlib.sha256(Path(__file__).with_name(name).read_bytes()).hexdigest()
    for name in ("kernel_compiler.py", "kernel_cache.py", "kernel_source.py")
)


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _written(code: CodeType) -> str:
    """All of a function's code but where it stands in its file."""
    constants = [_written(one) if isinstance(one, CodeType) else _value(one) for one in code.co_consts[1:]]
    names = (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
    return f"{code.co_code.hex()} {names} {constants} {code.co_exceptiontable.hex()}"


def _value(constant: Any) -> str:
    if isinstance(constant, (set, frozenset)):
        return repr(sorted(map(repr, constant)))
    if isinstance(constant, np.ndarray):
        return f"{constant.dtype} {constant.shape} {constant.tobytes().hex()}"
    return repr(constant)


class _Source:
    """The code and the constants that a function reaches, by name."""

    def __init__(self, own: frozenset[str]) -> None:
        self._own = own
        self.found: dict[str, str] = {}

    def follow(self, name: str, thing: Any) -> None:
        """Take in what code names so."""
        if hasattr(thing, "targetoptions"):  # numba's dispatcher of a function
            options = {key: getattr(value, "__name__", _value(value)) for key, value in thing.targetoptions.items()}
            self.found[f"{name}, compiled"] = repr(sorted(options.items()))
            thing = thing.py_func
        thing = getattr(thing, "_defn", thing)  # numba's intrinsic
        if isinstance(thing, FunctionType):
            self._follow_function(thing)
        elif isinstance(thing, type):
            if self._is_own(thing.__module__):
                members = list(thing) if isinstance(thing, EnumMeta) else getattr(thing, "_fields", ())
                types = inspect.get_annotations(thing)
                self.found[f"{thing.__module__}.{thing.__qualname__}"] = f"{members} {types}"
        elif isinstance(thing, (tuple, list)):
            self.found[name] = f"{type(thing).__name__} of {len(thing)}"
            for place, one in enumerate(thing):
                self.follow(f"{name}[{place}]", one)
        elif isinstance(thing, (int, float, complex, str, bytes, set, frozenset, np.generic, np.dtype, np.ndarray)):
            self.found[name] = _value(thing)

    def _follow_function(self, function: FunctionType) -> None:
        name, code = f"{function.__module__}.{function.__qualname__}", function.__code__
        if not self._is_own(function.__module__) or (written := _written(code)) == self.found.get(name):
            return
        while name in self.found:  # made twice by one function
            name += "'"
        self.found[name] = written
        known, names = function.__globals__, set(_names(code))
        for one in sorted(names & known.keys()):
            thing = known[one]
            if not isinstance(thing, ModuleType):
                self.follow(f"{function.__module__}.{one}", thing)
            elif self._is_own(thing.__name__):
                for inner in sorted(names & vars(thing).keys()):
                    self.follow(f"{thing.__name__}.{inner}", vars(thing)[inner])
        for one, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
            self.follow(f"{name}.{one}", cell.cell_contents)
        self.follow(f"{name}, defaults", function.__defaults__)
        self.follow(f"{name}, compiled by", getattr(function, "compiled_by", ()))

    def _is_own(self, module: str) -> bool:
        return module.partition(".")[0] in self._own


def reached(function: FunctionType, own: frozenset[str] = OWN) -> dict[str, str]:
    """All that a function, before it is compiled, calls and the constants that it uses: by name, written out."""
    source = _Source(own)
    source.follow(function.__qualname__, function)
    return source.found


@cache
def source_digest(function: FunctionType, own: frozenset[str] = OWN) -> str:
    """Digest of that; own: packages whose code is followed besides the function's."""
    package = function.__module__.partition(".")[0]
    found = sorted(reached(function, own | {package}).items())
    return hashlib.sha256(repr((_COMPILER, found)).encode()).hexdigest()[:32]
