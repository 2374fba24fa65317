"""The groups of a rod's arrays (`sim.rod_memory`) as compiled code takes them: two addresses, however many arrays.

A tuple of thirty arrays is three hundred values to the compiler, which are copied at every call. A group is the address
of the memory and that of the table of places in it; each array is made where it is named.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, lower_builtin, lower_getattr_generic, models, register_model, type_callable
from numba.np.arrayobj import make_array, populate_array

Place = tuple[int, int]
"""Of an array: the line of the table where it begins in the memory, its axes' lengths behind it, and how many these
are. Of a whole number, which has no axes: its line in the table."""


class Group(types.Type):
    """Type of a group."""

    def __init__(self, name: str, fields: Mapping[str, Place]) -> None:
        super().__init__(name=f"rod.{name}")
        self.fields = dict(fields)


@register_model(Group)
class _GroupModel(models.StructModel):
    def __init__(self, manager: Any, group: Group) -> None:
        members = [("numbers", types.CPointer(types.float64)), ("places", types.CPointer(types.int64))]
        super().__init__(manager, group, members)


def _type_of(axes: int) -> types.Type:
    return types.Array(types.float64, axes, "C") if axes else types.int64


@infer_getattr
class _Fields(AttributeTemplate):
    key = Group

    def generic_resolve(self, group: Group, name: str) -> types.Type | None:
        return _type_of(group.fields[name][1]) if name in group.fields else None


@lower_getattr_generic(Group)
def _field(context: Any, builder: Any, group: Group, value: Any, name: str) -> Any:
    """An array as its place in the table has it."""
    own = cgutils.create_struct_proxy(group)(context, builder, value)

    def place(line: int) -> Any:
        number = builder.load(builder.gep(own.places, [context.get_constant(types.intp, line)]))
        number.set_metadata("invariant.load", builder.module.add_metadata([]))  # the table is not written to
        return number

    line, axes = group.fields[name]
    if axes == 0:
        return place(line)
    shape = [place(line + 1 + axis) for axis in range(axes)]
    strides = [context.get_constant(types.intp, 8)]
    for length in shape[:0:-1]:
        strides.insert(0, builder.mul(strides[0], length, flags=["nsw"]))
    result = make_array(_type_of(axes))(context, builder)
    data = builder.gep(own.numbers, [place(line)])
    populate_array(result, data=data, shape=shape, strides=strides, itemsize=8, meminfo=None)
    return result._getvalue()


def compiled_carving(carve: Any, groups: tuple[Group, ...]) -> None:
    """In compiled code `carve(memory, places)` gives these groups of arrays in `memory`."""

    @type_callable(carve)
    def typing(context: Any) -> Any:
        return lambda memory, places: types.Tuple(groups)

    @lower_builtin(carve, types.Array, types.Array)
    def code(context: Any, builder: Any, signature: Any, arguments: list[Any]) -> Any:
        memory, places = (
            make_array(array)(context, builder, argument)
            for array, argument in zip(signature.args, arguments, strict=True)
        )
        made = []
        for group in groups:
            own = cgutils.create_struct_proxy(group)(context, builder)
            own.numbers, own.places = memory.data, places.data
            made.append(own._getvalue())
        return context.make_tuple(builder, signature.return_type, made)

    carve.compiled_by = (code, _field)  # for `softbot.kernel_source`
