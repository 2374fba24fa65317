"""How the rod twin's code is compiled."""

from __future__ import annotations

from softbot.kernel_compiler import part, unit

# no nnan, ninf: the check for a finite state has to survive
FAST_MATH = {"reassoc", "contract", "arcp", "nsz"}

# for what is called from compiled code only
inner = part(_nrt=False, fastmath=FAST_MATH)

# the same, for what is compiled by itself
apart = unit(_nrt=False, fastmath=FAST_MATH)
