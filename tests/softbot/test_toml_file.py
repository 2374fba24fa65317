"""TOML in and out: errors name file, key, value and mend; overrides; nothing half-written."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pydantic
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from softbot.errors import InputError
from softbot.toml_file import STRICT, check, override, read_toml, write_toml


class Wheel(pydantic.BaseModel):
    model_config = STRICT
    diameter_mm: float = Field(gt=0, description="outer diameter, in millimetres")
    spokes: int = 8


class Cart(pydantic.BaseModel):
    model_config = STRICT
    name: str = "cart"
    top_speed_m_s: float = Field(1.0, ge=0, le=10, description="in m/s")
    colour: str | None = None
    front: Wheel
    spare: Wheel | None = None
    wheel: tuple[Wheel, ...] = ()
    horse: tuple[str, ...] = Field(("Bess",), min_length=1)

    @pydantic.model_validator(mode="after")
    def _spare_fits(self) -> Cart:
        if self.spare is not None and self.spare.diameter_mm != self.front.diameter_mm:
            raise ValueError("spare.diameter_mm: must be that of the front wheel")
        return self


FRONT = {"diameter_mm": 300}


# --- reading ------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "the file is empty"),
        (b"  \n\t\n", "the file is empty"),
        (b"a = ", "not valid TOML"),
        (b"a = 1\na = 2\n", "not valid TOML"),
        (b"[robot\n", "at line 1"),
        (b"name = \"caf\xe9\"\n", "not a text file in UTF-8 (byte 11)"),
    ],
)  # fmt: skip
def test_file_that_is_not_toml_is_refused_by_name(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "scene.toml"
    path.write_bytes(content)
    with pytest.raises(InputError) as refusal:
        read_toml(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert says in str(refusal.value)


def test_missing_file_and_folder_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file; check the path"):
        read_toml(tmp_path / "nothing.toml")
    with pytest.raises(InputError, match="is a folder; name a TOML file"):
        read_toml(tmp_path)
    path = tmp_path / "file"
    path.write_text("a = 1")
    with pytest.raises(InputError, match="cannot be read"):
        read_toml(path / "below.toml")
    with pytest.raises(InputError, match=r"a\\x00b\.toml': is no path"):
        read_toml(tmp_path / "a\0b.toml")


def test_byte_order_mark_is_no_part_of_the_first_key(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_bytes(b"\xef\xbb\xbfname = 'x'\n")
    assert read_toml(path) == {"name": "x"}


# --- writing ------------------------------------------------------------

keys = st.text("abcdefghij_", min_size=1, max_size=6)
values = st.recursive(
    st.booleans() | st.integers(-(2**62), 2**62) | st.floats(allow_nan=False) | st.text("aé\"'\\\n\t #=", max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys, inner, max_size=3),
    max_leaves=12,
)


@given(table=st.dictionaries(keys, values, max_size=4))
def test_what_is_written_is_read_back(tmp_path_factory: pytest.TempPathFactory, table: dict[str, Any]) -> None:
    path = tmp_path_factory.mktemp("toml") / "table.toml"
    write_toml(path, table)
    assert read_toml(path) == table if table else path.read_text() == ""


def test_none_is_left_out_at_every_depth(tmp_path: Path) -> None:
    path = tmp_path / "t.toml"
    write_toml(path, {"a": None, "b": {"c": None, "d": 1}, "e": [{"f": None, "g": (1, 2)}]})
    assert read_toml(path) == {"b": {"d": 1}, "e": [{"g": [1, 2]}]}


def test_failed_write_leaves_the_old_file_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "t.toml"
    write_toml(path, {"a": 1})

    def refuse(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(InputError, match="No space left on device; choose another place"):
        write_toml(path, {"a": 2})
    assert read_toml(path) == {"a": 1}
    with pytest.raises(InputError, match="cannot be written"):
        write_toml(tmp_path / "no" / "such" / "folder.toml", {"a": 1})


# --- overrides ------------------------------------------------------------


@pytest.mark.parametrize(
    ("assignment", "expected"),
    [
        ("front.spokes=12", {"front": {"diameter_mm": 300, "spokes": 12}}),
        (" front . diameter_mm = 2.5e2", {"front": {"diameter_mm": 250.0}}),
        ("name=red cart", {"name": "red cart"}),
        ('name="7"', {"name": "7"}),
        ("name=a=b", {"name": "a=b"}),
        ("name=", {"name": ""}),
        ("ready=true", {"ready": True}),
        ("tags=[1, 2]", {"tags": [1, 2]}),
        ("wheel.1.spokes=3", {"wheel": [{"diameter_mm": 1}, {"diameter_mm": 2, "spokes": 3}]}),
        ("wheel.0={diameter_mm = 9}", {"wheel": [{"diameter_mm": 9}, {"diameter_mm": 2}]}),
        ("new.table.key=1", {"new": {"table": {"key": 1}}}),
        ("name=1\nother=2", {"name": "1\nother=2"}),
        ("name=" + "9" * 6000, {"name": "9" * 6000}),
        ("name=" + "[" * 3000, {"name": "[" * 3000}),
    ],
    ids=lambda value: str(value)[:40],
)
def test_override_lays_one_value_over_a_copy(assignment: str, expected: dict[str, Any]) -> None:
    table = {"front": dict(FRONT), "wheel": [{"diameter_mm": 1}, {"diameter_mm": 2}]}
    result = override(table, [assignment])
    assert {key: result[key] for key in expected} == expected
    assert table == {"front": FRONT, "wheel": [{"diameter_mm": 1}, {"diameter_mm": 2}]}


def test_later_overrides_win() -> None:
    assert override({}, ["a.b=1", "a.b=2", "a.c=3"]) == {"a": {"b": 2, "c": 3}}


@pytest.mark.parametrize(
    ("assignment", "says"),
    [
        ("front.spokes", "write it as key.subkey=value"),
        ("=3", "write it as key.subkey=value"),
        ("front..spokes=3", "write it as key.subkey=value"),
        ("name.first=3", "name is a value, not a table"),
        ("wheel.2.spokes=3", "'2' is no entry of that list; it has 2, counted from 0"),
        ("wheel.last.spokes=3", "'last' is no entry of that list"),
        ("wheel.-1=3", "'-1' is no entry of that list"),
        ("wheel.².spokes=3", "'²' is no entry of that list"),
        ("wheel.0.diameter_mm.x=3", "wheel.0.diameter_mm is a value, not a table"),
    ],
)
def test_override_that_leads_nowhere_is_refused(assignment: str, says: str) -> None:
    table = {"name": "cart", "wheel": [{"diameter_mm": 1}, {"diameter_mm": 2}]}
    with pytest.raises(InputError) as refusal:
        override(table, [assignment])
    assert str(refusal.value).startswith(f"--set {assignment!r}: ")
    assert says in str(refusal.value)


# --- checking ------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"front": {}}, ["front.diameter_mm: missing; add it (outer diameter, in millimetres)"]),
        ({}, ["front: missing; add it"]),
        ({"front": {"diameter_cm": 30}}, ["did you mean diameter_mm? (mind the unit)", "front.diameter_mm: missing"]),
        ({"front": {"diameter": 30, "diameter_mm": 3}}, ["did you mean diameter_mm? (mind the unit)"]),
        ({"front": {**FRONT, "spoke": 3}}, ["front.spoke: unknown key; did you mean spokes?"]),
        ({"front": {**FRONT, "xyz": 3}}, ["front.xyz: unknown key; known here: diameter_mm, spokes"]),
        ({"front": FRONT, "top_speed_km_h": 3}, ["top_speed_km_h: unknown key; did you mean top_speed_m_s?"]),
        ({"front": FRONT, "top_speed_m_s": 11}, ["top_speed_m_s = 11: input should be less than", "(in m/s)"]),
        ({"front": FRONT, "top_speed_m_s": "fast"}, ["top_speed_m_s = 'fast': input should be a valid number"]),
        ({"front": FRONT, "top_speed_m_s": float("inf")}, ["top_speed_m_s = inf: input should be"]),
        ({"front": {"diameter_mm": -1}}, ["front.diameter_mm = -1: input should be greater than 0 (outer diameter"]),
        ({"front": {**FRONT, "spokes": 2.5}}, ["front.spokes = 2.5: input should be a valid integer"]),
        ({"front": 3}, ["front = 3: input should be a table"]),
        ({"front": FRONT, "wheel": 3}, ["wheel = 3: input should be a list"]),
        ({"front": FRONT, "horse": []}, ["horse = []: input should be a list of 1 or more"]),
        ({"front": FRONT, "wheel": dict(FRONT)}, ["input should be a list of tables, each under [[wheel]]"]),
        ({"front": FRONT, "wheel": [FRONT, {"diameter_m": 1}]}, ["wheel.1.diameter_m: unknown key; did you mean dia"]),
        ({"front": FRONT, "spare": {"diameter_inch": 1}}, ["spare.diameter_inch: unknown key; did you mean diameter_"]),
        ({"front": FRONT, "spare": {"diameter_mm": 1}}, ["cart.toml: spare.diameter_mm: must be that of the front"]),
    ],
)
def test_wrong_key_is_named_with_its_value_and_its_mend(table: dict[str, Any], says: list[str]) -> None:
    with pytest.raises(InputError) as refusal:
        check(Cart, table, "cart.toml")
    lines = str(refusal.value).splitlines()
    assert all(line.startswith("cart.toml: ") for line in lines)
    for part in says:
        assert part in str(refusal.value)


def test_all_that_is_wrong_is_said_at_once_and_each_thing_once() -> None:
    with pytest.raises(InputError) as refusal:
        check(Cart, {"front": {"diameter_mm": -1, "bell": 1}, "top_speed_m_s": -1, "wheels": 4}, "cart.toml")
    lines = str(refusal.value).splitlines()
    assert len(lines) == len(set(lines)) == 4


def test_checked_table_becomes_the_model_with_its_defaults() -> None:
    cart = check(Cart, {"front": FRONT, "wheel": [FRONT]}, "cart.toml")
    assert cart.wheel == (Wheel(diameter_mm=300.0),)
    assert cart.top_speed_m_s == 1.0


@pytest.mark.parametrize("text", ["a = " + "[" * 3000, "seed = " + "9" * 6000], ids=["deep", "long number"])
def test_toml_that_breaks_the_reader_is_bad_input(tmp_path: Path, text: str) -> None:
    path = tmp_path / "odd.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"odd\.toml: not valid TOML"):
        read_toml(path)
