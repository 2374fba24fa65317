"""What a calibration takes on one core once it is compiled, in processor time; of tables, the median of five.

    python benchmarks/calibration.py

What the memory of the chambers adds to a step of plant and rod: `python -m sim.benchmark.memory_cost`.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path

from calib.fit import calibrate_table
from calib.model_choice import Geometry
from calib.series_calibration import calibrate_recording
from calib.table import read_rows, read_table

REPEATS = 5
DATA = Path(__file__).parent.parent / "calib" / "data"
TABLES = (
    ("asu_four_chamber_arm/table.csv", Geometry(length_m=0.134)),
    ("epfl_ecoflex_bending/stepwise.csv", Geometry(length_m=0.13)),
    ("published_three_chamber/means.csv", Geometry(length_m=0.15)),
)


def processor_s(work: Callable[[], object]) -> float:
    """Processor time of one call."""
    started_s = time.process_time()
    work()
    return time.process_time() - started_s


def static_s(name: str, geometry: Geometry) -> float:
    """Of one calibration of a table of holds."""
    table = read_table(DATA / name)
    calibrate_table(table, geometry)
    return statistics.median(processor_s(lambda: calibrate_table(table, geometry)) for _ in range(REPEATS))


def main() -> None:
    """Print the figures."""
    for name, geometry in TABLES:
        print(f"{name}: {static_s(name, geometry):.2f} s")
    rows = read_rows(DATA / "asu_four_chamber_arm" / "series.csv")
    geometry = Geometry(length_m=0.134, radius_m=0.029)
    calibrate_recording(rows.rows(rows.trial == rows.trial[0]), geometry)
    took_s = processor_s(lambda: calibrate_recording(rows, geometry))
    print(f"asu_four_chamber_arm/series.csv, four trials: {took_s:.1f} s")


if __name__ == "__main__":
    main()
