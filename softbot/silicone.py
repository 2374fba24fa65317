"""The library of silicones: walls fitted to tensile tests, from which a robot is predicted before it is built.

`softbot/data/materials.toml` is written by `python -m calib.fit_materials` from shipped tests. What a silicone says of
a robot is a prediction: `stiffness_log_sd` is how far its stiffness is to be trusted (standard deviation of the
logarithm). Since every law's stress is in proportion to its modulus, a wall that is s times stiffer does under a
pressure p what this one does under p/s.
"""

from __future__ import annotations

import difflib
from functools import lru_cache
from importlib import resources
from typing import Any

import pydantic
from pydantic import Field

from softbot.errors import InputError
from softbot.material import MATERIALS, OPTIONAL_PARAMETERS, MaterialName
from softbot.toml_file import STRICT, check, read_toml

MATERIALS_SCHEMA = "softbot-materials-1"


class Silicone(pydantic.BaseModel):
    """One castable silicone; what the numbers are is said in `calib.fit_materials`."""

    model_config = STRICT

    name: str
    law: MaterialName
    modulus_Pa: float = Field(gt=0)
    stiffening_Pa: float | None = None
    stiffening_2_Pa: float | None = None
    limit_invariant: float | None = None
    second_share: float | None = None
    density_kg_m3: float = Field(gt=0)
    small_strain_modulus_Pa: float = Field(gt=0)
    measured_small_strain_modulus_Pa: float = Field(gt=0)
    offset_Pa: float
    rms_percent: float
    fitted_to_strain: float
    stiffness_log_sd: float = Field(ge=0)
    stiffness_log_sd_parts: dict[str, float]
    source: str

    @property
    def parameters(self) -> dict[str, float]:
        """The law's parameters by key, as `[actuator]` has them."""
        return {key: getattr(self, key) for key in MATERIALS[self.law].keys if getattr(self, key) is not None}


class _Library(pydantic.BaseModel):
    model_config = STRICT

    schema_: str = Field(alias="schema")
    made_by: str
    licence: str
    silicone: tuple[Silicone, ...]


@lru_cache(maxsize=1)
def silicones() -> dict[str, Silicone]:
    """All silicones by name, softest first."""
    with resources.as_file(resources.files("softbot") / "data" / "materials.toml") as path:
        library = check(_Library, read_toml(path), path.name)
    return {one.name: one for one in library.silicone}


def silicone(name: str) -> Silicone:
    """The silicone of that name (case, spaces, hyphens do not matter). Raises InputError that lists the known ones."""
    known = silicones()
    plain = {_plain(one): one for one in known}
    if _plain(name) in plain:
        return known[plain[_plain(name)]]
    close = difflib.get_close_matches(_plain(name), plain, n=1, cutoff=0.75)
    hint = f"did you mean {plain[close[0]]}?" if close else f"known are {', '.join(known)}"
    raise InputError(f"material = {name!r}: is not in the library; {hint} (softbot materials lists them)")


def _plain(name: str) -> str:
    return "".join(letter for letter in name.lower() if letter.isalnum())


def wall_of(name: str, stated: dict[str, Any]) -> dict[str, Any]:
    """Keys of an `[actuator]` for a wall of this silicone, to be laid under what is `stated` there.

    Raises InputError where the table states a law or a parameter of its own that differs.
    """
    one = silicone(name)
    wall = {"law": one.law, **one.parameters}
    for key in ("law", "modulus_Pa", *OPTIONAL_PARAMETERS):
        if key in stated and stated[key] != wall.get(key, _nothing(key)):
            raise InputError(
                f"actuator.{key} = {stated[key]!r}: material = {one.name!r} says {wall.get(key, 'nothing of it')}; "
                "leave one of the two out"
            )
    return wall


def _nothing(key: str) -> float | None:
    return OPTIONAL_PARAMETERS[key].default if key in OPTIONAL_PARAMETERS else None
