"""The rod's memory as Python and as compiled code see it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sim.rod_memory import Contacts, Layout, State, Work, carve, instant_size, instants, places, rod_memory
from sim.rod_rule import Rule
from softbot.kernel_compiler import kernel

LAYOUTS = (
    Layout(modes=1, points=4, half=4, strains=3, base=3, columns=5, spots=1, resists=0),
    Layout(modes=3, points=16, half=8, strains=10, base=6, columns=16, spots=2, resists=1),
)
GROUPS = {"state": State, "rule": Rule, "contacts": Contacts, "work": Work}
FIELDS = [(group, field) for group, fields in GROUPS.items() for field in fields._fields]


def _look() -> Any:
    """Compiled: marks the first and the last number of each array and tells its lengths."""
    lines = ["def look(memory, places, shapes):", "    layout, state, rule, contacts, work = carve(memory, places)"]
    axes = {"state": carve(rod_memory(LAYOUTS[0]), places(LAYOUTS[0]))}
    _, *groups = axes["state"]
    for n, (group, field) in enumerate(FIELDS):
        count = getattr(groups[list(GROUPS).index(group)], field).ndim
        lines.append(f"    one = {group}.{field}")
        lines.append("    if one.size > 0:")
        lines.append(f"        one[{', '.join(['0'] * count)}] = {n + 1}.25")
        lines.append(f"        one[{', '.join(['-1'] * count)}] = {n + 1}.75")
        lines += [f"    shapes[{n}, {axis}] = one.shape[{axis}]" for axis in range(count)]
    lines.append("    return layout.modes + 100 * layout.columns + 10000 * layout.resists")
    space: dict[str, Any] = {"carve": carve}
    exec("\n".join(lines), space)
    return kernel(cache=False)(space["look"])


@pytest.fixture(scope="module")
def look() -> Any:
    return _look()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_compiled_code_and_python_see_the_same_arrays(look: Any, layout: Layout) -> None:
    memory, shapes = rod_memory(layout), np.zeros((len(FIELDS), 4), dtype=np.int64)
    told = look(memory, places(layout), shapes)
    assert told == layout.modes + 100 * layout.columns + 10000 * layout.resists
    seen, *groups = carve(memory, places(layout))
    assert seen == layout
    for n, (group, field) in enumerate(FIELDS):
        array = getattr(groups[list(GROUPS).index(group)], field)
        assert tuple(shapes[n, : array.ndim]) == array.shape, field
        if array.size > 0:
            assert array.flat[-1] == n + 1.75, field
            assert array.flat[0] == n + (1.25 if array.size > 1 else 1.75), field


@pytest.mark.parametrize("layout", LAYOUTS)
def test_no_two_arrays_share_a_number_and_the_memory_is_no_longer_than_they_need(layout: Layout) -> None:
    memory = rod_memory(layout)
    _, *groups = carve(memory, places(layout))
    for group in groups:
        for array in group:
            assert np.shares_memory(array, memory) or array.size == 0
            array += 1.0
    assert memory.max() == 1.0
    assert sum(array.size for group in groups for array in group) == memory.sum()
    assert memory.size - memory.sum() < 8 * len(FIELDS)


def test_the_memory_begins_with_what_an_instant_has() -> None:
    layout = LAYOUTS[1]
    memory = np.arange(float(rod_memory(layout).size))
    _, state, *_ = carve(memory, places(layout))
    many = np.stack([memory[: instant_size(layout)]] * 3)
    for name, part in instants(many, layout)._asdict().items():
        np.testing.assert_array_equal(part[1], getattr(state, name), err_msg=name)
        assert np.shares_memory(part, many)
