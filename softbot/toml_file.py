"""TOML files in and out: every error names the file, the key, the value and the mend.

A file is read into plain tables, `--set a.b=value` overrides are laid over it, and a pydantic model checks it field by
field. Unknown keys are errors; where one looks like a known key with another unit, the message says so.
"""

from __future__ import annotations

import difflib
import os
import tomllib
import typing
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import pydantic
import tomli_w

from softbot.errors import InputError

Model = TypeVar("Model", bound=pydantic.BaseModel)
Table = dict[str, Any]

STRICT = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
"""The configuration of every model of a file: no unknown keys, no NaN or infinity, immutable."""


def read_toml(path: Path) -> Table:
    """The tables of a TOML file. Raises InputError that names the file and what is wrong with it."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check the path") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; name a TOML file") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file in UTF-8 (byte {error.start}); save it as UTF-8") from None
    except ValueError:  # what no file system takes for a name: a zero byte
        raise InputError(f"{str(path)!r}: is no path; take the zero byte out") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if not text.strip():
        raise InputError(f"{path}: the file is empty; see scenes/ for examples")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # TOMLDecodeError is a ValueError; so is a number of too many digits
        raise InputError(f"{path}: not valid TOML: {error}") from None


def write_toml(path: Path, table: Mapping[str, Any]) -> None:
    """Write tables to a TOML file, atomically: a killed writer leaves the old file or the new one, never half."""
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_text(tomli_w.dumps(_without_none(table)), encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}; choose another place") from None


def override(table: Table, assignments: Iterable[str]) -> Table:
    """A copy of the tables with `a.b.c=value` assignments laid over it; list entries are named by their index.

    Values are read as TOML (`1.5`, `true`, `"text"`, `[1, 2]`); what is no TOML value is taken as text.
    """
    result = _copy(table)
    for assignment in assignments:
        key, sign, text = assignment.partition("=")
        parts = [part.strip() for part in key.split(".")]
        if not sign or not all(parts):
            raise InputError(f"--set {assignment!r}: write it as key.subkey=value, as in drive.period_s=2.0")
        place: Any = result
        for depth, part in enumerate(parts[:-1]):
            if isinstance(place, list):
                place = _entry(place, part, assignment)
            else:
                place = place.setdefault(part, {})
            if not isinstance(place, dict | list):
                raise InputError(f"--set {assignment!r}: {'.'.join(parts[: depth + 1])} is a value, not a table")
        if isinstance(place, list):
            _entry(place, parts[-1], assignment)
            place[int(parts[-1])] = _value(text)
        else:
            place[parts[-1]] = _value(text)
    return result


def check(model: type[Model], table: Mapping[str, Any], source: str) -> Model:
    """The tables as a checked model. Raises InputError with one line for each wrong key of `source`."""
    try:
        return model.model_validate(dict(table))
    except InputError as error:  # from a dataclass inside the model
        raise InputError(f"{source}: {error}") from None
    except pydantic.ValidationError as error:
        lines = [f"{source}: {_explain(detail, model)}" for detail in error.errors(include_url=False)]
        raise InputError("\n".join(dict.fromkeys(lines))) from None


_LISTS = ("tuple_type", "list_type")
_TABLES = ("model_type", "dataclass_type", "dict_type")
_IN_TOML = dict.fromkeys(_LISTS, "input should be a list") | dict.fromkeys(_TABLES, "input should be a table")
"""What TOML calls the types that pydantic names in Python's words."""


def _explain(detail: Any, model: type[pydantic.BaseModel]) -> str:
    place = [part for part in detail["loc"] if not (isinstance(part, str) and part.startswith("function-"))]
    key = ".".join(str(part) for part in _walk(model, place)[0])
    kind, value = detail["type"], detail.get("input")
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        known = list(_fields(_walk(model, place[:-1])[1]))
        return f"{key}: unknown key; {_suggest(str(place[-1]), known)}"
    if kind in ("missing", "missing_argument"):
        return f"{key}: missing; add it{_description(model, place)}"
    message = _IN_TOML.get(kind) or detail["msg"].removeprefix("Value error, ")
    if kind == "too_short":
        message = f"input should be a list of {detail['ctx']['min_length']} or more"
    if kind in _LISTS and isinstance(value, dict):
        message = f"input should be a list of tables, each under [[{key}]]"
    message = message[0].lower() + message[1:]
    shown = "" if isinstance(value, dict | list) and len(str(value)) > 60 else f" = {value!r}"
    return f"{key}{shown}: {message}{_description(model, place)}" if key else message


