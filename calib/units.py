"""Units that a table may use, and how a column's header names its quantity and its unit.

A header is `name_unit` (`pressure_0_kPa`), or a name with the unit in brackets or after a slash
(`Pressure (kPa)`, `pressure / kPa`). Everything is turned into SI.
"""

from __future__ import annotations

import math
import re

PRESSURE_PA = {
    "pa": 1.0,
    "hpa": 1e2,
    "kpa": 1e3,
    "mpa": 1e6,
    "mbar": 1e2,
    "bar": 1e5,
    "psi": 6894.757293168,
    "n/mm2": 1e6,
    "n/m2": 1.0,
}
ANGLE_RAD = {"deg": math.pi / 180.0, "rad": 1.0, "mrad": 1e-3}
CURVATURE_1_M = {"1/m": 1.0, "1/cm": 1e2, "1/mm": 1e3}
LENGTH_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254}
TIME_S = {"s": 1.0, "ms": 1e-3, "min": 60.0}

_SPELLINGS = {
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "radian": "rad",
    "radians": "rad",
    "n/mm²": "n/mm2",
    "n_mm2": "n/mm2",
    "nmm2": "n/mm2",
    "n/mm^2": "n/mm2",
    "n/m²": "n/m2",
    "n/m^2": "n/m2",
    "1_m": "1/m",
    "m-1": "1/m",
    "m^-1": "1/m",
    "m⁻¹": "1/m",
    "1_mm": "1/mm",
    "rad/m": "1/m",
    "inch": "in",
    "inches": "in",
    "pascal": "pa",
    "sec": "s",
    "seconds": "s",
}
_REFERENCES = {"g": False, "gauge": False, "a": True, "abs": True, "absolute": True}
_ALL = {**PRESSURE_PA, **ANGLE_RAD, **CURVATURE_1_M, **LENGTH_M, **TIME_S}
_REFERRED = [f"{unit}{joint}{word}" for unit in PRESSURE_PA for joint in ("", "_", " ") for word in _REFERENCES]
_SUFFIXES = sorted([*_ALL, *_SPELLINGS, *_REFERRED], key=len, reverse=True)


def unit_name(text: str) -> str | None:
    """The canonical name of a unit as people write it, or None for what is no unit known here."""
    return unit_and_reference(text)[0]


def unit_and_reference(text: str) -> tuple[str | None, bool | None]:
    """The unit's canonical name, None if unknown, and whether it says absolute (`psia`, `kPa abs`), None if nothing."""
    word = text.strip().lower().rstrip(".")
    word = _SPELLINGS.get(word, word)
    if word in _ALL:
        return word, None
    found = re.fullmatch(r"(.+?)[\s_(]*(gauge|absolute|abs|a|g)\)?", word)
    if found and found.group(1) in PRESSURE_PA:
        return found.group(1), _REFERENCES[found.group(2)]
    return None, None


def says_gauge(header: str) -> bool:
    """Whether a header says in so many words that its pressures are above the atmosphere."""
    name, unit = split_header(header)
    return "gauge" in name.split("_") or (unit is not None and unit_and_reference(unit)[1] is False)


def split_header(header: str) -> tuple[str, str | None]:
    """A header's name (lower case, words joined by `_`) and the text of its unit, None where it has none."""
    text = header.strip()
    for pattern in (
        r"^(.*?)\s*\[\s*([^\[\]]*?)\s*\]$",
        r"^(.*?)\s*\(\s*([^()]*?(?:\([ag]\))?)\s*\)$",
        r"^(.*?)\s+/\s+(\S+)$",
    ):
        found = re.match(pattern, text)
        if found:
            return _words(found.group(1)), found.group(2)
    lower = text.lower()
    for suffix in _SUFFIXES:
        for joint in ("_", " "):
            if lower.endswith(joint + suffix):
                return _words(text[: -len(suffix) - 1]), text[-len(suffix) :]
    return _words(text), None


def _words(text: str) -> str:
    return re.sub(r"[^0-9a-z]+", "_", text.lower()).strip("_").removesuffix("_in")  # "angle in deg"
