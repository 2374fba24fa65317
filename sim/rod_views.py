"""Other shapes of arrays without gaps, as compiled code takes them: the same numbers, no call and no count of owners.

`reshape` of compiled code calls a function that looks at every stride; these are asked for dozens of times in a step.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.core.base import BaseContext
from numba.core.imputils import impl_ret_borrowed
from numba.core.typing import Signature
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array


def _view(dimensions: int, array: types.Array) -> tuple[Signature, Any]:
    """Signature and code of a view with the first `dimensions` − 1 axes and all others as one."""
    if array.layout != "C":
        raise TypeError(f"an array without gaps is needed, not {array}")
    result = types.Array(array.dtype, dimensions, "C")

    def code(context: BaseContext, builder: Any, signature: Signature, arguments: list[Any]) -> Any:
        source = make_array(array)(context, builder, arguments[0])
        view = make_array(result)(context, builder)
        first = [builder.extract_value(source.shape, axis) for axis in range(dimensions - 1)]
        last = builder.extract_value(source.shape, dimensions - 1)
        for axis in range(dimensions, array.ndim):
            last = builder.mul(last, builder.extract_value(source.shape, axis))
        strides = [builder.extract_value(source.strides, axis) for axis in range(dimensions - 1)]
        populate_array(
            view, data=source.data, shape=[*first, last], strides=[*strides, source.itemsize],
            itemsize=source.itemsize, meminfo=source.meminfo, parent=source.parent,
        )  # fmt: skip
        return impl_ret_borrowed(context, builder, result, view._getvalue())

    return result(array), code


@intrinsic
def flat(typing_context: Any, values: types.Array) -> tuple[Signature, Any]:
    """All numbers as one vector."""
    return _view(1, values)


@intrinsic
def flat_rows(typing_context: Any, rows: types.Array) -> tuple[Signature, Any]:
    """Rows of one length, shape (first axis, the product of the others)."""
    return _view(2, rows)
