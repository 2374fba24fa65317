"""Digests of source files, for compiled kernels that call others.

numba keeps compiled code on disk and looks only at the file of the function that Python calls, not at the files of what
that function calls in turn. A kernel made by a function that takes such a digest, and uses it, is compiled anew when
any of those files has changed.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from types import ModuleType

_COMPILER = Path(__file__).with_name("kernel_compiler.py")


def kernel_stamp(*sources: ModuleType | str | Path) -> int:
    """Digest of the source files of modules, or of files, and of the compiler's own, as a positive number."""
    digest = hashlib.sha256()
    for source in (_COMPILER, *sources):
        path = Path(str(source.__file__)) if isinstance(source, ModuleType) else Path(source)
        digest.update(path.read_bytes())
    return (int.from_bytes(digest.digest()[:8], "big") >> 2) + 1
