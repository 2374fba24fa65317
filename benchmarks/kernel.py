"""How far the rod's kernel is from what this machine can compute: flops of a step, its time, the machine's rate.

    python benchmarks/kernel.py

The count is of multiplications and additions in the loops over points and columns, from their lengths; the machine's
rate is that of a compiled loop of dependent-free fused multiply-adds on an array that fits the first cache.
"""

from __future__ import annotations

import time

import numpy as np
from numba import njit

from sim.body import Body, World
from sim.rod import RodTwin
from sim.rod_drive import drive_array
from sim.scene import Drive

REPEATS = 15
BODY = Body(
    length_m=0.15,
    radius_m=0.01,
    mass_kg=0.0518,
    bending_stiffness_N_m2=3.93e-3,
    twisting_stiffness_N_m2=2.62e-3,
    axial_stiffness_N=157.0,
    damping_time_s=0.02,
)
FLOOR = World(9.81, "plane", 0.6, "coulomb")


def flops(columns: int, strains: int, points: int, half: int, modes: int) -> dict[str, int]:
    """Multiplications and additions of one step on a plane, solved once, by part."""
    triangle = columns * (columns + 1) // 2
    return {
        "place": points * (60 + 12 * modes + 54 + strains * (12 + 60)) + (3 + 6 * strains) * 2 * half * points,
        "rates and accelerations": 4 * columns * 2 * 7 * points + points * 140 + 6 * 2 * half * points,
        "inertia": triangle * 2 * 7 * points,
        "contact": points * 120 + columns * points * 12 + triangle * 2 * 3 * points,
        "solution": columns**3 // 3 + 2 * columns**2 + columns * 2 * 10 * points + 4 * strains**2,
    }


@njit(fastmath=True)
def _fused(values: np.ndarray, rounds: int) -> float:
    total = 0.0
    for _ in range(rounds):
        part = 0.0
        for i in range(values.shape[0]):
            part += values[i] * values[i]
        total += part * 1e-9
    return total


def machine_flops_1_s() -> float:
    """Best rate of a compiled sum of squares [1/s]."""
    values, rounds = np.ones(1024), 20000
    _fused(values, 1)
    best = min(_timed(lambda: _fused(values, rounds)) for _ in range(REPEATS))
    return 2.0 * len(values) * rounds / best


def _timed(run) -> float:  # type: ignore[no-untyped-def]
    began_s = time.perf_counter()
    run()
    return time.perf_counter() - began_s


def main() -> None:
    """Print the table."""
    rate = machine_flops_1_s()
    print(f"machine: {rate / 1e9:.1f} Gflop/s on one core, a compiled sum of squares\n")
    print(
        "| rod | columns | flops a step | time [µs] | Gflop/s | share of the machine's rate | step at that rate [µs] |"
    )
    print("|---|---|---|---|---|---|---|")
    drive = drive_array(Drive(kind="curvature", curvature_1_m=12.0, period_s=2.0, start_s=1.0))
    for label, modes, points, mirrored in (
        ("2 modes, 12 points, mirrored", 2, 12, True),
        ("3 modes, 16 points, mirrored", 3, 16, True),
        ("3 modes, 16 points, whole", 3, 16, False),
        ("6 modes, 32 points, whole", 6, 32, False),
    ):
        twin = RodTwin(
            BODY, FLOOR, modes=modes, contact_points=points, step_s=0.01, stretches=False, symmetric=mirrored
        )
        twin.play(drive, 1, 300)
        best_s = min(_timed(lambda twin=twin: twin.play(drive, 1, 400)) for _ in range(REPEATS)) / 400
        layout = twin._layout
        count = sum(
            flops(layout.columns, layout.columns - layout.base, layout.points, layout.half, layout.modes).values()
        )
        print(
            f"| {label} | {layout.columns} | {count:,} | {1e6 * best_s:.1f} | {count / best_s / 1e9:.2f} "
            f"| {100.0 * count / best_s / rate:.0f} % | {1e6 * count / rate:.1f} |"
        )


if __name__ == "__main__":
    main()
