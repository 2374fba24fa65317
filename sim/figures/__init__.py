"""The figures of theory and twins, each by one command: `softbot figure NAME`.

One module a figure, called as the figure is (with underscores for its hyphens). It has

    def draw(path: Path, **options) -> dict

which writes the picture to `path` and returns the numbers that it drew. Options have defaults, whose kind a given value
must have. Modules whose name starts with an underscore are no figures. Figures of what the twins do under a sequencer
are in a package of the same make, `softbot.nodes.figures`.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from softbot.errors import InputError

OWN = (__name__,)


def figures(packages: tuple[str, ...] = OWN) -> dict[str, str]:
    """Name of each figure of some packages → the first line of its module's docstring. Imports none of them."""
    found = {}
    for path in _modules(packages).values():
        found[path.stem.replace("_", "-")] = (
            ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        ).partition("\n")[0]
    return found


def draw(
    name: str, path: Path, options: Mapping[str, Any] | None = None, packages: tuple[str, ...] = OWN
) -> dict[str, Any]:
    """Draw a figure into `path` (PNG, SVG or PDF, by its ending); the numbers that it shows.

    Raises InputError for a name or an option that there is none of, an option of another kind than its default, and a
    path that cannot be written.
    """
    known = figures(packages)
    if name not in known:
        listed = "\n".join(f"  {one}: {line}" for one, line in known.items())
        raise InputError(f"{name!r} is no figure; there are:\n{listed}")
    module = importlib.import_module(next(one for one in _modules(packages) if one.endswith(_file_name(name))))
    parameters = dict(list(inspect.signature(module.draw).parameters.items())[1:])
    for key, value in (options or {}).items():
        if key not in parameters:
            raise InputError(f"{key}: no option of the figure {name}; it has {', '.join(parameters) or 'none'}")
        _same_kind(key, value, parameters[key].default)
    drawn: dict[str, Any] = module.draw(path, **(options or {}))
    return drawn


def _file_name(name: str) -> str:
    return f".{name.replace('-', '_')}"


def _modules(packages: tuple[str, ...]) -> dict[str, Path]:
    """Every module of these packages that is a figure, by its whole name, and its file."""
    found = {}
    for package in packages:
        spec = find_spec(package)
        assert spec is not None
        assert spec.submodule_search_locations is not None
        (folder,) = spec.submodule_search_locations
        for module in pkgutil.iter_modules([folder]):
            if not module.name.startswith("_"):
                found[f"{package}.{module.name}"] = Path(folder, f"{module.name}.py")
    return found


def _same_kind(key: str, value: object, default: object) -> None:
    """InputError unless `value` may stand in for `default`: a list for a tuple, each entry like its first."""
    if isinstance(default, tuple):
        if not isinstance(value, list | tuple) or not value:
            raise InputError(f"{key} = {value!r}: must be a list such as {list(default)}")
        for entry in value:
            _same_kind(key, entry, default[0])
        return
    number = isinstance(default, float) and isinstance(value, int | float) and not isinstance(value, bool)
    if default is not None and type(value) is not type(default) and not number:
        raise InputError(f"{key} = {value!r}: must be of the kind of {default!r}")
