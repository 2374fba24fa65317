"""How the rod twin's code is compiled, and when what was compiled on an earlier day is still good.

numba keeps compiled code on disk and looks only at the file of the function that Python calls, not at the files of what
that function calls in turn. So the one function that Python calls carries a stamp of all of them.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from numba import njit

from softbot import kernel_compiler
from softbot.kernel_compiler import PartCompiler

# no nnan, ninf: the check for a finite state has to survive
FAST_MATH = {"reassoc", "contract", "arcp", "nsz"}

# for what is called from compiled code only
inner = njit(
    _nrt=False, fastmath=FAST_MATH, no_cpython_wrapper=True, no_cfunc_wrapper=True, pipeline_class=PartCompiler
)


def source_stamp() -> str:
    """Digest of the rod twin's source files."""
    digest = hashlib.sha256()
    for path in [Path(str(kernel_compiler.__file__)), *sorted(Path(__file__).parent.glob("rod_*.py"))]:
        digest.update(path.read_bytes())
    return digest.hexdigest()