def _suggest(wrong: str, known: list[str]) -> str:
    stem = wrong.rsplit("_", 1)[0]
    for name in known:
        if "_" in name and (name.rsplit("_", 1)[0] == stem or _stem(name) == _stem(wrong)):
            return f"did you mean {name}? (mind the unit)"
    close = difflib.get_close_matches(wrong, known, n=1)
    if close:
        return f"did you mean {close[0]}?"
    return f"known here: {', '.join(known)}" if known else "remove it"


def _stem(name: str) -> str:
    """A key without its unit suffix: everything before the first part that is a unit."""
    parts = name.split("_")
    for index, part in enumerate(parts):
        if index and (part.lower() in _UNIT_WORDS or part == "1"):
            return "_".join(parts[:index])
    return name


_UNIT_WORDS = frozenset(
    "m mm cm um km s ms us min h hz kg g mg n mn pa kpa mpa bar psi k c rad deg rev m2 m3 m4 mm2 w v j".split()  # noqa: SIM905
)


def _walk(model: Any, place: list[Any]) -> tuple[list[Any], Any]:
    """A place of pydantic's without the tags of its unions, and the type that it leads to."""
    kept = []
    for part in place:
        tagged = _tagged(model, part)
        if typing.get_origin(model) is dict:
            model = typing.get_args(model)[1]
        elif tagged is not None:
            model = tagged
            continue
        elif not isinstance(part, int):
            model = _fields(model).get(part, model)
        kept.append(part)
    return kept, model


def _tagged(annotation: Any, tag: Any) -> Any:
    """The member of a union that has this tag, None where there is none."""
    if any(isinstance(one, pydantic.Tag) and one.tag == tag for one in getattr(annotation, "__metadata__", ())):
        return annotation.__origin__
    return next(filter(None, (_tagged(inner, tag) for inner in getattr(annotation, "__args__", ()))), None)


def _fields(model: Any) -> dict[str, Any]:
    """Field names of a model or a dataclass (looked for inside unions and lists) → their types."""
    for candidate in _unfold(model):
        if hasattr(candidate, "model_fields"):
            return {info.alias or name: info.annotation for name, info in candidate.model_fields.items()}
        if hasattr(candidate, "__dataclass_fields__"):
            hints = typing.get_type_hints(candidate)
            return {name: hints[name] for name in candidate.__dataclass_fields__}
    return {}


def _unfold(annotation: Any) -> list[Any]:
    arguments = getattr(annotation, "__args__", ())
    if not arguments or (isinstance(annotation, type) and hasattr(annotation, "model_fields")):
        return [annotation]
    return [inner for argument in arguments for inner in _unfold(argument)]


def _description(model: Any, place: list[Any]) -> str:
    for candidate in _unfold(_walk(model, place[:-1])[1]):
        info = getattr(candidate, "model_fields", {}).get(place[-1] if place else "")
        if info is not None and info.description:
            return f" ({info.description})"
    return ""


def _entry(place: list[Any], index: str, assignment: str) -> Any:
    if index not in map(str, range(len(place))):
        raise InputError(
            f"--set {assignment!r}: {index!r} is no entry of that list; it has {len(place)}, counted from 0"
        )
    return place[int(index)]


def _value(text: str) -> Any:
    try:
        tables = tomllib.loads(f"value = {text.strip()}")
    except (ValueError, RecursionError):  # no TOML, a number of too many digits, brackets too deep
        return text.strip()
    return tables["value"] if len(tables) == 1 else text.strip()


def _copy(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _copy(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_copy(item) for item in value]
    return value


def _without_none(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    if isinstance(value, list | tuple):
        return [_without_none(item) for item in value]
    return value
