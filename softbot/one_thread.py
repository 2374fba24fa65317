"""One thread for linear algebra: matrices here are small, and threads that wait for work take a core from others."""

from __future__ import annotations

import os

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Environment variables that say how many threads libraries start; they are read when a library is imported."""


def keep_to_one_thread() -> None:
    """For this process and those it starts, unless the environment says otherwise. Call it before numpy is imported."""
    for name in ONE_THREAD:
        os.environ.setdefault(name, "1")
