"""A bending-angle–pressure table in SI units."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class BendTable:
    """A table in SI units; n rows, in the order of the file."""

    source: str
    """Path of the file as it was given, for messages."""
    comments: tuple[str, ...]
    """The file's comment lines."""
    notes: tuple[str, ...]
    """What the reader assumed or left out, in words."""
    pressure_Pa: FloatArray
    """Gauge pressures, shape (n, 4)."""
    bend_rad: FloatArray
    """Size of the bend, shape (n,)."""
    direction_rad: FloatArray
    """Direction of the bend in the body frame, shape (n,); NaN where it was not measured."""
    length_m: FloatArray
    """Arc length, shape (n,); NaN where it was not measured."""
    loading: NDArray[np.bool_]
    """Whether the row was reached by rising pressure, shape (n,)."""
    trial: NDArray[np.str_]
    """Trial of each row, shape (n,); "" where the table has none."""
    setpoint: NDArray[np.str_]
    """Label of the commanded pressures of each row, shape (n,); "" where the table has none."""
    line: NDArray[np.int_]
    """Line of the file of each row, counted from 1, shape (n,)."""
    t_s: FloatArray
    """Time of each row, shape (n,) [s]; NaN where the table has none."""
    valid: NDArray[np.bool_]
    """Whether the bend of the row may be used, shape (n,): not flagged as bad."""
    row_word: str = "line"
    """What a row of the file is called in messages: "line" of a text, "row" of a workbook."""
    rest_length_m: float | None = None
    """Length at rest, where the table's lengths are all the same and so can be nothing else."""
    gauge_stated: bool = False
    """Whether the headers say that the pressures are gauge pressures (`psig`, `pressure_gauge_kPa`)."""

    def __len__(self) -> int:
        return len(self.bend_rad)

    def rows(self, chosen: NDArray[np.bool_] | NDArray[np.int_]) -> BendTable:
        """The table of the chosen rows (a mask or indices, shape (n,))."""
        index = np.arange(len(self))[chosen]
        return replace(
            self,
            pressure_Pa=self.pressure_Pa[index],
            bend_rad=self.bend_rad[index],
            direction_rad=self.direction_rad[index],
            length_m=self.length_m[index],
            loading=self.loading[index],
            trial=self.trial[index],
            setpoint=self.setpoint[index],
            line=self.line[index],
            t_s=self.t_s[index],
            valid=self.valid[index],
        )

    def place(self, row: int) -> str:
        """Where a row stands in the file, for messages."""
        return f"{self.source}, {self.row_word} {self.line[row]}"

    @property
    def has_length(self) -> bool:
        """Whether any row has a length."""
        return bool(np.any(np.isfinite(self.length_m)))


def joined_rows(one: BendTable, other: BendTable) -> BendTable:
    """The rows of one table and then those of another part of it."""
    changed = {
        part.name: np.concatenate([getattr(one, part.name), getattr(other, part.name)])
        for part in fields(one)
        if isinstance(getattr(one, part.name), np.ndarray)
    }
    return replace(one, **changed)  # type: ignore[arg-type]
