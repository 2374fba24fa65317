"""Compiled kernels that are handed other compiled kernels as arguments.

numba builds a kernel that calls another one together with all of that one's code, over and over for every caller. A
kernel that takes the other as an argument of a function type is built alone, in a second rather than in a minute.

This is a simulation module: it imports numba.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numba
from numba.core import types


class Handed(NamedTuple):
    """A compiled kernel as an argument of another, for the types of the arguments that it will be called with."""

    kernel: Any
    type: types.FunctionType


def handed(kernel: Any, *arguments: Any) -> Handed:
    """`kernel`, compiled for arguments of the types of these, to be handed to another kernel."""
    return Handed(kernel, types.FunctionType(_compiled(kernel, arguments).signature))


def entry(kernel: Any, *arguments: Any) -> Callable[..., Any]:
    """The way into `kernel` for arguments of the types of these, `Handed` ones among them.

    It checks no types when it is called, and takes plain kernels where there were `Handed` ones.
    """
    point: Callable[..., Any] = _compiled(kernel, arguments).entry_point
    return point


def _compiled(kernel: Any, arguments: tuple[Any, ...]) -> Any:
    signature = tuple(one.type if isinstance(one, Handed) else numba.typeof(one) for one in arguments)
    if signature not in kernel.overloads:
        kernel.compile(signature)
    return kernel.overloads[signature]
