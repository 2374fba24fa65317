"""A campaign's runs on a Dask cluster: `softbot campaign … --scheduler tcp://host:8786`.

The workers need this package and numba's cache folder of their own. A worker that dies has its runs made elsewhere by
Dask; each run's row is the same wherever it is made.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from softbot.errors import InputError, SimulationError, SoftbotError

_SHARE = 20  # runs of a task: a second or two
_UNDER_WAY = 2000  # tasks that the scheduler is given at most at once


def run_on_cluster(
    scheduler: str, task: Callable[[int], Any], todo: Sequence[int], keep: Callable[[Any], None]
) -> None:
    """Do `task` for each number of `todo` on the cluster at `scheduler`; `keep` is given each result as it comes.

    Raises InputError when there is no cluster there, or no Dask here.
    """
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise InputError("--scheduler: needs Dask; install it with: pip install 'softbot[cluster]'") from None
    try:
        client = Client(scheduler, timeout="10s")
    except (OSError, ValueError) as error:
        raise InputError(
            f"--scheduler {scheduler}: no Dask scheduler answers there ({error}); check the address"
        ) from None
    with client:
        shares = [list(todo[at : at + _SHARE]) for at in range(0, len(todo), _SHARE)]
        waiting = iter(shares)
        first = [
            client.submit(_several, task, share, pure=False)
            for share, _ in zip(waiting, range(_UNDER_WAY), strict=False)
        ]
        running = as_completed(first)
        for future in running:
            try:
                results = future.result()
            except Exception as error:
                raise SimulationError(f"a worker of the cluster failed: {type(error).__name__}: {error}") from error
            future.release()
            share = next(waiting, None)
            if share is not None:
                running.add(client.submit(_several, task, share, pure=False))
            for result in results:
                keep(result)


def _several(task: Callable[[int], Any], numbers: Sequence[int]) -> list[Any]:
    results: list[Any] = []
    for number in numbers:
        try:
            results.append(task(number))
        except SoftbotError as error:
            results.append(error.with_traceback(None))
    return results
