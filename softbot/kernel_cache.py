"""numba's cache of compiled kernels, read without the compiler: a start takes two thirds of the time.

Before it loads a kernel from disk numba imports all that it can compile, from random numbers to typed dictionaries, and
`scipy.linalg` to see whether there is one. None of that is asked for before something is compiled, and the compiler
sees to it by itself.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any


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

from numba.core.caching import FunctionCache  # noqa: E402
from numba.core.runtime import rtsys  # noqa: E402


class KernelCache(FunctionCache):
    """A kernel's place in the cache."""

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """The kernel for arguments of these types, or None."""
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(signature, target_context)
