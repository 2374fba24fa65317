"""How the rod twin's code is compiled, and when what was compiled on an earlier day is still good.

numba keeps compiled code on disk and looks only at the file of the function that Python calls, not at the files of what
that function calls in turn. So the one function that Python calls carries a stamp of all of them.
"""

from __future__ import annotations

from pathlib import Path

from softbot.kernel_compiler import part, unit
from softbot.kernel_stamp import kernel_stamp

# no nnan, ninf: the check for a finite state has to survive
FAST_MATH = {"reassoc", "contract", "arcp", "nsz"}

# for what is called from compiled code only
inner = part(_nrt=False, fastmath=FAST_MATH)

# the same, for what is compiled by itself
apart = unit(_nrt=False, fastmath=FAST_MATH)


def source_stamp() -> int:
    """Stamp of the rod twin's source files."""
    return kernel_stamp(*sorted(Path(__file__).parent.glob("rod_*.py")))
