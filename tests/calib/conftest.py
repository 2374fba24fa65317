"""Tables made by a known robot."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from softbot.actuator import ActuatorLaw
from softbot.cross_section import default_cross_section

MakeTable = Callable[..., Path]

LENGTH_M = 0.2
RADIUS_M = 0.02


@pytest.fixture
def make_table(tmp_path: Path) -> MakeTable:
    """A CSV of a robot of known parameters at given pressures [Pa], with noise; optional columns by name."""

    def make(
        pressure_Pa: np.ndarray,
        *,
        material: str = "neo-hookean",
        modulus_Pa: float = 5e4,
        gains: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0),
        dead_band_Pa: float = 0.0,
        noise_deg: float = 0.0,
        noise_mm: float = 0.0,
        columns: tuple[str, ...] = (),
        seed: int = 0,
    ) -> Path:
        rng = np.random.default_rng(seed)
        law = ActuatorLaw(default_cross_section(RADIUS_M), material, modulus_Pa, gains=gains, dead_band_Pa=dead_band_Pa)
        pressure = np.zeros((len(pressure_Pa), 4))
        pressure[:, : np.atleast_2d(pressure_Pa.T).shape[0]] = pressure_Pa.reshape(len(pressure_Pa), -1)
        strain, _ = law.equilibria(pressure)
        bend = np.degrees(LENGTH_M * strain[:, 1:]) + noise_deg * rng.standard_normal((len(pressure), 2))
        cells = {f"pressure_{i}_kPa": pressure[:, i] / 1e3 for i in range(4)} | {"bend_deg": np.hypot(*bend.T)}
        if "direction" in columns:
            cells["bend_direction_deg"] = np.degrees(np.arctan2(bend[:, 1], bend[:, 0]))
        if "length" in columns:
            cells["length_mm"] = 1e3 * LENGTH_M * strain[:, 0] + noise_mm * rng.standard_normal(len(pressure))
        path = tmp_path / f"known_{seed}.csv"
        lines = [",".join(cells), *(",".join(f"{v:.10g}" for v in row) for row in zip(*cells.values(), strict=True))]
        path.write_text("\n".join(lines), encoding="utf-8")
        return path

    return make
