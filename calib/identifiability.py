"""Which parameters a table determines, which only together, and which not at all: the Fisher information's spectrum.

With the coordinates θ (logarithms of parameters, so that 0.1 is 10 %) and the information F = JᵀJ/σ², the eigenvector
of a small eigenvalue is a change of all parameters that the measurements hardly see: along it the parameters are
known to ±1/√λ only. Where that is more than `VAGUE`, the parameters that make up the direction cannot be told from
each other.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.bend_table import FloatArray

VAGUE = 0.5
"""Of a logarithm: a parameter known to a factor of e^(2·0.5) = 2.7 either way (95 %) is not determined."""
_PART = 0.35  # least share of a unit vector that counts as part of a direction


@dataclass(frozen=True)
class Direction:
    """One eigenvector of the information."""

    names: tuple[str, ...]
    """Coordinates that make it up, the largest first."""
    signs: tuple[int, ...]
    """Their signs: equal ones grow together unseen."""
    standard_deviation: float
    """1/√λ: how far the parameters may move along it within one standard deviation."""

    @property
    def is_vague(self) -> bool:
        """Whether the measurements leave it open."""
        return not self.standard_deviation < VAGUE


def directions(names: Sequence[str], information: FloatArray) -> list[Direction]:
    """All directions, shape (c, c) information in units of 1/coordinate², the vaguest first."""
    value, vector = np.linalg.eigh(information)
    found = []
    for one, column in zip(value, vector.T, strict=True):
        order = np.argsort(-np.abs(column))
        parts = [int(i) for i in order if abs(column[i]) >= _PART] or [int(order[0])]
        sign = math.copysign(1.0, column[parts[0]])
        found.append(
            Direction(
                tuple(names[i] for i in parts),
                tuple(int(math.copysign(1.0, column[i]) * sign) for i in parts),
                1.0 / math.sqrt(one) if one > 1e-300 else math.inf,
            )
        )
    return found


def sentences(
    found: Sequence[Direction], plain: Mapping[str, str], remedy: Mapping[str, str], source: str = "this table"
) -> list[str]:
    """What is not determined, in words: `plain` names coordinates for people, `remedy` says what to measure."""
    said = []
    for one in found:
        if not one.is_vague:
            continue
        names = [plain.get(name, name) for name in dict.fromkeys(one.names)]
        what = " from ".join(names) if len(names) > 1 else f"the size of {names[0]}"
        mends = dict.fromkeys(remedy[name] for name in one.names if name in remedy)
        said.append(f"{source} cannot tell {what}" + (f": {'; '.join(mends)}" if mends else ""))
    return list(dict.fromkeys(said))
