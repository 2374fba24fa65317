"""numba's cache of compiled kernels: read without the compiler, and never older than what it was compiled from.

Before it loads a kernel from disk numba imports all that it can compile, from random numbers to typed dictionaries, and
`scipy.linalg` to see whether there is one. None of that is asked for before something is compiled, and the compiler
sees to it by itself.

A kernel may call *units* (`softbot.kernel_compiler`), whose code is not its own. They are kept by themselves, and
loaded before it.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
from collections.abc import Iterator
from typing import Any, NamedTuple

from softbot.kernel_source import source_digest


@contextlib.contextmanager
def _without_coverage() -> Iterator[None]:
    """A developers' tool, which numba imports in case its compiler is to be measured with it."""
    if "coverage" in sys.modules or os.environ.get("NUMBA_JIT_COVERAGE"):
        yield
        return
    sys.modules["coverage"] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules["coverage"]


with _without_coverage():
    import numba  # noqa: F401

from numba.core.caching import CompileResultCacheImpl, FunctionCache  # noqa: E402
from numba.core.compiler import CompileResult  # noqa: E402
from numba.core.runtime import rtsys  # noqa: E402


class Unit(NamedTuple):
    """Where a unit is to be found."""

    module: str
    name: str
    arguments: tuple[Any, ...]
    """numba's types."""

    def made(self) -> Any:
        """What it is compiled to, here, elsewhere or on an earlier day."""
        return getattr(importlib.import_module(self.module), self.name).made(self.arguments)


def units_of(library: Any) -> set[Unit]:
    """The units that code calls."""
    found: set[Unit] = set()
    for other in library._linking_libraries:
        unit = getattr(other, "unit", None)
        found |= units_of(other) if unit is None else {unit}
    return found


class _KernelCacheImpl(CompileResultCacheImpl):
    """What is written of a kernel, and how it becomes one again."""

    def reduce(self, result: Any) -> Any:
        library, module = result.library, result.library._final_module
        all_symbols = (*module.functions, *module.global_variables)
        defined = [str(one.name) for one in all_symbols if not one.is_declaration]
        state = list(super().reduce(result))
        state[6] = ""  # types written out for people to read
        called = {unit: unit.made().fndesc.mangled_name for unit in units_of(library)}
        return defined, called, getattr(library, "unit", None), state

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        defined, called, own, state = payload
        made = {unit: unit.made() for unit in called}  # before the code that calls them
        if any(made[unit].fndesc.mangled_name != symbol for unit, symbol in called.items()):
            return None
        target_context.codegen()._engine._defined_symbols.update(defined)
        result = CompileResult._rebuild(target_context, *state)
        result.library.unit = own
        result.library._linking_libraries.extend(one.library for one in made.values())
        return result


class KernelCache(FunctionCache):
    """A kernel's place in the cache."""

    _impl_class = _KernelCacheImpl

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """The kernel for arguments of these types, or None."""
        rtsys.initialize(target_context)
        self._cache_file._source_stamp = source_digest(self._py_func)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(signature, target_context)

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep the kernel for arguments of these types."""
        self._cache_file._source_stamp = source_digest(self._py_func)
        super().save_overload(signature, result)
